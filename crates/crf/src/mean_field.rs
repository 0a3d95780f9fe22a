//! Mean field: the labels of all nodes at once, each asking its neighbours.
//!
//! Eq. 1 gives every labelling X an energy, and with it a probability exp(-E(X)) / Z. What we want,
//! the probability that node i is dynamic, is a sum over 2^N labellings. Mean field looks for the
//! product of independent coins q₁ ... q_N that comes closest to it (C3 in docs/math_crf.md). At
//! the best coins each one agrees with what the others make it expect,
//!
//! ln(qᵢ / (1 - qᵢ)) = uᵢ + Σₘ ω^m Σⱼ k^m(i, j) (2 qⱼ - 1)      (C2)
//!
//! and the iteration applies the right side to all nodes in parallel, from q = σ(u), the nodes' own
//! opinion. A neighbour that is undecided (qⱼ = 1/2) says nothing; a certain one adds or takes away
//! ω k. The sums may be normalised, see [`Normalisation`].
//!
//! # How far an approximate sum leads astray
//! If every qⱼ is off by at most e, a normalised sum of kernels is off by at most 2e, plus δᵢ for
//! what was left out of the sum itself. So the log-odds of node i are off by at most
//! λᵢ = Σₘ ω^m (2 e gᵢ^m + δᵢ^m), and the next belief by at most
//! max(σ(ℓᵢ + λᵢ) - σ(ℓᵢ), σ(ℓᵢ) - σ(ℓᵢ - λᵢ)). This recursion runs beside the beliefs and costs two
//! sigmoids per node; a node that is sure of itself forgives errors, an undecided one amplifies
//! them by up to ω / 2 per kernel and iteration (C5).

use garad_core::Par;

use crate::config::{KernelConfig, MeanFieldConfig, Normalisation};

/// Which of the two kernels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kernel {
    /// Eq. 5.
    Feature,
    /// Eq. 6.
    Position,
}

/// Sums over all pairs: what the iteration needs of a kernel, and all it needs.
pub(crate) trait KernelSums {
    /// Σⱼ k(i, j) sⱼ for each i; j = i takes part if the configuration says so.
    fn sums(&self, kernel: Kernel, s: &[f64], par: Par) -> Vec<f64>;

    /// For each i, a bound on what [`KernelSums::sums`] leaves out or invents where |sⱼ| ≤ 1,
    /// rounding aside.
    fn left_out(&self, kernel: Kernel) -> Vec<f64>;
}

/// What the iteration found.
pub(crate) struct Solution {
    /// Belief of being dynamic.
    pub(crate) dynamic: Vec<f64>,
    /// Largest change in the last iteration.
    pub(crate) last_change: f64,
    /// Bound on the distance of any belief to the same iteration in exact arithmetic.
    pub(crate) error_bound: f64,
}

/// 1 / (1 + e⁻ˣ), to its last digits at both ends.
pub(crate) fn sigmoid(x: f64) -> f64 {
    if x >= 0.0 {
        1.0 / (1.0 + libm::exp(-x))
    } else {
        let e = libm::exp(x);
        e / (1.0 + e)
    }
}

/// One kernel with its weight and its normalisation: message = weight · out ∘ K (into ∘ s).
struct Messages {
    kernel: Kernel,
    weight: f64,
    /// Factor of each node when it speaks; `None` is 1.
    into: Option<Vec<f64>>,
    /// Factor of each node when it listens.
    out: Vec<f64>,
    /// gᵢ: bound on the normalised sum of kernel values.
    gain: Vec<f64>,
    /// δᵢ: bound on the error of the normalised sum.
    error: Vec<f64>,
}

impl Messages {
    fn new(
        kernel: Kernel,
        weight: f64,
        normalisation: Normalisation,
        kernels: &impl KernelSums,
        n: usize,
        par: Par,
    ) -> Self {
        let rows = kernels.sums(kernel, &vec![1.0; n], par);
        let mut left_out = kernels.left_out(kernel);
        // Any order of n additions loses at most n u Σ|terms|; a kernel value some thousand u.
        let rounding = (n as f64 + 4096.0) * f64::EPSILON;
        for (lost, r) in left_out.iter_mut().zip(&rows) {
            *lost += rounding * r.abs();
        }
        let reciprocal = |r: f64| if r > 0.0 { 1.0 / r } else { 0.0 };
        let (into, out, gain, error) = match normalisation {
            Normalisation::None => {
                let gain = rows.iter().zip(&left_out).map(|(r, l)| r + l).collect();
                (None, vec![1.0; n], gain, left_out)
            }
            Normalisation::Rows => {
                // |N̂/r̂ - N/r| ≤ |N̂ - N| / r̂ + (|N| / r) |r - r̂| / r̂ ≤ 2 δ / r̂. A node whose
                // whole sum may be made of what was left out hears nothing; it should have heard
                // something between -1 and 1.
                let heard = || {
                    rows.iter()
                        .zip(&left_out)
                        .map(|(&r, &lost)| (r, lost, r > lost))
                };
                let out = heard().map(|(r, _, any)| if any { 1.0 / r } else { 0.0 });
                let error = heard().map(|(r, lost, any)| match any {
                    true => 2.0 * lost / r,
                    false if lost > 0.0 => 1.0,
                    false => 0.0,
                });
                let (out, error) = (out.collect(), error.collect());
                (None, out, vec![1.0; n], error)
            }
            Normalisation::Symmetric => {
                let scale: Vec<f64> = rows.iter().map(|&r| reciprocal(r).sqrt()).collect();
                let gain = kernels.sums(kernel, &scale, par);
                let largest = scale.iter().copied().fold(0.0, f64::max);
                // Relative error of a row sum, and with it of its root's reciprocal (C5).
                let relative = rows
                    .iter()
                    .zip(&left_out)
                    .map(|(r, l)| if *l > 0.0 { l / r.max(0.0) } else { 0.0 });
                let worst = relative.fold(0.0, f64::max);
                let worst = if worst <= 0.5 { worst } else { f64::INFINITY };
                let gain: Vec<f64> = (0..n)
                    .map(|i| {
                        scale[i] * (gain[i] + left_out[i] * largest) * (1.0 + worst) * (1.0 + worst)
                    })
                    .collect();
                let error = (0..n)
                    .map(|i| (2.0 + worst) * worst * gain[i] + scale[i] * left_out[i] * largest)
                    .map(|e| if e.is_nan() { f64::INFINITY } else { e })
                    .collect();
                (Some(scale.clone()), scale, gain, error)
            }
        };
        Self {
            kernel,
            weight,
            into,
            out,
            gain,
            error,
        }
    }
}

/// `config.iterations` parallel updates of (C2) from q = σ(u). `log_odds` is u.
pub(crate) fn solve(
    log_odds: &[f64],
    kernels: &impl KernelSums,
    weights: &KernelConfig,
    config: &MeanFieldConfig,
    par: Par,
) -> Solution {
    let n = log_odds.len();
    let messages: Vec<Messages> = [
        (Kernel::Feature, weights.feature_weight),
        (Kernel::Position, weights.position_weight),
    ]
    .into_iter()
    .filter(|(_, weight)| *weight > 0.0)
    .map(|(kernel, weight)| Messages::new(kernel, weight, config.normalisation, kernels, n, par))
    .collect();

    let mut dynamic: Vec<f64> = log_odds.iter().map(|&u| sigmoid(u)).collect();
    let (mut last_change, mut error_bound) = (0.0f64, 4.0 * f64::EPSILON);
    for _ in 0..config.iterations {
        let opinion: Vec<f64> = dynamic.iter().map(|q| 2.0 * q - 1.0).collect();
        let mut logit = log_odds.to_vec();
        let mut slack = vec![0.0; n];
        for m in &messages {
            let sums = match &m.into {
                None => kernels.sums(m.kernel, &opinion, par),
                Some(scale) => {
                    let spoken: Vec<f64> = opinion.iter().zip(scale).map(|(s, c)| s * c).collect();
                    kernels.sums(m.kernel, &spoken, par)
                }
            };
            for i in 0..n {
                logit[i] += m.weight * (m.out[i] * sums[i]);
                slack[i] += m.weight * (2.0 * error_bound * m.gain[i] + m.error[i]);
            }
        }
        last_change = 0.0;
        let mut next_bound = 0.0f64;
        for i in 0..n {
            let updated = sigmoid(logit[i]);
            let slack = slack[i] + 16.0 * f64::EPSILON * (1.0 + logit[i].abs() + log_odds[i].abs());
            let above = sigmoid(logit[i] + slack) - updated;
            let below = updated - sigmoid(logit[i] - slack);
            next_bound = next_bound.max(above).max(below);
            let next = (1.0 - config.damping) * updated + config.damping * dynamic[i];
            last_change = last_change.max((next - dynamic[i]).abs());
            dynamic[i] = next;
        }
        error_bound =
            (1.0 - config.damping) * next_bound + config.damping * error_bound + 4.0 * f64::EPSILON;
    }
    Solution {
        dynamic,
        last_change,
        error_bound: error_bound.min(1.0),
    }
}

#[cfg(test)]
mod tests {
    use super::sigmoid;

    #[test]
    fn sigmoid_keeps_its_digits() {
        assert!((sigmoid(0.0) - 0.5).abs() < 1e-16, "middle");
        assert!(
            (sigmoid(-40.0) / 4.248_354_255_291_589e-18 - 1.0).abs() < 1e-14,
            "far below"
        );
        assert!(
            (sigmoid(2.0) + sigmoid(-2.0) - 1.0).abs() < 1e-15,
            "symmetric"
        );
        let ends = [-800.0, 800.0].map(|x| sigmoid(x).to_bits());
        assert_eq!(ends, [0.0f64, 1.0].map(f64::to_bits), "ends");
    }
}
