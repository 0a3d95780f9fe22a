//! [`KernelSums`], all that mean field needs of a kernel, and [`Reference`]: the sums as they are written,
//! over every pair in index order.

use garad_core::Par;

use crate::config::{KernelConfig, MeanFieldConfig};
use crate::cues::Node;
use crate::kernel;

/// One of the two kernels of eq. 4.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kernel {
    /// Eq. 5.
    Feature,
    /// Eq. 6.
    Position,
}

/// Sums of the kernels over all pairs.
pub(crate) trait KernelSums {
    /// Σⱼ k(i, j) sⱼ for each i; j = i takes part if the configuration says so.
    fn sums(&self, kernel: Kernel, s: &[f64], par: Par) -> Vec<f64>;

    /// For each i, a bound on the error of [`KernelSums::sums`] where |sⱼ| ≤ 1, rounding aside.
    fn left_out(&self, kernel: Kernel) -> Vec<f64>;
}

/// N² kernel values per call, in f64.
pub(crate) struct Reference<'a> {
    nodes: &'a [Node],
    kernels: &'a KernelConfig,
    self_message: bool,
}

impl<'a> Reference<'a> {
    pub(crate) fn new(
        nodes: &'a [Node],
        kernels: &'a KernelConfig,
        config: &MeanFieldConfig,
    ) -> Self {
        Self {
            nodes,
            kernels,
            self_message: config.self_message,
        }
    }
}

impl KernelSums for Reference<'_> {
    fn sums(&self, kernel: Kernel, s: &[f64], par: Par) -> Vec<f64> {
        let k = match kernel {
            Kernel::Feature => kernel::feature,
            Kernel::Position => kernel::position,
        };
        let nodes = self.nodes;
        par.map(nodes.len(), |i| {
            let mut sum = 0.0;
            for j in 0..nodes.len() {
                if j != i || self.self_message {
                    sum += k(&nodes[i], &nodes[j], self.kernels) * s[j];
                }
            }
            sum
        })
    }

    fn left_out(&self, _: Kernel) -> Vec<f64> {
        vec![0.0; self.nodes.len()]
    }
}
