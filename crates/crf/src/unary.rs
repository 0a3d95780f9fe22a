//! Eq. 2 and 3: from the cues of a node to its own opinion.
//!
//! Eq. 2 gives each cue a Gaussian of what static things look like and mixes them,
//!
//! P = Σ π_k N(x_k | μ_k, σ_k²)
//!
//! As it stands the cues' units decide their weights (a density per px beside one per observation),
//! and a point without any reprojection error is improbable. So by default each likelihood has a
//! peak of 1 and falls on the bad side of μ only; P is their mean over the cues that are there.
//!
//! Eq. 3, ψ = -ln P, does not say what the other label costs. P is a probability of being static, so
//!
//! ψ(static) = -ln P,  ψ(dynamic) = -ln(1 - P)      (C1)
//!
//! and all that counts is their difference, the log-odds u = ln((1 - P) / P) of being dynamic.
//!
//! # Example
//! Two cues. A reprojection error of 2.3 px is one σ beyond the mean: exp(-1/2) = 0.607. Seven
//! observations are more than the 5.4 expected: 1. P is their mean:
//! ```
//! use garad_crf::{Cues, UnaryConfig, unary};
//! let config = UnaryConfig::default();
//! let cues = Cues { reproj_px: Some(2.3), observations: Some(7), ..Cues::default() };
//! let p = unary::p_static(&cues, &config);
//! assert!((p - 0.803_265).abs() < 1e-6);
//! let [psi_static, psi_dynamic] = unary::potentials(&cues, &config);
//! assert!((psi_static - 0.219_070).abs() < 1e-6 && (psi_dynamic - 1.625_899).abs() < 1e-6);
//! ```

use crate::config::{CueModel, Decision, Height, Pooling, Score, Side, UnaryConfig};
use crate::cues::Cues;

/// √(2π)
const SQRT_TAU: f64 = 2.506_628_274_631_000_7;

/// Likelihood of a cue's value on something static.
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

/// The likelihoods of the cues that are there, pooled, and the sum of their weights.
fn pooled(cues: &Cues, config: &UnaryConfig) -> Option<(f64, f64)> {
    let (mut sum, mut log_sum, mut weights) = (0.0, 0.0, 0.0);
    for (value, model) in [
        (cues.reproj_px, &config.reprojection),
        (cues.depth_residual, &config.depth),
        (cues.observations.map(f64::from), &config.observations),
        (cues.epipolar_px, &config.epipolar),
    ] {
        if let Some(x) = value.filter(|_| model.weight > 0.0) {
            let value = likelihood(x, model, config.height);
            sum += model.weight * value;
            // ln 0 = -∞ is what makes a product 0.
            log_sum += model.weight * libm::log(value);
            weights += model.weight;
        }
    }
    let pooled = match config.pooling {
        Pooling::Mean => sum / weights,
        Pooling::Geometric => libm::exp(log_sum / weights),
    };
    (weights > 0.0).then_some((pooled, weights))
}

/// Eq. 2 over the cues that are there, their weights scaled to sum to 1. `None` without any.
///
/// In [0, 1] for [`Height::Unit`]; anything from 0 up for [`Height::Density`].
#[must_use]
pub fn mixture_likelihood(cues: &Cues, config: &UnaryConfig) -> Option<f64> {
    pooled(cues, config).map(|(pooled, _)| pooled)
}

/// Seen by fewer keyframes than it takes to have a say.
#[must_use]
pub fn is_thin(cues: &Cues, config: &UnaryConfig) -> bool {
    cues.observations
        .is_some_and(|n| n < config.min_observations)
}

/// Probability of being static, in [clamp, 1 - clamp]; 1/2 without any cue or with too few
/// observations.
#[must_use]
pub fn p_static(cues: &Cues, config: &UnaryConfig) -> f64 {
    let Some((pooled, weights)) = pooled(cues, config).filter(|_| !is_thin(cues, config)) else {
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
                Score::Sum => pooled * weights,
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

/// [ψ(static), ψ(dynamic)] = [-ln P, -ln(1 - P)], nat.
#[must_use]
pub fn potentials(cues: &Cues, config: &UnaryConfig) -> [f64; 2] {
    let p = p_static(cues, config);
    [-libm::log(p), -libm::log1p(-p)]
}

/// ψ(static) - ψ(dynamic): what the node's own cues say for being dynamic, as log-odds.
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
        let config = UnaryConfig::default();
        close(p_static(&Cues::default(), &config), 0.5);
        let two_sigma = Cues {
            epipolar_px: Some(0.7),
            ..Cues::default()
        };
        close(p_static(&two_sigma, &config), TWO);
        let and_good = Cues {
            depth_residual: Some(0.3),
            ..two_sigma
        };
        close(p_static(&and_good, &config), (TWO + 1.0) / 2.0);
        let mut ignoring = config;
        ignoring.depth.weight = 0.0;
        close(p_static(&and_good, &ignoring), TWO);
        assert_eq!(
            mixture_likelihood(&Cues::default(), &ignoring),
            None,
            "no cue"
        );
    }

    #[test]
    fn what_one_good_cue_is_worth() {
        let mut config = UnaryConfig::default();
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
            reproj_px: Some(2.9),
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
}
