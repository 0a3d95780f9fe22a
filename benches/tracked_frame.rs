//! A whole tracked frame, without decoding: ORB, prediction, matching, pose, local map and, where
//! one is due, keyframe and local bundle adjustment.
//!
//! The frames are those of the committed TUM sample, gone through forth and back so that the
//! camera keeps moving as it did.

use std::hint::black_box;
use std::path::Path;

use criterion::{Criterion, criterion_group, criterion_main};
use garad::core::Par;
use garad::dataset::{Dataset, Frame, OpenOptions};
use garad::slam::{Config, FrameInput, Silent, Slam};

fn sample() -> (Dataset, Vec<Frame>) {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/tum_fr1_desk_9");
    let dataset = Dataset::open(&path, &OpenOptions::default()).expect("the committed sample");
    let frames = dataset
        .frames(0)
        .map(|f| f.expect("a good frame"))
        .collect();
    (dataset, frames)
}

fn tracked_frame(c: &mut Criterion) {
    let (dataset, frames) = sample();
    let forth_and_back: Vec<_> = (0..frames.len())
        .chain((1..frames.len() - 1).rev())
        .collect();
    for threads in [1, 2] {
        c.bench_function(
            &format!("tracked_frame/tum_640x480/{threads}_thread"),
            |b| {
                let mut config = Config::default();
                config.insertion.enabled = false;
                let camera = dataset.calibration().camera;
                let mut slam = Slam::new(camera, config, 0, Par::new(threads)).expect("valid");
                let mut next = 0;
                b.iter(|| {
                    let frame = &frames[forth_and_back[next % forth_and_back.len()]];
                    let input = FrameInput {
                        t_s: next as f64 / 30.0,
                        depth_t_s: next as f64 / 30.0,
                        rgb: &frame.rgb,
                        depth: &frame.depth,
                        mask: None,
                    };
                    next += 1;
                    black_box(slam.process(&input, &mut Silent).expect("a good frame"))
                });
            },
        );
    }
}

criterion_group!(benches, tracked_frame);
criterion_main!(benches);
