//! [`BlockMatrix`]: sparse symmetric systems of 6x6 blocks, one per pose, by plain loops.
//!
//! Two poses share a block if something couples them: an edge of a pose graph, a point seen by
//! both. Eliminating a pose couples all poses it was coupled with, so the order of elimination
//! decides how many blocks fill in. [`Pattern`] picks it greedily: the pose with the fewest
//! neighbours next (minimum degree; Tinney and Walker 1967), the lowest index among equals. A
//! chain of keyframes then stays a chain, and a loop closure costs a few more blocks.
//!
//! The factorisation is that of [`crate::solve`], A = L D Lᵀ, with blocks for numbers, in one
//! order of operations: the same bits on every machine.

use nalgebra::Vector6;

use crate::solve::{NotPositiveDefinite, ldlt_factor, ldlt_substitute};

/// A 6x6 block, column by column: (i, j) at 6 j + i.
pub(crate) type Block = [f64; 36];

/// Which blocks of the factor are not zero, and the order in which poses are eliminated.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Pattern {
    /// Step at which each pose is eliminated.
    step: Vec<usize>,
    /// `start[k]..start[k + 1]` are the blocks below the diagonal of the k-th column.
    start: Vec<usize>,
    /// Their rows (steps), ascending within a column.
    row: Vec<usize>,
}

impl Pattern {
    /// For n poses and the pairs of them that are coupled, in any order and multiplicity.
    pub(crate) fn new(n: usize, pairs: impl IntoIterator<Item = (usize, usize)>) -> Self {
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
        let (mut start, mut row) = (vec![0], Vec::new());
        for mut column in columns {
            for a in &mut column {
                *a = step[*a];
            }
            column.sort_unstable();
            row.extend(column);
            start.push(row.len());
        }
        Self { step, start, row }
    }

    /// Number of poses.
    pub(crate) fn len(&self) -> usize {
        self.step.len()
    }

    /// When a pose is eliminated: of a coupled pair, the later one is the row of their block.
    pub(crate) fn step(&self, pose: usize) -> usize {
        self.step[pose]
    }

    /// Place among the off-diagonal blocks of the one with this row and column (steps).
    pub(crate) fn slot(&self, row: usize, column: usize) -> Option<usize> {
        let start = self.start[column];
        let rows = &self.row[start..self.start[column + 1]];
        rows.binary_search(&row).ok().map(|i| start + i)
    }

    /// Number of off-diagonal blocks of the factor.
    pub(crate) fn off_diagonal(&self) -> usize {
        self.row.len()
    }

    fn column(&self, k: usize) -> std::ops::Range<usize> {
        self.start[k]..self.start[k + 1]
    }
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
pub(crate) struct BlockMatrix<'a> {
    pattern: &'a Pattern,
    pub(crate) diagonal: Vec<Block>,
    pub(crate) lower: Vec<Block>,
}

impl<'a> BlockMatrix<'a> {
    pub(crate) fn zeros(pattern: &'a Pattern) -> Self {
        Self {
            pattern,
            diagonal: vec![[0.0; 36]; pattern.len()],
            lower: vec![[0.0; 36]; pattern.off_diagonal()],
        }
    }

    /// x with A x = b, a vector per step; b is replaced. A becomes its factor.
    ///
    /// # Errors
    /// [`NotPositiveDefinite`] at the first pivot that is not a positive finite number.
    pub(crate) fn solve(mut self, b: &mut [Vector6<f64>]) -> Result<(), NotPositiveDefinite> {
        self.factor()?;
        self.substitute(b);
        Ok(())
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
mod tests {
    use super::*;
    use garad_core::Rng;
    use nalgebra::{DMatrix, DVector};
    use proptest::prelude::*;

    fn filled(n: usize, pairs: &[(usize, usize)]) -> usize {
        Pattern::new(n, pairs.iter().copied()).off_diagonal()
    }

    #[test]
    fn chains_and_stars_do_not_fill() {
        assert_eq!(filled(5, &[(0, 1), (1, 2), (2, 3), (3, 4)]), 4, "chain");
        assert_eq!(
            filled(5, &[(0, 1), (0, 2), (0, 3), (0, 4)]),
            4,
            "star: its centre goes last"
        );
        assert_eq!(
            filled(4, &[(0, 1), (1, 2), (2, 3), (3, 0)]),
            5,
            "a ring gets one chord"
        );
        assert_eq!(
            filled(3, &[(0, 1), (1, 0), (2, 2)]),
            1,
            "pairs count once, loops not at all"
        );
        assert_eq!(filled(0, &[]), 0, "nothing");
    }

    #[test]
    fn indefinite_matrices_are_errors() {
        let pattern = Pattern::new(2, [(0, 1)]);
        let mut matrix = BlockMatrix::zeros(&pattern);
        matrix.diagonal[0] = std::array::from_fn(|i| f64::from(u8::from(i % 7 == 0)));
        let error = matrix.solve(&mut [Vector6::zeros(); 2]);
        assert_eq!(error.map_err(|e| e.row), Err(6), "the second pose is free");
    }

    proptest! {
        /// Σ JᵀJ over random couplings, and an identity: the block solver, and the full matrix
        /// times its answer.
        #[test]
        fn solutions_solve(
            pairs in proptest::collection::vec((0usize..9, 0usize..9), 0..20),
            seed: u64,
        ) {
            let n = 9;
            let mut rng = Rng::new(seed);
            let pattern = Pattern::new(n, pairs.iter().copied());
            let mut full = DMatrix::<f64>::identity(6 * n, 6 * n);
            for &(a, b) in &pairs {
                let mut j = DMatrix::<f64>::zeros(6, 6 * n);
                for i in 0..6 {
                    for k in 0..6 {
                        j[(i, 6 * a + k)] = rng.normal();
                        j[(i, 6 * b + k)] = rng.normal();
                    }
                }
                full += j.transpose() * j;
            }
            let mut matrix = BlockMatrix::zeros(&pattern);
            for a in 0..n {
                for b in 0..n {
                    let block = |i: usize| full[(6 * a + i % 6, 6 * b + i / 6)];
                    let (row, column) = (pattern.step(a), pattern.step(b));
                    if a == b {
                        matrix.diagonal[row] = std::array::from_fn(block);
                    } else if row > column
                        && let Some(slot) = pattern.slot(row, column)
                    {
                        matrix.lower[slot] = std::array::from_fn(block);
                    }
                }
            }
            let right = DVector::from_fn(6 * n, |_, _| rng.normal());
            let mut x = vec![Vector6::zeros(); n];
            for a in 0..n {
                x[pattern.step(a)] = right.fixed_rows::<6>(6 * a).into_owned();
            }
            matrix.solve(&mut x).unwrap();
            let x = DVector::from_fn(6 * n, |i, _| x[pattern.step(i / 6)][i % 6]);
            prop_assert!((full * &x - &right).amax() < 1e-10, "residual");
        }
    }
}
