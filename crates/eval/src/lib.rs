//! Evaluation of a run: trajectories, images, labels; `metrics.json` and `report.html`.
//!
//! Reading order: [`mod@associate`] (pairs of poses by time) → [`align`] (the best rigid motion between
//! two point lists) → [`mod@ate`], [`mod@rpe`] (trajectory errors, as in the papers), [`mod@jitter`] →
//! [`image_metrics`], [`depth`], [`mod@ghosts`], [`labels`] (images and segmentations) → [`metrics`]
//! (`metrics.json`), [`comparison`] → [`plot`], [`report`] (`report.html`).
//!
//! No function here reads a file or a clock.

pub mod align;
pub mod associate;
pub mod ate;
pub mod comparison;
pub mod depth;
pub mod error;
pub mod ghosts;
pub mod image_metrics;
pub mod jitter;
pub mod labels;
pub mod metrics;
pub mod plot;
pub mod report;
pub mod rpe;
pub mod stats;

pub use align::{Alignment, Sim3, align_points, align_trajectory};
pub use associate::{MAX_DT_S, associate, nearest_in_time};
pub use ate::{Ate, AteOptions, AtePoint, ate};
pub use comparison::{Comparison, Figures, Row};
pub use depth::{DepthL1, depth_l1};
pub use error::EvalError;
pub use ghosts::{GHOST_GAP_M, Ghosts, ghosts};
pub use image_metrics::{ImageQuality, compare_images, psnr_db, ssim, ssim_map};
pub use jitter::{Jitter, jitter};
pub use labels::{Confusion, FrameLabels, RunLabels};
pub use metrics::{DepthMetrics, LeftOut, Metrics, RenderMetrics, StageTiming};
pub use report::{FrameState, ReportData, Strip};
pub use rpe::{Rpe, RpeDelta, RpeOptions, rpe};
pub use stats::Stats;
