//! Which Gaussians move: cues, unary terms and a dense conditional random field by mean field.
//!
//! Gaussians on a person who walks through the room have large reprojection errors, jump in depth, are seen
//! by few keyframes and leave their epipolar lines; some on a wall do so too. Their positions and the
//! similarity of their features separate the two. The paper's eq. 1 gives every labelling an energy,
//!
//! E(X) = Σᵢ ψ_u(xᵢ) + Σ_{i<j} ψ_p(xᵢ, xⱼ)
//!
//! the first sum over each node's own cues, the second over all pairs with different labels. The minimum
//! over 2^N labellings is out of reach; mean field approximates how likely each node is to be dynamic.
//!
//! | eq. | function |
//! |---|---|
//! | 1, energy | [`SmallCrf::energy`] |
//! | 2, P(static) | [`unary::mixture_likelihood`] |
//! | 3, unary potential | [`unary::potentials`] |
//! | 4, pairwise potential | [`kernel::pairwise`] |
//! | 5, 6, kernels | [`kernel::feature`], [`kernel::position`] |
//! | 7, retention | [`LabelWindow::score`] |
//!
//! Reading order: [`cues`] (the input of a node) → [`unary`] → [`kernel`] → `mean_field` (the iteration),
//! `error_bound` (the effect of approximate sums) → `reference` (sums over pairs as written) and `fast` →
//! [`enumeration`] (the exact distribution of small fields) → [`window`]. [`config`] and [`readings`] name
//! every choice. Derivations: docs/math_crf.md, C1 to C6.
//!
//! # Example
//! Three Gaussians side by side, the middle one without any evidence, and one far away:
//! ```
//! use garad_core::{Label, Par};
//! use garad_crf::{Crf, CrfConfig, Cues, Node};
//! use nalgebra::{Vector2, Vector3};
//!
//! let node = |x: f64, reproj_px| Node {
//!     p_world: Vector3::new(x, 0.0, 2.0),
//!     uv_px: Some(Vector2::new(320.0 + 250.0 * x, 240.0)),
//!     cues: Cues { reproj_px, ..Cues::default() },
//!     previous: None,
//! };
//! let nodes = [node(0.0, Some(6.0)), node(0.02, None), node(0.04, Some(6.0)), node(1.0, Some(0.5))];
//! let beliefs = Crf::new(CrfConfig::default())?.infer(&nodes, Par::Seq)?;
//! assert_eq!(beliefs.labels, [Label::Dynamic, Label::Dynamic, Label::Dynamic, Label::Static]);
//! assert!(beliefs.dynamic[1] > 0.9); // no cue of its own: from its neighbours
//! # Ok::<(), garad_crf::CrfError>(())
//! ```

pub mod config;
pub mod cues;
pub mod enumeration;
pub mod error;
mod error_bound;
mod fast;
pub mod kernel;
mod mean_field;
mod normalised;
pub mod readings;
mod reference;
mod sigmoid;
pub mod unary;
pub mod window;

pub use config::{CrfConfig, CueModel, KernelConfig, MeanFieldConfig, Method, UnaryConfig};
pub use cues::{Cues, DepthNoise, Node};
pub use enumeration::SmallCrf;
pub use error::CrfError;
pub use readings::{
    Decision, Distance, Height, Normalisation, Pooling, PositionTerms, Score, Side, ThinEvidence,
    WindowReading,
};
pub use window::{LabelWindow, LabelWindowConfig};

use garad_core::{Label, Par};

use fast::Fast;
use mean_field::Solution;
use reference::Reference;

/// A field with its settings, ready for any number of nodes.
#[derive(Debug, Clone, PartialEq)]
pub struct Crf {
    config: CrfConfig,
}

/// The result of inference.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Beliefs {
    /// Probability of being dynamic, in [0, 1], one per node.
    pub dynamic: Vec<f64>,
    /// Dynamic where the belief is above the threshold.
    pub labels: Vec<Label>,
    /// Largest change of a belief in the last iteration: small if the iteration has converged.
    pub last_change: f64,
    /// No belief is further than this from the same iterations in exact arithmetic with
    /// every pair, so a label is certain where |dynamic - threshold| is larger. It grows with
    /// weights and iterations where nodes are undecided; 1 if there is no better bound.
    pub error_bound: f64,
}

impl Crf {
    /// # Errors
    /// [`CrfError::BadSetting`] with the first setting outside its range.
    pub fn new(config: CrfConfig) -> Result<Self, CrfError> {
        config.validate()?;
        Ok(Self { config })
    }

    /// Its settings.
    #[must_use]
    pub fn config(&self) -> &CrfConfig {
        &self.config
    }

    /// Labels from cues: unary terms (C1), then mean field (C2).
    ///
    /// # Shapes and units
    /// See [`Node`]; one belief per node, in the order of `nodes`. No nodes give no beliefs.
    /// # Numerics
    /// f64; the same bits for every `par` and on every machine. [`Method::Fast`] needs 8 bytes per
    /// pair of nodes within reach of the position kernel, at most 512 MiB.
    /// # Errors
    /// [`CrfError::BadNode`] with the first number that is not finite or outside its range.
    pub fn infer(&self, nodes: &[Node], par: Par) -> Result<Beliefs, CrfError> {
        let unary = &self.config.unary;
        let log_odds: Vec<f64> = nodes
            .iter()
            .map(|node| unary::log_odds(&node.cues, unary))
            .collect();
        let mut beliefs = self.infer_from_log_odds(nodes, &log_odds, par)?;
        if unary.thin == ThinEvidence::KeepPrevious {
            for (i, node) in nodes.iter().enumerate() {
                if let Some(previous) = node.previous.filter(|_| unary::is_thin(&node.cues, unary))
                {
                    beliefs.dynamic[i] = previous;
                    beliefs.labels[i] = self.label(previous);
                }
            }
        }
        Ok(beliefs)
    }

    /// As [`Crf::infer`], with the unary terms given: `log_odds[i]` = ψᵢ(static) - ψᵢ(dynamic).
    /// `Node::cues` enter the feature kernel alone; `Node::previous` is not used.
    ///
    /// # Errors
    /// As [`Crf::infer`]; [`CrfError::SizeMismatch`] unless there is one number per node.
    pub fn infer_from_log_odds(
        &self,
        nodes: &[Node],
        log_odds: &[f64],
        par: Par,
    ) -> Result<Beliefs, CrfError> {
        if log_odds.len() != nodes.len() {
            return Err(CrfError::SizeMismatch {
                what: "log_odds",
                got: log_odds.len(),
                expected: nodes.len(),
            });
        }
        for (i, (node, &u)) in nodes.iter().zip(log_odds).enumerate() {
            node.validate(i)?;
            if !u.is_finite() {
                return Err(CrfError::BadNode {
                    node: i,
                    what: "log_odds",
                    value: u,
                    expected: "a finite number",
                });
            }
        }
        let (kernels, config) = (&self.config.kernels, &self.config.mean_field);
        let Solution {
            dynamic,
            last_change,
            error_bound,
        } = match config.method {
            Method::Reference => {
                let sums = Reference::new(nodes, kernels, config);
                mean_field::solve(log_odds, &sums, kernels, config, par)
            }
            Method::Fast { tail } => {
                let sums = Fast::new(nodes, kernels, config, tail, par);
                mean_field::solve(log_odds, &sums, kernels, config, par)
            }
        };
        Ok(Beliefs {
            labels: dynamic.iter().map(|&q| self.label(q)).collect(),
            dynamic,
            last_change,
            error_bound,
        })
    }

    fn label(&self, dynamic: f64) -> Label {
        if dynamic > self.config.threshold {
            Label::Dynamic
        } else {
            Label::Static
        }
    }
}
