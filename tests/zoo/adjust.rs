//! Poses and points with the least cost, a second time with dense normal equations, with their faults.

use garad_conformance::Outputs;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3, Vector6};

use super::answers::Given;
use super::reprojection::{
    Lens, NEAREST_M, Pose, Seen, by_pose, observations, residual, turn, vectors,
};
use super::second::{Fault, How};

#[derive(Clone)]
struct State {
    poses: Vec<Pose>,
    points: Vec<Vector3<f64>>,
}

/// ½ Σ ρ(‖r‖²) over what is seen; poses and points that are held do not move.
struct Problem<'a> {
    lens: &'a Lens,
    seen: Vec<&'a Seen>,
    held: Vec<bool>,
    points_held: bool,
    /// δ² with two and with three rows; plain squares without.
    knee: Option<[f64; 2]>,
    how: &'a How,
}

impl Problem<'_> {
    fn knee(&self, seen: &Seen) -> f64 {
        let Some([two, three]) = self.knee else {
            return f64::INFINITY;
        };
        let knee = match seen.rows() {
            3 if !self.how.is(Fault::KneeOfTwo) => three,
            _ => two,
        };
        match self.how.is(Fault::KneeSquared) {
            true => knee * knee,
            false => knee,
        }
    }

    /// ρ and its slope.
    fn robust(&self, chi2: f64, seen: &Seen) -> (f64, f64) {
        let knee = self.knee(seen);
        if chi2 <= knee {
            return (chi2, 1.0);
        }
        let weight = match self.how.is(Fault::WeightOfTheSquare) {
            true => knee / chi2,
            false => (knee / chi2).sqrt(),
        };
        (2.0 * (knee * chi2).sqrt() - knee, weight)
    }

    fn in_camera(state: &State, seen: &Seen) -> Vector3<f64> {
        let pose = &state.poses[seen.pose];
        pose.rotation * state.points[seen.point] + pose.shift
    }

    fn cost(&self, state: &State) -> f64 {
        let one = |seen: &&Seen| {
            let p = Self::in_camera(state, seen);
            if p.z < NEAREST_M {
                return f64::INFINITY;
            }
            let chi2 = residual(self.lens, &p, seen, self.how).0.norm_squared();
            self.robust(chi2, seen).0
        };
        let half = if self.how.is(Fault::CostNotHalved) {
            1.0
        } else {
            0.5
        };
        half * self
            .how
            .sum
            .of(&self.seen.iter().map(one).collect::<Vec<_>>())
    }

    /// Column of each pose and of the first point, and how many there are.
    fn columns(&self, state: &State) -> (Vec<Option<usize>>, usize, usize) {
        let mut next = 0;
        let mut column = |held: &bool| {
            (!held).then(|| {
                next += 6;
                next - 6
            })
        };
        let of_pose = self.held.iter().map(&mut column).collect();
        let points = if self.points_held {
            0
        } else {
            3 * state.points.len()
        };
        (of_pose, next, next + points)
    }

    /// Hessian and gradient.
    fn equations(&self, state: &State) -> (DMatrix<f64>, DVector<f64>) {
        let (of_pose, first_point, n) = self.columns(state);
        let (mut h, mut g) = (DMatrix::zeros(n, n), DVector::zeros(n));
        for seen in &self.seen {
            let (pose, p_world) = (&state.poses[seen.pose], &state.points[seen.point]);
            let (r, j) = residual(self.lens, &Self::in_camera(state, seen), seen, self.how);
            let (_, weight) = self.robust(r.norm_squared(), seen);
            // One derivative of three rows per column that the residual depends on.
            let mut slopes: Vec<(usize, Vector3<f64>)> = Vec::new();
            if let Some(first) = of_pose[seen.pose] {
                let j = by_pose(&j, pose, p_world, self.how);
                slopes.extend((0..6).map(|k| (first + k, j.column(k).into())));
            }
            if !self.points_held {
                let j = j * pose.rotation;
                let first = first_point + 3 * seen.point;
                slopes.extend((0..3).map(|k| (first + k, j.column(k).into())));
            }
            let of_gradient = match self.how.is(Fault::JacobianNotWeighted) {
                true => weight.sqrt(),
                false => weight,
            };
            for (a, slope) in &slopes {
                g[*a] += of_gradient * slope.dot(&r);
                for (b, other) in &slopes {
                    h[(*a, *b)] += weight * slope.dot(other);
                }
            }
        }
        (h, g)
    }

    fn moved(&self, state: &State, step: &DVector<f64>) -> State {
        let (of_pose, first_point, _) = self.columns(state);
        let mut state = state.clone();
        for (pose, first) in state.poses.iter_mut().zip(of_pose) {
            if let Some(first) = first {
                let xi: Vector6<f64> = step.fixed_rows::<6>(first).into();
                let (shift, w) = (
                    xi.fixed_rows::<3>(0).into_owned(),
                    xi.fixed_rows::<3>(3).into_owned(),
                );
                let turned = turn(&w);
                pose.rotation = turned * pose.rotation;
                pose.shift = turned * pose.shift + shift;
            }
        }
        if !self.points_held {
            for (i, point) in state.points.iter_mut().enumerate() {
                *point += step.fixed_rows::<3>(first_point + 3 * i);
            }
        }
        state
    }

    /// Levenberg-Marquardt until nothing moves; cost before and after.
    fn minimise(&self, start: State) -> (State, f64, f64) {
        let first = self.cost(&start);
        let (mut state, mut cost, mut damping) = (start, first, 1e-4);
        let (mut h, mut g) = self.equations(&state);
        for _ in 0..400 {
            let mut damped = h.clone();
            for i in 0..damped.nrows() {
                damped[(i, i)] += damping * h[(i, i)].max(1e-9);
            }
            let Some(solved) = damped.cholesky() else {
                damping *= 10.0;
                continue;
            };
            let step = -solved.solve(&g);
            let next = self.moved(&state, &step);
            let next_cost = self.cost(&next);
            if next_cost <= cost {
                (state, cost, damping) = (next, next_cost, (damping * 0.1).max(1e-15));
                (h, g) = self.equations(&state);
            } else {
                damping *= 10.0;
            }
            if step.norm() < 1e-13 || damping > 1e9 {
                break;
            }
        }
        (state, first, cost)
    }
}

fn matrices(values: &[f64]) -> Vec<Matrix3<f64>> {
    values.chunks(9).map(Matrix3::from_row_slice).collect()
}

fn put_poses(out: &mut Outputs, poses: &[Pose]) {
    let rows = |p: &Pose| <[[f64; 3]; 3]>::from(p.rotation.transpose());
    out.put("rotation", poses.iter().map(rows));
    out.put(
        "translation",
        poses.iter().map(|p| <[f64; 3]>::from(p.shift)),
    );
}

fn start(case: Given<'_>, points: &str) -> State {
    let of = |name: &str| case.reals(name);
    let poses = matrices(&of("rotation_initial")).into_iter();
    let poses = poses.zip(vectors(&of("translation_initial")));
    State {
        poses: poses
            .map(|(rotation, shift)| Pose { rotation, shift })
            .collect(),
        points: vectors(&of(points)),
    }
}

pub(super) fn pose(case: Given<'_>, how: &How, out: &mut Outputs) {
    let lens = Lens::of(case);
    let initial = start(case, "p_world");
    let n = initial.points.len();
    let own: Vec<usize> = (0..n).flat_map(|i| [0, i]).collect();
    let seen = observations(case, &own);
    let knees = ["chi2_2d", "chi2_3d"].map(|name| case.number(name));
    let chi2 = |state: &State, i: usize| {
        let p = Problem::in_camera(state, &seen[i]);
        match p.z < NEAREST_M {
            true => f64::INFINITY,
            false => residual(&lens, &p, &seen[i], how).0.norm_squared(),
        }
    };
    let rounds = if n < 10 { 1 } else { case.count("rounds") };
    let (mut state, mut inlier) = (initial.clone(), vec![true; n]);
    let (mut first, mut cost) = (None, 0.0);
    for round in 0..rounds {
        // ORB-SLAM's rounds: each from the start, the last without a kernel.
        let begin = initial.clone();
        let used = (0..n).filter(|&i| inlier[i] && chi2(&begin, i).is_finite());
        let problem = Problem {
            lens: &lens,
            seen: used.map(|i| &seen[i]).collect(),
            held: vec![false],
            points_held: true,
            knee: (round <= 2 && !how.is(Fault::NoKernel)).then_some(knees),
            how,
        };
        let (solved, before, after) = problem.minimise(begin);
        (state, cost) = (solved, after);
        first = first.or(Some(before));
        for i in 0..n {
            let gate = match seen[i].rows() {
                3 if !how.is(Fault::GateOfTwo) => knees[1],
                _ => knees[0],
            };
            let inside = chi2(&state, i) <= gate;
            inlier[i] = match how.is(Fault::OutliersForGood) {
                true => inlier[i] && inside,
                false => inside,
            };
        }
    }
    out.put("cost_initial", [first.unwrap_or_default()]);
    out.put("cost", [cost]);
    if how.is(Fault::PoseInverted) {
        let rotation = state.poses[0].rotation.transpose();
        let shift = -(rotation * state.poses[0].shift);
        state.poses[0] = Pose { rotation, shift };
    }
    put_poses(out, &state.poses);
    out.put("inlier", inlier);
}

pub(super) fn bundle(case: Given<'_>, how: &How, out: &mut Outputs) {
    let lens = Lens::of(case);
    let initial = start(case, "points_initial");
    let of: Vec<usize> = (case.tensor("observed").i64().iter())
        .map(|i| usize::try_from(*i).expect("an index"))
        .collect();
    let seen = observations(case, &of);
    let fixed: Vec<bool> = case.tensor("fixed").u8().iter().map(|f| *f == 1).collect();
    let used = seen.iter().filter(|s| {
        let of_fixed = how.is(Fault::FixedViewsDropped) && fixed[s.pose];
        !of_fixed && Problem::in_camera(&initial, s).z >= NEAREST_M
    });
    let problem = Problem {
        lens: &lens,
        seen: used.collect(),
        held: match how.is(Fault::GaugeNotFixed) {
            true => vec![false; fixed.len()],
            false => fixed.clone(),
        },
        points_held: how.is(Fault::PointsHeld),
        knee: (!how.is(Fault::NoKernel)).then(|| ["chi2_2d", "chi2_3d"].map(|k| case.number(k))),
        how,
    };
    let (state, before, after) = problem.minimise(initial);
    out.put("cost_initial", [before]);
    out.put("cost", [after]);
    put_poses(out, &state.poses);
    out.put("points", state.points.into_iter().map(<[f64; 3]>::from));
}
