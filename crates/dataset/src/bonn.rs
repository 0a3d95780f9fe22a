//! BONN RGB-D Dynamic: from poses of the marker body to poses of the camera.
//!
//! `groundtruth.txt` of that data set holds poses of a motion-capture body on the sensor, in other
//! axes. The data set publishes the transformation to the camera:
//!
//! world_from_camera = A · T · A · T_m,   A (x, y, z) = (-x, z, y),
//!
//! with T a pose from the file. Results on BONN are usually published against the raw file; the
//! two differ by up to 2 cm, as the camera turns about the body.
//!
//! The 3x3 block of T_m is a rotation times 1.0593. A rigid motion has no scale, so the block is
//! replaced by the nearest rotation. Depth then agrees with these poses if raw depth
//! is divided by 5000 / 1.0593 = 4720.1 instead of 5000.

use garad_core::{Se3, So3, StampedPose};
use nalgebra::{Matrix3, Vector3};

/// T_m as published: rotation times 1.0593 | translation, metres.
#[rustfmt::skip]
const BODY_FROM_CAMERA: ([f64; 9], [f64; 3]) = (
    [
        1.0157,  0.1828, -0.2389,
        0.0009, -0.8431, -0.6413,
       -0.3009,  0.6147, -0.8085,
    ],
    [0.0113, -0.0098, 0.0111],
);
/// A: x to -x, y and z exchanged.
#[rustfmt::skip]
const AXES: [f64; 9] = [
    -1.0, 0.0, 0.0,
     0.0, 0.0, 1.0,
     0.0, 1.0, 0.0,
];

/// Camera poses from raw BONN ground truth, by the [module's formula](self).
///
/// # Shapes and units
/// Metres, seconds; times stay as they are.
/// # Numerics
/// f64. The nearest rotation to T_m's block comes from Newton's iteration, to a few 1e-16.
///
/// Source: ReFusion's data set page (Palazzolo et al., IROS 2019). Golden: `bonn/*`.
#[must_use]
pub fn bonn_camera_from_marker(raw: &[StampedPose]) -> Vec<StampedPose> {
    let axes = Se3::new(
        So3::from_matrix(&Matrix3::from_row_slice(&AXES)),
        Vector3::zeros(),
    );
    let (block, translation) = BODY_FROM_CAMERA;
    let body_from_camera = Se3::new(
        So3::from_matrix(&nearest_rotation(&Matrix3::from_row_slice(&block))),
        Vector3::from(translation),
    );
    let after = axes * body_from_camera;
    raw.iter()
        .map(|pose| StampedPose {
            t_s: pose.t_s,
            world_from_camera: axes * pose.world_from_camera * after,
        })
        .collect()
}

/// The rotation nearest to a matrix of positive determinant (its polar factor), by Newton's
/// iteration X ← ½ (X + X⁻ᵀ), which squares the error in each step (Higham 1986).
///
/// A matrix without an inverse is returned as it is.
fn nearest_rotation(m: &Matrix3<f64>) -> Matrix3<f64> {
    const STEPS: usize = 20;
    let mut x = *m;
    for _ in 0..STEPS {
        let Some(inverse) = x.try_inverse() else {
            return x;
        };
        x = (x + inverse.transpose()) * 0.5;
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearest_rotation_is_a_rotation_and_keeps_rotations() {
        let block = Matrix3::from_row_slice(&BODY_FROM_CAMERA.0);
        let r = nearest_rotation(&block);
        assert!(
            (r * r.transpose() - Matrix3::identity()).norm() < 1e-14,
            "orthonormal"
        );
        assert!((nearest_rotation(&r) - r).norm() < 1e-15, "a fixed point");
        // Scaling changes nothing, and the scale is the one the data set's users measured.
        assert!(
            (nearest_rotation(&(block * 3.0)) - r).norm() < 1e-14,
            "no scale"
        );
        let scale = (block.transpose() * r).trace() / 3.0;
        assert!((scale - 1.0593).abs() < 1e-4, "scale {scale}");
    }

    #[test]
    fn distances_are_kept_except_for_the_lever_arm() {
        let turn = |angle: f64| StampedPose {
            t_s: angle,
            world_from_camera: Se3::new(So3::exp(&Vector3::new(0.0, angle, 0.0)), Vector3::zeros()),
        };
        let moved = bonn_camera_from_marker(&[turn(0.0), turn(std::f64::consts::PI)]);
        let distance = (moved[0].world_from_camera.translation
            - moved[1].world_from_camera.translation)
            .norm();
        // Half a turn about y swings the camera to twice its distance from that axis. The axis
        // is y of the body; A takes the camera's place on the body (x, y, z) to (-x, z, y).
        let [x, y, _] = BODY_FROM_CAMERA.1;
        let lever = 2.0 * nalgebra::Vector2::new(x, y).norm();
        assert!(
            (distance - lever).abs() < 1e-12,
            "{distance} against {lever}"
        );
        assert!(
            bonn_camera_from_marker(&[]).is_empty(),
            "nothing in, nothing out"
        );
    }
}
