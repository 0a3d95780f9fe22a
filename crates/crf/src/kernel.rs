//! Eq. 5 and 6: how alike two nodes are.
//!
//! Two labels that differ cost Σ ω^m k^m (eq. 4 with the Potts model): nothing for strangers, ω for
//! twins. The first kernel compares what was measured about the nodes, the second where they are.

use crate::config::{Distance, KernelConfig, PositionTerms};
use crate::cues::Node;

/// k¹ = exp(-(αᵢ - αⱼ)² / 2σ_α² - (γᵢ - γⱼ)² / 2σ_γ²), eq. 5: α the mean reprojection error in px,
/// γ the number of observations.
///
/// 0 if one of the two lacks one of these: an untagged Gaussian is judged by its place alone.
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

/// k² = exp(-|Pᵢ - Pⱼ|² / 2σ_P² - |pᵢ - pⱼ|² / 2σ_p²), eq. 6: P in metres, p in px.
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
/// let (a, b) = (node(0.0, 300.0), node(0.5, 318.0));
/// // One σ apart in each: exp(-1/2 - 1/2).
/// let mut config = KernelConfig::default();
/// assert!((kernel::position(&a, &b, &config) - 0.367_879).abs() < 1e-6);
/// // As printed: exp(-0.5 / (2 · 0.25) - 18 / (2 · 324)) = exp(-1 - 1/36).
/// config.distance = Distance::Linear;
/// assert!((kernel::position(&a, &b, &config) - 0.357_801).abs() < 1e-6);
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
        let (seen, unseen) = (node(0.0, Some([10.0, 20.0])), node(0.5, None));
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
        let (near, far) = (node(0.0, Some([0.0, 0.0])), node(9.0, Some([18.0, 0.0])));
        assert!(
            (position(&near, &far, &config) - libm::exp(-0.5)).abs() < 1e-15,
            "one σ"
        );
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
            "twins"
        );
        assert!(feature(&full, &lacking, &config) == 0.0, "stranger");
        assert!(
            feature(&lacking, &lacking, &config) == 0.0,
            "even to itself"
        );
    }
}
