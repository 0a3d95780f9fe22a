//! Mean and covariance of flow vectors (eq. 9), plain and in the presence of outliers.

use garad_core::chi_square::chi2_2dof_quantile;
use nalgebra::{Matrix2, Vector2};

use super::config::{FlowConfig, FlowEstimator};

/// 1/Φ⁻¹(3/4): the standard deviation of a Gaussian whose median absolute deviation is 1.
const SIGMA_PER_MAD: f64 = 1.482_602_218_505_602;

/// Share of a Gaussian that [`FlowEstimator::Trimmed`] keeps.
const KEPT: f64 = 0.95;

/// The result of an estimator, without the floor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Estimate {
    pub(super) mean: Vector2<f64>,
    pub(super) covariance: Matrix2<f64>,
    /// Vectors used.
    pub(super) support: usize,
}

/// By the estimator of the settings; at least one vector, all finite.
pub(super) fn estimate(vectors: &[Vector2<f64>], config: &FlowConfig) -> Estimate {
    match config.estimator {
        FlowEstimator::Moments => moments(vectors),
        FlowEstimator::MedianMad => median_mad(vectors),
        FlowEstimator::Trimmed => trimmed(vectors, config.covariance_floor_px2),
    }
}

/// Eq. 9: Σ = 1/(n-1) Σ (Vₖ - μ)(Vₖ - μ)ᵀ with μ = 1/n Σ Vₖ, in two passes.
fn moments(vectors: &[Vector2<f64>]) -> Estimate {
    let n = vectors.len() as f64;
    let mut mean = Vector2::zeros();
    for v in vectors {
        mean += v;
    }
    mean /= n;
    let mut covariance = Matrix2::zeros();
    for v in vectors {
        let d = v - mean;
        covariance += d * d.transpose();
    }
    Estimate {
        mean,
        covariance: covariance / (n - 1.0).max(1.0),
        support: vectors.len(),
    }
}

fn median_mad(vectors: &[Vector2<f64>]) -> Estimate {
    let axis = |k: usize| {
        let centre = median(vectors.iter().map(|v| v[k]).collect());
        let deviation = median(vectors.iter().map(|v| (v[k] - centre).abs()).collect());
        let sigma = SIGMA_PER_MAD * deviation;
        (centre, sigma * sigma)
    };
    let [(x, xx), (y, yy)] = [axis(0), axis(1)];
    Estimate {
        mean: Vector2::new(x, y),
        covariance: Matrix2::new(xx, 0.0, 0.0, yy),
        support: vectors.len(),
    }
}

/// A Gaussian cut at χ² ≤ c keeps P₂ = 1 - e^(-c/2) of its mass and P₄/P₂ of its covariance, where
/// P₄ = 1 - e^(-c/2) (1 + c/2): the mass of χ² below c for 2 and for 4 degrees of freedom. (In polar
/// coordinates ∫ r² · r e^(-r²/2) dr over r² ≤ c is 2 P₄.)
fn trimmed(vectors: &[Vector2<f64>], floor_px2: f64) -> Estimate {
    let first = median_mad(vectors);
    let (xx, yy) = (
        first.covariance[(0, 0)] + floor_px2,
        first.covariance[(1, 1)] + floor_px2,
    );
    let cut = chi2_2dof_quantile(KEPT);
    let kept: Vec<Vector2<f64>> = vectors
        .iter()
        .filter(|v| {
            let d = *v - first.mean;
            // Written without a division: along an axis on which more than half of the vectors are
            // equal, and without a floor, only those equal ones stay.
            d.x * d.x * yy + d.y * d.y * xx <= cut * xx * yy
        })
        .copied()
        .collect();
    if kept.is_empty() {
        return Estimate {
            support: 0,
            ..first
        };
    }
    let mass_4 = 1.0 - (1.0 - KEPT) * (1.0 + 0.5 * cut);
    let found = moments(&kept);
    Estimate {
        covariance: found.covariance * (KEPT / mass_4),
        ..found
    }
}

/// The middle value, or the mean of the two in the middle; at least one, none NaN.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    0.5 * (values[(n - 1) / 2] + values[n / 2])
}
