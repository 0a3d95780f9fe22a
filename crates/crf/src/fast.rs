//! Kernel sums for thousands of nodes: the numbers of [`crate::reference`], faster.
//!
//! | kernel | structure | how |
//! |---|---|---|
//! | feature, eq. 5 | two numbers, one of them an integer | [`features`]: through a grid of Chebyshev points, O(N) |
//! | position, eq. 6 | five numbers, short range | [`blocks`] of 16 x 16 pairs, those known to be small left out |
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
use crate::reference::{Kernel, KernelSums, Reference};
use blocks::PositionSums;
use features::Grid;

/// Both kernels, prepared once per run.
pub(crate) struct Fast<'a> {
    /// The feature kernel, unless the nodes are too scattered for a grid.
    grid: Option<Grid>,
    pairs: Reference<'a>,
    positions: PositionSums,
}

impl<'a> Fast<'a> {
    /// A kernel of weight 0 gets no nodes, as its sums are not needed. `tail`: pairs whose position
    /// kernel is known to be below it may be left out.
    pub(crate) fn new(
        nodes: &'a [Node],
        kernels: &'a KernelConfig,
        config: &MeanFieldConfig,
        tail: f64,
        par: Par,
    ) -> Self {
        let needed = |weight: f64| if weight > 0.0 { nodes } else { &[] };
        let alike = needed(kernels.feature_weight);
        let near = needed(kernels.position_weight);
        Self {
            grid: Grid::new(alike, kernels, config.self_message),
            pairs: Reference::new(nodes, kernels, config),
            positions: PositionSums::new(near, kernels, config.self_message, tail, par),
        }
    }
}

impl KernelSums for Fast<'_> {
    fn sums(&self, kernel: Kernel, s: &[f64], par: Par) -> Vec<f64> {
        match (kernel, &self.grid) {
            (Kernel::Feature, Some(grid)) => grid.sums(s),
            (Kernel::Feature, None) => self.pairs.sums(kernel, s, par),
            (Kernel::Position, _) => self.positions.sums(s, par),
        }
    }

    fn left_out(&self, kernel: Kernel) -> Vec<f64> {
        match (kernel, &self.grid) {
            (Kernel::Feature, Some(grid)) => grid.left_out(),
            (Kernel::Feature, None) => self.pairs.left_out(kernel),
            (Kernel::Position, _) => self.positions.left_out().to_vec(),
        }
    }
}
