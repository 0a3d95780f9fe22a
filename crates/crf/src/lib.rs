//! Which Gaussians move: cues, unary terms and a dense conditional random field by mean field.
//!
//! A person walks through the room. Each Gaussian on them reprojects badly, jumps in depth, is seen
//! by few keyframes and leaves its epipolar lines; but so does, now and then, one on the wall. Where
//! they lie and how alike they are settles the matter: the paper's eq. 1 gives every labelling an energy,
//!
//! E(X) = Σᵢ ψᵢ(xᵢ) + Σ_{i<j} [xᵢ ≠ xⱼ] Σₘ ω^m k^m(i, j)
//!
//! the first sum for what a node's own cues say, the second for every pair of labels that differ
//! although the nodes are alike. The best of 2^N labellings is out of reach; mean field finds, in ten
//! rounds of asking the neighbours, how likely each node is to move.
//!
//! Reading order: [`cues`] (what a node brings) → [`unary`] (eq. 2, 3) → [`kernel`] (eq. 4 to 6) →
//! `mean_field` (the iteration, and how far an approximate sum leads it astray) → `reference` (sums
//! over pairs as written) and `fast` (the same, sooner) → [`small`] (energies and all labellings, to
//! judge the approximation) → [`window`] (eq. 7). [`config`] names every choice. Derivations:
//! docs/math_crf.md, C1 to C6.
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
//! assert!(beliefs.dynamic[1] > 0.9); // nothing of its own, but what its neighbours say
//! # Ok::<(), garad_crf::CrfError>(())
//! ```

pub mod config;
pub mod cues;
pub mod error;
mod fast;
pub mod kernel;
mod mean_field;
mod reference;
pub mod small;
pub mod unary;
pub mod window;

pub use config::{
    CrfConfig, CueModel, Decision, Distance, Height, KernelConfig, MeanFieldConfig, Method,
    Normalisation, Pooling, PositionTerms, Score, Side, ThinEvidence, UnaryConfig,
};
pub use cues::{Cues, DepthNoise, Node};
pub use error::CrfError;
pub use small::SmallCrf;
pub use window::{LabelWindow, LabelWindowConfig, WindowReading};

use garad_core::{Label, Par};

use fast::Fast;
use mean_field::Solution;
use reference::Reference;

/// A field with its settings, ready for any number of nodes.
#[derive(Debug, Clone, PartialEq)]
pub struct Crf {
    config: CrfConfig,
}

/// What the field believes of each node.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Beliefs {
    /// Probability of being dynamic, in [0, 1], one per node.
    pub dynamic: Vec<f64>,
    /// Dynamic where the belief is above the threshold.
    pub labels: Vec<Label>,
    /// Largest change of a belief in the last iteration: small if the field has settled.
    pub last_change: f64,
    /// No belief is further than this from what the same iterations give in exact arithmetic with
    /// every pair. So a label is beyond doubt where |dynamic - threshold| is larger. It grows with
    /// weights and iterations where nodes are undecided; 1 if nothing can be promised.
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
    /// `Node::cues` enter the feature kernel alone; `Node::previous` is not looked at.
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
