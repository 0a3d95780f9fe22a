//! Plots as SVG text: trajectories seen from two sides, error and tracking time over time.
//!
//! The text is a function of the numbers alone.

mod over_time;
mod style;
mod trajectory;

pub use over_time::{FrameTime, error_over_time, time_per_frame};
pub use style::{ALARM, ESTIMATE, GRID, INK, TRUTH};
pub use trajectory::{Plane, trajectory_panel, widest_planes};
