//! The walk: positions of feet, hips and knees in each phase of a stride.
//!
//! A stride is one cycle of the gait: each foot stands still on the floor for [`STANCE`] of it and swings
//! forward for the rest, half a cycle after the other. The hips move at constant speed, so a standing foot
//! moves back in the frame of the figure exactly as fast as the figure moves forward, and does not slide.
//! Knees follow from hip and ankle (two bones of fixed length).

use std::f64::consts::{PI, TAU};

use nalgebra::Vector3;

/// Share of the cycle in which a foot is on the floor.
pub(crate) const STANCE: f64 = 0.6;
/// A standing foot travels from this far in front of the hip to as far behind it, metres.
pub(crate) const HALF_STEP_M: f64 = 0.28;
/// Distance of one cycle, metres.
pub(crate) const STRIDE_M: f64 = 2.0 * HALF_STEP_M / STANCE;
/// Height of the hips when both feet are on the floor, metres; they rise by [`LIFT_M`] over a standing leg.
pub(crate) const HIP_M: f64 = 0.88;
pub(crate) const LIFT_M: f64 = 0.04;
pub(crate) const ANKLE_M: f64 = 0.08;
pub(crate) const BONE_M: f64 = 0.43;

/// Ankle in the frame of the figure at cycle position p in [0, 1): (forward, height above standing).
pub(crate) fn ankle(p: f64) -> (f64, f64) {
    if p < STANCE {
        (HALF_STEP_M * (1.0 - 2.0 * p / STANCE), 0.0)
    } else {
        let s = (p - STANCE) / (1.0 - STANCE);
        // a cubic that leaves and lands with the speed of the floor
        let slope = -2.0 * HALF_STEP_M / STANCE * (1.0 - STANCE);
        let (s2, s3) = (s * s, s * s * s);
        let x = -HALF_STEP_M * (2.0 * s3 - 3.0 * s2 + 1.0)
            + HALF_STEP_M * (3.0 * s2 - 2.0 * s3)
            + slope * (2.0 * s3 - 3.0 * s2 + s);
        let up = libm::sin(PI * s);
        (x, 0.11 * up * up)
    }
}

/// Rise of the hips: largest in the middle of a stance.
pub(crate) fn lift(cycle: f64) -> f64 {
    LIFT_M * (0.5 + 0.5 * libm::cos(2.0 * TAU * (cycle - 0.5 * STANCE)))
}

/// The knee of a leg of two equal bones, bent forward.
pub(crate) fn knee(hip: &Vector3<f64>, ankle: &Vector3<f64>) -> Vector3<f64> {
    let half = 0.5 * (ankle - hip);
    let bend = (BONE_M * BONE_M - half.norm_squared()).max(0.0).sqrt();
    let across = half.cross(&Vector3::y()).normalize();
    hip + half + across * bend.copysign(across.x)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bones meet at the knee and the ankle: legs are long enough for the step.
    #[test]
    fn legs_are_long_enough() {
        for k in 0..200 {
            let p = f64::from(k) / 200.0;
            let (x, up) = ankle(p);
            let hip = Vector3::new(0.0, 0.09, HIP_M + lift(p));
            let foot = Vector3::new(x, 0.085, ANKLE_M + up);
            let knee = knee(&hip, &foot);
            assert!(((knee - hip).norm() - BONE_M).abs() < 1e-12, "thigh at {p}");
            assert!(((foot - knee).norm() - BONE_M).abs() < 1e-12, "shin at {p}");
            let middle = 0.5 * (hip + foot);
            assert!(knee.x >= middle.x, "knees bend forward, at {p}");
        }
    }

    /// A standing foot does not move while the figure does, and swings without a jump.
    #[test]
    fn feet_do_not_slide() {
        let h = 1e-5;
        for k in 0..1000 {
            let p = f64::from(k) / 1000.0;
            let ((x0, z0), (x1, z1)) = (ankle(p), ankle((p + h) % 1.0));
            let floor_speed = (x1 - x0) / h + STRIDE_M;
            if p + h < STANCE {
                assert!(floor_speed.abs() < 1e-6 && z0 <= 0.0, "slides at {p}");
            }
            assert!(
                (x1 - x0).abs() < 1e-4 && (z1 - z0).abs() < 1e-5,
                "jumps at {p}"
            );
        }
    }
}
