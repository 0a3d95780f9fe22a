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
