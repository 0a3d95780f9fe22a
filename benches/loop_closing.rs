//! What a camera that comes back needs: the place among 1,000 keyframes, the pose from matches of
//! which half are wrong, and a graph of 1,000 poses closed in twenty places; one thread.
//!
//! `cargo bench --bench loop_closing`

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use garad_core::{Camera, KeyframeId, Par, Rng, Se3, So3};
use garad_features::{Descriptor, PlaceConfig, PlaceIndex};
use garad_optim::{
    PnpConfig, PoseEdge, PoseGraph, PoseGraphConfig, PoseObservation, solve_pnp_ransac,
};
use nalgebra::{Matrix6, Vector2, Vector3, Vector6};

const KEYFRAMES: u32 = 1_000;
const DESCRIPTORS: usize = 1_000;

fn random(rng: &mut Rng) -> Descriptor {
    Descriptor([0; 4].map(|_| rng.next_u64()))
}

/// Corners of 2,000 kinds, 30 bits around each: pictures share words, as those of a room do.
fn picture(kinds: &[Descriptor], rng: &mut Rng) -> Vec<Descriptor> {
    (0..DESCRIPTORS)
        .map(|_| {
            let mut descriptor = kinds[rng.below(kinds.len())];
            for _ in 0..30 {
                let bit = rng.below(256);
                descriptor.0[bit / 64] ^= 1 << (bit % 64);
            }
            descriptor
        })
        .collect()
}

fn place(criterion: &mut Criterion) {
    let mut rng = Rng::new(1);
    let kinds: Vec<_> = (0..2_000).map(|_| random(&mut rng)).collect();
    let mut index = PlaceIndex::new(PlaceConfig::default(), 0).expect("the usual settings");
    for id in 0..KEYFRAMES {
        index.add(KeyframeId(id), &picture(&kinds, &mut rng));
    }
    let seen = picture(&kinds, &mut rng);
    criterion.bench_function("place/query_1000_keyframes", |bencher| {
        bencher.iter(|| black_box(index.query(&seen, 5, |_| false)));
    });
}

fn pnp(criterion: &mut Criterion) {
    let camera = Camera::pinhole((640, 480), [535.4, 539.2, 320.1, 247.6]).expect("a calibration");
    let mut rng = Rng::new(2);
    let pose = Se3::exp(&Vector6::from_fn(|_, _| rng.normal()));
    let mut pixel = || Vector2::new(rng.range(0.0, 640.0), rng.range(0.0, 480.0));
    let observations: Vec<_> = (0..500)
        .map(|i| {
            let seen = pixel();
            let depth_m = 1.0 + f64::from(i % 50) * 0.1;
            PoseObservation {
                p_world: pose.inverse() * camera.unproject(&seen, depth_m),
                uv_px: if i % 2 == 0 { pixel() } else { seen },
                sigma_px: 1.0,
                depth: None,
            }
        })
        .collect();
    let config = PnpConfig::default();
    criterion.bench_function("pnp/500_matches_half_wrong", |bencher| {
        bencher.iter(|| black_box(solve_pnp_ransac(&camera, &observations, &config, Par::Seq)));
    });
}

/// A walk whose poses know their three predecessors, and twenty closures.
fn graph(n: usize) -> PoseGraph {
    let mut rng = Rng::new(3);
    let mut motion = |size: f64| Se3::exp(&Vector6::from_fn(|_, _| size * rng.normal()));
    let mut truth = vec![Se3::identity()];
    for k in 1..n {
        let forward = Se3::new(So3::exp(&(Vector3::y() * 0.1)), Vector3::z() * -0.1);
        truth.push(forward * motion(0.02) * truth[k - 1]);
    }
    let mut edge = |a: usize, b: usize| PoseEdge {
        a,
        b,
        a_from_b: truth[a] * truth[b].inverse() * motion(0.005),
        information: Matrix6::identity() * 1e4,
    };
    let mut graph = PoseGraph::default();
    graph.add_pose(truth[0], true);
    for k in 1..n {
        let odometry = edge(k, k - 1);
        graph.add_pose(odometry.a_from_b * graph.poses[k - 1], false);
        graph.edges.push(odometry);
        graph
            .edges
            .extend((k.saturating_sub(3)..k - 1).map(|b| edge(k, b)));
    }
    let closures = (n / 3..n).step_by(n / 30);
    graph.edges.extend(closures.map(|k| edge(k, k / 4)));
    graph
}

fn pose_graph(criterion: &mut Criterion) {
    let graph = graph(1_000);
    let name = format!("pose_graph/1000_poses_{}_edges", graph.edges.len());
    let mut group = criterion.benchmark_group("loop");
    group.sample_size(20);
    group.bench_function(name, |bencher| {
        bencher.iter(|| {
            let mut graph = graph.clone();
            black_box(graph.optimise(&PoseGraphConfig::default()))
        });
    });
    group.finish();
}

criterion_group!(benches, place, pnp, pose_graph);
criterion_main!(benches);
