//! [`BlockMatrix`]: sparse symmetric systems of 6x6 blocks, one per pose, and their solvers.
//!
//! Two poses share a block if something couples them: an edge of a pose graph, a point seen by
//! both. Eliminating a pose couples all poses it was coupled with, so the order of elimination
//! decides how many blocks fill in. [`LinearSolver`] names who orders and factors:
//!
//! | | [`LinearSolver::Portable`] | [`LinearSolver::Faer`] |
//! |---|---|---|
//! | code | loops in this file | the crate `faer`, by `faer_llt` |
//! | order | minimum degree (Tinney and Walker 1967): the pose with the fewest neighbours next, the lowest index among equals | approximate minimum degree (Amestoy, Davis and Duff 1996) |
//! | factor | A = L D Lᵀ as in [`crate::solve`], with blocks for numbers | A = L Lᵀ, columns of one structure together as a dense matrix |
//! | bits | one order of operations: the same on every machine | depend on the vector instructions of the processor |
//!
//! In either order a chain of keyframes stays a chain, and a loop closure costs a few more blocks.
//! Times of both: decision 017.

mod faer_llt;

use nalgebra::Vector6;
use serde::{Deserialize, Serialize};

use self::faer_llt::FaerLlt;
use crate::solve::{NotPositiveDefinite, ldlt_factor, ldlt_substitute};

/// The solver of a sparse system of poses (decision 017).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LinearSolver {
    /// LDLᵀ by plain loops: the same bits on every machine.
    #[default]
    Portable,
    /// LLᵀ of the crate `faer`, on one thread: faster for bundles of hundreds of keyframes. The last
    /// bits depend on the vector instructions of the processor.
    Faer,
}

/// A 6x6 block, column by column: (i, j) at 6 j + i.
pub type Block = [f64; 36];

/// Where the blocks of a matrix are, analysed once for all matrices of that structure.
///
/// For [`LinearSolver::Portable`] the blocks are those of the factor, and `step` is the order in
/// which poses are eliminated; for [`LinearSolver::Faer`] they are those of the matrix, in the order
/// in which the poses came.
#[derive(Debug)]
pub struct Pattern {
    /// Step of each pose: its row and column.
    step: Vec<usize>,
    /// `start[k]..start[k + 1]` are the blocks below the diagonal of the k-th column.
    start: Vec<usize>,
    /// Their rows (steps), ascending within a column.
    row: Vec<usize>,
    /// `None`: the portable solver.
    faer: Option<FaerLlt>,
}

impl Pattern {
    /// For n poses and the pairs of them that are coupled, in any order and multiplicity.
    pub fn new(
        n: usize,
        pairs: impl IntoIterator<Item = (usize, usize)>,
        solver: LinearSolver,
    ) -> Self {
        let mut neighbours = vec![Vec::new(); n];
        for (a, b) in pairs {
            if a != b {
                neighbours[a].push(b);
                neighbours[b].push(a);
            }
        }
        for list in &mut neighbours {
            list.sort_unstable();
            list.dedup();
        }
        let (step, columns) = match solver {
            LinearSolver::Portable => minimum_degree(neighbours),
            LinearSolver::Faer => ((0..n).collect(), below_diagonal(neighbours)),
        };
        let (mut start, mut row) = (vec![0], Vec::new());
        for mut column in columns {
            for a in &mut column {
                *a = step[*a];
            }
            column.sort_unstable();
            row.extend(column);
            start.push(row.len());
        }
        let faer = (solver == LinearSolver::Faer).then(|| FaerLlt::new(&start, &row));
        Self {
            step,
            start,
            row,
            faer,
        }
    }

    /// Number of poses.
    pub(crate) fn len(&self) -> usize {
        self.step.len()
    }

    /// Row and column of a pose: of a coupled pair, the later step is the row of their block.
    pub fn step(&self, pose: usize) -> usize {
        self.step[pose]
    }

    /// Place among the off-diagonal blocks of the one with this row and column (steps).
    pub fn slot(&self, row: usize, column: usize) -> Option<usize> {
        let start = self.start[column];
        let rows = &self.row[start..self.start[column + 1]];
        rows.binary_search(&row).ok().map(|i| start + i)
    }

    /// Numbers that the factor holds, on the diagonal and below: fill-in, and what a solver adds.
    pub fn factor_len(&self) -> usize {
        match &self.faer {
            None => 36 * (self.len() + self.row.len()),
            Some(faer) => faer.factor_len(),
        }
    }

    fn column(&self, k: usize) -> std::ops::Range<usize> {
        self.start[k]..self.start[k + 1]
    }
}

/// For each pose its coupled ones, ascending: the step of each pose, and the poses below the diagonal
/// of each step's column once all earlier ones are eliminated.
fn minimum_degree(mut neighbours: Vec<Vec<usize>>) -> (Vec<usize>, Vec<Vec<usize>>) {
    let n = neighbours.len();
    let mut step = vec![usize::MAX; n];
    let mut columns = Vec::with_capacity(n);
    for k in 0..n {
        let next = (0..n)
            .filter(|&a| step[a] == usize::MAX)
            .min_by_key(|&a| neighbours[a].len())
            .expect("k poses of n are eliminated so far");
        step[next] = k;
        let clique = std::mem::take(&mut neighbours[next]);
        for &a in &clique {
            let others = clique.iter().copied().filter(|&b| b != a);
            let list = std::mem::take(&mut neighbours[a]);
            neighbours[a] = union(list.into_iter().filter(|&b| b != next), others);
        }
        columns.push(clique);
    }
    (step, columns)
}

/// The poses below the diagonal of each column, without any elimination.
fn below_diagonal(mut neighbours: Vec<Vec<usize>>) -> Vec<Vec<usize>> {
    for (a, list) in neighbours.iter_mut().enumerate() {
        list.retain(|&b| b > a);
    }
    neighbours
}

/// Two ascending lists merged into one, without repetition.
fn union(a: impl Iterator<Item = usize>, b: impl Iterator<Item = usize>) -> Vec<usize> {
    let (mut a, mut b) = (a.peekable(), b.peekable());
    let mut merged = Vec::new();
    loop {
        let next = match (a.peek(), b.peek()) {
            (None, None) => return merged,
            (Some(&x), None) | (None, Some(&x)) => x,
            (Some(&x), Some(&y)) => x.min(y),
        };
        a.next_if_eq(&next);
        b.next_if_eq(&next);
        merged.push(next);
    }
}

/// A symmetric matrix with the blocks of a [`Pattern`]: whole diagonal blocks by step, and what
/// lies below them by slot.
#[derive(Debug, Clone)]
pub struct BlockMatrix<'a> {
    pattern: &'a Pattern,
    /// A block per step; both triangles.
    pub diagonal: Vec<Block>,
    /// A block per slot.
    pub lower: Vec<Block>,
}

impl<'a> BlockMatrix<'a> {
    /// Without values.
    pub fn zeros(pattern: &'a Pattern) -> Self {
        Self {
            pattern,
            diagonal: vec![[0.0; 36]; pattern.len()],
            lower: vec![[0.0; 36]; pattern.row.len()],
        }
    }

    /// x with A x = b, a vector per step; b is replaced.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] at the first pivot, in the solver's order, that is not a positive
    /// finite number; faer does not tell its value.
    pub fn solve(mut self, b: &mut [Vector6<f64>]) -> Result<(), NotPositiveDefinite> {
        match &self.pattern.faer {
            None => {
                self.factor()?;
                self.substitute(b);
                Ok(())
            }
            Some(faer) => faer.solve(&self, b),
        }
    }

    /// Column by column: L_ik = A_ik D_k⁻¹, then A_ij -= L_ik (L_jk D_k)ᵀ for all pairs below.
    fn factor(&mut self) -> Result<(), NotPositiveDefinite> {
        let mut scaled: Vec<Block> = Vec::new(); // L D of the column at hand
        for k in 0..self.pattern.len() {
            ldlt_factor(&mut self.diagonal[k], 6).map_err(|e| NotPositiveDefinite {
                row: 6 * k + e.row,
                ..e
            })?;
            let column = self.pattern.column(k);
            scaled.clear();
            scaled.extend_from_slice(&self.lower[column.clone()]);
            for slot in column.clone() {
                divide(&mut self.lower[slot], &self.diagonal[k]);
            }
            for (j, slot_j) in column.clone().enumerate() {
                let row_j = self.pattern.row[slot_j];
                let right = &scaled[j];
                let left = self.lower[slot_j];
                subtract_product(&mut self.diagonal[row_j], &left, right);
                // Column row_j holds all later rows of column k, by construction of the pattern.
                let mut target = self.pattern.start[row_j];
                for slot_i in slot_j + 1..column.end {
                    while self.pattern.row[target] < self.pattern.row[slot_i] {
                        target += 1;
                    }
                    let left = self.lower[slot_i];
                    subtract_product(&mut self.lower[target], &left, right);
                }
            }
        }
        Ok(())
    }

    /// L D Lᵀ x = b in place, in order of elimination.
    fn substitute(&self, x: &mut [Vector6<f64>]) {
        for k in 0..x.len() {
            for slot in self.pattern.column(k) {
                let x_k = x[k];
                let row = &mut x[self.pattern.row[slot]];
                for (column, &x_kj) in self.lower[slot].as_chunks::<6>().0.iter().zip(x_k.iter()) {
                    for i in 0..6 {
                        row[i] -= column[i] * x_kj;
                    }
                }
            }
        }
        for (x_k, diagonal) in x.iter_mut().zip(&self.diagonal) {
            ldlt_substitute(diagonal, x_k.as_mut_slice());
        }
        for k in (0..x.len()).rev() {
            for slot in self.pattern.column(k) {
                let x_i = x[self.pattern.row[slot]];
                for (j, column) in self.lower[slot].as_chunks::<6>().0.iter().enumerate() {
                    let mut dot = 0.0;
                    for i in 0..6 {
                        dot += column[i] * x_i[i];
                    }
                    x[k][j] -= dot;
                }
            }
        }
    }
}

/// A becomes A D⁻¹ for a factored symmetric block D: each row solved as a right side.
fn divide(a: &mut Block, diagonal: &Block) {
    for i in 0..6 {
        let mut row = [0.0; 6];
        for j in 0..6 {
            row[j] = a[6 * j + i];
        }
        ldlt_substitute(diagonal, &mut row);
        for j in 0..6 {
            a[6 * j + i] = row[j];
        }
    }
}

/// C -= A Bᵀ.
fn subtract_product(c: &mut Block, a: &Block, b: &Block) {
    let (a, _) = a.as_chunks::<6>();
    for (j, column) in c.as_chunks_mut::<6>().0.iter_mut().enumerate() {
        for k in 0..6 {
            let b_jk = b[6 * k + j];
            for i in 0..6 {
                column[i] -= a[k][i] * b_jk;
            }
        }
    }
}

#[cfg(test)]
mod tests;
