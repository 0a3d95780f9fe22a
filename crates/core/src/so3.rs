//! [`So3`]: rotations, accurate from 1e-160 rad to π.
//!
//! Notation: φ a rotation vector (axis times angle, radians), θ = |φ|, K = φ^ its cross-product
//! matrix. Every coefficient that would cancel near θ = 0 has a Taylor series there; the switch
//! sits where both sides agree to the last bits (a test sweeps it).

use nalgebra::{Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// Below this angle the coefficients that lose digits by cancellation come from their series.
/// At 1 rad ten terms reach 1e-17. The closed forms have lost one digit (θ - sin θ) to two (the
/// coefficient over θ⁵) of themselves there, which the powers of φ they multiply take back.
const SERIES_BELOW_RAD: f64 = 1.0;
const SERIES_TERMS: usize = 10;

/// A rotation, held as a unit quaternion (w, x, y, z).
///
/// # Example
/// ```
/// use garad_core::So3;
/// use nalgebra::Vector3;
/// // a quarter turn about z takes x to y
/// let quarter = So3::exp(&Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2));
/// assert!((quarter * Vector3::x() - Vector3::y()).norm() < 1e-15);
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct So3 {
    wxyz: [f64; 4],
}

impl Default for So3 {
    fn default() -> Self {
        Self::identity()
    }
}

/// The matrix v^ with v^ u = v × u.
#[must_use]
#[rustfmt::skip]
pub fn hat(v: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::new(
         0.0, -v.z,  v.y,
         v.z,  0.0, -v.x,
        -v.y,  v.x,  0.0,
    )
}

/// Σₖ (-1)ᵏ θ²ᵏ · coefficient(k), from the smallest term up.
fn alternating_series(theta2: f64, coefficient: impl Fn(usize) -> f64) -> f64 {
    (0..SERIES_TERMS)
        .rev()
        .fold(0.0, |tail, k| coefficient(k) - theta2 * tail)
}

fn inverse_factorial(n: usize) -> f64 {
    (2..=n).fold(1.0, |product, i| product / i as f64)
}

/// sin θ / θ.
fn sinc(theta: f64) -> f64 {
    if theta > 0.0 {
        libm::sin(theta) / theta
    } else {
        1.0
    }
}

/// (1 - cos θ) / θ², as ½ sinc²(θ/2): nothing cancels.
fn one_minus_cos_over_theta2(theta: f64) -> f64 {
    let half = sinc(0.5 * theta);
    0.5 * half * half
}

/// (θ - sin θ) / θ³ = 1/6 - θ²/120 + ...
pub(crate) fn theta_minus_sin_over_theta3(theta: f64) -> f64 {
    if theta < SERIES_BELOW_RAD {
        alternating_series(theta * theta, |k| inverse_factorial(2 * k + 3))
    } else {
        (theta - libm::sin(theta)) / (theta * theta * theta)
    }
}

/// (θ²/2 + cos θ - 1) / θ⁴ = 1/24 - θ²/720 + ...
pub(crate) fn cos_remainder_over_theta4(theta: f64) -> f64 {
    let theta2 = theta * theta;
    if theta < SERIES_BELOW_RAD {
        alternating_series(theta2, |k| inverse_factorial(2 * k + 4))
    } else {
        (0.5 * theta2 + libm::cos(theta) - 1.0) / (theta2 * theta2)
    }
}

/// (2θ - 3 sin θ + θ cos θ) / (2 θ⁵) = 1/120 - 2 θ²/5040 + 3 θ⁴/362880 - ...
pub(crate) fn sin_cos_remainder_over_theta5(theta: f64) -> f64 {
    let theta2 = theta * theta;
    if theta < SERIES_BELOW_RAD {
        alternating_series(theta2, |k| (k + 1) as f64 * inverse_factorial(2 * k + 5))
    } else {
        let (sin, cos) = libm::sincos(theta);
        (2.0 * theta - 3.0 * sin + theta * cos) / (2.0 * theta2 * theta2 * theta)
    }
}

/// (1 - (θ/2) cot(θ/2)) / θ² = 1/12 + θ²/720 + ...; the cot(θ/2) form stays exact up to π.
fn inverse_jacobian_coefficient(theta: f64) -> f64 {
    // B₂ₖ/(2k)! with the sign taken out: 1/12, 1/720, 1/30240, ...
    const BERNOULLI: [f64; 7] = [
        1.0 / 12.0,
        1.0 / 720.0,
        1.0 / 30_240.0,
        1.0 / 1_209_600.0,
        1.0 / 47_900_160.0,
        691.0 / 1_307_674_368_000.0,
        1.0 / 74_724_249_600.0,
    ];
    let theta2 = theta * theta;
    if theta < 0.5 {
        BERNOULLI
            .iter()
            .rev()
            .fold(0.0, |tail, b| b + theta2 * tail)
    } else {
        let (sin, cos) = libm::sincos(0.5 * theta);
        (1.0 - 0.5 * theta * cos / sin) / theta2
    }
}

/// Length without underflow: rotation vectors of 1e-160 rad have squares below the smallest number.
fn safe_norm(v: &Vector3<f64>) -> f64 {
    let largest = v.amax();
    if largest > 0.0 && largest.is_finite() {
        largest * (v / largest).norm()
    } else {
        largest
    }
}

impl So3 {
    /// No rotation.
    #[must_use]
    pub fn identity() -> Self {
        Self {
            wxyz: [1.0, 0.0, 0.0, 0.0],
        }
    }

    /// From (w, x, y, z) of any length but 0; `None` for 0, NaN and infinities.
    #[must_use]
    pub fn from_quaternion(w: f64, x: f64, y: f64, z: f64) -> Option<Self> {
        let largest = w.abs().max(x.abs()).max(y.abs()).max(z.abs());
        let finite = w.is_finite() && x.is_finite() && y.is_finite() && z.is_finite();
        if !finite || largest == 0.0 {
            return None;
        }
        let [w, x, y, z] = [w / largest, x / largest, y / largest, z / largest];
        let norm = (w * w + x * x + y * y + z * z).sqrt();
        Some(Self {
            wxyz: [w / norm, x / norm, y / norm, z / norm],
        })
    }

    /// The unit quaternion (w, x, y, z).
    #[must_use]
    pub fn quaternion(&self) -> [f64; 4] {
        self.wxyz
    }

    /// From a rotation matrix (assumed orthonormal up to rounding), by Shepperd's method: the
    /// largest of the four components is found first and divides the others.
    #[must_use]
    pub fn from_matrix(r: &Matrix3<f64>) -> Self {
        let trace = r[(0, 0)] + r[(1, 1)] + r[(2, 2)];
        // 4w² - 1, 4x² - 1, 4y² - 1, 4z² - 1
        let candidates = [
            trace,
            2.0 * r[(0, 0)] - trace,
            2.0 * r[(1, 1)] - trace,
            2.0 * r[(2, 2)] - trace,
        ];
        let mut best = 0;
        for i in 1..4 {
            if candidates[i] > candidates[best] {
                best = i;
            }
        }
        let skew = [
            r[(2, 1)] - r[(1, 2)],
            r[(0, 2)] - r[(2, 0)],
            r[(1, 0)] - r[(0, 1)],
        ];
        let sum = |i: usize, j: usize| r[(i, j)] + r[(j, i)];
        let four_best = 1.0 + candidates[best]; // 4 (component)²
        let q = match best {
            0 => [four_best, skew[0], skew[1], skew[2]],
            1 => [skew[0], four_best, sum(0, 1), sum(0, 2)],
            2 => [skew[1], sum(0, 1), four_best, sum(1, 2)],
            _ => [skew[2], sum(0, 2), sum(1, 2), four_best],
        };
        // Each entry is 4 (component)(largest component): normalising leaves the quaternion.
        Self::from_quaternion(q[0], q[1], q[2], q[3]).unwrap_or_default()
    }

    /// The rotation matrix.
    #[inline]
    #[must_use]
    #[rustfmt::skip]
    pub fn matrix(&self) -> Matrix3<f64> {
        let [w, x, y, z] = self.wxyz;
        Matrix3::new(
            1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z),       2.0 * (x * z + w * y),
            2.0 * (x * y + w * z),       1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x),
            2.0 * (x * z - w * y),       2.0 * (y * z + w * x),       1.0 - 2.0 * (x * x + y * y),
        )
    }

    /// exp(φ^): the rotation by |φ| about φ.
    ///
    /// q = (cos θ/2, ½ sinc(θ/2) φ)                                                    (E1)
    #[must_use]
    pub fn exp(phi: &Vector3<f64>) -> Self {
        let half = 0.5 * safe_norm(phi);
        let v = phi * (0.5 * sinc(half));
        Self {
            wxyz: [libm::cos(half), v.x, v.y, v.z],
        }
    }

    /// The rotation vector φ with |φ| ≤ π; at π its sign is free.
    ///
    /// φ = 2 atan2(|v|, w) v / |v|, q = ±(w, v) with w ≥ 0                              (E2)
    #[must_use]
    pub fn log(&self) -> Vector3<f64> {
        let [w, x, y, z] = self.wxyz;
        let v = Vector3::new(x, y, z);
        let (w, v) = if w < 0.0 { (-w, -v) } else { (w, v) };
        let sin_half = safe_norm(&v);
        if sin_half > 0.0 {
            v * (2.0 * libm::atan2(sin_half, w) / sin_half)
        } else {
            Vector3::zeros()
        }
    }

    /// The opposite rotation.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let [w, x, y, z] = self.wxyz;
        Self {
            wxyz: [w, -x, -y, -z],
        }
    }

    /// Angle to the identity, in [0, π].
    #[must_use]
    pub fn angle_rad(&self) -> f64 {
        safe_norm(&self.log())
    }

    /// Left Jacobian: exp(φ + δ) ≈ exp(J δ) exp(φ).
    ///
    /// J = I + (1 - cos θ)/θ² K + (θ - sin θ)/θ³ K²                                      (E3)
    #[must_use]
    pub fn left_jacobian(phi: &Vector3<f64>) -> Matrix3<f64> {
        let theta = safe_norm(phi);
        let k = hat(phi);
        Matrix3::identity()
            + k * one_minus_cos_over_theta2(theta)
            + k * k * theta_minus_sin_over_theta3(theta)
    }

    /// Inverse of [`So3::left_jacobian`], for θ < 2π.
    ///
    /// J⁻¹ = I - K/2 + (1 - (θ/2) cot(θ/2))/θ² K²                                        (E4)
    #[must_use]
    pub fn left_jacobian_inverse(phi: &Vector3<f64>) -> Matrix3<f64> {
        let k = hat(phi);
        Matrix3::identity() - k * 0.5 + k * k * inverse_jacobian_coefficient(safe_norm(phi))
    }
}

impl std::ops::Mul for So3 {
    type Output = Self;
    /// Composition: `a_from_c = a_from_b * b_from_c`. The product is brought back to unit length.
    fn mul(self, other: Self) -> Self {
        let [aw, ax, ay, az] = self.wxyz;
        let [bw, bx, by, bz] = other.wxyz;
        Self::from_quaternion(
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        )
        .unwrap_or_default()
    }
}

impl std::ops::Mul<Vector3<f64>> for So3 {
    type Output = Vector3<f64>;
    #[inline]
    fn mul(self, v: Vector3<f64>) -> Vector3<f64> {
        self.matrix() * v
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Both sides of a series switch against each other, in steps across it.
    #[test]
    fn series_and_closed_forms_meet() {
        type Coefficient = fn(f64) -> f64;
        let cases: [(&str, Coefficient, f64, f64); 4] = [
            ("theta - sin", theta_minus_sin_over_theta3, 1.0, 1.0 / 6.0),
            ("cos remainder", cos_remainder_over_theta4, 1.0, 1.0 / 24.0),
            (
                "sin cos remainder",
                sin_cos_remainder_over_theta5,
                1.0,
                1.0 / 120.0,
            ),
            (
                "inverse Jacobian",
                inverse_jacobian_coefficient,
                0.5,
                1.0 / 12.0,
            ),
        ];
        for (name, f, switch, at_zero) in cases {
            assert!((f(0.0) - at_zero).abs() < 1e-17, "{name} at 0");
            let (below, above) = (f(switch * (1.0 - 2e-16)), f(switch));
            assert!(
                (below - above).abs() < 4e-15 * above.abs().max(0.05),
                "{name}: {below} against {above}"
            );
        }
    }

    #[test]
    fn from_matrix_takes_every_branch() {
        use std::f64::consts::PI;
        let axes = [
            Vector3::x(),
            Vector3::y(),
            Vector3::z(),
            Vector3::new(0.6, 0.0, 0.8),
        ];
        for axis in axes {
            for angle in [0.0, 1e-9, 0.5, 2.0, 3.1, PI - 1e-9] {
                let r = So3::exp(&(axis * angle));
                let back = So3::from_matrix(&r.matrix());
                assert!(
                    (back.log() - axis * angle).norm() < 4e-15,
                    "axis {axis:?} angle {angle}"
                );
            }
        }
    }

    #[test]
    fn zero_and_nan_quaternions_are_refused() {
        assert!(So3::from_quaternion(0.0, 0.0, 0.0, 0.0).is_none(), "zero");
        assert!(
            So3::from_quaternion(f64::NAN, 0.0, 0.0, 1.0).is_none(),
            "NaN"
        );
        let tiny = So3::from_quaternion(1e-200, 0.0, 0.0, 0.0).expect("any length");
        assert_eq!(tiny, So3::identity(), "length does not matter");
    }
}
