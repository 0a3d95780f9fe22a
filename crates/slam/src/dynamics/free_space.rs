//! [`FreeSpace`]: which part of the world a depth image shows to be empty.
//!
//! A camera that measured 3 m along a ray saw free space up to there. A point now found in front of
//! that surface was not there then: it has moved in. A point of the map in front of the surface
//! that the present image shows has moved away. Both are one test; the opposite, a point behind the
//! surface, proves nothing, since it may have been occluded.
//!
//! ```text
//! camera ────────────── free space ──────────────┃ surface ░░ occluded ░░
//!                 a point here: InFront    OnSurface       Occluded
//! ```

use garad_core::{Camera, DepthImage, Image, Label, MaskImage, Se3};
use garad_crf::DepthNoise;
use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::mask::{CELL_PX, MOVING};

/// Depth range of a moving object within 12 pixels, metres.
const BODY_DEPTH_M: f64 = 0.2;

/// A depth image in cells of 4 x 4 pixels.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct FreeSpace {
    /// Nearest and farthest depth in the 3 x 3 cells around, metres; 0 where there is none.
    near: Image<f32>,
    far: Image<f32>,
    /// The mask of what moves there, if it is known.
    moving: Option<MaskImage>,
}

/// A point as seen by a depth image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Visibility {
    /// Outside the image, or no depth there.
    Unknown,
    /// Behind the surface.
    Occluded,
    /// On a surface with this label.
    OnSurface(Label),
    /// In front of the nearest surface around, by this many standard deviations of the sensor.
    InFront(f64),
}

impl FreeSpace {
    /// Depth in metres; 0, NaN and depths beyond `max_depth_m` are missing.
    #[must_use]
    pub fn new(depth: &DepthImage, max_depth_m: f64) -> Self {
        let (width, height) = depth.size();
        let (columns, rows) = (width.div_ceil(CELL_PX), height.div_ceil(CELL_PX));
        let mut near = Image::new(columns, rows, f32::INFINITY);
        let mut far = Image::new(columns, rows, 0.0f32);
        for y in 0..height {
            let row = y / CELL_PX;
            for (x, &z) in depth.row(y).iter().enumerate() {
                if z > 0.0 && f64::from(z) <= max_depth_m {
                    let cell = (x / CELL_PX, row);
                    near[cell] = near[cell].min(z);
                    far[cell] = far[cell].max(z);
                }
            }
        }
        let least = around(&near, f32::INFINITY, f32::min);
        Self {
            near: least.map(|z| if z.is_finite() { *z } else { 0.0 }),
            far: around(&far, 0.0, f32::max),
            moving: None,
        }
    }

    /// Sets the mask of what moves (255), in cells.
    pub fn set_moving(&mut self, cells: MaskImage) {
        self.moving = Some(cells);
    }

    /// Depth of the nearest surface around a point of the camera's frame; `None` outside the image and
    /// without depth.
    #[must_use]
    pub fn nearest_m(&self, p_cam: &Vector3<f64>, camera: &Camera) -> Option<f64> {
        let (x, y) = cell_of(p_cam, camera)?;
        let near = f64::from(*self.near.get(x, y)?);
        (near > 0.0).then_some(near)
    }

    /// The visibility of a point in this image, taken by `camera` from this pose.
    #[must_use]
    pub fn query(
        &self,
        p_world: &Vector3<f64>,
        camera: &Camera,
        camera_from_world: &Se3,
        noise: &DepthNoise,
    ) -> Visibility {
        let p_cam = *camera_from_world * *p_world;
        let Some((x, y)) = cell_of(&p_cam, camera) else {
            return Visibility::Unknown;
        };
        let (Some(&near), Some(&far)) = (self.near.get(x, y), self.far.get(x, y)) else {
            return Visibility::Unknown;
        };
        if near <= 0.0 {
            return Visibility::Unknown;
        }
        let (z, near, far) = (p_cam.z, f64::from(near), f64::from(far));
        let sigma_m = noise.sigma_m(near);
        if z < near - sigma_m {
            Visibility::InFront((near - z) / sigma_m)
        } else if z <= far + 3.0 * sigma_m {
            let moving = self.moving.as_ref().and_then(|m| m.get(x, y)) == Some(&MOVING);
            match moving {
                false => Visibility::OnSurface(Label::Static),
                // A surface well behind the moving object's nearest point is not part of it.
                true if z > near + BODY_DEPTH_M => Visibility::Occluded,
                true => Visibility::OnSurface(Label::Dynamic),
            }
        } else {
            Visibility::Occluded
        }
    }
}

/// The cell a point of the camera's frame falls into; `None` behind the camera or outside the image.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "compared with the image's bounds before the cast"
)]
fn cell_of(p_cam: &Vector3<f64>, camera: &Camera) -> Option<(usize, usize)> {
    let px: Vector2<f64> = camera.distort_pixel(&camera.project(p_cam)?);
    let (x, y) = ((px.x + 0.5).floor(), (px.y + 0.5).floor());
    let inside = x >= 0.0 && y >= 0.0 && x < camera.width as f64 && y < camera.height as f64;
    inside.then_some((x as usize / CELL_PX, y as usize / CELL_PX))
}

/// `best` of the 3 x 3 cells around each.
fn around(cells: &Image<f32>, worst: f32, best: impl Fn(f32, f32) -> f32) -> Image<f32> {
    let (width, height) = cells.size();
    let of = |values: &mut dyn Iterator<Item = f32>| values.fold(worst, &best);
    let rows = Image::from_fn(width, height, |x, y| {
        let row = cells.row(y);
        of(&mut row[x.saturating_sub(1)..(x + 2).min(width)].iter().copied())
    });
    Image::from_fn(width, height, |x, y| {
        of(&mut (y.saturating_sub(1)..(y + 2).min(height)).map(|y| rows[(x, y)]))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera::pinhole((64, 48), [60.0, 60.0, 31.5, 23.5]).expect("valid")
    }

    fn query(free_space: &FreeSpace, p: [f64; 3]) -> Visibility {
        let noise = DepthNoise {
            per_m: 0.0,
            floor_m: 0.1,
        };
        free_space.query(&Vector3::from(p), &camera(), &Se3::identity(), &noise)
    }

    #[test]
    fn a_point_belongs_to_the_cell_of_the_nearest_pixel() {
        // At z = 60 m, x and y are pixels from (31.5, 23.5); pixels 0 to 3 are the first cell.
        let cell = |u: f64, v: f64| cell_of(&Vector3::new(u - 31.5, v - 23.5, 60.0), &camera());
        assert_eq!(cell(3.4, 0.0), Some((0, 0)), "pixel 3");
        assert_eq!(cell(3.6, 0.0), Some((1, 0)), "pixel 4");
        assert_eq!(cell(0.0, 7.4), Some((0, 1)), "pixel 7");
        assert_eq!(cell(0.0, 7.6), Some((0, 2)), "pixel 8");
        assert_eq!(cell(-0.4, 47.4), Some((0, 11)), "the outermost pixels");
        assert_eq!(cell(-0.6, 0.0), None, "left of them");
        assert_eq!(cell(0.0, 47.6), None, "below them");
    }

    #[test]
    fn in_front_on_behind_outside() {
        let mut free_space = FreeSpace::new(&DepthImage::new(64, 48, 3.0), 8.0);
        assert_eq!(
            query(&free_space, [0.0, 0.0, 2.5]),
            Visibility::InFront(5.0),
            "half a metre of free space, σ 0.1 m"
        );
        assert_eq!(
            query(&free_space, [0.0, 0.0, 2.95]),
            Visibility::OnSurface(Label::Static),
            "within a σ"
        );
        assert_eq!(
            query(&free_space, [0.0, 0.0, 3.5]),
            Visibility::Occluded,
            "behind"
        );
        assert_eq!(
            query(&free_space, [9.0, 0.0, 3.0]),
            Visibility::Unknown,
            "beside"
        );
        assert_eq!(
            query(&free_space, [0.0, 0.0, -1.0]),
            Visibility::Unknown,
            "behind the camera"
        );
        free_space.set_moving(MaskImage::new(16, 12, MOVING));
        assert_eq!(
            query(&free_space, [0.0, 0.0, 3.0]),
            Visibility::OnSurface(Label::Dynamic),
            "on something that moved"
        );
    }

    #[test]
    fn no_point_is_in_front_beside_a_depth_edge() {
        let depth = DepthImage::from_fn(64, 48, |x, _| match x {
            0..=31 => 1.0,
            32..=47 => 3.0,
            _ => 0.0,
        });
        let free_space = FreeSpace::new(&depth, 8.0);
        // The ray of column 33 shows 3 m, but 1 m is a cell away.
        let beside_the_edge = [1.5 / 60.0 * 2.0, 0.0, 2.0];
        assert_eq!(
            query(&free_space, beside_the_edge),
            Visibility::OnSurface(Label::Static),
            "between the two surfaces"
        );
        let away_from_it = [11.0 / 60.0 * 2.0, 0.0, 2.0];
        assert_eq!(
            query(&free_space, away_from_it),
            Visibility::InFront(10.0),
            "only 3 m around"
        );
        let missing = [28.0 / 60.0 * 2.0, 0.0, 2.0];
        assert_eq!(query(&free_space, missing), Visibility::Unknown, "no depth");
    }

    /// The point that is seen at a pixel, at this depth.
    fn point(x: f64, y: f64, z: f64) -> [f64; 3] {
        camera().unproject(&Vector2::new(x, y), z).into()
    }

    /// One pixel of 2 m and one of 5 m before a wall at 3 m, in the cells (5, 3) and (10, 7): they count for the nine
    /// cells around them.
    #[test]
    fn the_nearest_and_the_farthest_of_nine_cells_count() {
        let mut depth = DepthImage::new(64, 48, 3.0);
        depth[(23, 12)] = 2.0;
        depth[(40, 31)] = 5.0;
        let free_space = FreeSpace::new(&depth, 8.0);
        for (x, y) in (0..12usize).flat_map(|y| (0..16usize).map(move |x| (x, y))) {
            let at = |z| point((4 * x) as f64 + 1.0, (4 * y) as f64 + 2.0, z);
            let near = x.abs_diff(5) <= 1 && y.abs_diff(3) <= 1;
            let found = free_space.nearest_m(&Vector3::from(at(7.0)), &camera());
            assert_eq!(found, Some(if near { 2.0 } else { 3.0 }), "({x}, {y})");
            let expected = match x.abs_diff(10) <= 1 && y.abs_diff(7) <= 1 {
                true => Visibility::OnSurface(Label::Static),
                false => Visibility::Occluded,
            };
            assert_eq!(query(&free_space, at(4.0)), expected, "({x}, {y})");
        }
    }

    #[test]
    fn depths_that_are_missing_or_too_far_are_unknown() {
        for (depth_m, nearest_m) in [
            (6.0, Some(6.0)),
            (6.25, None),
            (0.0, None),
            (-1.0, None),
            (f32::NAN, None),
            (f32::INFINITY, None),
        ] {
            let free_space = FreeSpace::new(&DepthImage::new(64, 48, depth_m), 6.0);
            let at = Vector3::new(0.1, -0.2, 1.0);
            assert_eq!(free_space.nearest_m(&at, &camera()), nearest_m, "{depth_m}");
            let is_unknown = query(&free_space, at.into()) == Visibility::Unknown;
            assert_eq!(is_unknown, nearest_m.is_none(), "{depth_m}");
            let behind = Vector3::new(0.0, 0.0, -1.0);
            assert_eq!(free_space.nearest_m(&behind, &camera()), None, "behind");
        }
    }

    /// Columns of 2 m and 3 m in turn; σ is 0.01 z² = 0.04 m at the nearest. A moving object is up to 0.2 m deep.
    #[test]
    fn sigma_is_that_of_the_nearest_depth() {
        let depth = DepthImage::from_fn(64, 48, |x, _| [2.0, 3.0][x % 2]);
        let mut free_space = FreeSpace::new(&depth, 8.0);
        let mut moving = MaskImage::new(16, 12, 0);
        moving[(3, 9)] = MOVING;
        moving[(5, 5)] = 128;
        free_space.set_moving(moving);
        let noise = DepthNoise {
            per_m: 0.01,
            floor_m: 0.001,
        };
        let query = |x, y, z| {
            let p = Vector3::from(point(x, y, z));
            free_space.query(&p, &camera(), &Se3::identity(), &noise)
        };
        use Visibility::{InFront, Occluded, OnSurface};
        let [still, moves] = [Label::Static, Label::Dynamic].map(OnSurface);
        for (z, at_rest, moving) in [
            (1.97, still, moves),
            (2.19, still, moves),
            (2.21, still, Occluded),
            (3.11, still, Occluded),
            (3.13, Occluded, Occluded),
        ] {
            for [x, y] in [[38.0, 14.0], [21.0, 22.0], [33.0, 33.0]] {
                assert_eq!(query(x, y, z), at_rest, "({x}, {y}), {z} m");
            }
            assert_eq!(query(13.0, 38.0, z), moving, "moving, {z} m");
        }
        for [x, y] in [[38.0, 14.0], [13.0, 38.0]] {
            for (z, expected) in [(1.95, 1.25), (1.0, 25.0)] {
                match query(x, y, z) {
                    InFront(sigmas) => assert!((sigmas - expected).abs() < 1e-9, "{sigmas}"),
                    other => panic!("{other:?} at {z} m"),
                }
            }
        }
    }

    /// Barrel distortion of the corner pulls it two pixels inwards, into another cell.
    #[test]
    fn cells_are_those_of_the_recorded_image() {
        let mut camera = camera();
        camera.distortion.k1 = -0.25;
        // r² = 0.49², and 1 - 0.25 r² = 0.940 of 29.4 px is 27.6 px.
        let p = Vector3::new(0.49, 0.0, 1.0);
        assert_eq!(cell_of(&p, &camera), Some((14, 6)), "pixel 59, not 61");
    }
}
