//! [`SchurSystem`]: the normal equations of a bundle, solved through its points.
//!
//! Poses p and points l are coupled only by observations, so the Gauss-Newton matrix has the form
//!
//! ```text
//! [ U   W ] [h_p]     [g_p]       U: a 6x6 block per pose, V: a 3x3 block per point,
//! [ Wᵀ  V ] [h_l] = - [g_l]       W: a 6x3 block per observation.
//! ```
//!
//! Points are eliminated one by one, because V is block-diagonal:
//!
//! (U - W V⁻¹ Wᵀ) h_p = -g_p + W V⁻¹ g_l,   h_l = V⁻¹ (-g_l - Wᵀ h_p)                     (E13)
//!
//! What is left is a system of six unknowns per free pose, with a block for each pair of poses that
//! see a point together ([`crate::blocks`]). Damping adds λD to U and V first, D = max(diag, floor):
//! diag their diagonal, the floor a tiny part ([`SMALLEST_DIAGONAL`]) of its largest element, so
//! that an unknown without an equation stays put instead of making the matrix singular.
//!
//! An observation acts through the point in its camera, p = R p_world + t, alone. With
//! J = ∂r/∂p, A = ρ' JᵀJ and g = ρ' Jᵀr (3x3 and 3) its parts are
//!
//! ```text
//! U = [I; p^] A [I, -p^]     W = [I; p^] A R     V = Rᵀ A R     g_p = [I; p^] g     g_l = Rᵀ g
//! ```
//!
//! Source: Triggs et al., *Bundle adjustment: a modern synthesis*, 2000, sec. 6.1.

use nalgebra::{Matrix3, Matrix6, SMatrix, SVector, Vector3, Vector6};

use crate::blocks::{Block, BlockMatrix, LinearSolver, Pattern};
use crate::dense::SMALLEST_DIAGONAL;
use crate::lm::{Damped, System};
use crate::solve::ldlt_inverse;

/// Which free pose and which point each observation connects; grouped by point, and within a
/// point by the step at which [`Pattern`] eliminates the pose (fixed ones first).
#[derive(Debug)]
pub(crate) struct Structure {
    pub(crate) pattern: Pattern,
    /// Observations `start[l]..start[l + 1]` are those of point l.
    pub(crate) start: Vec<usize>,
    /// Free pose of each observation, by step, `None` if its pose is fixed.
    pub(crate) step: Vec<Option<usize>>,
    /// For each point, each of its free observations a and each earlier one b, in that order:
    /// where the block of their poses is.
    place: Vec<Place>,
}

/// A block of the reduced matrix.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Place {
    Lower(usize),
    /// One pose saw the point twice.
    Diagonal(usize),
}

impl Structure {
    /// Sorts `observations`, given as (point, free pose if it is free, index), and finds their
    /// blocks.
    pub(crate) fn new(
        poses: usize,
        points: usize,
        observations: &mut [(usize, Option<usize>, usize)],
        solver: LinearSolver,
    ) -> Self {
        observations.sort_by_key(|o| o.0); // stable: the order within a point stays
        let same_point = |a: &(usize, _, _), b: &(usize, _, _)| a.0 == b.0;
        let mut coupled = vec![false; poses * poses];
        for seen in observations.chunk_by(same_point) {
            for (i, a) in seen.iter().enumerate() {
                for b in &seen[..i] {
                    if let (Some(a), Some(b)) = (a.1, b.1) {
                        coupled[a.max(b) * poses + a.min(b)] = true;
                    }
                }
            }
        }
        let pairs = (0..coupled.len()).filter(|&i| coupled[i]);
        let pattern = Pattern::new(poses, pairs.map(|i| (i / poses, i % poses)), solver);
        let step = |o: &(usize, Option<usize>, usize)| o.1.map(|pose| pattern.step(pose));
        observations.sort_by_key(|o| (o.0, step(o)));
        let mut place = Vec::new();
        for seen in observations.chunk_by(same_point) {
            let steps: Vec<usize> = seen.iter().filter_map(step).collect();
            for (i, &a) in steps.iter().enumerate() {
                for &b in &steps[..i] {
                    place.push(if a == b {
                        Place::Diagonal(a)
                    } else {
                        Place::Lower(pattern.slot(a, b).expect("coupled above"))
                    });
                }
            }
        }
        let start = (0..=points)
            .map(|l| observations.partition_point(|o| o.0 < l))
            .collect();
        let step = observations.iter().map(step).collect();
        Self {
            pattern,
            start,
            step,
            place,
        }
    }
}

/// A step of all free poses and all points.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct BundleStep {
    pub(crate) poses: Vec<Vector6<f64>>,
    pub(crate) points: Vec<Vector3<f64>>,
}

/// What one observation adds, in the frame of its camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct InCamera {
    /// p = R p_world + t.
    pub(crate) point: Vector3<f64>,
    /// A = ρ' JᵀJ.
    pub(crate) hessian: Matrix3<f64>,
    /// ρ' Jᵀr.
    pub(crate) gradient: Vector3<f64>,
}

/// [I; p^] A R.
type Coupling = [f64; 18];

/// U, V, W and the gradient at a state. Poses are numbered by step of elimination.
#[derive(Debug, Clone)]
pub(crate) struct SchurSystem<'a> {
    structure: &'a Structure,
    pub(crate) cost: f64,
    pub(crate) u: Vec<Matrix6<f64>>,
    pub(crate) v: Vec<Matrix3<f64>>,
    w: Vec<Coupling>,
    pub(crate) pose_gradient: Vec<Vector6<f64>>,
    pub(crate) point_gradient: Vec<Vector3<f64>>,
}

impl<'a> SchurSystem<'a> {
    pub(crate) fn zeros(structure: &'a Structure) -> Self {
        let (poses, points) = (structure.pattern.len(), structure.start.len() - 1);
        Self {
            structure,
            cost: 0.0,
            u: vec![Matrix6::zeros(); poses],
            v: vec![Matrix3::zeros(); points],
            w: Vec::with_capacity(structure.step.len()),
            pose_gradient: vec![Vector6::zeros(); poses],
            point_gradient: vec![Vector3::zeros(); points],
        }
    }

    /// Adds the next observation, of point l by a camera of this rotation. All of them, in order.
    #[inline]
    pub(crate) fn push(&mut self, l: usize, rotation: &Matrix3<f64>, seen: &InCamera) {
        let (a, g) = (&seen.hessian, &seen.gradient);
        let coupling = a * rotation;
        let back = rotation.transpose();
        self.v[l] += back * coupling;
        self.point_gradient[l] += back * g;
        let mut w = [0.0; 18];
        if let Some(k) = self.structure.step[self.w.len()] {
            let p = &seen.point;
            let turned = cross(p, a);
            let u = &mut self.u[k];
            add_3x3(u, (0, 0), a);
            add_3x3(u, (3, 0), &turned);
            add_3x3(u, (3, 3), &cross(p, &turned.transpose()));
            let torque = p.cross(g);
            let gradient = &mut self.pose_gradient[k];
            for i in 0..3 {
                gradient[i] += g[i];
                gradient[i + 3] += torque[i];
            }
            let turned = cross(p, &coupling);
            for (j, column) in w.as_chunks_mut::<6>().0.iter_mut().enumerate() {
                for i in 0..3 {
                    column[i] = coupling[(i, j)];
                    column[i + 3] = turned[(i, j)];
                }
            }
        }
        self.w.push(w);
    }

    /// To be called after the last observation: U becomes symmetric.
    pub(crate) fn finish(&mut self) {
        for u in &mut self.u {
            let lower_left = u.fixed_view::<3, 3>(3, 0).transpose();
            u.fixed_view_mut::<3, 3>(0, 3).copy_from(&lower_left);
        }
    }

    fn observations(&self, l: usize) -> std::ops::Range<usize> {
        self.structure.start[l]..self.structure.start[l + 1]
    }

    /// The floor of the diagonal, see [`SMALLEST_DIAGONAL`].
    fn floor(&self) -> f64 {
        let poses = self.u.iter().map(|u| u.diagonal().amax());
        let points = self.v.iter().map(|v| v.diagonal().amax());
        SMALLEST_DIAGONAL * poses.chain(points).fold(0.0, f64::max)
    }

    /// (V + λD)⁻¹ per point; 0 for a point without observations, which then stays.
    fn inverse_points(&self, damping: Damping) -> Option<Vec<Matrix3<f64>>> {
        self.v
            .iter()
            .map(|v| {
                if v.diagonal().amax() > 0.0 {
                    ldlt_inverse(&damping.damp(v)).ok()
                } else {
                    Some(Matrix3::zeros())
                }
            })
            .collect()
    }

    /// The reduced system of the poses: its matrix and its right side.
    fn reduce(
        &self,
        damping: Damping,
        v_inverse: &[Matrix3<f64>],
    ) -> (BlockMatrix<'a>, Vec<Vector6<f64>>) {
        let mut matrix = BlockMatrix::zeros(&self.structure.pattern);
        let mut right: Vec<Vector6<f64>> = self.pose_gradient.iter().map(|g| -g).collect();
        for (block, u) in matrix.diagonal.iter_mut().zip(&self.u) {
            block.copy_from_slice(damping.damp(u).as_slice());
        }
        let mut places = self.structure.place.iter();
        let mut free: Vec<&Coupling> = Vec::new();
        for (l, inverse) in v_inverse.iter().enumerate() {
            free.clear();
            for a in self.observations(l) {
                let Some(pa) = self.structure.step[a] else {
                    continue;
                };
                let wa_inverse = product_3x3(&self.w[a], inverse);
                add_product(&mut right[pa], &wa_inverse, &self.point_gradient[l]);
                for (wb, place) in free.iter().zip(&mut places) {
                    match *place {
                        Place::Lower(slot) => {
                            subtract_product(&mut matrix.lower[slot], &wa_inverse, wb);
                        }
                        Place::Diagonal(p) => {
                            let wb_inverse = product_3x3(wb, inverse);
                            let block = &mut matrix.diagonal[p];
                            subtract_product(block, &wa_inverse, wb);
                            subtract_product(block, &wb_inverse, &self.w[a]);
                        }
                    }
                }
                subtract_product(&mut matrix.diagonal[pa], &wa_inverse, &self.w[a]);
                free.push(&self.w[a]);
            }
        }
        (matrix, right)
    }

    /// h_l of each point once the poses' steps are known.
    fn substitute(&self, v_inverse: &[Matrix3<f64>], poses: &[Vector6<f64>]) -> Vec<Vector3<f64>> {
        (0..self.v.len())
            .map(|l| {
                let mut right = -self.point_gradient[l];
                for i in self.observations(l) {
                    if let Some(p) = self.structure.step[i] {
                        let (columns, _) = self.w[i].as_chunks::<6>();
                        for (element, column) in right.iter_mut().zip(columns) {
                            *element -= Vector6::from(*column).dot(&poses[p]);
                        }
                    }
                }
                v_inverse[l] * right
            })
            .collect()
    }

    /// ½ hᵀ(λDh - g), E10.
    fn model_decrease(&self, damping: Damping, step: &BundleStep) -> f64 {
        let mut sum = 0.0;
        for ((h, u), g) in step.poses.iter().zip(&self.u).zip(&self.pose_gradient) {
            sum += h.dot(&(h.component_mul(&damping.diagonal(u)) - g));
        }
        for ((h, v), g) in step.points.iter().zip(&self.v).zip(&self.point_gradient) {
            sum += h.dot(&(h.component_mul(&damping.diagonal(v)) - g));
        }
        0.5 * sum
    }
}

impl System for SchurSystem<'_> {
    type Step = BundleStep;

    fn cost(&self) -> f64 {
        self.cost
    }

    fn gradient_norm(&self) -> f64 {
        let poses = self.pose_gradient.iter().flat_map(|g| g.iter());
        let points = self.point_gradient.iter().flat_map(|g| g.iter());
        poses.chain(points).fold(0.0, |largest: f64, g| {
            if g.is_finite() {
                largest.max(g.abs())
            } else {
                f64::INFINITY
            }
        })
    }

    fn solve(&self, lambda: f64) -> Option<Damped<BundleStep>> {
        let damping = Damping {
            lambda,
            floor: self.floor(),
        };
        let v_inverse = self.inverse_points(damping)?;
        let (matrix, mut poses) = self.reduce(damping, &v_inverse);
        matrix.solve(&mut poses).ok()?;
        let points = self.substitute(&v_inverse, &poses);
        let step = BundleStep { poses, points };
        Some(Damped {
            model_decrease: self.model_decrease(damping, &step),
            step,
        })
    }
}

/// λ and the floor of D = max(diag, floor).
#[derive(Debug, Clone, Copy)]
struct Damping {
    lambda: f64,
    floor: f64,
}

impl Damping {
    /// The diagonal of λD for a block.
    fn diagonal<const N: usize>(self, a: &SMatrix<f64, N, N>) -> SVector<f64, N> {
        a.diagonal().map(|d| self.lambda * d.max(self.floor))
    }

    /// A + λD.
    fn damp<const N: usize>(self, a: &SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
        a + SMatrix::from_diagonal(&self.diagonal(a))
    }
}

/// p^ A.
#[inline]
fn cross(p: &Vector3<f64>, a: &Matrix3<f64>) -> Matrix3<f64> {
    let column = |j: usize| p.cross(&a.column(j).into_owned());
    Matrix3::from_columns(&[column(0), column(1), column(2)])
}

/// A 3x3 block of U, plus a matrix.
#[inline]
fn add_3x3(u: &mut Matrix6<f64>, (row, column): (usize, usize), a: &Matrix3<f64>) {
    for j in 0..3 {
        for i in 0..3 {
            u[(row + i, column + j)] += a[(i, j)];
        }
    }
}

/// W A.
#[inline]
fn product_3x3(w: &Coupling, a: &Matrix3<f64>) -> Coupling {
    let (w, _) = w.as_chunks::<6>();
    let mut product = [0.0; 18];
    for (j, column) in product.as_chunks_mut::<6>().0.iter_mut().enumerate() {
        for i in 0..6 {
            column[i] = w[0][i] * a[(0, j)] + w[1][i] * a[(1, j)] + w[2][i] * a[(2, j)];
        }
    }
    product
}

/// x += W v.
#[inline]
fn add_product(x: &mut Vector6<f64>, w: &Coupling, v: &Vector3<f64>) {
    let (w, _) = w.as_chunks::<6>();
    for i in 0..6 {
        x[i] += w[0][i] * v[0] + w[1][i] * v[1] + w[2][i] * v[2];
    }
}

/// C -= A Bᵀ: the innermost loop of a bundle.
#[inline]
fn subtract_product(c: &mut Block, a: &Coupling, b: &Coupling) {
    let (a, _) = a.as_chunks::<6>();
    for (j, column) in c.as_chunks_mut::<6>().0.iter_mut().enumerate() {
        let (b0, b1, b2) = (b[j], b[6 + j], b[12 + j]);
        for i in 0..6 {
            column[i] -= a[0][i] * b0 + a[1][i] * b1 + a[2][i] * b2;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::with_each_solver;
    use garad_core::so3::hat;
    use garad_core::{Rng, So3};

    /// Two free poses and a fixed one, three points, one of them unseen, one seen twice by one
    /// pose; random derivatives.
    fn structure(solver: LinearSolver) -> Structure {
        let mut observations = [
            (0, Some(0), 0),
            (0, None, 1),
            (1, Some(1), 2),
            (1, Some(0), 3),
            (1, Some(0), 4),
            (0, Some(1), 5),
        ];
        Structure::new(2, 3, &mut observations, solver)
    }

    fn random_system(structure: &Structure) -> SchurSystem<'_> {
        let mut rng = Rng::keyed(5, &[1]);
        let mut system = SchurSystem::zeros(structure);
        for l in 0..structure.start.len() - 1 {
            for _ in structure.start[l]..structure.start[l + 1] {
                let mut vector = || Vector3::from_fn(|_, _| rng.normal());
                let (point, residual, turn) = (vector(), vector(), vector());
                let jacobian = Matrix3::from_columns(&[vector(), vector(), vector()]);
                let seen = InCamera {
                    point,
                    hessian: jacobian.transpose() * jacobian,
                    gradient: jacobian.transpose() * residual,
                };
                system.push(l, &So3::exp(&turn).matrix(), &seen);
            }
        }
        system.finish();
        system
    }

    fn coupling(system: &SchurSystem<'_>, i: usize) -> SMatrix<f64, 6, 3> {
        SMatrix::from_column_slice(&system.w[i])
    }

    /// The parts of one observation are JᵀJ and Jᵀr of [J [I, -p^], J R].
    #[test]
    fn parts_are_products_of_the_full_jacobian() {
        let structure = Structure::new(1, 1, &mut [(0, Some(0), 0)], LinearSolver::Portable);
        let mut system = SchurSystem::zeros(&structure);
        let jacobian = Matrix3::new(1.0, 0.5, -0.3, 0.2, 2.0, 0.7, -0.4, 0.1, 1.5);
        let residual = Vector3::new(0.3, -0.8, 0.5);
        let rotation = So3::exp(&Vector3::new(0.4, -0.3, 0.9)).matrix();
        let point = Vector3::new(0.7, -0.2, 2.1);
        let seen = InCamera {
            point,
            hessian: jacobian.transpose() * jacobian,
            gradient: jacobian.transpose() * residual,
        };
        system.push(0, &rotation, &seen);
        system.finish();
        let mut by_pose = SMatrix::<f64, 3, 6>::zeros();
        by_pose.fixed_view_mut::<3, 3>(0, 0).copy_from(&jacobian);
        by_pose
            .fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&(-jacobian * hat(&point)));
        let by_point = jacobian * rotation;
        let errors = [
            (system.u[0] - by_pose.transpose() * by_pose).amax(),
            (coupling(&system, 0) - by_pose.transpose() * by_point).amax(),
            (system.v[0] - by_point.transpose() * by_point).amax(),
            (system.pose_gradient[0] - by_pose.transpose() * residual).amax(),
            (system.point_gradient[0] - by_point.transpose() * residual).amax(),
        ];
        assert!(
            errors.iter().all(|&e| e < 1e-13),
            "U, W, V, g_p, g_l: {errors:?}"
        );
    }

    /// E13 solves the full system: U h_p + W h_l = -g_p and Wᵀ h_p + V h_l = -g_l, damped.
    fn elimination_solves_the_full_system(solver: LinearSolver) {
        let structure = structure(solver);
        let system = random_system(&structure);
        for lambda in [1e-6, 0.1, 10.0] {
            let step = system.solve(lambda).expect("positive definite").step;
            let floor = system.floor();
            let damping = Damping { lambda, floor };
            let mut poses: Vec<_> = (0..2)
                .map(|p| damping.damp(&system.u[p]) * step.poses[p] + system.pose_gradient[p])
                .collect();
            let mut points: Vec<_> = (0..3)
                .map(|l| damping.damp(&system.v[l]) * step.points[l] + system.point_gradient[l])
                .collect();
            for l in 0..3 {
                for i in system.observations(l) {
                    if let Some(p) = structure.step[i] {
                        poses[p] += coupling(&system, i) * step.points[l];
                        points[l] += coupling(&system, i).transpose() * step.poses[p];
                    }
                }
            }
            let rest = poses.iter().map(Vector6::amax).fold(0.0, f64::max);
            let rest = points.iter().map(Vector3::amax).fold(rest, f64::max);
            assert!(rest < 1e-9, "λ = {lambda}: {rest}");
            assert!(
                step.points[2].amax() < 1e-300,
                "without observations: it stays"
            );
        }
    }

    with_each_solver! { elimination_solves_the_full_system }

    /// ½ hᵀ(λDh - g) is F(0) - L(h) = -gᵀh - ½ hᵀHh with the undamped H.
    #[test]
    fn promised_decrease_is_that_of_the_model() {
        let structure = structure(LinearSolver::Portable);
        let system = random_system(&structure);
        let damped = system.solve(0.3).expect("positive definite");
        let BundleStep { poses, points } = &damped.step;
        let mut decrease = 0.0;
        for p in 0..2 {
            decrease -= system.pose_gradient[p].dot(&poses[p]);
            decrease -= 0.5 * poses[p].dot(&(system.u[p] * poses[p]));
        }
        for l in 0..3 {
            decrease -= system.point_gradient[l].dot(&points[l]);
            decrease -= 0.5 * points[l].dot(&(system.v[l] * points[l]));
            for i in system.observations(l) {
                if let Some(p) = structure.step[i] {
                    decrease -= poses[p].dot(&(coupling(&system, i) * points[l]));
                }
            }
        }
        let error = (decrease - damped.model_decrease).abs();
        assert!(error < 1e-10, "{decrease} {}", damped.model_decrease);
    }

    /// V = diag(1, 4, 9), g = (2, -6, 0.9) and λ = ¼: h = -g / (1.25 V), and ½ h (¼ V h - g).
    #[test]
    fn damping_shortens_each_component() {
        let structure = Structure::new(0, 1, &mut [(0, None, 0)], LinearSolver::Portable);
        let mut system = SchurSystem::zeros(&structure);
        let seen = InCamera {
            point: Vector3::new(0.3, 0.2, 2.0),
            hessian: Matrix3::from_diagonal(&Vector3::new(1.0, 4.0, 9.0)),
            gradient: Vector3::new(2.0, -6.0, 0.9),
        };
        system.push(0, &Matrix3::identity(), &seen);
        system.finish();
        let damped = system.solve(0.25).expect("positive definite");
        let error = damped.step.points[0] - Vector3::new(-1.6, 1.2, -0.08);
        assert!(error.amax() < 1e-15, "{:?}", damped.step);
        // ½ (-1.6 (-0.4 - 2) + 1.2 (1.2 + 6) - 0.08 (-0.18 - 0.9))
        let error = damped.model_decrease - 0.5 * (3.84 + 8.64 + 0.0864);
        assert!(error.abs() < 1e-14, "{}", damped.model_decrease);
        assert!((system.gradient_norm() - 6.0).abs() < 1e-15, "largest");
    }
}
