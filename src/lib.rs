//! `garad`: a CPU-only reference implementation of GARAD-SLAM.
//!
//! RGB-D frames go in; out come the camera's path, a map of Gaussians, and for every feature
//! whether it moves. This crate is the facade: it re-exports the stages under one roof and holds
//! the [`runner`] that takes a recording through them and writes what came out.
//!
//! Reading order for the method itself: [`core`] → [`features`] → [`optim`] → [`crf`] → [`raster`]
//! → [`slam`]; `ARCHITECTURE.md` has the map.

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
pub mod conformance;
pub mod output;
pub mod packed_labels;
pub mod pictures;
pub mod progress;
pub mod render_quality;
pub mod runner;
pub mod session;
pub mod stopwatch;
pub mod trace;

/// The program in the README compiles and runs.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct ReadmeDoctests;
