//! The GARAD-SLAM pipeline: the only crate that knows the order of stages.
//!
//! Frames go in one by one through [`Slam::process`]; out come the camera's path
//! ([`Slam::trajectory`]), the landmarks and keyframes behind it, and a map of Gaussians
//! ([`Slam::gaussians`]). Nothing here reads files, clocks or terminals: images come as
//! arguments, timings leave through an [`Observer`].
//!
//! Reading order: `pipeline` is the method on a page. Then one frame's way: [`frame`] (features,
//! depth at keypoints, depth planes) → [`tracking`] (first pose, local map, final pose) →
//! [`dynamics`] (the paper, III-A and III-B: what moves) → [`keyframing`] (landmarks, bundle
//! adjustment, loops) → [`mapping`] (III-C: the Gaussians). Each stage is a function of the
//! [`Context`], what it reads, what it owns, and a [`trace::Recorder`]. [`session`] saves a run and
//! resumes it.

pub mod config;
pub mod context;
pub mod dynamics;
pub mod frame;
pub mod images;
pub mod io;
pub mod keyframing;
pub mod map;
pub mod mapping;
pub mod mask;
pub mod observer;
mod pipeline;
mod results;
pub mod session;
pub mod stages;
pub mod trace;
pub mod tracking;
pub mod trajectory;

#[cfg(test)]
mod testing;

pub use config::{Config, ConfigError, CullingConfig, LoopConfig};
pub use context::Context;
pub use io::{FrameInput, FrameReport, LabelledFrame, ReplayedFrame, SlamError, TrackingState};
pub use keyframing::loop_closing::LoopClosure;
pub use observer::{Observer, Silent, Stage};
pub use pipeline::Slam;
pub use session::SessionError;
