//! [`Frame`]: what tracking needs to know of one picture.

use garad_core::pyramid::{level_scales, level_sizes};
use garad_core::{Camera, DepthImage, FrameId, Label, LandmarkId, MaskImage, Se3};
use garad_features::{Descriptor, Keypoint};
use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::config::{Config, FeatureConfig};
use crate::mask::moving_near;
use crate::surface::Surface;

/// A frame: its features in ideal pixels, their depth, and the landmarks they were found to be.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Frame {
    /// Position in the recording.
    pub id: FrameId,
    /// Colour time stamp, seconds.
    pub t_s: f64,
    /// Where the camera is.
    pub camera_from_world: Se3,
    /// Keypoints as detected (distorted pixels).
    pub keypoints: Vec<Keypoint>,
    /// Their descriptors.
    pub descriptors: Vec<Descriptor>,
    /// Their places in the full picture (distorted), px.
    pub px: Vec<Vector2<f64>>,
    /// How far to trust them: 1.2^level px, or what refinement says.
    pub sigma_px: Vec<f64>,
    /// Where a pinhole would have seen them.
    pub uv_px: Vec<Vector2<f64>>,
    /// Metres along z; `None` where the sensor gave none or the point sits on a depth edge.
    pub depth_m: Vec<Option<f64>>,
    /// The patch around the keypoint shows one surface: depths 10 px around it are near its own.
    pub one_surface: Vec<bool>,
    /// Does the keypoint sit on something that moves?
    pub label: Vec<Label>,
    /// Keypoints that move take part in nothing, nor do those so near to something that moves that
    /// their descriptor or depth reaches across the edge.
    pub in_use: Vec<bool>,
    /// The landmark behind each keypoint.
    pub landmark: Vec<Option<LandmarkId>>,
    /// The depth picture in planes; kept by the youngest keyframes only.
    pub(crate) surface: Option<Surface>,
    grid: Grid,
}

impl Frame {
    /// Keeps what says when and where the picture was taken, and frees the rest.
    pub(crate) fn give_up_features(&mut self) {
        *self = Self {
            id: self.id,
            t_s: self.t_s,
            camera_from_world: self.camera_from_world,
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
            surface: None,
            grid: Grid::default(),
        };
    }

    /// Brings detected features to ideal pixels, reads their depth and label.
    ///
    /// Keypoints without an inverse under the distortion model, or outside the ideal picture, stay
    /// in the list (labels on disk count them) but off the grid, so nothing ever matches them.
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
        let ratio = config.refine.surface_ratio;
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
        let noise = &config.surface.noise;
        let surface = (config.surface.enabled)
            .then(|| Surface::new(depth, config.features.max_depth_m, noise));
        Self {
            id,
            t_s,
            camera_from_world: Se3::identity(),
            landmark: vec![None; keypoints.len()],
            surface,
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

    /// Puts keypoint i at a better place (distorted px), with the depth read there. A place without
    /// an ideal pixel changes nothing.
    pub fn move_keypoint(
        &mut self,
        i: usize,
        px: Vector2<f64>,
        sigma_px: f64,
        depth: &DepthImage,
        camera: &Camera,
        config: &Config,
    ) {
        if let Some(uv_px) = camera.undistort_pixel(&px) {
            self.px[i] = px;
            self.uv_px[i] = uv_px;
            self.sigma_px[i] = sigma_px;
            self.depth_m[i] = depth_at(depth, &px, &config.features);
        }
    }

    /// Gives every keypoint a label, and says which take part in matching. The others lose their
    /// landmark, and no search finds them.
    ///
    /// # Panics
    /// Unless there is a label and a decision for every keypoint.
    pub fn set_labels(&mut self, label: Vec<Label>, in_use: Vec<bool>, camera: &Camera) {
        assert_eq!(label.len(), self.len(), "a label per keypoint");
        assert_eq!(in_use.len(), self.len(), "a decision per keypoint");
        for (landmark, in_use) in self.landmark.iter_mut().zip(&in_use) {
            if !in_use {
                *landmark = None;
            }
        }
        self.grid = Grid::new(camera, &self.uv_px, &in_use);
        self.label = label;
        self.in_use = in_use;
    }

    /// Keypoints in use within `radius_px` of a place, at levels `low..=high`, in index order
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

/// Where the pixels of each ORB level lie in the picture.
///
/// A resized picture keeps its outer edges, so pixel x of a level W_l wide has its centre at
/// (x + ½) W/W_l - ½ of the full one. ORB-SLAM multiplies by 1.2^l instead, which is off by up to
/// 1.3 px at the coarsest level and moves points that are seen at changing levels (decision 003).
#[derive(Debug, Clone)]
pub struct Levels {
    /// 1.2^l as the extractor multiplies it into keypoints.
    scale: Vec<f64>,
    /// (W/W_l, H/H_l).
    ratio: Vec<(f64, f64)>,
    exact: bool,
}

impl Levels {
    /// For pictures of this size.
    #[must_use]
    pub fn new((width, height): (usize, usize), factor: f32, count: usize, exact: bool) -> Self {
        let ratio = level_sizes((width, height), factor, count)
            .iter()
            .map(|(w, h)| (width as f64 / *w as f64, height as f64 / *h as f64))
            .collect();
        let scale = level_scales(factor, count)
            .iter()
            .map(|s| f64::from(*s))
            .collect();
        Self {
            scale,
            ratio,
            exact,
        }
    }

    /// The keypoint's place in the full picture, px.
    #[must_use]
    pub fn center(&self, keypoint: &Keypoint) -> Vector2<f64> {
        let (x, y) = (f64::from(keypoint.x), f64::from(keypoint.y));
        let level = usize::from(keypoint.level);
        if !self.exact {
            return Vector2::new(x, y);
        }
        let (rx, ry) = self.ratio[level];
        let at = |c: f64, ratio: f64| (c / self.scale[level] + 0.5) * ratio - 0.5;
        Vector2::new(at(x, rx), at(y, ry))
    }
}

/// Depth at a keypoint's nearest pixel; `None` if missing, too far, or on an edge: the valid
/// depths of the 3x3 pixels around it spread by more than `edge_ratio` of it.
fn depth_at(depth: &DepthImage, px: &Vector2<f64>, config: &FeatureConfig) -> Option<f64> {
    let (x, y) = nearest_pixel(px, depth.size())?;
    let usable = |d: f32| d.is_finite() && d > 0.0 && f64::from(d) <= config.max_depth_m;
    let center = depth[(x, y)];
    if !usable(center) {
        return None;
    }
    let (mut low, mut high) = (center, center);
    for ny in y.saturating_sub(1)..=(y + 1).min(depth.height() - 1) {
        for nx in x.saturating_sub(1)..=(x + 1).min(depth.width() - 1) {
            let d = depth[(nx, ny)];
            if usable(d) {
                low = low.min(d);
                high = high.max(d);
            }
        }
    }
    let spread = f64::from(high - low);
    (spread <= config.edge_ratio * f64::from(center)).then(|| f64::from(center))
}

/// Do all valid depths on a 5x5 lattice over the 21x21 pixels around a place lie within `ratio` of
/// the depth at the place itself?
fn one_surface(depth: &DepthImage, px: &Vector2<f64>, ratio: f64) -> bool {
    const OFFSETS: [isize; 5] = [-10, -5, 0, 5, 10];
    let Some((x, y)) = nearest_pixel(px, depth.size()) else {
        return false;
    };
    let center = f64::from(depth[(x, y)]);
    let near = |d: &f32| *d <= 0.0 || (f64::from(*d) - center).abs() <= ratio * center;
    center > 0.0
        && OFFSETS.iter().all(|dy| {
            OFFSETS.iter().all(|dx| {
                let at = (x.checked_add_signed(*dx), y.checked_add_signed(*dy));
                let (Some(x), Some(y)) = at else { return true };
                depth.get(x, y).is_none_or(near)
            })
        })
}

/// Dynamic if anything moves within `radius` of the keypoint.
fn label_at(mask: &MaskImage, px: &Vector2<f64>, radius: usize) -> Label {
    match nearest_pixel(px, mask.size()) {
        Some((x, y)) if moving_near(mask, x, y, radius) => Label::Dynamic,
        _ => Label::Static,
    }
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "compared with the picture's bounds before the cast"
)]
fn nearest_pixel(px: &Vector2<f64>, (width, height): (usize, usize)) -> Option<(usize, usize)> {
    let (x, y) = ((px.x + 0.5).floor(), (px.y + 0.5).floor());
    let inside = x >= 0.0 && y >= 0.0 && x < width as f64 && y < height as f64;
    inside.then_some((x as usize, y as usize))
}

/// Keypoints by cell, so that a search looks at its neighbourhood only.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
struct Grid {
    columns: usize,
    rows: usize,
    /// `start[cell]..start[cell + 1]` into `index`.
    start: Vec<usize>,
    index: Vec<usize>,
}

/// ORB-SLAM's 64 x 48 cells of a 640 x 480 picture.
const CELL_PX: f64 = 10.0;

impl Grid {
    fn new(camera: &Camera, uv_px: &[Vector2<f64>], in_use: &[bool]) -> Self {
        let columns = cell_of(camera.width as f64, usize::MAX) + 1;
        let rows = cell_of(camera.height as f64, usize::MAX) + 1;
        let cell = |i: usize| {
            let uv = &uv_px[i];
            (in_use[i] && camera.contains(uv))
                .then(|| cell_of(uv.y, rows - 1) * columns + cell_of(uv.x, columns - 1))
        };
        // Counting sort: stable, so indices ascend within a cell.
        let mut start = vec![0; columns * rows + 1];
        for c in (0..uv_px.len()).filter_map(cell) {
            start[c + 1] += 1;
        }
        for c in 0..columns * rows {
            start[c + 1] += start[c];
        }
        let mut next = start.clone();
        let mut index = vec![0; start[columns * rows]];
        for i in 0..uv_px.len() {
            if let Some(c) = cell(i) {
                index[next[c]] = i;
                next[c] += 1;
            }
        }
        Self {
            columns,
            rows,
            start,
            index,
        }
    }

    fn cells(&self, uv: Vector2<f64>, radius: f64) -> impl Iterator<Item = usize> + '_ {
        let (x0, x1) = (
            cell_of(uv.x - radius, self.columns - 1),
            cell_of(uv.x + radius, self.columns - 1),
        );
        let (y0, y1) = (
            cell_of(uv.y - radius, self.rows - 1),
            cell_of(uv.y + radius, self.rows - 1),
        );
        (y0..=y1).flat_map(move |y| {
            let row = y * self.columns;
            self.index[self.start[row + x0]..self.start[row + x1 + 1]]
                .iter()
                .copied()
        })
    }
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "float to integer saturates and maps NaN to 0, which is the clamp wanted here"
)]
fn cell_of(coordinate: f64, last: usize) -> usize {
    ((coordinate / CELL_PX) as usize).min(last)
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::Real;

    fn keypoint(x: f32, y: f32, level: u8) -> Keypoint {
        Keypoint {
            x,
            y,
            level,
            angle_deg: 0.0,
            response: 1.0,
        }
    }

    fn frame(points: &[(f32, f32, u8)], depth: &DepthImage, mask: Option<&MaskImage>) -> Frame {
        let camera = Camera::pinhole(depth.size(), [50.0, 50.0, 31.5, 23.5]).expect("valid camera");
        let keypoints: Vec<_> = points.iter().map(|&(x, y, l)| keypoint(x, y, l)).collect();
        let descriptors = vec![Descriptor::default(); keypoints.len()];
        let mut config = Config::default();
        config.labels.dilate_px = 2;
        Frame::new(
            FrameId(0),
            0.0,
            keypoints,
            descriptors,
            depth,
            mask,
            &camera,
            &Levels::new(depth.size(), 1.2, 8, true),
            &config,
        )
    }

    #[test]
    fn near_finds_what_a_full_search_finds() {
        let depth = DepthImage::new(64, 48, 1.0);
        let mut rng = garad_core::Rng::new(1);
        let points: Vec<_> = (0..300)
            .map(|_| {
                (
                    rng.range(0.0, 63.0).to_f32(),
                    rng.range(0.0, 47.0).to_f32(),
                    u8::try_from(rng.below(4)).expect("below 4"),
                )
            })
            .collect();
        let frame = frame(&points, &depth, None);
        for _ in 0..200 {
            let uv = Vector2::new(rng.range(-10.0, 74.0), rng.range(-10.0, 58.0));
            let mut found: Vec<_> = frame.near(&uv, 7.0, 1, 2).collect();
            found.sort_unstable();
            let expected: Vec<_> = (0..points.len())
                .filter(|&i| {
                    let d = frame.uv_px[i] - uv;
                    (1..=2).contains(&points[i].2) && d.x.abs() < 7.0 && d.y.abs() < 7.0
                })
                .collect();
            assert_eq!(found, expected, "around {uv}");
        }
    }

    #[test]
    fn depth_on_an_edge_or_missing_is_no_depth() {
        let depth = DepthImage::from_fn(64, 48, |x, _| match x {
            0..=19 => 1.0,
            20..=39 => 2.0,
            _ => 0.0,
        });
        let frame = frame(
            &[(10.2, 5.0, 0), (19.6, 5.0, 0), (50.0, 5.0, 0)],
            &depth,
            None,
        );
        assert_eq!(
            frame.depth_m,
            [Some(1.0), None, None],
            "flat, edge, missing"
        );
    }

    #[test]
    fn moving_keypoints_are_labelled_and_never_matched() {
        let depth = DepthImage::new(64, 48, 1.0);
        let mask = MaskImage::from_fn(64, 48, |x, _| if x >= 32 { 255 } else { 0 });
        let frame = frame(
            &[(10.0, 9.0, 0), (30.0, 9.0, 0), (40.0, 9.0, 0)],
            &depth,
            Some(&mask),
        );
        let expected = [Label::Static, Label::Static, Label::Dynamic];
        assert_eq!(frame.label, expected, "left, near the edge, inside");
        assert_eq!(
            frame.in_use,
            [true, false, false],
            "near the edge is not to be trusted"
        );
        let all: Vec<_> = frame.near(&Vector2::new(32.0, 24.0), 100.0, 0, 7).collect();
        assert_eq!(all, [0], "only the static one can be matched");
    }
}
