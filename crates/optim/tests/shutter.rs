//! Laws of the pose with a rolling shutter, and of the prior of the centre.

mod common;

use garad_core::{RollingShutter, Se3};
use garad_optim::shutter::TurnProblem;
use garad_optim::{
    CentrePrior, PoseAndTurn, PoseConfig, PoseObservation, TurnConfig, check_jacobian,
    optimise_pose, optimise_pose_and_turn,
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
