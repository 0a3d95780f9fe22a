//! The first pose of a frame: constant velocity, then the reference keyframe.

use garad_core::Se3;

use super::depth_pose::{MIN_SHARE_UNLABELLED, refine_pose_with_depth};
use super::matching;
use super::shutter::ShutterModel;
use crate::context::Context;
use crate::frame::Frame;
use crate::map::Map;
use crate::trace::Recorder;

/// First pose from the last frame's landmarks, searched where constant velocity predicts them.
/// `false` if too few are found.
pub(crate) fn track_motion(
    context: &Context,
    map: &Map,
    last: &Frame,
    velocity: &Se3,
    frame: &mut Frame,
    shutter: &ShutterModel,
    recorder: &mut Recorder,
) -> bool {
    let config = &context.config.tracking;
    let predicted = *velocity * last.camera_from_world;
    recorder.record("predict", |record| {
        record.predict(&last.camera_from_world, velocity, &predicted);
    });
    for factor in [1.0, 2.0] {
        frame.camera_from_world = predicted;
        frame.landmark.fill(None);
        let radius_px = factor * config.motion_radius_px;
        let matches = matching::from_last_frame(context, map, last, frame, radius_px);
        recorder.record("match_motion", |record| record.links(frame));
        if matches >= config.motion_min_matches {
            return first_pose(context, map, frame, shutter, recorder);
        }
    }
    false
}

/// First pose from the reference keyframe's landmarks, found by descriptor, starting at the last
/// pose. `false` if too few are found.
pub(crate) fn track_reference(
    context: &Context,
    map: &Map,
    last: &Frame,
    reference: &Frame,
    frame: &mut Frame,
    shutter: &ShutterModel,
    recorder: &mut Recorder,
) -> bool {
    frame.camera_from_world = last.camera_from_world;
    frame.landmark.fill(None);
    let matches = matching::from_keyframe(context, map, reference, frame);
    recorder.record("match_reference", |record| record.links(frame));
    matches >= context.config.tracking.reference_min_matches
        && first_pose(context, map, frame, shutter, recorder)
}

fn first_pose(
    context: &Context,
    map: &Map,
    frame: &mut Frame,
    shutter: &ShutterModel,
    recorder: &mut Recorder,
) -> bool {
    let inliers =
        refine_pose_with_depth(context, map, frame, MIN_SHARE_UNLABELLED, shutter, recorder);
    inliers >= context.config.tracking.motion_min_inliers
}
