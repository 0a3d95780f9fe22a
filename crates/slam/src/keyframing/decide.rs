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
    use std::ops::Range;

    use garad_core::{DepthImage, LandmarkId};

    use super::*;
    use crate::config::Config;
    use crate::testing::World;

    fn config() -> Config {
        let mut config = Config::default();
        let k = &mut config.keyframes;
        (k.min_gap, k.max_gap, k.tracked_share, k.min_inliers) = (3, 12, 0.6, 20);
        (k.close_m, k.close_tracked_min, k.close_untracked_min) = (5.0, 90, 60);
        config
    }

    /// The last keyframe is frame 10. A frame of 300 keypoints on a wall at `depth_m`, the first
    /// `linked` of them tracked, these `unused` not in use.
    fn becomes(
        config: Config,
        frame: u32,
        (depth_m, linked, unused): (f32, usize, Range<usize>),
        inliers: usize,
        most: usize,
    ) -> bool {
        let mut world = World::new(config);
        let depth = DepthImage::new(160, 120, depth_m);
        let keyframe = world.frame(10, &depth);
        world.map.add_keyframe(keyframe);
        let mut now = world.frame(frame, &depth);
        for landmark in &mut now.landmark[..linked] {
            *landmark = Some(LandmarkId(0));
        }
        now.in_use[unused].fill(false);
        needs_keyframe(&world.context, &world.map, &now, inliers, most)
    }

    #[test]
    fn what_makes_a_keyframe() {
        let seen = || (2.0, 200, 0..0);
        let cases = [
            ("all is still seen", 15, seen(), 200, 200, false),
            ("60 % are left", 15, seen(), 120, 200, false),
            ("less", 15, seen(), 119, 200, true),
            ("less, but too soon", 12, seen(), 119, 200, false),
            ("the first frame that may", 13, seen(), 119, 200, true),
            (
                "89 near ones tracked, 61 new",
                15,
                (2.0, 89, 150..300),
                150,
                200,
                true,
            ),
            (
                "89 tracked, 60 new",
                15,
                (2.0, 89, 149..300),
                150,
                200,
                false,
            ),
            (
                "90 tracked, 61 new",
                15,
                (2.0, 90, 151..300),
                150,
                200,
                false,
            ),
            (
                "90 linked, one not in use",
                15,
                (2.0, 90, 0..1),
                150,
                200,
                true,
            ),
            ("just near", 15, (4.99, 89, 150..300), 150, 200, true),
            ("5 m are far", 15, (5.0, 89, 150..300), 150, 200, false),
            ("without depth", 15, (0.0, 89, 150..300), 150, 200, false),
            (
                "few near ones, but too soon",
                12,
                (2.0, 89, 150..300),
                150,
                200,
                false,
            ),
            ("eleven frames", 21, seen(), 200, 200, false),
            ("twelve frames", 22, seen(), 200, 200, true),
            (
                "twelve frames, just strong enough",
                22,
                seen(),
                20,
                20,
                true,
            ),
            ("twelve frames, too weak", 22, seen(), 19, 200, false),
        ];
        for (what, frame, keypoints, inliers, most, expected) in cases {
            let found = becomes(config(), frame, keypoints, inliers, most);
            assert_eq!(found, expected, "{what}");
        }
    }

    /// Without a least gap a frame still does not follow itself.
    #[test]
    fn the_least_gap_is_one_frame() {
        for (frame, expected) in [(10, false), (11, true)] {
            let mut config = config();
            config.keyframes.min_gap = 0;
            let found = becomes(config, frame, (2.0, 200, 0..0), 119, 200);
            assert_eq!(found, expected, "frame {frame}");
        }
    }

    /// Neither inliers nor keypoints nor the least gap count: there are none of them, or no such things.
    #[test]
    fn without_features_one_frame_in_so_many() {
        for (frame, inliers, max_gap, expected) in [
            (15, 119, 12, false),
            (21, 0, 12, false),
            (22, 0, 12, true),
            (22, 200, 13, false),
            (12, 0, 3, false),
            (13, 0, 3, true),
        ] {
            let mut config = config();
            config.tracking.method = TrackingMethod::Render;
            config.keyframes.max_gap = max_gap;
            let found = becomes(config, frame, (2.0, 89, 150..300), inliers, 200);
            assert_eq!(found, expected, "frame {frame}, one in {max_gap}");
        }
    }
}
