//! Quantiles of the χ² distribution: the thresholds of every test on whitened residuals.

/// 95 % with 2 degrees of freedom, to the digits the literature quotes: the gate of a reprojection
/// error (image coordinates), δ² of its Huber kernel, and the flow check of eq. 10.
pub const CHI2_2DOF_95: f64 = 5.991;

/// 95 % with 3 degrees of freedom: the gate of a reprojection error with a depth reading.
pub const CHI2_3DOF_95: f64 = 7.815;

/// The value that a χ² variable with 2 degrees of freedom stays below with probability `p`:
///
/// x = -2 ln(1 - p),   since P(χ² ≤ x) = 1 - exp(-x/2)
///
/// Infinite for 1, NaN outside [0, 1].
///
/// # Example
/// ```
/// let chi2 = garad_core::chi_square::chi2_2dof_quantile(0.95);
/// assert!((chi2 - 5.991464547107979).abs() < 1e-14); // -2 ln 0.05
/// ```
#[must_use]
pub fn chi2_2dof_quantile(p: f64) -> f64 {
    if p < 0.0 {
        return f64::NAN;
    }
    -2.0 * libm::log1p(-p)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_of_two_degrees() {
        let error = (chi2_2dof_quantile(0.95) - CHI2_2DOF_95).abs();
        assert!(error < 5e-4, "rounded to three decimals: {error}");
        let error = (chi2_2dof_quantile(0.5) - 2.0 * libm::log(2.0)).abs();
        assert!(error < 1e-15, "2 ln 2: {error}");
        assert!(chi2_2dof_quantile(0.0).abs() < 1e-300, "p = 0");
        assert!(chi2_2dof_quantile(1.0) == f64::INFINITY, "p = 1");
        for outside in [-0.1, 1.1, f64::NAN] {
            assert!(chi2_2dof_quantile(outside).is_nan(), "{outside}");
        }
    }

    /// P(χ² ≤ x) = erf(√(x/2)) - √(2x/π) exp(-x/2).
    #[test]
    fn quantile_of_three_degrees() {
        let x = CHI2_3DOF_95;
        let p = libm::erf((x / 2.0).sqrt())
            - (2.0 * x / std::f64::consts::PI).sqrt() * libm::exp(-x / 2.0);
        assert!((p - 0.95).abs() < 1e-5, "{p}");
    }
}
