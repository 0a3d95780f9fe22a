//! [`Stats`]: summary of a list of errors, as in papers.

use serde::{Deserialize, Serialize};

use crate::EvalError;

/// Summary of n errors e, in their unit.
///
/// rmse = √(Σe²/n), mean = Σe/n, std = √(Σ(e - mean)²/n), sse = Σe²
///
/// `std` is that of the population (divided by n, as evo and numpy do), so rmse² = mean² + std².
/// `median` is the mean of the two middle values when n is even.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Stats {
    /// Root of the mean square.
    pub rmse: f64,
    /// Arithmetic mean.
    pub mean: f64,
    /// Middle value.
    pub median: f64,
    /// Population standard deviation.
    pub std: f64,
    /// Smallest.
    pub min: f64,
    /// Largest.
    pub max: f64,
    /// Sum of squares.
    pub sse: f64,
    /// How many errors.
    pub pairs: usize,
}

impl Stats {
    /// Summary of `errors`, summed in their order.
    ///
    /// # Errors
    /// [`EvalError::TooFew`] for an empty list, [`EvalError::NonFinite`] for NaN or infinity.
    pub fn of(errors: &[f64]) -> Result<Self, EvalError> {
        let pairs = errors.len();
        if pairs == 0 {
            return Err(EvalError::TooFew {
                what: "errors",
                got: 0,
                needed: 1,
            });
        }
        if let Some(index) = errors.iter().position(|e| !e.is_finite()) {
            return Err(EvalError::NonFinite {
                what: "error",
                index,
            });
        }
        let n = pairs as f64;
        let sum = |f: &dyn Fn(f64) -> f64| errors.iter().fold(0.0, |sum, &e| sum + f(e));
        let sse = sum(&|e| e * e);
        let mean = sum(&|e| e) / n;
        let mut sorted = errors.to_vec();
        sorted.sort_by(f64::total_cmp);
        Ok(Self {
            rmse: (sse / n).sqrt(),
            mean,
            median: 0.5 * (sorted[(pairs - 1) / 2] + sorted[pairs / 2]),
            std: (sum(&|e| (e - mean) * (e - mean)) / n).sqrt(),
            min: sorted[0],
            max: sorted[pairs - 1],
            sse,
            pairs,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hand_numbers() {
        let stats = Stats::of(&[3.0, 1.0, 2.0, 6.0]).expect("four errors");
        let expected = Stats {
            rmse: 12.5f64.sqrt(),
            mean: 3.0,
            median: 2.5,
            std: 3.5f64.sqrt(), // (0 + 4 + 1 + 9) / 4, not / 3
            min: 1.0,
            max: 6.0,
            sse: 50.0,
            pairs: 4,
        };
        assert_eq!(stats, expected, "even count");
        let odd = Stats::of(&[5.0, 1.0, 2.0]).expect("three errors");
        assert!((odd.median - 2.0).abs() < 1e-15, "odd count: {odd:?}");
    }

    #[test]
    fn empty_lists_and_nan_are_errors() {
        let nothing = Stats::of(&[]);
        assert_eq!(
            nothing,
            Err(EvalError::TooFew {
                what: "errors",
                got: 0,
                needed: 1
            }),
            "empty"
        );
        let nan = EvalError::NonFinite {
            what: "error",
            index: 1,
        };
        assert_eq!(Stats::of(&[0.0, f64::NAN]), Err(nan), "NaN");
    }
}
