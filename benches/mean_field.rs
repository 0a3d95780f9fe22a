//! Mean field over a room with a person in it: ten iterations, set-up included.
//!
//! `cargo bench --bench mean_field`
//!
//! `exact` leaves out only what is below the last digit of a row's sum; `all_pairs` leaves out nothing.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use garad_core::{Par, Rng};
use garad_crf::{Crf, CrfConfig, Cues, Method, Node};
use nalgebra::{Vector2, Vector3};

fn room(n: usize) -> Vec<Node> {
    let mut rng = Rng::new(1);
    (0..n)
        .map(|_| {
            let moves = rng.uniform() < 0.2;
            let (z, u) = if moves {
                (rng.range(1.8, 2.2), rng.range(250.0, 400.0))
            } else {
                (rng.range(1.0, 5.0), rng.range(0.0, 640.0))
            };
            let v = rng.range(0.0, 480.0);
            let (error, seen) = if moves { (3.0, 5) } else { (0.9, 25) };
            Node {
                p_world: Vector3::new((u - 320.0) * z / 535.0, (v - 240.0) * z / 535.0, z),
                uv_px: Some(Vector2::new(u, v)),
                cues: Cues {
                    reproj_px: Some((error + 0.5 * rng.normal()).abs()),
                    depth_residual: Some(rng.normal().abs() * error),
                    observations: u32::try_from(1 + rng.below(seen)).ok(),
                    epipolar_px: None,
                },
                previous: None,
            }
        })
        .collect()
}

fn crf(method: Method, iterations: usize) -> Crf {
    let mut config = CrfConfig::default();
    config.mean_field.method = method;
    config.mean_field.iterations = iterations;
    Crf::new(config).expect("a valid configuration")
}

fn mean_field(criterion: &mut Criterion) {
    let mut bench = |name: &str, n: usize, method, iterations, threads| {
        let nodes = room(n);
        let crf = crf(method, iterations);
        let bound = crf.infer(&nodes, Par::new(threads)).map(|b| b.error_bound);
        eprintln!("{name}: error bound {bound:?}");
        criterion.bench_function(&format!("mean_field/{name}"), |bencher| {
            bencher.iter(|| crf.infer(black_box(&nodes), Par::new(threads)));
        });
    };
    let exact = Method::Fast { tail: 1e-17 };
    let all_pairs = Method::Fast { tail: 0.0 };
    let fast = Method::Fast { tail: 1e-9 };
    bench("reference_1000_x10", 1000, Method::Reference, 10, 2);
    bench("all_pairs_5000_x10", 5000, all_pairs, 10, 2);
    bench("exact_5000_x10", 5000, exact, 10, 2);
    let default = CrfConfig::default().mean_field.method;
    bench("default_5000_x10", 5000, default, 10, 2);
    bench("fast_5000_x10", 5000, fast, 10, 2);
    bench("fast_5000_x10_one_thread", 5000, fast, 10, 1);
    bench("exact_20000_x10", 20_000, exact, 10, 2);
    bench("fast_20000_x5", 20_000, fast, 5, 2);
}

criterion_group! {
    name = benches;
    config = Criterion::default().sample_size(10);
    targets = mean_field
}
criterion_main!(benches);
