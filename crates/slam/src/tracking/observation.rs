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

#[cfg(test)]
mod tests {
    use garad_core::{KeyframeId, Se3, So3};
    use nalgebra::Matrix3;

    use super::*;
    use crate::config::Config;
    use crate::testing::{World, uneven_camera};

    /// bf = 36 px·m.
    fn world(depth_residual: DepthResidual) -> World {
        let mut config = Config::default();
        let t = &mut config.tracking;
        (t.bf, t.disparity_sigma_px, t.depth_residual) = (36.0, 0.3, depth_residual);
        World::with_camera(uneven_camera(), config)
    }

    /// 1.5 m are 36 / 1.5 = 24 px of disparity.
    #[test]
    fn depth_as_a_third_residual() {
        let p_world = Vector3::new(0.1, 0.2, 2.0);
        let disparity = DepthObservation::Disparity {
            disparity_px: 24.0,
            sigma_px: 0.3,
        };
        let right = DepthObservation::Right {
            u_px: 26.5,
            sigma_px: 1.44,
        };
        for (kind, depth_m, depth) in [
            (DepthResidual::Disparity, Some(1.5), Some(disparity)),
            (DepthResidual::Right, Some(1.5), Some(right)),
            (DepthResidual::None, Some(1.5), None),
            (DepthResidual::Disparity, None, None),
        ] {
            let world = world(kind);
            let mut frame = world.see(0, &[p_world, p_world], &Se3::identity());
            frame.uv_px[1] = Vector2::new(50.5, 70.25);
            (frame.sigma_px[1], frame.depth_m[1]) = (1.44, depth_m);
            let expected = PoseObservation {
                p_world,
                uv_px: frame.uv_px[1],
                sigma_px: 1.44,
                depth,
            };
            let found = observation(&world.context.config.tracking, &frame, 1, p_world);
            assert_eq!(found, expected, "{kind:?}, {depth_m:?}");
        }
    }

    /// A point 2 m ahead of a camera rolled by 90°: world x is camera y, world y is camera -x.
    /// Image of Σ: [[55² b, -55·65 c], [., 65² a]] of a = Σxx, b = Σyy, c = Σxy.
    #[test]
    fn an_uncertain_landmark_widens_the_sigma() {
        let mut world = world(DepthResidual::Disparity);
        let roll = So3::exp(&Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2));
        let pose = Se3::new(roll, Vector3::new(0.25, -0.5, 0.5));
        let p_world = pose.inverse() * Vector3::new(0.0, 0.0, 2.0);
        let mut frame = world.see(0, &[p_world], &pose);
        frame.camera_from_world = pose;
        frame.sigma_px[0] = 1.2;
        let id = world.remember(frame.clone(), &[p_world])[0];
        let (a, b) = (4e-4, 9e-4);
        let of = |c: f64| Matrix3::new(a, c, 0.0, c, b, 0.0, 0.0, 0.0, 0.25);
        let triangulated = |c| LandmarkDepth::Triangulated { covariance: of(c) };
        let since = KeyframeId(0);
        let behind = Se3::new(roll, Vector3::new(0.25, -0.5, -5.0));
        for (what, depth, pose, sigma2) in [
            ("measured", LandmarkDepth::Measured { since }, pose, 1.44),
            ("along the axes", triangulated(0.0), pose, 1.44 + 2.7225),
            // λ = 2.20625 + √(0.51625² + 1.0725²)
            ("askew", triangulated(3e-4), pose, 1.44 + 3.396_532_4),
            ("behind the camera", triangulated(3e-4), behind, 1.44),
        ] {
            world.map.landmark_mut(id).expect("made").depth = depth;
            frame.camera_from_world = pose;
            let landmark = world.map.landmark(id).expect("made");
            let found = link_observation(&world.context, &frame, 0, landmark);
            let off = (found.sigma_px * found.sigma_px - sigma2).abs();
            assert!(off < 1e-6, "{what}: σ² = {sigma2}, off by {off}");
            assert_eq!(
                (found.p_world, found.uv_px),
                (p_world, frame.uv_px[0]),
                "{what}"
            );
        }
    }
}
