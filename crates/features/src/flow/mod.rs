//! The flow check of the paper (sec. III-B): does a point move as the static scene does?
//!
//! The flow vectors of static points have a mean μ and a covariance Σ (eq. 9); a suspect whose own flow V
//! lies within the ellipse (eq. 10)
//!
//! (V - μ)ᵀ Σ⁻¹ (V - μ) ≤ χ²   (2 degrees of freedom)
//!
//! is static too. Reading order: [`config`] → [`estimate`] (μ and Σ; robust estimators for static points with
//! outliers) → [`model`] (the distance) → [`verify_flow`], which applies the model to suspects.
//!
//! One Gaussian for the whole image assumes that all static points have the same flow. When the camera
//! rolls, nears a wall, or sees near and far at once, the raw flow spreads, Σ grows, and nearly all
//! suspects pass. [`FlowForm::Residual`] first subtracts the flow predicted from the
//! camera's motion and the depth, so that only errors of measurement are left.

pub mod config;
pub mod estimate;
pub mod model;

use nalgebra::Vector2;

use crate::error::FeatureError;
use model::finite;

pub use config::{FlowConfig, FlowEstimator, FlowForm};
pub use model::{FlowFit, FlowModel, fit_flow};

/// The flow of one point from frame i to frame j.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlowPoint {
    /// Position found by Lucas-Kanade minus position before, pixels.
    pub flow: Vector2<f64>,
    /// Flow of a static point here, from the motion of the camera and the depth,
    /// pixels; `None` without depth. Not used with raw flow.
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

    /// The vector of the model; `None` if the form needs a prediction and there is none.
    fn vector(&self, form: FlowForm) -> Option<Vector2<f64>> {
        match form {
            FlowForm::Raw => Some(self.flow),
            FlowForm::Residual => self.predicted.map(|predicted| self.flow - predicted),
        }
    }
}

/// The result for one suspect.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FlowVerdict {
    /// χ² is at most [`FlowConfig::chi2`]: static.
    pub inside: bool,
    /// χ² of eq. 10.
    pub distance2: f64,
}

/// The model and the results of the suspects.
#[derive(Debug, Clone, PartialEq)]
pub struct FlowVerification {
    /// The model, or why there is none.
    pub fit: FlowFit,
    /// One per suspect; `None` where nothing is decided: no model, or no prediction for it.
    pub verdicts: Vec<Option<FlowVerdict>>,
}

/// Fits the flow of static points and compares suspects with it.
///
/// μ = 1/n Σ Vₖ,   Σ = 1/(n-1) Σ (Vₖ - μ)(Vₖ - μ)ᵀ + floor I                  (eq. 9)
///
/// χ² = (V - μ)ᵀ Σ⁻¹ (V - μ),   inside if χ² ≤ `chi2`                         (eq. 10)
///
/// Without a model (switched off, too few static points, or all on a line and no floor) nothing is
/// decided and the labels stay as they were.
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
/// let config = FlowConfig { min_support: 4, ..FlowConfig::as_printed() };
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
    if !config.enabled {
        return Ok(FlowVerification {
            fit: FlowFit::Disabled,
            verdicts: vec![None; suspects.len()],
        });
    }
    let vectors: Vec<Vector2<f64>> = static_points
        .iter()
        .filter_map(|point| point.vector(config.model))
        .collect();
    let fit = fit_flow(&vectors, config)?;
    let verdicts = suspects
        .iter()
        .map(|suspect| {
            let Some(vector) = suspect.vector(config.model) else {
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

#[cfg(test)]
mod tests;
