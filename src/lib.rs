//! `garad`: a CPU-only reference implementation of GARAD-SLAM.
//!
//! Input are RGB-D frames; output are the trajectory of the camera, a map of Gaussians, and for every
//! feature whether it moves. This crate is the facade: it re-exports the stages and adds [`mod@run`],
//! which takes a recording through them, and [`output`], which writes the results.
//!
//! Reading order for the method itself: [`core`] → [`features`] → [`optim`] → [`crf`] → [`raster`]
//! → [`slam`]; `ARCHITECTURE.md` has the map.

pub use garad_conformance as conformance;
pub use garad_core as core;
pub use garad_crf as crf;
pub use garad_dataset as dataset;
pub use garad_eval as eval;
pub use garad_features as features;
pub use garad_golden as golden;
pub use garad_optim as optim;
pub use garad_raster as raster;
pub use garad_slam as slam;
pub use garad_synth as synth;

pub mod config_file;
pub mod images;
pub mod interrupt;
pub mod output;
pub mod packed_labels;
pub mod profiles;
pub mod progress;
pub mod published;
pub mod reason;
pub mod recording;
pub mod render_quality;
pub mod run;
pub mod session;
pub mod source;
pub mod stopwatch;
pub mod trace;
pub mod untracked;
pub mod usage;

/// The program in the README compiles and runs.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct ReadmeDoctests;
