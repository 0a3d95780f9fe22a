//! eˣ for x ≤ 0 in four f64 lanes at once, without branches.

use wide::bytemuck::cast;
use wide::{f64x4, i64x4};

/// Below this the answer is 0: e⁻⁷⁰⁸ = 3.3e-308 is the last whole unit above the subnormals.
const SMALLEST: f64 = -708.0;
/// Added and taken away again, it rounds a number below 2⁵¹ to the nearest integer.
const ROUND: f64 = 6_755_399_441_055_744.0; // 1.5 · 2⁵²
/// ln 2 = `LN2_HIGH` + `LN2_LOW`; the first has 42 bits, so that its product with |n| < 2¹¹ is exact.
const LN2_HIGH: f64 = 0.693_147_180_559_890_3;
const LN2_LOW: f64 = 5.497_923_018_708_371e-14;

/// 1/2!, 1/3!, ... 1/13!
const INVERSE_FACTORIALS: [f64; 12] = [
    1.0 / 2.0,
    1.0 / 6.0,
    1.0 / 24.0,
    1.0 / 120.0,
    1.0 / 720.0,
    1.0 / 5040.0,
    1.0 / 40_320.0,
    1.0 / 362_880.0,
    1.0 / 3_628_800.0,
    1.0 / 39_916_800.0,
    1.0 / 479_001_600.0,
    1.0 / 6_227_020_800.0,
];

/// eˣ for x ≤ 0 in each lane, within 1 ulp; 0 for x < -708 and for NaN.
///
/// eˣ = 2ⁿ eʳ, n = round(x / ln 2), r = x - n ln 2, |r| ≤ 0.347;
/// eʳ = 1 + r + r² (1/2! + r/3! + ... + r¹¹/13!), cut off with an error below r¹⁴/14! = 4e-18
///
/// Multiplications and additions only, so the bits are the same on every machine.
#[inline(always)]
pub(crate) fn exp_nonpositive(x: f64x4) -> f64x4 {
    let smallest = f64x4::splat(SMALLEST);
    // A NaN gives some number here, which is masked below.
    let reduced = x.fast_max(smallest);
    let shifted = reduced * f64x4::splat(std::f64::consts::LOG2_E) + f64x4::splat(ROUND);
    let n = shifted - f64x4::splat(ROUND);
    // r = high - low; high is exact and enters the sum unrounded.
    let high = reduced - n * f64x4::splat(LN2_HIGH);
    let low = n * f64x4::splat(LN2_LOW);
    let r = high - low;
    let mut tail = f64x4::splat(INVERSE_FACTORIALS[11]);
    for coefficient in INVERSE_FACTORIALS[..11].iter().rev() {
        tail = f64x4::splat(*coefficient) + r * tail;
    }
    let exp_r = f64x4::ONE + (high - (low - r * r * tail));
    // The lowest bits of `shifted` are n: moved up, they add to the exponent.
    let exponent: i64x4 = cast::<f64x4, i64x4>(shifted) << 52i64;
    let scaled: f64x4 = cast(cast::<f64x4, i64x4>(exp_r) + exponent);
    scaled & x.simd_ge(smallest)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// e^x of one number, through all lanes.
    fn exp_of(x: f64) -> f64 {
        let lanes = exp_nonpositive(f64x4::splat(x)).to_array();
        assert!(
            lanes.iter().all(|l| l.to_bits() == lanes[0].to_bits()),
            "lanes differ at {x}"
        );
        lanes[0]
    }

    /// `libm::exp` is itself within 1 ulp.
    #[test]
    fn within_two_ulp_of_libm() {
        let mut x = 0.0;
        while x > SMALLEST {
            let (got, want) = (exp_of(x), libm::exp(x));
            let ulps = got.to_bits().abs_diff(want.to_bits());
            assert!(ulps <= 1, "{ulps} ulp at {x}: {got} instead of {want}");
            x = x * 1.000_31 - 1e-4;
        }
    }

    #[test]
    fn ends_of_the_range() {
        for zero in [0.0, -0.0] {
            assert_eq!(exp_of(zero).to_bits(), 1.0f64.to_bits(), "e^0");
        }
        assert!(
            exp_of(SMALLEST) > f64::MIN_POSITIVE,
            "still a normal number"
        );
        for x in [-708.000_1, -1e300, f64::NEG_INFINITY, f64::NAN] {
            assert!(exp_of(x) == 0.0, "nothing left at {x}");
        }
        // The product with n is exact: the last eleven bits are zero.
        assert_eq!(LN2_HIGH.to_bits() & 0x7ff, 0, "bits of LN2_HIGH");
        assert!(
            (LN2_HIGH + LN2_LOW - std::f64::consts::LN_2).abs() < 1e-16,
            "ln 2"
        );
    }
}
