//! [`Snapshot`]: an input image kept for the report, with the labels of its keypoints.

use garad_core::{Label, MaskImage, RgbImage};
use garad_slam::{FrameReport, Slam, TrackingState};

use crate::source::SourceFrame;

/// An input image and what tracking made of it.
#[derive(Debug, Clone)]
pub struct Snapshot {
    /// Position in the recording.
    pub frame: usize,
    /// Time stamp, seconds.
    pub t_s: f64,
    /// The input.
    pub rgb: RgbImage,
    /// The computed mask or, without one, the given mask.
    pub mask: Option<MaskImage>,
    /// The true mask, where the recording has one.
    pub truth: Option<MaskImage>,
    /// Keypoints (x, y) with their roles.
    pub keypoints: Vec<(f32, f32, KeypointRole)>,
}

/// What tracking made of a keypoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum KeypointRole {
    /// Static, matched with a landmark.
    Tracked,
    /// Static, without a landmark.
    Free,
    /// On a moving object.
    Dynamic,
}

/// Snapshots per recording.
const COUNT: usize = 5;

/// Whether frame `i` of `total` is one to keep: evenly spread, the last frame among them.
pub(super) fn is_wanted(i: usize, total: usize) -> bool {
    (1..=COUNT).any(|k| i + 1 == (k * total).div_ceil(COUNT))
}

impl Snapshot {
    /// Of the frame that `slam` has just processed.
    pub(super) fn new(slam: &Slam, frame: SourceFrame, report: &FrameReport) -> Self {
        let keypoints = match slam.last_frame() {
            Some(last) if report.state == TrackingState::Tracking => (0..last.len())
                .map(|k| {
                    let role = match (last.label[k], last.landmark[k]) {
                        (Label::Dynamic, _) => KeypointRole::Dynamic,
                        (Label::Static, Some(_)) => KeypointRole::Tracked,
                        (Label::Static, None) => KeypointRole::Free,
                    };
                    (last.keypoints[k].x, last.keypoints[k].y, role)
                })
                .collect(),
            _ => Vec::new(),
        };
        let computed = slam.labelled_frame();
        Self {
            frame: report.id.index(),
            t_s: frame.t_s,
            mask: computed.map_or(frame.mask, |labels| Some(labels.mask(frame.rgb.size()))),
            rgb: frame.rgb,
            truth: frame.truth,
            keypoints,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::is_wanted;

    #[test]
    fn snapshots_are_spread_and_include_the_last_frame() {
        let taken: Vec<_> = (0..100).filter(|&i| is_wanted(i, 100)).collect();
        assert_eq!(taken, [19, 39, 59, 79, 99], "of 100");
        let few: Vec<_> = (0..3).filter(|&i| is_wanted(i, 3)).collect();
        assert_eq!(few, [0, 1, 2], "of 3");
    }
}
