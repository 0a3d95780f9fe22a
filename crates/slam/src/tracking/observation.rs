//! A keypoint as an observation of a point: its position, and its depth as a third residual.

use garad_optim::{DepthObservation, PoseObservation};
use nalgebra::Vector3;

use crate::config::{DepthResidual, TrackingConfig};
use crate::frame::Frame;

/// Keypoint i of a frame as an observation of a point: its position with its σ, and its depth as
/// a disparity with a σ of its own (decision 004).
pub(crate) fn observation(
    config: &TrackingConfig,
    frame: &Frame,
    i: usize,
    p_world: Vector3<f64>,
) -> PoseObservation {
    let sigma_px = frame.sigma_px[i];
    let depth = frame.depth_m[i].map(|depth_m| {
        let disparity_px = config.bf / depth_m;
        match config.depth_residual {
            DepthResidual::Disparity => DepthObservation::Disparity {
                disparity_px,
                sigma_px: config.disparity_sigma_px,
            },
            DepthResidual::Right => DepthObservation::Right {
                u_px: frame.uv_px[i].x - disparity_px,
                sigma_px,
            },
        }
    });
    PoseObservation {
        p_world,
        uv_px: frame.uv_px[i],
        sigma_px,
        depth,
    }
}
