//! [`compare`]: how far an answer is from the expected one, in units of its tolerance.

use std::fmt;

use crate::tensor::{Dtype, Tensor};
use crate::tol::{Class, Tolerance};

/// The verdict on one tensor.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// Within tolerance.
    pub passed: bool,
    /// Number of elements.
    pub elements: usize,
    /// Elements beyond their bound (for [`Class::Banded`]: beyond `tight`).
    pub outside: usize,
    /// Largest error over tolerance; 0 for an exact answer, infinite for a wrong label or a NaN.
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
            "{verdict} {} ({:?}): {} of {} elements outside; worst at {:?}: expected {:?}, got {:?}, {:.3} x tolerance",
            self.tolerance.name,
            self.tolerance.class,
            self.outside,
            self.elements,
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
    let values = expected.f64();
    if values.len() != got.len() {
        return Err(CountMismatch {
            expected: values.len(),
            got: got.len(),
            shape: expected.shape().to_vec(),
        });
    }
    let ratio = ratio_of(tolerance.class, expected.dtype(), &values);
    let mut comparison = Comparison {
        passed: true,
        elements: values.len(),
        outside: 0,
        worst: 0.0,
        worst_index: Vec::new(),
        expected: values.first().copied().unwrap_or(0.0),
        got: got.first().copied().unwrap_or(0.0),
        bound: 0.0,
        tolerance: *tolerance,
    };
    // For a band, `worst` is measured by the hard bound and `outside` by the tight one.
    let limit = match tolerance.class {
        Class::Banded { tight, hard, .. } => tight / hard,
        _ => 1.0,
    };
    for (i, (&e, &g)) in values.iter().zip(got).enumerate() {
        let r = if same(e, g) { 0.0 } else { ratio(e, g) };
        let r = if r.is_nan() { f64::INFINITY } else { r };
        comparison.outside += usize::from(r > limit);
        if i == 0 || r > comparison.worst {
            comparison.worst = r;
            comparison.worst_index = expected.unravel(i);
            (comparison.expected, comparison.got) = (e, g);
        }
    }
    let allowed = match tolerance.class {
        Class::Banded { share, .. } => share * values.len() as f64,
        _ => 0.0,
    };
    comparison.bound = bound_of(tolerance.class, largest(&values), comparison.expected);
    comparison.passed = comparison.worst <= 1.0 && comparison.outside as f64 <= allowed;
    Ok(comparison)
}

/// Equal as numbers, or both NaN.
#[allow(clippy::float_cmp, reason = "this is the exact comparison")]
fn same(expected: f64, got: f64) -> bool {
    expected == got || (expected.is_nan() && got.is_nan())
}

/// Error over tolerance of two numbers that are not the same; infinite if either is not finite.
fn ratio_of(class: Class, dtype: Dtype, expected: &[f64]) -> impl Fn(f64, f64) -> f64 {
    let largest = largest(expected);
    move |e, g| {
        if !(e.is_finite() && g.is_finite()) {
            return f64::INFINITY;
        }
        let error = match class {
            Class::Ulp(_) => ulps_apart(dtype, e, g),
            _ => (g - e).abs(),
        };
        error / bound_of(class, largest, e)
    }
}

/// The largest finite number of a tensor.
fn largest(expected: &[f64]) -> f64 {
    let finite = expected.iter().filter(|v| v.is_finite());
    finite.fold(0.0, |a: f64, v| a.max(v.abs()))
}

/// Largest error at an element: in representable numbers for [`Class::Ulp`], else in the tensor's unit.
fn bound_of(class: Class, largest: f64, expected: f64) -> f64 {
    match class {
        Class::Exact => 0.0,
        Class::Ulp(n) => n as f64,
        Class::AbsRel { abs, rel } => abs + rel * expected.abs(),
        Class::Vector { abs, rel } => abs + rel * largest,
        Class::Banded { hard, .. } => hard,
    }
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
}
