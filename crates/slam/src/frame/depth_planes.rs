//! [`DepthPlanes`]: a depth image as small planes, and the offsets between two such images.
//!
//! Keypoints alone cannot always separate a step to the side from a rotation: if all of them lie on
//! one plain wall, both motions move them alike, and a few keypoints on people who walk beside the
//! camera decide. Depth separates them. A rotation tilts the wall, and hundreds of pixels in a block
//! measure that tilt far below the noise of one.
//!
//! The image is cut into blocks, and in each the *inverse* depth is fitted by a linear function of
//! the pixel. For a plane n·X = d that is exact: X = z (x, y, 1) with (x, y) the normalised image
//! coordinates, so 1/z = (n₁ x + n₂ y + n₃) / d.
//!
//! ```text
//! block of this image ─→ its centre as a point ─→ moved into the other camera ─→ projects into a block
//!                                                                                        │
//!                        residual: distance of the point from that block's plane ←───────┘
//! ```

use garad_core::{Camera, DepthImage, MaskImage, Se3};
use garad_crf::DepthNoise;
use nalgebra::{Matrix3, RowVector6, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::mask::MOVING;

/// Side of a block, px.
const BLOCK_PX: usize = 16;
/// Share of a block's pixels that must have a depth.
const LEAST_COVERED: f64 = 0.75;
/// A block is a plane if its pixels stray from it by no more than so many standard deviations of
/// its mean (rmse). A single pixel strays by about four.
const FLAT_SIGMAS: f64 = 8.0;
/// Nearer than this a point counts as behind the camera, metres.
const MIN_DEPTH_M: f64 = 0.1;

/// A block's plane: inverse depth c + a (x - x₀) + b (y - y₀) at the recorded pixel (x, y).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
struct InverseDepthPlane {
    /// (x₀, y₀), px.
    middle_px: Vector2<f64>,
    /// (a, b), 1/(m px).
    slope: Vector2<f64>,
    /// c, 1/m.
    inverse_m: f64,
}

/// A depth image in blocks of 16 x 16 pixels; blocks that are no plane are left out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct DepthPlanes {
    columns: usize,
    rows: usize,
    planes: Vec<Option<InverseDepthPlane>>,
}

/// Distance of a block's centre from a plane of the other image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Offset {
    /// (1/z - w) z² for a point at depth z where the plane has the inverse depth w: to first order
    /// the distance along the ray, metres, positive in front of the plane.
    pub(crate) residual_m: f64,
    /// z.
    pub(crate) depth_m: f64,
    /// ∂ residual / ∂ξ, the pose moved to exp(ξ) * `camera_from_world`.
    pub(crate) jacobian: RowVector6<f64>,
}

impl DepthPlanes {
    /// Depth in metres; 0, NaN and what lies beyond `max_depth_m` are missing. `noise`: of a block's
    /// mean.
    pub(crate) fn new(depth: &DepthImage, max_depth_m: f64, noise: &DepthNoise) -> Self {
        let (width, height) = depth.size();
        let (columns, rows) = (width / BLOCK_PX, height / BLOCK_PX);
        let blocks = (0..rows).flat_map(|y| (0..columns).map(move |x| (x, y)));
        Self {
            columns,
            rows,
            planes: blocks
                .map(|(x, y)| {
                    InverseDepthPlane::fit(depth, x * BLOCK_PX, y * BLOCK_PX, max_depth_m, noise)
                })
                .collect(),
        }
    }

    /// Per block, row by row: x₀, y₀, a, b, c; NaN where there is no plane.
    pub(crate) fn rows_of_numbers(&self) -> Vec<f64> {
        let row = |plane: &Option<InverseDepthPlane>| {
            plane.map_or([f64::NAN; 5], |p| {
                [
                    p.middle_px.x,
                    p.middle_px.y,
                    p.slope.x,
                    p.slope.y,
                    p.inverse_m,
                ]
            })
        };
        self.planes.iter().flat_map(row).collect()
    }

    /// Leaves out the blocks where something moves (255 in the image's mask).
    pub(crate) fn without_moving(mut self, mask: &MaskImage) -> Self {
        for (i, plane) in self.planes.iter_mut().enumerate() {
            let (x0, y0) = ((i % self.columns) * BLOCK_PX, (i / self.columns) * BLOCK_PX);
            let moves = |y: usize| mask.row(y)[x0..x0 + BLOCK_PX].contains(&MOVING);
            if (y0..y0 + BLOCK_PX).any(moves) {
                *plane = None;
            }
        }
        self
    }

    /// How many planes there are.
    pub(crate) fn count(&self) -> usize {
        self.planes.iter().flatten().count()
    }

    /// The plane at a recorded pixel.
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "compared with the bounds before the cast"
    )]
    fn at(&self, px: &Vector2<f64>) -> Option<&InverseDepthPlane> {
        let block = (px + Vector2::repeat(0.5)) / BLOCK_PX as f64;
        let inside = block.x >= 0.0
            && block.y >= 0.0
            && block.x < self.columns as f64
            && block.y < self.rows as f64;
        inside.then(|| self.planes[block.y as usize * self.columns + block.x as usize].as_ref())?
    }

    /// This image's blocks, taken from `camera_from_world`, against `other`, taken from
    /// `other_from_world`: one offset for each that projects onto a plane.
    pub(crate) fn offsets<'a>(
        &'a self,
        camera_from_world: &Se3,
        other: &'a Self,
        other_from_world: &Se3,
        camera: &'a Camera,
    ) -> impl Iterator<Item = Offset> + 'a {
        let other_from_camera = *other_from_world * camera_from_world.inverse();
        let rotation = other_from_camera.rotation.matrix();
        let translation = other_from_camera.translation;
        self.planes.iter().flatten().filter_map(move |own| {
            let uv_px = camera.undistort_pixel(&own.middle_px)?;
            let p_cam = camera.unproject(&uv_px, 1.0 / own.inverse_m);
            let p = rotation * p_cam + translation;
            if p.z < MIN_DEPTH_M {
                return None;
            }
            let px = camera.distort_pixel(&camera.project(&p)?);
            let plane = other.at(&px)?;
            let expected = plane.inverse_m + plane.slope.dot(&(px - plane.middle_px));
            if expected <= 0.0 {
                return None;
            }
            let inverse = 1.0 / p.z;
            let z2 = p.z * p.z;
            // ∂/∂p of (1/z - w) at a fixed factor z², and with a lens that does not bend over a
            // pixel or two: both are left out of the Jacobian, not of the residual.
            let du = Vector3::new(
                camera.fx * inverse,
                0.0,
                -camera.fx * p.x * inverse * inverse,
            );
            let dv = Vector3::new(
                0.0,
                camera.fy * inverse,
                -camera.fy * p.y * inverse * inverse,
            );
            let along_z = Vector3::new(0.0, 0.0, -inverse * inverse);
            let gradient = (along_z - du * plane.slope.x - dv * plane.slope.y) * z2;
            // p = A exp(-ξ) p_cam: ∂p/∂ξ = R (-I, [p_cam]×).
            let g = rotation.transpose() * gradient;
            let turn = g.cross(&p_cam);
            Some(Offset {
                residual_m: (inverse - expected) * z2,
                depth_m: p.z,
                jacobian: RowVector6::new(-g.x, -g.y, -g.z, turn.x, turn.y, turn.z),
            })
        })
    }
}

impl InverseDepthPlane {
    /// Least squares over the block whose first pixel is (x0, y0).
    fn fit(
        depth: &DepthImage,
        x0: usize,
        y0: usize,
        max_depth_m: f64,
        noise: &DepthNoise,
    ) -> Option<Self> {
        let half = (BLOCK_PX as f64 - 1.0) / 2.0;
        // Sums of 1, x, y and their products, x and y from the middle; w is the inverse depth.
        let (mut n, mut x, mut y, mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        let (mut w, mut xw, mut yw, mut ww) = (0.0, 0.0, 0.0, 0.0);
        for row in 0..BLOCK_PX {
            let dy = row as f64 - half;
            for (column, z) in depth.row(y0 + row)[x0..x0 + BLOCK_PX].iter().enumerate() {
                let z = f64::from(*z);
                if z > 0.0 && z <= max_depth_m {
                    let (dx, inverse) = (column as f64 - half, 1.0 / z);
                    n += 1.0;
                    x += dx;
                    y += dy;
                    xx += dx * dx;
                    xy += dx * dy;
                    yy += dy * dy;
                    w += inverse;
                    xw += dx * inverse;
                    yw += dy * inverse;
                    ww += inverse * inverse;
                }
            }
        }
        if n < LEAST_COVERED * (BLOCK_PX * BLOCK_PX) as f64 {
            return None;
        }
        let normal = Matrix3::new(xx, xy, x, xy, yy, y, x, y, n);
        let right = Vector3::new(xw, yw, w);
        let plane = normal.cholesky()?.solve(&right);
        let depth_m = 1.0 / plane.z;
        let rmse = ((ww - plane.dot(&right)).max(0.0) / n).sqrt() * depth_m * depth_m;
        (plane.z > 0.0 && rmse <= FLAT_SIGMAS * noise.sigma_m(depth_m)).then_some(Self {
            middle_px: Vector2::new(x0 as f64 + half, y0 as f64 + half),
            slope: plane.xy(),
            inverse_m: plane.z,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOISE: DepthNoise = DepthNoise {
        per_m: 7.5e-4,
        floor_m: 2.5e-3,
    };

    fn camera() -> Camera {
        Camera::pinhole((160, 128), [140.0, 145.0, 79.5, 63.5]).expect("valid")
    }

    /// What a camera sees of the plane n·X = 1 (world).
    fn depth_image(n: Vector3<f64>, camera_from_world: &Se3) -> DepthImage {
        let camera = camera();
        let world_from_camera = camera_from_world.inverse();
        let rotation = world_from_camera.rotation.matrix();
        DepthImage::from_fn(160, 128, |x, y| {
            let ray = camera.unproject(&Vector2::new(x as f64, y as f64), 1.0);
            // n·(R z ray + t) = 1
            let z = (1.0 - n.dot(&world_from_camera.translation)) / n.dot(&(rotation * ray));
            #[allow(clippy::cast_possible_truncation, reason = "a depth image is f32")]
            let z = z as f32;
            z
        })
    }

    fn offsets(now: &DepthPlanes, pose: &Se3, then: &DepthPlanes) -> Vec<Offset> {
        now.offsets(pose, then, &Se3::identity(), &camera())
            .collect()
    }

    #[test]
    fn a_plane_is_linear_in_inverse_depth() {
        let n = Vector3::new(0.1, -0.05, 0.4);
        let surface = DepthPlanes::new(&depth_image(n, &Se3::identity()), 8.0, &NOISE);
        assert_eq!(surface.planes.len(), 80, "10 x 8 blocks");
        for plane in surface.planes.iter().flatten() {
            let uv = camera().unproject(&plane.middle_px, 1.0);
            assert!((plane.inverse_m - n.dot(&uv)).abs() < 1e-7, "{plane:?}");
            assert!((plane.slope.x - 0.1 / 140.0).abs() < 1e-8, "{plane:?}");
            assert!((plane.slope.y + 0.05 / 145.0).abs() < 1e-8, "{plane:?}");
        }
        assert_eq!(surface.planes.iter().flatten().count(), 80, "all of them");
    }

    #[test]
    fn edges_and_holes_have_no_plane() {
        let mut depth = DepthImage::new(160, 128, 2.0);
        for y in 0..128 {
            depth.row_mut(y)[8..16].fill(2.5); // an edge through the first column
        }
        for y in 0..5 {
            depth.row_mut(y)[32..48].fill(0.0); // 80 of 256 pixels: 0.31
        }
        for y in 16..20 {
            depth.row_mut(y)[32..48].fill(0.0); // 64 of 256: exactly a quarter
        }
        for y in 0..16 {
            depth.row_mut(y)[64..80].fill(9.0); // too far
        }
        let surface = DepthPlanes::new(&depth, 8.0, &NOISE);
        let there = |x: usize, y: usize| surface.planes[y * 10 + x].is_some();
        assert!(!there(0, 0) && !there(0, 5), "an edge");
        assert!(!there(2, 0) && there(2, 1), "holes");
        assert!(!there(4, 0) && there(5, 0), "beyond the range");
    }

    /// The same wall from two places: no offset at the right pose; a camera thought 1 cm farther back
    /// than it is puts its points 1 cm in front of the wall.
    #[test]
    fn offsets_are_metres_along_the_ray() {
        let n = Vector3::new(0.0, 0.0, 0.5);
        let then = DepthPlanes::new(&depth_image(n, &Se3::identity()), 8.0, &NOISE);
        let pose = Se3::exp(&[0.05, -0.03, -0.1, 0.02, -0.04, 0.01].into());
        let now = DepthPlanes::new(&depth_image(n, &pose), 8.0, &NOISE);
        let right = offsets(&now, &pose, &then);
        assert!(right.len() > 60, "{} of 80 blocks", right.len());
        for offset in &right {
            assert!(offset.residual_m.abs() < 1e-6, "{offset:?}");
            assert!((offset.depth_m - 2.0).abs() < 1e-6, "{offset:?}");
        }
        // camera_from_world moved by +z: the camera itself moves by -z.
        let back = Se3::exp(&[0.0, 0.0, 0.01, 0.0, 0.0, 0.0].into()) * pose;
        for offset in offsets(&now, &back, &then) {
            assert!((offset.residual_m - 0.01).abs() < 6e-4, "{offset:?}");
        }
    }

    #[test]
    fn jacobians_are_derivatives() {
        let n = Vector3::new(0.12, 0.2, 0.45);
        let then = DepthPlanes::new(&depth_image(n, &Se3::identity()), 8.0, &NOISE);
        let pose = Se3::exp(&[0.03, -0.02, 0.04, 0.01, -0.03, 0.02].into());
        let now = DepthPlanes::new(&depth_image(n, &pose), 8.0, &NOISE);
        let at = offsets(&now, &pose, &then);
        for k in 0..6 {
            let step = 1e-5;
            let moved = |sign: f64| {
                let mut xi = nalgebra::Vector6::zeros();
                xi[k] = sign * step;
                offsets(&now, &(Se3::exp(&xi) * pose), &then)
            };
            let (plus, minus) = (moved(1.0), moved(-1.0));
            assert_eq!(plus.len(), at.len(), "the same blocks");
            for ((p, m), o) in plus.iter().zip(&minus).zip(&at) {
                let slope = (p.residual_m - m.residual_m) / (2.0 * step);
                let error = (slope - o.jacobian[k]).abs();
                // The factor z² is held fixed, which is exact where the residual is 0.
                assert!(error < 1e-4 * (1.0 + slope.abs()), "{k}: {slope}, {o:?}");
            }
        }
    }

    #[test]
    fn blocks_that_move_are_left_out() {
        let mut mask = MaskImage::new(160, 128, 0);
        mask[(31, 16)] = MOVING; // the last column of a block, its first row
        let surface = DepthPlanes::new(&DepthImage::new(160, 128, 2.0), 8.0, &NOISE);
        let surface = surface.without_moving(&mask);
        let left_out: Vec<usize> = (0..80).filter(|&i| surface.planes[i].is_none()).collect();
        assert_eq!(left_out, [11], "column 1 of row 1");
    }

    #[test]
    fn blocks_outside_the_other_image_have_no_offset() {
        let wall = DepthPlanes::new(&DepthImage::new(160, 128, 2.0), 8.0, &NOISE);
        let turned = Se3::exp(&[0.0, 0.0, 0.0, 0.0, 2.0, 0.0].into());
        assert!(offsets(&wall, &turned, &wall).is_empty(), "looks away");
        let aside = Se3::exp(&[1.15, 0.0, 0.0, 0.0, 0.0, 0.0].into());
        // 1.15 m at 2 m are 80.5 px: five of ten columns are left.
        assert_eq!(offsets(&wall, &aside, &wall).len(), 40, "half of it");
    }

    /// Pixels alternately δ nearer and farther: rmse δ. σ = max(7.5e-4 z², 2.5 mm), eight times that is the limit.
    #[test]
    fn a_block_is_flat_to_eight_standard_deviations() {
        for (z, delta, flat) in [
            (2.0, 0.0236, true),
            (2.0, 0.0244, false),
            (1.0, 0.0196, true), // the floor
            (1.0, 0.0204, false),
        ] {
            let sign = |x, y| if (x + y) % 2 == 0 { 1.0 } else { -1.0 };
            let depth = DepthImage::from_fn(32, 16, |x, y| z + delta * sign(x, y));
            let planes = DepthPlanes::new(&depth, 8.0, &NOISE);
            assert_eq!(
                planes.count(),
                if flat { 2 } else { 0 },
                "{delta} m at {z} m"
            );
        }
    }

    #[test]
    fn blocks_are_found_by_pixel() {
        let planes = DepthPlanes::new(&DepthImage::new(160, 128, 2.0), 8.0, &NOISE);
        for (px, middle) in [
            ([-0.5, 3.0], Some([7.5, 7.5])),
            ([-0.51, 3.0], None),
            ([3.0, -0.51], None),
            ([15.49, 31.5], Some([7.5, 39.5])),
            ([15.5, 31.49], Some([23.5, 23.5])),
            ([159.4, 127.4], Some([151.5, 119.5])),
            ([159.6, 3.0], None),
            ([3.0, 127.6], None),
        ] {
            let found = planes.at(&Vector2::from(px)).map(|plane| plane.middle_px);
            assert_eq!(found, middle.map(Vector2::from), "{px:?}");
        }
        let far = DepthPlanes::new(&DepthImage::new(32, 16, 5.0), 5.0, &NOISE);
        assert_eq!(far.count(), 2, "as far as it may be");
    }
}
