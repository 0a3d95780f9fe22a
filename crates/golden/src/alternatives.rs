//! [`nearest`]: answers to problems with several solutions.
//!
//! Three points are seen alike from up to four poses, and nothing in the inputs says which of them is the camera's. An
//! answer to such a case may hold all of them, as one more axis after the first with NaN in the places left over. In
//! each row the solution nearest to the expected one, over all outputs together, is the one judged.

use std::borrow::Cow;

use crate::answers::Answers;
use crate::case::Case;
use crate::tensor::Tensor;

/// Stage and flag of the cases that may be answered so, and the largest number of solutions.
pub(crate) const SEVERAL: &[(&str, &str, usize)] = &[("pnp", "exact", 4)];

/// An output with `solutions` in each row.
struct Several<'a> {
    name: &'a str,
    expected: Vec<f64>,
    got: Vec<f64>,
    tensor: &'a Tensor,
    rows: usize,
    solutions: usize,
}

impl Several<'_> {
    /// Numbers of one solution.
    fn width(&self) -> usize {
        self.expected.len() / self.rows.max(1)
    }

    /// Squared distance of a solution from the expected one; places left over are infinitely far away.
    fn distance(&self, row: usize, solution: usize) -> f64 {
        let width = self.width();
        let got = self
            .got
            .chunks(width.max(1))
            .nth(row * self.solutions + solution);
        let pairs = got
            .unwrap_or_default()
            .iter()
            .zip(&self.expected[row * width..]);
        let sum: f64 = pairs.map(|(g, e)| (g - e) * (g - e)).sum();
        if sum.is_nan() { f64::INFINITY } else { sum }
    }

    /// The solutions chosen, one per row.
    fn chosen(&self, choice: &[usize], shape: &[usize]) -> Option<Tensor> {
        let size = self.width() * self.tensor.dtype().size();
        let rows = choice.iter().enumerate();
        let parts =
            rows.map(|(row, k)| &self.tensor.bytes()[(row * self.solutions + k) * size..][..size]);
        Tensor::from_bytes(
            self.tensor.dtype(),
            shape.to_vec(),
            parts.flatten().copied().collect(),
        )
    }
}

/// The answers with one solution per row.
pub(crate) fn nearest<'a>(case: &'a Case, answers: &'a Answers) -> Cow<'a, Answers> {
    let allowed = SEVERAL
        .iter()
        .find(|(stage, flag, _)| case.stage() == *stage && case.inputs().has_flag(flag));
    let Some(&(.., most)) = allowed else {
        return Cow::Borrowed(answers);
    };
    let several = case.outputs().iter().filter_map(|(name, expected)| {
        let tensor = answers.get(name)?.as_ref().ok()?;
        match (expected.shape(), tensor.shape()) {
            ([rows, rest @ ..], [n, k, more @ ..])
                if rows == n && rest == more && (1..=most).contains(k) =>
            {
                Some(Several {
                    name,
                    expected: expected.f64(),
                    got: tensor.f64(),
                    tensor,
                    rows: *rows,
                    solutions: *k,
                })
            }
            _ => None,
        }
    });
    let several: Vec<_> = several.collect();
    let Some(first) = several.first() else {
        return Cow::Borrowed(answers);
    };
    if several
        .iter()
        .any(|s| (s.rows, s.solutions) != (first.rows, first.solutions))
    {
        return Cow::Borrowed(answers);
    }
    let total = |row: usize, k: usize| several.iter().map(|s| s.distance(row, k)).sum::<f64>();
    let nearest =
        |row: usize| (0..first.solutions).min_by(|a, b| total(row, *a).total_cmp(&total(row, *b)));
    let choice: Vec<usize> = (0..first.rows).filter_map(nearest).collect();
    let mut one = answers.clone();
    for s in &several {
        let tensor = s.chosen(&choice, case.output(s.name).shape());
        one.insert(
            s.name.to_owned(),
            Ok(tensor.expect("as many numbers as expected")),
        );
    }
    Cow::Owned(one)
}
