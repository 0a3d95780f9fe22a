//! The motion that maps one list of points onto another: Horn's closed form.
//!
//! The world of an estimate is usually the frame of the first camera. Before positions can be compared,
//! it is aligned with the world of the ground truth.

use garad_core::{Se3, So3, StampedPose};
use nalgebra::{Matrix3, Matrix4, SymmetricEigen, Vector3, Vector4};
use serde::{Deserialize, Serialize};

use crate::EvalError;

/// Alignment before positions are compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Alignment {
    /// None: both trajectories already share a world.
    None,
    /// Rotation and translation. For RGB-D, where depth fixes the scale.
    #[default]
    Rigid,
    /// Rotation, translation and scale. For monocular systems; too favourable for RGB-D.
    Similarity,
}

/// A similarity x ↦ s R x + t.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sim3 {
    /// s.
    pub scale: f64,
    /// R.
    pub rotation: So3,
    /// t, metres.
    pub translation: Vector3<f64>,
}

impl Sim3 {
    /// No motion, scale 1.
    #[must_use]
    pub fn identity() -> Self {
        Self {
            scale: 1.0,
            rotation: So3::identity(),
            translation: Vector3::zeros(),
        }
    }

    /// The pose of a camera in the transformed world: R and t compose, the position is scaled.
    #[must_use]
    pub fn move_pose(&self, world_from_camera: &Se3) -> Se3 {
        Se3::new(
            self.rotation * world_from_camera.rotation,
            *self * world_from_camera.translation,
        )
    }
}

impl std::ops::Mul<Vector3<f64>> for Sim3 {
    type Output = Vector3<f64>;
    fn mul(self, point: Vector3<f64>) -> Vector3<f64> {
        self.rotation * point * self.scale + self.translation
    }
}

/// Every pose of `trajectory` in the aligned world.
#[must_use]
pub fn align_trajectory(aligned_from_world: &Sim3, trajectory: &[StampedPose]) -> Vec<StampedPose> {
    let moved = |pose: &StampedPose| StampedPose {
        t_s: pose.t_s,
        world_from_camera: aligned_from_world.move_pose(&pose.world_from_camera),
    };
    trajectory.iter().map(moved).collect()
}

/// The rotation, translation and (for [`Alignment::Similarity`]) scale that minimise
///
/// Σ |toᵢ - (s R fromᵢ + t)|²
///
/// With both lists centred, R = q(v): v the eigenvector of the largest eigenvalue λ of the 4x4
/// matrix N(Σ fromᵢ toᵢᵀ), for which vᵀ N v = Σ toᵢ · R(v) fromᵢ. Then s = λ / Σ|fromᵢ|² and
/// t = mean(to) - s R mean(from).
///
/// Every unit quaternion is a proper rotation, so reflections cannot occur, and coplanar points are well
/// conditioned. Collinear points leave the rotation about their line undetermined, coincident points the
/// whole rotation: of the optimal rotations the one nearest to the identity is returned; the residual is
/// the same for all.
///
/// Source: Horn 1987, "Closed-form solution of absolute orientation using unit quaternions";
/// the minimum is that of Umeyama 1991. Golden: `trajectory/umeyama_*`.
///
/// # Errors
/// [`EvalError::SizeMismatch`] for lists of unequal length, [`EvalError::TooFew`] below 3
/// points, [`EvalError::NonFinite`], [`EvalError::ScaleUndetermined`] where λ is nothing beside
/// √(Σ|fromᵢ|² Σ|toᵢ|²): a list of equal points, or lists without any correlation.
pub fn align_points(
    from: &[Vector3<f64>],
    to: &[Vector3<f64>],
    alignment: Alignment,
) -> Result<Sim3, EvalError> {
    if from.len() != to.len() {
        return Err(EvalError::SizeMismatch {
            what: "points to align",
            expected: (from.len(), 1),
            got: (to.len(), 1),
        });
    }
    let finite = |p: &Vector3<f64>| p.iter().all(|v| v.is_finite());
    if let Some(index) = (0..from.len()).find(|&i| !finite(&from[i]) || !finite(&to[i])) {
        return Err(EvalError::NonFinite {
            what: "point",
            index,
        });
    }
    if alignment == Alignment::None {
        return Ok(Sim3::identity());
    }
    if from.len() < 3 {
        return Err(EvalError::TooFew {
            what: "points",
            got: from.len(),
            needed: 3,
        });
    }

    let (from, mean_from) = centred(from);
    let (to, mean_to) = centred(to);
    let mut correlation = Matrix3::zeros(); // Σ from toᵀ
    let [mut from2, mut to2] = [0.0; 2]; // Σ |from|², Σ |to|²
    for (f, t) in from.iter().zip(&to) {
        correlation += f * t.transpose();
        from2 += f.norm_squared();
        to2 += t.norm_squared();
    }
    let rotation = best_rotation(&correlation);
    let scale = match alignment {
        Alignment::Similarity => {
            let pairs = from.iter().zip(&to);
            let along = pairs.fold(0.0, |sum, (f, t)| sum + t.dot(&(rotation * *f)));
            if along <= NO_CORRELATION * (from2 * to2).sqrt() {
                return Err(EvalError::ScaleUndetermined);
            }
            along / from2
        }
        Alignment::None | Alignment::Rigid => 1.0,
    };
    Ok(Sim3 {
        scale,
        rotation,
        translation: mean_to - rotation * mean_from * scale,
    })
}

/// The points about their mean, and the mean. What remains of equal points is exactly zero.
fn centred(points: &[Vector3<f64>]) -> (Vec<Vector3<f64>>, Vector3<f64>) {
    // Summed about the first point: a world far from its origin loses no digits.
    let first = points[0];
    let sum = points
        .iter()
        .fold(Vector3::zeros(), |sum, p| sum + (p - first));
    let mean_about_first = sum / points.len() as f64;
    let about_mean = |p: &Vector3<f64>| (p - first) - mean_about_first;
    (
        points.iter().map(about_mean).collect(),
        first + mean_about_first,
    )
}

/// Correlation of two lists of points below which one says nothing about the scale of the other.
const NO_CORRELATION: f64 = 1e-9;

/// Eigenvalues closer than this, relative to the largest, count as equal: that rotation is then
/// undetermined. This is so when the extent of the points across a line is 1e-6 of that along it.
const SAME_EIGENVALUE: f64 = 1e-12;

/// argmax over R of Σ to · R from = tr(R M), M = Σ from toᵀ.
#[rustfmt::skip]
fn best_rotation(m: &Matrix3<f64>) -> So3 {
    let [xx, xy, xz] = [m[(0, 0)], m[(0, 1)], m[(0, 2)]];
    let [yx, yy, yz] = [m[(1, 0)], m[(1, 1)], m[(1, 2)]];
    let [zx, zy, zz] = [m[(2, 0)], m[(2, 1)], m[(2, 2)]];
    let n = Matrix4::new(
        xx + yy + zz, yz - zy,      zx - xz,      xy - yx,
        yz - zy,      xx - yy - zz, xy + yx,      zx + xz,
        zx - xz,      xy + yx,      yy - xx - zz, yz + zy,
        xy - yx,      zx + xz,      yz + zy,      zz - xx - yy,
    );
    let eigen = SymmetricEigen::new(n);
    let largest = eigen.eigenvalues.max();
    // The identity, projected onto the eigenspace of the largest eigenvalue.
    let mut nearest = Vector4::zeros();
    let mut any = Vector4::zeros();
    for (value, v) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
        if *value >= largest - SAME_EIGENVALUE * largest.abs() {
            nearest += v * v[0];
            any = v.into_owned();
        }
    }
    // Half turns are orthogonal to the identity: all of them are equally near.
    let q = if nearest.norm() > SAME_EIGENVALUE { nearest } else { any };
    So3::from_quaternion(q[0], q[1], q[2], q[3]).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    fn cloud(seed: u64, n: usize, stretch: [f64; 3]) -> Vec<Vector3<f64>> {
        let mut rng = garad_core::Rng::keyed(seed, &[1]);
        let mut point = || Vector3::from(stretch.map(|s| s * rng.normal()));
        (0..n).map(|_| point()).collect()
    }

    fn cost(sim3: &Sim3, from: &[Vector3<f64>], to: &[Vector3<f64>]) -> f64 {
        let squares = from
            .iter()
            .zip(to)
            .map(|(f, t)| (t - *sim3 * *f).norm_squared());
        squares.fold(0.0, |sum, e| sum + e)
    }

    #[test]
    fn a_quarter_turn_by_hand() {
        let from = [Vector3::zeros(), Vector3::x(), Vector3::y(), Vector3::z()];
        let to = from.map(|p| Vector3::new(1.0 - 2.0 * p.y, 2.0 * p.x, 2.0 * p.z));
        let sim3 = align_points(&from, &to, Alignment::Similarity).expect("four points");
        assert!((sim3.scale - 2.0).abs() < 1e-15, "scale {}", sim3.scale);
        let turn = sim3.rotation.log() - Vector3::z() * (0.5 * PI);
        assert!(turn.norm() < 1e-15, "rotation {turn}");
        let shift = sim3.translation - Vector3::x();
        assert!(shift.norm() < 1e-15, "translation {shift}");
    }

    /// A mirrored cloud: the best proper rotation, never the mirror.
    #[test]
    fn a_mirror_is_not_a_rotation() {
        let from = cloud(3, 40, [1.0, 0.8, 0.3]);
        let to: Vec<_> = from.iter().map(|p| Vector3::new(p.x, p.y, -p.z)).collect();
        let sim3 = align_points(&from, &to, Alignment::Rigid).expect("40 points");
        assert!(
            (sim3.rotation.matrix().determinant() - 1.0).abs() < 1e-14,
            "proper"
        );
        // A small turn away from the optimum costs more.
        let optimum = cost(&sim3, &from, &to);
        for axis in [Vector3::x(), Vector3::y(), Vector3::z()] {
            for angle in [-1e-3, 1e-3] {
                let mean = from.iter().fold(Vector3::zeros(), |sum, p| sum + p) / 40.0;
                let mean_to = Vector3::new(mean.x, mean.y, -mean.z);
                let rotation = So3::exp(&(axis * angle)) * sim3.rotation;
                let other = Sim3 {
                    rotation,
                    translation: mean_to - rotation * mean,
                    ..sim3
                };
                assert!(cost(&other, &from, &to) > optimum, "axis {axis}");
            }
        }
    }

    #[test]
    fn collinear_points_take_the_smallest_rotation() {
        let from: Vec<_> = (0..5).map(|i| Vector3::x() * f64::from(i)).collect();
        let to: Vec<_> = from.iter().map(|p| Vector3::new(1.0, p.x, 0.0)).collect();
        let sim3 = align_points(&from, &to, Alignment::Rigid).expect("five points");
        assert!(cost(&sim3, &from, &to) < 1e-28, "the line is met");
        let turn = sim3.rotation.log() - Vector3::z() * (0.5 * PI);
        assert!(turn.norm() < 1e-12, "shortest turn, {turn}");

        let back: Vec<_> = from.iter().map(|p| -p).collect();
        let sim3 = align_points(&from, &back, Alignment::Rigid).expect("five points");
        assert!(cost(&sim3, &from, &back) < 1e-28, "a half turn is found");
    }

    #[test]
    fn coincident_points_are_not_rotated() {
        let from = vec![Vector3::new(0.1, 0.2, 0.3); 7];
        let to = cloud(5, 7, [1.0, 1.0, 1.0]);
        let sim3 = align_points(&from, &to, Alignment::Rigid).expect("seven points");
        assert_eq!(sim3.rotation, So3::identity(), "no turn");
        let similarity = align_points(&from, &to, Alignment::Similarity);
        assert_eq!(similarity, Err(EvalError::ScaleUndetermined), "no scale");
        let at_rest = align_points(&to, &from, Alignment::Similarity);
        assert_eq!(
            at_rest,
            Err(EvalError::ScaleUndetermined),
            "the reference rests"
        );
    }

    #[test]
    fn bad_input_is_reported() {
        let two = cloud(1, 2, [1.0; 3]);
        let error = align_points(&two, &two, Alignment::Rigid).expect_err("two points");
        assert_eq!(
            error,
            EvalError::TooFew {
                what: "points",
                got: 2,
                needed: 3
            },
            "few"
        );
        let error = align_points(&two, &two[..1], Alignment::Rigid).expect_err("uneven");
        assert!(matches!(error, EvalError::SizeMismatch { .. }), "{error}");
        let mut bad = cloud(1, 4, [1.0; 3]);
        bad[2].y = f64::INFINITY;
        let error = align_points(&bad, &bad, Alignment::Rigid).expect_err("infinite");
        assert!(
            matches!(error, EvalError::NonFinite { index: 2, .. }),
            "{error}"
        );
    }

    proptest! {
        /// Any similarity is found again, from clouds as flat as a plane.
        #[test]
        fn recovers_what_was_done(
            xi in proptest::array::uniform6(-3.0f64..3.0),
            scale in 0.2f64..5.0,
            flat in prop_oneof![Just(1.0), Just(1e-3), Just(0.0)],
            seed in 0u64..1000,
        ) {
            let motion = Se3::exp(&xi.into());
            let done = Sim3 { scale, rotation: motion.rotation, translation: motion.translation };
            let from = cloud(seed, 30, [1.0, 0.5, flat]);
            let to: Vec<_> = from.iter().map(|p| done * *p).collect();
            let found = align_points(&from, &to, Alignment::Similarity).expect("30 points");
            let turn = (found.rotation * done.rotation.inverse()).log().norm();
            prop_assert!(turn < 2e-14, "rotation off by {turn}");
            prop_assert!((found.scale / scale - 1.0).abs() < 1e-13, "scale {}", found.scale);
            let shift = (found.translation - done.translation).norm();
            prop_assert!(shift < 1e-12, "translation off by {shift}");
        }
    }
}
