//! Eigenvectors of a small symmetric matrix by Jacobi's rotations.
//!
//! Visible loops over a fixed size: the same bits on every machine.

use nalgebra::SMatrix;

/// Sweeps after which anything symmetric and finite is diagonal (convergence is quadratic).
const SWEEPS: usize = 30;

/// Eigenvalues in ascending order, and the eigenvectors as columns in the same order.
///
/// Cyclic Jacobi (Golub & Van Loan, algorithm 8.5.3): rotations in the plane (p, q) make a_pq
/// zero until all are. `None` if a number is not finite.
pub(super) fn symmetric_eigen<const N: usize>(
    matrix: &SMatrix<f64, N, N>,
) -> Option<([f64; N], SMatrix<f64, N, N>)> {
    if !matrix.iter().all(|v| v.is_finite()) {
        return None;
    }
    let mut a = *matrix;
    let mut vectors = SMatrix::<f64, N, N>::identity();
    for _ in 0..SWEEPS {
        let mut rotated = false;
        for p in 0..N {
            for q in p + 1..N {
                // Below rounding of the two diagonal entries there is nothing left to rotate.
                let negligible = f64::EPSILON * 1e-3 * (a[(p, p)].abs() + a[(q, q)].abs());
                if a[(p, q)].abs() <= negligible {
                    continue;
                }
                rotated = true;
                let tau = (a[(q, q)] - a[(p, p)]) / (2.0 * a[(p, q)]);
                let t = tau.signum() / (tau.abs() + (1.0 + tau * tau).sqrt());
                let c = 1.0 / (1.0 + t * t).sqrt();
                let s = t * c;
                for k in 0..N {
                    let (kp, kq) = (a[(k, p)], a[(k, q)]);
                    a[(k, p)] = c * kp - s * kq;
                    a[(k, q)] = s * kp + c * kq;
                }
                for k in 0..N {
                    let (pk, qk) = (a[(p, k)], a[(q, k)]);
                    a[(p, k)] = c * pk - s * qk;
                    a[(q, k)] = s * pk + c * qk;
                    let (kp, kq) = (vectors[(k, p)], vectors[(k, q)]);
                    vectors[(k, p)] = c * kp - s * kq;
                    vectors[(k, q)] = s * kp + c * kq;
                }
            }
        }
        if !rotated {
            break;
        }
    }
    let mut order: [usize; N] = std::array::from_fn(|i| i);
    order.sort_by(|&i, &j| a[(i, i)].total_cmp(&a[(j, j)]).then(i.cmp(&j)));
    let sorted = SMatrix::from_fn(|row, column| vectors[(row, order[column])]);
    Some((order.map(|i| a[(i, i)]), sorted))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Matrix3, Vector3};
    use proptest::prelude::*;

    #[test]
    fn by_hand() {
        let (values, vectors) = symmetric_eigen(&Matrix2::new(2.0, 1.0, 1.0, 2.0)).expect("finite");
        assert!(
            (values[0] - 1.0).abs() < 1e-15 && (values[1] - 3.0).abs() < 1e-15,
            "{values:?}"
        );
        assert!(
            (vectors[(0, 0)] + vectors[(1, 0)]).abs() < 1e-15,
            "(1, -1): {vectors}"
        );
        let (values, vectors) = symmetric_eigen(&Matrix3::<f64>::zeros()).expect("finite");
        assert_eq!(
            (values, vectors),
            ([0.0; 3], Matrix3::identity()),
            "nothing to do"
        );
        assert!(
            symmetric_eigen(&Matrix2::new(f64::NAN, 0.0, 0.0, 1.0)).is_none(),
            "NaN"
        );
    }

    proptest! {
        #[test]
        fn decomposes(v in proptest::array::uniform9(-5.0f64..5.0)) {
            let m = Matrix3::from_row_slice(&v);
            let a = m.transpose() * m;
            let (values, vectors) = symmetric_eigen(&a).expect("finite");
            let back = vectors * Matrix3::from_diagonal(&Vector3::from(values)) * vectors.transpose();
            prop_assert!((back - a).norm() <= 1e-14 * a.norm(), "{back} against {a}");
            prop_assert!((vectors.transpose() * vectors - Matrix3::identity()).norm() < 1e-14);
            prop_assert!(values[0] <= values[1] && values[1] <= values[2]);
        }
    }
}
