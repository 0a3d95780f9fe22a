//! Depth at the time of the colour image (E26).
//!
//! A depth camera has a clock of its own: its image is taken up to half a frame before or after the colour image it
//! is paired with. At a hand's half radian per second a hundredth of a second is 3 pixels. Depth is then read beside
//! the keypoint it belongs to, and edges seem to move. With the motion ξ per frame interval Δ that the camera had
//! before, the camera at the time of depth, τ later than colour, is
//!
//! depth_from_colour = exp(τ/Δ ξ)
//!
//! and the point on a colour pixel's ray whose image in the depth camera has its own depth there is what the
//! depth camera saw:
//!
//! z ↦ z + (D(π(q)) - q_z),   q = depth_from_colour (z K⁻¹ (u, v, 1))
//!
//! Two rounds, from z = D(u, v). Distortion is left out: it bends a motion of a few pixels by a small part.

use garad_core::{Camera, DepthImage, Par, Se3};
use nalgebra::{Matrix3, Vector3};

/// Rounds of the fixed point: the first finds the pixel to within a surface's slope, the second its depth.
const ROUNDS: usize = 2;

/// What the depth camera, that far from the colour camera when it took its image, saw at each colour pixel.
/// Depth that is missing there or lies outside its image is missing.
pub(crate) fn depth_at_colour_time(
    depth: &DepthImage,
    camera: &Camera,
    depth_from_colour: &Se3,
    par: Par,
) -> DepthImage {
    let (width, height) = depth.size();
    let mut seen = DepthImage::new(width, height, 0.0);
    let rotation = depth_from_colour.rotation.matrix();
    let columns: Vec<f64> = (0..width)
        .map(|x| (x as f64 - camera.cx) / camera.fx)
        .collect();
    par.for_each_chunk_mut(seen.data_mut(), ROWS * width, |rows, out| {
        for (row, out) in out.chunks_exact_mut(width).enumerate() {
            let y = rows * ROWS + row;
            let ray_y = (y as f64 - camera.cy) / camera.fy;
            for ((out, &there), &ray_x) in out.iter_mut().zip(depth.row(y)).zip(&columns) {
                let ray = Vector3::new(ray_x, ray_y, 1.0);
                let pose = (&rotation, &depth_from_colour.translation);
                *out = seen_from_colour(depth, camera, pose, f64::from(there), ray);
            }
        }
    });
    seen
}

/// Rows handled as one piece of work.
const ROWS: usize = 16;

/// Depth on a colour pixel's ray, metres, from the depth `z` that the image has there; 0 if missing. The pose of the
/// depth camera as rotation and translation.
#[inline]
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "positions are inside the image before the cast; depth is stored in f32"
)]
fn seen_from_colour(
    depth: &DepthImage,
    camera: &Camera,
    (rotation, translation): (&Matrix3<f64>, &Vector3<f64>),
    mut z: f64,
    ray: Vector3<f64>,
) -> f32 {
    let (width, height) = (depth.width() as f64, depth.height() as f64);
    for _ in 0..ROUNDS {
        let q = rotation * (z * ray) + translation;
        let u = camera.fx * q.x / q.z + camera.cx + 0.5;
        let v = camera.fy * q.y / q.z + camera.cy + 0.5;
        // NaN and what lies outside fail here.
        if !(z > 0.0 && u >= 0.0 && v >= 0.0 && u < width && v < height) {
            return 0.0;
        }
        let there = depth[(u as u32 as usize, v as u32 as usize)];
        if there > 0.0 {
            z += f64::from(there) - q.z;
        } else {
            return 0.0;
        }
    }
    z as f32
}

#[cfg(test)]
mod tests {
    use garad_core::So3;

    use super::*;

    fn camera() -> Camera {
        Camera::pinhole((160, 120), [120.0, 120.0, 79.5, 59.5]).expect("valid")
    }

    /// Exact depth of the planes n·p = d, the nearest of them, from a pose.
    fn planes(world: &[(Vector3<f64>, f64)], camera_from_world: &Se3) -> DepthImage {
        let camera = camera();
        let world_from_camera = camera_from_world.inverse();
        let centre = world_from_camera.translation;
        DepthImage::from_fn(160, 120, |x, y| {
            let px = nalgebra::Vector2::new(x as f64, y as f64);
            let ray = world_from_camera.rotation * camera.unproject(&px, 1.0);
            let hits = world
                .iter()
                .map(|(n, d)| (d - n.dot(&centre)) / n.dot(&ray));
            let nearest = hits.filter(|z| *z > 0.0).fold(f64::INFINITY, f64::min);
            garad_core::Real::to_f32(nearest)
        })
    }

    fn largest_error(found: &DepthImage, expected: &DepthImage) -> f64 {
        let inner = (10..110).flat_map(|y| (10..150).map(move |x| (x, y)));
        let off = |p: (usize, usize)| f64::from((found[p] - expected[p]).abs());
        inner.map(off).fold(0.0, f64::max)
    }

    /// A floor and a wall from a camera that turns and moves: a third of an interval earlier.
    #[test]
    fn a_moving_camera_sees_what_it_would_have_seen() {
        let world = [
            (Vector3::new(0.0, 0.0, 1.0), 3.0),
            (Vector3::new(0.0, 1.0, 0.2), 1.2),
        ];
        let now = Se3::identity();
        let motion = Se3::exp(&[0.03, -0.02, 0.04, 0.02, -0.05, 0.03].into());
        let then = Se3::exp(&(motion.log() * (-1.0 / 3.0))) * now;
        let (before, exact) = (planes(&world, &then), planes(&world, &now));
        let found = depth_at_colour_time(&before, &camera(), &(then * now.inverse()), Par::Seq);
        let (uncorrected, corrected) = (
            largest_error(&before, &exact),
            largest_error(&found, &exact),
        );
        assert!(
            uncorrected > 0.03,
            "{uncorrected} m: 1 cm nearer, 1 degree turned"
        );
        // Half a pixel of the floor's slope is left, where it meets the wall at 3 m.
        assert!(
            corrected < 0.4 * uncorrected,
            "{corrected} of {uncorrected} m"
        );
    }

    #[test]
    fn moved_edges_are_where_they_were_and_what_is_missing_stays_so() {
        let edge_at = |column: usize| {
            DepthImage::from_fn(160, 120, |x, _| match x {
                x if x < column => 1.5,
                x if x < 140 => 3.0,
                _ => 0.0,
            })
        };
        // The camera had turned to the right by 2 px when depth was taken.
        let turned = So3::exp(&Vector3::new(0.0, -2.0 / 120.0, 0.0));
        let turned = Se3::new(turned, Vector3::zeros());
        let found = depth_at_colour_time(&edge_at(58), &camera(), &turned, Par::Seq);
        for y in [20, 60, 100] {
            let row = found.row(y);
            let edge = row.iter().position(|z| *z > 2.0).expect("the far part");
            assert!((59..=61).contains(&edge), "row {y}: {edge}, 60 is exact");
            assert!(row[150..].iter().all(|z| *z <= 0.0), "row {y}: missing");
        }
    }

    #[test]
    fn any_number_of_threads_gives_the_same_bits() {
        let depth = planes(&[(Vector3::new(0.1, 0.2, 1.0), 3.0)], &Se3::identity());
        let motion = Se3::exp(&[0.03, -0.02, 0.04, 0.02, -0.05, 0.03].into());
        let of = |par| depth_at_colour_time(&depth, &camera(), &motion, par);
        assert_eq!(of(Par::Seq), of(Par::Threads(3)));
    }

    /// A camera that goes towards a wall saw it 3 m away when it took depth: the colour image was taken 0.1 m
    /// before or after.
    #[test]
    fn a_step_ahead_is_added_to_the_depth() {
        for (step_m, expected) in [(-0.1, 3.1), (0.1, 2.9)] {
            let step = Se3::new(So3::identity(), Vector3::new(0.0, 0.0, step_m));
            let mut depth = DepthImage::new(160, 120, 3.0);
            depth[(80, 60)] = 0.0;
            let found = depth_at_colour_time(&depth, &camera(), &step, Par::Seq);
            let off = f64::from(found[(40, 30)]) - expected;
            assert!(off.abs() < 1e-6, "{step_m} m: {}", found[(40, 30)]);
            assert!(found[(80, 60)] <= 0.0, "missing");
        }
    }
}
