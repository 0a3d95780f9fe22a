//! [`OpenOptions`]: how a recording is opened.

use std::path::PathBuf;

use crate::calibration::Preset;

/// How a recording is opened.
///
/// ```
/// use garad_dataset::{OpenOptions, Preset};
/// let options = OpenOptions {
///     preset: Some(Preset::Bonn),
///     ..OpenOptions::default()
/// };
/// assert_eq!(options.max_dt_s, 0.02);
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct OpenOptions {
    /// Calibration by name.
    pub preset: Option<Preset>,
    /// Calibration by file; wins over everything else.
    pub calibration: Option<PathBuf>,
    /// Raw depth per metre, instead of the calibration's.
    pub depth_factor: Option<f64>,
    /// Colour and depth belong together up to this difference in time, seconds.
    pub max_dt_s: f64,
    /// Added to the times of depth images before they are paired, seconds (the offset of TUM's `associate.py`).
    pub depth_offset_s: f64,
    /// Times out of order are errors instead of warnings.
    pub strict: bool,
    /// Read at most this many frames.
    pub max_frames: Option<usize>,
    /// Skip this many frames first.
    pub first_frame: usize,
}

impl Default for OpenOptions {
    fn default() -> Self {
        Self {
            preset: None,
            calibration: None,
            depth_factor: None,
            max_dt_s: 0.02,
            depth_offset_s: 0.0,
            strict: false,
            max_frames: None,
            first_frame: 0,
        }
    }
}
