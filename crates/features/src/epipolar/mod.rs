//! Two views of a rigid scene: epipolar geometry.
//!
//! Points are ideal pixels (x, y) of views 1 and 2, homogeneous p = (x, y, 1); everywhere
//!
//! p₂ᵀ F p₁ = 0,   F = K₂⁻ᵀ E K₁⁻¹,   E = t^ R,   (R, t) = `second_from_first`.        (E15)
//!
//! This file computes F from known poses and the distance of a pair of points from
//! it; [`mod@eight_point`] and [`ransac`] estimate F from pairs of points alone.

pub mod eight_point;
mod jacobi;
pub mod ransac;

use garad_core::so3::hat;
use garad_core::{Camera, Se3};
use nalgebra::{Matrix3, Vector2, Vector3};

pub use eight_point::eight_point;
pub use ransac::{FundamentalEstimate, RansacConfig, fundamental_ransac};

/// E = t^ R, with t^ u = t × u.
///
/// Points on the normalised planes of two cameras satisfy x₂ᵀ E x₁ = 0. Zero for a pure rotation,
/// which gives no constraint.
#[must_use]
pub fn essential(second_from_first: &Se3) -> Matrix3<f64> {
    hat(&second_from_first.translation) * second_from_first.rotation.matrix()
}

/// F = K₂⁻ᵀ t^ R K₁⁻¹ of two calibrated views, for ideal (undistorted) pixels (E15).
///
/// Source: Hartley & Zisserman 2004, eq. 9.2. Golden: `epipolar/*`.
///
/// # Example
/// ```
/// use garad_core::{Camera, Se3, So3};
/// use garad_features::epipolar::{fundamental, point_to_line_px};
/// use nalgebra::{Vector2, Vector3};
/// // A camera that moves sideways: rows stay rows.
/// let camera = Camera::pinhole((640, 480), [500.0, 500.0, 319.5, 239.5]).expect("valid");
/// let sideways = Se3::new(So3::identity(), Vector3::new(-0.1, 0.0, 0.0));
/// let f = fundamental(&camera, &camera, &sideways);
/// let [in_1, in_2] = point_to_line_px(&f, &Vector2::new(100.0, 50.0), &Vector2::new(80.0, 53.0));
/// assert!((in_1 - 3.0).abs() < 1e-9 && (in_2 - 3.0).abs() < 1e-9);
/// ```
#[must_use]
pub fn fundamental(first: &Camera, second: &Camera, second_from_first: &Se3) -> Matrix3<f64> {
    inverse_intrinsics(second).transpose()
        * essential(second_from_first)
        * inverse_intrinsics(first)
}

#[rustfmt::skip]
fn inverse_intrinsics(camera: &Camera) -> Matrix3<f64> {
    Matrix3::new(
        1.0 / camera.fx, 0.0,             -camera.cx / camera.fx,
        0.0,             1.0 / camera.fy, -camera.cy / camera.fy,
        0.0,             0.0,             1.0,
    )
}

/// Parts of the three distances: p₂ᵀ F p₁ and the normals of both epipolar lines.
struct Residual {
    algebraic: f64,
    /// (F p₁)₁,₂: normal of the line in view 2.
    normal_2: Vector2<f64>,
    /// (Fᵀ p₂)₁,₂: normal of the line in view 1.
    normal_1: Vector2<f64>,
}

impl Residual {
    fn new(f: &Matrix3<f64>, uv1: &Vector2<f64>, uv2: &Vector2<f64>) -> Self {
        let (p1, p2) = (
            Vector3::new(uv1.x, uv1.y, 1.0),
            Vector3::new(uv2.x, uv2.y, 1.0),
        );
        let (line_2, line_1) = (f * p1, f.transpose() * p2);
        Self {
            algebraic: p2.dot(&line_2),
            normal_2: line_2.xy(),
            normal_1: line_1.xy(),
        }
    }
}

/// a / b, and 0 for 0 / 0: at the epipole every line passes through the point.
fn ratio(a: f64, b: f64) -> f64 {
    if a == 0.0 { 0.0 } else { a / b }
}

/// Distance of each point from the epipolar line of the other, [in view 1, in view 2], pixels:
///
/// d₁ = |p₂ᵀ F p₁| / ‖(Fᵀ p₂)₁,₂‖,   d₂ = |p₂ᵀ F p₁| / ‖(F p₁)₁,₂‖                     (E15)
#[must_use]
pub fn point_to_line_px(f: &Matrix3<f64>, uv1: &Vector2<f64>, uv2: &Vector2<f64>) -> [f64; 2] {
    let r = Residual::new(f, uv1, uv2);
    [
        ratio(r.algebraic.abs(), r.normal_1.norm()),
        ratio(r.algebraic.abs(), r.normal_2.norm()),
    ]
}

/// The mean (d₁ + d₂)/2 of [`point_to_line_px`], pixels: the cue δ of eq. 2, averaged over the
/// observations of a point.
#[must_use]
pub fn symmetric_distance_px(f: &Matrix3<f64>, uv1: &Vector2<f64>, uv2: &Vector2<f64>) -> f64 {
    let [d1, d2] = point_to_line_px(f, uv1, uv2);
    0.5 * (d1 + d2)
}

/// Sampson's distance squared, the first-order reprojection error, pixels²:
///
/// (p₂ᵀ F p₁)² / (‖(F p₁)₁,₂‖² + ‖(Fᵀ p₂)₁,₂‖²)                                        (E15)
#[must_use]
pub fn sampson_px2(f: &Matrix3<f64>, uv1: &Vector2<f64>, uv2: &Vector2<f64>) -> f64 {
    let r = Residual::new(f, uv1, uv2);
    ratio(
        r.algebraic * r.algebraic,
        r.normal_1.norm_squared() + r.normal_2.norm_squared(),
    )
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use garad_core::{Rng, So3};
    use nalgebra::Vector6;
    use proptest::prelude::*;

    pub(crate) fn camera() -> Camera {
        Camera::pinhole((640, 480), [535.4, 539.2, 320.1, 247.6]).expect("valid")
    }

    /// `n` random points before two cameras: pixels in both.
    pub(crate) fn two_views(n: usize, motion: &Se3, seed: u64) -> [Vec<Vector2<f64>>; 2] {
        let mut rng = Rng::new(seed);
        let (mut uv1, mut uv2) = (Vec::new(), Vec::new());
        while uv1.len() < n {
            let uv = Vector2::new(rng.range(0.0, 640.0), rng.range(0.0, 480.0));
            let p1 = camera().unproject(&uv, rng.range(1.0, 5.0));
            if let Some(seen) = camera().project(&(*motion * p1)) {
                uv1.push(uv);
                uv2.push(seen);
            }
        }
        [uv1, uv2]
    }

    pub(crate) fn motion() -> Se3 {
        Se3::exp(&Vector6::new(0.25, -0.04, 0.06, 0.02, 0.08, -0.03))
    }

    #[test]
    fn distances_by_hand() {
        // Sideways motion with unit intrinsics: F = t^, lines are rows.
        let unit = Camera::pinhole((10, 10), [1.0, 1.0, 0.0, 0.0]).expect("valid");
        let sideways = Se3::new(So3::identity(), Vector3::x());
        let f = fundamental(&unit, &unit, &sideways);
        let (a, b) = (Vector2::new(2.0, 3.0), Vector2::new(5.0, 7.0));
        let [in_1, in_2] = point_to_line_px(&f, &a, &b);
        assert!(
            (in_1 - 4.0).abs() < 1e-14 && (in_2 - 4.0).abs() < 1e-14,
            "rows 3 and 7"
        );
        assert!(
            (symmetric_distance_px(&f, &a, &b) - 4.0).abs() < 1e-15,
            "mean"
        );
        // Each view takes half of the error: 2² + 2² = 8.
        assert!((sampson_px2(&f, &a, &b) - 8.0).abs() < 1e-14, "Sampson");
    }

    #[test]
    fn distances_at_the_epipole_are_zero() {
        // Forward motion: both epipoles at the principal point.
        let forward = Se3::new(So3::identity(), Vector3::z());
        let f = fundamental(&camera(), &camera(), &forward);
        let epipole = Vector2::new(camera().cx, camera().cy);
        let anywhere = Vector2::new(10.0, 400.0);
        assert!(
            symmetric_distance_px(&f, &epipole, &epipole).abs() < 1e-12,
            "itself"
        );
        let still = fundamental(&camera(), &camera(), &Se3::identity());
        assert!(
            sampson_px2(&still, &epipole, &anywhere).abs() < 1e-300,
            "no motion: no epipolar line"
        );
        let both = point_to_line_px(&still, &epipole, &anywhere);
        assert!(
            both.iter().all(|d| d.abs() < 1e-300),
            "0 / 0 is 0: {both:?}"
        );
    }

    proptest! {
        #[test]
        fn true_pairs_lie_on_their_lines(v in proptest::array::uniform6(-0.3f64..0.3), seed: u64) {
            let motion = Se3::exp(&Vector6::from_row_slice(&v));
            let f = fundamental(&camera(), &camera(), &motion);
            let [uv1, uv2] = two_views(10, &motion, seed);
            for (a, b) in uv1.iter().zip(&uv2) {
                prop_assert!(sampson_px2(&f, a, b) < 1e-18, "{}", sampson_px2(&f, a, b));
            }
        }

        #[test]
        fn swapping_the_views_transposes(seed: u64) {
            let f = fundamental(&camera(), &camera(), &motion());
            let mut rng = Rng::new(seed);
            let mut pixel = || Vector2::new(rng.range(0.0, 640.0), rng.range(0.0, 480.0));
            let (a, b) = (pixel(), pixel());
            let [d1, d2] = point_to_line_px(&f, &a, &b);
            let [e2, e1] = point_to_line_px(&f.transpose(), &b, &a);
            // Rounding moves a line by some 1e-13 of the coordinates, however near the pixel is.
            prop_assert!((d1 - e1).abs() <= 1e-9 && (d2 - e2).abs() <= 1e-9);
            // Scale of F means nothing.
            let [scaled, plain] = [f * -7.0, f].map(|f| sampson_px2(&f, &a, &b).sqrt());
            prop_assert!((scaled - plain).abs() <= 1e-9, "{scaled} px, {plain} px");
        }
    }
}
