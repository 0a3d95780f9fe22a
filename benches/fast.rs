//! FAST-9/16 on a textured 640x480 picture, one thread: the fast form and the plain loops.
//!
//! `cargo bench --bench fast`

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use garad_core::{GrayImage, Rng};
use garad_features::fast9::{self, Window};

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

fn fast(criterion: &mut Criterion) {
    let image = boxes(640, 480);
    let window = Window::inside(&image);
    let mut scores = GrayImage::default();
    criterion.bench_function("fast/scores", |bencher| {
        bencher.iter(|| fast9::fast::score_window(black_box(&image), 20, window, &mut scores));
    });
    criterion.bench_function("fast/scores_reference", |bencher| {
        bencher.iter(|| fast9::reference::score_window(black_box(&image), 20, window, &mut scores));
    });
    criterion.bench_function("fast/corners", |bencher| {
        bencher.iter(|| fast9::corners(black_box(&image), 20, true));
    });
}

criterion_group!(benches, fast);
criterion_main!(benches);
