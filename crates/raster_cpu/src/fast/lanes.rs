//! Eight pixels at once: what [`garad_core::lanes`] does not have, in an order that is ours.

use garad_core::lanes::{F32x8, Lanes};
use wide::f32x4;

/// 2ˣ for x ≤ 0 in each lane, within 2.7e-7 of it; 2⁻¹⁰⁰ for x < -100 and for NaN.
///
/// 2ˣ = 2ⁿ 2ᶠ, n = round(x), |f| ≤ ½; 2ᶠ is the polynomial of degree 5 whose largest relative
/// error is least, 7.5e-8 before rounding.
///
/// Multiplications and additions only, so the bits are the same on every machine.
#[inline(always)]
pub(crate) fn exp2_nonpositive<L: Lanes>(lanes: L, x: L::F32x8) -> L::F32x8 {
    // Added and taken away again, it rounds a number below 2²² to the nearest integer.
    let round = lanes.splat(12_582_912.0);
    let x = x.max(lanes.splat(-100.0));
    let shifted = x + round;
    let f = x - (shifted - round);
    // In pairs: half the latency of Horner's rule.
    let square = f * f;
    let p45 = lanes.splat(0.009_675_541) + f * lanes.splat(0.001_327_647_2);
    let p23 = lanes.splat(0.240_221_2) + f * lanes.splat(0.055_507_13);
    let p01 = lanes.splat(1.000_000_1) + f * lanes.splat(0.693_146_94);
    let p = p01 + square * (p23 + square * p45);
    // The lowest bits of `shifted` are n.
    p.times_two_to(shifted)
}

/// The sums of four vectors' lanes, each as ((0 + 4) + (1 + 5)) + ((2 + 6) + (3 + 7)).
#[inline(always)]
pub(crate) fn sums<V: F32x8>(of: [V; 4]) -> f32x4 {
    let halves = of.map(|v| {
        let [low, high] = v.halves();
        low + high
    });
    let [a, b, c, d] = f32x4::transpose(halves);
    (a + b) + (c + d)
}

#[cfg(test)]
mod tests {
    use garad_core::lanes::Portable;

    use super::*;

    #[test]
    fn powers_of_two_within_the_documented_error() {
        let (first, last) = ((-0.0f32).to_bits(), (-100.0f32).to_bits());
        let mut inputs: Vec<f32> = (first..=last).step_by(1009).map(f32::from_bits).collect();
        inputs.extend([-0.5, -1.5, -99.5, -100.0]);
        let mut worst = 0.0f64;
        for x in inputs.chunks(8) {
            let mut lanes = [-1.0; 8];
            lanes[..x.len()].copy_from_slice(x);
            let got = exp2_nonpositive(Portable, Portable.load(lanes)).to_array();
            for (got, x) in got.iter().zip(lanes) {
                let exact = garad_core::Real::exp(f64::from(x) * std::f64::consts::LN_2);
                worst = worst.max((f64::from(*got) / exact - 1.0).abs());
            }
        }
        assert!(worst < 2.7e-7, "{worst:e}");
    }

    #[test]
    fn powers_of_two_end_at_minus_one_hundred() {
        let beyond = [
            f32::NAN,
            -f32::NAN,
            f32::NEG_INFINITY,
            -100.01,
            -1e30,
            -127.0,
            -100.0,
            -3e38,
        ];
        let floor = exp2_nonpositive(Portable, Portable.splat(-100.0)).to_array()[0];
        assert!(floor > 0.0 && floor < 1e-30, "{floor:e}");
        let got = exp2_nonpositive(Portable, Portable.load(beyond)).to_array();
        assert!(
            got.iter().all(|v| v.to_bits() == floor.to_bits()),
            "{got:?}"
        );
    }

    #[test]
    fn lanes_are_added_in_the_order_that_is_written() {
        // Any other order of these loses other digits.
        let v = [1e8f32, 3.0, -1e8, 7.0, 1.5, -2e7, 9.0, 2e7];
        let expected = ((v[0] + v[4]) + (v[1] + v[5])) + ((v[2] + v[6]) + (v[3] + v[7]));
        let ones = Portable.splat(1.0);
        let steps = Portable.load([0.0, 1.0, 2.0, 3.0, 1.0, 2.0, 3.0, 4.0]);
        let got = sums([Portable.load(v), ones, ones + ones, steps]).to_array();
        assert_eq!(got[0].to_bits(), expected.to_bits(), "tree");
        assert!(got[1..] == [8.0, 16.0, 16.0], "each on its own: {got:?}");
    }
}
