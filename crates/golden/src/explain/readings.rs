//! The answers that usual mistakes would give, computed from the inputs.
//!
//! A mistake inside a formula leaves no factor or order that could be undone in the answer. So the stage is computed again
//! with one mistake of a table at a time, by plain formulas of docs/math.md in f64; the one whose result the answer agrees with, to
//! the tolerance of the output, is named.

mod colour;
mod field;
mod harmonics;
mod images;
mod reprojection;
mod splats;
mod training;

use super::suspect::Suspect;

/// A larger case gets no readings where each would take more terms: kernel values, or splats at pixels. Every one of a table
/// is computed by the plain formula, and a small case with the same mistake names it.
const MAX_TERMS: usize = 4_000_000;

/// A mistake and the numbers it leads to.
type Reading = (&'static str, Vec<f64>);
/// The readings of one output; `None` if the case lacks an input.
type Readings = fn(&Suspect<'_>) -> Option<Vec<Reading>>;

const STAGES: &[(&str, Readings)] = &[
    ("projection_covariance", splats::readings),
    ("raster", images::readings),
    ("raster_backward", colour::readings),
    ("reprojection", reprojection::readings),
    ("kernel", field::kernel),
    ("mean_field", field::mean_field),
    ("robust", field::robust),
    ("adam", training::adam),
    ("losses", training::losses),
];

/// Tries every mistake of the stage's table.
pub(super) fn find(s: &Suspect<'_>) -> Option<String> {
    let (_, readings) = STAGES.iter().find(|(stage, _)| *stage == s.case.stage())?;
    let mut all = readings(s)?.into_iter();
    all.find(|(_, numbers)| s.agrees_with(numbers))
        .map(|(name, _)| name.to_owned())
}
