//! [`SourceFrame`]: a frame of a recording with its masks, ready to be processed.

use garad_core::{DepthImage, MaskImage, RgbImage};
use garad_slam::FrameInput;

/// A frame of a recording.
#[derive(Debug, Clone)]
pub struct SourceFrame {
    /// Time stamp of the colour image, seconds.
    pub t_s: f64,
    /// Time stamp of the depth image, seconds.
    pub depth_t_s: f64,
    /// Colour.
    pub rgb: RgbImage,
    /// Depth, metres.
    pub depth: DepthImage,
    /// Oracle mask, 255 on moving objects: used instead of computed labels.
    pub mask: Option<MaskImage>,
    /// True mask, 255 on moving objects, 0 elsewhere: computed labels are compared with it.
    pub truth: Option<MaskImage>,
}

impl SourceFrame {
    /// What the pipeline gets to see of it.
    #[must_use]
    pub fn input(&self) -> FrameInput<'_> {
        FrameInput {
            t_s: self.t_s,
            depth_t_s: self.depth_t_s,
            rgb: &self.rgb,
            depth: &self.depth,
            mask: self.mask.as_ref(),
        }
    }
}
