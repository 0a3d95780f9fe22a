//! FAST, ORB, Hamming matching, pyramidal Lucas-Kanade, two-view geometry and the check of flow.
//!
//! Pictures in, points and correspondences out; nothing here knows of maps or Gaussians.
//! Reading order: [`fast9`] (corners) → [`orb`] (spread over the picture, turned, described) →
//! [`descriptor`], [`matching`] (which point is which), [`place`] (which picture shows the same) →
//! [`lk`] (where a point went) → [`epipolar`] (what two views allow) → [`flow`] (who moves as the
//! scene does).
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
