//! Mean field: the belief of every node, updated in parallel.
//!
//! Eq. 1 gives every labelling X an energy, and with it a probability exp(-E(X)) / Z. The probability
//! that node i is dynamic is a sum over 2^N labellings. Mean field approximates this distribution by the
//! closest one in which nodes are independent, with P(xᵢ = dynamic) = qᵢ (C3 in docs/math_crf.md).
//!
//! Under the pairwise potential of eq. 4 the expected energy of node i is ψ_u(static) + Σⱼ Jᵢⱼ qⱼ for
//! one label and ψ_u(dynamic) + Σⱼ Jᵢⱼ (1 - qⱼ) for the other, Jᵢⱼ = Σₘ ω^m k^m(i, j). At the optimum
//!
//! ln(qᵢ / (1 - qᵢ)) = uᵢ + Σₘ ω^m Σⱼ k^m(i, j) (2 qⱼ - 1)      (C2)
//!
//! and the iteration applies the right side to all nodes in parallel, starting at q = σ(u). The
//! sums may be normalised, see [`crate::Normalisation`].

use garad_core::Par;

use crate::config::{KernelConfig, MeanFieldConfig};
use crate::error_bound::ErrorBound;
use crate::normalised::NormalisedKernel;
use crate::reference::{Kernel, KernelSums};
use crate::sigmoid::sigmoid;

/// The result of the iteration.
pub(crate) struct Solution {
    /// Belief of being dynamic.
    pub(crate) dynamic: Vec<f64>,
    /// Largest change in the last iteration.
    pub(crate) last_change: f64,
    /// Bound on the distance of any belief to the same iteration in exact arithmetic.
    pub(crate) error_bound: f64,
}

/// `config.iterations` parallel updates of (C2) from q = σ(u). `log_odds` is u.
pub(crate) fn solve(
    log_odds: &[f64],
    sums: &impl KernelSums,
    kernels: &KernelConfig,
    config: &MeanFieldConfig,
    par: Par,
) -> Solution {
    let (n, damping) = (log_odds.len(), config.damping);
    let kernels: Vec<_> = [
        (Kernel::Feature, kernels.feature_weight),
        (Kernel::Position, kernels.position_weight),
    ]
    .into_iter()
    .filter(|(_, weight)| *weight > 0.0)
    .map(|(k, weight)| NormalisedKernel::new(sums, k, weight, config.normalisation, n, par))
    .collect();

    let mut dynamic: Vec<f64> = log_odds.iter().map(|&u| sigmoid(u)).collect();
    let (mut last_change, mut bound) = (0.0f64, ErrorBound::new(&kernels, par));
    for _ in 0..config.iterations {
        let s: Vec<f64> = dynamic.iter().map(|q| 2.0 * q - 1.0).collect();
        let mut logit = log_odds.to_vec();
        for kernel in &kernels {
            for (logit, sum) in logit.iter_mut().zip(kernel.sums(&s, par)) {
                *logit += kernel.weight * sum;
            }
        }
        bound.update(log_odds, &logit, damping);
        last_change = 0.0;
        for (q, &logit) in dynamic.iter_mut().zip(&logit) {
            let next = (1.0 - damping) * sigmoid(logit) + damping * *q;
            last_change = last_change.max((next - *q).abs());
            *q = next;
        }
    }
    Solution {
        dynamic,
        last_change,
        error_bound: bound.value(),
    }
}
