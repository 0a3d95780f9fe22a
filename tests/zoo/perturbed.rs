//! Answers made of the expected ones: right, at the edge of every tolerance, wrong in one way, or no answer at all.

#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "answers in other types, which truncate, are among what is made here"
)]

use garad_golden::{Case, Class, Dtype, Tensor, Tolerance, compare, npy};

/// An output of a case to the bytes of the file that answers it; `None`: no file.
pub(crate) type Perturbation = fn(&Case, &str) -> Option<Vec<u8>>;

fn encoded(dtype: Dtype, shape: &[usize], values: &[f64]) -> Option<Vec<u8>> {
    let bytes = values.iter().flat_map(|&v| match dtype {
        Dtype::F32 => (v as f32).to_le_bytes().to_vec(),
        Dtype::I64 => (v as i64).to_le_bytes().to_vec(),
        Dtype::I32 => (v as i32).to_le_bytes().to_vec(),
        Dtype::U8 => vec![v as u8],
        Dtype::Bool => vec![u8::from(v > 0.5)],
        _ => v.to_le_bytes().to_vec(),
    });
    let tensor = Tensor::from_bytes(dtype, shape.to_vec(), bytes.collect());
    Some(npy::encode(&tensor.expect("as many as before")))
}

/// The expected numbers, changed, in f64.
fn changed(case: &Case, name: &str, change: impl Fn(usize, f64) -> f64) -> Option<Vec<u8>> {
    let expected = case.output(name);
    let values: Vec<f64> = expected
        .f64()
        .into_iter()
        .enumerate()
        .map(|(i, v)| change(i, v))
        .collect();
    encoded(Dtype::F64, expected.shape(), &values)
}

/// A number further from `e` than none, by this part of its tolerance.
fn moved(expected: &Tensor, tolerance: &Tolerance, i: usize, part: f64) -> f64 {
    let mut values = expected.f64();
    let e = values[i];
    match tolerance.class {
        Class::Exact if part > 1.0 => e + 1.0,
        Class::Exact => e,
        Class::Ulp(n) => {
            let steps = (n as f64 * part).ceil() as u64;
            if expected.dtype() == Dtype::F32 {
                f64::from(f32::from_bits((e as f32).to_bits() + steps as u32))
            } else {
                f64::from_bits(e.to_bits() + steps)
            }
        }
        _ => {
            values[i] = f64::INFINITY;
            let one = compare::compare(expected, &values, tolerance).expect("as many");
            e + part * one.bound
        }
    }
}

/// Every `every`-th element at this part of its tolerance, upwards and downwards in turn.
fn at(case: &Case, name: &str, dtype: Dtype, part: f64, every: usize) -> Option<Vec<u8>> {
    let expected = case.output(name);
    let tolerance = match dtype {
        Dtype::F32 => case.tolerance_f32(name),
        _ => case.tolerance(name).copied(),
    };
    let tolerance = tolerance.expect("in the table");
    let mut values = expected.f64();
    let n = values.len();
    let every = every.min(n.max(1));
    for i in (every / 2..n).step_by(every) {
        let there = values[i];
        let up = moved(expected, &tolerance, i, part);
        values[i] = if i % 2 == 0 { up } else { there - (up - there) };
    }
    encoded(dtype, expected.shape(), &values)
}

/// Between both ends of a band: as many elements as it allows, and `more`.
fn in_band(case: &Case, name: &str, more: usize) -> Option<Vec<u8>> {
    let expected = case.output(name);
    let class = case.tolerance(name).expect("in the table").class;
    let Class::Banded { tight, share, hard } = class else {
        return changed(case, name, |_, v| v);
    };
    let allowed = (share * expected.len() as f64) as usize;
    changed(case, name, |i, v| {
        if i < allowed + more {
            v + 0.5 * (tight + hard)
        } else {
            v
        }
    })
}

/// One element in f32 near a cut, where the case says which are, by this much.
fn near_cuts(case: &Case, name: &str, every: usize, by: f64) -> Option<Vec<u8>> {
    let expected = case.output(name);
    let mask = case.inputs().get("robust");
    let mask = mask.filter(|m| expected.shape().starts_with(m.shape()) && !m.is_empty());
    let mask = mask.map(|m| (m.i64(), expected.len() / m.len()));
    let near = |i: usize| {
        mask.as_ref()
            .is_some_and(|(m, per)| m[i / per] == 0 && i.is_multiple_of(every))
    };
    let values: Vec<f64> = expected
        .f64()
        .into_iter()
        .enumerate()
        .map(|(i, v)| if near(i) { v + by } else { v })
        .collect();
    encoded(Dtype::F32, expected.shape(), &values)
}

/// Rows with several solutions; the right one is at a place that changes, others are off or not there.
fn several(case: &Case, name: &str, solutions: usize) -> Option<Vec<u8>> {
    let expected = case.output(name);
    let [rows, rest @ ..] = expected.shape() else {
        return changed(case, name, |_, v| v);
    };
    let values = expected.f64();
    let width = rest.iter().product::<usize>();
    let mut all = Vec::new();
    for row in 0..*rows {
        for k in 0..solutions {
            let off = match (k + solutions - row % solutions) % solutions {
                0 => 0.0,
                1 => f64::NAN,
                other => 0.25 * other as f64,
            };
            all.extend(values[row * width..][..width].iter().map(|v| v + off));
        }
    }
    let shape = [&[*rows, solutions], rest].concat();
    encoded(Dtype::F64, &shape, &all)
}

fn reversed_axes(case: &Case, name: &str) -> Option<Vec<u8>> {
    let expected = case.output(name);
    let shape: Vec<usize> = expected.shape().iter().rev().copied().collect();
    encoded(Dtype::F64, &shape, &expected.f64())
}

fn of_shape(case: &Case, name: &str, shape: impl Fn(&[usize]) -> Vec<usize>) -> Option<Vec<u8>> {
    let expected = case.output(name);
    let shape = shape(expected.shape());
    let mut values = expected.f64();
    values.resize(shape.iter().product(), 0.5);
    encoded(Dtype::F64, &shape, &values)
}

/// A file as numpy writes it, its header changed.
fn header(case: &Case, name: &str, from: &str, to: &str) -> Option<Vec<u8>> {
    let file = changed(case, name, |_, v| v)?;
    let at = file
        .windows(from.len())
        .position(|w| w == from.as_bytes())
        .expect("in the header");
    let mut damaged = file.clone();
    damaged.splice(at..at + from.len(), to.bytes());
    Some(damaged)
}

fn first_of(case: &Case, name: &str) -> bool {
    case.outputs()
        .keys()
        .next()
        .is_some_and(|first| first == name)
}

/// Every kind, with the words of the verdicts it must give, to the cases together.
#[rustfmt::skip]
pub(crate) const PERTURBATIONS: &[(&str, &str, Perturbation)] = &[
    ("right", "pass", |c, n| changed(c, n, |_, v| v)),
    ("right_f32", "pass", |c, n| encoded(Dtype::F32, c.output(n).shape(), &c.output(n).f64())),
    ("one_inside", "pass", |c, n| at(c, n, Dtype::F64, 0.98, usize::MAX)),
    ("one_at_the_bound", "pass fail", |c, n| at(c, n, Dtype::F64, 1.0, usize::MAX)),
    ("one_outside", "fail pass", |c, n| at(c, n, Dtype::F64, 1.02, usize::MAX)),
    ("one_inside_f32", "pass", |c, n| at(c, n, Dtype::F32, 0.98, usize::MAX)),
    ("one_outside_f32", "fail pass", |c, n| at(c, n, Dtype::F32, 1.02, usize::MAX)),
    ("third_inside", "pass fail", |c, n| at(c, n, Dtype::F64, 0.98, 3)),
    ("third_outside", "fail", |c, n| at(c, n, Dtype::F64, 1.02, 3)),
    ("third_f32", "pass fail", |c, n| at(c, n, Dtype::F32, 0.5, 3)),
    ("band_full", "pass", |c, n| in_band(c, n, 0)),
    ("band_over", "pass fail", |c, n| in_band(c, n, 1)),
    ("few_near_cuts", "pass", |c, n| near_cuts(c, n, 97, 5e-3)),
    ("all_near_cuts", "pass fail", |c, n| near_cuts(c, n, 1, 5e-3)),
    ("far_near_cuts", "pass fail", |c, n| near_cuts(c, n, 97, 0.5)),
    ("one_nan", "nonfinite pass", |c, n| changed(c, n, |i, v| if i == 2 { f64::NAN } else { v })),
    ("all_inf", "nonfinite", |c, n| changed(c, n, |_, _| f64::NEG_INFINITY)),
    ("negated", "fail pass", |c, n| changed(c, n, |_, v| -v)),
    ("doubled", "fail pass", |c, n| changed(c, n, |_, v| 2.0 * v)),
    ("zero", "fail pass", |c, n| changed(c, n, |_, _| 0.0)),
    ("reversed_axes", "shape pass", reversed_axes),
    ("flat", "shape pass", |c, n| of_shape(c, n, |s| vec![s.iter().product()])),
    ("one_more_axis", "pass", |c, n| of_shape(c, n, |s| [s, &[1]].concat())),
    ("row_more", "shape", |c, n| of_shape(c, n, |s| match s { [first, rest @ ..] => [&[first + 1], rest].concat(), [] => vec![2] })),
    ("as_i64", "pass fail", |c, n| encoded(Dtype::I64, c.output(n).shape(), &c.output(n).f64())),
    ("as_i32", "pass fail", |c, n| encoded(Dtype::I32, c.output(n).shape(), &c.output(n).f64())),
    ("as_u8", "pass fail", |c, n| encoded(Dtype::U8, c.output(n).shape(), &c.output(n).f64())),
    ("as_bool", "pass fail", |c, n| encoded(Dtype::Bool, c.output(n).shape(), &c.output(n).f64())),
    ("beyond_2_53", "unreadable pass", |c, n| encoded(Dtype::I64, c.output(n).shape(), &vec![-9.1e15; c.output(n).len()])),
    ("half_missing", "missing pass", |c, n| changed(c, n, |_, v| v).filter(|_| first_of(c, n))),
    ("all_missing", "missing", |_, _| None),
    ("lenient_half_missing", "pass missing", |c, n| changed(c, n, |_, v| v).filter(|_| first_of(c, n))),
    ("lenient_all_missing", "missing", |_, _| None),
    ("no_npy", "unreadable", |_, _| Some(b"nonsense".to_vec())),
    ("empty_file", "unreadable", |_, _| Some(Vec::new())),
    ("cut_off", "unreadable", |c, n| changed(c, n, |_, v| v).map(|mut f| { f.pop(); f })),
    ("cut_header", "unreadable", |c, n| changed(c, n, |_, v| v).map(|f| f[..60].to_vec())),
    ("version_2", "unreadable", |c, n| changed(c, n, |_, v| v).map(|mut f| { f[6] = 2; f })),
    ("fortran", "unreadable", |c, n| header(c, n, "False", "True ")),
    ("big_endian", "unreadable", |c, n| header(c, n, "'<f8'", "'>f8'")),
    ("as_f16", "unreadable", |c, n| header(c, n, "'<f8'", "'<f2'")),
    ("double_quotes", "unreadable", |c, n| header(c, n, "'descr'", "\"descr\"")),
    ("key_twice", "unreadable", |c, n| header(c, n, "'fortran_order': False, ", "'descr': '<f8'         , ")),
    ("blank_in_header", "pass", |c, n| header(c, n, ": False", ":False ")),
    ("four_solutions", "pass shape", |c, n| several(c, n, 4)),
    ("five_solutions", "shape", |c, n| several(c, n, 5)),
    ("uneven_solutions", "pass shape", |c, n| several(c, n, if first_of(c, n) { 3 } else { 2 })),
    ("one_with_solutions", "pass shape", |c, n| several(c, n, if first_of(c, n) { 3 } else { 1 })),
];
