//! Does a point move as the static scene does? The paper's check of flow (sec. III-B).
//!
//! The flow vectors of points known to be static have a mean μ and a covariance Σ; a suspect whose
//! own flow V lies within the ellipse
//!
//! (V - μ)ᵀ Σ⁻¹ (V - μ) ≤ χ²   (2 degrees of freedom, 5 % outside: 5.991)
//!
//! is static too. [`model`] fits μ and Σ and measures the distance; [`estimate`] holds what can
//! stand in for the plain moments when some of the static points are not; this file applies the
//! model to suspects.
//!
//! One Gaussian for the whole picture is a strong claim: it holds when all static points flow
//! alike. When the camera turns about its axis, nears a wall, or sees near and far at once, the raw
//! flow spreads, Σ with it, and nearly everything passes. [`FlowForm::Residual`] takes off what the
//! camera's motion and the depth predict first, so that only errors of measurement are left.

pub mod estimate;
pub mod model;

use nalgebra::Vector2;

use crate::error::FeatureError;

pub use estimate::FlowEstimator;
pub use model::{CHI2_2DOF_95, FlowFit, FlowModel, chi2_2dof_quantile, fit_flow};

/// Which vectors the model is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FlowForm {
    /// The flow as measured: the paper's words.
    #[default]
    Raw,
    /// The measured flow minus the predicted one. Points without a prediction take no part.
    Residual,
}

/// How the check is made.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlowConfig {
    /// Raw or residual flow.
    pub form: FlowForm,
    /// How mean and covariance are found; the plain moments are the paper's eq. 9.
    pub estimator: FlowEstimator,
    /// Added to both variances, pixels². A camera at rest has flows that are all but equal: the
    /// covariance would be that of rounding, and the least noise would be outside. 0 is the literal
    /// eq. 9.
    pub covariance_floor_px2: f64,
    /// Fewer static points than this make no model; at least 3, as two lie on a line.
    pub min_support: usize,
    /// Largest squared distance that is inside.
    pub chi2: f64,
}

impl Default for FlowConfig {
    /// Raw flow and plain moments as in the paper; (0.5 px)² and 10 points are ours.
    fn default() -> Self {
        Self {
            form: FlowForm::Raw,
            estimator: FlowEstimator::Moments,
            covariance_floor_px2: 0.25,
            min_support: 10,
            chi2: CHI2_2DOF_95,
        }
    }
}

impl FlowConfig {
    /// # Errors
    /// [`FeatureError::BadSetting`] with the first setting outside its range.
    fn validate(&self) -> Result<(), FeatureError> {
        let bad = |setting, value, expected| FeatureError::BadSetting {
            setting,
            value,
            expected,
        };
        let floor = self.covariance_floor_px2;
        if !(floor >= 0.0 && floor.is_finite()) {
            let expected = "pixels squared, finite and not negative";
            return Err(bad("covariance_floor_px2", floor, expected));
        }
        if self.min_support < 3 {
            let got = self.min_support as f64;
            return Err(bad("min_support", got, "at least 3 points"));
        }
        if !(self.chi2 > 0.0 && self.chi2.is_finite()) {
            return Err(bad("chi2", self.chi2, "a positive number"));
        }
        Ok(())
    }
}

/// The flow of one point from frame i to frame j.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlowPoint {
    /// Where Lucas-Kanade found it, minus where it was, pixels.
    pub flow: Vector2<f64>,
    /// What the flow of a static point here would be, from the motion of the camera and the depth,
    /// pixels; `None` without depth. Raw flow has no use for it.
    pub predicted: Option<Vector2<f64>>,
}

impl FlowPoint {
    /// A point without prediction.
    #[must_use]
    pub fn raw(flow: Vector2<f64>) -> Self {
        Self {
            flow,
            predicted: None,
        }
    }

    /// The vector that is judged; `None` if the form needs a prediction and there is none.
    fn vector(&self, form: FlowForm) -> Option<Vector2<f64>> {
        match form {
            FlowForm::Raw => Some(self.flow),
            FlowForm::Residual => self.predicted.map(|predicted| self.flow - predicted),
        }
    }
}

/// What the check says of one suspect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlowVerdict {
    /// It flows as static points do.
    pub inside: bool,
    /// Squared Mahalanobis distance (paper eq. 10).
    pub distance2: f64,
}

/// The model and what it says of the suspects.
#[derive(Debug, Clone, PartialEq)]
pub struct FlowVerification {
    /// The model, or why there is none.
    pub fit: FlowFit,
    /// One per suspect; `None` where nothing is decided: no model, or no prediction for it.
    pub verdicts: Vec<Option<FlowVerdict>>,
}

/// Fits the flow of static points and judges suspects by it.
///
/// μ = 1/n Σ Vₖ,   Σ = 1/(n-1) Σ (Vₖ - μ)(Vₖ - μ)ᵀ + floor I                  (paper eq. 9)
///
/// χ² = (V - μ)ᵀ Σ⁻¹ (V - μ),   inside if χ² ≤ `chi2`                         (paper eq. 10)
///
/// Without a model (too few static points, or all on a line and no floor) nothing is decided and
/// the labels stay what they were.
///
/// Source: the paper, sec. III-B; the floor, the least support, the residual form and the robust
/// estimators are ours. Spec test: `spec_flow_check`. Golden: `flow/*`.
///
/// # Numerics
/// f64, sums in the order of the points.
/// # Errors
/// [`FeatureError::BadSetting`]; [`FeatureError::Degenerate`] when a flow or a prediction that is
/// used is not finite: points that Lucas-Kanade lost do not belong here.
/// # Example
/// ```
/// use garad_features::flow::{FlowConfig, FlowPoint, verify_flow};
/// use nalgebra::Vector2;
/// let point = |x, y| FlowPoint::raw(Vector2::new(x, y));
/// let config = FlowConfig { covariance_floor_px2: 0.0, min_support: 4, ..FlowConfig::default() };
/// // Mean (2, 0); squares 1 + 1 along x and 1 + 1 along y, over n - 1 = 3: covariance 2/3 I.
/// let static_points = [point(1.0, 0.0), point(3.0, 0.0), point(2.0, 1.0), point(2.0, -1.0)];
/// let checked = verify_flow(&static_points, &[point(2.0, 1.5), point(5.0, 0.0)], &config)?;
/// let [near, far] = [0, 1].map(|i| checked.verdicts[i].expect("there is a model"));
/// assert!(near.inside && (near.distance2 - 1.5 * 1.5 * 1.5).abs() < 1e-14); // 1.5² / (2/3)
/// assert!(!far.inside && (far.distance2 - 3.0 * 3.0 * 1.5).abs() < 1e-14); // 13.5 > 5.991
/// # Ok::<(), garad_features::FeatureError>(())
/// ```
pub fn verify_flow(
    static_points: &[FlowPoint],
    suspects: &[FlowPoint],
    config: &FlowConfig,
) -> Result<FlowVerification, FeatureError> {
    let vectors: Vec<Vector2<f64>> = static_points
        .iter()
        .filter_map(|point| point.vector(config.form))
        .collect();
    let fit = fit_flow(&vectors, config)?;
    let verdicts = suspects
        .iter()
        .map(|suspect| {
            let Some(vector) = suspect.vector(config.form) else {
                return Ok(None);
            };
            finite(&vector)?;
            let FlowFit::Model(model) = &fit else {
                return Ok(None);
            };
            let distance2 = model.distance2(&vector);
            let inside = distance2 <= config.chi2;
            Ok(Some(FlowVerdict { inside, distance2 }))
        })
        .collect::<Result<_, FeatureError>>()?;
    Ok(FlowVerification { fit, verdicts })
}

fn finite(vector: &Vector2<f64>) -> Result<(), FeatureError> {
    if vector.x.is_finite() && vector.y.is_finite() {
        return Ok(());
    }
    let reason = "a flow vector is not finite";
    Err(FeatureError::Degenerate { reason })
}

#[cfg(test)]
mod tests;
