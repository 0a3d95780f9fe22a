//! [`exp_nonpositive`]: eˣ for x ≤ 0 in f32, without branches, so that loops over it vectorise.
//!
//! `libm::expf` decides by the size of x how to reduce it, which costs 10 to 15 ns per call where
//! an image needs ten million of them. For x ≤ 0 one reduction serves all.

/// Below this the answer is 0: e⁻⁸⁷ = 1.6e-38 is the last whole unit above the subnormals.
const SMALLEST: f32 = -87.0;
/// Added and subtracted again, it rounds a number below 2²² to the nearest integer.
const ROUND: f32 = 12_582_912.0; // 1.5 · 2²³
/// ln 2 = `LN2_HIGH` + `LN2_LOW`; the first has 15 bits, so that its product with |n| < 128 is exact.
const LN2_HIGH: f32 = 0.693_145_75;
const LN2_LOW: f32 = 1.428_606_8e-6;

/// eˣ for x ≤ 0, within 1 ulp; 0 for x < -87 and for NaN.
///
/// eˣ = 2ⁿ eʳ, n = round(x / ln 2), r = x - n ln 2, |r| ≤ 0.347;
/// eʳ = 1 + r + r² (1/2! + r/3! + ... + r⁵/7!), cut off with an error below r⁸/8! = 5e-9
///
/// Multiplications and additions only, so the bits are the same on every machine.
///
/// # Example
/// ```
/// use garad_core::exp::exp_nonpositive;
/// assert_eq!(exp_nonpositive(0.0), 1.0);
/// assert_eq!(exp_nonpositive(-0.5), 0.606_530_66);
/// assert_eq!(exp_nonpositive(-100.0), 0.0);
/// ```
#[inline]
#[must_use]
pub fn exp_nonpositive(x: f32) -> f32 {
    // A NaN fails the comparison.
    let reduced = if x > SMALLEST { x } else { SMALLEST };
    let shifted = reduced * std::f32::consts::LOG2_E + ROUND;
    let n = shifted - ROUND;
    // r = high - low; high is exact and enters the sum unrounded.
    let (high, low) = (reduced - n * LN2_HIGH, n * LN2_LOW);
    let r = high - low;
    let tail = 1.0 / 5040.0;
    let tail = 1.0 / 720.0 + r * tail;
    let tail = 1.0 / 120.0 + r * tail;
    let tail = 1.0 / 24.0 + r * tail;
    let tail = 1.0 / 6.0 + r * tail;
    let tail = 0.5 + r * tail;
    let exp_r = 1.0 + (high - (low - r * r * tail));
    // The lowest bits of `shifted` are n: moved up, they add to the exponent.
    let scaled = f32::from_bits(exp_r.to_bits().wrapping_add(shifted.to_bits() << 23));
    if x >= SMALLEST { scaled } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Largest error in ulp over every `step`-th float from -0 to -87.
    fn worst_ulp(step: usize) -> f64 {
        let (first, last) = ((-0.0f32).to_bits(), SMALLEST.to_bits());
        (first..=last)
            .step_by(step)
            .map(|bits| {
                let x = f32::from_bits(bits);
                let exact = libm::exp(f64::from(x));
                let got = exp_nonpositive(x);
                let below = f32::from_bits(got.to_bits() - 1);
                (f64::from(got) - exact).abs() / (f64::from(got) - f64::from(below))
            })
            .fold(0.0, f64::max)
    }

    #[test]
    fn within_one_ulp() {
        let worst = worst_ulp(997);
        assert!(worst < 1.0, "{worst} ulp");
    }

    #[test]
    #[ignore = "half a minute in a release build: every number of the range"]
    fn within_one_ulp_everywhere() {
        let worst = worst_ulp(1);
        assert!(worst < 1.0, "{worst} ulp");
    }

    #[test]
    fn ends_of_the_range() {
        assert_eq!(exp_nonpositive(-0.0).to_bits(), 1.0f32.to_bits(), "e^0");
        assert!(
            exp_nonpositive(SMALLEST) > f32::MIN_POSITIVE,
            "still a normal number"
        );
        for x in [-87.000_01, -1e30, f32::NEG_INFINITY, f32::NAN, -f32::NAN] {
            assert_eq!(exp_nonpositive(x).to_bits(), 0, "nothing left at {x}");
        }
        // LN2_HIGH: its last nine bits are zero.
        assert_eq!(LN2_HIGH.to_bits() & 0x1ff, 0, "the product with n is exact");
        let ln2 = f64::from(LN2_HIGH) + f64::from(LN2_LOW);
        assert!((ln2 - std::f64::consts::LN_2).abs() < 1e-13, "{ln2}");
    }
}
