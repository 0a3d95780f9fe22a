//! The GARAD-SLAM pipeline: the only place that knows the order of stages.
//!
//! Frames go in one by one through [`Slam::process`]; out come the camera's path
//! ([`Slam::trajectory`]), the landmarks and keyframes behind it, and a map of Gaussians
//! ([`Slam::gaussians`]). Nothing here reads files, clocks or terminals: pictures come as
//! arguments, timings leave through an [`Observer`].
//!
//! Reading order, one frame's way through the code:
//! [`frame`] (features, ideal pixels, depth at keypoints) → [`matching`] (landmarks found again)
//! → [`tracker`] (prediction, pose, local map, state) → [`refine`] (matches sharpened) →
//! [`keyframes`] (when to keep a frame, what it adds, what is thrown out) → [`local_ba`] (poses and
//! landmarks together) → [`loop_closing`] (a place seen again) → [`culling`] (keyframes that say nothing
//! new) → [`schedule`] (mapping beside tracking) → [`mapper`] (Gaussians where the
//! picture is not yet explained; the map learns the pictures). [`recover`] finds a lost camera
//! again. [`session`] puts a run aside and takes it up again. `opening` sees the first frames twice.

pub(crate) mod agreement;
pub mod config;
pub mod culling;
pub mod frame;
pub mod keyframes;
pub mod labels;
pub mod local_ba;
pub mod loop_closing;
pub mod map;
pub mod mapper;
pub mod mask;
pub mod matching;
pub mod observer;
pub(crate) mod opening;
pub mod recover;
pub mod refine;
pub mod schedule;
pub mod session;
pub(crate) mod surface;
pub mod system;
pub mod trace;
pub mod tracker;

pub use config::{Config, ConfigError};
pub use culling::CullingConfig;
pub use loop_closing::{LoopClosure, LoopConfig};
pub use observer::{Observer, Silent, Stage};
pub use opening::SecondSight;
pub use session::SessionError;
pub use system::{FrameInput, FrameReport, Slam, SlamError};
pub use tracker::TrackingState;
