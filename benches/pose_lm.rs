//! Pose-only optimisation of 500 observations, and a local bundle of 12 keyframes; one thread.
//!
//! `cargo bench --bench pose_lm`

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use garad_core::{Camera, Rng, Se3};
use garad_optim::{
    BundleConfig, BundleObservation, DepthObservation, PoseConfig, PoseObservation,
    optimise_bundle, optimise_pose,
};
use nalgebra::{Vector2, Vector3, Vector6};

const BF: f64 = 40.0;
const LEVELS: usize = 8;

fn camera() -> Camera {
    Camera::pinhole((640, 480), [535.4, 539.2, 320.1, 247.6]).expect("a valid calibration")
}

/// A standard deviation as ORB's pyramid gives it.
fn sigma_px(rng: &mut Rng) -> f64 {
    (0..rng.below(LEVELS)).fold(1.0, |sigma, _| sigma * 1.2)
}

/// Points at 0.8 to 6 m with noise in pixel and depth; one in five is matched wrongly.
fn frame(n: usize) -> Vec<PoseObservation> {
    let mut rng = Rng::keyed(1, &[n as u64]);
    (0..n)
        .map(|i| {
            let seen = Vector2::new(rng.range(0.0, 640.0), rng.range(0.0, 480.0));
            let depth_m = rng.range(0.8, 6.0);
            let sigma_px = sigma_px(&mut rng);
            let wrong = if i % 5 == 0 { 40.0 } else { 0.0 };
            let noise = Vector2::new(rng.normal(), rng.normal());
            let uv_px = seen + noise * sigma_px + Vector2::repeat(wrong * rng.uniform());
            let right = DepthObservation::right_from_depth(uv_px.x, sigma_px, depth_m, 0.01, BF);
            PoseObservation {
                p_world: camera().unproject(&seen, depth_m),
                uv_px,
                sigma_px,
                depth: (i % 10 != 0).then_some(right),
            }
        })
        .collect()
}

/// Keyframes along a path past a wall of points, each seeing all that falls into its picture.
struct Window {
    poses: Vec<Se3>,
    fixed: Vec<bool>,
    points: Vec<Vector3<f64>>,
    observations: Vec<BundleObservation>,
}

fn window(keyframes: usize, points: usize) -> Window {
    let mut rng = Rng::keyed(2, &[keyframes as u64]);
    let truth: Vec<Se3> = (0..keyframes)
        .map(|k| {
            Se3::exp(&Vector6::new(
                -0.15 * k as f64,
                0.0,
                0.0,
                0.0,
                0.02 * k as f64,
                0.0,
            ))
        })
        .collect();
    let points: Vec<Vector3<f64>> = (0..points)
        .map(|_| {
            Vector3::new(
                rng.range(-1.5, 3.5),
                rng.range(-1.2, 1.2),
                rng.range(2.0, 4.5),
            )
        })
        .collect();
    let mut observations = Vec::new();
    for (pose, camera_from_world) in truth.iter().enumerate() {
        for (point, p_world) in points.iter().enumerate() {
            let p_cam = *camera_from_world * *p_world;
            let Some(seen) = camera().project(&p_cam) else {
                continue;
            };
            if !camera().contains(&seen) || rng.uniform() < 0.4 {
                continue;
            }
            let sigma_px = sigma_px(&mut rng);
            let uv_px = seen + Vector2::new(rng.normal(), rng.normal()) * sigma_px;
            observations.push(BundleObservation {
                pose,
                point,
                uv_px,
                sigma_px,
                depth: Some(DepthObservation::right_from_depth(
                    uv_px.x, sigma_px, p_cam.z, 0.02, BF,
                )),
            });
        }
    }
    let mut disturb = |size: f64| Vector6::from_fn(|_, _| size * rng.normal());
    // The first two keyframes are right and held fixed.
    let fixed: Vec<bool> = (0..keyframes).map(|k| k < 2).collect();
    let poses = (truth.iter().zip(&fixed))
        .map(|(pose, &fixed)| Se3::exp(&disturb(if fixed { 0.0 } else { 0.01 })) * *pose)
        .collect();
    let points = points
        .iter()
        .map(|p| p + disturb(0.02).fixed_rows::<3>(0))
        .collect();
    Window {
        poses,
        fixed,
        points,
        observations,
    }
}

fn pose_lm(criterion: &mut Criterion) {
    let observations = frame(500);
    let initial = Se3::exp(&Vector6::new(0.03, -0.02, 0.03, 0.01, -0.02, 0.01));
    criterion.bench_function("pose_lm/500_observations_4_rounds", |bencher| {
        bencher.iter(|| {
            black_box(optimise_pose(
                &camera(),
                &observations,
                &initial,
                &PoseConfig::default(),
            ))
        });
    });
    let window = window(12, 1500);
    let name = format!("pose_lm/bundle_12_keyframes_{}", window.observations.len());
    criterion.bench_function(&name, |bencher| {
        bencher.iter(|| {
            let (mut poses, mut points) = (window.poses.clone(), window.points.clone());
            black_box(optimise_bundle(
                &camera(),
                BF,
                &mut poses,
                &window.fixed,
                &mut points,
                &window.observations,
                &BundleConfig::default(),
            ))
        });
    });
}

criterion_group!(benches, pose_lm);
criterion_main!(benches);
