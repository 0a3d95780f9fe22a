//! [`ErrorBound`]: how far approximate kernel sums can move the beliefs of mean field.
//!
//! If every qⱼ is off by at most e, a normalised sum of kernels is off by at most 2 e gᵢ, plus δᵢ for the
//! error of the sum itself. So the log-odds of node i are off by at most
//!
//! λᵢ = Σₘ ω^m (2 e gᵢ^m + δᵢ^m)                                                         (C5)
//!
//! and the next belief by at most max(σ(ℓᵢ + λᵢ) - σ(ℓᵢ), σ(ℓᵢ) - σ(ℓᵢ - λᵢ)). The largest over all nodes is the
//! next e. This recursion runs beside the iteration and costs three sigmoids per node. Where σ is flat errors
//! shrink; at an undecided node they grow by up to ω / 2 per kernel and iteration.

use garad_core::Par;

use crate::normalised::NormalisedKernel;
use crate::readings::Normalisation;
use crate::reference::KernelSums;
use crate::sigmoid::sigmoid;

/// What one kernel contributes to λ.
struct Terms {
    weight: f64,
    /// gᵢ: bound on the normalised sum of kernel values.
    gain: Vec<f64>,
    /// δᵢ: bound on the error of the normalised sum.
    error: Vec<f64>,
}

impl Terms {
    fn new<K: KernelSums>(kernel: &NormalisedKernel<'_, K>, par: Par) -> Self {
        let (rows, left_out, scale) = (&kernel.rows, &kernel.left_out, &kernel.out);
        let n = rows.len();
        let (gain, error) = match kernel.normalisation {
            Normalisation::None => {
                let gain = rows.iter().zip(left_out).map(|(r, l)| r + l).collect();
                (gain, left_out.clone())
            }
            Normalisation::Rows => {
                // |N̂/r̂ - N/r| ≤ |N̂ - N| / r̂ + (|N| / r) |r - r̂| / r̂ ≤ 2 δ / r̂. A row that may consist
                // of what was left out gives 0; the exact value is between -1 and 1.
                let error = rows.iter().zip(left_out).map(|(&r, &lost)| {
                    if r > lost {
                        2.0 * lost / r
                    } else if lost > 0.0 {
                        1.0
                    } else {
                        0.0
                    }
                });
                (vec![1.0; n], error.collect())
            }
            Normalisation::Symmetric => {
                let sums = kernel.kernels.sums(kernel.kernel, scale, par);
                let largest = scale.iter().copied().fold(0.0, f64::max);
                // Relative error of a row sum, and with it of its root's reciprocal (C5).
                let relative = rows
                    .iter()
                    .zip(left_out)
                    .map(|(r, l)| if *l > 0.0 { l / r.max(0.0) } else { 0.0 });
                let worst = relative.fold(0.0, f64::max);
                let worst = if worst <= 0.5 { worst } else { f64::INFINITY };
                let gain: Vec<f64> = (0..n)
                    .map(|i| {
                        scale[i] * (sums[i] + left_out[i] * largest) * (1.0 + worst) * (1.0 + worst)
                    })
                    .collect();
                let error = (0..n)
                    .map(|i| (2.0 + worst) * worst * gain[i] + scale[i] * left_out[i] * largest)
                    .map(|e| if e.is_nan() { f64::INFINITY } else { e })
                    .collect();
                (gain, error)
            }
        };
        Self {
            weight: kernel.weight,
            gain,
            error,
        }
    }
}

/// e: no belief is further than this from the same iterations in exact arithmetic.
pub(crate) struct ErrorBound {
    terms: Vec<Terms>,
    e: f64,
}

impl ErrorBound {
    /// Of q = σ(u).
    pub(crate) fn new<K: KernelSums>(kernels: &[NormalisedKernel<'_, K>], par: Par) -> Self {
        Self {
            terms: kernels.iter().map(|k| Terms::new(k, par)).collect(),
            e: 4.0 * f64::EPSILON,
        }
    }

    /// After an update to log-odds ℓ from unary log-odds u.
    pub(crate) fn update(&mut self, log_odds: &[f64], logit: &[f64], damping: f64) {
        let mut largest = 0.0f64;
        for (i, (&u, &l)) in log_odds.iter().zip(logit).enumerate() {
            let mut lambda = 0.0;
            for t in &self.terms {
                lambda += t.weight * (2.0 * self.e * t.gain[i] + t.error[i]);
            }
            let lambda = lambda + 16.0 * f64::EPSILON * (1.0 + l.abs() + u.abs());
            let above = sigmoid(l + lambda) - sigmoid(l);
            let below = sigmoid(l) - sigmoid(l - lambda);
            largest = largest.max(above).max(below);
        }
        self.e = (1.0 - damping) * largest + damping * self.e + 4.0 * f64::EPSILON;
    }

    /// e; 1 where nothing better is known.
    pub(crate) fn value(&self) -> f64 {
        self.e.min(1.0)
    }
}
