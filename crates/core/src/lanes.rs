//! Eight numbers at once on the instruction set that the processor has, found out at run time: [`dispatch`].
//!
//! A [`Kernel`] is written once, generic over [`Lanes`], and compiled twice: with [`Portable`] lanes for what the build
//! asks for (SSE2 on x86-64, NEON on AArch64, by `wide`) and, on x86-64, with AVX2 (by `pulp`, which keeps the
//! `unsafe` of the feature test). Lane by lane both do the same IEEE operations, nothing is fused and nothing is summed
//! across lanes but in an order written down, so the bits are the same.
//!
//! A function reaches the instruction set of its kernel only where it is inlined into it: everything a kernel calls
//! in its loops is `#[inline(always)]`. Data lie in memory as arrays.

use std::fmt::Debug;
use std::ops::{Add, AddAssign, BitAnd, BitOr, BitXor, Div, Mul, Sub};
use std::sync::OnceLock;

use wide::bytemuck::cast;
use wide::{f32x4, f32x8, f64x4, i32x8, i64x4};

#[cfg(target_arch = "x86_64")]
mod avx2;

/// Eight f32. A mask is a vector, too: all bits of a lane or none.
pub trait F32x8:
    Copy
    + Debug
    + Add<Output = Self>
    + AddAssign
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + BitAnd<Output = Self>
    + BitOr<Output = Self>
    + BitXor<Output = Self>
{
    /// As they lie in memory.
    fn to_array(self) -> [f32; 8];
    /// Lanes 0 to 3 and 4 to 7.
    fn halves(self) -> [f32x4; 2];
    /// The smaller; `other` if either is NaN.
    #[must_use]
    fn min(self, other: Self) -> Self;
    /// The larger; `other` if either is NaN.
    #[must_use]
    fn max(self, other: Self) -> Self;
    /// Mask of self ≥ other.
    #[must_use]
    fn ge(self, other: Self) -> Self;
    /// Mask of self > other.
    #[must_use]
    fn gt(self, other: Self) -> Self;
    /// Mask of self ≤ other.
    #[must_use]
    fn le(self, other: Self) -> Self;
    /// |self|.
    #[must_use]
    fn abs(self) -> Self;
    /// √self.
    #[must_use]
    fn sqrt(self) -> Self;
    /// Of a mask: `yes` where it is set, `no` elsewhere.
    #[must_use]
    fn select(self, yes: Self, no: Self) -> Self;
    /// Bit i: lane i has the sign bit; of a mask, lane i is set.
    fn signs(self) -> u32;
    /// self · 2ⁿ, where n are the lowest nine bits of `n`'s lanes, in two's complement; self and the
    /// product are normal numbers.
    #[must_use]
    fn times_two_to(self, n: Self) -> Self;
}

/// Four f64.
pub trait F64x4:
    Copy
    + Debug
    + Add<Output = Self>
    + AddAssign
    + Sub<Output = Self>
    + Mul<Output = Self>
    + BitAnd<Output = Self>
{
    /// As they lie in memory.
    fn to_array(self) -> [f64; 4];
    /// The larger; `other` if either is NaN.
    #[must_use]
    fn max(self, other: Self) -> Self;
    /// Mask of self ≥ other.
    #[must_use]
    fn ge(self, other: Self) -> Self;
    /// √self.
    #[must_use]
    fn sqrt(self) -> Self;
    /// self · 2ⁿ, where n are the lowest twelve bits of `n`'s lanes, in two's complement; self and the
    /// product are normal numbers.
    #[must_use]
    fn times_two_to(self, n: Self) -> Self;
}

/// An instruction set: makes vectors, which then know it.
pub trait Lanes: Copy + Debug {
    /// Eight f32.
    type F32x8: F32x8;
    /// Four f64.
    type F64x4: F64x4;
    /// From memory.
    fn load(self, lanes: [f32; 8]) -> Self::F32x8;
    /// From memory.
    fn load_f64(self, lanes: [f64; 4]) -> Self::F64x4;

    /// The same number in every lane.
    #[inline(always)]
    fn splat(self, value: f32) -> Self::F32x8 {
        self.load([value; 8])
    }

    /// The same number in every lane.
    #[inline(always)]
    fn splat_f64(self, value: f64) -> Self::F64x4 {
        self.load_f64([value; 4])
    }
}

/// What is run by [`dispatch`].
pub trait Kernel {
    /// What it computes.
    type Output;
    /// Runs it; `#[inline(always)]`.
    fn run<L: Lanes>(self, lanes: L) -> Self::Output;
}

/// An instruction set that [`dispatch`] knows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Level {
    /// What the build asks for.
    Portable,
    /// x86-64 with AVX2 (x86-64-v3).
    Avx2,
}

/// Environment variable that holds [`dispatch`] to [`Level::Portable`] where it is `portable`. Results have the same
/// bits.
pub const LEVEL_VARIABLE: &str = "GARAD_LANES";

impl Level {
    /// The best that this processor has, unless [`LEVEL_VARIABLE`] says otherwise.
    #[must_use]
    pub fn current() -> Self {
        static LEVEL: OnceLock<Level> = OnceLock::new();
        *LEVEL.get_or_init(|| {
            let held = std::env::var_os(LEVEL_VARIABLE).is_some_and(|v| v == "portable");
            if held { Self::Portable } else { Self::best() }
        })
    }

    fn best() -> Self {
        #[cfg(target_arch = "x86_64")]
        if pulp::x86::V3::is_available() {
            return Self::Avx2;
        }
        Self::Portable
    }
}

/// Runs a kernel on [`Level::current`].
#[inline]
pub fn dispatch<K: Kernel>(kernel: K) -> K::Output {
    dispatch_to(Level::current(), kernel)
}

/// Runs a kernel on a level, or on [`Level::Portable`] where the processor does not have it.
#[inline]
pub fn dispatch_to<K: Kernel>(level: Level, kernel: K) -> K::Output {
    #[cfg(target_arch = "x86_64")]
    if let (Level::Avx2, Some(simd)) = (level, pulp::x86::V3::try_new()) {
        return simd.vectorize(avx2::OnAvx2 { simd, kernel });
    }
    let _ = level;
    kernel.run(Portable)
}

/// What the build asks for.
#[derive(Debug, Clone, Copy)]
pub struct Portable;

impl Lanes for Portable {
    type F32x8 = f32x8;
    type F64x4 = f64x4;

    #[inline(always)]
    fn load(self, lanes: [f32; 8]) -> f32x8 {
        f32x8::new(lanes)
    }

    #[inline(always)]
    fn load_f64(self, lanes: [f64; 4]) -> f64x4 {
        f64x4::new(lanes)
    }
}

impl F32x8 for f32x8 {
    #[inline(always)]
    fn to_array(self) -> [f32; 8] {
        self.to_array()
    }

    #[inline(always)]
    fn halves(self) -> [f32x4; 2] {
        cast(self)
    }

    #[inline(always)]
    fn min(self, other: Self) -> Self {
        self.fast_min(other)
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.fast_max(other)
    }

    #[inline(always)]
    fn ge(self, other: Self) -> Self {
        self.simd_ge(other)
    }

    #[inline(always)]
    fn gt(self, other: Self) -> Self {
        self.simd_gt(other)
    }

    #[inline(always)]
    fn le(self, other: Self) -> Self {
        self.simd_le(other)
    }

    #[inline(always)]
    fn abs(self) -> Self {
        self.abs()
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        self.sqrt()
    }

    #[inline(always)]
    fn select(self, yes: Self, no: Self) -> Self {
        self.bitselect(yes, no)
    }

    #[inline(always)]
    fn signs(self) -> u32 {
        self.to_bitmask()
    }

    #[inline(always)]
    fn times_two_to(self, n: Self) -> Self {
        let exponent: i32x8 = cast::<Self, i32x8>(n) << 23i32;
        cast(cast::<Self, i32x8>(self) + exponent)
    }
}

impl F64x4 for f64x4 {
    #[inline(always)]
    fn to_array(self) -> [f64; 4] {
        self.to_array()
    }

    #[inline(always)]
    fn max(self, other: Self) -> Self {
        self.fast_max(other)
    }

    #[inline(always)]
    fn ge(self, other: Self) -> Self {
        self.simd_ge(other)
    }

    #[inline(always)]
    fn sqrt(self) -> Self {
        self.sqrt()
    }

    #[inline(always)]
    fn times_two_to(self, n: Self) -> Self {
        let exponent: i64x4 = cast::<Self, i64x4>(n) << 52i64;
        cast(cast::<Self, i64x4>(self) + exponent)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// All of the operations, on numbers that differ in every lane, as bits.
    struct Everything;

    impl Kernel for Everything {
        type Output = (Vec<u32>, Vec<u64>);

        #[inline(always)]
        fn run<L: Lanes>(self, lanes: L) -> Self::Output {
            let a = lanes.load([1.5, -2.25, 0.1, f32::NAN, -0.0, 7e-20, 3e30, -1.0]);
            let b = lanes.load([0.7, -2.25, 0.3, 2.0, 0.0, f32::NAN, -1e-3, 5.0]);
            let n =
                lanes.splat(12_582_912.0) + lanes.load([3.0, -7.0, 0.0, 1.0, 9.0, -4.0, 2.0, -1.0]);
            let mut sum = a;
            sum += b;
            let mask = a.ge(b);
            let vectors = [
                a + b,
                sum,
                a - b,
                a * b,
                a / b,
                a & b,
                a | b,
                a ^ b,
                a.min(b),
                b.min(a),
                a.max(b),
                b.max(a),
                mask,
                a.gt(b),
                a.le(b),
                a.abs(),
                a.sqrt(),
                mask.select(a, b),
                b.times_two_to(n),
            ];
            let mut bits: Vec<u32> = vectors
                .iter()
                .flat_map(|v| v.to_array().map(f32::to_bits))
                .collect();
            bits.extend(
                a.halves()
                    .iter()
                    .flat_map(|h| h.to_array().map(f32::to_bits)),
            );
            bits.push(a.signs());
            let c = lanes.load_f64([1.5, f64::NAN, -0.1, 2e100]);
            let d = lanes.load_f64([0.3, 2.0, f64::NAN, -4.0]);
            let n =
                lanes.splat_f64(6_755_399_441_055_744.0) + lanes.load_f64([3.0, -70.0, 0.0, 1.0]);
            let mut sum = c;
            sum += d;
            let vectors = [
                c + d,
                sum,
                c - d,
                c * d,
                c & d,
                c.max(d),
                d.max(c),
                c.ge(d),
                c.sqrt(),
                d.times_two_to(n),
            ];
            (
                bits,
                vectors
                    .iter()
                    .flat_map(|v| v.to_array().map(f64::to_bits))
                    .collect(),
            )
        }
    }

    /// On a processor without AVX2 both sides are portable, and nothing is compared.
    #[test]
    fn every_operation_has_the_same_bits_on_every_level() {
        let (single, double) = dispatch_to(Level::Portable, Everything);
        let (on_avx2, double_on_avx2) = dispatch_to(Level::Avx2, Everything);
        // The sign of a NaN that an operation makes is not defined; a NaN is.
        let same =
            |a: &u32, b: &u32| a == b || f32::from_bits(*a).is_nan() && f32::from_bits(*b).is_nan();
        let first = single.iter().zip(&on_avx2).position(|(a, b)| !same(a, b));
        assert_eq!((first, single.len()), (None, on_avx2.len()), "f32");
        let same =
            |a: &u64, b: &u64| a == b || f64::from_bits(*a).is_nan() && f64::from_bits(*b).is_nan();
        let first = double
            .iter()
            .zip(&double_on_avx2)
            .position(|(a, b)| !same(a, b));
        assert_eq!((first, double.len()), (None, double_on_avx2.len()), "f64");
    }

    /// -0.0 is not 0.0.
    fn bits<const N: usize>(lanes: [f32; N]) -> [u32; N] {
        lanes.map(f32::to_bits)
    }

    /// By hand, lane by lane.
    struct ByHand;

    impl Kernel for ByHand {
        type Output = ();

        #[inline(always)]
        fn run<L: Lanes>(self, lanes: L) {
            let a = lanes.load([1.0, -2.0, 3.0, f32::NAN, 5.0, -6.0, 7.0, -0.0]);
            let b = lanes.splat(4.0);
            assert_eq!(
                bits(a.min(b).to_array()),
                bits([1.0, -2.0, 3.0, 4.0, 4.0, -6.0, 4.0, -0.0]),
                "min"
            );
            assert_eq!(
                bits(a.max(b).to_array()),
                bits([4.0, 4.0, 4.0, 4.0, 5.0, 4.0, 7.0, 4.0]),
                "max"
            );
            assert!(
                b.max(a).to_array()[3].is_nan(),
                "the second where either is NaN"
            );
            let [ge, gt, le] =
                [a.ge(b), a.gt(lanes.splat(5.0)), a.le(lanes.splat(3.0))].map(F32x8::signs);
            assert_eq!(
                [ge, gt, le],
                [0b0101_0000, 0b0100_0000, 0b1010_0111],
                "comparisons"
            );
            assert_eq!(
                a.signs() & !(1 << 3),
                0b1010_0010,
                "signs, that of a NaN aside"
            );
            let chosen = a.ge(b).select(lanes.splat(1.0), lanes.splat(2.0));
            assert_eq!(
                bits(chosen.to_array()),
                bits([2.0, 2.0, 2.0, 2.0, 1.0, 2.0, 1.0, 2.0]),
                "select"
            );
            let [low, high] = a.halves();
            assert_eq!(
                (low.to_array()[2], high.to_array()[1]),
                (3.0, -6.0),
                "halves"
            );
            // 1.5 · 2²³ + n has n in its lowest bits.
            let n = lanes.load([12_582_912.0 - 3.0; 8]);
            assert_eq!(bits(b.times_two_to(n).to_array()), bits([0.5; 8]), "4 / 8");
            let n = lanes.splat_f64(6_755_399_441_055_744.0 + 5.0);
            let product = lanes.splat_f64(1.5).times_two_to(n).to_array();
            assert_eq!(
                product.map(f64::to_bits),
                [48.0f64.to_bits(); 4],
                "1.5 · 32"
            );
        }
    }

    #[test]
    fn operations_by_hand() {
        dispatch_to(Level::Portable, ByHand);
        dispatch_to(Level::Avx2, ByHand);
    }
}
