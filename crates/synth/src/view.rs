//! [`View`]: the solids seen by one camera, sorted into tiles, and the rays cast into them.
//!
//! A ray is o + z d with d = ((u - cx)/fx, (v - cy)/fy, 1) in the camera's frame, so its parameter
//! is the depth. Each solid stores the position of the camera in its own frame and a 3x3 matrix that
//! rotates d there. A tile lists the solids whose bounding boxes project into it, nearest first: after
//! a hit, the first solid that begins behind it ends the search.

use garad_core::{Camera, Se3};
use nalgebra::{Matrix3, Vector3};

use crate::shape::Shape;
use crate::solid::Solid;

/// Side of a tile, pixels.
const TILE: usize = 8;
/// Near plane, metres.
const NEAR_M: f64 = 0.05;

/// What a ray hits.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Hit {
    /// Index of the solid.
    pub(crate) index: usize,
    /// Depth along the optical axis, metres.
    pub(crate) z: f64,
}

#[derive(Debug, Clone, Copy)]
struct Seen {
    camera_in_solid: Vector3<f64>,
    solid_from_camera: Matrix3<f64>,
    /// Depth of its nearest part.
    z_min: f64,
}

/// One camera's view of the solids.
#[derive(Debug)]
pub(crate) struct View {
    pub(crate) camera: Camera,
    pub(crate) solids: Vec<Solid>,
    seen: Vec<Seen>,
    columns: usize,
    rows: usize,
    /// `lists[starts[t]..starts[t + 1]]`: the solids of tile t, nearest first.
    starts: Vec<usize>,
    lists: Vec<u32>,
}

impl View {
    pub(crate) fn new(camera: Camera, world_from_camera: &Se3, solids: Vec<Solid>) -> Self {
        let columns = camera.width.div_ceil(TILE);
        let rows = camera.height.div_ceil(TILE);
        let mut seen = Vec::with_capacity(solids.len());
        let mut boxes = Vec::new();
        for (index, solid) in solids.iter().enumerate() {
            let solid_from_camera = solid.world_from_solid.inverse() * *world_from_camera;
            let bounds = Self::bounds(&camera, solid, &solid_from_camera.inverse());
            let z_min = bounds.map_or(0.0, |b| b.0);
            seen.push(Seen {
                camera_in_solid: solid_from_camera.translation,
                solid_from_camera: solid_from_camera.rotation.matrix(),
                z_min,
            });
            if let Some((_, pixels)) = bounds {
                boxes.push((z_min, index, tile_range(pixels, columns, rows)));
            }
        }
        boxes.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let (starts, lists) = tile_lists(&boxes, columns, rows);
        Self {
            camera,
            solids,
            seen,
            columns,
            rows,
            starts,
            lists,
        }
    }

    /// (nearest depth, [u0, u1, v0, v1]) of the part of the bounding box beyond [`NEAR_M`]; `None`
    /// if there is none.
    ///
    /// That part is a convex solid whose corners are those of the box beyond the plane and the points
    /// where the box's edges cross it.
    fn bounds(camera: &Camera, solid: &Solid, camera_from_solid: &Se3) -> Option<(f64, [f64; 4])> {
        if let Shape::Room { .. } = solid.shape {
            // behind everything else, and hit by every ray that hits nothing else
            let everywhere = [0.0, camera.width as f64, 0.0, camera.height as f64];
            return Some((f64::MAX, everywhere));
        }
        let r = camera_from_solid.rotation.matrix();
        let corners = solid
            .shape
            .corners()
            .map(|p| r * p + camera_from_solid.translation);
        let mut z_min = f64::MAX;
        let mut pixels = [f64::MAX, f64::MIN, f64::MAX, f64::MIN];
        let mut include = |p: &Vector3<f64>| {
            let u = camera.fx * p.x / p.z + camera.cx;
            let v = camera.fy * p.y / p.z + camera.cy;
            z_min = z_min.min(p.z);
            pixels = [
                pixels[0].min(u),
                pixels[1].max(u),
                pixels[2].min(v),
                pixels[3].max(v),
            ];
        };
        for (k, p) in corners.iter().enumerate() {
            if p.z >= NEAR_M {
                include(p);
            }
            // the three edges from a corner lead to those whose number differs in one bit
            for other in [k | 1, k | 2, k | 4].map(|other| &corners[other]) {
                if (p.z < NEAR_M) != (other.z < NEAR_M) {
                    let s = (NEAR_M - p.z) / (other.z - p.z);
                    let crossing = p + (other - p) * s;
                    include(&Vector3::new(crossing.x, crossing.y, NEAR_M));
                }
            }
        }
        (z_min < f64::MAX).then_some((z_min, pixels))
    }

    /// Direction of the ray through a pixel, z = 1, in the camera's frame.
    #[inline]
    pub(crate) fn direction(&self, u: f64, v: f64) -> Vector3<f64> {
        let c = &self.camera;
        Vector3::new((u - c.cx) / c.fx, (v - c.cy) / c.fy, 1.0)
    }

    /// The first solid on the ray through a pixel of the image.
    #[inline]
    pub(crate) fn cast(&self, u: f64, v: f64) -> Option<Hit> {
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "the tile of a pixel, clamped to the border"
        )]
        let tile = |x: f64, count: usize| ((x.max(0.0) / TILE as f64) as usize).min(count - 1);
        let t = tile(v, self.rows) * self.columns + tile(u, self.columns);
        let d = self.direction(u, v);
        let mut best: Option<Hit> = None;
        for &index in &self.lists[self.starts[t]..self.starts[t + 1]] {
            let index = index as usize;
            let seen = &self.seen[index];
            let limit = best.map_or(f64::INFINITY, |hit| hit.z);
            if seen.z_min > limit {
                break;
            }
            let d = seen.solid_from_camera * d;
            if let Some(z) = self.solids[index]
                .shape
                .intersect(&seen.camera_in_solid, &d)
                && z < limit
            {
                best = Some(Hit { index, z });
            }
        }
        best
    }

    /// The point hit, in the frame of its solid.
    #[inline]
    pub(crate) fn point_in_solid(&self, hit: &Hit, u: f64, v: f64) -> Vector3<f64> {
        let seen = &self.seen[hit.index];
        seen.camera_in_solid + seen.solid_from_camera * (self.direction(u, v) * hit.z)
    }

    /// The ray's direction (z = 1 in the camera) in the frame of a solid.
    #[inline]
    pub(crate) fn direction_in_solid(&self, index: usize, u: f64, v: f64) -> Vector3<f64> {
        self.seen[index].solid_from_camera * self.direction(u, v)
    }
}

/// Tiles [c0, c1, r0, r1], ends included, that a box of pixels touches with a margin of one pixel;
/// `None` outside the image.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to the image before the cast"
)]
fn tile_range(pixels: [f64; 4], columns: usize, rows: usize) -> Option<[usize; 4]> {
    let range = |low: f64, high: f64, count: usize| {
        let (low, high) = (low - 1.0, high + 1.0);
        let end = (count * TILE) as f64;
        (high >= 0.0 && low < end).then(|| {
            let tile = |x: f64| ((x.clamp(0.0, end) / TILE as f64) as usize).min(count - 1);
            [tile(low), tile(high)]
        })
    };
    let [c0, c1] = range(pixels[0], pixels[1], columns)?;
    let [r0, r1] = range(pixels[2], pixels[3], rows)?;
    Some([c0, c1, r0, r1])
}

/// Lists of all tiles, each in the order of `boxes`.
fn tile_lists(
    boxes: &[(f64, usize, Option<[usize; 4]>)],
    columns: usize,
    rows: usize,
) -> (Vec<usize>, Vec<u32>) {
    let tiles = |range: &[usize; 4]| {
        let [c0, c1, r0, r1] = *range;
        (r0..=r1).flat_map(move |r| (c0..=c1).map(move |c| r * columns + c))
    };
    let mut starts = vec![0usize; columns * rows + 1];
    for (_, _, range) in boxes {
        for t in range.iter().flat_map(tiles) {
            starts[t + 1] += 1;
        }
    }
    for t in 0..columns * rows {
        starts[t + 1] += starts[t];
    }
    let mut next = starts.clone();
    let mut lists = vec![0u32; starts[columns * rows]];
    for (_, index, range) in boxes {
        for t in range.iter().flat_map(tiles) {
            #[allow(
                clippy::cast_possible_truncation,
                reason = "a room has a few hundred solids"
            )]
            let index = *index as u32;
            lists[next[t]] = index;
            next[t] += 1;
        }
    }
    (starts, lists)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::actor::Actor;
    use crate::camera_path::CameraPath;
    use crate::cast::{actors, furnishing};
    use crate::config::SceneName;
    use crate::material::Material;
    use crate::room::furnished;

    /// The wall is at 2.5 m in every pixel, except where the face of a box projects.
    #[test]
    fn depth_is_the_distance_along_the_axis() {
        let camera = Camera::pinhole((64, 48), [52.0, 52.0, 32.0, 23.0]).expect("a camera");
        let mut b = crate::solid::Builder::new(1);
        let tone = Material::Shade { tone: [0.5; 3] };
        let room = Shape::Room {
            half: Vector3::new(9.0, 9.0, 2.5),
        };
        b.solid(room, Se3::identity(), tone);
        b.block([0.2, 0.1, 1.5], [0.2, 0.1, 0.5], tone);
        let view = View::new(camera, &Se3::identity(), b.solids);
        for (y, x) in (0..48).flat_map(|y| (0..64).map(move |x| (y, x))) {
            let (u, v) = (f64::from(x), f64::from(y));
            let z = view.cast(u, v).expect("a closed room").z;
            // the front face spans x 0..0.4 and y 0..0.2 at z = 1, so 52 px to the metre
            let on_face = (32.0..32.0 + 20.8).contains(&u) && (23.0..23.0 + 10.4).contains(&v);
            let expected = if on_face { 1.0 } else { 2.5 };
            assert!((z - expected).abs() < 1e-14, "{z} at {u}, {v}");
        }
    }

    /// Tiles and depth order do not change the result of testing every ray against every solid.
    #[test]
    fn tiles_miss_no_solid() {
        let camera = Camera::pinhole((160, 120), [131.0, 131.0, 80.3, 58.9]).expect("a camera");
        for name in SceneName::all() {
            let solids: Vec<Solid> = furnished(furnishing(name), 1)
                .into_iter()
                .chain(actors(name, 1).iter().flat_map(|a: &Actor| a.solids(1.3)))
                .collect();
            let pose = CameraPath::new(name, 1).world_from_camera(1.3);
            let view = View::new(camera, &pose, solids);
            for k in 0..800u32 {
                let (u, v) = (
                    f64::from(k * 37 % 1600) * 0.1,
                    f64::from(k * 53 % 1200) * 0.1,
                );
                let d = view.direction(u, v);
                let mut nearest = f64::INFINITY;
                for (solid, seen) in view.solids.iter().zip(&view.seen) {
                    let d = seen.solid_from_camera * d;
                    if let Some(z) = solid.shape.intersect(&seen.camera_in_solid, &d) {
                        nearest = nearest.min(z);
                    }
                }
                let hit = view.cast(u, v).expect("the room is closed");
                assert_eq!(hit.z.to_bits(), nearest.to_bits(), "{name} at {u}, {v}");
            }
        }
    }
}
