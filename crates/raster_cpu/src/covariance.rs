//! The covariance of a Gaussian, from its own axes to the picture (R2 to R5).
//!
//! Nothing here forms Σ in the world: with M = J W R S, a 2x3 matrix whose columns are the
//! Gaussian's three half-axes as the picture sees them, the projected covariance is M Mᵀ, and
//! its determinant is a sum of squares that cannot cancel.

use garad_core::Real;

use crate::view::View;

/// Added to both diagonal entries of the projected covariance, px²: no splat is sharper than
/// about half a pixel, so none falls between pixel centres. Source: 3D Gaussian Splatting.
pub const BLUR_PX2: f64 = 0.3;

/// A symmetric 2x2 covariance in the picture and its determinant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Covariance2<T> {
    /// px².
    pub(crate) xx: T,
    /// px².
    pub(crate) xy: T,
    /// px².
    pub(crate) yy: T,
    /// xx yy - xy², px⁴, computed without that difference.
    pub(crate) det: T,
}

/// Rotation matrix of a quaternion (w, x, y, z) of any length but zero, row by row (R2).
///
/// `None` when the squared length is 0 or not finite: such a quaternion names no rotation.
#[rustfmt::skip]
pub(crate) fn rotation<T: Real>([w, x, y, z]: [T; 4]) -> Option<[[T; 3]; 3]> {
    let norm = (w * w + x * x + y * y + z * z).sqrt();
    if !(norm > T::ZERO && norm.is_finite()) {
        return None;
    }
    let [w, x, y, z] = [w / norm, x / norm, y / norm, z / norm];
    let (one, two) = (T::ONE, T::from_f64(2.0));
    Some([
        [one - two * (y * y + z * z), two * (x * y - w * z),       two * (x * z + w * y)],
        [two * (x * y + w * z),       one - two * (x * x + z * z), two * (y * z - w * x)],
        [two * (x * z - w * y),       two * (y * z + w * x),       one - two * (x * x + y * y)],
    ])
}

/// J W: the derivative of the pixel by the world point, rows (∂u, ∂v), px/m (R3).
///
/// ∂u/∂p = fx/z (r₀ - s_x r₂),  ∂v/∂p = fy/z (r₁ - s_y r₂),  s = clamp(x/z, y/z)
///
/// with rᵢ the rows of W, the rotation of `camera_from_world`.
pub(crate) fn pixel_from_world<T: Real>(view: &View<T>, p_cam: [T; 3]) -> [[T; 3]; 2] {
    let [x, y, z] = p_cam;
    let r = &view.rotation;
    let row = |axis: usize, slope: T| {
        let limit = view.slope_limit[axis];
        let slope = slope.max(-limit).min(limit);
        [0, 1, 2].map(|j| view.focal_px[axis] / z * (r[axis][j] - slope * r[2][j]))
    };
    [row(0, x / z), row(1, y / z)]
}

/// M = (J W) R S: column k is the k-th half-axis of the 1-sigma ellipsoid, in pixels (R4).
pub(crate) fn half_axes<T: Real>(
    pixel_from_world: &[[T; 3]; 2],
    rotation: &[[T; 3]; 3],
    sigma_m: [T; 3],
) -> [[T; 3]; 2] {
    pixel_from_world.map(|row| {
        [0, 1, 2].map(|k| {
            (row[0] * rotation[0][k] + row[1] * rotation[1][k] + row[2] * rotation[2][k])
                * sigma_m[k]
        })
    })
}

/// Σ' = M Mᵀ + 0.3 I with its determinant (R5):
///
/// det Σ' = Σ_{j<k} (m_j × m_k)² + 0.3 Σ_k |m_k|² + 0.3²
///
/// The first sum is det M Mᵀ by Cauchy-Binet. Every term is a square, so nothing cancels: for a
/// needle of 80 x 0.5 px in f32, xx yy - xy² is off by 4e-4, this by 3e-7.
pub(crate) fn covariance<T: Real>(m: &[[T; 3]; 2]) -> Covariance2<T> {
    let [u, v] = m;
    let dot = |a: &[T; 3], b: &[T; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let cross = |j: usize, k: usize| u[j] * v[k] - u[k] * v[j];
    let (uu, uv, vv) = (dot(u, u), dot(u, v), dot(v, v));
    let (c01, c02, c12) = (cross(0, 1), cross(0, 2), cross(1, 2));
    let blur = T::from_f64(BLUR_PX2);
    Covariance2 {
        xx: uu + blur,
        xy: uv,
        yy: vv + blur,
        det: c01 * c01 + c02 * c02 + c12 * c12 + blur * (uu + vv) + blur * blur,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::{Camera, Se3, So3};
    use nalgebra::{Matrix2x3, Matrix3, Vector3};
    use proptest::prelude::*;

    #[test]
    fn quaternion_of_a_quarter_turn_and_of_nothing() {
        let h = 0.5f64.sqrt();
        // Three times the unit quaternion of a quarter turn about z: x goes to y.
        let r = rotation([3.0 * h, 0.0, 0.0, 3.0 * h]).expect("a rotation");
        assert!(
            (r[1][0] - 1.0).abs() < 1e-15 && r[0][0].abs() < 1e-15,
            "{r:?}"
        );
        assert_eq!(rotation([0.0f64; 4]), None, "zero");
        assert_eq!(
            rotation([1e-30f32, 0.0, 0.0, 0.0]),
            None,
            "square underflows"
        );
        assert_eq!(rotation([1e30f32, 0.0, 0.0, 0.0]), None, "square overflows");
        assert_eq!(rotation([f64::NAN, 1.0, 0.0, 0.0]), None, "NaN");
    }

    proptest! {
        /// The whole chain against the formula as 3D Gaussian Splatting writes it.
        #[test]
        fn spec_covariance(
            x in -3.0f64..3.0, y in -3.0f64..3.0, z in 0.3f64..4.0,
            q in proptest::array::uniform4(-1.0f64..1.0),
            log_scale in proptest::array::uniform3(-6.0f64..0.0),
            turn in proptest::array::uniform3(-1.0f64..1.0),
        ) {
            prop_assume!(q.iter().map(|v| v * v).sum::<f64>() > 1e-3);
            let camera = Camera::pinhole((64, 48), [50.0, 60.0, 20.0, 30.0]).expect("valid");
            let pose = Se3::new(So3::exp(&Vector3::from(turn)), Vector3::zeros());
            let view = View::new(&camera, &pose);
            let sigma = log_scale.map(Real::exp);
            let m = half_axes(
                &pixel_from_world(&view, [x, y, z]),
                &rotation(q).expect("not zero"),
                sigma,
            );
            let ours = covariance(&m);

            let limit = |v: f64, n: f64, f: f64| v.clamp(-1.3 * n / (2.0 * f), 1.3 * n / (2.0 * f));
            let (tx, ty) = (limit(x / z, 64.0, 50.0) * z, limit(y / z, 48.0, 60.0) * z);
            let j = Matrix2x3::new(
                50.0 / z, 0.0, -50.0 * tx / (z * z),
                0.0, 60.0 / z, -60.0 * ty / (z * z),
            );
            let r = So3::from_quaternion(q[0], q[1], q[2], q[3]).expect("not zero").matrix();
            let s2 = Matrix3::from_diagonal(&Vector3::from(sigma.map(|s| s * s)));
            let w = pose.rotation.matrix();
            let cov = j * w * r * s2 * r.transpose() * w.transpose() * j.transpose();
            let size = cov[(0, 0)] + cov[(1, 1)] + 0.6;
            prop_assert!((ours.xx - cov[(0, 0)] - 0.3).abs() < 1e-13 * size, "xx");
            prop_assert!((ours.xy - cov[(0, 1)]).abs() < 1e-13 * size, "xy");
            prop_assert!((ours.yy - cov[(1, 1)] - 0.3).abs() < 1e-13 * size, "yy");
            let det = (cov[(0, 0)] + 0.3) * (cov[(1, 1)] + 0.3) - cov[(0, 1)] * cov[(0, 1)];
            prop_assert!((ours.det - det).abs() < 1e-13 * size * size, "det");
        }
    }

    /// The figures of [`covariance`]'s documentation: needles of 20 to 80 by 0.55 to 1 px at all
    /// angles, the determinant in f32 against f64.
    #[test]
    fn determinant_of_needles_in_f32() {
        let (mut worst, mut worst_naive) = (0.0f64, 0.0f64);
        for step in 0..180 {
            let (sin, cos) = Real::sin_cos(f64::from(step) * std::f64::consts::PI / 180.0);
            for (long, thin) in [(20.0, 0.1), (80.0, 0.5), (80.0, 1.0)] {
                let m32 = [
                    [cos * long, -sin * thin, 0.0].map(Real::to_f32),
                    [sin * long, cos * thin, 0.0].map(Real::to_f32),
                ];
                let ours = covariance(&m32);
                // The truth for exactly these entries.
                let exact = covariance(&m32.map(|row| row.map(f64::from))).det;
                let naive = f64::from(ours.xx * ours.yy - ours.xy * ours.xy);
                worst = worst.max((f64::from(ours.det) - exact).abs() / exact);
                worst_naive = worst_naive.max((naive - exact).abs() / exact);
            }
        }
        assert!(worst < 3e-7, "sum of squares: {worst:e}");
        assert!(
            worst_naive > 2e-4,
            "difference of products: {worst_naive:e}"
        );
    }
}
