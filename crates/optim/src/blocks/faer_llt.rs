//! [`FaerLlt`]: a [`BlockMatrix`] solved by the sparse Cholesky factorisation of the crate `faer`.
//!
//! The structure is analysed once: an approximate minimum degree order of all unknowns, and the
//! supernodes, columns of L with the same rows, which are kept as dense matrices. Each solve permutes
//! the lower triangle of A, factors A = L Lᵀ and substitutes, on one thread.
//!
//! The products of dense matrices run in kernels that faer picks by what the processor has: SSE2, AVX2
//! with fused multiply-add, AVX-512. They sum in different orders and round differently.

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltError;
use faer::sparse::linalg::SupernodalThreshold;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use faer::{Conj, MatMut, Par, Side};
use nalgebra::Vector6;

use super::BlockMatrix;
use crate::solve::NotPositiveDefinite;

/// Where the numbers of A and of its factor are.
#[derive(Debug)]
pub(super) struct FaerLlt {
    /// The lower triangle, column by column.
    matrix: SymbolicSparseColMat<usize>,
    factor: SymbolicCholesky<usize>,
}

impl FaerLlt {
    /// For blocks in the rows `row[start[k]..start[k + 1]]` below the diagonal of column k.
    pub(super) fn new(start: &[usize], row: &[usize]) -> Self {
        let n = start.len() - 1;
        let (mut starts, mut rows) = (vec![0], Vec::new());
        for k in 0..n {
            let below = &row[start[k]..start[k + 1]];
            for j in 0..6 {
                rows.extend(6 * k + j..6 * k + 6);
                rows.extend(below.iter().flat_map(|&r| 6 * r..6 * r + 6));
                starts.push(rows.len());
            }
        }
        let matrix = SymbolicSparseColMat::new_checked(6 * n, 6 * n, starts, None, rows);
        let params = CholeskySymbolicParams {
            supernodal_flop_ratio_threshold: SupernodalThreshold::FORCE_SUPERNODAL,
            ..CholeskySymbolicParams::default()
        };
        let order = SymmetricOrdering::Amd;
        let factor = factorize_symbolic_cholesky(matrix.as_ref(), Side::Lower, order, params)
            .expect("indices of the factor fit into memory");
        Self { matrix, factor }
    }

    /// Numbers of the factor.
    pub(super) fn factor_len(&self) -> usize {
        self.factor.len_val()
    }

    /// x with A x = b in place of b.
    pub(super) fn solve(
        &self,
        a: &BlockMatrix<'_>,
        b: &mut [Vector6<f64>],
    ) -> Result<(), NotPositiveDefinite> {
        let values = self.values(a);
        let a = SparseColMatRef::new(self.matrix.as_ref(), &values);
        let mut x: Vec<f64> = b.iter().flat_map(|b| b.iter().copied()).collect();
        let mut l = vec![0.0; self.factor.len_val()];
        let factoring =
            (self.factor).factorize_numeric_llt_scratch::<f64>(Par::Seq, Default::default());
        let solving = self.factor.solve_in_place_scratch::<f64>(1, Par::Seq);
        let mut memory = MemBuffer::new(factoring.or(solving));
        let memory = MemStack::new(&mut memory);
        let params = Default::default();
        self.factor
            .factorize_numeric_llt(
                &mut l,
                a,
                Side::Lower,
                params,
                Par::Seq,
                memory,
                Default::default(),
            )
            .map_err(|LltError::NonPositivePivot { index }| self.not_positive(index))?
            .solve_in_place_with_conj(
                Conj::No,
                MatMut::from_column_major_slice_mut(&mut x, a.ncols(), 1),
                Par::Seq,
                memory,
            );
        if let Some(row) = x.iter().position(|x| !x.is_finite()) {
            let pivot = f64::NAN;
            return Err(NotPositiveDefinite { row, pivot });
        }
        for (b, x) in b.iter_mut().zip(x.as_chunks::<6>().0) {
            *b = Vector6::from(*x);
        }
        Ok(())
    }

    /// The lower triangle, in the order of `matrix`.
    fn values(&self, a: &BlockMatrix<'_>) -> Vec<f64> {
        let mut values = Vec::with_capacity(self.matrix.compute_nnz());
        for (k, diagonal) in a.diagonal.iter().enumerate() {
            for j in 0..6 {
                values.extend_from_slice(&diagonal[7 * j..6 * j + 6]);
                for block in &a.lower[a.pattern.column(k)] {
                    values.extend_from_slice(&block[6 * j..6 * j + 6]);
                }
            }
        }
        values
    }

    /// The row of A whose pivot failed, from its place in faer's order.
    fn not_positive(&self, index: usize) -> NotPositiveDefinite {
        let order = self.factor.perm().expect("ordered by degree").arrays().0;
        NotPositiveDefinite {
            row: order[index],
            pivot: f64::NAN,
        }
    }
}
