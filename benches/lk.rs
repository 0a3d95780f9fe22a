//! Lucas-Kanade for 1000 points of a 640x480 picture, one thread: pyramid, tracking, plain loops.
//!
//! `cargo bench --bench lk`

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use garad_core::{GrayImage, Par, Real, Rng};
use garad_features::{LkConfig, LkPyramid, lk};

/// Smoothed noise, moved by (`dx`, `dy`) pixels.
fn clouds(dx: usize, dy: usize) -> GrayImage {
    let (width, height) = (700, 540);
    let mut rng = Rng::new(2);
    let mut noise = vec![0u32; width * height];
    noise.fill_with(|| if rng.below(12) == 0 { 255 * 8 } else { 0 });
    // Three passes of a box of 5 along both axes are nearly a Gaussian.
    for stride in [1, 1, 1, width, width, width] {
        let before = noise.clone();
        for i in 2 * stride..noise.len() - 2 * stride {
            noise[i] = (0..5)
                .map(|k| before[i + k * stride - 2 * stride])
                .sum::<u32>()
                / 5;
        }
    }
    GrayImage::from_fn(640, 480, |x, y| {
        let value = noise[(y + 30 - dy) * width + x + 30 - dx];
        u8::try_from(value.min(255)).expect("a byte")
    })
}

fn lucas_kanade(criterion: &mut Criterion) {
    let (first, second) = (clouds(0, 0), clouds(3, 2));
    criterion.bench_function("lk/pyramid", |bencher| {
        bencher.iter(|| LkPyramid::new(black_box(&first), 3));
    });
    let prev = LkPyramid::new(&first, 3).expect("not empty");
    let next = LkPyramid::new(&second, 3).expect("not empty");
    let mut rng = Rng::new(3);
    let mut point = || [rng.range(15.0, 625.0), rng.range(15.0, 465.0)].map(Real::to_f32);
    let points: Vec<[f32; 2]> = (0..1000).map(|_| point()).collect();
    let config = LkConfig::default();
    for par in [Par::Seq, Par::Threads(2)] {
        criterion.bench_function(&format!("lk/track_1000_{}", par.threads()), |bencher| {
            bencher.iter(|| lk::track(&prev, &next, black_box(&points), None, &config, par));
        });
    }
    criterion.bench_function("lk/track_100_reference", |bencher| {
        let few = &points[..100];
        bencher.iter(|| lk::track_reference(&prev, &next, black_box(few), None, &config, Par::Seq));
    });
}

criterion_group!(benches, lucas_kanade);
criterion_main!(benches);
