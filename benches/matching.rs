//! Hamming matching of 1000 with 1000 descriptors, half of them true pairs.
//!
//! `cargo bench --bench matching`

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use garad_core::{Par, Rng};
use garad_features::matching::{match_descriptors, nearest};
use garad_features::{Descriptor, MatchConfig};

fn matching(criterion: &mut Criterion) {
    let mut rng = Rng::new(4);
    let query: Vec<Descriptor> = (0..1000)
        .map(|_| Descriptor(std::array::from_fn(|_| rng.next_u64())))
        .collect();
    let train: Vec<Descriptor> = query
        .iter()
        .enumerate()
        .map(|(i, q)| {
            let mut words = q.0;
            // About 16 bits of a pair differ; every other descriptor is somebody else's.
            let noise = rng.next_u64() & rng.next_u64() & rng.next_u64();
            words[i % 4] ^= if i % 2 == 0 { noise } else { rng.next_u64() };
            Descriptor(words)
        })
        .collect();
    for par in [Par::Seq, Par::Threads(2)] {
        criterion.bench_function(&format!("matching/nearest_{}", par.threads()), |bencher| {
            bencher.iter(|| nearest(black_box(&query), black_box(&train), par));
        });
    }
    criterion.bench_function("matching/mutual", |bencher| {
        let config = MatchConfig::default();
        bencher.iter(|| match_descriptors(black_box(&query), &train, &config, Par::Seq));
    });
}

criterion_group!(benches, matching);
criterion_main!(benches);
