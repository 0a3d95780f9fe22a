//! [`ldlt_solve`]: small symmetric positive definite systems by plain loops.
//!
//! A = L D Lᵀ with L unit lower triangular and D diagonal: as Cholesky, but without square roots.
//! Matrix libraries pick their kernels by processor; these loops have one order of operations and
//! give one answer everywhere.

use nalgebra::{SMatrix, SVector};
use thiserror::Error;

/// The matrix is not positive definite.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
#[error("not positive definite: pivot {pivot} at row {row}")]
pub struct NotPositiveDefinite {
    /// Row of the pivot.
    pub row: usize,
    /// The pivot found: zero, negative, infinite or NaN; NaN also from a solver that does not tell.
    pub pivot: f64,
}

/// x with A x = b, A symmetric positive definite (the upper triangle is read).
///
/// # Numerics
/// N³/6 multiplications, backward stable without pivoting for positive definite A.
///
/// # Errors
/// [`NotPositiveDefinite`] at the first pivot that is not a positive finite number.
///
/// # Example
/// ```
/// use garad_optim::ldlt_solve;
/// use nalgebra::{Matrix2, Vector2};
/// let x = ldlt_solve(&Matrix2::new(4.0, 2.0, 2.0, 3.0), &Vector2::new(10.0, 9.0)).unwrap();
/// assert_eq!(x, Vector2::new(1.5, 2.0));
/// ```
#[inline]
pub fn ldlt_solve<const N: usize>(
    a: &SMatrix<f64, N, N>,
    b: &SVector<f64, N>,
) -> Result<SVector<f64, N>, NotPositiveDefinite> {
    let (mut factor, mut x) = (*a, *b);
    // nalgebra stores columns: read as rows, its upper triangle is the lower one.
    ldlt_factor(factor.as_mut_slice(), N)?;
    ldlt_substitute(factor.as_slice(), x.as_mut_slice());
    Ok(x)
}

/// The inverse of a symmetric positive definite matrix, e.g. a covariance from an information.
///
/// # Errors
/// [`NotPositiveDefinite`] as [`ldlt_solve`].
pub fn ldlt_inverse<const N: usize>(
    a: &SMatrix<f64, N, N>,
) -> Result<SMatrix<f64, N, N>, NotPositiveDefinite> {
    let mut factor = *a;
    ldlt_factor(factor.as_mut_slice(), N)?;
    let mut inverse = SMatrix::<f64, N, N>::identity();
    for column in inverse.as_mut_slice().chunks_exact_mut(N) {
        ldlt_substitute(factor.as_slice(), column);
    }
    Ok(inverse)
}

/// Replaces the lower triangle of a row-major n x n matrix by L (below the diagonal) and D (on it).
///
/// # Errors
/// [`NotPositiveDefinite`] at the first pivot that is not a positive finite number.
#[inline]
pub fn ldlt_factor(a: &mut [f64], n: usize) -> Result<(), NotPositiveDefinite> {
    for i in 0..n {
        let (above, row) = a.split_at_mut(i * n);
        // Row i so far holds A; turn it into L D, column by column: (LD)ᵢⱼ = Aᵢⱼ - Σₖ (LD)ᵢₖ Lⱼₖ.
        for j in 0..i {
            row[j] -= dot(&row[..j], &above[j * n..j * n + j]);
        }
        // Lᵢⱼ = (LD)ᵢⱼ / Dⱼ and Dᵢ = Aᵢᵢ - Σⱼ (LD)ᵢⱼ Lᵢⱼ.
        let mut pivot = row[i];
        for j in 0..i {
            let l_ij = row[j] / above[j * n + j];
            pivot -= row[j] * l_ij;
            row[j] = l_ij;
        }
        if !(pivot > 0.0 && pivot.is_finite()) {
            return Err(NotPositiveDefinite { row: i, pivot });
        }
        row[i] = pivot;
    }
    Ok(())
}

/// Replaces b by the solution of L D Lᵀ x = b, for a factor from [`ldlt_factor`].
#[inline]
pub fn ldlt_substitute(factor: &[f64], b: &mut [f64]) {
    let n = b.len();
    for i in 0..n {
        b[i] -= dot(&b[..i], &factor[i * n..i * n + i]);
    }
    for i in 0..n {
        b[i] /= factor[i * n + i];
    }
    for i in (0..n).rev() {
        let x_i = b[i];
        for j in 0..i {
            b[j] -= x_i * factor[i * n + j];
        }
    }
}

/// Σ aᵢ bᵢ in four interleaved partial sums, always combined in the same order: the processor
/// adds four at a time, and the answer has one order of additions.
#[inline]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (a4, a_rest) = a.as_chunks::<4>();
    let (b4, b_rest) = b.as_chunks::<4>();
    let mut sums = [0.0; 4];
    for (x, y) in a4.iter().zip(b4) {
        for lane in 0..4 {
            sums[lane] += x[lane] * y[lane];
        }
    }
    let mut sum = (sums[0] + sums[1]) + (sums[2] + sums[3]);
    for (x, y) in a_rest.iter().zip(b_rest) {
        sum += x * y;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, SMatrix, Vector3};
    use proptest::prelude::*;

    #[test]
    #[rustfmt::skip]
    fn a_factor_by_hand() {
        // L = [1; 2 1; 3 4 1], D = (2, 3, 5)
        let mut a = [
            2.0,  4.0,  6.0,
            4.0, 11.0, 24.0,
            6.0, 24.0, 71.0,
        ];
        ldlt_factor(&mut a, 3).unwrap();
        let lower = [a[0], a[3], a[4], a[6], a[7], a[8]];
        assert_eq!(lower.map(|v: f64| v.to_string()).join(" "), "2 2 3 3 4 5", "D and L");
    }

    #[test]
    fn indefinite_matrices_are_errors() {
        let row = |m: Matrix3<f64>| ldlt_solve(&m, &Vector3::x()).map_err(|e| e.row);
        assert_eq!(row(Matrix3::zeros()), Err(0), "zero");
        assert_eq!(row(Matrix3::from_element(1.0)), Err(1), "rank 1");
        assert_eq!(row(-Matrix3::identity()), Err(0), "negative");
        assert_eq!(row(Matrix3::from_element(f64::NAN)), Err(0), "NaN");
        assert_eq!(
            row(Matrix3::from_element(f64::INFINITY)),
            Err(0),
            "infinite"
        );
    }

    proptest! {
        /// A = Bᵀ B + I/2 and a known x: the solution, and the inverse column by column.
        #[test]
        fn solutions_solve(
            b in proptest::array::uniform32(-2.0f64..2.0),
            x in proptest::array::uniform5(-3.0f64..3.0),
        ) {
            let b = SMatrix::<f64, 6, 5>::from_iterator(b.iter().copied().cycle());
            let a = b.transpose() * b + SMatrix::<f64, 5, 5>::identity() * 0.5;
            let x = SVector::from(x);
            let solved = ldlt_solve(&a, &(a * x)).unwrap();
            prop_assert!((solved - x).norm() < 1e-11, "{solved} {x}");
            let one = a * ldlt_inverse(&a).unwrap();
            prop_assert!((one - SMatrix::identity()).norm() < 1e-11, "{one}");
        }

        #[test]
        fn dot_is_the_plain_sum(v in proptest::collection::vec(-1.0f64..1.0, 0..40)) {
            let plain: f64 = v.iter().map(|x| x * x).fold(0.0, |a, b| a + b);
            prop_assert!((dot(&v, &v) - plain).abs() < 1e-13, "{plain}");
        }
    }
}
