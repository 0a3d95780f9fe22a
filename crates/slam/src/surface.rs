//! [`Surface`]: a depth picture as small planes, and how far one picture stands off another.
//!
//! Keypoints alone cannot always tell a step to the side from a turn: where all of them sit on one
//! plain wall, either moves them alike, and a few on people who walk beside the camera decide. The
//! wall's depth knows better. A turn tilts it, and hundreds of pixels in a block measure that tilt
//! far below the noise of one.
//!
//! The picture is cut into blocks, and in each the *inverse* depth is fitted by a linear function of
//! the pixel. For a plane n·X = d that is exact: X = z (x, y, 1) with (x, y) the ideal picture's
//! coordinates, so 1/z = (n₁ x + n₂ y + n₃) / d.
//!
//! ```text
//! block of this picture ─→ its middle as a point ─→ moved into the other camera ─→ falls into a block
//!                                                                                        │
//!                          residual: how far the point stands behind that block's plane ─┘
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
struct Patch {
    /// (x₀, y₀), px.
    middle_px: Vector2<f64>,
    /// (a, b), 1/(m px).
    slope: Vector2<f64>,
    /// c, 1/m.
    inverse_m: f64,
}

/// A depth picture in blocks of 16 x 16 pixels; what is no plane is left out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Surface {
    columns: usize,
    rows: usize,
    patches: Vec<Option<Patch>>,
}

/// How far a block's middle stands behind the other picture's plane.
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

impl Surface {
    /// Depth in metres; 0, NaN and what lies beyond `max_depth_m` are missing. `noise`: of a block's
    /// mean.
    pub(crate) fn new(depth: &DepthImage, max_depth_m: f64, noise: &DepthNoise) -> Self {
        let (width, height) = depth.size();
        let (columns, rows) = (width / BLOCK_PX, height / BLOCK_PX);
        let blocks = (0..rows).flat_map(|y| (0..columns).map(move |x| (x, y)));
        Self {
            columns,
            rows,
            patches: blocks
                .map(|(x, y)| Patch::fit(depth, x * BLOCK_PX, y * BLOCK_PX, max_depth_m, noise))
                .collect(),
        }
    }

    /// Per block, row by row: x₀, y₀, a, b, c; NaN where there is no plane.
    pub(crate) fn numbers(&self) -> Vec<f64> {
        let row = |patch: &Option<Patch>| {
            patch.map_or([f64::NAN; 5], |p| {
                [
                    p.middle_px.x,
                    p.middle_px.y,
                    p.slope.x,
                    p.slope.y,
                    p.inverse_m,
                ]
            })
        };
        self.patches.iter().flat_map(row).collect()
    }

    /// Leaves out the blocks where something moves (255 in the picture's mask).
    pub(crate) fn without_moving(mut self, mask: &MaskImage) -> Self {
        for (i, patch) in self.patches.iter_mut().enumerate() {
            let (x0, y0) = ((i % self.columns) * BLOCK_PX, (i / self.columns) * BLOCK_PX);
            let moves = |y: usize| mask.row(y)[x0..x0 + BLOCK_PX].contains(&MOVING);
            if (y0..y0 + BLOCK_PX).any(moves) {
                *patch = None;
            }
        }
        self
    }

    /// How many planes there are.
    pub(crate) fn planes(&self) -> usize {
        self.patches.iter().flatten().count()
    }

    /// The plane at a recorded pixel.
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "compared with the bounds before the cast"
    )]
    fn at(&self, px: &Vector2<f64>) -> Option<&Patch> {
        let block = (px + Vector2::repeat(0.5)) / BLOCK_PX as f64;
        let inside = block.x >= 0.0
            && block.y >= 0.0
            && block.x < self.columns as f64
            && block.y < self.rows as f64;
        inside.then(|| self.patches[block.y as usize * self.columns + block.x as usize].as_ref())?
    }

    /// This picture's blocks, taken from `camera_from_world`, against `other`, taken from
    /// `other_from_world`: one offset for each that falls onto a plane.
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
        self.patches.iter().flatten().filter_map(move |patch| {
            let uv_px = camera.undistort_pixel(&patch.middle_px)?;
            let p_cam = camera.unproject(&uv_px, 1.0 / patch.inverse_m);
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

impl Patch {
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
    fn picture(n: Vector3<f64>, camera_from_world: &Se3) -> DepthImage {
        let camera = camera();
        let world_from_camera = camera_from_world.inverse();
        let rotation = world_from_camera.rotation.matrix();
        DepthImage::from_fn(160, 128, |x, y| {
            let ray = camera.unproject(&Vector2::new(x as f64, y as f64), 1.0);
            // n·(R z ray + t) = 1
            let z = (1.0 - n.dot(&world_from_camera.translation)) / n.dot(&(rotation * ray));
            #[allow(clippy::cast_possible_truncation, reason = "a depth picture is f32")]
            let z = z as f32;
            z
        })
    }

    fn offsets(now: &Surface, pose: &Se3, then: &Surface) -> Vec<Offset> {
        now.offsets(pose, then, &Se3::identity(), &camera())
            .collect()
    }

    #[test]
    fn a_plane_is_linear_in_inverse_depth() {
        let n = Vector3::new(0.1, -0.05, 0.4);
        let surface = Surface::new(&picture(n, &Se3::identity()), 8.0, &NOISE);
        assert_eq!(surface.patches.len(), 80, "10 x 8 blocks");
        for patch in surface.patches.iter().flatten() {
            let uv = camera().unproject(&patch.middle_px, 1.0);
            assert!((patch.inverse_m - n.dot(&uv)).abs() < 1e-7, "{patch:?}");
            assert!((patch.slope.x - 0.1 / 140.0).abs() < 1e-8, "{patch:?}");
            assert!((patch.slope.y + 0.05 / 145.0).abs() < 1e-8, "{patch:?}");
        }
        assert_eq!(surface.patches.iter().flatten().count(), 80, "all of them");
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
        let surface = Surface::new(&depth, 8.0, &NOISE);
        let there = |x: usize, y: usize| surface.patches[y * 10 + x].is_some();
        assert!(!there(0, 0) && !there(0, 5), "an edge");
        assert!(!there(2, 0) && there(2, 1), "holes");
        assert!(!there(4, 0) && there(5, 0), "beyond the range");
    }

    /// The same wall from two places: no offset at the right pose; a camera thought 1 cm farther back
    /// than it is puts its points 1 cm in front of the wall.
    #[test]
    fn offsets_are_metres_along_the_ray() {
        let n = Vector3::new(0.0, 0.0, 0.5);
        let then = Surface::new(&picture(n, &Se3::identity()), 8.0, &NOISE);
        let pose = Se3::exp(&[0.05, -0.03, -0.1, 0.02, -0.04, 0.01].into());
        let now = Surface::new(&picture(n, &pose), 8.0, &NOISE);
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
        let then = Surface::new(&picture(n, &Se3::identity()), 8.0, &NOISE);
        let pose = Se3::exp(&[0.03, -0.02, 0.04, 0.01, -0.03, 0.02].into());
        let now = Surface::new(&picture(n, &pose), 8.0, &NOISE);
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
    fn what_moves_is_left_out() {
        let mut mask = MaskImage::new(160, 128, 0);
        mask[(31, 16)] = MOVING; // the last column of a block, its first row
        let surface = Surface::new(&DepthImage::new(160, 128, 2.0), 8.0, &NOISE);
        let surface = surface.without_moving(&mask);
        let left_out: Vec<usize> = (0..80).filter(|&i| surface.patches[i].is_none()).collect();
        assert_eq!(left_out, [11], "column 1 of row 1");
    }

    #[test]
    fn what_falls_beside_the_other_picture_has_no_offset() {
        let wall = Surface::new(&DepthImage::new(160, 128, 2.0), 8.0, &NOISE);
        let turned = Se3::exp(&[0.0, 0.0, 0.0, 0.0, 2.0, 0.0].into());
        assert!(offsets(&wall, &turned, &wall).is_empty(), "looks away");
        let aside = Se3::exp(&[1.15, 0.0, 0.0, 0.0, 0.0, 0.0].into());
        // 1.15 m at 2 m are 80.5 px: five of ten columns are left.
        assert_eq!(offsets(&wall, &aside, &wall).len(), 40, "half of it");
    }
}
