//! [`ImageStore`]: the image pyramids of the youngest keyframes, for Lucas-Kanade.

use std::collections::BTreeMap;
use std::sync::Arc;

use garad_core::{GrayImage, KeyframeId};
use garad_features::LkPyramid;
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

use crate::config::Config;

/// Levels above the full image where patch motion searches: displacements of 30 px must be found.
const PATCH_MOTION_LEVELS: usize = 3;

/// An image pyramid as Lucas-Kanade wants it; `None` if no stage uses one.
pub(crate) fn lk_pyramid(gray: &GrayImage, config: &Config) -> Option<LkPyramid> {
    let (labels, flow) = (&config.labels, &config.flow);
    let for_labels = labels.enabled && (flow.enabled || labels.patch_motion.enabled);
    let levels = match labels.patch_motion.enabled {
        true => PATCH_MOTION_LEVELS,
        false => 1,
    };
    let wanted = config.subpixel.enabled || for_labels;
    wanted.then(|| LkPyramid::new(gray, levels).expect("a camera's image has pixels"))
}

/// A pixel as Lucas-Kanade takes it.
#[allow(clippy::cast_possible_truncation, reason = "the tracker works in f32")]
pub(crate) fn lk_point(px: &Vector2<f64>) -> [f32; 2] {
    [px.x as f32, px.y as f32]
}

/// Image pyramids of the youngest keyframes, by keyframe.
#[derive(Debug, Default)]
pub struct ImageStore {
    pyramids: BTreeMap<KeyframeId, Arc<LkPyramid>>,
}

impl ImageStore {
    /// The pyramid of a keyframe, if it is still kept.
    #[must_use]
    pub fn get(&self, keyframe: KeyframeId) -> Option<&LkPyramid> {
        self.pyramids.get(&keyframe).map(|pyramid| &**pyramid)
    }

    /// Keyframes whose images are kept, oldest first.
    pub fn keyframes(&self) -> impl DoubleEndedIterator<Item = KeyframeId> + '_ {
        self.pyramids.keys().copied()
    }

    /// Keeps a new keyframe's image and drops those beyond `subpixel.keyframes`.
    pub(crate) fn insert(
        &mut self,
        keyframe: KeyframeId,
        pyramid: Option<Arc<LkPyramid>>,
        config: &Config,
    ) {
        if let Some(pyramid) = pyramid {
            self.pyramids.insert(keyframe, pyramid);
        }
        while self.pyramids.len() > config.subpixel.keyframes {
            self.pyramids.pop_first();
        }
    }

    /// Drops a culled keyframe's image.
    pub(crate) fn remove(&mut self, keyframe: KeyframeId) {
        self.pyramids.remove(&keyframe);
    }

    /// For a session: every kept pyramid.
    pub(crate) fn to_saved(&self) -> SavedImages<&LkPyramid> {
        SavedImages(self.pyramids.iter().map(|(k, p)| (*k, &**p)).collect())
    }

    /// From a session.
    pub(crate) fn from_saved(saved: SavedImages<LkPyramid>) -> Self {
        let pyramids = saved.0.into_iter().map(|(k, p)| (k, Arc::new(p)));
        Self {
            pyramids: pyramids.collect(),
        }
    }
}

/// [`ImageStore`] as it stands in a session.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct SavedImages<P>(Vec<(KeyframeId, P)>);

#[cfg(test)]
mod tests {
    use super::*;

    fn image(value: u8) -> GrayImage {
        GrayImage::new(320, 240, value)
    }

    /// (subpixel, labels, flow check, patch motion): levels of the pyramid.
    #[test]
    fn a_pyramid_has_the_levels_that_some_stage_needs() {
        for (settings, levels) in [
            ([false, false, false, false], None),
            ([false, false, true, true], None), // labels are off
            ([false, true, false, false], None),
            ([true, false, false, false], Some(2)),
            ([false, true, true, false], Some(2)),
            ([false, true, false, true], Some(4)),
            ([true, false, false, true], Some(4)),
            ([true, true, true, true], Some(4)),
        ] {
            let mut config = Config::default();
            let [subpixel, labels, flow, patch_motion] = settings;
            (config.subpixel.enabled, config.flow.enabled) = (subpixel, flow);
            (config.labels.enabled, config.labels.patch_motion.enabled) = (labels, patch_motion);
            let pyramid = lk_pyramid(&image(7), &config);
            assert_eq!(pyramid.map(|p| p.levels()), levels, "{settings:?}");
        }
    }

    #[test]
    fn a_pixel_is_a_point() {
        let point = lk_point(&Vector2::new(3.5, -0.25));
        assert_eq!(point.map(f32::to_bits), [3.5, -0.25].map(f32::to_bits));
    }

    /// The images of the two youngest keyframes are kept; one without an image drops none of them.
    #[test]
    fn images_of_the_youngest_keyframes_are_kept() {
        let mut config = Config::default();
        config.subpixel.keyframes = 2;
        let mut images = ImageStore::default();
        let kept = |images: &ImageStore| -> Vec<(u32, u8)> {
            let value = |k: KeyframeId| images.get(k).expect("kept").image()[(0, 0)];
            images.keyframes().map(|k| (k.0, value(k))).collect()
        };
        for (keyframe, value, expected) in [
            (0, Some(10), &[(0, 10)][..]),
            (1, Some(11), &[(0, 10), (1, 11)]),
            (2, None, &[(0, 10), (1, 11)]),
            (3, Some(13), &[(1, 11), (3, 13)]),
            (5, Some(15), &[(3, 13), (5, 15)]),
        ] {
            let pyramid = value.map(|v| Arc::new(LkPyramid::new(&image(v), 1).expect("pixels")));
            images.insert(KeyframeId(keyframe), pyramid, &config);
            assert_eq!(kept(&images), expected, "after keyframe {keyframe}");
        }
        let bytes = postcard::to_stdvec(&images.to_saved()).expect("a form");
        let saved = postcard::from_bytes(&bytes).expect("images");
        assert_eq!(
            kept(&ImageStore::from_saved(saved)),
            [(3, 13), (5, 15)],
            "from a session"
        );
        images.remove(KeyframeId(3));
        assert!(images.get(KeyframeId(3)).is_none(), "culled");
        assert_eq!(kept(&images), [(5, 15)]);
        config.subpixel.keyframes = 0;
        images.insert(KeyframeId(6), None, &config);
        assert!(kept(&images).is_empty(), "none is wanted");
    }
}
