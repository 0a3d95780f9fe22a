//! The unary potential: P(static) from four cues (eq. 2) and its negative logarithm (eq. 3).
//!
//! The paper models each cue on static points by a Gaussian and adds them up,
//!
//! P = Σ π_k N(x_k | μ_k, σ_k²)
//!
//! As printed the cues' units decide their weights (a density per px beside one per observation),
//! and a point without any reprojection error is improbable. So by default each likelihood has a
//! peak of 1 and falls on the bad side of μ only; P is their geometric mean over the known cues.
//!
//! The potential ψ = -ln P leaves the cost of the other label open. P is a probability of being static, so
//!
//! ψ(static) = -ln P,  ψ(dynamic) = -ln(1 - P)      (C1)
//!
//! and only their difference matters, the log-odds u = ln((1 - P) / P) of being dynamic.
//!
//! # Example
//! Two cues. A reprojection error of 3.5 px is one σ above the mean: exp(-1/2). Seven
//! observations are more than the mean of 2: 1. P is their geometric mean, exp(-1/4):
//! ```
//! use garad_crf::{Cues, UnaryConfig, unary};
//! let config = UnaryConfig::default();
//! let cues = Cues { reproj_px: Some(3.5), observations: Some(7), ..Cues::default() };
//! let p = unary::p_static(&cues, &config);
//! assert!((p - 0.778_801).abs() < 1e-6);
//! let [psi_static, psi_dynamic] = unary::potentials(&cues, &config);
//! assert!((psi_static - 0.25).abs() < 1e-12 && (psi_dynamic - 1.508_691).abs() < 1e-6);
//! ```

use crate::config::{CueModel, UnaryConfig};
use crate::cues::Cues;
use crate::readings::{Decision, Height, Pooling, Score, Side};

/// √(2π)
const SQRT_TAU: f64 = 2.506_628_274_631_000_7;

/// N(x | μ, σ²) of eq. 2: the likelihood of a cue's value on a static point.
///
/// exp(-d² / 2σ²), d = x - μ, or 0 on the good side of a one-sided model; times 1 / (σ √2π) if
/// `height` asks for a density.
#[must_use]
pub fn likelihood(x: f64, model: &CueModel, height: Height) -> f64 {
    let d = match model.side {
        Side::Above => (x - model.mean).max(0.0),
        Side::Below => (x - model.mean).min(0.0),
        Side::Both => x - model.mean,
    } / model.sigma;
    let unit = libm::exp(-0.5 * (d * d));
    match height {
        Height::Unit => unit,
        Height::Density => unit / (model.sigma * SQRT_TAU),
    }
}

/// (πₖ, N(xₖ | μₖ, σₖ²)) of the cues α, β, γ, δ; (0, 1) for an unknown one.
fn weighted_likelihoods(cues: &Cues, config: &UnaryConfig) -> [(f64, f64); 4] {
    [
        (cues.reproj_px, &config.reprojection),
        (cues.depth_residual, &config.depth),
        (cues.observations.map(f64::from), &config.observations),
        (cues.epipolar_px, &config.epipolar),
    ]
    .map(|(x, model)| match x {
        Some(x) if model.weight > 0.0 => (model.weight, likelihood(x, model, config.height)),
        _ => (0.0, 1.0),
    })
}

/// Σₖ πₖ over the known cues.
fn total_weight(cues: &Cues, config: &UnaryConfig) -> f64 {
    let terms = weighted_likelihoods(cues, config).into_iter();
    terms.fold(0.0, |sum, (pi, _)| sum + pi)
}

/// Eq. 2: P = Σₖ πₖ N(xₖ | μₖ, σₖ²) over the known cues, divided by Σₖ πₖ, which the paper has at 1.
/// `None` without any cue.
///
/// In [0, 1] for [`Height::Unit`]; anything from 0 up for [`Height::Density`].
#[must_use]
pub fn mixture_likelihood(cues: &Cues, config: &UnaryConfig) -> Option<f64> {
    let terms = weighted_likelihoods(cues, config);
    let sum = |f: fn(f64, f64) -> f64| terms.iter().fold(0.0, |sum, &(pi, n)| sum + f(pi, n));
    let weights = total_weight(cues, config);
    let p = match config.pooling {
        Pooling::Mean => sum(|pi, n| pi * n) / weights,
        // ln 0 = -∞ makes the product 0.
        Pooling::Geometric => libm::exp(sum(|pi, n| pi * libm::log(n)) / weights),
    };
    (weights > 0.0).then_some(p)
}

/// Too few observations for a P of its own ([`UnaryConfig::min_observations`]).
#[must_use]
pub fn is_thin(cues: &Cues, config: &UnaryConfig) -> bool {
    cues.observations
        .is_some_and(|n| n < config.min_observations)
}

/// Probability of being static, in [clamp, 1 - clamp]; 1/2 without any cue or with too few
/// observations.
#[must_use]
pub fn p_static(cues: &Cues, config: &UnaryConfig) -> f64 {
    let Some(pooled) = mixture_likelihood(cues, config).filter(|_| !is_thin(cues, config)) else {
        return 0.5;
    };
    let p = match config.decision {
        Decision::Soft => pooled,
        Decision::Hard {
            score,
            threshold,
            threshold_with_epipolar,
            confidence,
        } => {
            let score = match score {
                Score::Mean => pooled,
                Score::Sum => pooled * total_weight(cues, config),
            };
            let threshold = match cues.epipolar_px {
                Some(_) => threshold_with_epipolar,
                None => threshold,
            };
            if score >= threshold {
                confidence
            } else {
                1.0 - confidence
            }
        }
    };
    p.max(config.clamp).min(1.0 - config.clamp)
}

/// Eq. 3: ψ_u = -ln P, nat, for P(static) and for P(dynamic) = 1 - P.
#[must_use]
pub fn potentials(cues: &Cues, config: &UnaryConfig) -> [f64; 2] {
    let p = p_static(cues, config);
    [-libm::log(p), -libm::log1p(-p)]
}

/// u = ψ(static) - ψ(dynamic): the log-odds of being dynamic from the node's own cues.
#[must_use]
pub fn log_odds(cues: &Cues, config: &UnaryConfig) -> f64 {
    let [psi_static, psi_dynamic] = potentials(cues, config);
    psi_static - psi_dynamic
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::CrfConfig;

    fn close(got: f64, want: f64) {
        assert!((got - want).abs() < 1e-12, "{got} instead of {want}");
    }

    /// exp(-1/2), exp(-2): one and two σ.
    const ONE: f64 = 0.606_530_659_712_633_4;
    const TWO: f64 = 0.135_335_283_236_612_7;

    #[test]
    fn one_sided_models_fall_on_the_bad_side_only() {
        let error = CueModel::new(1.7, 0.6, Side::Above);
        let count = CueModel::new(5.4, 1.5, Side::Below);
        for (x, model, want) in [
            (0.0, error, 1.0),
            (1.7, error, 1.0),
            (2.3, error, ONE),
            (2.9, error, TWO),
            (30.0, count, 1.0),
            (5.4, count, 1.0),
            (3.9, count, ONE),
            (2.4, count, TWO),
        ] {
            close(likelihood(x, &model, Height::Unit), want);
        }
        let both = CueModel::new(1.7, 0.6, Side::Both);
        close(likelihood(1.1, &both, Height::Unit), ONE);
        close(likelihood(2.3, &both, Height::Unit), ONE);
    }

    #[test]
    fn heights_quoted_in_the_documentation() {
        let peak = |sigma| likelihood(0.0, &CueModel::new(0.0, sigma, Side::Both), Height::Density);
        assert!((peak(0.6) - 0.66).abs() < 0.005, "{}", peak(0.6));
        assert!((peak(0.2) - 2.0).abs() < 0.01, "{}", peak(0.2));
        let perfect = likelihood(0.0, &CueModel::new(1.7, 0.6, Side::Both), Height::Unit);
        assert!((perfect - 0.018).abs() < 5e-4, "{perfect}");
    }

    #[test]
    fn missing_cues_do_not_count() {
        let mut config = UnaryConfig {
            pooling: Pooling::Mean,
            ..UnaryConfig::default()
        };
        close(p_static(&Cues::default(), &config), 0.5);
        let two_sigma = Cues {
            epipolar_px: Some(4.0),
            ..Cues::default()
        };
        close(p_static(&two_sigma, &config), TWO);
        let and_good = Cues {
            depth_residual: Some(0.3),
            ..two_sigma
        };
        close(p_static(&and_good, &config), (TWO + 1.0) / 2.0);
        config.depth.weight = 0.0;
        close(p_static(&and_good, &config), TWO);
        let nothing = mixture_likelihood(&Cues::default(), &config);
        assert_eq!(nothing, None, "no cue");
    }

    #[test]
    fn what_one_good_cue_is_worth() {
        let mut config = UnaryConfig {
            pooling: Pooling::Mean,
            ..UnaryConfig::default()
        };
        let one_good_of_three = Cues {
            reproj_px: Some(40.0),
            depth_residual: Some(40.0),
            epipolar_px: Some(0.0),
            ..Cues::default()
        };
        assert!(
            (log_odds(&one_good_of_three, &config) - libm::log(2.0)).abs() < 1e-12,
            "ln 2"
        );
        config.pooling = Pooling::Geometric;
        close(p_static(&one_good_of_three, &config), config.clamp);
        let mild = Cues {
            reproj_px: Some(4.5),
            epipolar_px: Some(0.0),
            ..Cues::default()
        };
        close(p_static(&mild, &config), libm::exp(-1.0));
    }

    #[test]
    fn probabilities_are_clamped_and_their_odds_are_finite() {
        let config = UnaryConfig::default();
        let hopeless = Cues {
            reproj_px: Some(1e3),
            ..Cues::default()
        };
        close(p_static(&hopeless, &config), 1e-3);
        assert!(
            (log_odds(&hopeless, &config) - 6.906_754_778_648_554).abs() < 1e-12,
            "ln 999"
        );
        let perfect = Cues {
            reproj_px: Some(0.0),
            ..Cues::default()
        };
        close(p_static(&perfect, &config), 0.999);
        assert!(
            (log_odds(&perfect, &config) + 6.906_754_778_648_554).abs() < 1e-12,
            "-ln 999"
        );
    }

    #[test]
    fn one_observation_has_no_say() {
        let config = UnaryConfig::default();
        let seen = |n| Cues {
            reproj_px: Some(50.0),
            observations: Some(n),
            ..Cues::default()
        };
        close(p_static(&seen(1), &config), 0.5);
        assert!(p_static(&seen(2), &config) < 0.1, "two observations have");
    }

    #[test]
    fn hard_decisions_switch_at_their_thresholds() {
        let config = CrfConfig::lc_crf().unary;
        // Reprojection at its mean scores 1: above 0.8 without, not below 1.0 with the epipolar term.
        let good = Cues {
            reproj_px: Some(1.7),
            ..Cues::default()
        };
        close(p_static(&good, &config), 0.7);
        let far = Cues {
            epipolar_px: Some(10.0),
            ..good
        };
        close(p_static(&far, &config), 0.7);
        let worse = Cues {
            reproj_px: Some(1.8),
            ..far
        };
        close(p_static(&worse, &config), 0.3);
        close(
            p_static(
                &Cues {
                    epipolar_px: None,
                    ..worse
                },
                &config,
            ),
            0.7,
        );
        let mut mean = config;
        mean.decision = Decision::Hard {
            score: Score::Mean,
            threshold: 0.8,
            threshold_with_epipolar: 0.8,
            confidence: 0.7,
        };
        close(p_static(&far, &mean), 0.3);
        close(log_odds(&far, &mean), libm::log(0.7 / 0.3));
    }

    /// Each setting away from its default: exp(-d²/2σ²) of each cue alone, in its own weights, with its own clamp and its own
    /// least number of observations.
    #[test]
    fn every_cue_has_its_own_model_and_weight() {
        let mut config = UnaryConfig {
            reprojection: CueModel {
                weight: 2.0,
                ..CueModel::new(1.1, 0.5, Side::Above)
            },
            depth: CueModel {
                weight: 0.5,
                ..CueModel::new(2.9, 0.7, Side::Both)
            },
            observations: CueModel {
                weight: 3.0,
                ..CueModel::new(9.0, 4.0, Side::Below)
            },
            epipolar: CueModel {
                weight: 1.5,
                ..CueModel::new(0.4, 0.3, Side::Above)
            },
            pooling: Pooling::Mean,
            clamp: 0.02,
            min_observations: 4,
            ..UnaryConfig::default()
        };
        let cues = Cues {
            reproj_px: Some(1.6),
            depth_residual: Some(1.5),
            observations: Some(5),
            epipolar_px: Some(1.0),
        };
        // One σ, two, one and two.
        let (weights, sum) = (7.0, 2.0 * ONE + 0.5 * TWO + 3.0 * ONE + 1.5 * TWO);
        close(p_static(&cues, &config), sum / weights);
        config.height = Height::Density;
        let per = |sigma: f64| 1.0 / (sigma * (2.0 * std::f64::consts::PI).sqrt());
        let sum = 2.0 * ONE * per(0.5)
            + 0.5 * TWO * per(0.7)
            + 3.0 * ONE * per(4.0)
            + 1.5 * TWO * per(0.3);
        close(p_static(&cues, &config), sum / weights);
        config.height = Height::Unit;
        config.pooling = Pooling::Geometric;
        close(
            p_static(&cues, &config),
            libm::exp(-(0.5 * 5.0 + 2.0 * 2.0) / weights),
        );
        for (observations, thin) in [(3, true), (4, false)] {
            let cues = Cues {
                observations: Some(observations),
                reproj_px: Some(9.0),
                ..Cues::default()
            };
            assert_eq!(is_thin(&cues, &config), thin, "{observations} observations");
            close(p_static(&cues, &config), if thin { 0.5 } else { 0.02 });
        }
        let perfect = Cues {
            reproj_px: Some(0.0),
            ..Cues::default()
        };
        close(p_static(&perfect, &config), 0.98);
    }

    /// exp(-1/2) = 0.60653 reaches its threshold, exp(-0.502) = 0.6053 does not; each kind of node has its own.
    #[test]
    fn hard_decisions_by_their_own_thresholds() {
        let config = UnaryConfig {
            reprojection: CueModel::new(1.0, 0.5, Side::Above),
            epipolar: CueModel::new(1.0, 0.5, Side::Above),
            pooling: Pooling::Mean,
            decision: Decision::Hard {
                score: Score::Sum,
                threshold: 0.6065,
                threshold_with_epipolar: 1.2,
                confidence: 0.9,
            },
            ..UnaryConfig::default()
        };
        let p = |reproj_px: f64, epipolar_px: Option<f64>| {
            let cues = Cues {
                reproj_px: Some(reproj_px),
                epipolar_px,
                ..Cues::default()
            };
            p_static(&cues, &config)
        };
        close(p(1.5, None), 0.9);
        close(p(1.501, None), 0.1);
        // 0.607 + 0.607 is above 1.2; 0.607 + 0.135 and 1 + 0.135 are above the other threshold alone.
        close(p(1.5, Some(1.5)), 0.9);
        close(p(1.5, Some(2.0)), 0.1);
        close(p(0.5, Some(2.0)), 0.1);
    }
}
