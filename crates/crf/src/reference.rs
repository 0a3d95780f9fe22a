//! Kernel sums as they are written: every pair, in index order.

use garad_core::Par;

use crate::config::{KernelConfig, MeanFieldConfig};
use crate::cues::Node;
use crate::kernel;
use crate::mean_field::{Kernel, KernelSums};

/// The readable sums: N² kernel values per call, in f64.
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
