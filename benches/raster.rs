//! The rasterizer's forward pass: 640x480, 10 000 to 200 000 Gaussians, one and two threads, f32.

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use garad_core::{Camera, GaussianMap, KeyframeId, NewGaussian, Par, Real, Rng, Se3};
use garad_raster::{RenderOptions, render};
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

fn forward(criterion: &mut Criterion) {
    let camera = Camera::pinhole((640, 480), [535.4, 539.2, 320.1, 247.6]).expect("freiburg3");
    let mut group = criterion.benchmark_group("raster_forward");
    group.sample_size(20);
    for n in [10_000, 50_000, 200_000] {
        let map = room(n, &camera);
        for threads in [1, 2] {
            let id = BenchmarkId::new(format!("{n}_gaussians"), format!("{threads}_threads"));
            group.bench_function(id, |bencher| {
                bencher.iter(|| {
                    render(
                        black_box(&map),
                        &camera,
                        &Se3::default(),
                        &RenderOptions::default(),
                        Par::new(threads),
                    )
                    .expect("a picture")
                });
            });
        }
    }
    group.finish();
}

criterion_group!(benches, forward);
criterion_main!(benches);
