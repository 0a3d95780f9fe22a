//! F from eight or more pairs of points, linearly.

use nalgebra::{Matrix3, SMatrix, SVector, Vector2};

use super::jacobi::symmetric_eigen;
use crate::error::FeatureError;

/// Pairs the linear system needs.
pub const MIN_PAIRS: usize = 8;

/// Eigenvalues below this share of the largest count as 0. Two of them leave F undetermined:
/// points on one plane, or no parallax.
const RANK_TOLERANCE: f64 = 1e-12;

/// The normalised eight-point algorithm.
///
/// Points of each view are moved to their centroid and scaled to a mean distance of √2; each pair
/// gives one row (p̂₂ ⊗ p̂₁) of A, and F̂ minimises ‖A f‖ with ‖f‖ = 1 (the last eigenvector of
/// AᵀA). Its nearest singular matrix F̂ (I - v vᵀ), v the last right singular vector, goes back
/// to pixels as F = T₂ᵀ F̂ T₁ (E15).
///
/// The result has ‖F‖ = 1 and its entry of largest magnitude positive. Source: Hartley 1997.
///
/// # Numerics
/// f64. On exact points, pairs lie within 1e-6 px (Sampson) of the result.
///
/// # Errors
/// [`FeatureError::SizeMismatch`] for lists of different length, [`FeatureError::TooFewPoints`]
/// below 8, [`FeatureError::Degenerate`] for points that do not determine F or are not finite.
pub fn eight_point(
    uv1: &[Vector2<f64>],
    uv2: &[Vector2<f64>],
) -> Result<Matrix3<f64>, FeatureError> {
    check_pairs(uv1, uv2)?;
    let all: Vec<usize> = (0..uv1.len()).collect();
    eight_point_of(uv1, uv2, &all)
}

pub(super) fn check_pairs(uv1: &[Vector2<f64>], uv2: &[Vector2<f64>]) -> Result<(), FeatureError> {
    if uv1.len() != uv2.len() {
        return Err(FeatureError::SizeMismatch {
            what: "numbers of points",
            left: (uv1.len(), 0),
            right: (uv2.len(), 0),
        });
    }
    if uv1.len() < MIN_PAIRS {
        return Err(FeatureError::TooFewPoints {
            got: uv1.len(),
            needed: MIN_PAIRS,
        });
    }
    Ok(())
}

/// [`eight_point`] of the pairs `chosen`, at least 8.
pub(super) fn eight_point_of(
    uv1: &[Vector2<f64>],
    uv2: &[Vector2<f64>],
    chosen: &[usize],
) -> Result<Matrix3<f64>, FeatureError> {
    let open = |reason| FeatureError::Degenerate { reason };
    let (t1, t2) = (normalisation(uv1, chosen)?, normalisation(uv2, chosen)?);
    let mut normal_matrix = SMatrix::<f64, 9, 9>::zeros();
    for &i in chosen {
        let (p1, p2) = (t1 * uv1[i].push(1.0), t2 * uv2[i].push(1.0));
        let row = SVector::<f64, 9>::from_fn(|k, _| p2[k / 3] * p1[k % 3]);
        for r in 0..9 {
            for c in 0..9 {
                normal_matrix[(r, c)] += row[r] * row[c];
            }
        }
    }
    let (values, vectors) =
        symmetric_eigen(&normal_matrix).ok_or(open("points that are not finite"))?;
    if values[1] <= RANK_TOLERANCE * values[8] {
        return Err(open("points on a plane, on a line, or without parallax"));
    }
    let full_rank = Matrix3::from_fn(|r, c| vectors[(3 * r + c, 0)]);
    let (_, right) = symmetric_eigen(&(full_rank.transpose() * full_rank))
        .ok_or(open("points that are not finite"))?;
    let v = right.column(0);
    let singular = full_rank * (Matrix3::identity() - v * v.transpose());
    Ok(scaled_to_one(&(t2.transpose() * singular * t1)))
}

/// Similarity that brings the points' centroid to 0 and their mean distance from it to √2.
#[rustfmt::skip]
fn normalisation(uv: &[Vector2<f64>], chosen: &[usize]) -> Result<Matrix3<f64>, FeatureError> {
    let n = chosen.len() as f64;
    let centroid = chosen.iter().fold(Vector2::zeros(), |sum, &i| sum + uv[i]) / n;
    let spread = chosen.iter().fold(0.0, |sum, &i| sum + (uv[i] - centroid).norm()) / n;
    if !(spread > 0.0 && spread.is_finite()) {
        return Err(FeatureError::Degenerate { reason: "points that are all equal or not finite" });
    }
    let s = std::f64::consts::SQRT_2 / spread;
    Ok(Matrix3::new(
        s,   0.0, -s * centroid.x,
        0.0, s,   -s * centroid.y,
        0.0, 0.0, 1.0,
    ))
}

/// ‖F‖ = 1 and the entry of largest magnitude positive.
fn scaled_to_one(f: &Matrix3<f64>) -> Matrix3<f64> {
    let largest = f.iter().fold(
        0.0f64,
        |best, &v| if v.abs() > best.abs() { v } else { best },
    );
    f * (largest.signum() / f.norm())
}

#[cfg(test)]
mod tests {
    use super::super::tests::{camera, motion, two_views};
    use super::super::{fundamental, sampson_px2};
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        #[test]
        fn finds_f_from_exact_points(seed: u64, n in 12usize..60) {
            let [uv1, uv2] = two_views(n, &motion(), seed);
            let f = eight_point(&uv1, &uv2).expect("general position");
            for (a, b) in uv1.iter().zip(&uv2) {
                prop_assert!(sampson_px2(&f, a, b).sqrt() < 1e-6, "{}", sampson_px2(&f, a, b));
            }
            prop_assert!((f.norm() - 1.0).abs() < 1e-14 && f.determinant().abs() < 1e-15);
            let truth = scaled_to_one(&fundamental(&camera(), &camera(), &motion()));
            prop_assert!((f - truth).norm() < 1e-6, "{f} against {truth}");
        }
    }

    #[test]
    fn degenerate_points_are_errors() {
        let [uv1, uv2] = two_views(20, &motion(), 1);
        let refused =
            |a: &[Vector2<f64>], b: &[Vector2<f64>]| eight_point(a, b).expect_err("refused");
        assert_eq!(
            refused(&uv1[..7], &uv2[..7]),
            FeatureError::TooFewPoints { got: 7, needed: 8 }
        );
        assert!(
            matches!(refused(&uv1, &uv2[..9]), FeatureError::SizeMismatch { .. }),
            "lengths"
        );
        let degenerate = |a: &[Vector2<f64>], b: &[Vector2<f64>]| {
            assert!(
                matches!(refused(a, b), FeatureError::Degenerate { .. }),
                "open"
            );
        };
        degenerate(&uv1, &uv1); // no motion
        degenerate(&[uv1[0]; 9], &[uv2[0]; 9]); // one point
        let line: Vec<_> = (0..9)
            .map(|i| Vector2::new(f64::from(i), 2.0 * f64::from(i)))
            .collect();
        degenerate(&line, &uv2[..9]); // a line
        let mut nan = uv1.clone();
        nan[3].x = f64::NAN;
        degenerate(&nan, &uv2);
    }
}
