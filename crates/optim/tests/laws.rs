//! Laws of Levenberg-Marquardt, of the normal equations and of pose optimisation.

mod common;

use std::cell::Cell;

use garad_core::{Rng, Se3, So3};
use garad_optim::dense::{Cost, Dense, NormalEquations, Problem, Recorder, Visitor};
use garad_optim::lm::{LmConfig, Report, StopReason, Trial, minimise, minimise_observed};
use garad_optim::pose::PoseProblem;
use garad_optim::{
    DepthObservation, OptimError, PoseConfig, PoseObservation, RobustKernel, check_jacobian,
    optimise_pose,
};
use nalgebra::{SMatrix, SVector, Vector2, Vector3, Vector6};
use proptest::prelude::*;

use common::{BF, camera, observations, truth};

/// Residuals given by a closure that returns values and Jacobian.
struct Residuals<F, const M: usize, const N: usize> {
    kernel: RobustKernel,
    f: F,
}

impl<F, const M: usize, const N: usize> Problem<N> for Residuals<F, M, N>
where
    F: Fn(&SVector<f64, N>) -> (SVector<f64, M>, SMatrix<f64, M, N>),
{
    type State = SVector<f64, N>;
    fn blocks(&self, state: &Self::State, visitor: &mut impl Visitor<N>) {
        let (residual, jacobian) = (self.f)(state);
        for m in 0..M {
            let row = SVector::from([residual[m]]);
            visitor.block(self.kernel, &row, || {
                SMatrix::<f64, 1, N>::from(jacobian.row(m))
            });
        }
    }
    fn step(&self, state: &Self::State, step: &SVector<f64, N>) -> Self::State {
        state + step
    }
}

fn plain<F, const M: usize, const N: usize>(f: F) -> Residuals<F, M, N>
where
    F: Fn(&SVector<f64, N>) -> (SVector<f64, M>, SMatrix<f64, M, N>),
{
    let kernel = RobustKernel::None;
    Residuals { kernel, f }
}

fn to_the_end() -> LmConfig {
    LmConfig {
        iterations: 500,
        cost_tolerance: 0.0,
        cost_floor: 1e-28,
        ..LmConfig::default()
    }
}

#[test]
fn rosenbrock_is_solved() {
    // (10 (y - x²), 1 - x), minimum at (1, 1)
    let problem = plain(|p: &SVector<f64, 2>| {
        let (x, y) = (p[0], p[1]);
        let r = SVector::from([10.0 * (y - x * x), 1.0 - x]);
        (r, SMatrix::<f64, 2, 2>::new(-20.0 * x, 10.0, -1.0, 0.0))
    });
    let start = SVector::from([-1.2, 1.0]);
    let (found, report) = minimise(&Dense(&problem), start, &to_the_end());
    assert!(
        (found - SVector::from([1.0, 1.0])).norm() < 1e-12,
        "{found} {report:?}"
    );
    assert!(report.iterations < 40, "{report:?}");
}

#[test]
fn powells_singular_function_is_solved() {
    // The Jacobian has rank 2 at the minimum 0: convergence is linear, the answer still 0.
    let problem = plain(|p: &SVector<f64, 4>| {
        let (a, b) = (p[1] - 2.0 * p[2], p[0] - p[3]);
        let (s5, s10) = (5.0f64.sqrt(), 10.0f64.sqrt());
        let r = SVector::from([p[0] + 10.0 * p[1], s5 * (p[2] - p[3]), a * a, s10 * b * b]);
        #[rustfmt::skip]
        let j = SMatrix::<f64, 4, 4>::new(
            1.0, 10.0, 0.0, 0.0,
            0.0, 0.0, s5, -s5,
            0.0, 2.0 * a, -4.0 * a, 0.0,
            2.0 * s10 * b, 0.0, 0.0, -2.0 * s10 * b,
        );
        (r, j)
    });
    let start = SVector::from([3.0, -1.0, 0.0, 1.0]);
    let (found, report) = minimise(&Dense(&problem), start, &to_the_end());
    assert!(
        found.amax() < 1e-4 && report.cost < 1e-16,
        "{found} {report:?}"
    );
}

/// The predicted decrease of a linear problem is exact at any λ: 1.0000, and not 1.24 or 13.8.
#[test]
fn gain_ratio_is_one_on_linear_problems() {
    let mut rng = Rng::keyed(11, &[0]);
    let j = SMatrix::<f64, 9, 4>::from_fn(|_, _| rng.normal());
    let b = SVector::<f64, 9>::from_fn(|_, _| rng.normal());
    let problem = plain(|x: &SVector<f64, 4>| (j * x - b, j));
    for lambda in [1e-3, 0.1, 1.0, 10.0, 1e4] {
        let config = LmConfig {
            lambda,
            iterations: 1,
            ..to_the_end()
        };
        let seen = Cell::new(0.0);
        let observer = |trial: &Trial| seen.set(trial.gain_ratio);
        minimise_observed(&Dense(&problem), SVector::from([5.0; 4]), &config, observer);
        let error = (seen.get() - 1.0f64).abs();
        assert!(error < 1e-9, "λ = {lambda}: {}", seen.get());
    }
}

#[test]
fn units_of_the_unknowns_do_not_matter() {
    let make = |unit: f64| {
        plain(move |p: &SVector<f64, 2>| {
            let (x, y) = (p[0] * unit, p[1]);
            let r = SVector::from([10.0 * (y - x * x), 1.0 - x]);
            (
                r,
                SMatrix::<f64, 2, 2>::new(-20.0 * x * unit, 10.0, -unit, 0.0),
            )
        })
    };
    let run = |unit: f64| {
        let start = SVector::from([-1.2 / unit, 1.0]);
        minimise(&Dense(&make(unit)), start, &to_the_end()).1
    };
    let (metres, gigametres) = (run(1.0), run(1e9));
    assert_eq!(
        (metres.iterations, metres.rejected),
        (gigametres.iterations, gigametres.rejected),
        "the same path"
    );
}

#[test]
fn nothing_to_fit_means_no_step() {
    let problem = plain(|x: &SVector<f64, 2>| (x * 3.0, SMatrix::identity() * 3.0));
    let (found, report) = minimise(&Dense(&problem), SVector::zeros(), &to_the_end());
    assert_eq!(report.stop, StopReason::ZeroGradient, "{report:?}");
    assert!(
        found.amax() < 1e-300 && report.iterations + report.rejected == 0,
        "{report:?}"
    );
}

/// The cost beyond x = 1 is NaN, and every full step leads there.
#[test]
fn steps_into_nan_are_rejected() {
    let problem = plain(|x: &SVector<f64, 1>| {
        let r = if x[0] > 1.0 { f64::NAN } else { x[0] - 5.0 };
        (SVector::from([r]), SMatrix::<f64, 1, 1>::identity())
    });
    let (found, report) = minimise(&Dense(&problem), SVector::zeros(), &to_the_end());
    assert!(found[0] <= 1.0 && found[0] > 0.9, "{found}");
    assert!(
        report.rejected > 0 && report.cost <= report.cost0,
        "{report:?}"
    );
    let nowhere = minimise(&Dense(&problem), SVector::from([2.0]), &to_the_end()).1;
    assert_eq!(nowhere.stop, StopReason::NotFinite, "{nowhere:?}");
}

#[test]
fn unseen_unknowns_stay() {
    let problem = plain(|x: &SVector<f64, 2>| {
        let r = SVector::from([x[0] - 2.0]);
        (r, SMatrix::<f64, 1, 2>::new(1.0, 0.0))
    });
    let (found, _) = minimise(&Dense(&problem), SVector::from([0.0, 7.0]), &to_the_end());
    assert!(
        (found - SVector::from([2.0, 7.0])).norm() < 1e-12,
        "{found}"
    );
}

/// The gradient is that of the cost that is reported, with every kernel, inside and outside.
#[test]
fn gradient_is_that_of_the_reported_cost() {
    let kernels = [
        RobustKernel::None,
        RobustKernel::Huber { delta: 1.5 },
        RobustKernel::Cauchy { c: 1.5 },
        RobustKernel::Tukey { c: 4.0 },
    ];
    for kernel in kernels {
        let problem = Residuals {
            kernel,
            f: |x: &SVector<f64, 2>| {
                let r = SVector::from([x[0] * x[1] - 2.0, x[0] - 3.0 * x[1], 0.1 * x[0]]);
                let j = SMatrix::<f64, 3, 2>::new(x[1], x[0], 1.0, -3.0, 0.1, 0.0);
                (r, j)
            },
        };
        let cost = |x: SVector<f64, 2>| {
            let mut cost = Cost::default();
            problem.blocks(&x, &mut cost);
            cost.cost
        };
        for x in [
            SVector::from([0.0, 0.0]),
            SVector::from([2.0, 1.3]),
            SVector::from([6.0, 0.4]),
        ] {
            let mut equations = NormalEquations::<2>::default();
            problem.blocks(&x, &mut equations);
            for i in 0..2 {
                let mut h = SVector::zeros();
                h[i] = 1e-5;
                let slope = (cost(x + h) - cost(x - h)) / 2e-5;
                let error = (slope - equations.gradient[i]).abs();
                assert!(
                    error < 1e-8,
                    "{kernel:?} at {x}: {slope} {}",
                    equations.gradient
                );
            }
        }
    }
}

// ---- poses ----

proptest! {
    /// Every row of every block, through the same step that the optimiser takes.
    #[test]
    fn pose_jacobians_are_the_derivatives(
        xi in proptest::array::uniform6(-0.05f64..0.05), seed in 0u64..1000,
    ) {
        let problem = PoseProblem::new(&camera(), BF, Some([2.4, 2.8]), observations(&truth(), 20, seed));
        let state = Se3::exp(&Vector6::from_row_slice(&xi)) * truth();
        let check = check_jacobian(&problem, &state, 3e-4).expect("all in front");
        prop_assert!(check.elements == 20 / 2 * (2 + 3) * 6, "{check:?}");
        prop_assert!(check.worst < 1e-10, "{check:?}");
    }

    #[test]
    fn exact_observations_give_the_exact_pose(
        xi in proptest::array::uniform6(-0.1f64..0.1), seed in 0u64..1000,
    ) {
        let initial = Se3::exp(&Vector6::from_row_slice(&xi)) * truth();
        let seen = observations(&truth(), 60, seed);
        let solution = optimise_pose(&camera(), &seen, &initial, &PoseConfig::default()).expect("sound");
        let error = solution.camera_from_world * truth().inverse();
        prop_assert!(error.log().norm() < 1e-6, "{:?}", solution.reports);
        prop_assert_eq!(solution.n_inliers, 60);
    }
}

/// The check itself: one wrong sign is found, with its place.
#[test]
fn the_checker_finds_a_wrong_jacobian() {
    let wrong = plain(|x: &SVector<f64, 2>| {
        let r = SVector::from([x[0] * x[1], x[0] - x[1]]);
        (r, SMatrix::<f64, 2, 2>::new(x[1], x[0], 1.0, 1.0))
    });
    let check = check_jacobian(&wrong, &SVector::from([0.3, 0.7]), 1e-3).expect("fixed blocks");
    assert_eq!(
        (check.block, check.row, check.column),
        (1, 0, 1),
        "{check:?}"
    );
    assert!((check.worst - 2.0).abs() < 1e-9, "{check:?}");
}

/// A residual that is shown, or allowed, on one side only cannot be compared.
#[test]
fn the_checker_declines_where_blocks_change() {
    struct Edge {
        forbids: bool,
    }
    impl Problem<1> for Edge {
        type State = f64;
        fn blocks(&self, x: &f64, visitor: &mut impl Visitor<1>) {
            if *x < 0.5 {
                visitor.block(RobustKernel::None, &SVector::from([3.0 * x]), || {
                    SMatrix::<f64, 1, 1>::new(3.0)
                });
            } else if self.forbids {
                visitor.forbid();
            }
        }
        fn step(&self, x: &f64, step: &SVector<f64, 1>) -> f64 {
            x + step[0]
        }
    }
    for forbids in [true, false] {
        let at = |x: f64| check_jacobian(&Edge { forbids }, &x, 0.01).map(|c| c.elements);
        assert_eq!(at(0.47), Some(1), "two steps below the edge");
        assert_eq!(at(0.485), None, "the second step is across");
        assert_eq!(at(0.51), None, "blocks appear behind");
    }
    let nothing = check_jacobian(&Edge { forbids: false }, &0.6, 0.01);
    assert_eq!(
        nothing.map(|c| (c.elements, c.worst > 0.0)),
        Some((0, false)),
        "no block"
    );
}

#[test]
fn order_of_the_observations_does_not_matter() {
    let mut seen = observations(&truth(), 80, 3);
    for (i, o) in seen.iter_mut().enumerate() {
        o.uv_px.x += libm::sin(i as f64); // something to disagree about
    }
    let initial = Se3::exp(&Vector6::repeat(0.02)) * truth();
    let solve = |seen: &[PoseObservation]| {
        optimise_pose(&camera(), seen, &initial, &PoseConfig::default()).expect("sound")
    };
    let forwards = solve(&seen);
    seen.reverse();
    let backwards = solve(&seen);
    let apart = forwards.camera_from_world * backwards.camera_from_world.inverse();
    assert!(apart.log().norm() < 1e-9, "{apart:?}");
    let flags: Vec<bool> = backwards.inlier.iter().rev().copied().collect();
    assert_eq!(flags, forwards.inlier, "the same inliers");
}

#[test]
fn outliers_and_points_behind_the_camera_are_left_out() {
    let mut seen = observations(&truth(), 60, 4);
    for o in &mut seen[..12] {
        o.uv_px += Vector2::new(40.0, -25.0);
    }
    let behind = truth().inverse() * Vector3::new(0.1, 0.0, -2.0);
    let at_the_centre = truth().inverse() * Vector3::zeros();
    seen[12].p_world = behind;
    seen[13].p_world = at_the_centre;
    let initial = Se3::exp(&Vector6::repeat(0.01)) * truth();
    for restart_from_initial in [true, false] {
        let config = PoseConfig {
            restart_from_initial,
            ..PoseConfig::default()
        };
        let solution = optimise_pose(&camera(), &seen, &initial, &config).expect("sound");
        let expected: Vec<bool> = (0..60).map(|i| i >= 14).collect();
        assert_eq!(solution.inlier, expected, "restart {restart_from_initial}");
        let error = solution.camera_from_world * truth().inverse();
        assert!(
            error.log().norm() < 1e-6,
            "restart {restart_from_initial}: {error:?}"
        );
        assert_eq!(solution.reports.len(), 4, "rounds");
    }
}

#[test]
fn information_is_the_hessian_of_the_inliers() {
    let seen = observations(&truth(), 30, 5);
    let solution =
        optimise_pose(&camera(), &seen, &truth(), &PoseConfig::default()).expect("sound");
    let problem = PoseProblem::new(&camera(), BF, None, seen);
    let mut blocks = Recorder::<6>::default();
    problem.blocks(&solution.camera_from_world, &mut blocks);
    let rows = blocks.blocks.iter().flat_map(|b| b.jacobian.iter());
    let expected = rows.fold(SMatrix::<f64, 6, 6>::zeros(), |sum, j| {
        sum + j * j.transpose()
    });
    let error = (expected - solution.information).amax() / expected.amax();
    assert!(error < 1e-12, "{error}");
}

#[test]
fn bad_input_is_named() {
    let good = observations(&truth(), 12, 6);
    let solve = |seen: &[PoseObservation], config: &PoseConfig| {
        optimise_pose(&camera(), seen, &truth(), config).map(|_| ())
    };
    let config = PoseConfig::default();
    assert_eq!(
        solve(&good[..2], &config),
        Err(OptimError::TooFewObservations { got: 2, needed: 3 }),
        "too few"
    );
    let with = |change: fn(&mut PoseObservation)| {
        let mut seen = good.clone();
        change(&mut seen[4]);
        solve(&seen, &config).expect_err("refused").to_string()
    };
    assert!(
        with(|o| o.p_world.y = f64::NAN).contains("observation 4 is not finite"),
        "point"
    );
    assert!(
        with(|o| o.uv_px.x = f64::INFINITY).contains("observation 4 is not finite"),
        "pixel"
    );
    assert!(
        with(|o| o.sigma_px = 0.0).contains("sigma_px of observation 4 is 0"),
        "sigma"
    );
    let right = |u_px, sigma_px| Some(DepthObservation::Right { u_px, sigma_px });
    let mut seen = good.clone();
    seen[4].depth = right(f64::NAN, 1.0);
    assert!(solve(&seen, &config).is_err(), "right coordinate");
    seen[4].depth = right(1.0, -1.0);
    assert!(solve(&seen, &config).is_err(), "right sigma");
    let flat = PoseConfig { bf: 0.0, ..config };
    assert!(solve(&good, &flat).is_err(), "no baseline");
    let lost = Se3::new(So3::identity(), Vector3::new(f64::NAN, 0.0, 0.0));
    assert!(
        optimise_pose(&camera(), &good, &lost, &config).is_err(),
        "pose"
    );
}

#[test]
fn with_everything_behind_the_camera_the_initial_pose_comes_back() {
    let seen = observations(&truth(), 12, 7);
    let turned = Se3::new(So3::exp(&Vector3::new(0.0, 3.1, 0.0)), Vector3::zeros()) * truth();
    let solution = optimise_pose(&camera(), &seen, &turned, &PoseConfig::default()).expect("sound");
    assert_eq!(solution.camera_from_world, turned, "where it was");
    assert_eq!(
        (solution.n_inliers, solution.reports.len()),
        (0, 0),
        "nothing done"
    );
}

/// Huge but finite numbers, points on the image plane: an answer or an error, never a NaN.
#[test]
fn extreme_numbers_leave_the_pose_finite() {
    for poison in [1e300, -1e300, 1e-300, 1e18, f64::MIN_POSITIVE, 5e-324] {
        let mut seen = observations(&truth(), 30, 8);
        seen[0].p_world = Vector3::repeat(poison);
        seen[1].uv_px.x = poison;
        seen[3].p_world.z = poison;
        let solution =
            optimise_pose(&camera(), &seen, &truth(), &PoseConfig::default()).expect("finite");
        assert!(solution.camera_from_world.is_finite(), "{poison}");
        assert!(solution.n_inliers >= 26, "{poison}: {}", solution.n_inliers);
        assert!(
            solution.information.iter().all(|v| v.is_finite()),
            "{poison}"
        );
        let finite = |r: &Report| r.cost.is_finite() && r.cost <= r.cost0;
        assert!(
            solution.reports.iter().all(finite),
            "{poison}: {:?}",
            solution.reports
        );
    }
}

/// σ from a depth error: u_R and the disparity move by bf/d² per metre.
#[test]
fn a_depth_reading_in_both_forms() {
    let right = DepthObservation::right_from_depth(300.0, 1.2, 2.0, 0.05, BF);
    let disparity = DepthObservation::disparity_from_depth(2.0, 0.05, BF);
    let DepthObservation::Right { u_px, sigma_px } = right else {
        panic!("{right:?}");
    };
    assert!((u_px - 280.0).abs() < 1e-12, "300 - 40/2");
    assert!(
        (sigma_px - 1.3).abs() < 1e-12,
        "1.2 and 40/4·0.05 = 0.5 are the legs"
    );
    let DepthObservation::Disparity {
        disparity_px,
        sigma_px,
    } = disparity
    else {
        panic!("{disparity:?}");
    };
    assert!((disparity_px - 20.0).abs() < 1e-12, "40/2");
    assert!((sigma_px - 0.5).abs() < 1e-12, "40/4·0.05");
}
