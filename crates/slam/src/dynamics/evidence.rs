//! [`DepthEvidence`]: what the depth images of other times say about a point.

use garad_core::{Camera, Label, Se3};
use garad_crf::DepthNoise;
use nalgebra::Vector3;

use super::free_space::{FreeSpace, Visibility};

/// The free space of another time, and the pose it was seen from.
#[derive(Debug)]
pub struct HistoryView<'a> {
    /// What it saw to be empty.
    pub free_space: &'a FreeSpace,
    /// Its pose.
    pub camera_from_world: Se3,
    /// Frames between then and now.
    pub age_frames: u32,
}

/// The free space of all views that a frame is compared with.
#[derive(Debug)]
pub struct FreeSpaceHistory<'a> {
    /// Of all views.
    pub camera: &'a Camera,
    /// Of the depth camera.
    pub noise: &'a DepthNoise,
    /// The views, in any order.
    pub views: Vec<HistoryView<'a>>,
}

/// What all views together say about a point.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DepthEvidence {
    /// Distance in front of the surface seen there, in standard deviations of the sensor: the
    /// largest of all views, 0 if all that see the point have it on a static surface, `None` if no
    /// view sees it.
    pub residual: Option<f64>,
    /// Age of the oldest view that has the point on a static surface, frames.
    pub agreed_frames: u32,
}

impl FreeSpaceHistory<'_> {
    /// The evidence on a point: its depth cue, and how long it has been on a static surface.
    #[must_use]
    pub fn query(&self, p_world: &Vector3<f64>) -> DepthEvidence {
        let mut evidence = DepthEvidence::default();
        for view in &self.views {
            let so_far = evidence.residual.unwrap_or(0.0);
            let pose = &view.camera_from_world;
            match (view.free_space).query(p_world, self.camera, pose, self.noise) {
                Visibility::InFront(sigmas) => evidence.residual = Some(so_far.max(sigmas)),
                Visibility::OnSurface(Label::Static) => {
                    evidence.residual = Some(so_far);
                    evidence.agreed_frames = evidence.agreed_frames.max(view.age_frames);
                }
                Visibility::OnSurface(Label::Dynamic)
                | Visibility::Occluded
                | Visibility::Unknown => {}
            }
        }
        evidence
    }
}
