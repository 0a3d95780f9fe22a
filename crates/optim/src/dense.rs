//! [`Problem`]: few unknowns, many residual blocks, dense normal equations.
//!
//! A problem is one function, [`Problem::blocks`], that shows every residual block with its
//! Jacobian and kernel to a [`Visitor`]. The cost, the normal equations, the finite-difference
//! check and the recorder of all blocks are visitors: residual and Jacobian cannot disagree,
//! because one place computes both.

use nalgebra::{SMatrix, SVector};

use crate::lm::{Damped, Model, System};
use crate::robust::RobustKernel;
use crate::solve::ldlt_solve;

/// A least-squares problem with N unknowns: F = ½ Σ ρ(‖r‖²).
pub trait Problem<const N: usize> {
    /// The unknowns.
    type State: Clone;

    /// Shows each block at a state, always in the same order.
    fn blocks(&self, state: &Self::State, visitor: &mut impl Visitor<N>);

    /// The state moved by a step of the tangent space.
    fn step(&self, state: &Self::State, step: &SVector<f64, N>) -> Self::State;
}

/// Sees the residual blocks of a problem.
pub trait Visitor<const N: usize> {
    /// A block: the whitened residual r and, when asked for, ∂r/∂(step).
    fn block<const M: usize>(
        &mut self,
        kernel: RobustKernel,
        residual: &SVector<f64, M>,
        jacobian: impl FnOnce() -> SMatrix<f64, M, N>,
    );

    /// The state is not allowed (a point behind its camera): the cost is infinite.
    fn forbid(&mut self);
}

/// ½ Σ ρ(‖r‖²).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Cost {
    /// The sum so far.
    pub cost: f64,
}

impl<const N: usize> Visitor<N> for Cost {
    #[inline]
    fn block<const M: usize>(
        &mut self,
        kernel: RobustKernel,
        residual: &SVector<f64, M>,
        _jacobian: impl FnOnce() -> SMatrix<f64, M, N>,
    ) {
        self.cost += 0.5 * kernel.rho(residual.norm_squared());
    }

    fn forbid(&mut self) {
        self.cost = f64::INFINITY;
    }
}

/// Cost, gradient g = Σ ρ' Jᵀr and Gauss-Newton matrix H = Σ ρ' JᵀJ.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormalEquations<const N: usize> {
    /// F.
    pub cost: f64,
    /// g.
    pub gradient: SVector<f64, N>,
    /// The upper triangle of H; the rest is 0.
    pub hessian: SMatrix<f64, N, N>,
}

impl<const N: usize> Default for NormalEquations<N> {
    fn default() -> Self {
        Self {
            cost: 0.0,
            gradient: SVector::zeros(),
            hessian: SMatrix::zeros(),
        }
    }
}

impl<const N: usize> NormalEquations<N> {
    /// H, both triangles.
    #[must_use]
    pub fn full_hessian(&self) -> SMatrix<f64, N, N> {
        let mut full = self.hessian;
        full.fill_lower_triangle_with_upper_triangle();
        full
    }
}

impl<const N: usize> Visitor<N> for NormalEquations<N> {
    #[inline]
    fn block<const M: usize>(
        &mut self,
        kernel: RobustKernel,
        residual: &SVector<f64, M>,
        jacobian: impl FnOnce() -> SMatrix<f64, M, N>,
    ) {
        let s = residual.norm_squared();
        self.cost += 0.5 * kernel.rho(s);
        let weight = kernel.weight(s);
        let j = jacobian();
        for b in 0..N {
            let mut column = [0.0; M];
            for m in 0..M {
                column[m] = weight * j[(m, b)];
                self.gradient[b] += column[m] * residual[m];
            }
            for a in 0..=b {
                let mut sum = 0.0;
                for m in 0..M {
                    sum += j[(m, a)] * column[m];
                }
                self.hessian[(a, b)] += sum;
            }
        }
    }

    fn forbid(&mut self) {
        self.cost = f64::INFINITY;
    }
}

/// A diagonal element is never taken for less than this part of the largest one: an unknown that
/// without a residual keeps its value and does not make the system singular.
pub(crate) const SMALLEST_DIAGONAL: f64 = 1e-24;

impl<const N: usize> System for NormalEquations<N> {
    type Step = SVector<f64, N>;

    fn cost(&self) -> f64 {
        self.cost
    }

    fn gradient_norm(&self) -> f64 {
        if self.gradient.iter().all(|g| g.is_finite()) {
            self.gradient.amax()
        } else {
            f64::INFINITY
        }
    }

    fn solve(&self, lambda: f64) -> Option<Damped<Self::Step>> {
        let floor = SMALLEST_DIAGONAL * self.hessian.diagonal().amax();
        let damping = self.hessian.diagonal().map(|d| lambda * d.max(floor));
        let mut damped = self.hessian;
        for i in 0..N {
            damped[(i, i)] += damping[i];
        }
        let step = ldlt_solve(&damped, &-self.gradient).ok()?;
        if !step.iter().all(|h| h.is_finite()) {
            return None;
        }
        let model_decrease = 0.5 * step.dot(&(damping.component_mul(&step) - self.gradient));
        Some(Damped {
            step,
            model_decrease,
        })
    }
}

/// A [`Problem`] as a [`crate::lm::Model`].
#[derive(Debug)]
pub struct Dense<'a, P, const N: usize>(pub &'a P);

impl<P: Problem<N>, const N: usize> Model for Dense<'_, P, N> {
    type State = P::State;
    type System = NormalEquations<N>;

    fn cost(&self, state: &P::State) -> f64 {
        let mut cost = Cost::default();
        self.0.blocks(state, &mut cost);
        cost.cost
    }

    fn linearise(&self, state: &P::State) -> NormalEquations<N> {
        let mut equations = NormalEquations::default();
        self.0.blocks(state, &mut equations);
        equations
    }

    fn step(&self, state: &P::State, step: &SVector<f64, N>) -> P::State {
        self.0.step(state, step)
    }
}

/// A residual block as it was shown.
#[derive(Debug, Clone, PartialEq)]
pub struct Block<const N: usize> {
    /// Its kernel.
    pub kernel: RobustKernel,
    /// r.
    pub residual: Vec<f64>,
    /// Rows of ∂r/∂(step).
    pub jacobian: Vec<SVector<f64, N>>,
}

impl<const N: usize> Block<N> {
    /// ρ'(‖r‖²).
    #[must_use]
    pub fn weight(&self) -> f64 {
        self.kernel
            .weight(self.residual.iter().map(|r| r * r).fold(0.0, |a, b| a + b))
    }
}

/// Keeps every block: residuals, Jacobians and weights for a test or a trace to look at.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Recorder<const N: usize> {
    /// In the order shown.
    pub blocks: Vec<Block<N>>,
    /// [`Visitor::forbid`] was called.
    pub forbidden: bool,
}

impl<const N: usize> Visitor<N> for Recorder<N> {
    fn block<const M: usize>(
        &mut self,
        kernel: RobustKernel,
        residual: &SVector<f64, M>,
        jacobian: impl FnOnce() -> SMatrix<f64, M, N>,
    ) {
        let j = jacobian();
        self.blocks.push(Block {
            kernel,
            residual: residual.iter().copied().collect(),
            jacobian: (0..M).map(|m| j.row(m).transpose()).collect(),
        });
    }

    fn forbid(&mut self) {
        self.forbidden = true;
    }
}
