//! Rounds, kernels and gates of a pose, by the cost at which each round starts.
//!
//! The initial pose is the true one moved along the camera's x: a point at depth z is then seen
//! fx dx/z pixels too far right, and so is its image in the virtual right camera; its disparity stays.

use super::*;
use crate::dense::Recorder;
use crate::lm::StopReason;
use garad_core::So3;

const FX: f64 = 500.0;
const BF: f64 = 25.0;
const DX_M: f64 = 0.02;

fn camera() -> Camera {
    Camera::pinhole((640, 480), [FX, 400.0, 320.0, 240.0]).expect("valid")
}

fn truth() -> Se3 {
    let rotation = So3::exp(&Vector3::new(0.3, -0.5, 0.2));
    Se3::new(rotation, Vector3::new(0.4, -0.2, 0.7))
}

fn moved(dx_m: f64, dz_m: f64) -> Se3 {
    Se3::new(So3::identity(), Vector3::new(dx_m, 0.0, dz_m)) * truth()
}

/// Camera coordinates of the i-th point.
fn p_cam(i: usize) -> Vector3<f64> {
    let t = i as f64;
    let (x, y) = (0.4 * libm::sin(2.3 * t), 0.3 * libm::cos(1.7 * t));
    Vector3::new(x, y, 1.5 + 0.25 * t)
}

/// σ of the pixel and of the right coordinate.
fn sigmas_px(i: usize) -> (f64, f64) {
    (0.8 + 0.15 * (i % 5) as f64, 1.9 + 0.1 * i as f64)
}

/// n exact observations, by turns without depth, with a right coordinate and with a disparity.
fn observations(n: usize) -> Vec<PoseObservation> {
    let one = |i: usize| {
        let p_cam = p_cam(i);
        let uv_px = camera().project(&p_cam).expect("in front");
        let (sigma_px, right_sigma_px) = sigmas_px(i);
        let depth = match i % 3 {
            0 => None,
            1 => Some(DepthObservation::Right {
                u_px: uv_px.x - BF / p_cam.z,
                sigma_px: right_sigma_px,
            }),
            _ => Some(DepthObservation::Disparity {
                disparity_px: BF / p_cam.z,
                sigma_px: 0.3,
            }),
        };
        PoseObservation {
            p_world: truth().inverse() * p_cam,
            uv_px,
            sigma_px,
            depth,
        }
    };
    (0..n).map(one).collect()
}

/// δ of 2 and of 3: neither the default, nor each other's square.
fn config() -> PoseConfig {
    PoseConfig {
        bf: BF,
        chi2_2d: 4.0,
        chi2_3d: 9.0,
        ..PoseConfig::default()
    }
}

fn solve(observations: &[PoseObservation], initial: &Se3, config: &PoseConfig) -> PoseSolution {
    optimise_pose(&camera(), observations, initial, config).expect("sound")
}

/// ½ ρ(s) of the i-th observation from the moved pose, its pixel `off_v_px` below where it belongs.
fn cost_at_start(i: usize, off_v_px: f64, kernel: bool) -> f64 {
    let (sigma, right_sigma) = sigmas_px(i);
    let du = FX * DX_M / p_cam(i).z;
    let mut s = (du * du + off_v_px * off_v_px) / (sigma * sigma);
    if i % 3 == 1 {
        s += du * du / (right_sigma * right_sigma);
    }
    let delta = if i.is_multiple_of(3) { 2.0 } else { 3.0 };
    if kernel && s > delta * delta {
        delta * s.sqrt() - 0.5 * delta * delta
    } else {
        0.5 * s
    }
}

#[test]
fn each_round_starts_where_it_should_with_its_kernel_and_its_inliers() {
    const N: usize = 14;
    let mut seen = observations(N);
    let off_v_px = |i: usize| [0.0, 40.0, -55.0][usize::from(i == 3) + 2 * usize::from(i == 7)];
    for (i, o) in seen.iter_mut().enumerate() {
        o.uv_px.y += off_v_px(i);
    }
    let right = |i: &usize| off_v_px(*i).abs() < 1.0;
    let below =
        |i: &usize| right(i) && cost_at_start(*i, 0.0, false) - cost_at_start(*i, 0.0, true) < 1e-9;
    let n_below = (0..N).filter(below).count();
    assert!(
        (3..10).contains(&n_below),
        "on both sides of the knee: {n_below}"
    );
    let total = |kernel: bool, all: bool| -> f64 {
        let used = (0..N).filter(|i| all || right(i));
        used.map(|i| cost_at_start(i, -off_v_px(i), kernel))
            .fold(0.0, |a, b| a + b)
    };
    let (first, robust, plain) = (total(true, true), total(true, false), total(false, false));
    for (restart_from_initial, kernel_off_after_round, rounds, expected) in [
        (true, 2, 4, [first, robust, robust, plain]),
        (true, 0, 4, [first, plain, plain, plain]),
        (true, 1, 3, [first, robust, plain, 0.0]),
        (true, 9, 4, [first, robust, robust, robust]),
        (false, 0, 4, [first, 0.0, 0.0, 0.0]),
    ] {
        let config = PoseConfig {
            restart_from_initial,
            kernel_off_after_round,
            rounds,
            iterations: 25,
            ..config()
        };
        let solution = solve(&seen, &moved(DX_M, 0.0), &config);
        let what = format!("restart {restart_from_initial}, kernel to {kernel_off_after_round}");
        assert_eq!(solution.reports.len(), rounds, "{what}");
        for (round, (report, expected)) in solution.reports.iter().zip(expected).enumerate() {
            // Outliers leave the first round's pose a few tenths of a pixel off.
            let tolerance = if expected > 0.0 { 1e-9 * expected } else { 2.0 };
            let error = (report.cost0 - expected).abs();
            assert!(
                error <= tolerance,
                "{what}, round {round}: {} for {expected}",
                report.cost0
            );
        }
        let expected: Vec<bool> = (0..N).map(|i| right(&i)).collect();
        assert_eq!(solution.inlier, expected, "{what}");
        assert_eq!(solution.n_inliers, N - 2, "{what}");
        let last = solution.reports[rounds - 1].cost;
        assert_eq!(solution.cost.to_bits(), last.to_bits(), "{what}: cost");
    }
}

/// Four of fourteen 9 px too low pull the first round's pose so far that a right one (1) is beyond its gate; without them
/// the second round meets it exactly, and the third has it again.
#[test]
fn what_was_left_out_is_checked_again() {
    let mut seen = observations(14);
    for i in [0, 3, 6, 9] {
        seen[i].uv_px.y += 9.0;
    }
    let wrong = |i: usize| i < 10 && i.is_multiple_of(3);
    let after = |rounds: usize| {
        let config = PoseConfig {
            rounds,
            iterations: 30,
            ..config()
        };
        solve(&seen, &moved(DX_M, 0.0), &config)
    };
    let inliers = |but_one: bool| -> Vec<bool> {
        let out = |i: usize| wrong(i) || (but_one && i == 1);
        (0..14).map(|i| !out(i)).collect()
    };
    assert_eq!(after(1).inlier, inliers(true), "after the first round");
    assert_eq!(after(2).inlier, inliers(false), "after the second");
    let reports = after(3).reports;
    for (round, but_one) in [(1, true), (2, false)] {
        let used = (0..14).filter(|&i| inliers(but_one)[i]);
        let expected = used.fold(0.0, |sum, i| sum + cost_at_start(i, 0.0, true));
        let error = (reports[round].cost0 - expected).abs();
        assert!(error < 1e-9 * expected, "round {round}: {reports:?}");
    }
}

/// Σ JᵀJ of the inliers alone, without a kernel; neither the outliers' nor the prior's.
#[test]
fn information_leaves_the_outliers_out() {
    let mut seen = observations(14);
    seen[4].uv_px.y += 60.0;
    let config = PoseConfig {
        prior: Some(CentrePrior {
            centre_m: truth().inverse().translation,
            root_information: Matrix3::identity() * 50.0,
        }),
        ..config()
    };
    let solution = solve(&seen, &moved(DX_M, 0.0), &config);
    seen.remove(4);
    let mut recorder = Recorder::<6>::default();
    PoseProblem::new(&camera(), BF, None, seen).blocks(&solution.camera_from_world, &mut recorder);
    let rows = recorder.blocks.iter().flat_map(|b| b.jacobian.iter());
    let expected = rows.fold(Matrix6::zeros(), |sum, j| sum + j * j.transpose());
    let error = (solution.information - expected).amax() / expected.amax();
    assert!(error < 1e-12, "{error}");
}

#[test]
fn with_fewer_than_ten_there_is_one_round() {
    for (n, rounds, expected) in [(9, 4, 1), (9, 0, 0), (10, 4, 4), (10, 2, 2), (12, 0, 0)] {
        let config = PoseConfig { rounds, ..config() };
        let solution = solve(&observations(n), &truth(), &config);
        assert_eq!(
            solution.reports.len(),
            expected,
            "{n} observations, {rounds} rounds"
        );
        assert_eq!(solution.n_inliers, n, "{n}: gated even without a round");
    }
}

/// Without a trial the pose stays, and the second round needs three inliers of the first.
#[test]
fn rounds_end_with_fewer_than_three_inliers() {
    for (good, expected) in [(2, 1), (3, 4)] {
        let mut seen = observations(12);
        for o in &mut seen[good..] {
            o.uv_px.y += 30.0;
        }
        let config = PoseConfig {
            iterations: 0,
            ..config()
        };
        let solution = solve(&seen, &truth(), &config);
        assert_eq!(solution.reports.len(), expected, "{good} inliers");
        assert_eq!(solution.n_inliers, good, "counted");
    }
}

#[test]
fn the_gate_is_at_its_chi2_for_each_kind() {
    let depth = DepthObservation::Disparity {
        disparity_px: 12.5,
        sigma_px: 0.4,
    };
    let seen = |off_v_px: f64, depth| PoseObservation {
        p_world: Vector3::new(0.0, 0.0, 2.0),
        uv_px: Vector2::new(320.0, 240.0 + off_v_px),
        sigma_px: 2.0,
        depth,
    };
    // 1.5² = 2.25 and 2.5² = 6.25, with σ = 2 px
    let offs = [3.0, -3.0625, 5.0, -5.0625];
    let both = offs.map(|off| [seen(off, None), seen(off, Some(depth))]);
    let config = PoseConfig {
        iterations: 0,
        rounds: 1,
        chi2_2d: 2.25,
        chi2_3d: 6.25,
        ..config()
    };
    let solution = solve(both.as_flattened(), &Se3::identity(), &config);
    let expected = [true, true, false, true, false, true, false, false];
    assert_eq!(
        solution.inlier, expected,
        "1.5, 1.53, 2.5, 2.53 σ, without and with depth"
    );
    assert_eq!(solution.n_inliers, 4, "counted");
}

/// A point 3 cm from the lens at the initial pose, 0.4 m at the true one and 1.5 σ off: it takes part in
/// a round that starts where it is in front.
#[test]
fn a_point_that_comes_before_the_camera_is_readmitted() {
    let mut seen = observations(12);
    let near = Vector3::new(0.0, 0.0, 0.4);
    seen.push(PoseObservation {
        p_world: truth().inverse() * near,
        uv_px: Vector2::new(320.0, 240.0 + 3.0),
        sigma_px: 2.0,
        depth: None,
    });
    for (restart_from_initial, expected) in [(true, [0.0, 0.0]), (false, [0.0, 1.125])] {
        let config = PoseConfig {
            restart_from_initial,
            iterations: 30,
            rounds: 2,
            ..config()
        };
        let solution = solve(&seen, &moved(0.0, -0.37), &config);
        assert_eq!(solution.n_inliers, 13, "restart {restart_from_initial}");
        let (first, second) = (solution.reports[0], solution.reports[1]);
        assert!(first.cost < 1e-9, "all in front are exact: {first:?}");
        let found = if restart_from_initial {
            second.cost
        } else {
            second.cost0
        };
        assert!(
            (found - expected[1]).abs() < 1e-3,
            "restart {restart_from_initial}: {second:?}"
        );
    }
}

#[test]
fn trials_and_tolerance_are_those_asked_for() {
    let seen = observations(12);
    for (iterations, cost_tolerance, trials, stop) in [
        (1, 1e-9, 1, StopReason::IterationLimit),
        (2, 1e-9, 2, StopReason::IterationLimit),
        // The model expects nearly the whole cost to go, and never more than twice that.
        (5, 2.1, 0, StopReason::Converged),
    ] {
        let config = PoseConfig {
            iterations,
            cost_tolerance,
            rounds: 1,
            ..config()
        };
        let report = solve(&seen, &moved(DX_M, 0.0), &config).reports[0];
        assert_eq!(
            (report.iterations + report.rejected, report.stop),
            (trials, stop),
            "{iterations}, {cost_tolerance}: {report:?}"
        );
    }
}

/// ½ ρ(‖Lᵀ (c - c₀)‖²) with δ = 3, in every round: L = [10; 4 20; 0 0 30], so
/// Lᵀ d = (10 d₀ + 4 d₁, 20 d₁, 30 d₂).
#[test]
fn the_prior_has_its_own_kernel_in_every_round() {
    #[rustfmt::skip]
    let root_information = Matrix3::new(
        10.0,  0.0,  0.0,
         4.0, 20.0,  0.0,
         0.0,  0.0, 30.0,
    );
    // (1, 2, 1.5): s = 7.25; (2, 4, 3): s = 29
    for (scale, expected) in [(1.0, 0.5 * 7.25), (2.0, 3.0 * 29f64.sqrt() - 4.5)] {
        let off_m = Vector3::new(0.06, 0.1, 0.05) * scale;
        let config = PoseConfig {
            iterations: 0,
            prior: Some(CentrePrior {
                centre_m: truth().inverse().translation + off_m,
                root_information,
            }),
            ..config()
        };
        let solution = solve(&observations(12), &truth(), &config);
        assert_eq!(solution.reports.len(), 4, "rounds");
        for report in &solution.reports {
            assert!(
                (report.cost0 - expected).abs() < 1e-9,
                "{scale}: {report:?}"
            );
        }
    }
}

#[test]
fn gates_and_baseline_must_be_positive() {
    let error = |config: PoseConfig| {
        let result = optimise_pose(&camera(), &observations(4), &truth(), &config);
        result.expect_err("refused").to_string()
    };
    for wrong in [0.0, -2.0, f64::NAN] {
        let cases = [
            (
                "bf",
                PoseConfig {
                    bf: wrong,
                    ..config()
                },
            ),
            (
                "chi2_2d",
                PoseConfig {
                    chi2_2d: wrong,
                    ..config()
                },
            ),
            (
                "chi2_3d",
                PoseConfig {
                    chi2_3d: wrong,
                    ..config()
                },
            ),
        ];
        for (name, config) in cases {
            let error = error(config);
            assert!(error.starts_with(name), "{wrong}: {error}");
        }
    }
}
