//! [`SchurSystem`]: the normal equations of a bundle, solved through its points.
//!
//! Poses p and points l meet only in observations, so the Gauss-Newton matrix has the form
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
//! What is left is a dense system of six unknowns per free pose. Damping adds λ diag to U and V
//! first. Source: Triggs et al., *Bundle adjustment: a modern synthesis*, 2000, sec. 6.1.

use nalgebra::{Matrix3, Matrix6, SMatrix, SVector, Vector3, Vector6};

use crate::dense::SMALLEST_DIAGONAL;
use crate::lm::{Damped, System};
use crate::solve::{ldlt_factor, ldlt_inverse, ldlt_substitute};

type Matrix6x3 = SMatrix<f64, 6, 3>;

/// Which free pose and which point each observation connects; grouped by point.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Structure {
    /// Number of free poses.
    pub(crate) poses: usize,
    /// Observations `start[l]..start[l + 1]` are those of point l.
    pub(crate) start: Vec<usize>,
    /// Free pose of each observation, `None` if its pose is fixed.
    pub(crate) pose: Vec<Option<usize>>,
}

/// A step of all free poses and all points.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct BundleStep {
    pub(crate) poses: Vec<Vector6<f64>>,
    pub(crate) points: Vec<Vector3<f64>>,
}

/// U, V, W and the gradient at a state.
#[derive(Debug, Clone)]
pub(crate) struct SchurSystem<'a> {
    structure: &'a Structure,
    pub(crate) cost: f64,
    pub(crate) u: Vec<Matrix6<f64>>,
    pub(crate) v: Vec<Matrix3<f64>>,
    pub(crate) w: Vec<Matrix6x3>,
    pub(crate) pose_gradient: Vec<Vector6<f64>>,
    pub(crate) point_gradient: Vec<Vector3<f64>>,
}

impl<'a> SchurSystem<'a> {
    pub(crate) fn zeros(structure: &'a Structure) -> Self {
        let points = structure.start.len() - 1;
        Self {
            structure,
            cost: 0.0,
            u: vec![Matrix6::zeros(); structure.poses],
            v: vec![Matrix3::zeros(); points],
            w: vec![Matrix6x3::zeros(); structure.pose.len()],
            pose_gradient: vec![Vector6::zeros(); structure.poses],
            point_gradient: vec![Vector3::zeros(); points],
        }
    }

    /// Adds observation i of point l: its weight, residual and the two Jacobians.
    pub(crate) fn add<const M: usize>(
        &mut self,
        (i, l): (usize, usize),
        weight: f64,
        residual: &SMatrix<f64, M, 1>,
        pose_jacobian: &SMatrix<f64, M, 6>,
        point_jacobian: &SMatrix<f64, M, 3>,
    ) {
        let weighted = point_jacobian.transpose() * weight;
        self.v[l] += weighted * point_jacobian;
        self.point_gradient[l] += weighted * residual;
        if let Some(p) = self.structure.pose[i] {
            let weighted = pose_jacobian.transpose() * weight;
            self.u[p] += weighted * pose_jacobian;
            self.pose_gradient[p] += weighted * residual;
            self.w[i] = weighted * point_jacobian;
        }
    }

    fn observations(&self, l: usize) -> std::ops::Range<usize> {
        self.structure.start[l]..self.structure.start[l + 1]
    }

    /// What the diagonal is never taken for less than, see [`SMALLEST_DIAGONAL`].
    fn floor(&self) -> f64 {
        let poses = self.u.iter().map(|u| u.diagonal().amax());
        let points = self.v.iter().map(|v| v.diagonal().amax());
        SMALLEST_DIAGONAL * poses.chain(points).fold(0.0, f64::max)
    }

    /// (V + λD)⁻¹ per point; 0 for a point that nobody sees, which then stays.
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

    /// The reduced system of the poses: its matrix, row by row, lower triangle; its right side.
    fn reduce(&self, damping: Damping, v_inverse: &[Matrix3<f64>]) -> (Vec<f64>, Vec<f64>) {
        let n = 6 * self.structure.poses;
        let (mut matrix, mut right) = (vec![0.0; n * n], vec![0.0; n]);
        for (p, u) in self.u.iter().enumerate() {
            subtract_block(&mut matrix, n, (p, p), &-damping.damp(u));
            subtract(&mut right, p, &self.pose_gradient[p]);
        }
        for (l, inverse) in v_inverse.iter().enumerate() {
            for a in self.observations(l) {
                let Some(pa) = self.structure.pose[a] else {
                    continue;
                };
                let wa_inverse = self.w[a] * inverse;
                subtract(&mut right, pa, &-(wa_inverse * self.point_gradient[l]));
                for b in self.observations(l) {
                    if let Some(pb) = self.structure.pose[b]
                        && pb <= pa
                    {
                        let block = wa_inverse * self.w[b].transpose();
                        subtract_block(&mut matrix, n, (pa, pb), &block);
                    }
                }
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
                    if let Some(p) = self.structure.pose[i] {
                        right -= self.w[i].transpose() * poses[p];
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
        let (mut matrix, mut right) = self.reduce(damping, &v_inverse);
        ldlt_factor(&mut matrix, right.len()).ok()?;
        ldlt_substitute(&matrix, &mut right);
        let (blocks, _) = right.as_chunks::<6>();
        let poses: Vec<_> = blocks.iter().map(|&h| Vector6::from(h)).collect();
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

/// Block (row, column) of an n x n matrix stored row by row, minus a block.
fn subtract_block(
    matrix: &mut [f64],
    n: usize,
    (row, column): (usize, usize),
    block: &Matrix6<f64>,
) {
    for i in 0..6 {
        let start = (6 * row + i) * n + 6 * column;
        for (j, element) in matrix[start..start + 6].iter_mut().enumerate() {
            *element -= block[(i, j)];
        }
    }
}

/// Piece p of a stacked vector, minus a vector.
fn subtract(stacked: &mut [f64], p: usize, vector: &Vector6<f64>) {
    for (element, v) in stacked[6 * p..6 * p + 6].iter_mut().zip(vector.iter()) {
        *element -= v;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::Rng;

    /// Two free poses and a fixed one, three points, one of them unseen, random Jacobians.
    fn random_system(structure: &Structure) -> SchurSystem<'_> {
        let mut rng = Rng::keyed(5, &[1]);
        let mut system = SchurSystem::zeros(structure);
        for l in 0..structure.start.len() - 1 {
            for i in structure.start[l]..structure.start[l + 1] {
                let residual = SMatrix::<f64, 3, 1>::from_fn(|_, _| rng.normal());
                let pose = SMatrix::<f64, 3, 6>::from_fn(|_, _| rng.normal());
                let point = SMatrix::<f64, 3, 3>::from_fn(|_, _| rng.normal());
                system.add((i, l), rng.range(0.2, 1.0), &residual, &pose, &point);
            }
        }
        system
    }

    fn structure() -> Structure {
        Structure {
            poses: 2,
            start: vec![0, 3, 6, 6],
            pose: vec![Some(0), None, Some(1), Some(1), Some(0), Some(0)],
        }
    }

    /// E13 solves the full system: U h_p + W h_l = -g_p and Wᵀ h_p + V h_l = -g_l, damped.
    #[test]
    fn elimination_solves_the_full_system() {
        let structure = structure();
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
                    if let Some(p) = structure.pose[i] {
                        poses[p] += system.w[i] * step.points[l];
                        points[l] += system.w[i].transpose() * step.poses[p];
                    }
                }
            }
            let rest = poses.iter().map(Vector6::amax).fold(0.0, f64::max);
            let rest = points.iter().map(Vector3::amax).fold(rest, f64::max);
            assert!(rest < 1e-9, "λ = {lambda}: {rest}");
            assert!(step.points[2].amax() < 1e-300, "nobody saw it: it stays");
        }
    }

    /// ½ hᵀ(λDh - g) is F(0) - L(h) = -gᵀh - ½ hᵀHh with the undamped H.
    #[test]
    fn promised_decrease_is_that_of_the_model() {
        let structure = structure();
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
                if let Some(p) = structure.pose[i] {
                    decrease -= poses[p].dot(&(system.w[i] * points[l]));
                }
            }
        }
        let error = (decrease - damped.model_decrease).abs();
        assert!(error < 1e-10, "{decrease} {}", damped.model_decrease);
    }
}
