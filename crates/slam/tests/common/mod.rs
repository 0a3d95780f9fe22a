//! What the tests of the pipeline share.

use garad_core::MaskImage;
use garad_slam::{FrameInput, FrameReport, Silent, Slam};
use garad_synth::SynthFrame;

/// Gives the system a synthetic frame, with a mask of what moves or without.
pub(crate) fn process(
    slam: &mut Slam,
    frame: &SynthFrame,
    mask: Option<&MaskImage>,
) -> FrameReport {
    let input = FrameInput {
        t_s: frame.t_s,
        depth_t_s: frame.t_s,
        rgb: &frame.rgb,
        depth: &frame.depth,
        mask,
    };
    slam.process(&input, &mut Silent).expect("a good frame")
}
