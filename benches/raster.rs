//! The rasterizer, reference and fast, forward and both ways: 640x480, 10 000 to 200 000 Gaussians,
//! one and two threads, f32.

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use garad_core::{Camera, GaussianMap, Image, KeyframeId, NewGaussian, Par, Real, Rng, Se3};
use garad_raster::{
    Gradients, RasterError, RenderOptions, Rendered, Upstream, backward, fast, render,
};
use std::hint::black_box;

/// A room as mapping leaves it: centres spread over the picture at 1 to 4 m, half-axes about a
/// centimetre (1 to 5 px) with a spread of e^0.5 each, turned at random, opacities 0.1 to 0.95.
fn room(n: usize, camera: &Camera) -> GaussianMap<f32> {
    let mut rng = Rng::keyed(7, &[n as u64]);
    let mut map = GaussianMap::new(0);
    for _ in 0..n {
        let z = rng.range(1.0, 4.0);
        let u = rng.range(-20.0, camera.width as f64 + 20.0);
        let v = rng.range(-20.0, camera.height as f64 + 20.0);
        let mean = [
            (u - camera.cx) / camera.fx * z,
            (v - camera.cy) / camera.fy * z,
            z,
        ];
        let i = map.push(&NewGaussian {
            mean: mean.map(Real::to_f32),
            sigma_m: 0.01,
            opacity: rng.range(0.1, 0.95).to_f32(),
            color: [0; 3].map(|_| rng.uniform().to_f32()),
            landmark: None,
            born: KeyframeId(0),
        });
        for k in 0..3 {
            map.log_scales[i][k] += (0.5 * rng.normal()).to_f32();
        }
        map.quaternions[i] = [0; 4].map(|_| rng.normal().to_f32());
    }
    map
}

type Draw =
    fn(&GaussianMap<f32>, &Camera, &Se3, &RenderOptions, Par) -> Result<Rendered<f32>, RasterError>;
type Back = fn(
    &GaussianMap<f32>,
    &Camera,
    &Se3,
    &RenderOptions,
    &Rendered<f32>,
    &Upstream<f32>,
    Par,
) -> Result<Gradients<f32>, RasterError>;

const BOTH: [(&str, Draw, Back); 2] = [
    ("reference", render, backward),
    ("fast", fast::render, fast::backward),
];

/// Every size, implementation and number of threads, without and with the way back.
fn raster(criterion: &mut Criterion) {
    let camera = Camera::pinhole((640, 480), [535.4, 539.2, 320.1, 247.6]).expect("freiburg3");
    let (pose, options) = (Se3::default(), RenderOptions::default());
    let mut rng = Rng::new(3);
    let upstream = Upstream {
        color: Image::from_fn(640, 480, |_, _| [0; 3].map(|_| rng.normal().to_f32())),
        depth: Some(Image::from_fn(640, 480, |_, _| rng.normal().to_f32())),
        opacity: None,
    };
    let mut group = criterion.benchmark_group("raster");
    group.sample_size(20);
    for n in [10_000, 50_000, 200_000] {
        let map = room(n, &camera);
        for (name, draw, back) in BOTH {
            for threads in [1, 2] {
                let par = Par::new(threads);
                let picture = || draw(black_box(&map), &camera, &pose, &options, par);
                let id = |way: &str| {
                    BenchmarkId::new(
                        format!("{way}_{name}"),
                        format!("{n}_gaussians_{threads}_threads"),
                    )
                };
                group.bench_function(id("forward"), |bencher| {
                    bencher.iter(|| picture().expect("a picture"));
                });
                group.bench_function(id("forward_backward"), |bencher| {
                    bencher.iter(|| {
                        let picture = picture().expect("a picture");
                        back(&map, &camera, &pose, &options, &picture, &upstream, par)
                            .expect("gradients")
                    });
                });
            }
        }
    }
    group.finish();
}

criterion_group!(benches, raster);
criterion_main!(benches);
