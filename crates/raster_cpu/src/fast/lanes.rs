//! Eight pixels at once: the arithmetic that `wide` does not have, in an order that is ours.

use wide::bytemuck::cast;
use wide::{f32x4, f32x8, i32x8};

/// Columns of the eight pixels of a block, which is four wide and two high.
pub(crate) const COLUMNS: f32x8 = f32x8::new([0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0]);
/// Their rows.
pub(crate) const ROWS: f32x8 = f32x8::new([0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0]);

/// [`garad_core::exp::exp_nonpositive`] in each lane, operation by operation: the same bits.
#[inline(always)]
pub(crate) fn exp_nonpositive(x: f32x8) -> f32x8 {
    let smallest = f32x8::splat(-87.0);
    let round = f32x8::splat(12_582_912.0);
    // What a NaN leaves here is thrown away below.
    let reduced = x.fast_max(smallest);
    let shifted = reduced * f32x8::splat(std::f32::consts::LOG2_E) + round;
    let n = shifted - round;
    let high = reduced - n * f32x8::splat(0.693_145_75);
    let low = n * f32x8::splat(1.428_606_8e-6);
    let r = high - low;
    let tail = f32x8::splat(1.0 / 5040.0);
    let tail = f32x8::splat(1.0 / 720.0) + r * tail;
    let tail = f32x8::splat(1.0 / 120.0) + r * tail;
    let tail = f32x8::splat(1.0 / 24.0) + r * tail;
    let tail = f32x8::splat(1.0 / 6.0) + r * tail;
    let tail = f32x8::splat(0.5) + r * tail;
    let exp_r = f32x8::ONE + (high - (low - r * r * tail));
    let exponent: i32x8 = cast::<f32x8, i32x8>(shifted) << 23i32;
    let scaled: f32x8 = cast(cast::<f32x8, i32x8>(exp_r) + exponent);
    scaled & x.simd_ge(smallest)
}

/// The sums of four vectors' lanes, each as ((0 + 4) + (1 + 5)) + ((2 + 6) + (3 + 7)).
#[inline(always)]
pub(crate) fn sums(of: [f32x8; 4]) -> [f32; 4] {
    let halves = of.map(|v| {
        let [low, high] = cast::<f32x8, [f32x4; 2]>(v);
        low + high
    });
    let [a, b, c, d] = f32x4::transpose(halves);
    ((a + b) + (c + d)).to_array()
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::exp;

    #[test]
    fn exponential_has_the_bits_of_the_scalar_one() {
        let (first, last) = ((-0.0f32).to_bits(), (-90.0f32).to_bits());
        let mut inputs: Vec<f32> = (first..=last).step_by(1009).map(f32::from_bits).collect();
        inputs.extend([f32::NAN, -f32::NAN, f32::NEG_INFINITY, -87.0, -87.000_01]);
        for x in inputs.chunks(8) {
            let mut lanes = [-1.0; 8];
            lanes[..x.len()].copy_from_slice(x);
            let got = exp_nonpositive(f32x8::new(lanes)).to_array();
            for (got, x) in got.iter().zip(lanes) {
                let want = exp::exp_nonpositive(x);
                assert_eq!(got.to_bits(), want.to_bits(), "e^{x}: {got} against {want}");
            }
        }
    }

    #[test]
    fn lanes_are_added_in_the_order_that_is_written() {
        // Any other order of these loses other digits.
        let v = [1e8f32, 3.0, -1e8, 7.0, 1.5, -2e7, 9.0, 2e7];
        let expected = ((v[0] + v[4]) + (v[1] + v[5])) + ((v[2] + v[6]) + (v[3] + v[7]));
        let ones = f32x8::ONE;
        let got = sums([f32x8::new(v), ones, ones + ones, COLUMNS + ROWS]);
        assert_eq!(got[0].to_bits(), expected.to_bits(), "tree");
        assert!(got[1..] == [8.0, 16.0, 16.0], "each on its own: {got:?}");
    }
}
