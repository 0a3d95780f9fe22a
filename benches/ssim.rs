//! The photometric loss with its gradient (0.8 L1 + 0.2 (1 - SSIM)) and mask: the sweep over rows
//! on one and two threads, and the plain reference on one, f32.
//!
//! `cargo bench --bench ssim`

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use garad_core::{Image, MaskImage, Par, Real, Rng};
use garad_raster::RasterError;
use garad_raster::losses::{self, ImageLoss};
use std::hint::black_box;

type Picture = Image<[f32; 3]>;
type Loss =
    fn(&Picture, &Picture, f64, Option<&MaskImage>, Par) -> Result<ImageLoss<f32>, RasterError>;

/// Noise of all brightnesses, and the same a little off.
fn pictures(width: usize, height: usize) -> (Picture, Picture) {
    let mut rng = Rng::new(5);
    let target = Image::from_fn(width, height, |_, _| [0; 3].map(|_| rng.uniform().to_f32()));
    let rendered = target.map(|p| p.map(|v| v + (0.05 * rng.normal()).to_f32()));
    (rendered, target)
}

fn photometric(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("photometric");
    group.sample_size(30);
    for (width, height) in [(320, 240), (640, 480), (1280, 960)] {
        let (rendered, target) = pictures(width, height);
        // A person: a tenth of the picture.
        let excluded = Image::from_fn(width, height, |x, y| {
            if x > width * 4 / 5 && y > height / 2 {
                255
            } else {
                0
            }
        });
        let ways: [(&str, Loss, usize); 3] = [
            ("reference", losses::reference::photometric, 1),
            ("sweep", losses::photometric, 1),
            ("sweep", losses::photometric, 2),
        ];
        for (name, loss, threads) in ways {
            let id = BenchmarkId::new(name, format!("{width}x{height}_{threads}_threads"));
            group.bench_function(id, |bencher| {
                bencher.iter(|| {
                    let (x, y) = (black_box(&rendered), &target);
                    loss(x, y, 0.2, Some(&excluded), Par::new(threads)).expect("sizes fit")
                });
            });
        }
    }
    group.finish();
}

criterion_group!(benches, photometric);
criterion_main!(benches);
