//! [`Suspect`]: an answer to be explained.

use crate::case::Case;

/// An answer agrees with another one to so many tolerances: both are rounded, and the other one may be larger.
const SLACK: f64 = 4.0;
/// Another answer explains this one if it is nearer than this share of the distance from the expected one.
const NEARER: f64 = 0.1;

/// An answer that is not within tolerance, and the means to try others.
pub(super) struct Suspect<'a> {
    pub(super) case: &'a Case,
    pub(super) output: &'a str,
    pub(super) shape: &'a [usize],
    pub(super) expected: &'a [f64],
    pub(super) got: &'a [f64],
    /// Whether other numbers in its place are within tolerance.
    pub(super) passes: &'a dyn Fn(&[f64]) -> bool,
}

impl Suspect<'_> {
    /// Length of the last axis, 1 for a scalar.
    pub(super) fn columns(&self) -> usize {
        self.shape.last().copied().unwrap_or(1).max(1)
    }

    /// Numbers per column.
    pub(super) fn rows(&self) -> usize {
        self.got.len() / self.columns()
    }

    /// The answer with another number in each place.
    pub(super) fn map(&self, f: impl Fn(usize, f64) -> f64) -> Vec<f64> {
        self.got.iter().enumerate().map(|(i, &g)| f(i, g)).collect()
    }

    /// The answer with element `from(i)` in place `i`.
    pub(super) fn gather(&self, from: impl Fn(usize) -> usize) -> Vec<f64> {
        (0..self.got.len()).map(|i| self.got[from(i)]).collect()
    }

    /// `name` if these numbers are within tolerance.
    pub(super) fn named(&self, name: &str, numbers: &[f64]) -> Option<String> {
        (self.passes)(numbers).then(|| name.to_owned())
    }

    /// Whether the answer is as far from these numbers as it may be from the expected ones, roundings of both included.
    /// Numbers that would pass themselves explain nothing, and neither do those that are hardly nearer.
    pub(super) fn agrees_with(&self, numbers: &[f64]) -> bool {
        if numbers.len() != self.got.len() || (self.passes)(numbers) {
            return false;
        }
        let distance = |from: &[f64]| -> f64 {
            let pairs = self.got.iter().zip(from).filter(|(g, _)| !g.is_nan());
            pairs.map(|(g, f)| (g - f) * (g - f)).sum::<f64>().sqrt()
        };
        if distance(numbers) > NEARER * distance(self.expected) {
            return false;
        }
        let rest = self.map(|i, g| {
            let off = g - numbers[i];
            let both_missing = g.is_nan() && numbers[i].is_nan();
            if both_missing || off == 0.0 {
                self.expected[i]
            } else {
                self.expected[i] + off / SLACK
            }
        });
        (self.passes)(&rest)
    }
}
