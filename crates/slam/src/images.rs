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
