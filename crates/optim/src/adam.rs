//! [`Adam`] and [`sgd`]: descent along a gradient, parameter by parameter.
//!
//! A group is one array of the map, as a flat slice (`as_flattened_mut`), with its own learning
//! rate and its own [`Adam`]. Rows come and go as the map grows and is pruned: [`Adam::retain`],
//! [`Adam::extend`].

use garad_core::Real;
use serde::{Deserialize, Serialize};

use crate::error::{OptimError, positive};

/// Decay rates of the moments, and ε.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct AdamConfig {
    /// Share of the mean gradient kept per step; its time constant is 1/(1 - β₁) steps.
    pub beta1: f64,
    /// The same for the mean square.
    pub beta2: f64,
    /// Added to the root of the mean square. With the small value of 3D Gaussian Splatting it only
    /// avoids 0/0, and steps do not depend on the size of the gradients.
    pub eps: f64,
}

impl Default for AdamConfig {
    /// 0.9, 0.999, 1e-15. Source: 3D Gaussian Splatting.
    fn default() -> Self {
        Self {
            beta1: 0.9,
            beta2: 0.999,
            eps: 1e-15,
        }
    }
}

/// Adam's state for one group of `rows` rows of `width` numbers.
///
/// m ← β₁ m + (1 - β₁) g,   v ← β₂ v + (1 - β₂) g²,
/// p ← p - η m̂/(√v̂ + ε),   m̂ = m/(1 - β₁ᵗ),   v̂ = v/(1 - β₂ᵗ)                            (O6)
///
/// Source: Kingma & Ba 2015, Alg. 1. Golden: `adam/*`.
///
/// # Example
/// The first step is the learning rate, whatever the size of the gradient:
/// ```
/// use garad_optim::{Adam, AdamConfig};
/// let mut parameters = [1.0f64, 1.0];
/// let mut adam = Adam::new(AdamConfig::default(), 2, 1)?;
/// adam.step(&mut parameters, &[1e-4, -1e4], 0.1)?;
/// assert!((parameters[0] - 0.9).abs() < 1e-10 && (parameters[1] - 1.1).abs() < 1e-10);
/// # Ok::<(), garad_optim::OptimError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Adam<T> {
    config: AdamConfig,
    width: usize,
    /// (m, v) of each number.
    moments: Vec<[T; 2]>,
    /// β₁ᵗ and β₂ᵗ.
    beta_powers: [f64; 2],
}

impl<T: Real> Adam<T> {
    /// No step yet.
    ///
    /// # Errors
    /// [`OptimError`] unless both betas lie inside (0, 1) and `eps` and `width` are positive.
    pub fn new(config: AdamConfig, rows: usize, width: usize) -> Result<Self, OptimError> {
        for (index, beta) in [(1, config.beta1), (2, config.beta2)] {
            positive("beta", index, beta)?;
            positive("1 - beta", index, 1.0 - beta)?;
        }
        positive("eps", 0, config.eps)?;
        positive("width", 0, width as f64)?;
        Ok(Self {
            config,
            width,
            moments: vec![[T::ZERO; 2]; rows * width],
            beta_powers: [1.0; 2],
        })
    }

    /// Number of rows.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.moments.len() / self.width
    }

    /// (m, v) of each number, row by row.
    #[must_use]
    pub fn moments(&self) -> &[[T; 2]] {
        &self.moments
    }

    /// One step down `gradient` (O6), the learning rate η in units of the parameters.
    ///
    /// # Numerics
    /// Elementwise in `T`; the corrections for the start, 1 - βᵗ, in f64.
    /// # Errors
    /// [`OptimError::SizeMismatch`]; [`OptimError::NotFinite`] for a gradient, which would stay in
    /// the moments for good; a learning rate below 0. State and parameters are then as before.
    pub fn step(
        &mut self,
        parameters: &mut [T],
        gradient: &[T],
        learning_rate: f64,
    ) -> Result<(), OptimError> {
        self.step_by_column(parameters, gradient, &vec![learning_rate; self.width])
    }

    /// [`Adam::step`] with a learning rate for each of the `width` columns.
    ///
    /// # Errors
    /// As [`Adam::step`]; [`OptimError::SizeMismatch`] unless there is a rate per column.
    pub fn step_by_column(
        &mut self,
        parameters: &mut [T],
        gradient: &[T],
        learning_rates: &[f64],
    ) -> Result<(), OptimError> {
        same_length("parameters", self.moments.len(), parameters.len())?;
        same_length("learning rates", self.width, learning_rates.len())?;
        for rate in learning_rates {
            check_rate(*rate)?;
        }
        check_gradient(parameters, gradient)?;
        let AdamConfig { beta1, beta2, eps } = self.config;
        self.beta_powers[0] *= beta1;
        self.beta_powers[1] *= beta2;
        let [correction1, correction2] = self.beta_powers.map(|power| 1.0 - power);
        let c = T::from_f64;
        let (keep1, add1) = (c(beta1), c(1.0 - beta1));
        let (keep2, add2) = (c(beta2), c(1.0 - beta2));
        let rates: Vec<T> = learning_rates.iter().map(|r| c(r / correction1)).collect();
        let (root, eps) = (c(correction2).sqrt(), c(eps));
        let rows = parameters
            .chunks_exact_mut(self.width)
            .zip(gradient.chunks_exact(self.width))
            .zip(self.moments.chunks_exact_mut(self.width));
        for ((p, g), moments) in rows {
            for (((p, &g), [m, v]), &rate) in p.iter_mut().zip(g).zip(moments).zip(&rates) {
                *m = keep1 * *m + add1 * g;
                *v = keep2 * *v + add2 * g * g;
                *p -= rate * (*m / (v.sqrt() / root + eps));
            }
        }
        Ok(())
    }

    /// Rows of `width` numbers from now on, none fewer than before; the moments of new columns
    /// are 0.
    ///
    /// # Errors
    /// [`OptimError::SizeMismatch`] for fewer columns.
    pub fn widen(&mut self, width: usize) -> Result<(), OptimError> {
        if width < self.width {
            return same_length("columns", self.width, width);
        }
        let mut moments = Vec::with_capacity(self.rows() * width);
        for row in self.moments.chunks_exact(self.width) {
            moments.extend_from_slice(row);
            moments.resize(moments.len() + width - self.width, [T::ZERO; 2]);
        }
        self.moments = moments;
        self.width = width;
        Ok(())
    }

    /// Removes the rows that are `false`; the others keep their moments.
    ///
    /// # Errors
    /// [`OptimError::SizeMismatch`].
    pub fn retain(&mut self, keep: &[bool]) -> Result<(), OptimError> {
        same_length("rows to keep", self.rows(), keep.len())?;
        let rows = self.moments.chunks_exact(self.width).zip(keep);
        self.moments = rows
            .filter(|&(_, &keep)| keep)
            .flat_map(|(row, _)| row.iter().copied())
            .collect();
        Ok(())
    }

    /// Appends rows with moments 0. The count of steps goes on, as in 3D Gaussian Splatting: a
    /// new row starts as one whose gradients have been 0 so far. Its first step, at late t, is
    /// η (1 - β₁)/√(1 - β₂), about three times the learning rate.
    pub fn extend(&mut self, rows: usize) {
        let len = self.moments.len() + rows * self.width;
        self.moments.resize(len, [T::ZERO; 2]);
    }
}

/// One step of plain gradient descent, p ← p - η g (O7).
///
/// # Errors
/// As [`Adam::step`]; the parameters are then as before.
/// # Example
/// ```
/// let mut parameters = [1.0f64, 2.0];
/// garad_optim::sgd(&mut parameters, &[0.5, -4.0], 0.25)?;
/// assert_eq!(parameters, [0.875, 3.0]);
/// # Ok::<(), garad_optim::OptimError>(())
/// ```
pub fn sgd<T: Real>(
    parameters: &mut [T],
    gradient: &[T],
    learning_rate: f64,
) -> Result<(), OptimError> {
    check_rate(learning_rate)?;
    check_gradient(parameters, gradient)?;
    let rate = T::from_f64(learning_rate);
    for (p, &g) in parameters.iter_mut().zip(gradient) {
        *p -= rate * g;
    }
    Ok(())
}

/// 0 leaves a group unchanged.
fn check_rate(learning_rate: f64) -> Result<(), OptimError> {
    if learning_rate.is_finite() && learning_rate >= 0.0 {
        Ok(())
    } else {
        positive("learning rate", 0, learning_rate)
    }
}

fn check_gradient<T: Real>(parameters: &[T], gradient: &[T]) -> Result<(), OptimError> {
    same_length("gradient", parameters.len(), gradient.len())?;
    match gradient.iter().position(|g| !g.is_finite()) {
        Some(index) => Err(OptimError::NotFinite {
            what: "gradient",
            index,
        }),
        None => Ok(()),
    }
}

fn same_length(what: &'static str, expected: usize, got: usize) -> Result<(), OptimError> {
    if got == expected {
        Ok(())
    } else {
        Err(OptimError::SizeMismatch {
            what,
            got,
            expected,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn adam(rows: usize, width: usize) -> Adam<f64> {
        Adam::new(AdamConfig::default(), rows, width).expect("valid settings")
    }

    #[test]
    fn columns_have_their_own_rates_and_new_ones_start_at_rest() {
        let mut state = adam(2, 1);
        let mut p = [1.0, 2.0];
        state.step(&mut p, &[1.0, -1.0], 0.1).expect("a step");
        state.widen(2).expect("wider");
        assert_eq!(state.rows(), 2, "as many rows");
        let mut wide = [p[0], 0.0, p[1], 0.0];
        let mut apart = adam(2, 1);
        let mut alone = [1.0, 2.0];
        apart.step(&mut alone, &[1.0, -1.0], 0.1).expect("a step");
        apart.step(&mut alone, &[0.5, 0.5], 0.1).expect("a step");
        state
            .step_by_column(&mut wide, &[0.5, 1.0, 0.5, 1.0], &[0.1, 0.0])
            .expect("a step");
        assert_eq!(
            [wide[0], wide[2]].map(f64::to_bits),
            alone.map(f64::to_bits),
            "the old column goes on as it was"
        );
        assert_eq!(
            [wide[1], wide[3]].map(f64::to_bits),
            [0; 2],
            "a rate of 0 is rest"
        );
        assert!(state.widen(1).is_err(), "never narrower");
        assert!(
            state.step_by_column(&mut wide, &[0.0; 4], &[0.1]).is_err(),
            "a rate per column"
        );
    }

    #[test]
    fn two_steps_by_hand() {
        let config = AdamConfig {
            beta1: 0.5,
            beta2: 0.75,
            eps: 1e-15,
        };
        let mut state = Adam::new(config, 1, 1).expect("valid");
        let mut p = [1.0f64];
        state.step(&mut p, &[2.0], 0.1).expect("a step");
        // m = 1, v = 1; m̂ = 2, v̂ = 4.
        assert!((p[0] - 0.9).abs() < 1e-15, "first: {}", p[0]);
        state.step(&mut p, &[-1.0], 0.1).expect("a step");
        // m = 0, v = 1: the pulls cancel.
        assert!((p[0] - 0.9).abs() < 1e-15, "second: {}", p[0]);
        state.step(&mut p, &[1.0], 0.1).expect("a step");
        // m = ½, v = 1; m̂ = ½/(7/8), v̂ = 1/(37/64).
        let step = 0.1 * (4.0 / 7.0) * (37.0f64 / 64.0).sqrt();
        assert!((p[0] - 0.9 + step).abs() < 1e-15, "third: {}", p[0]);
    }

    /// β = (½, ¾), ε = 3: after g = 2, m̂ = 2 and √v̂ = 2; a row that comes then has, after g = 4, m = 2 and v = 4, and t = 2
    /// as the others: m̂ = 2/(3/4), v̂ = 4/(7/16).
    #[test]
    fn rows_that_come_and_go_and_columns_by_hand() {
        let config = AdamConfig {
            beta1: 0.5,
            beta2: 0.75,
            eps: 3.0,
        };
        let mut state = Adam::new(config, 2, 2).expect("valid");
        let mut p = vec![1.0f64, 2.0, 3.0, 4.0];
        state
            .step_by_column(&mut p, &[2.0, -2.0, 4.0, 0.0], &[0.5, 0.25])
            .expect("a step");
        // rate m̂/(√v̂ + 3): 2/5 and 4/7
        let expected = [
            1.0 - 0.5 * 0.4,
            2.0 + 0.25 * 0.4,
            3.0 - 0.5 * 4.0 / 7.0,
            4.0,
        ];
        let close = |p: &[f64], expected: &[f64]| {
            p.len() == expected.len() && p.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-15)
        };
        assert!(close(&p, &expected), "{p:?} {expected:?}");
        state.retain(&[false, true]).expect("two rows");
        state.extend(1);
        assert_eq!(state.rows(), 2, "one went, one came");
        let mut p = vec![0.0; 4];
        state
            .step_by_column(&mut p, &[-4.0, 0.0, 4.0, -8.0], &[0.5, 0.25])
            .expect("a step");
        // The old row: m = 2, v = 4, then m = 1 - 2, v = 3 + 4. The new one: m = g/2, v = g²/4.
        let step =
            |rate: f64, m: f64, v: f64| -rate * (m / 0.75) / ((v / (7.0 / 16.0)).sqrt() + 3.0);
        let expected = [
            step(0.5, -1.0, 7.0),
            0.0,
            step(0.5, 2.0, 4.0),
            step(0.25, -4.0, 16.0),
        ];
        assert!(close(&p, &expected), "{p:?} {expected:?}");
    }

    #[test]
    fn no_gradient_no_step() {
        let mut p = [1.0f32, -2.0];
        let mut state = Adam::new(AdamConfig::default(), 1, 2).expect("valid");
        for _ in 0..5 {
            state.step(&mut p, &[0.0, 0.0], 0.1).expect("a step");
        }
        assert_eq!(
            p.map(f32::to_bits),
            [1.0f32, -2.0].map(f32::to_bits),
            "0/eps is 0"
        );
    }

    /// A quadratic bowl 10⁶ times steeper one way than the other.
    #[test]
    fn a_bowl_of_any_shape_is_descended() {
        let mut p = [1.0f64, 1.0];
        let mut state = adam(2, 1);
        for t in 0..2000 {
            let gradient = [1e3 * p[0], 1e-3 * p[1]];
            state
                .step(&mut p, &gradient, 0.02 / (1.0 + f64::from(t) / 50.0))
                .expect("a step");
        }
        assert!(p.iter().all(|x| x.abs() < 1e-3), "{p:?}");
    }

    proptest! {
        /// A state that followed removal and insertion goes on like one that never knew the others.
        #[test]
        fn rows_do_not_know_each_other(
            gradients in proptest::collection::vec(-1.0f64..1.0, 6 * 8),
            keep in proptest::array::uniform4(any::<bool>()),
        ) {
            let mut p = [0.0f64; 8]; // 4 rows of 2
            let mut state = adam(4, 2);
            let mut steps = gradients.chunks(8);
            for g in steps.by_ref().take(3) {
                state.step(&mut p, g, 0.01).expect("a step");
            }
            let kept: Vec<usize> = (0..8).filter(|i| keep[i / 2]).collect();
            let (mut part, mut p_part) = (state.clone(), kept.iter().map(|&i| p[i]).collect::<Vec<_>>());
            part.retain(&keep).expect("four rows");
            part.extend(1);
            p_part.extend([5.0, 5.0]);
            for g in steps {
                state.step(&mut p, g, 0.01).expect("a step");
                let mut g_part: Vec<f64> = kept.iter().map(|&i| g[i]).collect();
                g_part.extend([0.0, 0.0]);
                part.step(&mut p_part, &g_part, 0.01).expect("a step");
            }
            let expected: Vec<f64> = kept.iter().map(|&i| p[i]).chain([5.0, 5.0]).collect();
            prop_assert_eq!(part.rows(), kept.len() / 2 + 1);
            prop_assert_eq!(p_part, expected);
        }
    }

    #[test]
    fn invalid_input_is_an_error_and_changes_nothing() {
        let (mut state, mut p) = (adam(1, 2), [1.0, 2.0]);
        let before = state.clone();
        let nan = state.step(&mut p, &[0.0, f64::NAN], 0.1);
        assert_eq!(
            nan,
            Err(OptimError::NotFinite {
                what: "gradient",
                index: 1
            }),
            "NaN"
        );
        let short = state.step(&mut p, &[0.0], 0.1);
        assert!(
            matches!(
                short,
                Err(OptimError::SizeMismatch {
                    what: "gradient",
                    ..
                })
            ),
            "{short:?}"
        );
        let short = state.step(&mut p[..1], &[0.0], 0.1);
        assert!(
            matches!(
                short,
                Err(OptimError::SizeMismatch {
                    what: "parameters",
                    ..
                })
            ),
            "{short:?}"
        );
        for rate in [-0.1, f64::NAN, f64::INFINITY] {
            assert!(
                state.step(&mut p, &[1.0, 1.0], rate).is_err(),
                "rate {rate}"
            );
            assert!(sgd(&mut p, &[1.0, 1.0], rate).is_err(), "rate {rate}");
        }
        assert!(state.retain(&[true, true]).is_err(), "one row");
        assert!(sgd(&mut p, &[f64::INFINITY, 0.0], 0.1).is_err(), "infinite");
        assert_eq!((state, p), (before, [1.0, 2.0]), "untouched");
        for (beta1, beta2, eps, width) in [
            (1.0, 0.9, 1e-8, 1),
            (0.9, 0.0, 1e-8, 1),
            (0.9, f64::NAN, 1e-8, 1),
            (0.9, 0.9, 0.0, 1),
            (0.9, 0.9, 1e-8, 0),
        ] {
            let config = AdamConfig { beta1, beta2, eps };
            assert!(
                Adam::<f64>::new(config, 1, width).is_err(),
                "{config:?}, {width}"
            );
        }
    }
}
