//! Optima found elsewhere (scipy, mpmath) must be found here too.

use garad_core::{Camera, Se3, So3};
use garad_golden::Case;
use garad_optim::{PoseConfig, PoseObservation, PoseSolution, RightObservation, optimise_pose};
use nalgebra::{Matrix3, Vector2, Vector3};

fn camera(case: &Case) -> Camera {
    let intrinsics = ["fx", "fy", "cx", "cy"].map(|name| case.param_f64(name));
    Camera::pinhole((640, 480), intrinsics).expect("a valid calibration")
}

fn pose_observations(case: &Case) -> Vec<PoseObservation> {
    let tensors = ["p_world", "uv", "sigma", "right"].map(|name| case.input(name).f64());
    let [p_world, uv, sigma, right] = &tensors;
    (0..sigma.len())
        .map(|i| PoseObservation {
            p_world: Vector3::from_column_slice(&p_world[3 * i..3 * i + 3]),
            uv_px: Vector2::from_column_slice(&uv[2 * i..2 * i + 2]),
            sigma_px: sigma[i],
            right: right[2 * i].is_finite().then(|| RightObservation {
                u_px: right[2 * i],
                sigma_px: right[2 * i + 1],
            }),
        })
        .collect()
}

fn initial(case: &Case) -> Se3 {
    let rotation = Matrix3::from_row_slice(&case.input("rotation_initial").f64());
    let translation = Vector3::from_column_slice(&case.input("translation_initial").f64());
    Se3::new(So3::from_matrix(&rotation), translation)
}

fn run(case: &Case, config: &PoseConfig) -> PoseSolution {
    optimise_pose(
        &camera(case),
        &pose_observations(case),
        &initial(case),
        config,
    )
    .expect("sound input")
}

fn config(case: &Case) -> PoseConfig {
    PoseConfig {
        bf: case.param_f64("bf"),
        rounds: case.param_usize("rounds"),
        chi2_2d: case.param_f64("chi2_2d"),
        chi2_3d: case.param_f64("chi2_3d"),
        ..PoseConfig::default()
    }
}

/// The entries of R row by row, as the case holds them.
fn row_major(rotation: &Matrix3<f64>) -> Vec<f64> {
    rotation.transpose().iter().copied().collect()
}

#[test]
fn poses_are_the_optima() {
    let mut problems = Vec::new();
    for case in Case::load_all("pose_lm") {
        let config = PoseConfig {
            iterations: 60,
            cost_tolerance: 1e-18,
            ..config(&case)
        };
        let solution = run(&case, &config);
        let pose = solution.camera_from_world;
        let inlier: Vec<f64> = solution
            .inlier
            .iter()
            .map(|&i| f64::from(u8::from(i)))
            .collect();
        for (name, got) in [
            ("cost_initial", vec![solution.reports[0].cost0]),
            ("cost", vec![solution.cost]),
            ("rotation", row_major(&pose.rotation.matrix())),
            ("translation", pose.translation.iter().copied().collect()),
            ("inlier", inlier),
        ] {
            problems.extend(case.check(name, &got).err());
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

/// With the default budget of 10 trials per round the cost is within 1e-6 of the optimum, and a
/// run never ends above its start.
#[test]
fn ten_trials_are_enough() {
    for case in Case::load_all("pose_lm") {
        let solution = run(&case, &config(&case));
        let optimum = case.output("cost").f64()[0];
        assert!(
            solution.cost <= optimum * (1.0 + 1e-6),
            "{}: {} against {optimum}, {:?}",
            case.name(),
            solution.cost,
            solution.reports
        );
        for report in &solution.reports {
            assert!(report.cost <= report.cost0, "{}: {report:?}", case.name());
        }
    }
}
