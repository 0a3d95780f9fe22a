//! Kernel sums for thousands of nodes: the same numbers as [`crate::reference`], sooner.
//!
//! | kernel | structure | how |
//! |---|---|---|
//! | feature, eq. 5 | two numbers, one of them an integer | [`features`]: through a grid of Chebyshev points, O(N) |
//! | position, eq. 6 | five numbers, short range | [`blocks`] of 16 x 16 pairs, those that are surely small left out |
//!
//! Reading order: [`exp`] → [`tree`] (which nodes form a block) → [`blocks`] → [`features`].
//! All in f64, multiplications, additions and comparisons in an order that is fixed: the same bits
//! on every machine and for every number of threads.

pub(crate) mod blocks;
pub(crate) mod exp;
pub(crate) mod features;
pub(crate) mod tree;

use garad_core::Par;

use crate::config::{KernelConfig, MeanFieldConfig};
use crate::cues::Node;
use crate::mean_field::{Kernel, KernelSums};
use blocks::PositionSums;
use features::FeatureSums;

/// Both kernels, prepared once per run.
pub(crate) struct Fast {
    features: FeatureSums,
    positions: PositionSums,
}

impl Fast {
    /// A kernel of weight 0 is given no nodes, as nobody asks for its sums. `tail`: pairs whose position kernel is surely below it may be left out.
    pub(crate) fn new(
        nodes: &[Node],
        kernels: &KernelConfig,
        config: &MeanFieldConfig,
        tail: f64,
        par: Par,
    ) -> Self {
        let needed = |weight: f64| if weight > 0.0 { nodes } else { &[] };
        let (alike, near) = (
            needed(kernels.feature_weight),
            needed(kernels.position_weight),
        );
        Self {
            features: FeatureSums::new(alike, kernels, config.self_message),
            positions: PositionSums::new(near, kernels, config.self_message, tail, par),
        }
    }
}

impl KernelSums for Fast {
    fn sums(&self, kernel: Kernel, s: &[f64], par: Par) -> Vec<f64> {
        match kernel {
            Kernel::Feature => self.features.sums(s, par),
            Kernel::Position => self.positions.sums(s, par),
        }
    }

    fn left_out(&self, kernel: Kernel) -> Vec<f64> {
        match kernel {
            Kernel::Feature => self.features.left_out(),
            Kernel::Position => self.positions.left_out().to_vec(),
        }
    }
}
