//! Decoding of one 640x480 frame, colour and depth, on one thread: the nine frames of the sample.
//!
//! `cargo bench --bench decode`

use std::hint::black_box;
use std::path::Path;

use criterion::{Criterion, criterion_group, criterion_main};
use garad_dataset::{Dataset, OpenOptions};

fn decode(criterion: &mut Criterion) {
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/tum_fr1_desk_9");
    let dataset = Dataset::open(&sample, &OpenOptions::default()).expect("the committed sample");
    let mut frames = (0..dataset.len()).cycle();
    criterion.bench_function("decode/frame_640x480", |bencher| {
        bencher.iter(|| black_box(frames.next().map(|i| dataset.read(i))));
    });
    criterion.bench_function("decode/open_folder", |bencher| {
        bencher.iter(|| black_box(Dataset::open(&sample, &OpenOptions::default())));
    });
}

criterion_group!(benches, decode);
criterion_main!(benches);
