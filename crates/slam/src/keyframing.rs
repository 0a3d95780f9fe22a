//! Keyframes: when a frame becomes one, and what follows from it in the map of landmarks.
//!
//! | step | file |
//! |---|---|
//! | does the frame become a keyframe? | `decide` |
//! | observations, new landmarks, duplicates | `landmarks` |
//! | landmarks of keypoints without depth | `two_view` |
//! | poses and landmarks optimised together | `local_ba` |
//! | a revisited place | [`loop_closing`] |
//! | redundant keyframes | `culling` |

pub(crate) mod culling;
pub(crate) mod decide;
pub(crate) mod landmarks;
pub(crate) mod local_ba;
pub mod loop_closing;
pub(crate) mod two_view;

use garad_core::LandmarkId;
use serde::{Deserialize, Serialize};

use self::loop_closing::LoopCloser;

/// The state of keyframing.
#[derive(Debug, Default, Serialize, Deserialize)]
pub struct Keyframing {
    /// Landmarks still to be confirmed.
    pub(crate) recent: Vec<LandmarkId>,
    pub(crate) loops: LoopCloser,
    /// Most inliers of a frame since the last keyframe.
    pub(crate) most_inliers: usize,
}

#[cfg(test)]
mod tests {
    use garad_core::{DepthImage, Par};

    use crate::config::Config;
    use crate::pipeline::Slam;
    use crate::testing::World;

    /// The most inliers since the last keyframe, this frame's included, and none after one. Where nothing is
    /// added to the map no frame becomes a keyframe.
    #[test]
    fn the_most_inliers_are_counted_from_keyframe_to_keyframe() {
        let mut config = Config::default();
        let k = &mut config.keyframes;
        (k.min_gap, k.max_gap, k.tracked_share, k.min_inliers) = (2, 9, 0.5, 10);
        (k.close_tracked_min, k.close_untracked_min) = (0, 300);
        let world = World::new(config.clone());
        let depth = DepthImage::new(160, 120, 2.0);
        let mut slam = Slam::new(world.context.camera, config, 0, Par::Seq).expect("valid");
        for (id, inliers, becomes, most) in [
            (0, 70, true, 0), // there is none yet
            (1, 80, false, 80),
            (2, 60, false, 80),
            (3, 40, false, 80), // half of 80
            (4, 100, false, 100),
            (5, 49, true, 0),
            (6, 30, false, 30), // too soon, and the most
            (7, 30, false, 30),
            (8, 14, true, 0),
        ] {
            let frame = world.frame(id, &depth);
            assert_eq!(
                slam.becomes_keyframe(&frame, inliers),
                becomes,
                "frame {id}"
            );
            assert_eq!(slam.keyframing.most_inliers, most, "after frame {id}");
            if becomes {
                slam.map.add_keyframe(frame);
            }
        }
        slam.localising = true;
        assert!(
            !slam.becomes_keyframe(&world.frame(30, &depth), 50),
            "finished"
        );
        assert_eq!(slam.keyframing.most_inliers, 50, "counted all the same");
    }
}
