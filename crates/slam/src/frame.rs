//! [`Frame`]: the features of one RGB-D image, their depth, labels and landmarks.

pub(crate) mod depth_planes;
pub(crate) mod depth_time;
pub mod extract;
mod grid;
pub(crate) mod keypoint_depth;
mod levels;

use garad_core::{Camera, DepthImage, FrameId, Label, LandmarkId, MaskImage, RollingShutter, Se3};
use garad_features::{Descriptor, Keypoint};
use nalgebra::{Matrix3, Matrix6, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use self::depth_planes::DepthPlanes;
use self::grid::Grid;
use self::keypoint_depth::{depth_at, nearest_pixel, one_surface};
use crate::config::Config;
use crate::mask::moving_near;

pub use self::levels::Levels;

/// A frame: its features in ideal pixels, their depth, and the landmarks they were found to be.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Frame {
    /// Position in the recording.
    pub id: FrameId,
    /// Time stamp of the colour image, seconds.
    pub t_s: f64,
    /// Pose of the camera at the middle row.
    pub camera_from_world: Se3,
    /// Where the camera's motion so far lets it be expected.
    pub(crate) expected: Option<CentreEstimate>,
    /// What its links say about the pose.
    pub(crate) information: PoseInformation,
    /// How it turned while the image was read out.
    pub shutter: RollingShutter,
    /// Keypoints as detected (distorted pixels).
    pub keypoints: Vec<Keypoint>,
    /// Their descriptors.
    pub descriptors: Vec<Descriptor>,
    /// Their positions in the full image (distorted), px.
    pub px: Vec<Vector2<f64>>,
    /// Their standard deviation: 1.2^level px, or that of a subpixel match.
    pub sigma_px: Vec<f64>,
    /// Their positions in the undistorted image, as if all rows were read with the middle one, px.
    pub uv_px: Vec<Vector2<f64>>,
    /// Metres along z; `None` where the sensor gave none or the point sits on a depth edge.
    pub depth_m: Vec<Option<f64>>,
    /// The patch around the keypoint shows one surface: depths 10 px around it are near its own.
    pub one_surface: Vec<bool>,
    /// Whether the keypoint is on something that moves.
    pub label: Vec<Label>,
    /// Keypoints that take part in matching: not those that move, nor those so near to something
    /// that moves that their descriptor or depth reaches across the edge.
    pub in_use: Vec<bool>,
    /// The landmark behind each keypoint.
    pub landmark: Vec<Option<LandmarkId>>,
    /// The depth image as planes; kept by the youngest keyframes only.
    pub(crate) depth_planes: Option<DepthPlanes>,
    grid: Grid,
}

/// The centre of a camera, N(centre, information⁻¹), in world coordinates, metres.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(crate) struct CentreEstimate {
    pub(crate) centre_m: Vector3<f64>,
    pub(crate) information: Matrix3<f64>,
}

/// What links to landmarks say about the pose of a frame, each with an error of its own.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
pub(crate) struct PoseInformation {
    /// H = Σ JᵀJ over ξ = (ρ, φ): the inverse of the covariance.
    pub(crate) matrix: Matrix6<f64>,
    /// How many there are.
    pub(crate) links: usize,
}

impl Frame {
    /// Keeps id, time and pose and frees the rest.
    pub(crate) fn drop_features(&mut self) {
        *self = Self {
            id: self.id,
            t_s: self.t_s,
            camera_from_world: self.camera_from_world,
            shutter: self.shutter,
            information: self.information,
            expected: self.expected,
            keypoints: Vec::new(),
            descriptors: Vec::new(),
            px: Vec::new(),
            sigma_px: Vec::new(),
            uv_px: Vec::new(),
            depth_m: Vec::new(),
            one_surface: Vec::new(),
            label: Vec::new(),
            in_use: Vec::new(),
            landmark: Vec::new(),
            depth_planes: None,
            grid: Grid::default(),
        };
    }

    /// Brings detected features to ideal pixels, reads their depth and label.
    ///
    /// Keypoints without an inverse under the distortion model, or outside the ideal image, stay
    /// in the list (labels on disk count them) but off the grid, so no search returns them.
    #[must_use]
    pub fn new(
        id: FrameId,
        t_s: f64,
        keypoints: Vec<Keypoint>,
        descriptors: Vec<Descriptor>,
        depth: &DepthImage,
        mask: Option<&MaskImage>,
        camera: &Camera,
        levels: &Levels,
        config: &Config,
    ) -> Self {
        let outside = Vector2::new(f64::NAN, f64::NAN);
        let px: Vec<_> = keypoints.iter().map(|k| levels.center(k)).collect();
        let uv_px: Vec<_> = px
            .iter()
            .map(|p| camera.undistort_pixel(p).unwrap_or(outside))
            .collect();
        let sigma_px = keypoints
            .iter()
            .map(|k| levels.scale[usize::from(k.level)])
            .collect();
        let depth_m = px
            .iter()
            .map(|p| depth_at(depth, p, &config.features))
            .collect();
        let ratio = config.subpixel.surface_ratio;
        let one_surface = px.iter().map(|p| one_surface(depth, p, ratio)).collect();
        let label: Vec<_> = px
            .iter()
            .map(|p| mask.map_or(Label::Static, |m| label_at(m, p, 0)))
            .collect();
        let reach_px = config.labels.dilate_px;
        let in_use: Vec<_> = px
            .iter()
            .map(|p| mask.is_none_or(|m| label_at(m, p, reach_px) == Label::Static))
            .collect();
        let grid = Grid::new(camera, &uv_px, &in_use);
        let noise = &config.depth_planes.noise;
        let depth_planes = (config.depth_planes.enabled)
            .then(|| DepthPlanes::new(depth, config.features.max_depth_m, noise));
        Self {
            id,
            t_s,
            camera_from_world: Se3::identity(),
            shutter: RollingShutter::global(),
            information: PoseInformation::default(),
            expected: None,
            landmark: vec![None; keypoints.len()],
            depth_planes,
            keypoints,
            descriptors,
            px,
            sigma_px,
            uv_px,
            depth_m,
            one_surface,
            label,
            in_use,
            grid,
        }
    }

    /// Number of features.
    #[must_use]
    pub fn len(&self) -> usize {
        self.keypoints.len()
    }

    /// No feature at all.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.keypoints.is_empty()
    }

    /// The camera's centre in the world.
    #[must_use]
    pub fn center(&self) -> Vector3<f64> {
        self.camera_from_world.inverse().translation
    }

    /// The world point a keypoint with depth sees.
    #[must_use]
    pub fn world_point(&self, i: usize, camera: &Camera) -> Option<Vector3<f64>> {
        let depth = self.depth_m[i]?;
        Some(self.camera_from_world.inverse() * camera.unproject(&self.uv_px[i], depth))
    }

    /// Moves keypoint i to a better position (distorted px) and reads its depth there. A position
    /// without an ideal pixel changes nothing.
    pub fn move_keypoint(
        &mut self,
        i: usize,
        px: Vector2<f64>,
        sigma_px: f64,
        depth: &DepthImage,
        camera: &Camera,
        config: &Config,
    ) {
        if let Some(uv_px) = self.shutter.ideal_pixel(camera, &px) {
            self.px[i] = px;
            self.uv_px[i] = uv_px;
            self.sigma_px[i] = sigma_px;
            self.depth_m[i] = depth_at(depth, &px, &config.features);
        }
    }

    /// Gives every keypoint its label. Suspects and keypoints that are not in use lose their
    /// landmark; those not in use are found by no search.
    ///
    /// # Panics
    /// Unless there is a label for every keypoint.
    pub(crate) fn apply_labels(&mut self, labels: &FrameLabels, camera: &Camera) {
        assert_eq!(labels.label.len(), self.len(), "a label per keypoint");
        for (landmark, in_use) in self.landmark.iter_mut().zip(&labels.in_use) {
            if !in_use {
                *landmark = None;
            }
        }
        self.grid = Grid::new(camera, &self.uv_px, &labels.in_use);
        self.label.clone_from(&labels.label);
        self.in_use.clone_from(&labels.in_use);
    }

    /// The camera turned like this while the image was read out: brings all keypoints to the
    /// middle row. The rows are those of the detected positions.
    pub(crate) fn set_shutter(&mut self, shutter: RollingShutter, camera: &Camera) {
        self.shutter = shutter;
        for (uv_px, px) in self.uv_px.iter_mut().zip(&self.px) {
            if let Some(ideal) = shutter.ideal_pixel(camera, px) {
                *uv_px = ideal;
            }
        }
        self.grid = Grid::new(camera, &self.uv_px, &self.in_use);
    }

    /// Leaves out the depth planes where the mask (255) says that something moves.
    pub(crate) fn mask_depth_planes(&mut self, mask: Option<&MaskImage>) {
        if let Some(mask) = mask {
            self.depth_planes = self.depth_planes.take().map(|p| p.without_moving(mask));
        }
    }

    /// Keypoints in use within `radius_px` of a position, at levels `low..=high`, in index order
    /// within each cell.
    pub fn near(
        &self,
        uv_px: &Vector2<f64>,
        radius_px: f64,
        low: i32,
        high: i32,
    ) -> impl Iterator<Item = usize> + '_ {
        let center = *uv_px;
        self.grid.cells(center, radius_px).filter(move |&i| {
            let level = i32::from(self.keypoints[i].level);
            let d = self.uv_px[i] - center;
            level >= low && level <= high && d.x.abs() < radius_px && d.y.abs() < radius_px
        })
    }
}

/// What moves in a frame: the answer of [`dynamics`](crate::dynamics), applied to the frame once.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct FrameLabels {
    /// Per keypoint.
    pub(crate) label: Vec<Label>,
    /// Per keypoint: may it be matched?
    pub(crate) in_use: Vec<bool>,
    /// 255 where something moves, one value per cell.
    pub(crate) cells: MaskImage,
    /// Landmarks that are static again, ascending (`labels.source = "gaussians"`).
    pub(crate) restored: Vec<LandmarkId>,
}

impl FrameLabels {
    /// Dynamic where either is.
    pub(crate) fn union(mut self, other: Self) -> Self {
        for (label, other) in self.label.iter_mut().zip(other.label) {
            if other == Label::Dynamic {
                *label = other;
            }
        }
        for (in_use, other) in self.in_use.iter_mut().zip(other.in_use) {
            *in_use &= other;
        }
        for (cell, other) in self.cells.data_mut().iter_mut().zip(other.cells.data()) {
            *cell |= other;
        }
        Self {
            restored: other.restored,
            ..self
        }
    }
}

/// Dynamic if anything moves within `radius` of the keypoint.
fn label_at(mask: &MaskImage, px: &Vector2<f64>, radius: usize) -> Label {
    match nearest_pixel(px, mask.size()) {
        Some((x, y)) if moving_near(mask, x, y, radius) => Label::Dynamic,
        _ => Label::Static,
    }
}

#[cfg(test)]
mod tests;
