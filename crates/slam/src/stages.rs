//! Steps of the pipeline that can be stated without the rest of it, for the golden cases of the same names
//! (`garad-conformance`) and for whoever ports one of them.
//!
//! | stage | functions |
//! |---|---|
//! | `free_space` | [`FreeSpace::query`], [`FreeSpaceHistory::query`] |
//! | `cues` | [`landmark_cues`] |
//! | `landmark_links` | [`from_last_frame`], [`from_local_map`] |
//! | `keyframe` | [`needs_keyframe`] |
//! | `relabel` | [`relabel`] |
//! | `image_pyramid` | [`Target::new`], [`level_of_iteration`] |
//! | `densify` | [`Densifier`], [`densify_with`], [`too_large`], [`faded`] |

pub use crate::dynamics::cues::landmark_cues;
pub use crate::dynamics::evidence::{DepthEvidence, FreeSpaceHistory, HistoryView};
pub use crate::dynamics::free_space::{FreeSpace, Visibility};
pub use crate::dynamics::landmarks::LandmarkLabel;
pub use crate::keyframing::decide::needs_keyframe;
pub use crate::mapping::coarse_to_fine::level_of_iteration;
pub use crate::mapping::densify::{Densifier, densify_with, faded, too_large};
pub use crate::mapping::relabel::relabel;
pub use crate::mapping::view::Target;
pub use crate::tracking::matching::{from_last_frame, from_local_map};
