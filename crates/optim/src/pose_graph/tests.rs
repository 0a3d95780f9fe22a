//! Loops whose best shape is known, by both linear solvers, and derivatives by differences.

use super::*;
use crate::lm::StopReason;
use crate::testing::with_each_solver;
use garad_core::{Rng, So3};
use nalgebra::Vector3;
use proptest::prelude::*;

fn tight(linear_solver: LinearSolver) -> PoseGraphConfig {
    PoseGraphConfig {
        iterations: 100,
        cost_tolerance: 1e-20,
        linear_solver,
        ..PoseGraphConfig::default()
    }
}

fn random_motion(rng: &mut Rng, size: f64) -> Se3 {
    Se3::exp(&Vector6::from_fn(|_, _| size * rng.normal()))
}

/// A random positive definite matrix with eigenvalues of order 1 to 10.
fn random_information(rng: &mut Rng) -> Matrix6<f64> {
    let j = Matrix6::from_fn(|_, _| rng.normal());
    j.transpose() * j + Matrix6::identity()
}

with_each_solver! {
    a_drift_of_translation_is_spread_evenly
    a_drift_of_rotation_is_spread_by_weight
    exact_edges_undo_any_disturbance
    a_wrong_closure_is_bent_around
    what_is_not_connected_stays
    a_pose_against_itself_is_constant
}

/// A walk of n poses, with noise on its odometry, that is closed at every tenth pose.
fn walk(n: usize, noise: f64) -> PoseGraph {
    let mut rng = Rng::keyed(11, &[n as u64]);
    let mut graph = PoseGraph::default();
    let mut truth = vec![Se3::identity()];
    for k in 1..n {
        let forward = Se3::new(So3::exp(&Vector3::new(0.0, 0.3, 0.02)), Vector3::z() * -0.3);
        truth.push(forward * random_motion(&mut rng, 0.05) * truth[k - 1]);
    }
    let mut edge = |a: usize, b: usize| PoseEdge {
        a,
        b,
        a_from_b: truth[a] * truth[b].inverse() * random_motion(&mut rng, noise),
        information: random_information(&mut rng),
    };
    let mut edges: Vec<PoseEdge> = (1..n).map(|k| edge(k, k - 1)).collect();
    graph.add_pose(truth[0], true);
    for k in 1..n {
        let pose = edges[k - 1].a_from_b * graph.poses[k - 1];
        assert_eq!(graph.add_pose(pose, false), k, "its index");
    }
    edges.extend((10..n).step_by(10).map(|k| edge(k, k - 10)));
    graph.edges = edges;
    graph
}

fn a_drift_of_translation_is_spread_evenly(solver: LinearSolver) {
    // Round a square of one metre, each step measured 2 cm too long in x; rotations known.
    let corners = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)];
    let truth = corners.map(|(x, y)| Se3::new(So3::identity(), Vector3::new(x, y, 0.0)));
    let drift = Se3::new(So3::identity(), Vector3::new(0.02, 0.0, 0.0));
    let sure_of_rotation = Vector6::new(1.0, 1.0, 1.0, 1e12, 1e12, 1e12);
    let mut graph = PoseGraph {
        poses: vec![truth[0]; 4],
        fixed: vec![true, false, false, false],
        edges: (0..4)
            .map(|k| PoseEdge {
                a: (k + 1) % 4,
                b: k,
                a_from_b: drift * truth[(k + 1) % 4] * truth[k].inverse(),
                information: Matrix6::from_diagonal(&sure_of_rotation),
            })
            .collect(),
    };
    let report = graph.optimise(&tight(solver)).unwrap();
    // Every edge is 2 cm off and all can be met but for the sum of 8 cm: each keeps its 2 cm.
    for (pose, expected) in graph.poses.iter().zip(&truth) {
        assert!((*pose * expected.inverse()).log().norm() < 1e-9, "{pose:?}");
    }
    assert!(
        (report.report.cost - 4.0 * 0.5 * 4e-4).abs() < 1e-12,
        "{report:?}"
    );
    assert!(
        report.chi2.iter().all(|c| (c - 4e-4).abs() < 1e-12),
        "{report:?}"
    );
}

fn a_drift_of_rotation_is_spread_by_weight(solver: LinearSolver) {
    // Turning on the spot by quarters, measured as 90° + 4°, 90°, 90°, 90°; the third edge counts half.
    let turn = |deg: f64| So3::exp(&(Vector3::y() * deg.to_radians()));
    let mut graph = PoseGraph::default();
    for k in 0..4 {
        graph.add_pose(
            Se3::new(turn(90.0 * f64::from(k)), Vector3::zeros()),
            k == 0,
        );
    }
    for k in 0..4 {
        graph.edges.push(PoseEdge {
            a: (k + 1) % 4,
            b: k,
            a_from_b: Se3::new(turn(if k == 0 { 94.0 } else { 90.0 }), Vector3::zeros()),
            information: Matrix6::identity() * if k == 2 { 0.5 } else { 1.0 },
        });
    }
    let report = graph.optimise(&tight(solver)).unwrap();
    // 4° = 0.8° + 0.8° + 1.6° + 0.8°, in proportion to 1 / weight.
    let expected = [0.0, 93.2, 182.4, 270.8].map(turn);
    for (pose, expected) in graph.poses.iter().zip(expected) {
        let error = (pose.rotation * expected.inverse()).log().norm();
        assert!(error < 1e-9 && pose.translation.norm() < 1e-9, "{pose:?}");
    }
    let unit = 0.8f64.to_radians();
    let expected = 0.5 * unit * unit * (3.0 + 0.5 * 4.0);
    assert!((report.report.cost - expected).abs() < 1e-12, "{report:?}");
}

fn exact_edges_undo_any_disturbance(solver: LinearSolver) {
    let mut graph = walk(60, 0.0);
    let truth = graph.poses.clone();
    let mut rng = Rng::new(2);
    for pose in &mut graph.poses[1..] {
        *pose = random_motion(&mut rng, 0.2) * *pose;
    }
    let report = graph.optimise(&tight(solver)).unwrap();
    assert!(report.report.cost < 1e-12, "{report:?}");
    for (pose, expected) in graph.poses.iter().zip(&truth) {
        assert!((*pose * expected.inverse()).log().norm() < 1e-6, "{pose:?}");
    }
}

/// One closure in six is nonsense: Cauchy's kernel lets it go.
fn a_wrong_closure_is_bent_around(solver: LinearSolver) {
    let mut graph = walk(60, 0.001);
    let truth = walk(60, 0.0);
    let wrong = graph.edges.len() - 3;
    graph.edges[wrong].a_from_b = random_motion(&mut Rng::new(5), 1.0);
    let config = PoseGraphConfig {
        kernel: RobustKernel::Cauchy { c: 0.02 },
        ..tight(solver)
    };
    let report = graph.optimise(&config).unwrap();
    let worst = (0..report.chi2.len()).max_by(|&i, &j| report.chi2[i].total_cmp(&report.chi2[j]));
    assert_eq!(worst, Some(wrong), "named by its chi2");
    for edge in &truth.edges {
        let others = edge.error(&graph.poses).log().norm();
        assert!(
            others < 0.02 || edge.a % 10 == 0,
            "{} {}: {others}",
            edge.a,
            edge.b
        );
    }
}

proptest! {
    /// Jacobians against central differences, through the same left perturbation.
    #[test]
    fn jacobians_are_derivatives(seed: u64, size in 0.0f64..0.8) {
        let mut rng = Rng::new(seed);
        let poses = [random_motion(&mut rng, 1.0), random_motion(&mut rng, 1.0)];
        let edge = PoseEdge {
            a: 0,
            b: 1,
            a_from_b: poses[0] * poses[1].inverse() * random_motion(&mut rng, size),
            information: Matrix6::identity(),
        };
        let (r, by_a, by_b) = edge.linearise(&poses);
        prop_assume!(r.fixed_rows::<3>(3).norm() < 2.8); // away from the kink of the logarithm
        let h = 1e-5;
        for (moved, jacobian) in [(0, by_a), (1, by_b)] {
            for i in 0..6 {
                let at = |h: f64| {
                    let mut xi = Vector6::zeros();
                    xi[i] = h;
                    let mut poses = poses;
                    poses[moved] = Se3::exp(&xi) * poses[moved];
                    edge.error(&poses).log()
                };
                let column = (at(h) - at(-h)) / (2.0 * h);
                let error = (column - jacobian.column(i)).amax();
                prop_assert!(error < 1e-7, "pose {moved}, column {i}: {error}");
            }
        }
    }
}

/// As closely as the cost, known to 1e-16, tells poses apart: to the root of that.
#[test]
fn both_solvers_find_the_same_poses() {
    let optimised = [LinearSolver::Portable, LinearSolver::Faer].map(|solver| {
        let mut graph = walk(80, 0.05);
        graph.optimise(&tight(solver)).unwrap();
        graph.poses
    });
    for (portable, faer) in optimised[0].iter().zip(&optimised[1]) {
        let apart = (*portable * faer.inverse()).log().norm();
        assert!(apart < 1e-7, "{apart}");
    }
}

fn what_is_not_connected_stays(solver: LinearSolver) {
    let mut graph = walk(5, 0.1);
    let alone = Se3::new(So3::identity(), Vector3::new(7.0, 8.0, 9.0));
    graph.add_pose(alone, false);
    graph.optimise(&tight(solver)).unwrap();
    assert_eq!(graph.poses[5], alone, "no edge, no move");
    let nothing = PoseGraph::default().optimise(&tight(solver)).unwrap();
    assert_eq!(
        nothing.report.stop,
        StopReason::ZeroGradient,
        "an empty graph"
    );
}

/// An edge from a pose to itself that is not the identity cannot be met and moves nothing else.
fn a_pose_against_itself_is_constant(solver: LinearSolver) {
    let mut graph = walk(3, 0.0);
    let before = graph.poses.clone();
    graph.edges.push(PoseEdge {
        a: 2,
        b: 2,
        a_from_b: Se3::identity(),
        information: Matrix6::identity(),
    });
    graph.optimise(&tight(solver)).unwrap();
    for (pose, before) in graph.poses.iter().zip(&before) {
        assert!((*pose * before.inverse()).log().norm() < 1e-9, "{pose:?}");
    }
}

type Change = fn(&mut PoseGraph);

#[test]
fn bad_input_is_named_and_nothing_moves() {
    let error_of = |change: Change| {
        let mut graph = walk(4, 0.1);
        change(&mut graph);
        let before = format!("{graph:?}");
        let error = graph.optimise(&tight(LinearSolver::Portable)).unwrap_err();
        assert_eq!(before, format!("{graph:?}"), "untouched");
        error.to_string()
    };
    let cases: [(Change, &str); 6] = [
        (
            |g| g.edges[1].a = 9,
            "observation 1 refers to pose 9; there are 4",
        ),
        (|g| g.fixed.clear(), "fixed: 0 entries; expected 4"),
        (
            |g| g.poses[2].translation.x = f64::NAN,
            "pose 2 is not finite",
        ),
        (
            |g| g.edges[0].information[(1, 1)] = f64::INFINITY,
            "edge 0 is not finite",
        ),
        (
            |g| g.edges[2].information[(4, 4)] = -1.0,
            "information of edge 2",
        ),
        (
            |g| g.edges[2].information[(0, 4)] += 1.0,
            "information of edge 2",
        ),
    ];
    for (change, expected) in cases {
        let error = error_of(change);
        assert!(error.contains(expected), "{error}");
    }
}

/// The assembled gradient is the derivative of the cost through the step, with kernels that act on some
/// edges and not on others.
#[test]
fn gradient_is_the_derivative_of_the_cost() {
    for kernel in [
        RobustKernel::None,
        RobustKernel::Huber { delta: 0.7 },
        RobustKernel::GemanMcClure { c: 0.7 },
    ] {
        let mut graph = walk(12, 0.1);
        graph.fixed[4] = true;
        let config = PoseGraphConfig {
            kernel,
            ..PoseGraphConfig::default()
        };
        let mut rng = Rng::new(8);
        for pose in &mut graph.poses {
            *pose = random_motion(&mut rng, 0.1) * *pose;
        }
        let chi2 = graph.edges.iter().map(|e| e.chi2(&graph.poses));
        let beyond = chi2.filter(|c| *c > 0.49).count();
        assert!(
            beyond > 1 && beyond < graph.edges.len(),
            "{beyond} beyond the knee"
        );
        let model = GraphModel::new(&graph, &config);
        let system = (&&model).linearise(&graph.poses);
        let error = (system.cost - (&&model).cost(&graph.poses)).abs();
        assert!(error < 1e-12 * system.cost, "both ways to the cost agree");
        let scale = system.gradient_norm();
        for k in 0..system.gradient.len() {
            for i in 0..6 {
                let cost = |h: f64| {
                    let mut step = vec![Vector6::zeros(); system.gradient.len()];
                    step[k][i] = h;
                    (&&model).cost(&(&&model).step(&graph.poses, &step))
                };
                let slope = (cost(1e-6) - cost(-1e-6)) / 2e-6;
                let error = (slope - system.gradient[k][i]).abs();
                assert!(error < 1e-6 * scale, "{kernel:?}, step {k}, {i}: {error}");
            }
        }
    }
}

/// One edge along x: r = 3, Ω = 4, so s = 36; the other directions are exact. With Huber's δ = 2 the weight is ⅓:
/// H = 4/3, g = 4, and at λ = ½ the step is -4 / 2 and the model expects ½ · 2 (⅔ · 2 + 4).
#[test]
fn one_step_by_hand_with_a_kernel() {
    let along = |x: f64| Se3::new(So3::identity(), Vector3::new(x, 0.0, 0.0));
    let graph = PoseGraph {
        poses: vec![Se3::identity(), along(5.0)],
        fixed: vec![true, false],
        edges: vec![PoseEdge {
            a: 1,
            b: 0,
            a_from_b: along(2.0),
            information: Matrix6::identity() * 4.0,
        }],
    };
    let config = PoseGraphConfig {
        kernel: RobustKernel::Huber { delta: 2.0 },
        ..PoseGraphConfig::default()
    };
    let model = GraphModel::new(&graph, &config);
    let system = (&&model).linearise(&graph.poses);
    let damped = system.solve(0.5).expect("positive definite");
    assert!((system.cost - 10.0).abs() < 1e-12, "½ (2 · 2 · 6 - 4)");
    let error = (damped.step[0] - Vector6::new(-2.0, 0.0, 0.0, 0.0, 0.0, 0.0)).amax();
    assert!(error < 1e-12, "{:?}", damped.step);
    let error = (damped.model_decrease - 16.0 / 3.0).abs();
    assert!(error < 1e-12, "{}", damped.model_decrease);
}

#[test]
fn trials_tolerance_and_chi2_are_those_asked_for() {
    for (iterations, cost_tolerance, trials, stop) in [
        (0, 1e-9, 0, StopReason::IterationLimit),
        (1, 1e-9, 1, StopReason::IterationLimit),
        (2, 1e-12, 2, StopReason::IterationLimit),
        (5, 2.1, 0, StopReason::Converged),
    ] {
        let mut graph = walk(25, 0.2);
        let config = PoseGraphConfig {
            iterations,
            cost_tolerance,
            kernel: RobustKernel::Huber { delta: 1.5 },
            ..PoseGraphConfig::default()
        };
        let report = graph.optimise(&config).unwrap();
        assert_eq!(
            (
                report.report.iterations + report.report.rejected,
                report.report.stop
            ),
            (trials, stop),
            "{iterations}, {cost_tolerance}: {report:?}"
        );
        // χ² is without the kernel, of the poses at the end.
        let rho = report.chi2.iter().map(|s| config.kernel.rho(*s));
        let cost = 0.5 * rho.fold(0.0, |a, b| a + b);
        assert!(
            (cost - report.report.cost).abs() < 1e-12 * cost,
            "{report:?}"
        );
    }
}

#[test]
fn scales_of_kernels_must_be_positive() {
    for wrong in [0.0, -1.5, f64::INFINITY] {
        for kernel in [
            RobustKernel::Huber { delta: wrong },
            RobustKernel::Cauchy { c: wrong },
            RobustKernel::GemanMcClure { c: wrong },
            RobustKernel::Tukey { c: wrong },
        ] {
            let config = PoseGraphConfig {
                kernel,
                ..PoseGraphConfig::default()
            };
            let error = walk(4, 0.1).optimise(&config).unwrap_err().to_string();
            assert!(error.contains("scale of the kernel"), "{kernel:?}: {error}");
        }
    }
}
