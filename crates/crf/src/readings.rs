//! The readings: where the paper, its source LC-CRF-SLAM (Du et al. 2020) and this crate differ.
//!
//! The paper leaves most of these open, and some of its equations cannot be meant as they are printed. Each
//! reading is one variant here, so that the choices of another implementation can be reproduced.
//! [`crate::CrfConfig::as_printed`] and [`crate::CrfConfig::lc_crf`] select those of the two papers.

use serde::{Deserialize, Serialize};

/// Eq. 2: on which side of its mean a cue's value is evidence against being static.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// Larger values: errors and distances.
    Above,
    /// Smaller values: the number of observations.
    Below,
    /// Both: eq. 2 to the letter. Under it a perfect reprojection (0 px) has the likelihood 0.018,
    /// against the paper's own assumption that dynamic points have the larger errors.
    Both,
}

/// Eq. 2: the value of a likelihood at its peak.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Height {
    /// 1, whatever the unit: exp(-(x - μ)² / 2σ²).
    Unit,
    /// 1 / (σ √2π): a density, eq. 2 to the letter. Its peak depends on the unit of the cue (0.66
    /// for a σ of 0.6 px, 2.0 for 0.2 px) and can exceed 1.
    Density,
}

/// Eq. 2: how the likelihoods of a node's cues are combined.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pooling {
    /// Their weighted mean, eq. 2. One good cue among k keeps P at 1/k at least, however bad the
    /// others are: with three cues the log-odds of being dynamic cannot exceed ln 2.
    Mean,
    /// Their weighted geometric mean, Π Nₖ^πₖ: each bad cue counts. Not in the paper.
    Geometric,
}

/// Eq. 3: from the combined likelihood of a node to its P(static).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Decision {
    /// P is the combined likelihood.
    Soft,
    /// A label first: static if the score reaches the threshold; P is then the confidence in it.
    Hard {
        /// What is compared with the threshold.
        score: Score,
        /// Threshold of nodes without an epipolar distance.
        threshold: f64,
        /// Threshold of nodes with one.
        threshold_with_epipolar: f64,
        /// P(label) of the decided label, in (1/2, 1).
        confidence: f64,
    },
}

/// The score of a hard decision.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Score {
    /// The combined likelihood (the LC-CRF paper: their mean; 0.8).
    Mean,
    /// Weighted sum of the likelihoods (its code; 0.8, or 1.0 with an epipolar distance).
    Sum,
}

/// The belief of a node with too few observations ([`crate::UnaryConfig::min_observations`]).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ThinEvidence {
    /// Its previous belief if it has one, else what inference gives.
    KeepPrevious,
    /// What inference gives: its neighbours alone decide.
    Neighbours,
}

/// Eq. 6: how distances enter the position kernel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Distance {
    /// exp(-d² / 2σ²), as in eq. 5 and every Gaussian kernel.
    Squared,
    /// exp(-d / 2σ²), eq. 6 as printed. With σ = 18 px it is exp(-d / 648 px): nearly constant over an image
    /// of 640 columns, so that all nodes end up with one label.
    Linear,
}

/// Eq. 6: which distances enter the position kernel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PositionTerms {
    /// Metres and pixels. A pair of which one has no pixel is compared in metres alone.
    Both,
    /// Metres.
    Space,
    /// Pixels (LC-CRF's code). Nodes without a pixel have no neighbours.
    Pixel,
}

/// Eq. 4: divisor of the sum of one kernel over the neighbours j of node i; rᵢ = Σⱼ kᵢⱼ.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Normalisation {
    /// 1: eq. 4 to the letter; messages grow with the density of nodes.
    None,
    /// rᵢ: the mean over the neighbours (LC-CRF).
    Rows,
    /// √(rᵢ rⱼ): as Rows, but the coupling stays symmetric, so that an energy exists.
    Symmetric,
}

/// Eq. 7: the retention score S and when a Gaussian is removed ([`crate::window`]).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum WindowReading {
    /// S is the share of static runs among the last n.
    #[default]
    StaticShare,
    /// S as printed, over the last n + 1 runs.
    Literal,
}
