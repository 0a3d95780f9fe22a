//! What a report is made of.

use garad_core::RgbImage;

use crate::{Ate, ImageQuality, Metrics};

/// The content of the page. What is empty or `None` is left out or reported as unknown.
#[derive(Debug, Clone, Copy)]
pub struct ReportData<'a> {
    /// Figures, counts, version and name of the recording.
    pub metrics: &'a Metrics,
    /// How the trajectory was judged, e.g. "rigid alignment, nearest time within 0.02 s, raw
    /// ground truth"; without `ate` why it was not, e.g. "cannot be judged: no ground truth".
    pub protocol: &'a str,
    /// Trajectory errors.
    pub ate: Option<&'a Ate>,
    /// All frames in order of time.
    pub frames: &'a [FrameState],
    /// Frames shown as images.
    pub strips: &'a [Strip<'a>],
    /// Warnings, one sentence each.
    pub warnings: &'a [String],
    /// The configuration as used.
    pub config_toml: &'a str,
}

/// One frame of the recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameState {
    /// Seconds, in the recording's time.
    pub t_s: f64,
    /// Whether it has a pose.
    pub tracked: bool,
    /// Whether it became a keyframe.
    pub keyframe: bool,
    /// Duration of tracking, milliseconds.
    pub track_ms: Option<f64>,
}

/// Images of one frame side by side.
#[derive(Debug, Clone, Copy)]
pub struct Strip<'a> {
    /// Index of the frame.
    pub frame: usize,
    /// Seconds since the first frame.
    pub t_s: f64,
    /// The recorded image.
    pub input: &'a RgbImage,
    /// The map rendered from the estimated pose.
    pub render: Option<&'a RgbImage>,
    /// Labels, drawn over the input or as a mask.
    pub labels: Option<&'a RgbImage>,
    /// Render against input.
    pub quality: Option<ImageQuality>,
    /// Whether `quality` is of the pixels outside a mask of what moves.
    pub outside_mask: bool,
}
