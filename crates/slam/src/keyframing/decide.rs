//! When a frame becomes a keyframe: ORB-SLAM's RGB-D rules.

use garad_core::KeyframeId;

use crate::context::Context;
use crate::frame::Frame;
use crate::map::Map;

/// Whether a tracked frame becomes a keyframe. Mapping counts as always ready: its schedule is fixed
/// by frame numbers, so there is no queue to ask.
pub(crate) fn needs_keyframe(
    context: &Context,
    map: &Map,
    reference: KeyframeId,
    frame: &Frame,
    inliers: usize,
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
    let confirmed = confirmed_landmarks(map, reference);
    let few = (inliers as f64) < config.ref_ratio * confirmed as f64;
    few || need_close || gap >= config.max_gap
}

/// Landmarks of a keyframe that at least two keyframes observe (one, while there are no more than
/// two keyframes).
fn confirmed_landmarks(map: &Map, keyframe: KeyframeId) -> usize {
    let needed = match map.keyframes().len() {
        0..=2 => 1,
        _ => 2,
    };
    let landmarks = map.keyframe(keyframe).landmark.iter().flatten();
    landmarks
        .filter_map(|l| map.landmark(*l))
        .filter(|l| l.observations.len() >= needed)
        .count()
}
