//! A bundle without noise, and what is done to it.

use super::*;
use crate::lm::{StopReason, System};
use crate::testing::with_each_solver;
use garad_core::{Rng, So3};
use nalgebra::Vector6;

const BF: f64 = 40.0;

struct Scene {
    camera: Camera,
    truth: Bundle,
    start: Bundle,
    fixed: Vec<bool>,
    observations: Vec<BundleObservation>,
}

/// Cameras on an arc that see all points, every second time with depth, without noise.
fn scene(n_poses: usize, n_points: usize) -> Scene {
    let mut rng = Rng::keyed(3, &[n_poses as u64, n_points as u64]);
    let camera = Camera::pinhole((640, 480), [535.4, 539.2, 320.1, 247.6]).unwrap();
    let truth = Bundle {
        poses: (0..n_poses)
            .map(|k| {
                let turn = 0.06 * k as f64;
                let rotation = So3::exp(&Vector3::new(0.02 * turn, turn, -0.3 * turn));
                Se3::new(rotation, Vector3::new(-2.0 * turn, 0.1 * turn, 0.2 * turn))
            })
            .collect(),
        points: (0..n_points)
            .map(|_| {
                let (x, y) = (rng.range(-1.0, 1.0), rng.range(-0.8, 0.8));
                Vector3::new(x, y, rng.range(2.0, 5.0))
            })
            .collect(),
    };
    let mut observations = Vec::new();
    for (pose, camera_from_world) in truth.poses.iter().enumerate() {
        for (point, p_world) in truth.points.iter().enumerate() {
            let p_cam = *camera_from_world * *p_world;
            let uv_px = camera.project(&p_cam).unwrap();
            let depth = DepthObservation::right_from_depth(uv_px.x, 1.2, p_cam.z, 0.02, BF);
            observations.push(BundleObservation {
                pose,
                point,
                uv_px,
                sigma_px: 1.2,
                depth: ((pose + point) % 2 == 0).then_some(depth),
            });
        }
    }
    let mut start = truth.clone();
    for pose in &mut start.poses[1..] {
        *pose = Se3::exp(&Vector6::from_fn(|_, _| 0.01 * rng.normal())) * *pose;
    }
    for point in &mut start.points {
        *point += Vector3::from_fn(|_, _| 0.03 * rng.normal());
    }
    Scene {
        camera,
        truth,
        start,
        fixed: (0..n_poses).map(|k| k == 0).collect(),
        observations,
    }
}

fn adjust(scene: &mut Scene) -> BundleReport {
    optimise_bundle(
        &scene.camera,
        BF,
        &mut scene.start.poses,
        &scene.fixed,
        &mut scene.start.points,
        &scene.observations,
        &BundleConfig::default(),
    )
    .unwrap()
}

#[test]
fn exact_observations_give_the_exact_bundle() {
    let mut scene = scene(5, 30);
    let first = scene.start.poses[0];
    let report = adjust(&mut scene);
    assert!(report.report.cost < 1e-9, "{report:?}");
    assert!(report.inlier.iter().all(|&i| i), "all explained");
    assert_eq!(
        scene.start.poses[0], first,
        "a fixed pose stays, bit by bit"
    );
    for (found, truth) in scene.start.poses.iter().zip(&scene.truth.poses) {
        assert!((*found * truth.inverse()).log().norm() < 1e-5, "{found:?}");
    }
    for (found, truth) in scene.start.points.iter().zip(&scene.truth.points) {
        assert!((found - truth).norm() < 1e-4, "{found}");
    }
}

/// A whole trajectory at once: 16 keyframes, each point seen by four in a row. The reduced system is a band,
/// and some points seen from both ends close it to a ring.
fn a_long_path_is_one_bundle(solver: LinearSolver) {
    let mut scene = scene(16, 240);
    let window = |point: usize| point % 13..point % 13 + 4;
    let at_both_ends = |o: &BundleObservation| o.point < 12 && (o.pose < 2 || o.pose > 13);
    scene
        .observations
        .retain(|o| window(o.point).contains(&o.pose) || at_both_ends(o));
    let config = BundleConfig {
        iterations: 60,
        cost_tolerance: 1e-14,
        linear_solver: solver,
        ..BundleConfig::default()
    };
    let report = optimise_bundle(
        &scene.camera,
        BF,
        &mut scene.start.poses,
        &scene.fixed,
        &mut scene.start.points,
        &scene.observations,
        &config,
    );
    let report = report.unwrap().report;
    assert!(report.cost < 1e-9, "{report:?}");
    for (found, truth) in scene.start.poses.iter().zip(&scene.truth.poses) {
        assert!((*found * truth.inverse()).log().norm() < 1e-4, "{found:?}");
    }
}

with_each_solver! {
    a_long_path_is_one_bundle
    free_and_fixed_poses_by_turns
}

/// A free pose without a single observation has no equation; the others are still solved.
#[test]
fn a_pose_that_sees_nothing_does_not_stop_the_others() {
    let mut scene = scene(5, 30);
    scene.observations.retain(|o| o.pose != 4);
    let unseen = scene.start.poses[4];
    let report = adjust(&mut scene);
    assert!(report.report.cost < 1e-3, "{report:?}");
    assert!(
        (scene.start.poses[4] * unseen.inverse()).log().norm() < 1e-12,
        "it stays"
    );
    for (found, truth) in scene.start.poses[..4].iter().zip(&scene.truth.poses) {
        assert!((*found * truth.inverse()).log().norm() < 1e-3, "{found:?}");
    }
}

/// The assembled gradient is the derivative of the cost through the step, for every unknown.
#[test]
fn gradient_is_the_derivative_of_the_cost() {
    let scene = scene(3, 6);
    let config = BundleConfig::default();
    let model = BundleModel::new(
        Intrinsics::new(&scene.camera, BF),
        &scene.start,
        &scene.fixed,
        &scene.observations,
        &config,
    );
    let system = (&model).linearise(&scene.start);
    assert!(
        (system.cost - (&model).cost(&scene.start)).abs() < 1e-9 * system.cost,
        "both ways to the cost agree"
    );
    let h = 1e-6;
    let slope = |change: &dyn Fn(&mut BundleStep, f64)| {
        let cost = |h: f64| {
            let mut step = BundleStep {
                poses: vec![Vector6::zeros(); 2],
                points: vec![Vector3::zeros(); 6],
            };
            change(&mut step, h);
            (&model).cost(&(&model).step(&scene.start, &step))
        };
        (cost(h) - cost(-h)) / (2.0 * h)
    };
    let scale = system.gradient_norm();
    for i in 0..6 {
        for p in 0..2 {
            let error = slope(&|s, h| s.poses[p][i] = h) - system.pose_gradient[p][i];
            assert!(error.abs() < 1e-7 * scale, "pose {p}, {i}: {error}");
        }
        for c in 0..3 {
            let error = slope(&|s, h| s.points[i][c] = h) - system.point_gradient[i][c];
            assert!(error.abs() < 1e-7 * scale, "point {i}, {c}: {error}");
        }
    }
}

#[test]
fn wrong_matches_are_named_and_bent_around() {
    let mut scene = scene(5, 30);
    for i in [7, 40, 99] {
        scene.observations[i].uv_px.y += 30.0;
    }
    let report = adjust(&mut scene);
    let wrong: Vec<usize> = (0..150).filter(|&i| !report.inlier[i]).collect();
    assert_eq!(wrong, [7, 40, 99], "those and no others");
    let error = scene.start.poses[3] * scene.truth.poses[3].inverse();
    assert!(error.log().norm() < 5e-3, "Huber: {error:?}");
}

/// 95 % of χ²: 5.991 for a pixel (2 degrees of freedom), 7.815 with its depth (3). A point 2 m ahead of a camera at
/// rest, seen so many σ beside the middle; the depth reading is exact and adds nothing.
#[test]
fn the_gate_is_that_of_the_degrees_of_freedom() {
    let camera = Camera::pinhole((640, 480), [500.0, 500.0, 320.0, 240.0]).unwrap();
    let depth = DepthObservation::right_from_depth(320.0, 1.0, 2.0, 0.0, BF);
    let seen = |off_px: f64, depth| BundleObservation {
        pose: 0,
        point: 0,
        uv_px: Vector2::new(320.0, 240.0 + off_px),
        sigma_px: 1.0,
        depth,
    };
    // 2.4² = 5.76, 2.6² = 6.76, 2.9² = 8.41
    let observations = [2.4, 2.6, 2.9].map(|off| [seen(off, None), seen(off, Some(depth))]);
    let config = BundleConfig {
        iterations: 0,
        ..BundleConfig::default()
    };
    let report = optimise_bundle(
        &camera,
        BF,
        &mut [Se3::identity()],
        &[true],
        &mut [Vector3::new(0.0, 0.0, 2.0)],
        observations.as_flattened(),
        &config,
    );
    assert_eq!(
        report.unwrap().inlier,
        [true, true, false, true, false, false],
        "2.4, 2.6 and 2.9 σ, without and with depth"
    );
}

#[test]
fn the_unseen_stays_and_what_is_behind_takes_no_part() {
    let mut scene = scene(4, 20);
    scene.start.points.push(Vector3::new(1.0, 2.0, 3.0));
    let behind = Vector3::new(0.0, 0.0, -4.0);
    scene.start.points.push(behind);
    scene.observations.push(BundleObservation {
        point: 21,
        ..scene.observations[0]
    });
    let report = adjust(&mut scene);
    assert_eq!(
        scene.start.points[20],
        Vector3::new(1.0, 2.0, 3.0),
        "unseen"
    );
    assert_eq!(scene.start.points[21], behind, "behind the camera");
    assert!(
        !report.inlier[80] && report.report.cost < 1e-9,
        "{report:?}"
    );
}

#[test]
fn with_all_poses_fixed_the_points_still_move() {
    let mut scene = scene(3, 10);
    scene.start.poses = scene.truth.poses.clone();
    scene.fixed = vec![true; 3];
    let report = adjust(&mut scene);
    assert!(report.report.cost < 1e-9, "{report:?}");
    let nothing = optimise_bundle(
        &scene.camera,
        BF,
        &mut [],
        &[],
        &mut [],
        &[],
        &BundleConfig::default(),
    );
    let stop = nothing.map(|r| r.report.stop);
    assert_eq!(stop, Ok(StopReason::ZeroGradient), "an empty bundle");
}

type Change = fn(&mut Scene);

#[test]
fn bad_input_is_named_and_nothing_moves() {
    let error_of = |change: Change| {
        let mut scene = scene(3, 5);
        change(&mut scene);
        let before = scene.start.clone();
        let error = optimise_bundle(
            &scene.camera,
            BF,
            &mut scene.start.poses,
            &scene.fixed,
            &mut scene.start.points,
            &scene.observations,
            &BundleConfig::default(),
        )
        .unwrap_err();
        assert_eq!(
            format!("{before:?}"),
            format!("{:?}", scene.start),
            "untouched"
        );
        error.to_string()
    };
    let cases: [(Change, &str); 6] = [
        (
            |s| s.observations[2].pose = 3,
            "observation 2 refers to pose 3; there are 3",
        ),
        (
            |s| s.observations[2].point = 9,
            "refers to point 9; there are 5",
        ),
        (|s| s.start.points[1].y = f64::NAN, "point 1 is not finite"),
        (
            |s| s.start.poses[2].translation.x = f64::INFINITY,
            "pose 2 is not finite",
        ),
        (
            |s| s.observations[4].sigma_px = -1.0,
            "sigma_px of observation 4 is -1",
        ),
        (|s| s.fixed = vec![], "fixed: 0 entries; expected 3"),
    ];
    for (change, expected) in cases {
        let error = error_of(change);
        assert!(error.contains(expected), "{error}");
    }
}

/// Residuals of (0.5, 1.5), (1, 2) and (1, 3) σ in v, with σ = 2 px: ½ s below the knee, δ √s - ½ δ² beyond it.
#[test]
fn cost_and_gates_are_those_of_the_configuration() {
    let camera = Camera::pinhole((640, 480), [500.0, 400.0, 320.0, 240.0]).unwrap();
    let depth = DepthObservation::Disparity {
        disparity_px: 25.0 / 2.0,
        sigma_px: 0.4,
    };
    let seen = |pose: usize, off_sigma: f64, depth| BundleObservation {
        pose,
        point: 0,
        uv_px: Vector2::new(320.0, 240.0 - 2.0 * off_sigma),
        sigma_px: 2.0,
        depth,
    };
    let observations = [
        seen(0, 1.5, None),
        seen(0, -2.0, None),
        seen(1, 2.0, None),
        seen(1, -2.0, Some(depth)),
        seen(0, 3.0, Some(depth)),
        seen(1, 3.1, Some(depth)),
    ];
    let plain = 0.5 * (2.25 + 4.0 + 4.0 + 4.0 + 9.0 + 9.61);
    // δ = 1.6 without depth and 3 with it
    let robust = 0.5 * (2.25 + 4.0 + 9.0) + 2.0 * (1.6 * 2.0 - 1.28) + (3.0 * 3.1 - 4.5);
    for (robust, expected) in [(true, robust), (false, plain)] {
        let config = BundleConfig {
            iterations: 0,
            chi2_2d: 1.6 * 1.6,
            chi2_3d: 9.0,
            robust,
            ..BundleConfig::default()
        };
        let report = optimise_bundle(
            &camera,
            25.0,
            &mut [Se3::identity(); 2],
            &[false, true],
            &mut [Vector3::new(0.0, 0.0, 2.0)],
            &observations,
            &config,
        )
        .unwrap();
        let error = (report.report.cost0 - expected).abs();
        assert!(error < 1e-12, "robust {robust}: {report:?} for {expected}");
        let expected = [true, false, false, true, true, false];
        assert_eq!(report.inlier, expected, "robust {robust}");
        assert_eq!(report.report.stop, StopReason::IterationLimit, "{robust}");
    }
}

/// Fixed poses between free ones: each step reaches the pose that it was computed for.
fn free_and_fixed_poses_by_turns(solver: LinearSolver) {
    let mut scene = scene(6, 40);
    scene.fixed = [true, false, false, true, false, true].to_vec();
    for k in [3, 5] {
        scene.start.poses[k] = scene.truth.poses[k];
    }
    let config = BundleConfig {
        iterations: 30,
        cost_tolerance: 1e-14,
        linear_solver: solver,
        ..BundleConfig::default()
    };
    let report = optimise_bundle(
        &scene.camera,
        BF,
        &mut scene.start.poses,
        &scene.fixed,
        &mut scene.start.points,
        &scene.observations,
        &config,
    );
    assert!(report.unwrap().report.cost < 1e-12, "all met");
    for (k, (found, truth)) in scene.start.poses.iter().zip(&scene.truth.poses).enumerate() {
        if scene.fixed[k] {
            assert_eq!(found, truth, "pose {k} is fixed");
        }
        assert!(
            (*found * truth.inverse()).log().norm() < 1e-6,
            "pose {k}: {found:?}"
        );
    }
}

#[test]
fn trials_and_tolerance_are_those_asked_for() {
    for (iterations, cost_tolerance, trials, stop) in [
        (1, 1e-9, 1, StopReason::IterationLimit),
        (3, 1e-9, 3, StopReason::IterationLimit),
        (5, 2.1, 0, StopReason::Converged),
    ] {
        let mut scene = scene(4, 20);
        let config = BundleConfig {
            iterations,
            cost_tolerance,
            ..BundleConfig::default()
        };
        let report = optimise_bundle(
            &scene.camera,
            BF,
            &mut scene.start.poses,
            &scene.fixed,
            &mut scene.start.points,
            &scene.observations,
            &config,
        );
        let report = report.unwrap().report;
        assert_eq!(
            (report.iterations + report.rejected, report.stop),
            (trials, stop),
            "{iterations}, {cost_tolerance}: {report:?}"
        );
    }
}
