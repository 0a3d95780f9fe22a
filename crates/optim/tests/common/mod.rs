//! A camera, its pose, and points before it.

use garad_core::{Camera, Rng, Se3, So3};
use garad_optim::{DepthObservation, PoseObservation};
use nalgebra::{Vector2, Vector3};

pub(crate) fn camera() -> Camera {
    Camera::pinhole((640, 480), [535.4, 539.2, 320.1, 247.6]).expect("valid")
}

pub(crate) const BF: f64 = 40.0;

/// Points before a camera at `truth`, seen without noise; every second one with depth, in both
/// forms by turns.
pub(crate) fn observations(truth: &Se3, n: usize, seed: u64) -> Vec<PoseObservation> {
    let mut rng = Rng::keyed(seed, &[n as u64]);
    (0..n)
        .map(|i| {
            let uv_px = Vector2::new(rng.range(0.0, 640.0), rng.range(0.0, 480.0));
            let depth_m = rng.range(0.5, 6.0);
            let sigma_px = rng.range(1.0, 3.0);
            PoseObservation {
                p_world: truth.inverse() * camera().unproject(&uv_px, depth_m),
                uv_px,
                sigma_px,
                depth: match i % 4 {
                    0 => Some(DepthObservation::right_from_depth(
                        uv_px.x, sigma_px, depth_m, 0.01, BF,
                    )),
                    2 => Some(DepthObservation::disparity_from_depth(depth_m, 0.01, BF)),
                    _ => None,
                },
            }
        })
        .collect()
}

pub(crate) fn truth() -> Se3 {
    Se3::new(
        So3::exp(&Vector3::new(0.3, -0.5, 0.2)),
        Vector3::new(0.4, -0.2, 0.7),
    )
}
