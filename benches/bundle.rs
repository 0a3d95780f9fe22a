//! A local bundle of the size a tracker meets: 15 keyframes (two of them fixed), 2,000 points, each
//! seen six times, Huber; one thread.
//!
//! `cargo bench --bench bundle`. `iteration` is the price of one more iteration (a run of seven
//! less a run of two, both without a stop, over five); `to_1e-6` ends with the cost within 1e-6 of
//! the optimum, which is checked here.

use std::hint::black_box;
use std::time::{Duration, Instant};

use criterion::{Criterion, criterion_group, criterion_main};
use garad_core::{Camera, Rng, Se3, So3};
use garad_optim::{
    BundleConfig, BundleObservation, BundleReport, DepthObservation, optimise_bundle,
};
use nalgebra::{Vector3, Vector6};

const BF: f64 = 40.0;
const KEYFRAMES: usize = 15;
const FIXED: usize = 2;
const POINTS: usize = 2_000;
const VIEWS: usize = 6;

fn camera() -> Camera {
    Camera::pinhole((640, 480), [535.4, 539.2, 320.1, 247.6]).expect("a valid calibration")
}

struct Window {
    poses: Vec<Se3>,
    fixed: Vec<bool>,
    points: Vec<Vector3<f64>>,
    observations: Vec<BundleObservation>,
}

/// Cameras along a path past a wall; noise of one σ in pixels, one observation in fifty wrong, all
/// with depth or none.
fn window(with_depth: bool) -> Window {
    let mut rng = Rng::keyed(4, &[u64::from(with_depth)]);
    let truth: Vec<Se3> = (0..KEYFRAMES)
        .map(|k| {
            let along = k as f64 / KEYFRAMES as f64 - 0.5;
            let turn = Vector3::new(0.02 * along, -0.3 * along, 0.05 * along);
            Se3::new(
                So3::exp(&turn),
                Vector3::new(-0.8 * along, 0.1 * along, 0.2 * along),
            )
        })
        .collect();
    let (mut points, mut observations) = (Vec::new(), Vec::new());
    while points.len() < POINTS {
        let (x, y) = (rng.range(-2.5, 2.5), rng.range(-1.8, 1.8));
        let p_world = Vector3::new(x, y, rng.range(2.0, 5.0));
        // Consecutive keyframes, as a point is tracked.
        let first = rng.below(KEYFRAMES - VIEWS + 1);
        let seen: Vec<_> = (first..first + VIEWS)
            .filter_map(|pose| {
                let p_cam = truth[pose] * p_world;
                let uv = camera()
                    .project(&p_cam)
                    .filter(|uv| camera().contains(uv))?;
                Some((pose, uv, p_cam.z))
            })
            .collect();
        if seen.len() < VIEWS {
            continue;
        }
        for (pose, uv, depth_m) in seen {
            let sigma_px = (0..rng.below(5)).fold(1.0, |sigma, _| sigma * 1.2);
            let wrong = if rng.below(50) == 0 { 30.0 } else { sigma_px };
            let uv_px = uv.map(|c| c + wrong * rng.normal());
            let reading = depth_m * (1.0 + 0.005 * rng.normal());
            observations.push(BundleObservation {
                pose,
                point: points.len(),
                uv_px,
                sigma_px,
                depth: with_depth.then(|| {
                    DepthObservation::right_from_depth(uv_px.x, sigma_px, reading, 0.02, BF)
                }),
            });
        }
        points.push(p_world);
    }
    let fixed: Vec<bool> = (0..KEYFRAMES).map(|k| k < FIXED).collect();
    let mut disturb = |size: f64| Vector6::from_fn(|_, _| size * rng.normal());
    let poses = (truth.iter().zip(&fixed))
        .map(|(pose, &fixed)| Se3::exp(&disturb(if fixed { 0.0 } else { 0.01 })) * *pose)
        .collect();
    for point in &mut points {
        *point += disturb(0.02).fixed_rows::<3>(0);
    }
    Window {
        poses,
        fixed,
        points,
        observations,
    }
}

fn adjust(window: &Window, config: &BundleConfig) -> BundleReport {
    let (mut poses, mut points) = (window.poses.clone(), window.points.clone());
    optimise_bundle(
        &camera(),
        BF,
        &mut poses,
        &window.fixed,
        &mut points,
        &window.observations,
        config,
    )
    .expect("sound input")
}

/// A fixed number of trials, whatever they gain.
fn trials(iterations: usize) -> BundleConfig {
    BundleConfig {
        iterations,
        cost_tolerance: 0.0,
        ..BundleConfig::default()
    }
}

fn bundle(criterion: &mut Criterion) {
    for (name, with_depth) in [("pixels", false), ("pixels_and_depth", true)] {
        let window = window(with_depth);
        assert_eq!(
            window.observations.len(),
            VIEWS * POINTS,
            "the size promised above"
        );
        let optimum = adjust(&window, &trials(100)).report.cost;
        let to_1e6 = BundleConfig {
            iterations: 100,
            cost_tolerance: 1e-7,
            ..BundleConfig::default()
        };
        let reached = adjust(&window, &to_1e6).report;
        assert!(
            reached.cost <= optimum * (1.0 + 1e-6),
            "{reached:?} against {optimum}"
        );
        let mut group = criterion.benchmark_group(format!("bundle/{name}"));
        group.sample_size(20);
        group.bench_function("iteration", |bencher| {
            bencher.iter_custom(|times| {
                let time = |config: &BundleConfig| {
                    let start = Instant::now();
                    for _ in 0..times {
                        black_box(adjust(&window, config));
                    }
                    start.elapsed()
                };
                let (long, short) = (time(&trials(7)), time(&trials(2)));
                long.checked_sub(short).unwrap_or(Duration::ZERO) / 5
            });
        });
        let trials = reached.iterations + reached.rejected;
        group.bench_function(format!("to_1e-6_in_{trials}"), |bencher| {
            bencher.iter(|| black_box(adjust(&window, &to_1e6)));
        });
        group.finish();
    }
}

criterion_group!(benches, bundle);
criterion_main!(benches);
