//! When a frame becomes a keyframe (decision 016).
//!
//! ORB-SLAM compares a frame's inliers with the landmarks of its reference keyframe. How many of
//! those are found again depends on the sensor, the room and the exposure as much as on the camera's
//! motion: where the detector repeats itself badly, nearly every frame became a keyframe. What counts
//! is how much of what was tracked since the last keyframe has been lost.

use crate::config::TrackingMethod;
use crate::context::Context;
use crate::frame::Frame;
use crate::map::Map;

/// Whether a tracked frame becomes a keyframe; `most_inliers`: of any frame since the last one, this
/// one included. Mapping counts as always ready: its schedule is fixed by frame numbers, so there is no
/// queue to ask. Without features (tracking by rendering) it is one frame in `max_gap`.
#[must_use]
pub fn needs_keyframe(
    context: &Context,
    map: &Map,
    frame: &Frame,
    inliers: usize,
    most_inliers: usize,
) -> bool {
    let config = &context.config.keyframes;
    let since_last = frame.id.0 - map.last_keyframe_frame().0;
    let gap = usize::try_from(since_last).unwrap_or(usize::MAX);
    if context.config.tracking.method == TrackingMethod::Render {
        return gap >= config.max_gap;
    }
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

#[cfg(test)]
mod tests {
    use garad_core::{DepthImage, LandmarkId};

    use super::*;
    use crate::config::Config;
    use crate::testing::World;

    /// The last keyframe is frame 10. A frame of 300 keypoints on a wall at `depth_m`, the first
    /// `linked` of them tracked.
    fn becomes(frame: u32, depth_m: f32, linked: usize, inliers: usize, most: usize) -> bool {
        let mut config = Config::default();
        let k = &mut config.keyframes;
        (k.min_gap, k.max_gap, k.tracked_share, k.min_inliers) = (3, 10, 0.6, 20);
        (k.close_m, k.close_tracked_min, k.close_untracked_min) = (6.0, 100, 70);
        let mut world = World::new(config);
        let depth = DepthImage::new(160, 120, depth_m);
        let keyframe = world.frame(10, &depth);
        world.map.add_keyframe(keyframe);
        let mut now = world.frame(frame, &depth);
        for landmark in &mut now.landmark[..linked] {
            *landmark = Some(LandmarkId(0));
        }
        needs_keyframe(&world.context, &world.map, &now, inliers, most)
    }

    #[test]
    fn what_makes_a_keyframe() {
        let cases = [
            ("all is still seen", 15, 2.0, 200, 200, 200, false),
            ("60 % are left", 15, 2.0, 120, 120, 200, false),
            ("less", 15, 2.0, 119, 119, 200, true),
            ("less, but too soon", 12, 2.0, 119, 119, 200, false),
            ("the first frame that may", 13, 2.0, 119, 119, 200, true),
            (
                "few near points are tracked, many are new",
                15,
                2.0,
                99,
                150,
                200,
                true,
            ),
            ("the same, but they are far", 15, 7.0, 99, 150, 200, false),
            ("nine frames", 19, 2.0, 200, 200, 200, false),
            ("ten frames", 20, 2.0, 200, 200, 200, true),
            ("ten frames, too weak", 20, 2.0, 200, 19, 200, false),
        ];
        for (what, frame, depth_m, linked, inliers, most, expected) in cases {
            let found = becomes(frame, depth_m, linked, inliers, most);
            assert_eq!(found, expected, "{what}");
        }
    }
}
