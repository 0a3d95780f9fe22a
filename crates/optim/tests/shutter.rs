//! Laws of the pose with a rolling shutter, and of the prior of the centre.

mod common;

use garad_core::{RollingShutter, Se3};
use garad_optim::dense::{Problem, Recorder};
use garad_optim::shutter::TurnProblem;
use garad_optim::{
    CentrePrior, PoseAndTurn, PoseConfig, PoseObservation, RobustKernel, TurnConfig,
    check_jacobian, optimise_pose, optimise_pose_and_turn,
};
use nalgebra::{Vector3, Vector6};
use proptest::prelude::*;

use common::{BF, camera, observations, truth};

/// The observations of a camera that turns while its rows are read, as recorded, with the time of
/// each row.
fn rolling(truth: &Se3, turn_rad: Vector3<f64>, seed: u64) -> Vec<(PoseObservation, f64)> {
    let shutter = RollingShutter { turn_rad };
    let seen = observations(truth, 80, seed).into_iter();
    let seen = seen.filter_map(|still| {
        let uv_px = shutter.recorded_pixel(&camera(), &still.uv_px);
        let row_time = RollingShutter::row_time(uv_px.y, camera().height);
        let recorded = PoseObservation {
            uv_px,
            depth: None,
            ..still
        };
        (0.0..480.0)
            .contains(&uv_px.y)
            .then_some((recorded, row_time))
    });
    seen.collect()
}

fn turn_config(sigma_rad: f64) -> TurnConfig {
    TurnConfig {
        bf: BF,
        iterations: 20,
        huber: [2.4, 2.8],
        expected_rad: Vector3::zeros(),
        sigma_rad,
    }
}

proptest! {
    #[test]
    fn turn_jacobians_are_the_derivatives(
        xi in proptest::array::uniform6(-0.05f64..0.05), turn in proptest::array::uniform3(-0.02f64..0.02),
        seed in 0u64..1000,
    ) {
        let seen: Vec<_> = observations(&truth(), 20, seed).into_iter()
            .map(|o| (o, RollingShutter::row_time(o.uv_px.y, camera().height)))
            .collect();
        let config = turn_config(0.01);
        let problem = TurnProblem::new(&camera(), &seen, &config);
        let state = PoseAndTurn {
            camera_from_world: Se3::exp(&Vector6::from_row_slice(&xi)) * truth(),
            shutter: RollingShutter { turn_rad: Vector3::from(turn) },
        };
        let check = check_jacobian(&problem, &state, 3e-4).expect("all in front");
        prop_assert!(check.elements == (20 / 2 * (2 + 3) + 3) * 9, "{check:?}");
        prop_assert!(check.worst < 1e-9, "{check:?}");
    }

    /// Pose and turn are both found; a camera taken for a still one is centimetres off.
    #[test]
    fn exact_rows_give_the_exact_turn(turn in proptest::array::uniform3(-0.01f64..0.01), seed in 0u64..1000) {
        let turn_rad = Vector3::from(turn);
        let seen = rolling(&truth(), turn_rad, seed);
        let initial = PoseAndTurn { camera_from_world: truth(), shutter: RollingShutter::global() };
        let found = optimise_pose_and_turn(&camera(), &seen, &initial, &turn_config(1e3));
        let error = found.camera_from_world * truth().inverse();
        prop_assert!(error.log().norm() < 1e-6, "{error:?}");
        prop_assert!((found.shutter.turn_rad - turn_rad).norm() < 1e-6, "{:?}", found.shutter);
    }
}

/// With σ → 0 nothing but the expected turn is possible.
#[test]
fn a_certain_turn_is_kept() {
    let seen = rolling(&truth(), Vector3::new(0.004, 0.0, 0.0), 3);
    let expected_rad = Vector3::new(0.0, 0.002, 0.0);
    let config = TurnConfig {
        expected_rad,
        ..turn_config(1e-9)
    };
    let initial = PoseAndTurn {
        camera_from_world: truth(),
        shutter: RollingShutter {
            turn_rad: expected_rad,
        },
    };
    let found = optimise_pose_and_turn(&camera(), &seen, &initial, &config);
    let moved = (found.shutter.turn_rad - expected_rad).norm();
    assert!(moved < 1e-9, "{:?}", found.shutter);
}

/// One prior along x beside the links: F = ½ h (x - 0)² + ½ w (x - a)² has its minimum at a w/(h + w),
/// h what the links say of x once all other unknowns follow.
#[test]
fn the_prior_of_the_centre_weighs_by_its_information() {
    let truth = truth();
    let seen = observations(&truth, 40, 5);
    let alone = optimise_pose(&camera(), &seen, &truth, &PoseConfig::default()).expect("sound");
    let covariance = alone.information.try_inverse().expect("determined");
    // In camera coordinates the step of the centre is -ρ; the prior is in world coordinates.
    let rotation = truth.rotation.matrix();
    let covariance = rotation.transpose() * covariance.fixed_view::<3, 3>(0, 0) * rotation;
    let information = covariance.try_inverse().expect("determined");
    let root = information.cholesky().expect("positive definite").l();
    let centre_m = truth.inverse().translation;
    let off_m = Vector3::new(1e-4, 0.0, 0.0);
    let config = PoseConfig {
        prior: Some(CentrePrior {
            centre_m: centre_m + off_m,
            root_information: root,
        }),
        ..PoseConfig::default()
    };
    let both = optimise_pose(&camera(), &seen, &truth, &config).expect("sound");
    let step = both.camera_from_world.inverse().translation - centre_m;
    // As certain as the links: half of the way.
    assert!((step - 0.5 * off_m).norm() < 1e-7, "{step}");
    assert_eq!(both.information, both.information.transpose(), "symmetric");
    let change = (both.information - alone.information).norm() / alone.information.norm();
    assert!(change < 1e-3, "the links' own information: {change}");
}

/// Observations without depth have the first kernel, those with depth the second, the expected turn none: its residual is
/// (ω - ω₀)/σ.
#[test]
fn blocks_have_their_kernels_and_the_turn_its_prior() {
    let seen: Vec<_> = observations(&truth(), 8, 2)
        .into_iter()
        .map(|o| (o, RollingShutter::row_time(o.uv_px.y, camera().height)))
        .collect();
    let config = TurnConfig {
        expected_rad: Vector3::new(0.01, -0.02, 0.03),
        ..turn_config(0.004)
    };
    let state = PoseAndTurn {
        camera_from_world: truth(),
        shutter: RollingShutter {
            turn_rad: Vector3::new(0.014, -0.01, 0.028),
        },
    };
    let mut recorder = Recorder::<9>::default();
    TurnProblem::new(&camera(), &seen, &config).blocks(&state, &mut recorder);
    assert_eq!(recorder.blocks.len(), 9, "eight and the prior");
    for (block, (o, _)) in recorder.blocks.iter().zip(&seen) {
        let delta = if o.depth.is_some() { 2.8 } else { 2.4 };
        assert_eq!(block.kernel, RobustKernel::Huber { delta }, "{o:?}");
    }
    let prior = &recorder.blocks[8];
    assert_eq!(prior.kernel, RobustKernel::None, "the prior");
    for (r, expected) in prior.residual.iter().zip([1.0, 2.5, -0.5]) {
        assert!((r - expected).abs() < 1e-12, "{:?}", prior.residual);
    }
}

/// No trial leaves the state; the baseline is that of the configuration.
#[test]
fn trials_and_baseline_are_those_asked_for() {
    let seen: Vec<_> = observations(&truth(), 40, 4)
        .into_iter()
        .map(|o| (o, 0.1))
        .collect();
    let initial = PoseAndTurn {
        camera_from_world: Se3::exp(&Vector6::repeat(0.01)) * truth(),
        shutter: RollingShutter::global(),
    };
    let error = |config: &TurnConfig| {
        let found = optimise_pose_and_turn(&camera(), &seen, &initial, config);
        (found.camera_from_world * truth().inverse()).log().norm()
    };
    let start = (initial.camera_from_world * truth().inverse()).log().norm();
    let with = |iterations: usize, bf: f64| TurnConfig {
        iterations,
        bf,
        ..turn_config(1e-6)
    };
    assert!((error(&with(0, BF)) - start).abs() < 1e-15, "no trial");
    let (one, all) = (error(&with(1, BF)), error(&with(20, BF)));
    assert!(all < 1e-5 && all < one && one < start, "{one} {all}");
    assert!(error(&with(20, 0.9 * BF)) > 1e-3, "another baseline");
}
