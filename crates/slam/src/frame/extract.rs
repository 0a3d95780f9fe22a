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

#[cfg(test)]
mod tests {
    use garad_core::{Par, RgbImage};

    use super::*;
    use crate::config::Config;
    use crate::testing::{World, texture, uneven_camera, wall};

    /// 900 are to be used, at most three times as many detected; keypoints of the last frame and of
    /// these in use.
    #[test]
    fn more_keypoints_where_some_move() {
        let mut config = Config::default();
        (config.features.count, config.features.max_oversampling) = (900, 3.0);
        let world = World::new(config);
        assert_eq!(
            wanted_keypoints(&world.context, None),
            900,
            "the first frame"
        );
        let empty = world.frame_of(0, &[], &wall());
        assert_eq!(
            wanted_keypoints(&world.context, Some(&empty)),
            900,
            "no keypoint"
        );
        for (in_use, expected) in [
            (300, 900),
            (280, 964), // 964.3
            (200, 1350),
            (101, 2673), // 2673.3
            (100, 2700),
            (99, 2700),
            (0, 2700),
        ] {
            let mut last = world.frame(0, &wall());
            last.in_use[in_use..].fill(false);
            let wanted = wanted_keypoints(&world.context, Some(&last));
            assert_eq!(wanted, expected, "{in_use} of 300 in use");
        }
    }

    #[test]
    fn features_are_those_of_the_settings() {
        let mut config = Config::default();
        let f = &mut config.features;
        (f.count, f.scale, f.levels, f.exact_levels) = (300, 1.3, 3, false);
        (f.fast_threshold, f.fast_min_threshold) = (60, 25);
        let context = Context::new(uneven_camera(), config, 0, Par::Seq).expect("valid");
        let gray = texture();
        let mut by_hand = OrbExtractor::new(OrbConfig {
            features: 120,
            scale: 1.3,
            levels: 3,
            threshold: 60,
            min_threshold: 25,
            ..OrbConfig::default()
        })
        .expect("valid");
        let expected = by_hand.extract(&gray, Par::Seq).expect("an image");
        let rgb = RgbImage::from_fn(160, 120, |x, y| [gray[(x, y)]; 3]);
        let input = FrameInput {
            t_s: 7.5,
            depth_t_s: 7.25,
            rgb: &rgb,
            depth: &wall(),
            mask: None,
        };
        let mut extractor = FrameExtractor::new(&context).expect("valid");
        let id = FrameId(4);
        let found = extractor.extract(&context, id, &input, &gray, 120);
        let found = found.expect("an image");
        assert_eq!(found.keypoints, expected.keypoints, "keypoints");
        assert_eq!(found.descriptors, expected.descriptors, "descriptors");
        assert_eq!((found.id, Some(found.t_s)), (id, Some(7.5)), "frame");
        for (keypoint, (px, sigma_px)) in
            (found.keypoints.iter()).zip(found.px.iter().zip(&found.sigma_px))
        {
            let [x, y] = [keypoint.x, keypoint.y].map(f64::from);
            assert_eq!([px.x, px.y].map(Some), [x, y].map(Some), "as ORB has it");
            let expected = [1.0, 1.3, 1.69][usize::from(keypoint.level)];
            assert!((sigma_px - expected).abs() < 1e-6, "{keypoint:?}");
        }
        assert!(found.keypoints.iter().any(|k| k.level == 2), "all levels");
        let none = extractor.without_features(&context, id, &input);
        assert!(none.is_empty() && none.id == id, "no features");
    }
}
