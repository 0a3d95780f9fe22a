//! The pairwise potential (eq. 4) and its two kernels: similar features (eq. 5), nearby positions (eq. 6).

use garad_core::Label;

use crate::config::KernelConfig;
use crate::cues::Node;
use crate::readings::{Distance, PositionTerms};

/// Eq. 4: ψ_p(xᵢ, xⱼ) = μ(xᵢ, xⱼ) Σₘ ω^m k^m(fᵢ, fⱼ), nat. Mean field takes its expectation.
#[must_use]
pub fn pairwise(x: [Label; 2], f: [&Node; 2], config: &KernelConfig) -> f64 {
    let ([x_i, x_j], [f_i, f_j]) = (x, f);
    potts(x_i, x_j)
        * (config.feature_weight * feature(f_i, f_j, config)
            + config.position_weight * position(f_i, f_j, config))
}

/// μ of eq. 4, the Potts model: 1 for different labels, 0 for equal ones.
#[must_use]
pub fn potts(x_i: Label, x_j: Label) -> f64 {
    f64::from(u8::from(x_i != x_j))
}

/// Eq. 5: k¹ = exp(-(αᵢ - αⱼ)² / 2σ_α² - (γᵢ - γⱼ)² / 2σ_γ²), α the mean reprojection error in px,
/// γ the number of observations.
///
/// 0 if one of the two lacks one of these: an untagged Gaussian has the position kernel alone.
///
/// # Example
/// ```
/// use garad_crf::{Cues, KernelConfig, Node, kernel};
/// let node = |reproj_px, n| Node {
///     cues: Cues { reproj_px: Some(reproj_px), observations: Some(n), ..Cues::default() },
///     ..Node::default()
/// };
/// // One σ (0.6 px) and two σ (3 observations) apart: exp(-1/2 - 2).
/// let k = kernel::feature(&node(1.0, 4), &node(1.6, 7), &KernelConfig::default());
/// assert!((k - 0.082_085).abs() < 1e-6);
/// ```
#[must_use]
pub fn feature(a: &Node, b: &Node, config: &KernelConfig) -> f64 {
    let (Some((alpha_a, gamma_a)), Some((alpha_b, gamma_b))) = (features(a), features(b)) else {
        return 0.0;
    };
    let alpha = (alpha_a - alpha_b) / config.sigma_reproj_px;
    let gamma = (f64::from(gamma_a) - f64::from(gamma_b)) / config.sigma_observations;
    libm::exp(-0.5 * (alpha * alpha) - 0.5 * (gamma * gamma))
}

/// (α, γ) of a node that has both.
pub(crate) fn features(node: &Node) -> Option<(f64, u32)> {
    Some((node.cues.reproj_px?, node.cues.observations?))
}

/// Eq. 6: k² = exp(-|Pᵢ - Pⱼ|² / 2σ_P² - |pᵢ - pⱼ|² / 2σ_p²), P in metres, p in px.
///
/// The paper prints the distances without squares; [`Distance::Linear`] is that reading.
///
/// # Example
/// ```
/// use garad_crf::{Distance, KernelConfig, Node, kernel};
/// use nalgebra::{Vector2, Vector3};
/// let node = |x, u| Node {
///     p_world: Vector3::new(x, 0.0, 2.0),
///     uv_px: Some(Vector2::new(u, 240.0)),
///     ..Node::default()
/// };
/// let (a, b) = (node(0.0, 300.0), node(0.2, 330.0));
/// // One σ apart in each: exp(-1/2 - 1/2).
/// let mut config = KernelConfig::default();
/// assert!((kernel::position(&a, &b, &config) - 0.367_879).abs() < 1e-6);
/// // As printed: exp(-0.2 / (2 · 0.04) - 30 / (2 · 900)) = exp(-5/2 - 1/60).
/// config.distance = Distance::Linear;
/// assert!((kernel::position(&a, &b, &config) - 0.080_728).abs() < 1e-6);
/// ```
#[must_use]
pub fn position(a: &Node, b: &Node, config: &KernelConfig) -> f64 {
    let space = (a.p_world - b.p_world).norm_squared();
    let pixel = match (a.uv_px, b.uv_px) {
        (Some(a), Some(b)) => Some((a - b).norm_squared()),
        _ => None,
    };
    let (space, pixel) = match (config.terms, pixel) {
        (PositionTerms::Both, pixel) => (space, pixel.unwrap_or(0.0)),
        (PositionTerms::Space, _) => (space, 0.0),
        (PositionTerms::Pixel, Some(pixel)) => (0.0, pixel),
        (PositionTerms::Pixel, None) => return 0.0,
    };
    let (space, pixel) = match config.distance {
        Distance::Squared => (space, pixel),
        Distance::Linear => (space.sqrt(), pixel.sqrt()),
    };
    let two_variances = |sigma: f64| 2.0 * (sigma * sigma);
    libm::exp(-space / two_variances(config.sigma_m) - pixel / two_variances(config.sigma_px))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cues::Cues;
    use nalgebra::{Vector2, Vector3};

    fn node(x: f64, uv_px: Option<[f64; 2]>) -> Node {
        Node {
            p_world: Vector3::new(x, 1.0, 3.0),
            uv_px: uv_px.map(Vector2::from),
            ..Node::default()
        }
    }

    #[test]
    fn pairs_without_a_pixel() {
        let (seen, unseen) = (node(0.0, Some([10.0, 20.0])), node(0.2, None));
        let k = |terms| {
            let config = KernelConfig {
                terms,
                ..KernelConfig::default()
            };
            position(&seen, &unseen, &config)
        };
        let metres_alone = libm::exp(-0.5);
        assert!(
            (k(PositionTerms::Both) - metres_alone).abs() < 1e-15,
            "both"
        );
        assert!(
            (k(PositionTerms::Space) - metres_alone).abs() < 1e-15,
            "space"
        );
        assert!(k(PositionTerms::Pixel) == 0.0, "pixel");
    }

    #[test]
    fn pixels_alone_ignore_depth() {
        let config = KernelConfig {
            terms: PositionTerms::Pixel,
            ..KernelConfig::default()
        };
        let (near, far) = (node(0.0, Some([0.0, 0.0])), node(9.0, Some([30.0, 0.0])));
        assert!(
            (position(&near, &far, &config) - libm::exp(-0.5)).abs() < 1e-15,
            "one σ"
        );
    }

    #[test]
    fn different_labels_cost_the_weighted_kernels() {
        use garad_core::Label::{Dynamic, Static};
        let mut a = node(0.0, Some([10.0, 20.0]));
        a.cues.reproj_px = Some(1.0);
        a.cues.observations = Some(3);
        let mut b = node(0.2, Some([40.0, 20.0]));
        b.cues.reproj_px = Some(1.6);
        b.cues.observations = Some(3);
        // One σ apart in α, in metres and in px: 1 exp(-1/2) + 3 exp(-1/2 - 1/2).
        let cost = libm::exp(-0.5) + 3.0 * libm::exp(-1.0);
        let config = KernelConfig::default();
        for (x, expected) in [
            ([Static, Dynamic], cost),
            ([Dynamic, Static], cost),
            ([Static, Static], 0.0),
            ([Dynamic, Dynamic], 0.0),
        ] {
            let got = pairwise(x, [&a, &b], &config);
            assert!((got - expected).abs() < 1e-15, "{x:?}: {got}");
        }
    }

    #[test]
    fn features_need_both_numbers() {
        let config = KernelConfig::default();
        let full = Node {
            cues: Cues {
                reproj_px: Some(1.0),
                observations: Some(3),
                ..Cues::default()
            },
            ..Node::default()
        };
        let mut lacking = full;
        lacking.cues.observations = None;
        assert!(
            (feature(&full, &full, &config) - 1.0).abs() < 1e-15,
            "equal features"
        );
        assert!(
            feature(&full, &lacking, &config) == 0.0,
            "one lacks a feature"
        );
        assert!(feature(&lacking, &lacking, &config) == 0.0, "both lack it");
    }

    /// Every width and weight away from its default: α 3 σ of 0.25 apart, γ 2 σ of 2.5, metres ½ σ of 0.8, pixels
    /// 1.5 σ of 8.
    #[test]
    fn widths_and_weights_are_those_of_the_configuration() {
        let mut a = node(0.1, Some([10.0, 20.0]));
        a.cues.reproj_px = Some(1.0);
        a.cues.observations = Some(3);
        let mut b = node(0.5, Some([10.0, 32.0]));
        b.cues.reproj_px = Some(1.75);
        b.cues.observations = Some(8);
        let config = KernelConfig {
            feature_weight: 40.0,
            sigma_reproj_px: 0.25,
            sigma_observations: 2.5,
            position_weight: 0.7,
            sigma_m: 0.8,
            sigma_px: 8.0,
            ..KernelConfig::default()
        };
        let features = libm::exp(-4.5 - 2.0);
        let both = libm::exp(-0.125 - 1.125);
        assert!((feature(&a, &b, &config) - features).abs() < 1e-15, "eq. 5");
        assert!((position(&a, &b, &config) - both).abs() < 1e-15, "eq. 6");
        let cost = pairwise([Label::Static, Label::Dynamic], [&a, &b], &config);
        assert!(
            (cost - 40.0 * features - 0.7 * both).abs() < 1e-15,
            "eq. 4: {cost}"
        );
        let terms = |terms, distance| {
            position(
                &a,
                &b,
                &KernelConfig {
                    terms,
                    distance,
                    ..config.clone()
                },
            )
        };
        for (got, exponent) in [
            (terms(PositionTerms::Space, Distance::Squared), 0.125),
            (terms(PositionTerms::Pixel, Distance::Squared), 1.125),
            // d / 2σ²: 0.4/1.28 and 12/128
            (terms(PositionTerms::Space, Distance::Linear), 0.3125),
            (terms(PositionTerms::Pixel, Distance::Linear), 0.093_75),
            (terms(PositionTerms::Both, Distance::Linear), 0.406_25),
        ] {
            assert!(
                (got - libm::exp(-exponent)).abs() < 1e-15,
                "{got} for {exponent}"
            );
        }
    }
}
