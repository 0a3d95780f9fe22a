//! [`explain`]: which usual slip turns an answer into the right one.
//!
//! A port that is wrong by a convention is wrong everywhere, and a table of errors says little. So
//! the answer is put through a short list of transformations; the one after which it is within
//! tolerance names the slip. What fits by chance is kept out: free factors and offsets are only
//! fitted where there are several times as many numbers as unknowns.

mod fits;
mod rearranged;
mod siblings;

use crate::case::Case;

/// An answer that is not within tolerance, and the means to try others.
pub(crate) struct Suspect<'a> {
    pub(crate) case: &'a Case,
    pub(crate) output: &'a str,
    pub(crate) shape: &'a [usize],
    pub(crate) expected: &'a [f64],
    pub(crate) got: &'a [f64],
    /// Whether other numbers in its place are within tolerance.
    pub(crate) passes: &'a dyn Fn(&[f64]) -> bool,
}

impl Suspect<'_> {
    /// Length of the last axis, 1 for a scalar.
    pub(crate) fn columns(&self) -> usize {
        self.shape.last().copied().unwrap_or(1).max(1)
    }

    /// Numbers per column.
    pub(crate) fn rows(&self) -> usize {
        self.got.len() / self.columns()
    }

    /// The answer with another number in each place.
    pub(crate) fn map(&self, f: impl Fn(usize, f64) -> f64) -> Vec<f64> {
        self.got.iter().enumerate().map(|(i, &g)| f(i, g)).collect()
    }

    /// The answer with element `from(i)` in place `i`.
    pub(crate) fn gather(&self, from: impl Fn(usize) -> usize) -> Vec<f64> {
        (0..self.got.len()).map(|i| self.got[from(i)]).collect()
    }

    /// `name` if these numbers are within tolerance.
    pub(crate) fn named(&self, name: &str, numbers: &[f64]) -> Option<String> {
        (self.passes)(numbers).then(|| name.to_owned())
    }
}

/// The slip that explains an answer, in words; `None` if none of the list does.
///
/// `got` has as many numbers as `expected`, both flat in C order under the shape of the case's output;
/// `passes` judges numbers in its place.
#[must_use]
pub fn explain(
    case: &Case,
    output: &str,
    expected: &[f64],
    got: &[f64],
    passes: &dyn Fn(&[f64]) -> bool,
) -> Option<String> {
    let suspect = Suspect {
        case,
        output,
        shape: case.output(output).shape(),
        expected,
        got,
        passes,
    };
    if got.is_empty() || got.len() != expected.len() || got.iter().any(|v| v.is_nan()) {
        return None;
    }
    rearranged::find(&suspect)
        .or_else(|| siblings::find(&suspect))
        .or_else(|| fits::find(&suspect))
}
