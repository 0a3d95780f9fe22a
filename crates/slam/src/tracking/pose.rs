//! The pose of a frame from its links to static landmarks (eq. 11).

use garad_optim::{CentrePrior, PoseConfig, optimise_pose};

use super::observation::link_observation;
use crate::context::Context;
use crate::frame::{Frame, PoseInformation};
use crate::map::Map;
use crate::trace::Recorder;

/// Links without which no pose is computed.
const MIN_LINKS: usize = 3;

/// Optimises the frame's pose over its links to static landmarks (eq. 11, solved by
/// [`optimise_pose`]) and unlinks the outliers. Returns the number of inliers; 0 leaves the pose as
/// it was.
pub(crate) fn pose_from_links(
    context: &Context,
    map: &Map,
    frame: &mut Frame,
    recorder: &mut Recorder,
) -> usize {
    let mut keypoints = Vec::new();
    let mut observations = Vec::new();
    for i in 0..frame.len() {
        let Some(landmark) = frame.landmark[i].and_then(|l| map.static_landmark(l)) else {
            frame.landmark[i] = None;
            continue;
        };
        debug_assert!(frame.in_use[i], "only keypoints in use are linked");
        keypoints.push(i);
        observations.push(link_observation(context, frame, i, landmark));
    }
    if observations.len() < MIN_LINKS {
        return 0;
    }
    let before = frame.camera_from_world;
    let prior = centre_prior(frame);
    let solution = optimise_pose(
        &context.camera,
        &observations,
        &before,
        &PoseConfig {
            prior,
            ..pose_config(context)
        },
    )
    .expect("at least three observations, of finite numbers");
    if !solution.camera_from_world.is_finite() {
        return 0;
    }
    recorder.record("pose", |record| {
        record.pose_lm(
            &keypoints,
            &observations,
            &before,
            prior.as_ref(),
            &solution,
        );
    });
    frame.camera_from_world = solution.camera_from_world;
    frame.information = PoseInformation {
        matrix: solution.information,
        links: solution.n_inliers,
    };
    for (&i, inlier) in keypoints.iter().zip(&solution.inlier) {
        if !inlier {
            frame.landmark[i] = None;
        }
    }
    solution.n_inliers
}

/// What the camera's motion so far says of the frame's centre.
pub(crate) fn centre_prior(frame: &Frame) -> Option<CentrePrior> {
    let expected = frame.expected?;
    Some(CentrePrior {
        centre_m: expected.centre_m,
        root_information: expected.information.cholesky()?.l(),
    })
}

/// The settings of eq. 11's solver.
pub(crate) fn pose_config(context: &Context) -> PoseConfig {
    PoseConfig {
        bf: context.config.tracking.bf,
        ..PoseConfig::default()
    }
}
