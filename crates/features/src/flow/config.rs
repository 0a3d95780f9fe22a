//! [`FlowConfig`]: the settings of the flow check.

use garad_core::chi_square::CHI2_2DOF_95;
use serde::{Deserialize, Serialize};

use crate::error::{FeatureError, setting};

/// How suspects are checked; the defaults are the pipeline's (decision 005).
///
/// # Example
/// ```
/// use garad_features::flow::{FlowConfig, FlowEstimator, FlowForm};
/// let printed = FlowConfig::as_printed();
/// assert_eq!((printed.model, printed.estimator), (FlowForm::Raw, FlowEstimator::Moments));
/// assert_eq!((printed.covariance_floor_px2, printed.chi2), (0.0, 5.991));
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FlowConfig {
    /// Off (`--without flow`): nothing is verified, suspects keep their labels.
    pub enabled: bool,
    /// The vectors of the model: flow as measured, or without the camera's part.
    pub model: FlowForm,
    /// Estimator of mean and covariance.
    pub estimator: FlowEstimator,
    /// Added to both variances, px². The flows of a camera at rest are nearly equal: their covariance
    /// is that of rounding, and the least noise would be outside. 0 is the literal eq. 9.
    pub covariance_floor_px2: f64,
    /// Static points a model needs; at least 3, as two lie on a line.
    pub min_support: usize,
    /// Largest χ² of a suspect that counts as static.
    pub chi2: f64,
}

/// The vectors of the flow model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FlowForm {
    /// The flow as measured: the paper.
    Raw,
    /// The measured flow minus the predicted one. Points without a prediction are left out.
    Residual,
}

/// Estimator of mean and covariance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FlowEstimator {
    /// Sample mean and covariance with n - 1: eq. 9. One outlier moves both.
    Moments,
    /// Per axis the median, and the median absolute deviation as a standard deviation; the axes
    /// count as uncorrelated. Tolerates up to half of the vectors being outliers.
    MedianMad,
    /// The moments of the vectors that lie within 95 % of the Gaussian of
    /// [`FlowEstimator::MedianMad`], the covariance enlarged by what a Gaussian with uncorrelated
    /// axes loses by that cut. Tolerates as many outliers unless they are close by, and estimates the
    /// correlation.
    Trimmed,
}

impl Default for FlowConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            model: FlowForm::Residual,
            estimator: FlowEstimator::Trimmed,
            covariance_floor_px2: 0.04,
            min_support: 10,
            chi2: CHI2_2DOF_95,
        }
    }
}

impl FlowConfig {
    /// Eq. 9 and 10 to the letter: raw flow, plain moments, no floor.
    #[must_use]
    pub fn as_printed() -> Self {
        Self {
            model: FlowForm::Raw,
            estimator: FlowEstimator::Moments,
            covariance_floor_px2: 0.0,
            ..Self::default()
        }
    }

    /// # Errors
    /// [`FeatureError::BadSetting`] with the first setting outside its range.
    pub fn validate(&self) -> Result<(), FeatureError> {
        let (floor, support, chi2) = (self.covariance_floor_px2, self.min_support, self.chi2);
        let expected = "pixels squared, finite and not negative";
        let valid = floor >= 0.0 && floor.is_finite();
        setting("covariance_floor_px2", floor, expected, valid)?;
        let valid = support >= 3;
        setting("min_support", support as f64, "at least 3 points", valid)?;
        let valid = chi2 > 0.0 && chi2.is_finite();
        setting("chi2", chi2, "a positive number", valid)
    }
}
