//! Fields small enough to enumerate: the energy of a labelling, all labellings, the free energy.
//!
//! The energy of eq. 1 for labels x ∈ {static, dynamic}^N is
//!
//! E(X) = Σᵢ ψ_u(xᵢ) + Σ_{i<j} μ(xᵢ, xⱼ) Jᵢⱼ,   Jᵢⱼ = Σₘ ω^m k^m(i, j)
//!
//! and its probability exp(-E(X)) / Z. With N nodes there are 2^N labellings; for N up to 20 all of
//! them can be visited, which gives the exact distribution that mean field approximates.
//!
//! Mean field looks for independent probabilities q that minimise the free energy
//!
//! F(q) = ⟨E⟩_q - S(q)
//!      = Σᵢ [qᵢ ψᵢ(1) + (1 - qᵢ) ψᵢ(0) + qᵢ ln qᵢ + (1 - qᵢ) ln(1 - qᵢ)]
//!        + Σ_{i<j} Jᵢⱼ [qᵢ (1 - qⱼ) + qⱼ (1 - qᵢ)]
//!
//! F(q) = -ln Z + KL(q ‖ p) ≥ -ln Z: the closer F comes to its bound, the better the approximation (C3).
//!
//! # Example
//! Two similar nodes: one has log-odds 2 of being dynamic, the other no evidence (0).
//! ```
//! use garad_core::Label::Dynamic;
//! use garad_crf::SmallCrf;
//! let crf = SmallCrf::from_log_odds(&[2.0, 0.0], vec![0.0, 1.0, 1.0, 0.0]).unwrap();
//! let exact = crf.enumerate().unwrap();
//! assert_eq!(exact.map, [Dynamic, Dynamic]);
//! // ψ(dynamic) = -u, and different labels cost 1. Both static: E = 0; the first alone dynamic:
//! // -2 + 1; the second alone: 0 + 1; both: -2.
//! let z = libm::exp(0.0) + libm::exp(1.0) + libm::exp(-1.0) + libm::exp(2.0);
//! assert!((exact.log_z - libm::log(z)).abs() < 1e-14);
//! // F is never below -ln Z, but comes close.
//! let mut q = vec![0.5, 0.5];
//! for _ in 0..50 {
//!     crf.sweep(&mut q);
//! }
//! let gap = crf.free_energy(&q) + exact.log_z;
//! assert!(gap > 0.0 && gap < 0.05, "{gap}");
//! ```

use garad_core::Label;

use crate::config::KernelConfig;
use crate::cues::Node;
use crate::error::CrfError;
use crate::kernel::{pairwise, potts};
use crate::sigmoid::sigmoid;

/// Nodes up to which all labellings are visited.
pub const MAX_ENUMERATED: usize = 20;

/// A field with all its potentials written out.
#[derive(Debug, Clone, PartialEq)]
pub struct SmallCrf {
    /// [ψ(static), ψ(dynamic)] of each node.
    potentials: Vec<[f64; 2]>,
    /// J, N x N row by row; symmetric, its diagonal is ignored.
    coupling: Vec<f64>,
}

/// What the enumeration of all labellings gives.
#[derive(Debug, Clone, PartialEq)]
pub struct Enumeration {
    /// The labelling of least energy; the first in binary counting order among equals.
    pub map: Vec<Label>,
    /// Its energy.
    pub map_energy: f64,
    /// Energy of the second best.
    pub second_energy: f64,
    /// ln Σ exp(-E).
    pub log_z: f64,
    /// Probability of each node being dynamic.
    pub dynamic: Vec<f64>,
}

impl SmallCrf {
    /// From log-odds u of being dynamic, ψ(static) = 0 and ψ(dynamic) = -u, and an N x N matrix J, row by row.
    ///
    /// # Errors
    /// [`CrfError::SizeMismatch`] if J is not N x N.
    pub fn from_log_odds(log_odds: &[f64], coupling: Vec<f64>) -> Result<Self, CrfError> {
        let expected = log_odds.len() * log_odds.len();
        if coupling.len() != expected {
            return Err(CrfError::SizeMismatch {
                what: "coupling",
                got: coupling.len(),
                expected,
            });
        }
        Ok(Self {
            potentials: log_odds.iter().map(|&u| [0.0, -u]).collect(),
            coupling,
        })
    }

    /// With the couplings of eq. 4 between `nodes`, not normalised.
    ///
    /// # Errors
    /// [`CrfError::SizeMismatch`] unless there is one number per node.
    pub fn from_nodes(
        nodes: &[Node],
        log_odds: &[f64],
        config: &KernelConfig,
    ) -> Result<Self, CrfError> {
        let differ = [Label::Static, Label::Dynamic];
        let row = |a| nodes.iter().map(move |b| pairwise(differ, [a, b], config));
        Self::from_log_odds(log_odds, nodes.iter().flat_map(row).collect())
    }

    /// Number of nodes.
    #[must_use]
    pub fn len(&self) -> usize {
        self.potentials.len()
    }

    /// Without any node?
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.potentials.is_empty()
    }

    fn j(&self, a: usize, b: usize) -> f64 {
        self.coupling[a * self.len() + b]
    }

    /// Eq. 1: E(X) = Σᵢ ψ_u(xᵢ) + Σ_{i<j} ψ_p(xᵢ, xⱼ), nat, for one label per node.
    #[must_use]
    pub fn energy(&self, x: &[Label]) -> f64 {
        let mut energy = 0.0;
        for i in 0..self.len() {
            energy += self.potentials[i][usize::from(x[i] == Label::Dynamic)];
            for j in i + 1..self.len() {
                energy += potts(x[i], x[j]) * self.j(i, j);
            }
        }
        energy
    }

    /// All 2^N labellings.
    ///
    /// # Errors
    /// [`CrfError::TooManyNodes`] above [`MAX_ENUMERATED`].
    pub fn enumerate(&self) -> Result<Enumeration, CrfError> {
        let n = self.len();
        if n > MAX_ENUMERATED {
            return Err(CrfError::TooManyNodes {
                got: n,
                limit: MAX_ENUMERATED,
            });
        }
        let labels_of = |code: usize| -> Vec<Label> {
            let label = |i| {
                if code >> i & 1 == 1 {
                    Label::Dynamic
                } else {
                    Label::Static
                }
            };
            (0..n).map(label).collect()
        };
        let energies: Vec<f64> = (0..1usize << n)
            .map(|code| self.energy(&labels_of(code)))
            .collect();
        let (mut best, mut second_energy) = (0, f64::INFINITY);
        for code in 1..energies.len() {
            if energies[code] < energies[best] {
                second_energy = energies[best];
                best = code;
            } else {
                second_energy = second_energy.min(energies[code]);
            }
        }
        // Relative to the best, so that nothing overflows.
        let map_energy = energies[best];
        let mut z = 0.0;
        let mut dynamic = vec![0.0; n];
        for (code, energy) in energies.iter().enumerate() {
            let weight = libm::exp(map_energy - energy);
            z += weight;
            for (i, q) in dynamic.iter_mut().enumerate() {
                if code >> i & 1 == 1 {
                    *q += weight;
                }
            }
        }
        Ok(Enumeration {
            map: labels_of(best),
            map_energy,
            second_energy,
            log_z: libm::log(z) - map_energy,
            dynamic: dynamic.into_iter().map(|q| q / z).collect(),
        })
    }

    /// F(q), nat. 0 ln 0 = 0.
    #[must_use]
    pub fn free_energy(&self, q: &[f64]) -> f64 {
        let n = self.len();
        let entropy = |p: f64| if p > 0.0 { p * libm::log(p) } else { 0.0 };
        let mut free = 0.0;
        for i in 0..n {
            let [psi_static, psi_dynamic] = self.potentials[i];
            free += q[i] * psi_dynamic + (1.0 - q[i]) * psi_static;
            free += entropy(q[i]) + entropy(1.0 - q[i]);
            for j in i + 1..n {
                free += self.j(i, j) * (q[i] * (1.0 - q[j]) + q[j] * (1.0 - q[i]));
            }
        }
        free
    }

    /// One sequential update of all q, each from the latest values of the others. Each is the
    /// minimum of F along its coordinate, so F never rises (parallel updates do not guarantee this).
    pub fn sweep(&self, q: &mut [f64]) {
        let n = self.len();
        for i in 0..n {
            let [psi_static, psi_dynamic] = self.potentials[i];
            let mut logit = psi_static - psi_dynamic;
            for j in (0..n).filter(|&j| j != i) {
                logit += self.j(i, j) * (2.0 * q[j] - 1.0);
            }
            q[i] = sigmoid(logit);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Label::{Dynamic, Static};

    fn pair(u: [f64; 2], j: f64) -> SmallCrf {
        SmallCrf::from_log_odds(&u, vec![0.0, j, j, 0.0]).expect("2 x 2")
    }

    #[test]
    fn two_nodes_by_hand() {
        let crf = pair([3.0, -1.0], 0.5);
        let cases = [
            ([Static, Static], 0.0),
            ([Dynamic, Static], -2.5),
            ([Static, Dynamic], 1.5),
            ([Dynamic, Dynamic], -2.0),
        ];
        for (labels, energy) in cases {
            assert!((crf.energy(&labels) - energy).abs() < 1e-15, "{labels:?}");
        }
        let all = crf.enumerate().expect("two nodes");
        assert_eq!(all.map, [Dynamic, Static], "least energy");
        for (got, want) in [(all.map_energy, -2.5), (all.second_energy, -2.0)] {
            assert!((got - want).abs() < 1e-15, "{got} instead of {want}");
        }
        let weights: Vec<f64> = cases.iter().map(|(_, e)| libm::exp(-e)).collect();
        let z: f64 = weights.iter().sum();
        assert!((all.log_z - libm::log(z)).abs() < 1e-14, "ln Z");
        assert!(
            (all.dynamic[0] - (weights[1] + weights[3]) / z).abs() < 1e-15,
            "marginal"
        );
    }

    #[test]
    fn without_coupling_mean_field_is_exact() {
        let crf = pair([3.0, -1.0], 0.0);
        let mut q = vec![0.5, 0.5];
        crf.sweep(&mut q);
        let all = crf.enumerate().expect("two nodes");
        assert!((q[0] - all.dynamic[0]).abs() < 1e-15, "first");
        assert!((crf.free_energy(&q) + all.log_z).abs() < 1e-14, "F = -ln Z");
    }

    #[test]
    fn certain_labels_have_no_entropy() {
        let crf = pair([3.0, -1.0], 0.5);
        assert!((crf.free_energy(&[1.0, 0.0]) + 2.5).abs() < 1e-15, "F = E");
    }

    #[test]
    fn sizes_are_checked() {
        assert!(
            matches!(
                SmallCrf::from_log_odds(&[0.0; 3], vec![0.0; 8]),
                Err(CrfError::SizeMismatch { expected: 9, .. })
            ),
            "J"
        );
        let large = SmallCrf::from_log_odds(&[0.0; 21], vec![0.0; 441]).expect("21 x 21");
        assert!(
            matches!(
                large.enumerate(),
                Err(CrfError::TooManyNodes { got: 21, .. })
            ),
            "2^21"
        );
        let empty = SmallCrf::from_log_odds(&[], vec![])
            .expect("0 x 0")
            .enumerate()
            .expect("one labelling");
        assert!(empty.map.is_empty() && empty.log_z == 0.0, "{empty:?}");
    }
}
