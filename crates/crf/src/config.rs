//! [`CrfConfig`]: every choice that changes an answer, with its reason.
//!
//! The paper leaves most of these open. Each reading has a name here, so that whatever another
//! implementation chose can be reproduced. The numbers come from LC-CRF-SLAM (Du et al. 2020),
//! whose field the paper's follows; [`CrfConfig::lc_crf`] is that system's own setting.

use serde::{Deserialize, Serialize};

use crate::error::{CrfError, setting};

/// The whole configuration.
///
/// # Example
/// ```
/// use garad_crf::{Crf, CrfConfig};
/// let mut config = CrfConfig::default();
/// config.mean_field.iterations = 5;
/// assert!(Crf::new(config.clone()).is_ok());
/// config.kernels.sigma_m = -0.5;
/// let error = Crf::new(config).unwrap_err();
/// assert_eq!(error.to_string(), "kernels.sigma_m is -0.5; expected a number above 0");
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CrfConfig {
    /// What a node's own cues say (eq. 2, 3).
    pub unary: UnaryConfig,
    /// How alike two nodes are (eq. 4 to 6).
    pub kernels: KernelConfig,
    /// How the field is solved.
    pub mean_field: MeanFieldConfig,
    /// A node is dynamic if its belief is above this.
    pub threshold: f64,
}

impl Default for CrfConfig {
    fn default() -> Self {
        Self {
            unary: UnaryConfig::default(),
            kernels: KernelConfig::default(),
            mean_field: MeanFieldConfig::default(),
            threshold: 0.5,
        }
    }
}

/// From cues to the probability of being static.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct UnaryConfig {
    /// Mean reprojection error, px.
    pub reprojection: CueModel,
    /// Mean depth residual, in standard deviations of the sensor ([`crate::DepthNoise`]).
    pub depth: CueModel,
    /// Number of observing keyframes.
    pub observations: CueModel,
    /// Mean symmetric epipolar distance, px.
    pub epipolar: CueModel,
    /// How high a likelihood is at its peak.
    pub height: Height,
    /// How the likelihoods of a node become one.
    pub pooling: Pooling,
    /// From likelihoods to a unary term.
    pub decision: Decision,
    /// P is kept within [clamp, 1 - clamp]: no cue is ever certain. 1e-3 limits |ln(P / (1 - P))|
    /// to 6.9, which a handful of neighbours can still outvote.
    pub clamp: f64,
    /// Nodes with a known number of observations below this have no say of their own: P = 1/2.
    pub min_observations: u32,
    /// The belief of such a node after inference.
    pub thin: ThinEvidence,
}

impl Default for UnaryConfig {
    fn default() -> Self {
        Self {
            reprojection: CueModel::new(1.7, 0.6, Side::Above),
            // The mean of |r| / σ is 0.8 for noise alone.
            depth: CueModel::new(1.0, 1.0, Side::Above),
            observations: CueModel::new(5.4, 1.5, Side::Below),
            epipolar: CueModel::new(0.3, 0.2, Side::Above),
            height: Height::Unit,
            pooling: Pooling::Mean,
            decision: Decision::Soft,
            clamp: 1e-3,
            min_observations: 2,
            thin: ThinEvidence::KeepPrevious,
        }
    }
}

/// One Gaussian of eq. 2: what a cue looks like on static things.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CueModel {
    /// μ, in the cue's unit.
    pub mean: f64,
    /// σ, in the cue's unit.
    pub sigma: f64,
    /// On which side of μ a value speaks against being static.
    pub side: Side,
    /// π, its share; the shares of the cues a node has are scaled to sum to 1. 0 ignores the cue.
    pub weight: f64,
}

impl CueModel {
    /// With weight 1.
    #[must_use]
    pub const fn new(mean: f64, sigma: f64, side: Side) -> Self {
        Self {
            mean,
            sigma,
            side,
            weight: 1.0,
        }
    }
}

/// On which side of the mean a value speaks against being static.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Side {
    /// Larger values do: errors and distances.
    Above,
    /// Smaller values do: the number of observations.
    Below,
    /// Both do: eq. 2 to the letter. Under it a perfect reprojection (0 px) scores 0.018, against
    /// the paper's own assumption that dynamic points have the larger errors.
    Both,
}

/// Height of a likelihood at its peak.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Height {
    /// 1, whatever the unit: exp(-(x - μ)² / 2σ²).
    Unit,
    /// 1 / (σ √2π): a density, eq. 2 to the letter. Its peak depends on the unit of the cue (0.66
    /// for a σ of 0.6 px, 2.0 for 0.2 px) and can exceed 1.
    Density,
}

/// How the likelihoods of a node's cues become one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Pooling {
    /// Their weighted mean, eq. 2. One good cue among k keeps P at 1/k at least, however bad the
    /// others are: with three cues no node can say more for being dynamic than ln 2.
    Mean,
    /// Their weighted geometric mean, Π Nₖ^πₖ: each bad cue counts. Not in the paper.
    Geometric,
}

/// From the likelihoods of a node's cues to its unary term.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Decision {
    /// P is what pooling makes of them.
    Soft,
    /// A label first: static if the score reaches the threshold; P is then the confidence in it.
    Hard {
        /// What is compared with the threshold.
        score: Score,
        /// Threshold of nodes without an epipolar distance.
        threshold: f64,
        /// Threshold of nodes with one.
        threshold_with_epipolar: f64,
        /// P(label) for the label that was decided, in (1/2, 1).
        confidence: f64,
    },
}

/// What a hard decision looks at.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Score {
    /// The pooled likelihood (the LC-CRF paper: their mean; 0.8).
    Mean,
    /// Weighted sum of the likelihoods (its code; 0.8, or 1.0 with an epipolar distance).
    Sum,
}

/// What becomes of a node that was seen too rarely to have a say.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ThinEvidence {
    /// It keeps its previous belief if it has one; its neighbours decide otherwise.
    KeepPrevious,
    /// Its neighbours decide.
    Neighbours,
}

/// Weights and widths of the two kernels.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KernelConfig {
    /// ω¹ of the feature kernel. With row-normalised kernels, the most it can add to a log-odds.
    ///
    /// With 1 and 3 the beliefs are all but settled after ten iterations. LC-CRF's 10 and 30, over its
    /// hard labels, are still moving after its five, so that a label depends on when one stops.
    pub feature_weight: f64,
    /// σ_α of eq. 5, px of reprojection error.
    pub sigma_reproj_px: f64,
    /// σ_γ of eq. 5, observations.
    pub sigma_observations: f64,
    /// ω² of the position kernel.
    pub position_weight: f64,
    /// σ_P of eq. 6, metres.
    pub sigma_m: f64,
    /// σ_p of eq. 6, px.
    pub sigma_px: f64,
    /// Distances of eq. 6, squared or as printed.
    pub distance: Distance,
    /// Which of the two distances of eq. 6 enter.
    pub terms: PositionTerms,
}

impl Default for KernelConfig {
    fn default() -> Self {
        Self {
            feature_weight: 1.0,
            sigma_reproj_px: 0.6,
            sigma_observations: 1.5,
            position_weight: 3.0,
            sigma_m: 0.5,
            sigma_px: 18.0,
            distance: Distance::Squared,
            terms: PositionTerms::Both,
        }
    }
}

/// How distances enter the position kernel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Distance {
    /// exp(-d² / 2σ²), as eq. 5 and every Gaussian kernel.
    Squared,
    /// exp(-d / 2σ²), eq. 6 as printed. With σ = 18 px it is exp(-d / 648 px): flat over a picture
    /// of 640 columns, so that everything ends up with one label.
    Linear,
}

/// Which distances enter the position kernel.
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

/// The iteration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MeanFieldConfig {
    /// Number of parallel updates, always all of them.
    pub iterations: usize,
    /// What a kernel's sum over the neighbours is divided by.
    pub normalisation: Normalisation,
    /// Whether j = i takes part. LC-CRF includes it. Under [`Normalisation::Rows`] it is what keeps
    /// a lonely node from following a neighbour far away: without it that neighbour's kernel, however
    /// small, is divided by itself.
    pub self_message: bool,
    /// Share of the old belief that stays in the new one, in [0, 1).
    pub damping: f64,
    /// How the sums are computed.
    pub method: Method,
}

impl Default for MeanFieldConfig {
    fn default() -> Self {
        Self {
            iterations: 10,
            normalisation: Normalisation::Rows,
            self_message: true,
            damping: 0.0,
            method: Method::Fast { tail: 1e-12 },
        }
    }
}

/// Divisor of the sum of one kernel over the neighbours j of node i; rᵢ = Σⱼ kᵢⱼ.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Normalisation {
    /// 1: eq. 4 to the letter; a node in a crowd hears louder voices than one alone.
    None,
    /// rᵢ: the mean over the neighbours (LC-CRF).
    Rows,
    /// √(rᵢ rⱼ): as Rows, but the coupling stays symmetric, so that an energy exists.
    Symmetric,
}

/// How kernel sums are computed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Method {
    /// Every pair, one after the other: the text to read, for up to a few thousand nodes.
    Reference,
    /// Vectorised, with pairs left out whose position kernel is surely below `tail`.
    /// [`crate::Beliefs::error_bound`] says what that may have changed. 0 leaves nothing out.
    Fast {
        /// In [0, 1).
        tail: f64,
    },
}

impl CrfConfig {
    /// What the code of LC-CRF-SLAM does, as far as eq. 2 to 6 can express it: two-sided
    /// likelihoods of which the sum decides, a confidence of 0.7, pixels alone in the position
    /// kernel, weights 10 and 30, five iterations.
    ///
    /// Its depth cue is the mean depth itself, 2.75 ± 0.5 m: give that number as
    /// [`crate::Cues::depth_residual`].
    #[must_use]
    pub fn lc_crf() -> Self {
        Self {
            unary: UnaryConfig {
                reprojection: CueModel::new(1.7, 0.6, Side::Both),
                depth: CueModel::new(2.75, 0.5, Side::Both),
                observations: CueModel::new(5.4, 1.5, Side::Both),
                epipolar: CueModel::new(0.3, 0.2, Side::Both),
                decision: Decision::Hard {
                    score: Score::Sum,
                    threshold: 0.8,
                    threshold_with_epipolar: 1.0,
                    confidence: 0.7,
                },
                min_observations: 0,
                ..UnaryConfig::default()
            },
            kernels: KernelConfig {
                feature_weight: 10.0,
                position_weight: 30.0,
                terms: PositionTerms::Pixel,
                ..KernelConfig::default()
            },
            mean_field: MeanFieldConfig {
                iterations: 5,
                ..MeanFieldConfig::default()
            },
            ..Self::default()
        }
    }

    /// # Errors
    /// [`CrfError::BadSetting`] with the first setting outside its range.
    pub fn validate(&self) -> Result<(), CrfError> {
        const POSITIVE: &str = "a number above 0";
        const NOT_NEGATIVE: &str = "a number of at least 0";
        const INSIDE: &str = "a number strictly between 0 and 1";
        let positive = |v: f64| v > 0.0 && v.is_finite();
        let not_negative = |v: f64| v >= 0.0 && v.is_finite();
        let inside = |v: f64| v > 0.0 && v < 1.0;

        let u = &self.unary;
        for (mean, sigma, weight, cue) in [
            (
                "unary.reprojection.mean",
                "unary.reprojection.sigma",
                "unary.reprojection.weight",
                &u.reprojection,
            ),
            (
                "unary.depth.mean",
                "unary.depth.sigma",
                "unary.depth.weight",
                &u.depth,
            ),
            (
                "unary.observations.mean",
                "unary.observations.sigma",
                "unary.observations.weight",
                &u.observations,
            ),
            (
                "unary.epipolar.mean",
                "unary.epipolar.sigma",
                "unary.epipolar.weight",
                &u.epipolar,
            ),
        ] {
            setting(mean, cue.mean, "a finite number", cue.mean.is_finite())?;
            setting(sigma, cue.sigma, POSITIVE, positive(cue.sigma))?;
            setting(weight, cue.weight, NOT_NEGATIVE, not_negative(cue.weight))?;
        }
        setting(
            "unary.clamp",
            u.clamp,
            "a number above 0 and below 1/2",
            u.clamp > 0.0 && u.clamp < 0.5,
        )?;
        if let Decision::Hard {
            threshold,
            threshold_with_epipolar,
            confidence,
            ..
        } = u.decision
        {
            setting(
                "unary.decision.threshold",
                threshold,
                POSITIVE,
                positive(threshold),
            )?;
            setting(
                "unary.decision.threshold_with_epipolar",
                threshold_with_epipolar,
                POSITIVE,
                positive(threshold_with_epipolar),
            )?;
            let expected = "a number above 1/2 and below 1";
            setting(
                "unary.decision.confidence",
                confidence,
                expected,
                confidence > 0.5 && confidence < 1.0,
            )?;
        }
        let k = &self.kernels;
        setting(
            "kernels.feature_weight",
            k.feature_weight,
            NOT_NEGATIVE,
            not_negative(k.feature_weight),
        )?;
        setting(
            "kernels.position_weight",
            k.position_weight,
            NOT_NEGATIVE,
            not_negative(k.position_weight),
        )?;
        for (name, sigma) in [
            ("kernels.sigma_reproj_px", k.sigma_reproj_px),
            ("kernels.sigma_observations", k.sigma_observations),
            ("kernels.sigma_m", k.sigma_m),
            ("kernels.sigma_px", k.sigma_px),
        ] {
            setting(name, sigma, POSITIVE, positive(sigma))?;
        }
        let m = &self.mean_field;
        let expected = "a number of at least 0 and below 1";
        setting(
            "mean_field.damping",
            m.damping,
            expected,
            m.damping >= 0.0 && m.damping < 1.0,
        )?;
        if let Method::Fast { tail } = m.method {
            setting(
                "mean_field.method.tail",
                tail,
                expected,
                (0.0..1.0).contains(&tail),
            )?;
        }
        setting("threshold", self.threshold, INSIDE, inside(self.threshold))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_and_presets_are_valid() {
        assert_eq!(CrfConfig::default().validate(), Ok(()), "default");
        assert_eq!(CrfConfig::lc_crf().validate(), Ok(()), "LC-CRF");
    }

    /// Every setting with a range, one step outside of it, is named in the error.
    #[test]
    fn each_setting_outside_its_range_is_named() {
        type Break = fn(&mut CrfConfig);
        let breaks: [(&str, Break); 12] = [
            ("unary.reprojection.mean", |c| {
                c.unary.reprojection.mean = f64::NAN
            }),
            ("unary.depth.sigma", |c| c.unary.depth.sigma = 0.0),
            ("unary.epipolar.weight", |c| c.unary.epipolar.weight = -1.0),
            ("unary.clamp", |c| c.unary.clamp = 0.5),
            ("unary.decision.confidence", |c| {
                c.unary.decision = Decision::Hard {
                    score: Score::Mean,
                    threshold: 0.8,
                    threshold_with_epipolar: 0.8,
                    confidence: 0.5,
                };
            }),
            ("kernels.feature_weight", |c| {
                c.kernels.feature_weight = -1e-9
            }),
            ("kernels.position_weight", |c| {
                c.kernels.position_weight = f64::INFINITY
            }),
            ("kernels.sigma_m", |c| c.kernels.sigma_m = 0.0),
            ("kernels.sigma_px", |c| c.kernels.sigma_px = f64::NAN),
            ("mean_field.damping", |c| c.mean_field.damping = 1.0),
            ("mean_field.method.tail", |c| {
                c.mean_field.method = Method::Fast { tail: 1.0 }
            }),
            ("threshold", |c| c.threshold = 1.0),
        ];
        for (name, spoil) in breaks {
            let mut config = CrfConfig::default();
            spoil(&mut config);
            match config.validate() {
                Err(CrfError::BadSetting { setting, .. }) => assert_eq!(setting, name, "its name"),
                other => panic!("{name}: {other:?}"),
            }
        }
    }
}
