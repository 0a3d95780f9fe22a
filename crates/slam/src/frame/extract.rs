//! [`FrameExtractor`]: from an RGB-D image to a [`Frame`].

use garad_core::{FrameId, GrayImage};
use garad_features::{Descriptor, Keypoint, OrbConfig, OrbExtractor};

use super::Frame;
use super::levels::Levels;
use crate::context::Context;
use crate::io::{FrameInput, SlamError};

/// Detects ORB features and makes frames of them.
#[derive(Debug)]
pub struct FrameExtractor {
    orb: OrbExtractor,
    levels: Levels,
}

impl FrameExtractor {
    /// For the camera and the settings of a context.
    ///
    /// # Errors
    /// [`SlamError::Features`] for an invalid setting.
    pub fn new(context: &Context) -> Result<Self, SlamError> {
        let features = &context.config.features;
        #[allow(
            clippy::cast_possible_truncation,
            reason = "1.2 as the f32 it is defined in"
        )]
        let scale = features.scale as f32;
        let size = (context.camera.width, context.camera.height);
        let orb = OrbExtractor::new(OrbConfig {
            features: features.count,
            scale,
            levels: features.levels,
            threshold: features.fast_threshold,
            min_threshold: features.fast_min_threshold,
            ..OrbConfig::default()
        });
        let frame = FrameId(0);
        Ok(Self {
            orb: orb.map_err(|source| SlamError::Features { frame, source })?,
            levels: Levels::new(size, scale, features.levels, features.exact_levels),
        })
    }

    /// The frame of an image, without features.
    pub(crate) fn without_features(
        &self,
        context: &Context,
        id: FrameId,
        input: &FrameInput<'_>,
    ) -> Frame {
        self.frame(context, id, input, (Vec::new(), Vec::new()))
    }

    /// The frame of an image, with `wanted` features at most.
    ///
    /// # Errors
    /// [`SlamError::Features`].
    pub(crate) fn extract(
        &mut self,
        context: &Context,
        id: FrameId,
        input: &FrameInput<'_>,
        gray: &GrayImage,
        wanted: usize,
    ) -> Result<Frame, SlamError> {
        self.orb.look_for(wanted);
        let features = self.orb.extract(gray, context.par);
        let features = features.map_err(|source| SlamError::Features { frame: id, source })?;
        let features = (features.keypoints, features.descriptors);
        Ok(self.frame(context, id, input, features))
    }

    fn frame(
        &self,
        context: &Context,
        id: FrameId,
        input: &FrameInput<'_>,
        (keypoints, descriptors): (Vec<Keypoint>, Vec<Descriptor>),
    ) -> Frame {
        Frame::new(
            id,
            input.t_s,
            keypoints,
            descriptors,
            input.depth,
            input.mask,
            &context.camera,
            &self.levels,
            &context.config,
        )
    }
}

/// Number of features to detect, so that `features.count` can be used if the same share as in the
/// last frame moves. Where people cover half the image, half of all keypoints are theirs.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "between 1 and 10 times a usize of at most 100 000"
)]
pub(crate) fn wanted_keypoints(context: &Context, last: Option<&Frame>) -> usize {
    let config = &context.config.features;
    let last = last.filter(|last| !last.is_empty());
    let times = last.map_or(1.0, |last| {
        let in_use = last.in_use.iter().filter(|in_use| **in_use).count();
        (last.len() as f64 / in_use as f64).min(config.max_oversampling)
    });
    (config.count as f64 * times) as usize
}
