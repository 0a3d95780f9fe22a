//! [`judge`]: the verdict on a case, given a backend's outputs.
//!
//! An answer in f32 where f64 is expected is held to the tolerance of f32 ([`tol::for_f32`]). If
//! the case has an input `robust`, it says which pixels are away from every cut; there an answer in f32 is
//! held to its tolerance, and all pixels together to the budget `STAGE.f32.flips_FLAG` or `STAGE.f32.flips`. An input
//! `robust_OUTPUT` takes its place for one output, without a budget: elsewhere nothing is said.

use crate::alternatives::nearest;
use crate::answers::Answers;
use crate::case::Case;
use crate::compare::{Comparison, compare, compare_scaled};
use crate::explain::explain;
use crate::metrics::Metrics;
use crate::tensor::{Dtype, Tensor};
use crate::tol::{self, Class};
use crate::verdict::{CaseVerdict, Outcome, OutputVerdict, Verdict};

/// Judges every output of a case.
#[must_use]
pub fn judge(case: &Case, answers: &Answers, allow_missing: bool) -> CaseVerdict {
    let answers = nearest(case, answers);
    let in_f32 = case.outputs().iter().any(|(name, expected)| {
        let answer = answers.get(name).and_then(|answer| answer.as_ref().ok());
        answer.is_some_and(|answer| answer.dtype() == Dtype::F32 && expected.dtype() == Dtype::F64)
    });
    let outputs: Vec<OutputVerdict> = case
        .outputs()
        .keys()
        .map(|name| match answers.get(name) {
            None => problem(name, Verdict::Missing, None, "no file of this name"),
            Some(Err(why)) => problem(name, Verdict::Unreadable, None, why),
            Some(Ok(answer)) => judge_output(case, name, answer, in_f32),
        })
        .collect();
    let any = |f: fn(Verdict) -> bool| outputs.iter().any(|o| f(o.verdict));
    let outcome = if any(|v| v > Verdict::Missing) {
        Outcome::Fail
    } else if !any(|v| v == Verdict::Pass) {
        Outcome::Missing
    } else if any(|v| v == Verdict::Missing) && !allow_missing {
        Outcome::Fail
    } else {
        Outcome::Pass
    };
    CaseVerdict {
        outputs,
        ..CaseVerdict::without_outputs(case, outcome)
    }
}

fn problem(name: &str, verdict: Verdict, dtype: Option<Dtype>, note: &str) -> OutputVerdict {
    OutputVerdict {
        name: name.to_owned(),
        verdict,
        dtype,
        comparison: None,
        metrics: None,
        note: Some(note.to_owned()),
    }
}

/// Sizes other than 1: a column may be a vector.
fn squeezed(shape: &[usize]) -> Vec<usize> {
    shape.iter().copied().filter(|&n| n != 1).collect()
}

fn judge_output(case: &Case, name: &str, answer: &Tensor, in_f32: bool) -> OutputVerdict {
    let expected = case.output(name);
    let dtype = Some(answer.dtype());
    if squeezed(expected.shape()) != squeezed(answer.shape()) {
        let exact = case.tolerance(name).is_ok_and(|t| t.class == Class::Exact);
        let note = other_shape(expected, answer, exact);
        return problem(name, Verdict::Shape, dtype, &note);
    }
    let tolerance = match answer.dtype() {
        Dtype::F32 => case.tolerance_f32(name),
        _ => case.tolerance(name).copied(),
    };
    let tolerance = match tolerance {
        Ok(tolerance) => tolerance,
        Err(error) => return problem(name, Verdict::Unreadable, dtype, &error.to_string()),
    };
    let values = expected.f64();
    let robust = if in_f32 {
        robust(case, name, expected)
    } else {
        None
    };
    // Elements near a cut count as right here; the budget for flips judges them.
    let away = |numbers: &[f64]| -> Vec<f64> {
        let Some((mask, per)) = &robust else {
            return numbers.to_vec();
        };
        let at = |i: usize| {
            if mask[i / per] == 0 {
                values[i]
            } else {
                numbers[i]
            }
        };
        (0..numbers.len()).map(at).collect()
    };
    let flips = robust
        .as_ref()
        .filter(|_| tolerance.class != Class::Exact)
        .filter(|_| case.inputs().get(&format!("robust_{name}")).is_none())
        .and_then(|_| tol::flips(case.stage(), case.inputs().flags()));
    let scales = case.inputs().get(&format!("scale_{name}")).map(Tensor::f64);
    let verdict_on = |numbers: &[f64]| -> Option<Comparison> {
        let tight = compare_scaled(expected, &away(numbers), &tolerance, scales.as_deref()).ok()?;
        let all = flips.and_then(|flips| compare(expected, numbers, flips).ok());
        Some(match all {
            Some(all) if tight.passed && !all.passed => all,
            _ => tight,
        })
    };
    let got = answer.f64();
    let Some(comparison) = verdict_on(&got) else {
        return problem(
            name,
            Verdict::Shape,
            dtype,
            &other_shape(expected, answer, false),
        );
    };
    let lost = got
        .iter()
        .zip(&values)
        .filter(|(g, e)| e.is_finite() && !g.is_finite());
    let lost = lost.count();
    let (verdict, note) = if comparison.passed {
        (Verdict::Pass, None)
    } else if lost > 0 {
        let note = format!("{lost} of {} numbers are NaN or infinite", got.len());
        (Verdict::NonFinite, Some(note))
    } else {
        let passes = |numbers: &[f64]| verdict_on(numbers).is_some_and(|c| c.passed);
        let mistake = explain(case, name, &values, &got, &passes);
        let mistake = mistake.map(|mistake| format!("fits, if this mistake is undone: {mistake}"));
        (
            Verdict::Fail,
            mistake.or_else(|| looks_like_f32(answer, &comparison)),
        )
    };
    let columns = expected.shape().last().copied().unwrap_or(1);
    let whole = tolerance.class == Class::Exact || verdict == Verdict::Pass;
    let metrics = Metrics::of(&values, &got, columns).filter(|_| !whole);
    OutputVerdict {
        name: name.to_owned(),
        verdict,
        dtype,
        comparison: Some(comparison),
        metrics,
        note,
    }
}

/// The mask of a case over the first axes of an output, with the elements per entry of the mask.
pub(crate) fn robust(case: &Case, name: &str, expected: &Tensor) -> Option<(Vec<i64>, usize)> {
    let own = case.inputs().get(&format!("robust_{name}"));
    let mask = own.or_else(|| case.inputs().get("robust"))?;
    let fits = expected.shape().starts_with(mask.shape()) && !mask.is_empty();
    fits.then(|| (mask.i64(), expected.len() / mask.len()))
}

/// Numbers in f64 that f32 could hold were hardly computed in f64.
#[allow(
    clippy::cast_possible_truncation,
    reason = "whether it truncates is the question"
)]
#[allow(clippy::float_cmp, reason = "the same bits or not")]
fn looks_like_f32(answer: &Tensor, comparison: &Comparison) -> Option<String> {
    let close = comparison.worst < 10.0 * tol::F32_OVER_F64;
    let values = answer.f64();
    let narrow = values.iter().all(|&v| f64::from(v as f32) == v);
    let whole = values.iter().all(|&v| v.fract() == 0.0);
    (answer.dtype() == Dtype::F64 && close && narrow && !whole).then(|| {
        "every number fits in float32: if it was computed in float32, save it as float32 (<f4) \
         and it is held to that tolerance"
            .to_owned()
    })
}

/// What is wrong with a shape, and for lists of whole numbers which rows are missing or too many.
fn other_shape(expected: &Tensor, answer: &Tensor, exact: bool) -> String {
    let mut note = format!(
        "shape {:?}; expected {:?}",
        answer.shape(),
        expected.shape()
    );
    let reversed: Vec<usize> = expected.shape().iter().rev().copied().collect();
    if answer.shape() == reversed {
        note.push_str(": the axes are reversed (column-major, or (width, height))");
    } else if answer.len() == expected.len() {
        note.push_str(": as many numbers; reshape");
    } else if expected.shape().get(1..) == answer.shape().get(1..) && exact {
        let rows = |tensor: &Tensor| -> Vec<Vec<u64>> {
            let width = tensor.shape()[1..].iter().product::<usize>().max(1);
            let values = tensor.f64();
            let bits = |row: &[f64]| row.iter().map(|v| v.to_bits()).collect();
            let mut rows: Vec<_> = values.chunks(width).map(bits).collect();
            rows.sort();
            rows
        };
        let (theirs, mine) = (rows(expected), rows(answer));
        let only = |a: &[Vec<u64>], b: &[Vec<u64>]| -> (usize, String) {
            let odd: Vec<_> = a
                .iter()
                .filter(|row| b.binary_search(row).is_err())
                .collect();
            let first = odd.first().map_or(String::new(), |row| {
                let row: Vec<f64> = row.iter().map(|&b| f64::from_bits(b)).collect();
                format!(", for one {row:?}")
            });
            (odd.len(), first)
        };
        let ((missing, lost), (extra, more)) = (only(&theirs, &mine), only(&mine, &theirs));
        note.push_str(&format!(
            ": {missing} rows are missing{lost}; {extra} should not be there{more}"
        ));
    }
    note
}
