//! [`FlowModel`]: mean and covariance of the flow of static points, and the distance to them.

use nalgebra::{Matrix2, Vector2};

use super::config::FlowConfig;
use super::estimate::estimate;
use crate::error::FeatureError;

/// A Gaussian over flow vectors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlowModel {
    /// μ, pixels.
    pub mean: Vector2<f64>,
    /// Σ with the floor in it, pixels².
    pub covariance: Matrix2<f64>,
    /// Vectors in mean and covariance: those given, less those trimmed.
    pub support: usize,
    /// Σ = L Lᵀ: l₁₁, l₂₁, l₂₂.
    factor: [f64; 3],
}

/// A model, or why there is none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum FlowFit {
    /// There is one.
    Model(FlowModel),
    /// [`FlowConfig::enabled`] is off.
    Disabled,
    /// Too few static points.
    TooFew {
        /// How many there are.
        got: usize,
        /// [`FlowConfig::min_support`].
        needed: usize,
    },
    /// All flows are equal or lie on a line, and there is no floor (or their squares overflow).
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

/// Below this share of the variance of y, its part that is uncorrelated with x is rounding.
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

    /// Eq. 10: χ² = (V - μ)ᵀ Σ⁻¹ (V - μ) = ‖L⁻¹ (V - μ)‖², Σ = L Lᵀ, of a flow vector V.
    ///
    /// # Numerics
    /// By substitution, never negative: an inverse through the determinant would lose the remaining
    /// digits of a thin ellipse.
    #[must_use]
    pub fn distance2(&self, flow: &Vector2<f64>) -> f64 {
        let d = flow - self.mean;
        let [l11, l21, l22] = self.factor;
        let x = d.x / l11;
        let y = (d.y - l21 * x) / l22;
        x * x + y * y
    }
}

/// Mean and covariance of the vectors by the estimator of the settings, plus the floor.
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

pub(super) fn finite(vector: &Vector2<f64>) -> Result<(), FeatureError> {
    if vector.x.is_finite() && vector.y.is_finite() {
        return Ok(());
    }
    let reason = "a flow vector is not finite";
    Err(FeatureError::Degenerate { reason })
}
