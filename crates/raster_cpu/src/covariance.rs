//! The covariance of a Gaussian, from its own axes to the image (R2 to R5), and the backward pass
//! (R15 to R18).
//!
//! Nothing here forms Σ in the world: with M = J W R S, a 2x3 matrix whose columns are the
//! Gaussian's three half-axes in the image, the projected covariance is M Mᵀ, and
//! its determinant is a sum of squares that cannot cancel.

use garad_core::Real;

use crate::options::ClampGradient;
use crate::scalar::{column, cross, dot, three, two};
use crate::view::View;

/// Added to both diagonal entries of the projected covariance, px²: no splat is sharper than
/// about half a pixel, so none falls between pixel centres. Source: 3D Gaussian Splatting.
pub const BLUR_PX2: f64 = 0.3;

/// A symmetric 2x2 covariance in the image and its determinant.
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
#[inline]
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

// Cached between the two: nothing; the quaternion is all there is.

/// Backward pass of [`rotation`], from G = ∂L/∂R to the quaternion as stored (R18):
///
/// ∂L/∂q = (1 - q̂ q̂ᵀ) Σᵢⱼ Gᵢⱼ ∂Rᵢⱼ/∂q̂ / |q|
///
/// Orthogonal to q: the length of q changes nothing.
#[inline]
pub(crate) fn rotation_backward<T: Real>(quaternion: [T; 4], g: &[[T; 3]; 3]) -> [T; 4] {
    let [w, x, y, z] = quaternion;
    let norm = (w * w + x * x + y * y + z * z).sqrt();
    let unit = [w / norm, x / norm, y / norm, z / norm];
    let [w, x, y, z] = unit;
    let two = T::from_f64(2.0);
    // ∂R/∂w is antisymmetric; the others are symmetric but for one term with w.
    let (a_x, a_y, a_z) = (g[2][1] - g[1][2], g[0][2] - g[2][0], g[1][0] - g[0][1]);
    let (s_yz, s_xz, s_xy) = (g[1][2] + g[2][1], g[0][2] + g[2][0], g[0][1] + g[1][0]);
    let free = [
        two * (x * a_x + y * a_y + z * a_z),
        two * (w * a_x + y * s_xy + z * s_xz - two * x * (g[1][1] + g[2][2])),
        two * (w * a_y + x * s_xy + z * s_yz - two * y * (g[0][0] + g[2][2])),
        two * (w * a_z + x * s_xz + y * s_yz - two * z * (g[0][0] + g[1][1])),
    ];
    let radial = free[0] * w + free[1] * x + free[2] * y + free[3] * z;
    let across = |k: usize| (free[k] - radial * unit[k]) / norm;
    [across(0), across(1), across(2), across(3)]
}

/// J W: the derivative of the pixel by the world point, rows (∂u, ∂v), px/m (R3).
///
/// ∂u/∂p = fx/z (r₀ - s_x r₂),  ∂v/∂p = fy/z (r₁ - s_y r₂),  s = clamp(x/z, y/z)
///
/// with rᵢ the rows of W, the rotation of `camera_from_world`.
#[inline]
pub(crate) fn pixel_from_world<T: Real>(view: &View<T>, p_cam: [T; 3]) -> [[T; 3]; 2] {
    let [x, y, z] = p_cam;
    let r = &view.rotation;
    let row = |axis: usize, slope: T| {
        let (slope, _) = clamped(slope, view.slope_limit[axis]);
        three(|j| view.focal_px[axis] / z * (r[axis][j] - slope * r[2][j]))
    };
    [row(0, x / z), row(1, y / z)]
}

/// A slope cut to ± `limit`, and whether that changed it.
#[inline]
fn clamped<T: Real>(slope: T, limit: T) -> (T, bool) {
    (slope.max(-limit).min(limit), slope.abs() > limit)
}

// Cached between the two: J W itself.

/// What [`pixel_from_world`] passes back.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PixelFromWorldGradient<T> {
    /// ∂L/∂(point in the camera), 1/m.
    pub(crate) p_cam: [T; 3],
    /// ∂L/∂φ for W ← exp(φ^) W with the point held fixed.
    pub(crate) turn: [T; 3],
}

/// Backward pass of [`pixel_from_world`], from G = ∂L/∂(J W) (R17).
///
/// Per row g of G, with a its axis, s its clamped slope and h = W g the row seen from the camera:
///
/// z += -(g · (J W)_a)/z;  unless clamped, with ∂L/∂s = -(f_a/z) h_z:  a += ∂L/∂s / z, z -= s ∂L/∂s / z;
/// φ += h × J_a,  J_a = (f_a/z) (e_a - s e_z)
#[inline]
pub(crate) fn pixel_from_world_backward<T: Real>(
    view: &View<T>,
    p_cam: [T; 3],
    pixel_from_world: &[[T; 3]; 2],
    gradient: &[[T; 3]; 2],
    clamp: ClampGradient,
) -> PixelFromWorldGradient<T> {
    let z = p_cam[2];
    let (mut d_p, mut turn) = ([T::ZERO; 3], [T::ZERO; 3]);
    for axis in 0..2 {
        let (slope, is_clamped) = clamped(p_cam[axis] / z, view.slope_limit[axis]);
        let scale = view.focal_px[axis] / z;
        let (g, row) = (gradient[axis], pixel_from_world[axis]);
        d_p[2] -= dot(g, row) / z;
        let h = three(|i| dot(view.rotation[i], g));
        let d_slope = -scale * h[2];
        if !is_clamped {
            d_p[axis] += d_slope / z;
        }
        // The CUDA code holds s z, not s, while z moves.
        if !is_clamped || clamp == ClampGradient::PassThrough {
            d_p[2] -= slope * d_slope / z;
        }
        let mut j = [T::ZERO, T::ZERO, -scale * slope];
        j[axis] = scale;
        for (sum, part) in turn.iter_mut().zip(cross(h, j)) {
            *sum += part;
        }
    }
    PixelFromWorldGradient { p_cam: d_p, turn }
}

/// M = (J W) R S: column k is the k-th half-axis of the 1-sigma ellipsoid, in pixels (R4).
#[inline]
pub(crate) fn half_axes<T: Real>(
    pixel_from_world: &[[T; 3]; 2],
    rotation: &[[T; 3]; 3],
    sigma_m: [T; 3],
) -> [[T; 3]; 2] {
    two(|a| three(|k| dot(pixel_from_world[a], column(rotation, k)) * sigma_m[k]))
}

// Cached between the two: M, J W, R and σ.

/// What [`half_axes`] passes back.
#[derive(Debug, Clone, Copy)]
pub(crate) struct HalfAxesGradient<T> {
    /// ∂L/∂(J W).
    pub(crate) pixel_from_world: [[T; 3]; 2],
    /// ∂L/∂R.
    pub(crate) rotation: [[T; 3]; 3],
    /// ∂L/∂ ln σ.
    pub(crate) log_scale: [T; 3],
}

/// Backward pass of [`half_axes`], from G = ∂L/∂M (R16):
///
/// ∂L/∂(J W) = G S Rᵀ,   ∂L/∂R = (J W)ᵀ G S,   ∂L/∂ ln σₖ = m_k · g_k
#[inline]
pub(crate) fn half_axes_backward<T: Real>(
    pixel_from_world: &[[T; 3]; 2],
    rotation: &[[T; 3]; 3],
    sigma_m: [T; 3],
    m: &[[T; 3]; 2],
    g: &[[T; 3]; 2],
) -> HalfAxesGradient<T> {
    let gs = two(|a| three(|k| g[a][k] * sigma_m[k]));
    HalfAxesGradient {
        pixel_from_world: two(|a| three(|j| dot(gs[a], rotation[j]))),
        rotation: three(|j| {
            three(|k| pixel_from_world[0][j] * gs[0][k] + pixel_from_world[1][j] * gs[1][k])
        }),
        log_scale: three(|k| m[0][k] * g[0][k] + m[1][k] * g[1][k]),
    }
}

/// Σ' = M Mᵀ + 0.3 I with its determinant (R5):
///
/// det Σ' = Σ_{j<k} (m_j × m_k)² + 0.3 Σ_k |m_k|² + 0.3²
///
/// The first sum is det M Mᵀ by Cauchy-Binet. Every term is a square, so nothing cancels: for a
/// needle of 80 x 0.5 px in f32, xx yy - xy² is off by 4e-4, this by 3e-7.
#[inline]
pub(crate) fn covariance<T: Real>(m: &[[T; 3]; 2]) -> Covariance2<T> {
    let [u, v] = *m;
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

// Cached between the two: M.

/// Backward pass of [`covariance`], from ∂L/∂(Σ'xx, Σ'xy, Σ'yy) to ∂L/∂M (R15).
///
/// Σ'xy stands for both entries off the diagonal. det Σ' is a function of the three and passes
/// nothing back of its own.
#[inline]
pub(crate) fn covariance_backward<T: Real>(m: &[[T; 3]; 2], [xx, xy, yy]: [T; 3]) -> [[T; 3]; 2] {
    let [u, v] = m;
    let two = T::from_f64(2.0);
    [
        three(|k| two * xx * u[k] + xy * v[k]),
        three(|k| xy * u[k] + two * yy * v[k]),
    ]
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

    /// One axis clamped: only z moves the Jacobian there, and only so far as the option says.
    #[test]
    fn clamped_slopes_pass_nothing_sideways() {
        let camera = Camera::pinhole((8, 8), [4.0, 4.0, 3.5, 3.5]).expect("valid");
        let view = View::<f64>::new(&camera, &Se3::default());
        // Limit 1.3 · 8 / (2 · 4) = 1.3; x/z = 2 is beyond, y/z = 0.5 within.
        let p = [4.0, 1.0, 2.0];
        let jw = pixel_from_world(&view, p);
        let ones = [[1.0; 3]; 2];
        let back = |clamp| pixel_from_world_backward(&view, p, &jw, &ones, clamp).p_cam;
        // Row u = 2 (1, 0, -1.3), sum -0.6; row v = (4/z) (0, 1, -y/z), sum 4/z - 4 y/z² = 1.
        let (x, y) = (0.0, -4.0 / 4.0);
        let z_of_v = -4.0 / 4.0 + 2.0 * 4.0 * 1.0 / 8.0; // -4/z² + 8 y/z³
        let z_true = -2.0 / 2.0 * (1.0 - 1.3); // f/z (1 - s), s fixed
        let z_cuda = -4.0 / 4.0 + 2.0 * 4.0 * 2.6 / 8.0; // -4/z² + 8 (s z)/z³, s z fixed
        for (clamp, z_of_u) in [
            (ClampGradient::True, z_true),
            (ClampGradient::PassThrough, z_cuda),
        ] {
            let got = back(clamp);
            for (got, want) in got.iter().zip([x, y, z_of_u + z_of_v]) {
                assert!(
                    (got - want).abs() < 1e-14,
                    "{clamp:?}: {got} against {want}"
                );
            }
        }
    }

    #[test]
    fn gradient_of_a_quaternion_is_across_it() {
        let q = [0.4f64, -1.1, 0.3, 2.0];
        let g = [[0.3, -0.8, 0.5], [1.0, 0.2, -0.6], [0.7, 0.1, -0.4]];
        let d = rotation_backward(q, &g);
        let radial: f64 = d.iter().zip(q).map(|(d, q)| d * q).sum();
        assert!(radial.abs() < 1e-15, "{radial:e}");
        let value = |q: [f64; 4]| -> f64 {
            let r = rotation(q).expect("not zero");
            (0..9).map(|k| r[k / 3][k % 3] * g[k / 3][k % 3]).sum()
        };
        for k in 0..4 {
            let at = |h: f64| {
                let mut moved = q;
                moved[k] += h;
                value(moved)
            };
            let h = 1e-3;
            let slope = (8.0 * (at(h) - at(-h)) - (at(2.0 * h) - at(-2.0 * h))) / (12.0 * h);
            assert!(
                (d[k] - slope).abs() < 1e-11 && d[k].abs() > 1e-3,
                "component {k}"
            );
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
