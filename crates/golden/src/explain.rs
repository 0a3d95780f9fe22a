//! [`explain`]: which usual mistake turns an answer into the right one.
//!
//! A port that is wrong by a convention is wrong everywhere, and a table of errors says little. So
//! the answer is put through a short list of transformations; the one after which it is within
//! tolerance names the mistake. What fits by chance is kept out: free factors and offsets are only
//! fitted where there are several times as many numbers as unknowns. A mistake inside a formula cannot be undone in the
//! answer; the stage is computed again with it.

mod fits;
mod readings;
mod rearranged;
mod siblings;
mod suspect;

use crate::case::Case;
use suspect::Suspect;

/// The mistake that explains an answer, in words; `None` if none of the list does.
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
    if got.is_empty() || got.len() != expected.len() {
        return None;
    }
    let known = |s: &Suspect<'_>| {
        rearranged::find(s)
            .or_else(|| siblings::find(s))
            .or_else(|| fits::find(s))
    };
    // Of flags nearly any change is some rearrangement.
    let mut values: Vec<u64> = expected.iter().map(|v| v.to_bits()).collect();
    values.sort_unstable();
    values.dedup();
    let varied = got.len() == 1 || values.len() > 2;
    let complete = got.iter().all(|v| !v.is_nan());
    let rearranged = || (varied && complete).then(|| known(&suspect)).flatten();
    readings::find(&suspect).or_else(rearranged)
}
