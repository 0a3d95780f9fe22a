//! [`N`]: f32 as different processors compute it.

use std::cmp::Ordering;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

use garad_core::Real;

/// A number in f32; with `FMA` products are added without rounding in between, with `FTZ` what is below the normal
/// numbers is zero. Both are what GPUs do.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(crate) struct N<const FMA: bool, const FTZ: bool>(pub(crate) f32);

impl<const FMA: bool, const FTZ: bool> N<FMA, FTZ> {
    pub(crate) const ZERO: Self = Self(0.0);
    pub(crate) const ONE: Self = Self(1.0);

    pub(crate) fn new(v: f64) -> Self {
        Self::flushed(v.to_f32())
    }

    fn flushed(v: f32) -> Self {
        Self(if FTZ && v.is_subnormal() { 0.0 } else { v })
    }

    pub(crate) fn wide(self) -> f64 {
        f64::from(self.0)
    }

    /// self · b + c.
    pub(crate) fn times_plus(self, b: Self, c: Self) -> Self {
        match FMA {
            // A product of two f32 is exact in f64.
            true => Self::flushed((self.wide() * b.wide() + c.wide()).to_f32()),
            false => self * b + c,
        }
    }

    pub(crate) fn sqrt(self) -> Self {
        Self::flushed(self.0.sqrt())
    }

    pub(crate) fn exp(self) -> Self {
        Self::flushed(Real::exp(self.0))
    }

    pub(crate) fn min(self, other: Self) -> Self {
        if other < self { other } else { self }
    }

    pub(crate) fn max(self, other: Self) -> Self {
        if other > self { other } else { self }
    }

    pub(crate) fn abs(self) -> Self {
        Self(self.0.abs())
    }
}

impl<const FMA: bool, const FTZ: bool> PartialOrd for N<FMA, FTZ> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        self.0.partial_cmp(&other.0)
    }
}

macro_rules! operator {
    ($($trait:ident, $name:ident, $op:tt);*) => {$(
        impl<const FMA: bool, const FTZ: bool> $trait for N<FMA, FTZ> {
            type Output = Self;
            fn $name(self, other: Self) -> Self {
                Self::flushed(self.0 $op other.0)
            }
        }
    )*};
}
operator!(Add, add, +; Sub, sub, -; Mul, mul, *; Div, div, /);

impl<const FMA: bool, const FTZ: bool> Neg for N<FMA, FTZ> {
    type Output = Self;
    fn neg(self) -> Self {
        Self(-self.0)
    }
}

impl<const FMA: bool, const FTZ: bool> AddAssign for N<FMA, FTZ> {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl<const FMA: bool, const FTZ: bool> SubAssign for N<FMA, FTZ> {
    fn sub_assign(&mut self, other: Self) {
        *self = *self - other;
    }
}

/// A sum of products.
pub(crate) fn dot<const M: bool, const Z: bool>(a: &[N<M, Z>], b: &[N<M, Z>]) -> N<M, Z> {
    let pairs = a.iter().zip(b);
    pairs.fold(N::ZERO, |sum, (a, b)| a.times_plus(*b, sum))
}

/// A 3x3 matrix, row by row.
pub(crate) type Mat<const M: bool, const Z: bool> = [[N<M, Z>; 3]; 3];

pub(crate) fn apply<const M: bool, const Z: bool>(m: &Mat<M, Z>, v: &[N<M, Z>; 3]) -> [N<M, Z>; 3] {
    [0, 1, 2].map(|i| dot(&m[i], v))
}

pub(crate) fn transposed<const M: bool, const Z: bool>(m: &Mat<M, Z>) -> Mat<M, Z> {
    [0, 1, 2].map(|i| [m[0][i], m[1][i], m[2][i]])
}

pub(crate) fn cross<const M: bool, const Z: bool>(
    a: &[N<M, Z>; 3],
    b: &[N<M, Z>; 3],
) -> [N<M, Z>; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

/// exp that is off by up to so many units in the last place, by an amount that follows from its argument.
pub(crate) fn rough_exp<const M: bool, const Z: bool>(x: N<M, Z>, ulp: u32) -> N<M, Z> {
    let exact = x.exp();
    if ulp == 0 || exact.0 <= 0.0 || !exact.0.is_normal() {
        return exact;
    }
    let mixed =
        x.0.to_bits()
            .wrapping_mul(0x9E37_79B9)
            .rotate_left(13)
            .wrapping_mul(0x85EB_CA6B);
    let off = mixed % (2 * ulp + 1);
    N(f32::from_bits(exact.0.to_bits() + off - ulp))
}
