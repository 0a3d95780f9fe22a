//! [`CrfConfig`]: every setting that changes a result, with its reason.
//!
//! The defaults are the pipeline's; decision 005 has the measurements behind them. Two presets:
//! [`CrfConfig::as_printed`] is the paper to the letter, [`CrfConfig::lc_crf`] the code of
//! LC-CRF-SLAM (Du et al. 2020), whose field the paper follows. [`crate::readings`] holds the options.

use serde::{Deserialize, Serialize};

use crate::error::{CrfError, setting};
use crate::readings::{
    Decision, Distance, Height, Normalisation, Pooling, PositionTerms, Score, Side, ThinEvidence,
};

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
    /// From a node's own cues to its unary potential (eq. 2, 3).
    pub unary: UnaryConfig,
    /// From two nodes to their pairwise potential (eq. 4 to 6).
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
    /// The value of a likelihood at its peak.
    pub height: Height,
    /// How the likelihoods of a node are combined.
    pub pooling: Pooling,
    /// From the combined likelihood to P(static).
    pub decision: Decision,
    /// P is kept within [clamp, 1 - clamp]. 1e-3 limits |ln(P / (1 - P))| to 6.9, which a handful of
    /// neighbours can still outweigh.
    pub clamp: f64,
    /// Nodes with a known number of observations below this have P = 1/2.
    pub min_observations: u32,
    /// The belief of such a node after inference.
    pub thin: ThinEvidence,
}

impl Default for UnaryConfig {
    fn default() -> Self {
        Self {
            reprojection: CueModel::new(2.5, 1.0, Side::Above),
            // The mean of |r| / σ is 0.8 for noise alone.
            depth: CueModel::new(2.0, 1.5, Side::Above),
            observations: CueModel::new(2.0, 1.0, Side::Below),
            epipolar: CueModel::new(2.0, 1.0, Side::Above),
            height: Height::Unit,
            pooling: Pooling::Geometric,
            decision: Decision::Soft,
            clamp: 1e-3,
            min_observations: 2,
            thin: ThinEvidence::KeepPrevious,
        }
    }
}

/// One Gaussian of eq. 2: the distribution of a cue on static points.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CueModel {
    /// μ, in the cue's unit.
    pub mean: f64,
    /// σ, in the cue's unit.
    pub sigma: f64,
    /// On which side of μ a value is evidence against being static.
    pub side: Side,
    /// π; the weights of the cues a node has are scaled to sum to 1. 0 ignores the cue.
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

/// Weights and widths of the two kernels.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KernelConfig {
    /// ω¹ of the feature kernel. With row-normalised kernels, the most it can add to a log-odds.
    ///
    /// Larger weights converge more slowly. With 1 and 3 and LC-CRF's unary numbers the tenth iteration
    /// changes no belief by more than 0.06; with LC-CRF's 10 and 30, over its hard labels, its fifth and
    /// last still changes some by more than 0.3, so that labels depend on the number of iterations.
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
            sigma_m: 0.2,
            sigma_px: 30.0,
            distance: Distance::Squared,
            terms: PositionTerms::Both,
        }
    }
}

/// The iteration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MeanFieldConfig {
    /// Number of parallel updates, always all of them.
    pub iterations: usize,
    /// Divisor of a kernel's sum over the neighbours.
    pub normalisation: Normalisation,
    /// Whether j = i takes part. LC-CRF includes it. Under [`Normalisation::Rows`] it keeps an isolated
    /// node from following a neighbour far away: without it that neighbour's kernel, however
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
            iterations: 5,
            normalisation: Normalisation::Rows,
            self_message: true,
            damping: 0.0,
            method: Method::Fast { tail: 1e-4 },
        }
    }
}

/// How kernel sums are computed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Method {
    /// Every pair, one after the other: plain code, for up to a few thousand nodes.
    Reference,
    /// Vectorised, without pairs whose position kernel is known to be below `tail`.
    /// [`crate::Beliefs::error_bound`] bounds the effect. 0 leaves nothing out.
    Fast {
        /// In [0, 1).
        tail: f64,
    },
}

/// A range: its words and its test.
type Range = (&'static str, fn(f64) -> bool);
const FINITE: Range = ("a finite number", f64::is_finite);
const POSITIVE: Range = ("a number above 0", |v| v > 0.0 && v.is_finite());
const NOT_NEGATIVE: Range = ("a number of at least 0", |v| v >= 0.0 && v.is_finite());
const INSIDE: Range = ("a number strictly between 0 and 1", |v| v > 0.0 && v < 1.0);
const LOWER_HALF: Range = ("a number above 0 and below 1/2", |v| v > 0.0 && v < 0.5);
const UPPER_HALF: Range = ("a number above 1/2 and below 1", |v| v > 0.5 && v < 1.0);
const FRACTION: Range = ("a number of at least 0 and below 1", |v| {
    (0.0..1.0).contains(&v)
});

impl CrfConfig {
    /// The paper to the letter: eq. 2 with two-sided densities and their mean, eq. 4 without
    /// normalisation and without j = i, eq. 6 with distances that are not squared.
    ///
    /// The paper gives no numbers. Means, deviations and widths are LC-CRF's, except for the depth
    /// cue, which is another quantity there; weights and iterations are ours.
    #[must_use]
    pub fn as_printed() -> Self {
        Self {
            unary: UnaryConfig {
                reprojection: CueModel::new(1.7, 0.6, Side::Both),
                depth: CueModel::new(1.0, 1.0, Side::Both),
                observations: CueModel::new(5.4, 1.5, Side::Both),
                epipolar: CueModel::new(0.3, 0.2, Side::Both),
                height: Height::Density,
                pooling: Pooling::Mean,
                decision: Decision::Soft,
                clamp: 1e-3,
                min_observations: 0,
                thin: ThinEvidence::KeepPrevious,
            },
            kernels: KernelConfig {
                feature_weight: 1.0,
                sigma_reproj_px: 0.6,
                sigma_observations: 1.5,
                position_weight: 3.0,
                sigma_m: 0.5,
                sigma_px: 18.0,
                distance: Distance::Linear,
                terms: PositionTerms::Both,
            },
            mean_field: MeanFieldConfig {
                iterations: 10,
                normalisation: Normalisation::None,
                self_message: false,
                damping: 0.0,
                method: Method::Reference,
            },
            threshold: 0.5,
        }
    }

    /// What the code of LC-CRF-SLAM does, as far as eq. 2 to 6 can express it: two-sided
    /// likelihoods of which the sum decides, a confidence of 0.7, pixels alone in the position
    /// kernel, weights 10 and 30, five iterations.
    ///
    /// Its depth cue is the mean depth itself, 2.75 ± 0.5 m: give that number as
    /// [`crate::Cues::depth_residual`].
    #[must_use]
    pub fn lc_crf() -> Self {
        let printed = Self::as_printed();
        Self {
            unary: UnaryConfig {
                depth: CueModel::new(2.75, 0.5, Side::Both),
                height: Height::Unit,
                decision: Decision::Hard {
                    score: Score::Sum,
                    threshold: 0.8,
                    threshold_with_epipolar: 1.0,
                    confidence: 0.7,
                },
                ..printed.unary
            },
            kernels: KernelConfig {
                feature_weight: 10.0,
                position_weight: 30.0,
                distance: Distance::Squared,
                terms: PositionTerms::Pixel,
                ..printed.kernels
            },
            mean_field: MeanFieldConfig {
                iterations: 5,
                normalisation: Normalisation::Rows,
                self_message: true,
                method: Method::Fast { tail: 1e-12 },
                ..printed.mean_field
            },
            ..printed
        }
    }

    /// # Errors
    /// [`CrfError::BadSetting`] with the first setting outside its range.
    pub fn validate(&self) -> Result<(), CrfError> {
        let (u, k, m) = (&self.unary, &self.kernels, &self.mean_field);
        let check =
            |name, value, (expected, holds): Range| setting(name, value, expected, holds(value));
        #[rustfmt::skip]
        let cues = [
            (["unary.reprojection.mean", "unary.reprojection.sigma", "unary.reprojection.weight"], &u.reprojection),
            (["unary.depth.mean", "unary.depth.sigma", "unary.depth.weight"], &u.depth),
            (["unary.observations.mean", "unary.observations.sigma", "unary.observations.weight"], &u.observations),
            (["unary.epipolar.mean", "unary.epipolar.sigma", "unary.epipolar.weight"], &u.epipolar),
        ];
        for ([mean, sigma, weight], cue) in cues {
            check(mean, cue.mean, FINITE)?;
            check(sigma, cue.sigma, POSITIVE)?;
            check(weight, cue.weight, NOT_NEGATIVE)?;
        }
        check("unary.clamp", u.clamp, LOWER_HALF)?;
        if let Decision::Hard {
            threshold,
            threshold_with_epipolar: epipolar,
            confidence,
            ..
        } = u.decision
        {
            check("unary.decision.threshold", threshold, POSITIVE)?;
            check("unary.decision.threshold_with_epipolar", epipolar, POSITIVE)?;
            check("unary.decision.confidence", confidence, UPPER_HALF)?;
        }
        check("kernels.feature_weight", k.feature_weight, NOT_NEGATIVE)?;
        check("kernels.position_weight", k.position_weight, NOT_NEGATIVE)?;
        check("kernels.sigma_reproj_px", k.sigma_reproj_px, POSITIVE)?;
        check("kernels.sigma_observations", k.sigma_observations, POSITIVE)?;
        check("kernels.sigma_m", k.sigma_m, POSITIVE)?;
        check("kernels.sigma_px", k.sigma_px, POSITIVE)?;
        check("mean_field.damping", m.damping, FRACTION)?;
        if let Method::Fast { tail } = m.method {
            check("mean_field.method.tail", tail, FRACTION)?;
        }
        check("threshold", self.threshold, INSIDE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_and_presets_are_valid() {
        assert_eq!(CrfConfig::default().validate(), Ok(()), "default");
        assert_eq!(CrfConfig::as_printed().validate(), Ok(()), "printed");
        assert_eq!(CrfConfig::lc_crf().validate(), Ok(()), "LC-CRF");
    }

    /// Every setting with a range, one step outside of it, is named in the error.
    #[test]
    fn each_setting_outside_its_range_is_named() {
        type Break = fn(&mut CrfConfig);
        let breaks: [(&str, Break); 24] = [
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
            ("unary.reprojection.sigma", |c| {
                c.unary.reprojection.sigma = -1.0
            }),
            ("unary.depth.mean", |c| c.unary.depth.mean = f64::INFINITY),
            ("unary.depth.weight", |c| c.unary.depth.weight = f64::NAN),
            ("unary.observations.sigma", |c| {
                c.unary.observations.sigma = 0.0
            }),
            ("unary.observations.weight", |c| {
                c.unary.observations.weight = -0.5
            }),
            ("unary.epipolar.mean", |c| c.unary.epipolar.mean = f64::NAN),
            ("unary.epipolar.sigma", |c| c.unary.epipolar.sigma = 0.0),
            ("kernels.sigma_reproj_px", |c| {
                c.kernels.sigma_reproj_px = 0.0
            }),
            ("kernels.sigma_observations", |c| {
                c.kernels.sigma_observations = -2.0
            }),
            ("unary.clamp", |c| c.unary.clamp = 0.0),
            ("mean_field.damping", |c| c.mean_field.damping = -0.1),
            ("threshold", |c| c.threshold = 0.0),
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
