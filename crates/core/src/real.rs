//! [`Real`]: the source of all transcendental functions.
//!
//! `std`'s `exp`, `sin`, ... call the platform's C library, whose bits change with the processor
//! (glibc picks an FMA variant at run time) and with the target (wasm differs again). `libm` is
//! plain Rust arithmetic: one answer everywhere. `sqrt` is correctly rounded by IEEE 754 and may
//! come from `std`. Decision: `docs/decisions/001-transcendentals.md`.

use std::fmt::{Debug, Display};
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Sub, SubAssign};

mod sealed {
    pub trait Sealed {}
    impl Sealed for f32 {}
    impl Sealed for f64 {}
}

/// A real number: `f32` (compared with a GPU) or `f64` (gradient checks).
///
/// The trait is sealed: code that is generic over it is generic over these two and nothing else.
pub trait Real:
    sealed::Sealed
    + Copy
    + Debug
    + Default
    + Display
    + PartialEq
    + PartialOrd
    + Send
    + Sync
    + 'static
    + Neg<Output = Self>
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + AddAssign
    + SubAssign
    + MulAssign
    + DivAssign
{
    /// 0.
    const ZERO: Self;
    /// 1.
    const ONE: Self;
    /// Distance from 1 to the next larger number.
    const EPSILON: Self;

    /// Nearest representable number.
    fn from_f64(x: f64) -> Self;
    /// Nearest `f32`.
    fn to_f32(self) -> f32;
    /// Exact for both implementors.
    fn to_f64(self) -> f64;
    /// Square root, correctly rounded.
    fn sqrt(self) -> Self;
    /// |x|.
    fn abs(self) -> Self;
    /// Largest integer not above x.
    fn floor(self) -> Self;
    /// Smallest integer not below x.
    fn ceil(self) -> Self;
    /// The larger one; a NaN loses against a number.
    fn max(self, other: Self) -> Self;
    /// The smaller one; a NaN loses against a number.
    fn min(self, other: Self) -> Self;
    /// Neither NaN nor infinite.
    fn is_finite(self) -> bool;
    /// eˣ.
    fn exp(self) -> Self;
    /// eˣ for x ≤ 0 in inner loops: [`crate::exp::exp_nonpositive`] for f32,
    /// plain [`Real::exp`] for f64.
    fn exp_nonpositive(self) -> Self;
    /// Natural logarithm.
    fn ln(self) -> Self;
    /// (sin x, cos x), x in radians.
    fn sin_cos(self) -> (Self, Self);
    /// tan x, x in radians.
    fn tan(self) -> Self;
    /// Angle of the point (x, y) = (`other`, `self`), in (-π, π].
    fn atan2(self, other: Self) -> Self;
    /// arccos, in [0, π].
    fn acos(self) -> Self;
    /// xʸ.
    fn powf(self, y: Self) -> Self;
    /// Total order (IEEE 754 totalOrder): the key to sort by.
    fn total_cmp(&self, other: &Self) -> std::cmp::Ordering;
}

macro_rules! impl_real {
    ($t:ty, $exp:path, $expnp:path, $ln:path, $sincos:path, $tan:path, $atan2:path, $acos:path, $pow:path) => {
        impl Real for $t {
            const ZERO: Self = 0.0;
            const ONE: Self = 1.0;
            const EPSILON: Self = <$t>::EPSILON;

            #[inline]
            #[allow(clippy::cast_possible_truncation, reason = "rounding is the purpose")]
            fn from_f64(x: f64) -> Self {
                x as $t
            }
            #[inline]
            #[allow(clippy::cast_possible_truncation, reason = "rounding is the purpose")]
            fn to_f32(self) -> f32 {
                self as f32
            }
            #[inline]
            fn to_f64(self) -> f64 {
                f64::from(self)
            }
            #[inline]
            fn sqrt(self) -> Self {
                <$t>::sqrt(self)
            }
            #[inline]
            fn abs(self) -> Self {
                <$t>::abs(self)
            }
            #[inline]
            fn floor(self) -> Self {
                <$t>::floor(self)
            }
            #[inline]
            fn ceil(self) -> Self {
                <$t>::ceil(self)
            }
            #[inline]
            fn max(self, other: Self) -> Self {
                <$t>::max(self, other)
            }
            #[inline]
            fn min(self, other: Self) -> Self {
                <$t>::min(self, other)
            }
            #[inline]
            fn is_finite(self) -> bool {
                <$t>::is_finite(self)
            }
            #[inline]
            fn exp(self) -> Self {
                $exp(self)
            }
            #[inline]
            fn exp_nonpositive(self) -> Self {
                $expnp(self)
            }
            #[inline]
            fn ln(self) -> Self {
                $ln(self)
            }
            #[inline]
            fn sin_cos(self) -> (Self, Self) {
                $sincos(self)
            }
            #[inline]
            fn tan(self) -> Self {
                $tan(self)
            }
            #[inline]
            fn atan2(self, other: Self) -> Self {
                $atan2(self, other)
            }
            #[inline]
            fn acos(self) -> Self {
                $acos(self)
            }
            #[inline]
            fn powf(self, y: Self) -> Self {
                $pow(self, y)
            }
            #[inline]
            fn total_cmp(&self, other: &Self) -> std::cmp::Ordering {
                <$t>::total_cmp(self, other)
            }
        }
    };
}

impl_real!(
    f32,
    libm::expf,
    crate::exp::exp_nonpositive,
    libm::logf,
    libm::sincosf,
    libm::tanf,
    libm::atan2f,
    libm::acosf,
    libm::powf
);
impl_real!(
    f64,
    libm::exp,
    libm::exp,
    libm::log,
    libm::sincos,
    libm::tan,
    libm::atan2,
    libm::acos,
    libm::pow
);

#[cfg(test)]
mod tests {
    use super::Real;

    /// The formula as written, for both widths, so that a wrong argument order in the macro shows.
    fn spec<T: Real>(tolerance: f64) {
        let near = |a: T, b: f64| assert!((a.to_f64() - b).abs() <= tolerance, "{a} against {b}");
        near(T::from_f64(1.0).exp(), std::f64::consts::E);
        near(T::from_f64(-1.0).exp_nonpositive(), 0.367_879_441_171_442_3);
        near(T::from_f64(std::f64::consts::E).ln(), 1.0);
        near(T::from_f64(0.5).sin_cos().0, 0.479_425_538_604_203);
        near(T::from_f64(0.5).sin_cos().1, 0.877_582_561_890_372_8);
        near(T::from_f64(0.5).tan(), 0.546_302_489_843_790_5);
        // y first: the point (x, y) = (-1, 1) lies in the second quadrant.
        near(
            T::from_f64(1.0).atan2(T::from_f64(-1.0)),
            3.0 * std::f64::consts::FRAC_PI_4,
        );
        near(T::from_f64(-1.0).acos(), std::f64::consts::PI);
        near(T::from_f64(2.0).powf(T::from_f64(10.0)), 1024.0);
    }

    #[test]
    fn functions_are_the_ones_they_are_named_after() {
        spec::<f32>(1e-6);
        spec::<f64>(4e-15);
    }

    #[test]
    fn nan_loses_against_a_number() {
        assert!(Real::max(f64::NAN, 1.0).is_finite(), "max");
        assert!(Real::min(1.0f32, f32::NAN).is_finite(), "min");
    }
}
