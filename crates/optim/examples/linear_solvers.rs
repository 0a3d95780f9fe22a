//! Both linear solvers on pose graphs and bundles of 100, 1,000 and 5,000 keyframes: the table of decision 017.
//!
//! ```text
//! cargo run --release -p garad-optim --example linear_solvers            # a few minutes, one thread
//! cargo run --release -p garad-optim --example linear_solvers -- 100     # that size alone
//! ```
//!
//! A camera goes round a room, looking outwards, and sees each place again in every lap. A solve is one
//! factorisation and substitution of a system with the blocks of the problem and random values. Its
//! difference is that of the solutions, relative to the largest element; the difference of the whole
//! optimisation is that of the camera centres, relative to the diameter of the path. Times are processor
//! time of the one thread (Linux), which depends little on other load. The bits are a hash of the optimised
//! translations, to be compared between processors.

#![allow(clippy::print_stdout, reason = "an example speaks to its reader")]

use std::time::Duration;

use garad_core::{Camera, Rng, Se3, So3};
use garad_optim::blocks::{BlockMatrix, Pattern};
use garad_optim::{
    BundleConfig, BundleObservation, DepthObservation, LinearSolver, PoseEdge, PoseGraph,
    PoseGraphConfig, Report, optimise_bundle,
};
use nalgebra::{Matrix6, Vector2, Vector3, Vector6};

/// Keyframes, and laps they are spread over.
const SIZES: [(usize, usize); 3] = [(100, 2), (1_000, 4), (5_000, 10)];
const STEP_M: f64 = 0.2;
/// Odometry edges to this many predecessors.
const PREDECESSORS: usize = 4;
const POINTS_PER_KEYFRAME: usize = 50;
const BF: f64 = 40.0;

fn main() {
    let only: Option<usize> = std::env::args().nth(1).and_then(|n| n.parse().ok());
    println!(
        "| problem | keyframes | blocks | solver | numbers in factor | analysis [ms] | solve [ms] | difference | optimisation [s] | trials | difference | bits |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    for (keyframes, laps) in SIZES {
        if only.is_none_or(|n| n == keyframes) {
            let path = Path::new(keyframes, laps);
            pose_graph(&path);
            bundle(&path);
        }
    }
}

struct Path {
    /// `camera_from_world`.
    poses: Vec<Se3>,
    per_lap: usize,
}

impl Path {
    fn new(keyframes: usize, laps: usize) -> Self {
        let per_lap = keyframes / laps;
        let radius_m = Self::radius_m(per_lap);
        let mut rng = Rng::keyed(17, &[keyframes as u64]);
        let poses = (0..keyframes).map(|k| {
            let angle = std::f64::consts::TAU * k as f64 / per_lap as f64;
            let turn = So3::exp(&(Vector3::y() * angle));
            let world_from_camera = Se3::new(turn, turn * (Vector3::z() * radius_m));
            motion(&mut rng, 0.02) * world_from_camera.inverse()
        });
        let poses = poses.collect();
        Self { poses, per_lap }
    }

    fn radius_m(per_lap: usize) -> f64 {
        STEP_M * per_lap as f64 / std::f64::consts::TAU
    }
}

fn motion(rng: &mut Rng, size: f64) -> Se3 {
    Se3::exp(&Vector6::from_fn(|_, _| size * rng.normal()))
}

/// Odometry, and a closed loop at every 25th keyframe from the second lap on.
fn pose_graph(path: &Path) {
    let mut rng = Rng::new(3);
    let n = path.poses.len();
    let mut edge = |a: usize, b: usize| PoseEdge {
        a,
        b,
        a_from_b: path.poses[a] * path.poses[b].inverse() * motion(&mut rng, 0.001),
        information: Matrix6::identity() * 1e6,
    };
    let mut graph = PoseGraph::default();
    graph.add_pose(path.poses[0], true);
    for k in 1..n {
        let odometry = edge(k, k - 1);
        graph.add_pose(odometry.a_from_b * graph.poses[k - 1], false);
        graph.edges.push(odometry);
        let others = k.saturating_sub(PREDECESSORS)..k - 1;
        graph.edges.extend(others.map(|b| edge(k, b)));
    }
    let closures = (path.per_lap..n).step_by(25);
    graph
        .edges
        .extend(closures.map(|k| edge(k, k % path.per_lap)));
    let pairs: Vec<_> = graph.edges.iter().map(|e| (e.a, e.b)).collect();
    compare("pose graph", path, &pairs, |linear_solver| {
        let mut graph = graph.clone();
        let config = PoseGraphConfig {
            linear_solver,
            ..PoseGraphConfig::default()
        };
        let report = graph.optimise(&config).expect("sound input").report;
        (graph.poses, report)
    });
}

/// Points and what is seen of them: each by five to eight keyframes in a row, or, every second one, by as
/// many divided between the lap in which it was found and another one.
fn observe(path: &Path, camera: &Camera) -> (Vec<Vector3<f64>>, Vec<BundleObservation>) {
    let mut rng = Rng::new(4);
    let n = path.poses.len();
    let (mut points, mut observations) = (Vec::new(), Vec::new());
    while points.len() < POINTS_PER_KEYFRAME * n {
        let born = points.len() / POINTS_PER_KEYFRAME;
        let uv_px = Vector2::new(rng.range(0.0, 639.0), rng.range(0.0, 479.0));
        let p_cam = camera.unproject(&uv_px, rng.range(2.0, 5.0));
        let p_world = path.poses[born].inverse() * p_cam;
        let views = 5 + rng.below(4);
        let here = if points.len() % 2 == 0 {
            views
        } else {
            views / 2
        };
        let again = (born + path.per_lap * (1 + rng.below(n / path.per_lap - 1))) % n;
        let seen: Vec<_> = (born..born + here)
            .chain(again..again + views - here)
            .filter_map(|pose| {
                let p_cam = path.poses[pose % n] * p_world;
                let uv = camera.project(&p_cam).filter(|uv| camera.contains(uv))?;
                Some((pose % n, uv, p_cam.z))
            })
            .collect();
        if seen.len() < 5 {
            continue;
        }
        for (pose, uv, depth_m) in seen {
            let uv_px = uv.map(|c| c + rng.normal());
            let depth = DepthObservation::right_from_depth(uv_px.x, 1.0, depth_m, 0.02, BF);
            observations.push(BundleObservation {
                pose,
                point: points.len(),
                uv_px,
                sigma_px: 1.0,
                depth: Some(depth),
            });
        }
        points.push(p_world);
    }
    (points, observations)
}

fn bundle(path: &Path) {
    let camera = Camera::pinhole((640, 480), [300.0, 300.0, 319.5, 239.5]).expect("a calibration");
    let (mut points, observations) = observe(path, &camera);
    let mut rng = Rng::new(6);
    let mut pairs = Vec::new();
    for seen in observations.chunk_by(|a, b| a.point == b.point) {
        for (i, a) in seen.iter().enumerate() {
            pairs.extend(seen[..i].iter().map(|b| (a.pose, b.pose)));
        }
    }
    let fixed: Vec<_> = (0..path.poses.len()).map(|k| k == 0).collect();
    let poses: Vec<_> = (path.poses.iter().zip(&fixed))
        .map(|(pose, &fixed)| motion(&mut rng, if fixed { 0.0 } else { 0.01 }) * *pose)
        .collect();
    for point in &mut points {
        *point += Vector3::from_fn(|_, _| 0.02 * rng.normal());
    }
    compare("bundle", path, &pairs, |linear_solver| {
        let (mut poses, mut points) = (poses.clone(), points.clone());
        let config = BundleConfig {
            linear_solver,
            ..BundleConfig::default()
        };
        let (k, o) = (&camera, &observations);
        let report = optimise_bundle(k, BF, &mut poses, &fixed, &mut points, o, &config);
        (poses, report.expect("sound input").report)
    });
}

/// A row of the table per solver.
fn compare(
    problem: &str,
    path: &Path,
    pairs: &[(usize, usize)],
    optimise: impl Fn(LinearSolver) -> (Vec<Se3>, Report),
) {
    let n = path.poses.len();
    let pairs = &distinct(pairs);
    let mut first: Option<(Vec<Vector6<f64>>, Vec<Se3>)> = None;
    for solver in [LinearSolver::Portable, LinearSolver::Faer] {
        let (pattern, analysis_ms) =
            time(|| timed(|| Pattern::new(n, pairs.iter().copied(), solver)));
        let (x, solve_ms) = time(|| solve(&pattern, n, pairs));
        let ((poses, report), whole_ms) = time(|| timed(|| optimise(solver)));
        let (x0, poses0) = first.get_or_insert_with(|| (x.clone(), poses.clone()));
        let largest = x0.iter().map(Vector6::amax).fold(0.0, f64::max);
        let of_solve = x0.iter().zip(&x).map(|(a, b)| (a - b).amax());
        let center = |pose: &Se3| pose.inverse().translation;
        let apart = (poses0.iter().zip(&poses)).map(|(a, b)| (center(a) - center(b)).norm());
        println!(
            "| {problem} | {n} | {} | {solver:?} | {} | {analysis_ms:.2} | {solve_ms:.2} | {:.0e} | {:.3} | {} | {:.0e} | {:08x} |",
            pairs.len(),
            pattern.factor_len(),
            of_solve.fold(0.0, f64::max) / largest,
            1e-3 * whole_ms,
            report.iterations + report.rejected,
            apart.fold(0.0, f64::max) / (2.0 * Path::radius_m(path.per_lap)),
            hash(&poses),
        );
    }
}

/// Of every bit of the translations: FNV-1a over 64-bit words, folded to 32 bits.
fn hash(poses: &[Se3]) -> u64 {
    let numbers = poses.iter().flat_map(|p| p.translation.iter());
    let hash = numbers.fold(0xcbf2_9ce4_8422_2325u64, |hash, number| {
        (hash ^ number.to_bits()).wrapping_mul(0x0100_0000_01b3)
    });
    (hash >> 32) ^ (hash & 0xffff_ffff)
}

/// Pairs of different poses, each once.
fn distinct(pairs: &[(usize, usize)]) -> Vec<(usize, usize)> {
    let mut pairs: Vec<_> = pairs.iter().map(|(a, b)| (*a.min(b), *a.max(b))).collect();
    pairs.retain(|(a, b)| a != b);
    pairs.sort_unstable();
    pairs.dedup();
    pairs
}

/// Σ JᵀJ over the pairs, and 1e-3 on the diagonal: the solution per pose, and the time to find it.
fn solve(pattern: &Pattern, n: usize, pairs: &[(usize, usize)]) -> (Vec<Vector6<f64>>, Duration) {
    let mut rng = Rng::new(5);
    let mut matrix = BlockMatrix::zeros(pattern);
    let mut add = |row: usize, column: usize, block: Matrix6<f64>| {
        let target = if row == column {
            &mut matrix.diagonal[row]
        } else {
            &mut matrix.lower[pattern.slot(row, column).expect("coupled")]
        };
        for (element, value) in target.iter_mut().zip(block.iter()) {
            *element += value;
        }
    };
    for k in 0..n {
        add(k, k, Matrix6::identity() * 1e-3);
    }
    for &(a, b) in pairs {
        let mut step_and_jacobian =
            |pose| (pattern.step(pose), Matrix6::from_fn(|_, _| rng.normal()));
        let mut parts = [step_and_jacobian(a), step_and_jacobian(b)];
        parts.sort_by_key(|(step, _)| *step);
        let [(column, j_column), (row, j_row)] = parts;
        add(row, row, j_row.transpose() * j_row);
        add(column, column, j_column.transpose() * j_column);
        add(row, column, j_row.transpose() * j_column);
    }
    let mut x = vec![Vector6::zeros(); n];
    for pose in 0..n {
        x[pattern.step(pose)] = Vector6::from_fn(|_, _| rng.normal());
    }
    let (solved, time) = timed(|| matrix.solve(&mut x));
    solved.expect("positive definite");
    ((0..n).map(|pose| x[pattern.step(pose)]).collect(), time)
}

/// The result of a call and its time.
fn timed<T>(call: impl FnOnce() -> T) -> (T, Duration) {
    let start = processor_time();
    let result = call();
    (result, processor_time() - start)
}

/// The result of the last call and the mean time, ms, of as many as fill 0.2 s.
fn time<T>(mut call: impl FnMut() -> (T, Duration)) -> (T, f64) {
    let (mut calls, mut sum) = (0.0, Duration::ZERO);
    loop {
        let (result, time) = call();
        calls += 1.0;
        sum += time;
        if sum > Duration::from_millis(200) {
            return (result, 1e3 * sum.as_secs_f64() / calls);
        }
    }
}

/// Of this thread so far, to some milliseconds.
fn processor_time() -> Duration {
    let statistics = std::fs::read_to_string("/proc/thread-self/schedstat").expect("on Linux");
    let ns = statistics.split(' ').next().and_then(|ns| ns.parse().ok());
    Duration::from_nanos(ns.expect("nanoseconds first"))
}
