//! [`PoseGraph`]: poses from measured relative poses.
//!
//! Tracking measures each keyframe against its neighbours; small errors add up. When
//! the camera returns to a known place, one more relative pose measures the accumulated error, and the graph
//! distributes it over the loop. Points are not part of the graph: a point moves with the keyframe that
//! made it, p_world ← T_new⁻¹ T_old p_world.
//!
//! An edge measures a_from_b; its residual is the remaining motion (E17):
//!
//! ```text
//! E = (a_from_b)⁻¹ T_a T_b⁻¹      r = log E  (ρ, φ)      F = ½ Σ ρ(rᵀ Ω r)
//! ```
//!
//! with T = camera_from_world, moved on the left. Then exp(ξ_a) T_a gives exp(Ad(a_from_b⁻¹) ξ_a) E
//! and exp(ξ_b) T_b gives exp(-Ad(E) ξ_b) E, so that with the left Jacobian J of SE(3)
//!
//! ∂r/∂ξ_a = J(r)⁻¹ Ad(a_from_b⁻¹),   ∂r/∂ξ_b = -J(r)⁻¹ Ad(E)
//!
//! Source: Kümmerle et al., *g2o: a general framework for graph optimization*, 2011; Barfoot, *State
//! estimation for robotics*, 2017, sec. 9.2.

use garad_core::Se3;
use nalgebra::{Matrix6, SMatrix, Vector6};

use crate::blocks::{Block, BlockMatrix, LinearSolver, Pattern};
use crate::dense::SMALLEST_DIAGONAL;
use crate::error::{OptimError, positive};
use crate::lm::{Damped, LmConfig, Model, Report, System, minimise};
use crate::robust::RobustKernel;
use crate::solve::ldlt_inverse;

/// A measured relative pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseEdge {
    /// Index of one pose.
    pub a: usize,
    /// Index of the other.
    pub b: usize,
    /// Measured: `camera_a_from_world` times the inverse of `camera_b_from_world`.
    pub a_from_b: Se3,
    /// Ω, the inverse covariance of the residual in the order (ρ, φ), 1/m² and 1/rad²; not negative.
    pub information: Matrix6<f64>,
}

/// How a graph is optimised.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseGraphConfig {
    /// Trials of Levenberg-Marquardt.
    pub iterations: usize,
    /// Converged when a step promises no more than this part of the cost.
    pub cost_tolerance: f64,
    /// On rᵀΩr of each edge; limits the effect of a wrong loop closure.
    pub kernel: RobustKernel,
    /// Of the steps.
    pub linear_solver: LinearSolver,
}

impl Default for PoseGraphConfig {
    fn default() -> Self {
        Self {
            iterations: 20,
            cost_tolerance: 1e-6,
            kernel: RobustKernel::None,
            linear_solver: LinearSolver::Portable,
        }
    }
}

/// First λ. The smallest eigenvalue of a long chain is 1/N² of the diagonal, and λ must be below it.
const LAMBDA: f64 = 1e-8;

/// The report of the minimisation, and the residual of each edge.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseGraphReport {
    /// Of the minimisation.
    pub report: Report,
    /// rᵀΩr of each edge at the end: χ² with 6 degrees of freedom if the information is true.
    pub chi2: Vec<f64>,
}

/// Poses and the edges between them.
///
/// # Example
/// Two poses and two measurements of their distance, one with twice the information:
/// ```
/// use garad_core::{Se3, So3};
/// use garad_optim::{PoseEdge, PoseGraph, PoseGraphConfig};
/// use nalgebra::{Matrix6, Vector3};
/// let along = |x: f64| Se3::new(So3::identity(), Vector3::new(x, 0.0, 0.0));
/// let edge = |x: f64, weight: f64| PoseEdge {
///     a: 1,
///     b: 0,
///     a_from_b: along(x),
///     information: Matrix6::identity() * weight,
/// };
/// let mut graph = PoseGraph {
///     poses: vec![Se3::identity(); 2],
///     fixed: vec![true, false],
///     edges: vec![edge(1.0, 2.0), edge(4.0, 1.0)],
/// };
/// graph.optimise(&PoseGraphConfig::default()).unwrap();
/// assert!((graph.poses[1].translation.x - 2.0).abs() < 1e-6); // (2 · 1 + 1 · 4) / 3
/// ```
#[derive(Debug, Clone, PartialEq, Default)]
pub struct PoseGraph {
    /// `camera_from_world`, metres.
    pub poses: Vec<Se3>,
    /// Poses that do not move; without one the graph as a whole is held only by the damping.
    pub fixed: Vec<bool>,
    /// In the order in which they are summed.
    pub edges: Vec<PoseEdge>,
}

impl PoseGraph {
    /// Adds a pose; its index.
    pub fn add_pose(&mut self, camera_from_world: Se3, fixed: bool) -> usize {
        self.poses.push(camera_from_world);
        self.fixed.push(fixed);
        self.poses.len() - 1
    }

    /// Optimises the free poses by Levenberg-Marquardt.
    ///
    /// # Numerics
    /// f64, sums in the order of the edges, sparse systems of 6x6 blocks ([`crate::blocks`]): the same
    /// bits on every machine by [`LinearSolver::Portable`]. Rotations of a residual near π have a kink in their logarithm: start
    /// from poses that are less than half a turn wrong.
    ///
    /// # Errors
    /// [`OptimError`] for indices out of range, lists of different length, numbers that are not
    /// finite, information that is not symmetric or has a negative direction; nothing has moved then.
    pub fn optimise(&mut self, config: &PoseGraphConfig) -> Result<PoseGraphReport, OptimError> {
        self.validate(config)?;
        let model = GraphModel::new(self, config);
        let lm = LmConfig {
            iterations: config.iterations,
            lambda: LAMBDA,
            cost_tolerance: config.cost_tolerance,
            ..LmConfig::default()
        };
        let (poses, report) = minimise(&&model, self.poses.clone(), &lm);
        let chi2 = self.edges.iter().map(|e| e.chi2(&poses)).collect();
        self.poses = poses;
        Ok(PoseGraphReport { report, chi2 })
    }

    fn validate(&self, config: &PoseGraphConfig) -> Result<(), OptimError> {
        if self.fixed.len() != self.poses.len() {
            return Err(OptimError::SizeMismatch {
                what: "fixed",
                got: self.fixed.len(),
                expected: self.poses.len(),
            });
        }
        match config.kernel {
            RobustKernel::None => {}
            RobustKernel::Huber { delta: scale }
            | RobustKernel::Cauchy { c: scale }
            | RobustKernel::GemanMcClure { c: scale }
            | RobustKernel::Tukey { c: scale } => positive("scale of the kernel", 0, scale)?,
        }
        let not_finite = |what, index| Err(OptimError::NotFinite { what, index });
        if let Some(index) = self.poses.iter().position(|p| !p.is_finite()) {
            return not_finite("pose", index);
        }
        for (index, edge) in self.edges.iter().enumerate() {
            for target in [edge.a, edge.b] {
                if target >= self.poses.len() {
                    return Err(OptimError::OutOfRange {
                        what: "pose",
                        index,
                        target,
                        count: self.poses.len(),
                    });
                }
            }
            if !edge.a_from_b.is_finite() || !edge.information.iter().all(|v| v.is_finite()) {
                return not_finite("edge", index);
            }
            let scale = edge.information.diagonal().amax();
            let asymmetry = (edge.information - edge.information.transpose()).amax();
            let lifted = edge.information + Matrix6::identity() * (1e-9 * scale);
            if asymmetry > 1e-9 * scale || (scale > 0.0 && ldlt_inverse(&lifted).is_err()) {
                return Err(OptimError::NotPositive {
                    what: "information of edge",
                    index,
                    value: edge.information.diagonal().min(),
                });
            }
        }
        Ok(())
    }
}

impl PoseEdge {
    /// E = (a_from_b)⁻¹ T_a T_b⁻¹.
    fn error(&self, poses: &[Se3]) -> Se3 {
        self.a_from_b.inverse() * (poses[self.a] * poses[self.b].inverse())
    }

    fn chi2(&self, poses: &[Se3]) -> f64 {
        let r = self.error(poses).log();
        r.dot(&(self.information * r))
    }

    /// r, ∂r/∂ξ_a, ∂r/∂ξ_b.
    fn linearise(&self, poses: &[Se3]) -> (Vector6<f64>, Matrix6<f64>, Matrix6<f64>) {
        let error = self.error(poses);
        let r = error.log();
        let j_inverse = Se3::left_jacobian_inverse(&r);
        let by_a = j_inverse * self.a_from_b.inverse().adjoint();
        let by_b = -(j_inverse * error.adjoint());
        (r, by_a, by_b)
    }
}

struct GraphModel<'g> {
    edges: &'g [PoseEdge],
    kernel: RobustKernel,
    /// Step of elimination of each pose, `None` if it is fixed.
    step: Vec<Option<usize>>,
    pattern: Pattern,
}

impl<'g> GraphModel<'g> {
    fn new(graph: &'g PoseGraph, config: &PoseGraphConfig) -> Self {
        let mut free = vec![None; graph.poses.len()];
        let mut n = 0;
        for (number, _) in free
            .iter_mut()
            .zip(&graph.fixed)
            .filter(|(_, fixed)| !**fixed)
        {
            *number = Some(n);
            n += 1;
        }
        let pairs = graph.edges.iter().filter_map(|e| free[e.a].zip(free[e.b]));
        let pattern = Pattern::new(n, pairs, config.linear_solver);
        Self {
            edges: &graph.edges,
            kernel: config.kernel,
            step: free.iter().map(|f| f.map(|f| pattern.step(f))).collect(),
            pattern,
        }
    }
}

impl<'m> Model for &'m GraphModel<'_> {
    type State = Vec<Se3>;
    type System = GraphSystem<'m>;

    fn cost(&self, poses: &Vec<Se3>) -> f64 {
        let rho = self.edges.iter().map(|e| self.kernel.rho(e.chi2(poses)));
        rho.fold(0.0, |sum, rho| sum + 0.5 * rho)
    }

    fn linearise(&self, poses: &Vec<Se3>) -> GraphSystem<'m> {
        let mut system = GraphSystem {
            cost: 0.0,
            hessian: BlockMatrix::zeros(&self.pattern),
            gradient: vec![Vector6::zeros(); self.pattern.len()],
        };
        for edge in self.edges {
            let (r, by_a, by_b) = edge.linearise(poses);
            let chi2 = r.dot(&(edge.information * r));
            system.cost += 0.5 * self.kernel.rho(chi2);
            let weighted = edge.information * self.kernel.weight(chi2);
            let parts = [(self.step[edge.a], by_a), (self.step[edge.b], by_b)];
            for (i, &(row, j_row)) in parts.iter().enumerate() {
                let Some(row) = row else { continue };
                let left = j_row.transpose() * weighted;
                system.gradient[row] += left * r;
                add(&mut system.hessian.diagonal[row], &(left * j_row));
                let (column, j_column) = parts[1 - i];
                let Some(column) = column else { continue };
                if row == column {
                    add(&mut system.hessian.diagonal[row], &(left * j_column));
                } else if let Some(slot) = self.pattern.slot(row, column) {
                    add(&mut system.hessian.lower[slot], &(left * j_column));
                }
            }
        }
        system
    }

    fn step(&self, poses: &Vec<Se3>, step: &Vec<Vector6<f64>>) -> Vec<Se3> {
        let moved = |(pose, number): (&Se3, &Option<usize>)| match number {
            Some(k) => Se3::exp(&step[*k]) * *pose,
            None => *pose,
        };
        poses.iter().zip(&self.step).map(moved).collect()
    }
}

fn add(block: &mut Block, matrix: &SMatrix<f64, 6, 6>) {
    for (element, value) in block.iter_mut().zip(matrix.iter()) {
        *element += value;
    }
}

/// H, by step of elimination, and the gradient.
struct GraphSystem<'m> {
    cost: f64,
    hessian: BlockMatrix<'m>,
    gradient: Vec<Vector6<f64>>,
}

impl GraphSystem<'_> {
    /// D = max(diag H, a tiny part of its largest element), per step.
    fn scale(&self) -> Vec<Vector6<f64>> {
        let diagonals = self.hessian.diagonal.iter();
        let diagonals: Vec<_> = diagonals
            .map(|d| Vector6::from_fn(|i, _| d[7 * i]))
            .collect();
        let largest = diagonals.iter().map(Vector6::amax).fold(0.0, f64::max);
        let floor = SMALLEST_DIAGONAL * largest;
        diagonals.iter().map(|d| d.map(|d| d.max(floor))).collect()
    }
}

impl System for GraphSystem<'_> {
    type Step = Vec<Vector6<f64>>;

    fn cost(&self) -> f64 {
        self.cost
    }

    fn gradient_norm(&self) -> f64 {
        let elements = self.gradient.iter().flat_map(|g| g.iter());
        elements.fold(0.0, |largest: f64, g| {
            if g.is_finite() {
                largest.max(g.abs())
            } else {
                f64::INFINITY
            }
        })
    }

    fn solve(&self, lambda: f64) -> Option<Damped<Vec<Vector6<f64>>>> {
        let scale = self.scale();
        let mut damped = self.hessian.clone();
        for (block, d) in damped.diagonal.iter_mut().zip(&scale) {
            for i in 0..6 {
                block[7 * i] += lambda * d[i];
            }
        }
        let mut step: Vec<_> = self.gradient.iter().map(|g| -g).collect();
        damped.solve(&mut step).ok()?;
        let mut model_decrease = 0.0;
        for ((h, d), g) in step.iter().zip(&scale).zip(&self.gradient) {
            model_decrease += 0.5 * h.dot(&(h.component_mul(d) * lambda - g));
        }
        Some(Damped {
            step,
            model_decrease,
        })
    }
}

#[cfg(test)]
mod tests;
