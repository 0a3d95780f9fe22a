//! ORB on a textured 640x480 picture, 1000 features: the whole extractor and its parts.
//!
//! `cargo bench --bench orb`

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use garad_core::pyramid::GrayPyramid;
use garad_core::{GrayImage, Image, Par, Rng};
use garad_features::orb::{blur, brief, detect, orientation};
use garad_features::{OrbConfig, OrbExtractor};

/// Grey boxes of random place, size and shade, with a little noise.
fn boxes(width: usize, height: usize) -> GrayImage {
    let mut rng = Rng::new(1);
    let mut image = GrayImage::new(width, height, 90);
    for _ in 0..width * height / 400 {
        let (x0, y0) = (rng.below(width), rng.below(height));
        let (w, h) = (4 + rng.below(24), 4 + rng.below(24));
        let shade = u8::try_from(rng.below(248)).expect("a byte");
        for y in y0..(y0 + h).min(height) {
            image.row_mut(y)[x0..(x0 + w).min(width)].fill(shade);
        }
    }
    image.map(|&v| v + u8::try_from(rng.below(8)).expect("a byte"))
}

fn orb(criterion: &mut Criterion) {
    let image = boxes(640, 480);
    let config = OrbConfig::default();
    let mut extractor = OrbExtractor::new(config).expect("defaults are valid");
    for par in [Par::Seq, Par::Threads(2)] {
        let name = format!("orb/extract_{}", par.threads());
        criterion.bench_function(&name, |bencher| {
            bencher.iter(|| extractor.extract(black_box(&image), par));
        });
    }
    criterion.bench_function("orb/pyramid", |bencher| {
        bencher.iter(|| GrayPyramid::scaled(black_box(image.clone()), config.scale, config.levels));
    });
    let mut scores = GrayImage::default();
    criterion.bench_function("orb/detect_level_0", |bencher| {
        bencher.iter(|| detect::cell_corners(black_box(&image), &config, &mut scores));
    });
    let (mut rows, mut blurred) = (Image::default(), GrayImage::default());
    criterion.bench_function("orb/blur_level_0", |bencher| {
        bencher.iter(|| blur::blur_into(black_box(&image), &mut rows, &mut blurred));
    });
    criterion.bench_function("orb/angle", |bencher| {
        bencher.iter(|| orientation::angle_deg(black_box(&image), 300, 200));
    });
    criterion.bench_function("orb/describe", |bencher| {
        bencher.iter(|| brief::describe(black_box(&blurred), 300, 200, 33.0));
    });
}

criterion_group!(benches, orb);
criterion_main!(benches);
