//! Scenes for the laws.

use garad_core::{Camera, GaussianMap, KeyframeId, Label, NewGaussian, Rng, Se3, So3};
use nalgebra::Vector3;

/// 70 x 50 px, the principal point well off the middle.
pub(crate) fn camera() -> Camera {
    Camera::pinhole((70, 50), [80.0, 75.0, 27.3, 31.8]).expect("valid")
}

/// A pose that mixes all axes.
pub(crate) fn pose() -> Se3 {
    Se3::new(
        So3::exp(&Vector3::new(0.3, -0.2, 0.4)),
        Vector3::new(0.2, -0.1, 0.3),
    )
}

/// `n` Gaussians of degree 1 in and around the view of [`camera`] at [`pose`], from specks to
/// splats of half the image, a fifth of them needles, a third of them dynamic.
pub(crate) fn map(seed: u64, n: usize) -> GaussianMap<f64> {
    let mut rng = Rng::keyed(seed, &[n as u64]);
    let camera = camera();
    let world_from_camera = pose().inverse();
    let mut map = GaussianMap::new(1);
    for i in 0..n {
        let z = rng.range(0.1, 4.0);
        let p = Vector3::new(
            (rng.range(-30.0, 100.0) - camera.cx) / camera.fx * z,
            (rng.range(-30.0, 80.0) - camera.cy) / camera.fy * z,
            z,
        );
        let mean = world_from_camera * p;
        let k = map.push(&NewGaussian {
            mean: [mean.x, mean.y, mean.z],
            sigma_m: 0.02 + 0.2 * rng.uniform() * rng.uniform() * z,
            opacity: rng.range(0.02, 0.999),
            color: [rng.uniform(), rng.uniform(), rng.uniform()],
            landmark: None,
            born: KeyframeId(0),
        });
        map.quaternions[k] = [0; 4].map(|_| rng.normal());
        for axis in 0..3 {
            map.log_scales[k][axis] += 0.5 * rng.normal();
        }
        if i % 5 == 0 {
            map.log_scales[k][1] -= 6.0;
            map.log_scales[k][2] -= 6.0;
        }
        for c in 1..4 {
            map.sh[4 * k + c] = [0; 3].map(|_| 0.2 * rng.normal());
        }
        if i % 3 == 0 {
            map.label[k] = Label::Dynamic;
        }
    }
    map
}
