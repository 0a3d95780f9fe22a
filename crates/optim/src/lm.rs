//! [`minimise`]: Levenberg-Marquardt, written once for every problem.
//!
//! Each trial solves (H + λD) h = -g, with H = Σ ρ' JᵀJ the Gauss-Newton matrix, g = Σ ρ' Jᵀr the
//! gradient of the cost and D = diag(H) (Marquardt's scaling: the answer does not depend on the units
//! of the unknowns). The step is taken if the cost becomes *smaller*; the comparison is written
//! so that NaN is a rejection.
//!
//! The gain ratio compares the decrease of the cost with the decrease that the linear model predicts,
//!
//! F(0) - L(h) = -gᵀh - ½ hᵀHh = ½ hᵀ(λDh - g)                                          (E10)
//!
//! and is 1 for every λ where residuals are linear and there is no kernel. λ follows Nielsen (1999):
//! after a success times max(1/3, 1 - (2ρ-1)³), after a failure times 2, 4, 8, ...
//!
//! Source: Madsen, Nielsen, Tingleff, *Methods for non-linear least squares problems*, 2004,
//! alg. 3.16, with D = diag(H) for I.

/// What [`minimise`] needs of a problem. Dense problems of few unknowns get it from
/// [`crate::dense::Problem`]; bundle adjustment implements it with a Schur complement.
pub trait Model {
    /// The unknowns.
    type State;
    /// Their linearisation.
    type System: System;

    /// F = ½ Σ ρ(‖r‖²). Infinite or NaN where the state is not allowed: such a step is rejected.
    fn cost(&self, state: &Self::State) -> f64;
    /// Cost, gradient and Gauss-Newton matrix at a state.
    fn linearise(&self, state: &Self::State) -> Self::System;
    /// The state moved by a step, on its manifold.
    fn step(&self, state: &Self::State, step: &<Self::System as System>::Step) -> Self::State;
}

/// A linearised problem.
pub trait System {
    /// A move in the tangent space.
    type Step;
    /// The cost where it was linearised.
    fn cost(&self) -> f64;
    /// Largest absolute component of the gradient.
    fn gradient_norm(&self) -> f64;
    /// The step for a damping λ; `None` if the damped matrix is not positive definite.
    fn solve(&self, lambda: f64) -> Option<Damped<Self::Step>>;
}

/// A step and what the linear model expects of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Damped<S> {
    /// h.
    pub step: S,
    /// ½ hᵀ(λDh - g), not negative.
    pub model_decrease: f64,
}

/// When to stop, and where λ starts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LmConfig {
    /// Trials at most, taken or rejected.
    pub iterations: usize,
    /// First λ, relative to the diagonal of H.
    pub lambda: f64,
    /// Converged when the model expects a decrease of at most this part of the cost.
    pub cost_tolerance: f64,
    /// Converged when the cost is at most this: nothing is left to fit.
    pub cost_floor: f64,
}

impl Default for LmConfig {
    fn default() -> Self {
        Self {
            iterations: 10,
            lambda: 1e-4,
            cost_tolerance: 1e-9,
            cost_floor: 1e-12,
        }
    }
}

/// The reason for stopping.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StopReason {
    /// The model expects no more than [`LmConfig::cost_tolerance`], or the cost is at its floor.
    Converged,
    /// The gradient is exactly zero.
    ZeroGradient,
    /// [`LmConfig::iterations`] trials are done.
    IterationLimit,
    /// λ became so large that steps no longer move anything.
    Stalled,
    /// The cost at the start is NaN or infinite; nothing was done.
    NotFinite,
}

/// Summary of a minimisation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Report {
    /// Cost at the start.
    pub cost0: f64,
    /// Cost at the end, never above `cost0`.
    pub cost: f64,
    /// Steps taken.
    pub iterations: usize,
    /// Steps rejected.
    pub rejected: usize,
    /// Largest absolute component of the gradient at the end.
    pub grad_norm: f64,
    /// The reason for stopping.
    pub stop: StopReason,
}

/// One trial, as an observer sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trial {
    /// Damping.
    pub lambda: f64,
    /// Cost before.
    pub cost: f64,
    /// Cost after; NaN when the system could not be solved.
    pub new_cost: f64,
    /// Decrease of the cost over the predicted one.
    pub gain_ratio: f64,
    /// Taken.
    pub accepted: bool,
}

/// λ and how it moves.
#[derive(Debug, Clone, Copy)]
struct Damping {
    lambda: f64,
    growth: f64,
}

impl Damping {
    /// Beyond this a step is 1e-16 of the gradient step in units of D.
    const LARGEST: f64 = 1e16;

    fn accept(&mut self, gain_ratio: f64) {
        let x = 2.0 * gain_ratio - 1.0;
        self.lambda *= (1.0 - x * x * x).max(1.0 / 3.0);
        self.growth = 2.0;
    }

    fn reject(&mut self) {
        self.lambda *= self.growth;
        self.growth *= 2.0;
    }
}

/// Minimises from `initial`.
///
/// # Numerics
/// The cost never rises. Deterministic.
pub fn minimise<M: Model>(model: &M, initial: M::State, config: &LmConfig) -> (M::State, Report) {
    minimise_observed(model, initial, config, |_| ())
}

/// [`minimise`], showing every trial.
pub fn minimise_observed<M: Model>(
    model: &M,
    initial: M::State,
    config: &LmConfig,
    mut observer: impl FnMut(&Trial),
) -> (M::State, Report) {
    let mut state = initial;
    let mut system = model.linearise(&state);
    let mut damping = Damping {
        lambda: config.lambda,
        growth: 2.0,
    };
    let mut report = Report {
        cost0: system.cost(),
        cost: system.cost(),
        iterations: 0,
        rejected: 0,
        grad_norm: system.gradient_norm(),
        stop: StopReason::NotFinite,
    };
    if !(report.cost0.is_finite() && report.grad_norm.is_finite()) {
        return (state, report);
    }
    report.stop = loop {
        if report.grad_norm <= 0.0 {
            break StopReason::ZeroGradient;
        }
        if report.cost <= config.cost_floor {
            break StopReason::Converged;
        }
        if report.iterations + report.rejected >= config.iterations {
            break StopReason::IterationLimit;
        }
        if damping.lambda > Damping::LARGEST {
            break StopReason::Stalled;
        }
        let mut trial = Trial {
            lambda: damping.lambda,
            cost: report.cost,
            new_cost: f64::NAN,
            gain_ratio: f64::NAN,
            accepted: false,
        };
        if let Some(damped) = system.solve(damping.lambda) {
            // After a rejection a small predicted decrease only means that λ is large.
            if damping.growth <= 2.0 && damped.model_decrease <= config.cost_tolerance * report.cost
            {
                break StopReason::Converged;
            }
            let candidate = model.step(&state, &damped.step);
            trial.new_cost = model.cost(&candidate);
            trial.gain_ratio = (trial.cost - trial.new_cost) / damped.model_decrease;
            trial.accepted = trial.new_cost < trial.cost;
            if trial.accepted {
                state = candidate;
            }
        }
        observer(&trial);
        if trial.accepted {
            report.iterations += 1;
            damping.accept(trial.gain_ratio);
            system = model.linearise(&state);
            report.cost = system.cost();
            report.grad_norm = system.gradient_norm();
        } else {
            report.rejected += 1;
            damping.reject();
        }
    };
    (state, report)
}

#[cfg(test)]
mod tests;
