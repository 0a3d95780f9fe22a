//! What goes into the pipeline and what comes out: [`FrameInput`], [`FrameReport`], [`SlamError`].

use garad_core::{
    Camera, CameraError, DepthImage, FrameId, KeyframeId, Label, MaskImage, RgbImage, Se3,
};
use garad_features::FeatureError;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::config::ConfigError;
use crate::mapping::error::TrainError;

/// One RGB-D frame of a recording.
#[derive(Debug, Clone, Copy)]
pub struct FrameInput<'a> {
    /// Time stamp of the colour image, seconds, ascending.
    pub t_s: f64,
    /// Time stamp of the depth image, seconds.
    pub depth_t_s: f64,
    /// Colour.
    pub rgb: &'a RgbImage,
    /// Metres along z, registered to colour; 0 and NaN are missing.
    pub depth: &'a DepthImage,
    /// 255 where something moves; features there take part in nothing.
    pub mask: Option<&'a MaskImage>,
}

impl FrameInput<'_> {
    /// # Errors
    /// [`SlamError::SizeMismatch`] for an image whose size is not the camera's.
    pub(crate) fn check_sizes(&self, frame: FrameId, camera: &Camera) -> Result<(), SlamError> {
        let expected = (camera.width, camera.height);
        let sizes = [
            ("colour", Some(self.rgb.size())),
            ("depth", Some(self.depth.size())),
            ("mask", self.mask.map(MaskImage::size)),
        ];
        for (what, got) in sizes {
            if let Some(got) = got.filter(|g| *g != expected) {
                return Err(SlamError::SizeMismatch {
                    frame,
                    what,
                    got,
                    expected,
                });
            }
        }
        Ok(())
    }
}

/// What the tracker knows about where it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum TrackingState {
    /// No frame with enough depth yet.
    NotInitialised,
    /// The pose is good.
    Tracking,
    /// No pose: the camera is searched for among the keyframes.
    Lost,
}

impl TrackingState {
    /// The word in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::NotInitialised => "not initialised",
            Self::Tracking => "tracking",
            Self::Lost => "lost",
        }
    }
}

/// The outcome of one frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FrameReport {
    /// Position in the recording.
    pub id: FrameId,
    /// Time stamp, seconds.
    pub t_s: f64,
    /// State after the frame.
    pub state: TrackingState,
    /// Tracked, but by far fewer landmarks than the frames before: blurred, or covered by something
    /// near. Its pose owes much to the camera's motion, and it does not become a keyframe.
    pub weak: bool,
    /// ORB features.
    pub keypoints: usize,
    /// Of these on moving things.
    pub dynamic_keypoints: usize,
    /// Landmarks that agree with the pose; pixels compared, if it was found by rendering.
    pub inliers: usize,
    /// The keyframe it became.
    pub keyframe: Option<KeyframeId>,
    /// The pose, as far as known now; later adjustment may still move it.
    pub camera_from_world: Option<Se3>,
}

/// What the pipeline found to move in one frame: the output that is written and judged.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct LabelledFrame {
    /// The frame.
    pub frame: FrameId,
    /// Position of every keypoint in the recorded image, px, and its label.
    pub keypoints: Vec<([f64; 2], Label)>,
    /// 255 where something moves, one value per 4 x 4 pixels.
    pub cells: MaskImage,
}

impl LabelledFrame {
    /// The mask at the size of the image.
    #[must_use]
    pub fn mask(&self, size: (usize, usize)) -> MaskImage {
        crate::mask::full_size(&self.cells, size)
    }
}

/// One of the first frames, processed a second time after the pipeline restarted
/// ([`Slam::take_replayed`](crate::Slam::take_replayed)).
#[derive(Debug, Clone)]
pub struct ReplayedFrame {
    /// Its report.
    pub report: FrameReport,
    /// What moves there.
    pub labels: Option<LabelledFrame>,
}

/// What stops a run.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SlamError {
    /// Invalid configuration.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// Invalid calibration.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// An image whose size is not the camera's.
    #[error("frame {frame}: the {what} image is {got:?} pixels, the calibration says {expected:?}")]
    SizeMismatch {
        /// Which frame.
        frame: FrameId,
        /// colour, depth or mask.
        what: &'static str,
        /// Its size.
        got: (usize, usize),
        /// The calibrated size.
        expected: (usize, usize),
    },
    /// The map could not be rendered or trained.
    #[error("training: {0}")]
    Train(#[from] TrainError),
    /// The mapping thread panicked, and the map is lost with it. The path stays.
    #[error("the mapping thread panicked; the map of Gaussians is lost")]
    MappingLost,
    /// Features could not be detected.
    #[error("frame {frame}: {source}")]
    Features {
        /// Which frame.
        frame: FrameId,
        /// Why.
        source: FeatureError,
    },
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The camera is 8 x 6 pixels; the first image of another size is named.
    #[test]
    fn images_must_have_the_cameras_size() {
        let camera = Camera::pinhole((8, 6), [7.0, 7.5, 3.5, 2.5]).expect("valid");
        let right = (8, 6);
        for (rgb, depth, mask, wrong) in [
            (right, right, None, None),
            (right, right, Some(right), None),
            ((6, 8), right, None, Some(("colour", (6, 8)))),
            ((8, 5), (9, 6), Some((1, 1)), Some(("colour", (8, 5)))),
            (right, (7, 6), None, Some(("depth", (7, 6)))),
            (right, (8, 7), Some(right), Some(("depth", (8, 7)))),
            (right, right, Some((2, 2)), Some(("mask", (2, 2)))),
        ] {
            let rgb = RgbImage::new(rgb.0, rgb.1, [0; 3]);
            let depth = DepthImage::new(depth.0, depth.1, 1.0);
            let mask = mask.map(|(w, h)| MaskImage::new(w, h, 0));
            let input = FrameInput {
                t_s: 0.5,
                depth_t_s: 0.6,
                rgb: &rgb,
                depth: &depth,
                mask: mask.as_ref(),
            };
            let found = match input.check_sizes(FrameId(7), &camera) {
                Ok(()) => None,
                Err(SlamError::SizeMismatch {
                    frame: FrameId(7),
                    what,
                    got,
                    expected: (8, 6),
                }) => Some((what, got)),
                Err(other) => panic!("{other}"),
            };
            assert_eq!(found, wrong);
        }
    }

    #[test]
    fn states_have_the_words_of_reports() {
        use TrackingState::{Lost, NotInitialised, Tracking};
        let words = [NotInitialised, Tracking, Lost].map(TrackingState::name);
        assert_eq!(words, ["not initialised", "tracking", "lost"]);
    }

    /// 10 x 6 pixels are 3 x 2 cells of 4 pixels; those at the right and at the bottom are cut off.
    #[test]
    fn a_mask_has_the_size_of_the_image() {
        let labelled = LabelledFrame {
            frame: FrameId(3),
            keypoints: Vec::new(),
            cells: MaskImage::from_fn(3, 2, |x, y| {
                if (x, y) == (2, 0) || (x, y) == (0, 1) {
                    255
                } else {
                    0
                }
            }),
        };
        let mask = labelled.mask((10, 6));
        let expected = MaskImage::from_fn(10, 6, |x, y| match (x, y) {
            (8.., 0..4) | (0..4, 4..) => 255,
            _ => 0,
        });
        assert_eq!(mask, expected);
    }
}
