//! [`NormalisedKernel`]: one kernel of eq. 4 with its weight, its sums divided as [`Normalisation`] says.

use garad_core::Par;

use crate::readings::Normalisation;
use crate::reference::{Kernel, KernelSums};

/// ω^m and the sums of k^m: out ∘ K (into ∘ s).
pub(crate) struct NormalisedKernel<'a, K> {
    pub(crate) kernels: &'a K,
    pub(crate) kernel: Kernel,
    /// ω^m.
    pub(crate) weight: f64,
    pub(crate) normalisation: Normalisation,
    /// rᵢ = Σⱼ k(i, j).
    pub(crate) rows: Vec<f64>,
    /// Bound on the error of rᵢ, and of any Σⱼ k(i, j) sⱼ with |sⱼ| ≤ 1.
    pub(crate) left_out: Vec<f64>,
    /// Factor of each sⱼ; `None` is 1.
    into: Option<Vec<f64>>,
    /// Factor of each sum.
    pub(crate) out: Vec<f64>,
}

impl<'a, K: KernelSums> NormalisedKernel<'a, K> {
    pub(crate) fn new(
        kernels: &'a K,
        kernel: Kernel,
        weight: f64,
        normalisation: Normalisation,
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
        let (into, out) = match normalisation {
            Normalisation::None => (None, vec![1.0; n]),
            // A row that is no larger than its error gives no message.
            Normalisation::Rows => {
                let known = |(&r, &lost)| if r > lost { 1.0 / r } else { 0.0 };
                (None, rows.iter().zip(&left_out).map(known).collect())
            }
            Normalisation::Symmetric => {
                let scale: Vec<f64> = rows.iter().map(|&r| reciprocal(r).sqrt()).collect();
                (Some(scale.clone()), scale)
            }
        };
        Self {
            kernels,
            kernel,
            weight,
            normalisation,
            rows,
            left_out,
            into,
            out,
        }
    }

    /// Σⱼ k(i, j) sⱼ for each i, normalised.
    pub(crate) fn sums(&self, s: &[f64], par: Par) -> Vec<f64> {
        let mut sums = match &self.into {
            None => self.kernels.sums(self.kernel, s, par),
            Some(scale) => {
                let scaled: Vec<f64> = s.iter().zip(scale).map(|(s, c)| s * c).collect();
                self.kernels.sums(self.kernel, &scaled, par)
            }
        };
        for (sum, out) in sums.iter_mut().zip(&self.out) {
            *sum *= out;
        }
        sums
    }
}
