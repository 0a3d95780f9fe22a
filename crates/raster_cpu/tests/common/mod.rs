//! Scenes, gradients and types that several test files use.
#![allow(dead_code, reason = "each test file uses a part")]

use garad_core::{
    Camera, GaussianMap, Image, KeyframeId, Label, NewGaussian, Par, Real, Rng, Se3, So3,
};
use garad_raster::{Gradients, RasterError, RenderOptions, Rendered, Upstream};
use nalgebra::Vector3;

/// `render` or `fast::render`.
pub(crate) type Draw<T> =
    fn(&GaussianMap<T>, &Camera, &Se3, &RenderOptions, Par) -> Result<Rendered<T>, RasterError>;
/// `backward` or `fast::backward`.
pub(crate) type Back<T> = fn(
    &GaussianMap<T>,
    &Camera,
    &Se3,
    &RenderOptions,
    &Rendered<T>,
    &Upstream<T>,
    Par,
) -> Result<Gradients<T>, RasterError>;

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

/// Normal numbers everywhere.
pub(crate) fn upstream(seed: u64, camera: &Camera) -> Upstream<f64> {
    let mut rng = Rng::keyed(seed, &[1]);
    let (w, h) = (camera.width, camera.height);
    Upstream {
        color: Image::from_fn(w, h, |_, _| [0; 3].map(|_| rng.normal())),
        depth: Some(Image::from_fn(w, h, |_, _| rng.normal())),
        opacity: Some(Image::from_fn(w, h, |_, _| rng.normal())),
    }
}

pub(crate) fn narrow(up: &Upstream<f64>) -> Upstream<f32> {
    let image = |i: &Image<f64>| i.map(|v| v.to_f32());
    Upstream {
        color: up.color.map(|c| c.map(Real::to_f32)),
        depth: up.depth.as_ref().map(image),
        opacity: up.opacity.as_ref().map(image),
    }
}

pub(crate) fn flat<T: Real, const N: usize>(rows: &[[T; N]]) -> Vec<f64> {
    column(rows.as_flattened())
}

pub(crate) fn column<T: Real>(values: &[T]) -> Vec<f64> {
    values.iter().map(|v| v.to_f64()).collect()
}

/// Every gradient under the name it has in `case.json`.
pub(crate) fn tensors<T: Real>(g: &Gradients<T>) -> [(&'static str, Vec<f64>); 11] {
    [
        ("d_means", flat(&g.means)),
        ("d_log_scales", flat(&g.log_scales)),
        ("d_quaternions", flat(&g.quaternions)),
        ("d_opacity_logits", column(&g.opacity_logits)),
        ("d_sh", flat(&g.sh)),
        ("d_pose", column(&g.pose)),
        ("d_means2d", flat(&g.means2d)),
        ("d_conics", flat(&g.conics)),
        ("d_opacities", column(&g.opacities)),
        ("d_colors", flat(&g.colors)),
        ("d_depths", column(&g.depths)),
    ]
}

/// What f32 costs each of [`tensors`]: measured on a reference in f32 against itself in f64, largest
/// difference by largest value, for 20 000 Gaussians.
pub(crate) const GRADIENT_COST: [f64; 11] = [
    9.2e-6, 6.2e-6, 7.5e-6, 7.1e-6, 8.1e-6, 2.0e-5, 8.3e-6, 8.4e-6, 7.1e-6, 8.1e-6, 8.1e-6,
];
