//! [`compare`]: how far an answer is from the expected one, in units of its tolerance.

use std::fmt;

use crate::tensor::{Dtype, Tensor};
use crate::tol::{Class, Tolerance};

/// The verdict on one tensor.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// Within tolerance.
    pub passed: bool,
    /// Number of elements (for [`Class::Rows`]: of rows).
    pub elements: usize,
    /// Elements beyond their bound (for [`Class::Banded`]: beyond `tight`; for [`Class::Rows`]: rows).
    pub outside: usize,
    /// Largest error over tolerance; 0 for an exact answer, infinite for a wrong label or a NaN. Where a share may
    /// be beyond its bound, over what no element may exceed.
    pub worst: f64,
    /// Where it is; empty for an empty tensor.
    pub worst_index: Vec<usize>,
    /// What should be there.
    pub expected: f64,
    /// What is there.
    pub got: f64,
    /// How far `got` may be from `expected` there, in the tensor's unit (for [`Class::Ulp`] in
    /// representable numbers).
    pub bound: f64,
    /// Judged by.
    pub tolerance: Tolerance,
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let verdict = if self.passed { "within" } else { "NOT within" };
        write!(
            f,
            "{verdict} {} ({:?}): {} of {} {} outside; worst at {:?}: expected {:?}, got {:?}, {:.3} x tolerance",
            self.tolerance.name,
            self.tolerance.class,
            self.outside,
            self.elements,
            match self.tolerance.class {
                Class::Rows { .. } => "rows",
                _ => "elements",
            },
            self.worst_index,
            self.expected,
            self.got,
            self.worst
        )
    }
}

/// The numbers differ in count; nothing else can be said.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{got} elements; expected {expected} ({shape:?})")]
pub struct CountMismatch {
    /// Elements of the expected tensor.
    pub expected: usize,
    /// Elements given.
    pub got: usize,
    /// Shape of the expected tensor.
    pub shape: Vec<usize>,
}

/// Compares an answer, flat in C order, with the expected tensor.
///
/// # Errors
/// [`CountMismatch`] if the number of elements differs.
pub fn compare(
    expected: &Tensor,
    got: &[f64],
    tolerance: &Tolerance,
) -> Result<Comparison, CountMismatch> {
    compare_scaled(expected, got, tolerance, None)
}

/// [`compare`] with the scale of each row for [`Class::Rows`], which the other classes do not use.
///
/// # Errors
/// [`CountMismatch`] as [`compare`], also if there is not one scale for each row.
pub fn compare_scaled(
    expected: &Tensor,
    got: &[f64],
    tolerance: &Tolerance,
    scales: Option<&[f64]>,
) -> Result<Comparison, CountMismatch> {
    let values = expected.f64();
    if values.len() != got.len() {
        return Err(CountMismatch {
            expected: values.len(),
            got: got.len(),
            shape: expected.shape().to_vec(),
        });
    }
    let bounds = Bounds::new(tolerance.class, expected, &values, scales)?;
    let mut comparison = Comparison {
        passed: true,
        elements: bounds.judged(values.len()),
        outside: 0,
        worst: 0.0,
        worst_index: Vec::new(),
        expected: values.first().copied().unwrap_or(0.0),
        got: got.first().copied().unwrap_or(0.0),
        bound: 0.0,
        tolerance: *tolerance,
    };
    // Where there is a budget, `worst` is measured by the hard bound and `outside` by the tight one.
    let (limit, share) = match tolerance.class {
        Class::Banded { tight, share, hard } => (tight / hard, share),
        Class::Rows { share, hard, .. } => (hard.recip(), share),
        _ => (1.0, 0.0),
    };
    let mut worst_at = 0;
    // The row that was last found to be outside.
    let mut outside_row = None;
    for (i, (&e, &g)) in values.iter().zip(got).enumerate() {
        let r = if same(e, g) {
            0.0
        } else {
            ratio(tolerance.class, expected.dtype(), e, g, bounds.at(i, e))
        };
        let r = if r.is_nan() { f64::INFINITY } else { r };
        let row = bounds.row_of(i);
        if r > limit && outside_row != Some(row) {
            comparison.outside += 1;
            outside_row = Some(row);
        }
        if i == 0 || r > comparison.worst {
            comparison.worst = r;
            comparison.worst_index = expected.unravel(i);
            (comparison.expected, comparison.got) = (e, g);
            worst_at = i;
        }
    }
    let allowed = share * comparison.elements as f64;
    comparison.bound = bounds.at(worst_at, comparison.expected);
    comparison.passed = comparison.worst <= 1.0 && comparison.outside as f64 <= allowed;
    Ok(comparison)
}

/// Equal as numbers, or both NaN.
#[allow(clippy::float_cmp, reason = "this is the exact comparison")]
fn same(expected: f64, got: f64) -> bool {
    expected == got || (expected.is_nan() && got.is_nan())
}

/// Error over tolerance of two numbers that are not the same; infinite if either is not finite.
fn ratio(class: Class, dtype: Dtype, e: f64, g: f64, bound: f64) -> f64 {
    if !(e.is_finite() && g.is_finite()) {
        return f64::INFINITY;
    }
    let error = match class {
        Class::Ulp(_) => ulps_apart(dtype, e, g),
        _ => (g - e).abs(),
    };
    error / bound
}

/// The largest finite number of a list.
fn largest(values: &[f64]) -> f64 {
    let finite = values.iter().filter(|v| v.is_finite());
    finite.fold(0.0, |a: f64, v| a.max(v.abs()))
}

/// Largest error at each element: in representable numbers for [`Class::Ulp`], else in the tensor's unit.
struct Bounds {
    class: Class,
    /// Of the tensor.
    largest: f64,
    /// Numbers in a row for [`Class::Rows`], else 1.
    width: usize,
    /// Of each row for [`Class::Rows`], else none.
    rows: Vec<f64>,
}

impl Bounds {
    fn new(
        class: Class,
        expected: &Tensor,
        values: &[f64],
        scales: Option<&[f64]>,
    ) -> Result<Self, CountMismatch> {
        let mut bounds = Self {
            class,
            largest: largest(values),
            width: 1,
            rows: Vec::new(),
        };
        let Class::Rows {
            rel, floor, hard, ..
        } = class
        else {
            return Ok(bounds);
        };
        let behind = expected.shape().get(1..).unwrap_or_default();
        bounds.width = behind.iter().product::<usize>().max(1);
        let sizes: Vec<f64> = values.chunks(bounds.width).map(largest).collect();
        if let Some(scales) = scales.filter(|scales| scales.len() != sizes.len()) {
            return Err(CountMismatch {
                expected: sizes.len(),
                got: scales.len(),
                shape: expected.shape().to_vec(),
            });
        }
        let typical = lower_median(sizes.iter().copied().filter(|&s| s > 0.0).collect());
        let scale = |row: usize| scales.map_or(typical, |scales| scales[row]);
        let bound = |(row, size): (usize, &f64)| hard * (rel * size + floor * scale(row));
        bounds.rows = sizes.iter().enumerate().map(bound).collect();
        Ok(bounds)
    }

    /// How many things are judged of a tensor of so many numbers.
    fn judged(&self, elements: usize) -> usize {
        match self.class {
            Class::Rows { .. } => self.rows.len(),
            _ => elements,
        }
    }

    fn row_of(&self, element: usize) -> usize {
        element / self.width
    }

    fn at(&self, element: usize, expected: f64) -> f64 {
        match self.class {
            Class::Exact => 0.0,
            Class::Ulp(n) => n as f64,
            Class::AbsRel { abs, rel } => abs + rel * expected.abs(),
            Class::Vector { abs, rel } => abs + rel * self.largest,
            Class::Banded { hard, .. } => hard,
            Class::Rows { .. } => self.rows.get(self.row_of(element)).copied().unwrap_or(0.0),
        }
    }
}

/// Of a sorted list of n numbers that at (n - 1)/2, rounded down; 0 of an empty one.
fn lower_median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let middle = values.len().saturating_sub(1) / 2;
    values.get(middle).copied().unwrap_or(0.0)
}

/// Representable numbers between two finite ones, counted in f32 for f32 tensors, else in f64.
#[allow(
    clippy::cast_possible_truncation,
    reason = "the expected value is an f32; what is got is rounded to one"
)]
fn ulps_apart(dtype: Dtype, a: f64, b: f64) -> f64 {
    // Bits read as sign and magnitude, so that neighbours differ by 1 across 0 as well.
    let ordinal64 = |v: f64| {
        let bits = i128::from(v.to_bits() & (u64::MAX >> 1));
        if v.is_sign_negative() { -bits } else { bits }
    };
    let ordinal32 = |v: f64| {
        let bits = i128::from((v as f32).to_bits() & (u32::MAX >> 1));
        if v.is_sign_negative() { -bits } else { bits }
    };
    let apart = if dtype == Dtype::F32 {
        ordinal32(a) - ordinal32(b)
    } else {
        ordinal64(a) - ordinal64(b)
    };
    apart.unsigned_abs() as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tolerance(class: Class) -> Tolerance {
        Tolerance {
            name: "test",
            class,
            reason: "test",
        }
    }

    fn verdict(class: Class, expected: &[f64], got: &[f64]) -> Comparison {
        compare(&Tensor::from(expected.to_vec()), got, &tolerance(class)).unwrap()
    }

    #[test]
    fn the_worst_element_is_named_with_its_place() {
        let expected = Tensor::from(vec![1.0; 6]).reshape(&[2, 3]).unwrap();
        let class = Class::AbsRel { abs: 0.5, rel: 0.5 };
        let got = [1.0, 1.5, 1.0, 1.0, 1.0, 3.0];
        let c = compare(&expected, &got, &tolerance(class)).unwrap();
        assert!(
            !c.passed && c.outside == 1 && c.worst_index == [1, 2],
            "{c}"
        );
        assert!(
            (c.worst - 2.0).abs() < 1e-15 && (c.got - 3.0).abs() < 1e-15,
            "{c}"
        );
        assert!(
            c.to_string()
                .contains("worst at [1, 2]: expected 1.0, got 3.0"),
            "{c}"
        );
    }

    #[test]
    fn bounds_belong_to_the_inside() {
        let class = Class::AbsRel {
            abs: 0.25,
            rel: 0.0,
        };
        assert!(verdict(class, &[1.0], &[1.25]).passed, "at the bound");
        assert!(!verdict(class, &[1.0], &[1.25 + 1e-15]).passed, "beyond");
        assert!(
            verdict(Class::Exact, &[0.0], &[-0.0]).passed,
            "zero has no sign here"
        );
        assert!(
            !verdict(Class::Exact, &[1.0], &[1.0 + 2.3e-16]).passed,
            "one bit"
        );
        let zero = Class::AbsRel {
            abs: 0.0,
            rel: 1e-3,
        };
        assert!(verdict(zero, &[0.0], &[0.0]).passed, "0/0 is no error");
        assert!(
            !verdict(zero, &[0.0], &[1e-300]).passed,
            "an absent absolute part"
        );
    }

    #[test]
    fn classes_differ_where_they_should() {
        let (expected, got) = ([1000.0, 1e-3], [1000.0, 2e-3]);
        let element = Class::AbsRel {
            abs: 0.0,
            rel: 1e-5,
        };
        let vector = Class::Vector {
            abs: 0.0,
            rel: 1e-5,
        };
        assert!(
            !verdict(element, &expected, &got).passed,
            "judged by itself"
        );
        assert!(
            verdict(vector, &expected, &got).passed,
            "judged by the largest"
        );
        let next = f64::from_bits(1.0f64.to_bits() + 2);
        assert!(verdict(Class::Ulp(2), &[1.0], &[next]).passed, "two steps");
        assert!(!verdict(Class::Ulp(1), &[1.0], &[next]).passed, "one step");
        let tiny = f64::from_bits(1);
        assert!(
            verdict(Class::Ulp(2), &[-tiny], &[tiny]).passed,
            "across zero"
        );
        let single = Tensor::from_bytes(Dtype::F32, vec![1], 1.0f32.to_le_bytes().into()).unwrap();
        let next = f64::from(1.0 + f32::EPSILON);
        let c = compare(&single, &[next], &tolerance(Class::Ulp(1))).unwrap();
        assert!(c.passed, "counted in f32: {c}");
    }

    #[test]
    fn bands_have_a_budget_and_a_hard_end() {
        let class = Class::Banded {
            tight: 0.01,
            share: 0.25,
            hard: 1.0,
        };
        let expected = [0.0; 4];
        assert!(
            verdict(class, &expected, &[0.0, 0.5, 0.0, 0.01]).passed,
            "one of four"
        );
        assert!(
            !verdict(class, &expected, &[0.0, 0.5, 0.0, 0.02]).passed,
            "two of four"
        );
        assert!(
            !verdict(class, &expected, &[0.0, 1.5, 0.0, 0.0]).passed,
            "too far"
        );
    }

    #[test]
    fn not_a_number_is_a_class_of_its_own() {
        let wide = Class::AbsRel {
            abs: 1e300,
            rel: 1.0,
        };
        assert!(verdict(wide, &[f64::NAN], &[f64::NAN]).passed, "both");
        assert!(!verdict(wide, &[1.0], &[f64::NAN]).passed, "got");
        assert!(!verdict(wide, &[f64::NAN], &[1.0]).passed, "expected");
        assert!(
            !verdict(wide, &[f64::INFINITY], &[f64::NEG_INFINITY]).passed,
            "signs"
        );
        assert!(
            verdict(Class::Exact, &[f64::INFINITY], &[f64::INFINITY]).passed,
            "same"
        );
        let vector = Class::Vector {
            abs: 0.0,
            rel: 1e-3,
        };
        assert!(
            !verdict(vector, &[f64::INFINITY, 1.0], &[f64::INFINITY, 2.0]).passed,
            "an infinity does not widen the rest"
        );
    }

    #[test]
    fn counts_must_agree() {
        let tensor = Tensor::from(vec![1.0, 2.0]);
        assert!(
            compare(&tensor, &[1.0], &tolerance(Class::Exact)).is_err(),
            "one short"
        );
        assert!(
            verdict(Class::Exact, &[], &[]).passed,
            "nothing equals nothing"
        );
    }

    /// `tight` and `hard` in the unit of the tensor: 0.5 and 4.
    #[test]
    fn both_ends_of_a_band_by_hand() {
        let class = Class::Banded {
            tight: 0.5,
            share: 0.5,
            hard: 4.0,
        };
        for (got, passed, outside, worst) in [
            ([1.5, 1.0], true, 0, 0.125),
            ([1.5625, 1.0], true, 1, 0.140_625),
            ([1.5625, 0.4375], false, 2, 0.140_625),
            ([5.0, 1.0], true, 1, 1.0),
            ([1.0, -3.0625], false, 1, 1.015_625),
        ] {
            let c = verdict(class, &[1.0, 1.0], &got);
            assert_eq!((c.passed, c.outside), (passed, outside), "{got:?}: {c}");
            assert!((c.worst - worst).abs() < 1e-15, "{got:?}: {c}");
        }
    }

    /// The bound is that of the element that is worst.
    #[test]
    fn bounds_by_hand() {
        let (expected, got) = ([-8.0, -3.0, 0.5], [-8.0, -2.0, 0.5]);
        for (class, bound) in [
            (
                Class::AbsRel {
                    abs: 0.25,
                    rel: 0.5,
                },
                1.75,
            ),
            (
                Class::Vector {
                    abs: 0.5,
                    rel: 0.25,
                },
                2.5,
            ),
            (
                Class::Banded {
                    tight: 0.1,
                    share: 1.0,
                    hard: 3.0,
                },
                3.0,
            ),
            (Class::Ulp(7), 7.0),
            (Class::Exact, 0.0),
        ] {
            let c = verdict(class, &expected, &got);
            assert!((c.bound - bound).abs() < 1e-15, "{class:?}: {}", c.bound);
            assert_eq!(c.worst_index, [1], "{class:?}");
            let exact = matches!(class, Class::Exact | Class::Ulp(_));
            assert!(
                exact || (c.worst - 1.0 / bound).abs() < 1e-15,
                "{class:?}: {}",
                c.worst
            );
        }
    }

    /// Rows of two; sizes 8, 0, 2 and 1000, so the lower median of those that are not zero is 8. With half of it as
    /// floor: 0.25 size + 4 is 6, 4, 4.5 and 254, and four times that in any.
    #[test]
    fn rows_by_hand() {
        let class = Class::Rows {
            rel: 0.25,
            floor: 0.5,
            share: 0.25,
            hard: 4.0,
        };
        let values = [8.0, -1.0, 0.0, 0.0, -2.0, 1.0, 3.0, 1000.0];
        let expected = Tensor::from(values.to_vec()).reshape(&[4, 2]).unwrap();
        let judged = |scales: Option<&[f64]>, row: usize, error: [f64; 2]| {
            let mut got = values;
            (got[2 * row], got[2 * row + 1]) =
                (got[2 * row] + error[0], got[2 * row + 1] - error[1]);
            compare_scaled(&expected, &got, &tolerance(class), scales).unwrap()
        };
        for (row, error, passed, outside, bound) in [
            (0, [6.0, 6.0], true, 0, 24.0),
            (0, [6.5, 7.0], true, 1, 24.0),
            (0, [0.0, 24.0], true, 1, 24.0),
            (0, [24.5, 0.0], false, 1, 24.0),
            (1, [4.0, 0.0], true, 0, 16.0),
            (1, [0.0, 16.5], false, 1, 16.0),
            (2, [4.75, 0.0], true, 1, 18.0),
            (3, [254.0, 0.0], true, 0, 1016.0),
            (3, [0.0, 1017.0], false, 1, 1016.0),
        ] {
            let c = judged(None, row, error);
            assert_eq!(
                (c.passed, c.outside),
                (passed, outside),
                "{row} {error:?}: {c}"
            );
            assert!(
                (c.bound - bound).abs() < 1e-12,
                "{row} {error:?}: {}",
                c.bound
            );
            assert_eq!((c.elements, c.worst_index[0]), (4, row), "{row}: {c}");
            assert!(
                (c.worst - error[0].max(error[1]) / bound).abs() < 1e-15,
                "{c}"
            );
        }
        // With scales of its own: 0.25 · 8 + 0.5 · 2 = 3, and nothing at all where the scale is 0, too.
        let scales = [2.0, 0.0, 1.0, 0.0];
        assert_eq!(
            judged(Some(&scales), 0, [3.0, 0.0]).outside,
            0,
            "at the bound"
        );
        assert_eq!(judged(Some(&scales), 0, [3.5, 0.0]).outside, 1, "beyond");
        assert!(
            !judged(Some(&scales), 1, [1e-300, 0.0]).passed,
            "no part in the image"
        );
        let few = compare_scaled(&expected, &values, &tolerance(class), Some(&scales[1..]));
        assert!(few.is_err(), "a scale per row");
        let c = judged(None, 0, [25.0, 0.0]);
        assert!(c.to_string().contains("1 of 4 rows outside"), "{c}");
    }

    /// The budget counts rows, not numbers: both rows of a quarter of eight.
    #[test]
    fn the_budget_of_rows_and_columns_of_numbers() {
        let class = Class::Rows {
            rel: 0.5,
            floor: 0.0,
            share: 0.25,
            hard: 2.0,
        };
        let expected = Tensor::from(vec![4.0; 8]);
        let judged = |wrong: usize| {
            let got: Vec<f64> = (0..8).map(|i| if i < wrong { 7.0 } else { 4.0 }).collect();
            compare(&expected, &got, &tolerance(class)).unwrap()
        };
        assert!(judged(2).passed, "two rows of one number");
        assert!(!judged(3).passed, "three");
        assert!(!verdict(class, &[4.0], &[f64::NAN]).passed, "NaN");
        assert!(verdict(class, &[], &[]).passed, "nothing");
    }
}
