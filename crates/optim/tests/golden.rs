//! Optima found elsewhere (scipy, mpmath) must be found here too.

use garad_core::{Camera, Par, Se3, So3};
use garad_golden::Case;
use garad_optim::dense::{Problem, Recorder};
use garad_optim::pose::PoseProblem;
use garad_optim::{
    BundleConfig, BundleObservation, BundleReport, DepthObservation, PnpConfig, PoseConfig,
    PoseEdge, PoseGraph, PoseGraphConfig, PoseObservation, PoseSolution, Report, RobustKernel,
    StopReason, optimise_bundle, optimise_pose, p3p, solve_pnp_ransac,
};
use nalgebra::{Matrix3, Matrix6, Vector2, Vector3};

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
            depth: right_observation(&right[2 * i..2 * i + 2]),
        })
        .collect()
}

/// (u_R, σ_R), NaN for none.
fn right_observation(pair: &[f64]) -> Option<DepthObservation> {
    let [u_px, sigma_px] = [pair[0], pair[1]];
    u_px.is_finite()
        .then_some(DepthObservation::Right { u_px, sigma_px })
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

/// The true pose is among those of each triple; of several answers the nearest is compared.
fn poses_of_triples(case: &Case) -> (Vec<f64>, Vec<f64>) {
    let (points, uv) = (case.input("p_world").f64(), case.input("uv").f64());
    let rotations = case.output("rotation").f64();
    let truth = poses(&rotations, &case.output("translation").f64());
    let (mut rotation, mut translation) = (Vec::new(), Vec::new());
    for (i, truth) in truth.iter().enumerate() {
        let p_world = [0, 1, 2].map(|k| Vector3::from_column_slice(&points[9 * i + 3 * k..][..3]));
        let seen = [0, 1, 2].map(|k| {
            let uv_px = Vector2::from_column_slice(&uv[6 * i + 2 * k..][..2]);
            camera(case).unproject(&uv_px, 1.0)
        });
        let error = |pose: &Se3| (*pose * truth.inverse()).log().norm();
        let found = p3p(&seen, &p_world);
        let nearest = found
            .iter()
            .min_by(|a, b| error(a).total_cmp(&error(b)))
            .unwrap_or_else(|| panic!("{}: triple {i} has no pose", case.name()));
        rotation.extend(row_major(&nearest.rotation.matrix()));
        translation.extend(nearest.translation.iter());
    }
    (rotation, translation)
}

#[test]
fn lost_cameras_are_found() {
    let mut problems = Vec::new();
    for case in Case::load_all("pnp") {
        if case.has_flag("exact") {
            let (rotation, translation) = poses_of_triples(&case);
            problems.extend(case.check("rotation", &rotation).err());
            problems.extend(case.check("translation", &translation).err());
            continue;
        }
        let tensors = ["p_world", "uv", "sigma"].map(|name| case.input(name).f64());
        let [p_world, uv, sigma] = &tensors;
        let observations: Vec<_> = (0..sigma.len())
            .map(|i| PoseObservation {
                p_world: Vector3::from_column_slice(&p_world[3 * i..3 * i + 3]),
                uv_px: Vector2::from_column_slice(&uv[2 * i..2 * i + 2]),
                sigma_px: sigma[i],
                depth: None,
            })
            .collect();
        let config = PnpConfig {
            pose: PoseConfig {
                iterations: 60,
                cost_tolerance: 1e-18,
                ..PoseConfig::default()
            },
            ..PnpConfig::default()
        };
        let result = solve_pnp_ransac(&camera(&case), &observations, &config, Par::Threads(2));
        let result = result.expect("sound input").expect("a pose");
        let pose = result.camera_from_world;
        let inlier = result.inlier.iter().map(|&i| f64::from(u8::from(i)));
        for (name, got) in [
            ("rotation", row_major(&pose.rotation.matrix())),
            ("translation", pose.translation.iter().copied().collect()),
            ("inlier", inlier.collect()),
        ] {
            problems.extend(case.check(name, &got).err());
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

#[test]
fn derivatives_are_those_of_the_projection() {
    let mut problems = Vec::new();
    for case in Case::load_all("reprojection") {
        let camera = camera(&case);
        let observations = pose_observations(&case);
        let (phi, t) = (case.input("phi").f64(), case.input("t").f64());
        let (mut residual, mut by_pose, mut by_point) = (Vec::new(), Vec::new(), Vec::new());
        for (i, observation) in observations.iter().enumerate() {
            let vector = |v: &[f64]| Vector3::from_column_slice(&v[3 * i..3 * i + 3]);
            let pose = Se3::new(So3::exp(&vector(&phi)), vector(&t));
            let bf = case.param_f64("bf");
            let mut seen = Recorder::<6>::default();
            PoseProblem::new(&camera, bf, None, vec![*observation]).blocks(&pose, &mut seen);
            let block = &seen.blocks[0];
            residual.extend(&block.residual);
            by_pose.extend(block.jacobian.iter().flat_map(|row| row.iter().copied()));
            let p_cam = pose * observation.p_world;
            let point = camera.project_jacobian(&p_cam) * pose.rotation.matrix();
            by_point.extend((point / observation.sigma_px).transpose().iter().copied());
        }
        for (name, got) in [
            ("residual", residual),
            ("by_pose", by_pose),
            ("by_point", by_point),
        ] {
            problems.extend(case.check(name, &got).err());
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

struct Bundle {
    poses: Vec<Se3>,
    points: Vec<Vector3<f64>>,
    report: BundleReport,
}

/// Rotations and translations, as the case holds them.
fn poses(rotations: &[f64], translations: &[f64]) -> Vec<Se3> {
    (rotations.chunks_exact(9).zip(translations.chunks_exact(3)))
        .map(|(r, t)| {
            let rotation = So3::from_matrix(&Matrix3::from_row_slice(r));
            Se3::new(rotation, Vector3::from_column_slice(t))
        })
        .collect()
}

fn adjust(case: &Case, config: &BundleConfig) -> Bundle {
    let mut poses = poses(
        &case.input("rotation_initial").f64(),
        &case.input("translation_initial").f64(),
    );
    let fixed: Vec<bool> = case.input("fixed").u8().iter().map(|&f| f == 1).collect();
    let points = case.input("points_initial").f64();
    let mut points: Vec<_> = points
        .chunks_exact(3)
        .map(Vector3::from_column_slice)
        .collect();
    let tensors = ["uv", "sigma", "right"].map(|name| case.input(name).f64());
    let [uv, sigma, right] = &tensors;
    let index = |i: i64| usize::try_from(i).expect("an index");
    let observations: Vec<BundleObservation> = (case.input("observed").i64().chunks_exact(2))
        .enumerate()
        .map(|(i, pair)| BundleObservation {
            pose: index(pair[0]),
            point: index(pair[1]),
            uv_px: Vector2::from_column_slice(&uv[2 * i..2 * i + 2]),
            sigma_px: sigma[i],
            depth: right_observation(&right[2 * i..2 * i + 2]),
        })
        .collect();
    let report = optimise_bundle(
        &camera(case),
        case.param_f64("bf"),
        &mut poses,
        &fixed,
        &mut points,
        &observations,
        config,
    )
    .expect("sound input");
    Bundle {
        poses,
        points,
        report,
    }
}

fn bundle_config(case: &Case) -> BundleConfig {
    BundleConfig {
        chi2_2d: case.param_f64("chi2_2d"),
        chi2_3d: case.param_f64("chi2_3d"),
        ..BundleConfig::default()
    }
}

#[test]
fn bundles_are_the_optima() {
    let mut problems = Vec::new();
    for case in Case::load_all("bundle") {
        let config = BundleConfig {
            iterations: 300,
            cost_tolerance: 1e-18,
            ..bundle_config(&case)
        };
        let bundle = adjust(&case, &config);
        let rotations = bundle.poses.iter().map(|p| p.rotation.matrix());
        let translations = bundle.poses.iter().map(|p| p.translation);
        for (name, got) in [
            ("cost_initial", vec![bundle.report.report.cost0]),
            ("cost", vec![bundle.report.report.cost]),
            ("rotation", rotations.flat_map(|r| row_major(&r)).collect()),
            (
                "translation",
                translations.flat_map(<[f64; 3]>::from).collect(),
            ),
            (
                "points",
                bundle
                    .points
                    .iter()
                    .copied()
                    .flat_map(<[f64; 3]>::from)
                    .collect(),
            ),
        ] {
            problems.extend(case.check(name, &got).err());
        }
        // At its default stop the cost is within 1e-6 of the optimum.
        let config = BundleConfig {
            iterations: 40,
            ..bundle_config(&case)
        };
        let Report { cost, stop, .. } = adjust(&case, &config).report.report;
        let optimum = case.output("cost").f64()[0];
        if stop != StopReason::Converged || cost > optimum * (1.0 + 1e-6) {
            problems.push(format!("{}: {stop:?} at {cost}, {optimum}", case.name()));
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

fn graph(case: &Case) -> PoseGraph {
    let input = |name: &str| case.input(name).f64();
    let poses_of = |r: &str, t: &str| poses(&input(r), &input(t));
    let start = poses_of("rotation_initial", "translation_initial");
    let measured = poses_of("edge_rotation", "edge_translation");
    let ends = case.input("edges").i64();
    let information = input("information");
    let index = |i: i64| usize::try_from(i).expect("an index");
    let edges = (ends.chunks_exact(2).zip(measured))
        .zip(information.chunks_exact(36))
        .map(|((ends, a_from_b), information)| PoseEdge {
            a: index(ends[0]),
            b: index(ends[1]),
            a_from_b,
            information: Matrix6::from_row_slice(information),
        })
        .collect();
    PoseGraph {
        fixed: (0..start.len()).map(|k| k == 0).collect(),
        poses: start,
        edges,
    }
}

#[test]
fn pose_graphs_are_the_optima() {
    let mut problems = Vec::new();
    for case in Case::load_all("pose_graph") {
        let mut solved = graph(&case);
        let config = PoseGraphConfig {
            iterations: 100,
            cost_tolerance: 1e-20,
            ..PoseGraphConfig::default()
        };
        let report = solved.optimise(&config).expect("sound input").report;
        let rotations = solved.poses.iter().map(|p| p.rotation.matrix());
        let translations = solved.poses.iter().map(|p| p.translation);
        for (name, got) in [
            ("cost_initial", vec![report.cost0]),
            ("cost", vec![report.cost]),
            ("rotation", rotations.flat_map(|r| row_major(&r)).collect()),
            (
                "translation",
                translations.flat_map(<[f64; 3]>::from).collect(),
            ),
        ] {
            problems.extend(case.check(name, &got).err());
        }
        // With the default settings the cost is within 1e-6 of the optimum.
        let mut solved = graph(&case);
        let report = solved.optimise(&PoseGraphConfig::default());
        let Report { cost, stop, .. } = report.expect("sound input").report;
        let optimum = case.output("cost").f64()[0];
        if stop != StopReason::Converged || cost > optimum * (1.0 + 1e-6) {
            problems.push(format!("{}: {stop:?} at {cost}, {optimum}", case.name()));
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

#[test]
fn kernels_are_those_of_the_table() {
    let mut problems = Vec::new();
    for case in Case::load_all("robust") {
        let scale = case.param_f64("scale");
        let kernel = match case.param_str("kernel") {
            "huber" => RobustKernel::Huber { delta: scale },
            "cauchy" => RobustKernel::Cauchy { c: scale },
            "geman_mcclure" => RobustKernel::GemanMcClure { c: scale },
            "tukey" => RobustKernel::Tukey { c: scale },
            other => panic!("{}: no kernel '{other}'", case.name()),
        };
        let s = case.input("s").f64();
        let rho: Vec<f64> = s.iter().map(|&s| kernel.rho(s)).collect();
        let weight: Vec<f64> = s.iter().map(|&s| kernel.weight(s)).collect();
        for (name, got) in [("rho", rho), ("weight", weight)] {
            problems.extend(case.check(name, &got).err());
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}
