//! FAST, ORB, Hamming matching, pyramidal Lucas-Kanade, two-view geometry and the flow check.
//!
//! Images in, points and correspondences out; nothing here depends on maps or Gaussians.
//! Reading order: [`fast9`] (corners) → [`orb`] (spread over the image, oriented, described) →
//! [`descriptor`], [`matching`] (correspondences), [`place`] (place recognition) →
//! [`lk`] (optical flow) → [`epipolar`] (two-view geometry) → [`flow`] (eq. 9, 10: the flow check).
//!
//! Everything up to sub-pixel tracking is integer arithmetic with the definitions of OpenCV and
//! ORB-SLAM3, so that a port can be compared bit by bit.

pub mod descriptor;
pub mod epipolar;
pub mod error;
pub mod fast9;
pub mod flow;
pub mod lk;
pub mod matching;
pub mod orb;
pub mod place;

pub use descriptor::Descriptor;
pub use error::FeatureError;
pub use flow::{FlowConfig, FlowEstimator, FlowForm, FlowPoint, verify_flow};
pub use lk::{LkConfig, LkPyramid, LkStatus, LkTrack};
pub use matching::{Match, MatchConfig};
pub use orb::{Features, Keypoint, OrbConfig, OrbExtractor};
pub use place::{Candidate, PlaceConfig, PlaceIndex};
