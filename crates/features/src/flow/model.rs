//! [`FlowModel`]: mean and covariance of the flow of static points, and the distance to them.

use nalgebra::{Matrix2, Vector2};

use super::estimate::estimate;
use super::{FlowConfig, finite};
use crate::error::FeatureError;

/// χ² that 5 % of static points exceed, 2 degrees of freedom, to the digits the field quotes;
/// [`chi2_2dof_quantile`] has the others.
pub const CHI2_2DOF_95: f64 = 5.991;

/// The value that a χ² variable with 2 degrees of freedom stays below with probability `p`:
///
/// x = -2 ln(1 - p),   since P(χ² ≤ x) = 1 - exp(-x/2)
///
/// Infinite for 1, NaN outside [0, 1].
///
/// # Example
/// ```
/// let chi2 = garad_features::flow::chi2_2dof_quantile(0.95);
/// assert!((chi2 - 5.991464547107979).abs() < 1e-14); // -2 ln 0.05
/// ```
#[must_use]
pub fn chi2_2dof_quantile(p: f64) -> f64 {
    if p < 0.0 {
        return f64::NAN;
    }
    -2.0 * libm::log1p(-p)
}

/// A Gaussian over flow vectors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlowModel {
    /// μ, pixels.
    pub mean: Vector2<f64>,
    /// Σ with the floor in it, pixels².
    pub covariance: Matrix2<f64>,
    /// Vectors that mean and covariance were made of: those given, less those trimmed.
    pub support: usize,
    /// Σ = L Lᵀ: l₁₁, l₂₁, l₂₂.
    factor: [f64; 3],
}

/// A model, or why there is none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FlowFit {
    /// There is one.
    Model(FlowModel),
    /// Too few static points: nothing can be decided.
    TooFew {
        /// How many took part.
        got: usize,
        /// [`FlowConfig::min_support`].
        needed: usize,
    },
    /// All flows are equal or lie on a line, and there is no floor (or their squares overflow):
    /// nothing can be decided.
    Singular,
}

impl FlowFit {
    /// The model, if there is one.
    #[must_use]
    pub fn model(&self) -> Option<&FlowModel> {
        match self {
            Self::Model(model) => Some(model),
            _ => None,
        }
    }
}

/// Below this share of its variance, what y has on its own is rounding of what it has with x.
const ON_A_LINE: f64 = 1e-12;

impl FlowModel {
    /// `None` if the covariance is not positive definite, or too large for an f64.
    fn new(mean: Vector2<f64>, covariance: Matrix2<f64>, support: usize) -> Option<Self> {
        let (a, b, c) = (covariance[(0, 0)], covariance[(1, 0)], covariance[(1, 1)]);
        let l11 = a.sqrt();
        let l21 = b / l11;
        let rest = c - l21 * l21;
        // NaN (a zero variance makes 0 / 0) fails the comparisons.
        let finite = covariance.iter().all(|v| v.is_finite());
        (finite && a > 0.0 && rest > ON_A_LINE * c).then(|| Self {
            mean,
            covariance,
            support,
            factor: [l11, l21, rest.sqrt()],
        })
    }

    /// Squared Mahalanobis distance of a flow vector (paper eq. 10):
    ///
    /// χ² = (V - μ)ᵀ Σ⁻¹ (V - μ) = ‖L⁻¹ (V - μ)‖²,   Σ = L Lᵀ
    ///
    /// # Numerics
    /// By substitution, never negative: an inverse through the determinant would lose the digits
    /// that a thin ellipse has left.
    #[must_use]
    pub fn distance2(&self, flow: &Vector2<f64>) -> f64 {
        let d = flow - self.mean;
        let [l11, l21, l22] = self.factor;
        let x = d.x / l11;
        let y = (d.y - l21 * x) / l22;
        x * x + y * y
    }
}

/// Mean and covariance of the vectors by the estimator of the settings, plus the floor
/// (paper eq. 9).
///
/// # Errors
/// [`FeatureError::BadSetting`]; [`FeatureError::Degenerate`] when a vector is not finite.
pub fn fit_flow(vectors: &[Vector2<f64>], config: &FlowConfig) -> Result<FlowFit, FeatureError> {
    config.validate()?;
    vectors.iter().try_for_each(finite)?;
    let too_few = |got| FlowFit::TooFew {
        got,
        needed: config.min_support,
    };
    if vectors.len() < config.min_support {
        return Ok(too_few(vectors.len()));
    }
    let found = estimate(vectors, config);
    if found.support < config.min_support {
        return Ok(too_few(found.support));
    }
    let covariance = found.covariance + Matrix2::identity() * config.covariance_floor_px2;
    let model = FlowModel::new(found.mean, covariance, found.support);
    Ok(model.map_or(FlowFit::Singular, FlowFit::Model))
}
