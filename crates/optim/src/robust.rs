//! [`RobustKernel`]: limits the influence of large residuals.
//!
//! A kernel acts on the squared norm s = ‖r‖² of a whitened residual *block*: the cost of a
//! problem is F = ½ Σ ρ(sᵢ), its gradient Σ ρ'(sᵢ) Jᵢᵀ rᵢ. Every kernel has ρ(0) = 0 and ρ'(0) = 1,
//! so that small residuals count as without one. (A kernel on each scalar residual, as in
//! scipy's `loss="huber"`, is another function.)

/// ρ(s) and its derivative, the weight of a block in the normal equations.
///
/// | kernel | ρ(s) | ρ'(s) |
/// |---|---|---|
/// | none | s | 1 |
/// | Huber, s ≤ δ² | s | 1 |
/// | Huber, s > δ² | 2 δ √s - δ² | δ / √s |
/// | Cauchy | c² ln(1 + s/c²) | 1 / (1 + s/c²) |
/// | Geman-McClure | s / (1 + s/c²) | 1 / (1 + s/c²)² |
/// | Tukey, s ≤ c² | c²/3 (1 - (1 - s/c²)³) | (1 - s/c²)² |
/// | Tukey, s > c² | c²/3 | 0 |
///
/// Huber is convex in r and its influence never falls; that of the last three falls to 0, and they need a good
/// start. Under Geman-McClure no block costs more than c², and no influence is exactly 0.
///
/// # Example
/// ```
/// use garad_optim::RobustKernel;
/// let huber = RobustKernel::Huber { delta: 2.0 };
/// assert_eq!((huber.rho(4.0), huber.weight(4.0)), (4.0, 1.0)); // at the knee
/// assert_eq!((huber.rho(9.0), huber.weight(16.0)), (8.0, 0.5)); // linear in r beyond it
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum RobustKernel {
    /// Plain least squares.
    #[default]
    None,
    /// Quadratic, then linear in ‖r‖.
    Huber {
        /// Norm of the residual at the knee.
        delta: f64,
    },
    /// Logarithmic.
    Cauchy {
        /// Norm of the residual whose weight is ½.
        c: f64,
    },
    /// Tends to c².
    GemanMcClure {
        /// Norm of the residual whose weight is ¼.
        c: f64,
    },
    /// Constant from c on.
    Tukey {
        /// Norm of the residual from which on it counts no more.
        c: f64,
    },
}

impl RobustKernel {
    /// ρ(s), s = ‖r‖² ≥ 0.
    #[inline]
    #[must_use]
    pub fn rho(self, s: f64) -> f64 {
        match self {
            Self::None => s,
            Self::Huber { delta } if s <= delta * delta => s,
            Self::Huber { delta } => 2.0 * delta * s.sqrt() - delta * delta,
            Self::Cauchy { c } => c * c * libm::log1p(s / (c * c)),
            Self::GemanMcClure { c } => s / (1.0 + s / (c * c)),
            Self::Tukey { c } => {
                let x = (s / (c * c)).min(1.0);
                // 1 - (1 - x)³ without the difference of two numbers near 1
                c * c * x * (1.0 - x + x * x / 3.0)
            }
        }
    }

    /// ρ'(s): 1 for small residuals, less for large ones.
    #[inline]
    #[must_use]
    pub fn weight(self, s: f64) -> f64 {
        match self {
            Self::None => 1.0,
            Self::Huber { delta } if s <= delta * delta => 1.0,
            Self::Huber { delta } => delta / s.sqrt(),
            Self::Cauchy { c } => 1.0 / (1.0 + s / (c * c)),
            Self::GemanMcClure { c } => {
                let x = 1.0 + s / (c * c);
                1.0 / (x * x)
            }
            Self::Tukey { c } => {
                let x = (s / (c * c)).min(1.0);
                (1.0 - x) * (1.0 - x)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn kernels(scale: f64) -> [RobustKernel; 5] {
        [
            RobustKernel::None,
            RobustKernel::Huber { delta: scale },
            RobustKernel::Cauchy { c: scale },
            RobustKernel::GemanMcClure { c: scale },
            RobustKernel::Tukey { c: scale },
        ]
    }

    /// The table above, typed again.
    fn spec(kernel: RobustKernel, s: f64) -> f64 {
        match kernel {
            RobustKernel::None => s,
            RobustKernel::Huber { delta } if s > delta * delta => {
                2.0 * delta * s.sqrt() - delta * delta
            }
            RobustKernel::Huber { .. } => s,
            RobustKernel::Cauchy { c } => c * c * libm::log(1.0 + s / (c * c)),
            RobustKernel::GemanMcClure { c } => c * c * s / (c * c + s),
            RobustKernel::Tukey { c } if s > c * c => c * c / 3.0,
            RobustKernel::Tukey { c } => {
                let inside = 1.0 - s / (c * c);
                c * c / 3.0 * (1.0 - inside * inside * inside)
            }
        }
    }

    #[test]
    fn a_zero_residual_has_cost_0_and_weight_1() {
        for kernel in kernels(1.7) {
            assert!(kernel.rho(0.0).abs() < 1e-300, "{kernel:?}: rho(0)");
            assert!(
                (kernel.weight(0.0) - 1.0).abs() < 1e-15,
                "{kernel:?}: rho'(0)"
            );
        }
    }

    #[test]
    fn value_and_slope_are_continuous_at_the_knee() {
        let scale = 1.3;
        let knee = scale * scale;
        for kernel in kernels(scale) {
            let (below, above) = (knee * (1.0 - 1e-12), knee * (1.0 + 1e-12));
            let jump = kernel.rho(above) - kernel.rho(below);
            assert!(jump.abs() < 1e-11, "{kernel:?}: value jumps by {jump}");
            let jump = kernel.weight(above) - kernel.weight(below);
            assert!(jump.abs() < 1e-11, "{kernel:?}: slope jumps by {jump}");
        }
    }

    #[test]
    fn influence_of_a_large_residual() {
        // Influence |d(rho/2)/dr| = r rho'(r²): r, delta, about c²/r, about c⁴/r³, 0.
        let influence = kernels(2.0).map(|k| 1000.0 * k.weight(1e6));
        assert!((influence[0] - 1000.0).abs() < 1e-9, "none: {influence:?}");
        assert!((influence[1] - 2.0).abs() < 1e-12, "Huber: {influence:?}");
        assert!((influence[2] - 4e-3).abs() < 1e-7, "Cauchy: {influence:?}");
        assert!((influence[3] - 16e-9).abs() < 1e-12, "G-McC: {influence:?}");
        assert!(influence[4].abs() < 1e-300, "Tukey: {influence:?}");
    }

    proptest! {
        #[test]
        fn formulas_are_those_of_the_table(s in 0.0f64..50.0, scale in 0.2f64..5.0) {
            for kernel in kernels(scale) {
                let (rho, expected) = (kernel.rho(s), spec(kernel, s));
                prop_assert!((rho - expected).abs() <= 1e-13 * (1.0 + s), "{kernel:?}: {rho} {expected}");
            }
        }

        /// The weight is the slope of rho, on both sides of the knee.
        #[test]
        fn the_weight_is_the_derivative(s in 0.01f64..50.0, scale in 0.2f64..5.0) {
            prop_assume!((s.sqrt() - scale).abs() > 1e-3);
            let h = 1e-5 * s;
            for kernel in kernels(scale) {
                let slope = (kernel.rho(s + h) - kernel.rho(s - h)) / (2.0 * h);
                prop_assert!((slope - kernel.weight(s)).abs() < 1e-7, "{kernel:?}: {slope}");
            }
        }
    }
}
