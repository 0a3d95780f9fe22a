//! [`PastView`]: what an earlier frame saw, and [`ReferenceImage`]: an image of another time in which a sample
//! is searched for.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use garad_core::{Camera, FrameId, KeyframeId, RollingShutter, Se3};
use garad_features::LkPyramid;
use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::bootstrap::FutureView;
use super::free_space::FreeSpace;
use crate::context::Context;
use crate::map::Map;

/// Least distance to a future view, frames.
const MIN_FUTURE_FRAMES: u32 = 3;

/// The free space of an earlier frame, its image while that is young enough, and its pose relative to a
/// keyframe.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct PastView {
    pub(crate) frame: FrameId,
    pub(super) reference: KeyframeId,
    pub(super) frame_from_reference: Se3,
    pub(super) shutter: RollingShutter,
    pub(super) free_space: FreeSpace,
    pub(super) image: Option<Arc<LkPyramid>>,
}

impl PastView {
    pub(super) fn camera_from_world(&self, map: &Map) -> Se3 {
        self.frame_from_reference * map.keyframe(self.reference).camera_from_world
    }
}

/// An image of another time, and the pose it was taken from.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ReferenceImage<'a> {
    pub(super) pyramid: &'a LkPyramid,
    camera_from_world: Se3,
    shutter: RollingShutter,
    free_space: &'a FreeSpace,
    /// Frames between then and now.
    pub(super) age_frames: u32,
}

#[cfg(test)]
impl<'a> ReferenceImage<'a> {
    /// An image of ten frames ago.
    pub(super) fn new(
        pyramid: &'a LkPyramid,
        free_space: &'a FreeSpace,
        camera_from_world: Se3,
    ) -> Self {
        Self {
            pyramid,
            camera_from_world,
            shutter: RollingShutter::global(),
            free_space,
            age_frames: 10,
        }
    }
}

impl ReferenceImage<'_> {
    /// Where a point is seen in it if it has been static, px; `None` outside.
    pub(super) fn predicted_pixel(
        &self,
        camera: &Camera,
        p_world: &Vector3<f64>,
    ) -> Option<Vector2<f64>> {
        let uv = camera.project(&(self.camera_from_world * *p_world))?;
        let inside = camera.contains(&uv);
        inside.then(|| self.shutter.recorded_pixel(camera, &uv))
    }

    pub(super) fn center(&self) -> Vector3<f64> {
        self.camera_from_world.inverse().translation
    }

    /// Whether it has depth around a point, and no surface there that is nearer by `edge_m`: nothing hid it.
    pub(super) fn sees(&self, camera: &Camera, p_world: &Vector3<f64>, edge_m: f64) -> bool {
        let p_cam = self.camera_from_world * *p_world;
        let nearest_m = self.free_space.nearest_m(&p_cam, camera);
        nearest_m.is_some_and(|nearest_m| nearest_m > p_cam.z - edge_m)
    }
}

/// The past views whose ages are nearest to those configured, and the future views.
pub(crate) fn reference_images<'a>(
    context: &Context,
    map: &Map,
    past: &'a VecDeque<PastView>,
    future: &'a [FutureView],
    now: FrameId,
) -> Vec<ReferenceImage<'a>> {
    let config = &context.config.labels.patch_motion;
    // A replayed frame has past views that are younger.
    let age = |view: &PastView| now.0.checked_sub(view.frame.0);
    let kept = past.iter().filter(|view| view.image.is_some());
    let aged: Vec<(&PastView, u32)> = kept.filter_map(|v| Some((v, age(v)?))).collect();
    let chosen: BTreeMap<FrameId, &PastView> = config
        .ages_frames
        .iter()
        .filter_map(|wanted| {
            let off = |(_, age): &&(&PastView, u32)| age.abs_diff(*wanted);
            let nearest = aged.iter().min_by_key(off);
            nearest.filter(|k| off(k) <= config.slack_frames())
        })
        .map(|(view, _)| (view.frame, *view))
        .collect();
    let past = chosen.into_values().filter_map(|view| {
        Some(ReferenceImage {
            pyramid: view.image.as_deref()?,
            camera_from_world: view.camera_from_world(map),
            shutter: view.shutter,
            free_space: &view.free_space,
            age_frames: now.0 - view.frame.0,
        })
    });
    let future = future.iter().filter_map(|view| {
        let far = now.0.abs_diff(view.frame.0) >= MIN_FUTURE_FRAMES;
        Some(ReferenceImage {
            pyramid: view.pyramid.as_ref().filter(|_| far)?,
            camera_from_world: view.camera_from_world,
            shutter: RollingShutter::global(),
            free_space: &view.free_space,
            age_frames: now.0.abs_diff(view.frame.0),
        })
    });
    past.chain(future).collect()
}
