//! One training iteration at full size: target, render, loss, backward, Adam.
//!
//! `cargo bench --bench training`

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use garad_core::{Camera, GaussianMap, KeyframeId, NewGaussian, Par, Real, RgbImage, Rng, Se3};
use garad_slam::config::TrainConfig;
use garad_slam::mapping::train::{Pick, Trainer, TrainingScene};
use garad_slam::mapping::view::TrainingView;
use garad_slam::trace::Recorder;

/// Splats of about 2 px over the whole image, at 1 to 4 m.
fn room(n: usize, camera: &Camera) -> GaussianMap<f32> {
    let mut rng = Rng::keyed(7, &[n as u64]);
    let mut map = GaussianMap::new(0);
    for _ in 0..n {
        let z = rng.range(1.0, 4.0);
        let u = rng.range(0.0, camera.width as f64);
        let v = rng.range(0.0, camera.height as f64);
        let mean = [
            (u - camera.cx) / camera.fx * z,
            (v - camera.cy) / camera.fy * z,
            z,
        ];
        map.push(&NewGaussian {
            mean: mean.map(Real::to_f32),
            sigma_m: 0.006,
            opacity: rng.range(0.1, 0.95).to_f32(),
            color: [0; 3].map(|_| rng.uniform().to_f32()),
            landmark: None,
            born: KeyframeId(0),
        });
    }
    map
}

fn training(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("training_iteration");
    group.sample_size(10);
    let config = TrainConfig {
        uses_per_level: 0,
        ..TrainConfig::default()
    };
    for (width, height) in [(320, 240), (640, 480), (1280, 960)] {
        let scale = width as f64 / 640.0;
        let k = [535.4, 539.2, 320.1, 247.6].map(|v| v * scale);
        let camera = Camera::pinhole((width, height), k).expect("freiburg3");
        let mut rng = Rng::new(3);
        let rgb = RgbImage::from_fn(width, height, |_, _| {
            [0; 3].map(|_| u8::try_from(rng.below(256)).expect("a byte"))
        });
        for n in [10_000, 50_000, 200_000] {
            for threads in [1, 2] {
                let mut map = room(n, &camera);
                let mut trainer = Trainer::new(&camera, 0).expect("the usual numbers");
                trainer.add_view(TrainingView::new(KeyframeId(0), rgb.clone(), None, None, 0));
                let name = format!("{n}/{width}x{height}_{threads}_threads");
                group.bench_function(BenchmarkId::from_parameter(name), |bencher| {
                    bencher.iter(|| {
                        let scene = TrainingScene {
                            poses: &[Se3::identity()],
                            extent_m: 1.0,
                            window_runs: 10,
                        };
                        let (par, recorder) = (Par::new(threads), &mut Recorder::default());
                        let map = black_box(&mut map);
                        trainer
                            .step(map, Pick::Youngest, scene, &config, None, par, recorder)
                            .expect("an iteration")
                    });
                });
            }
        }
    }
    group.finish();
}

criterion_group!(benches, training);
criterion_main!(benches);
