//! [`Se3`]: rigid motions, and the conventions of every pose in this project.
//!
//! | question | answer | test that fails under the other choice |
//! |---|---|---|
//! | what `camera_from_world` does | x_cam = R x_world + t | `acts_on_points` |
//! | composition | `a_from_c = a_from_b * b_from_c` | `acts_on_points` |
//! | tangent order | ξ = (ρ, φ): translation first, then rotation | `tangent_order` |
//! | perturbation | on the left: exp(ξ) * pose | `adjoint_moves_to_the_left` |
//! | quaternion | (w, x, y, z) in memory, `qx qy qz qw` in TUM files | `quaternion_order` |
//!
//! Points and vectors are both `Vector3`: `pose * p` moves a point, `pose.rotation * v` a vector.

use nalgebra::{Matrix3, Matrix4, Matrix6, Vector3, Vector6};
use serde::{Deserialize, Serialize};

use crate::so3::{
    So3, cos_remainder_over_theta4, hat, sin_cos_remainder_over_theta5, theta_minus_sin_over_theta3,
};

/// A rigid motion x ↦ R x + t.
///
/// # Example
/// ```
/// use garad_core::{Se3, So3};
/// use nalgebra::Vector3;
/// // A camera one metre behind the world's origin sees that origin one metre ahead.
/// let camera_from_world = Se3::new(So3::identity(), Vector3::new(0.0, 0.0, 1.0));
/// assert_eq!(camera_from_world * Vector3::zeros(), Vector3::new(0.0, 0.0, 1.0));
/// assert_eq!(camera_from_world.inverse().translation, Vector3::new(0.0, 0.0, -1.0));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Se3 {
    /// R.
    pub rotation: So3,
    /// t, metres.
    pub translation: Vector3<f64>,
}

impl Se3 {
    /// From its parts.
    #[must_use]
    pub fn new(rotation: So3, translation: Vector3<f64>) -> Self {
        Self {
            rotation,
            translation,
        }
    }

    /// No motion.
    #[must_use]
    pub fn identity() -> Self {
        Self::default()
    }

    /// exp(ξ^), ξ = (ρ, φ).
    ///
    /// R = exp(φ^), t = J(φ) ρ                                                           (E5)
    #[must_use]
    pub fn exp(xi: &Vector6<f64>) -> Self {
        let (rho, phi) = split(xi);
        Self {
            rotation: So3::exp(&phi),
            translation: So3::left_jacobian(&phi) * rho,
        }
    }

    /// ξ with exp(ξ^) = self and |φ| ≤ π.
    #[must_use]
    pub fn log(&self) -> Vector6<f64> {
        let phi = self.rotation.log();
        let rho = So3::left_jacobian_inverse(&phi) * self.translation;
        Vector6::new(rho.x, rho.y, rho.z, phi.x, phi.y, phi.z)
    }

    /// `b_from_a` of `a_from_b`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let rotation = self.rotation.inverse();
        Self {
            rotation,
            translation: -(rotation * self.translation),
        }
    }

    /// Ad with exp(Ad ξ) = T exp(ξ) T⁻¹: a perturbation carried from the right to the left.
    ///
    /// Ad = [R, t^ R; 0, R]                                                              (E6)
    #[must_use]
    pub fn adjoint(&self) -> Matrix6<f64> {
        let r = self.rotation.matrix();
        blocks(&r, &(hat(&self.translation) * r), &r)
    }

    /// Left Jacobian of SE(3): exp(ξ + δ) ≈ exp(J δ) exp(ξ), J = [Jφ, Q; 0, Jφ].        (E7)
    #[must_use]
    pub fn left_jacobian(xi: &Vector6<f64>) -> Matrix6<f64> {
        let (rho, phi) = split(xi);
        let j = So3::left_jacobian(&phi);
        blocks(&j, &Self::left_jacobian_q(&rho, &phi), &j)
    }

    /// Inverse of [`Se3::left_jacobian`]: [J⁻¹, -J⁻¹ Q J⁻¹; 0, J⁻¹].
    #[must_use]
    pub fn left_jacobian_inverse(xi: &Vector6<f64>) -> Matrix6<f64> {
        let (rho, phi) = split(xi);
        let j_inv = So3::left_jacobian_inverse(&phi);
        let q = Self::left_jacobian_q(&rho, &phi);
        blocks(&j_inv, &-(j_inv * q * j_inv), &j_inv)
    }

    /// The upper right block of the left Jacobian (Barfoot 2017, eq. 7.86):
    ///
    /// Q = ½ P + (θ - sin θ)/θ³ (KP + PK + KPK) + (θ²/2 + cos θ - 1)/θ⁴ (K²P + PK² - 3KPK)
    ///     + (2θ - 3 sin θ + θ cos θ)/(2θ⁵) (KPK² + K²PK),   P = ρ^, K = φ^               (E8)
    #[must_use]
    pub fn left_jacobian_q(rho: &Vector3<f64>, phi: &Vector3<f64>) -> Matrix3<f64> {
        let theta = phi.norm();
        let (p, k) = (hat(rho), hat(phi));
        let kpk = k * p * k;
        let k2 = k * k;
        p * 0.5
            + (k * p + p * k + kpk) * theta_minus_sin_over_theta3(theta)
            + (k2 * p + p * k2 - kpk * 3.0) * cos_remainder_over_theta4(theta)
            + (kpk * k + k * kpk) * sin_cos_remainder_over_theta5(theta)
    }

    /// The homogeneous 4x4 matrix.
    #[must_use]
    pub fn matrix(&self) -> Matrix4<f64> {
        let mut m = Matrix4::identity();
        m.fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&self.rotation.matrix());
        m.fixed_view_mut::<3, 1>(0, 3).copy_from(&self.translation);
        m
    }

    /// Every number finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.translation.iter().all(|v| v.is_finite())
            && self.rotation.quaternion().iter().all(|v| v.is_finite())
    }
}

fn split(xi: &Vector6<f64>) -> (Vector3<f64>, Vector3<f64>) {
    (
        Vector3::new(xi[0], xi[1], xi[2]),
        Vector3::new(xi[3], xi[4], xi[5]),
    )
}

/// [a, b; 0, d].
fn blocks(a: &Matrix3<f64>, b: &Matrix3<f64>, d: &Matrix3<f64>) -> Matrix6<f64> {
    let mut m = Matrix6::zeros();
    m.fixed_view_mut::<3, 3>(0, 0).copy_from(a);
    m.fixed_view_mut::<3, 3>(0, 3).copy_from(b);
    m.fixed_view_mut::<3, 3>(3, 3).copy_from(d);
    m
}

impl std::ops::Mul for Se3 {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Self {
            rotation: self.rotation * other.rotation,
            translation: self.rotation * other.translation + self.translation,
        }
    }
}

impl std::ops::Mul<Vector3<f64>> for Se3 {
    type Output = Vector3<f64>;
    #[inline]
    fn mul(self, point: Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.translation
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::FRAC_PI_2;

    fn xi(v: [f64; 6]) -> Vector6<f64> {
        Vector6::from_row_slice(&v)
    }

    #[test]
    fn acts_on_points() {
        let turn = Se3::new(So3::exp(&(Vector3::z() * FRAC_PI_2)), Vector3::zeros());
        let shift = Se3::new(So3::identity(), Vector3::x());
        // shift after turn: y-axis point goes to -x, then +1
        let p = (shift * turn) * Vector3::y();
        assert!(p.norm() < 1e-15, "the right factor acts first: {p}");
    }

    #[test]
    fn tangent_order() {
        let moved = Se3::exp(&xi([1.0, 2.0, 3.0, 0.0, 0.0, 0.0]));
        assert_eq!(
            moved.translation,
            Vector3::new(1.0, 2.0, 3.0),
            "translation first"
        );
        assert_eq!(moved.rotation, So3::identity(), "no rotation");
    }

    #[test]
    fn quaternion_order() {
        let q = So3::exp(&(Vector3::x() * std::f64::consts::PI)).quaternion();
        assert!(
            q[0].abs() < 1e-16 && (q[1] - 1.0).abs() < 1e-16,
            "w first: {q:?}"
        );
    }

    proptest! {
        #[test]
        fn exp_and_log_undo_each_other(
            v in proptest::array::uniform6(-1.7f64..1.7)
        ) {
            let back = Se3::exp(&xi(v)).log();
            prop_assert!((back - xi(v)).norm() < 2e-14, "{back} against {v:?}");
        }

        #[test]
        fn inverse_cancels(v in proptest::array::uniform6(-3.0f64..3.0)) {
            let t = Se3::exp(&xi(v));
            let one = t * t.inverse();
            prop_assert!(one.log().norm() < 1e-14, "{one:?}");
        }

        #[test]
        fn adjoint_moves_to_the_left(
            v in proptest::array::uniform6(-2.0f64..2.0),
            d in proptest::array::uniform6(-0.5f64..0.5),
        ) {
            let t = Se3::exp(&xi(v));
            let right = t * Se3::exp(&xi(d));
            let left = Se3::exp(&(t.adjoint() * xi(d))) * t;
            prop_assert!((right * left.inverse()).log().norm() < 1e-13, "Ad");
        }

        #[test]
        fn left_jacobian_is_the_derivative(v in proptest::array::uniform6(-1.5f64..1.5)) {
            let base = Se3::exp(&xi(v)).inverse();
            let j = Se3::left_jacobian(&xi(v));
            let h = 1e-5;
            for i in 0..6 {
                let mut d = Vector6::zeros();
                d[i] = h;
                let plus = (Se3::exp(&(xi(v) + d)) * base).log();
                let minus = (Se3::exp(&(xi(v) - d)) * base).log();
                let column = (plus - minus) / (2.0 * h);
                prop_assert!((column - j.column(i)).norm() < 1e-9, "column {i}");
            }
            let one = j * Se3::left_jacobian_inverse(&xi(v));
            prop_assert!((one - Matrix6::identity()).norm() < 1e-13, "inverse");
        }
    }
}
