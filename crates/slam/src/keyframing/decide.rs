//! When a frame becomes a keyframe (decision 016).
//!
//! ORB-SLAM compares a frame's inliers with the landmarks of its reference keyframe. How many of
//! those are found again depends on the sensor, the room and the exposure as much as on the camera's
//! motion: where the detector repeats itself badly, nearly every frame became a keyframe. What counts
//! is how much of what was tracked since the last keyframe has been lost.

use crate::context::Context;
use crate::frame::Frame;
use crate::map::Map;

/// Whether a tracked frame becomes a keyframe; `most_inliers`: of any frame since the last one, this
/// one included. Mapping counts as always ready: its schedule is fixed by frame numbers, so there is no
/// queue to ask.
pub(crate) fn needs_keyframe(
    context: &Context,
    map: &Map,
    frame: &Frame,
    inliers: usize,
    most_inliers: usize,
) -> bool {
    let config = &context.config.keyframes;
    let since_last = frame.id.0 - map.last_keyframe_frame().0;
    let gap = usize::try_from(since_last).unwrap_or(usize::MAX);
    if gap < config.min_gap.max(1) || inliers < config.min_inliers {
        return false;
    }
    let close = |i: &usize| frame.depth_m[*i].is_some_and(|d| d < config.close_m);
    let (tracked, untracked): (Vec<_>, Vec<_>) = (0..frame.len())
        .filter(close)
        .filter(|&i| frame.in_use[i])
        .partition(|&i| frame.landmark[i].is_some());
    let need_close =
        tracked.len() < config.close_tracked_min && untracked.len() > config.close_untracked_min;
    let lost_sight = (inliers as f64) < config.tracked_share * most_inliers as f64;
    lost_sight || need_close || gap >= config.max_gap
}
