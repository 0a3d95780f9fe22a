//! A keypoint as an observation of a point: its position, and its depth as a third residual.

use garad_optim::{DepthObservation, PoseObservation};
use nalgebra::{Matrix2, Vector2, Vector3};

use crate::config::{DepthResidual, TrackingConfig};
use crate::context::Context;
use crate::frame::Frame;
use crate::map::landmark::{Landmark, LandmarkDepth};

/// Keypoint i of a frame as an observation of its landmark. What is not known of a landmark from two views widens σ
/// by the larger axis of its image: σ² + λ_max(J Σ Jᵀ), J = ∂π/∂p.
pub(crate) fn link_observation(
    context: &Context,
    frame: &Frame,
    i: usize,
    landmark: &Landmark,
) -> PoseObservation {
    let seen = observation(&context.config.tracking, frame, i, landmark.p_world);
    let LandmarkDepth::Triangulated { covariance } = landmark.depth else {
        return seen;
    };
    let pose = &frame.camera_from_world;
    let p_cam = *pose * landmark.p_world;
    if p_cam.z <= 0.0 {
        return seen;
    }
    let j = context.camera.project_jacobian(&p_cam) * pose.rotation.matrix();
    let image: Matrix2<f64> = j * covariance * j.transpose();
    let (mean, half) = (0.5 * image.trace(), 0.5 * (image[(0, 0)] - image[(1, 1)]));
    let largest = mean + Vector2::new(half, image[(0, 1)]).norm();
    PoseObservation {
        sigma_px: (seen.sigma_px * seen.sigma_px + largest).sqrt(),
        ..seen
    }
}

/// Keypoint i of a frame as an observation of a point: its position with its σ, and its depth as
/// a disparity with a σ of its own (decision 004).
pub(crate) fn observation(
    config: &TrackingConfig,
    frame: &Frame,
    i: usize,
    p_world: Vector3<f64>,
) -> PoseObservation {
    let sigma_px = frame.sigma_px[i];
    let depth = frame.depth_m[i].and_then(|depth_m| {
        let disparity_px = config.bf / depth_m;
        match config.depth_residual {
            DepthResidual::Disparity => Some(DepthObservation::Disparity {
                disparity_px,
                sigma_px: config.disparity_sigma_px,
            }),
            DepthResidual::Right => Some(DepthObservation::Right {
                u_px: frame.uv_px[i].x - disparity_px,
                sigma_px,
            }),
            DepthResidual::None => None,
        }
    });
    PoseObservation {
        p_world,
        uv_px: frame.uv_px[i],
        sigma_px,
        depth,
    }
}
