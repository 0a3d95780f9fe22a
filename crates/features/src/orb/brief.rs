//! Rotated BRIEF: 256 comparisons of a smoothed patch, turned by the keypoint's angle.

use garad_core::GrayImage;

use super::pattern::PATTERN;
use crate::descriptor::Descriptor;

/// Farthest pixel a rotated comparison can reach: round(13 √2) = 18.
pub const REACH: usize = 18;

/// Describes the patch around (x, y) of a blurred image.
///
/// Each point (px, py) of the pattern is turned by θ and rounded to a pixel, half to even:
///
/// (u, v) = (round(px cos θ - py sin θ), round(px sin θ + py cos θ))
///
/// and bit k says whether the first point of pair k is darker than the second.
///
/// # Numerics
/// θ = f32(`angle_deg` · f32(π/180)); cos and sin in f64, rounded to f32; products and sums in
/// f32 without fusing. These are ORB-SLAM's roundings, and descriptors are bit-equal to its own.
///
/// # Panics
/// If (x, y) is nearer than [`REACH`] to the edge.
#[must_use]
pub fn describe(blurred: &GrayImage, x: usize, y: usize, angle_deg: f32) -> Descriptor {
    let stride = blurred.width();
    let offsets = rotated_offsets(angle_deg, stride);
    // Every offset is relative to the patch's first pixel, so that all indices are unsigned.
    let start = (y - REACH) * stride + (x - REACH);
    let length = 2 * REACH * stride + 2 * REACH + 1;
    let patch = &blurred.data()[start..start + length];
    let mut words = [0u64; 4];
    for (word, pairs) in words.iter_mut().zip(offsets.chunks_exact(64)) {
        for (bit, &[p, q]) in pairs.iter().enumerate() {
            *word |= u64::from(patch[p as usize] < patch[q as usize]) << bit;
        }
    }
    Descriptor(words)
}

/// Adding this to |v| < 2²² leaves round(v), half to even, in the low bits of the sum.
const ROUNDER: f32 = 12_582_912.0; // 1.5 * 2²³

#[inline]
fn round_half_even(v: f32) -> i32 {
    (v + ROUNDER)
        .to_bits()
        .wrapping_sub(ROUNDER.to_bits())
        .cast_signed()
}

/// Index of each rotated point in a patch whose middle is (REACH, REACH).
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    reason = "rounding to f32 is the definition; a row is shorter than 2³¹ / 37 pixels"
)]
fn rotated_offsets(angle_deg: f32, stride: usize) -> [[u32; 2]; 256] {
    const RADIANS: f32 = (std::f64::consts::PI / 180.0) as f32;
    let (sin, cos) = libm::sincos(f64::from(angle_deg * RADIANS));
    let (sin, cos) = (sin as f32, cos as f32);
    let stride = stride as i32;
    let middle = REACH as i32 * (stride + 1);
    let index = |px: i8, py: i8| {
        let (px, py) = (f32::from(px), f32::from(py));
        let u = round_half_even(px * cos - py * sin);
        let v = round_half_even(px * sin + py * cos);
        (middle + v * stride + u).cast_unsigned()
    };
    let mut out = [[0; 2]; 256];
    for (out, &[x0, y0, x1, y1]) in out.iter_mut().zip(&PATTERN) {
        *out = [index(x0, y0), index(x1, y1)];
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::Rng;

    #[test]
    fn first_bits_by_hand() {
        // A ramp that brightens to the right: I(p) < I(q) if and only if p lies left of q.
        let ramp = GrayImage::from_fn(37, 37, |x, _| u8::try_from(x * 6).expect("byte"));
        let upright = describe(&ramp, 18, 18, 0.0);
        let turned = describe(&ramp, 18, 18, 90.0);
        for (k, &[x0, y0, x1, y1]) in PATTERN.iter().enumerate() {
            let bit = |d: Descriptor| d.0[k / 64] >> (k % 64) & 1 == 1;
            assert_eq!(bit(upright), x0 < x1, "pair {k} as it is");
            // A quarter turn takes (x, y) to (-y, x).
            assert_eq!(bit(turned), -y0 < -y1, "pair {k} turned");
        }
    }

    #[test]
    fn no_angle_leaves_the_patch() {
        // A 37 x 37 image is exactly the patch: one pixel more would panic.
        let mut rng = Rng::new(2);
        let noise = GrayImage::from_fn(37, 37, |_, _| u8::try_from(rng.below(256)).expect("byte"));
        let mut farthest = 0;
        for i in 0..3600u16 {
            let angle_deg = f32::from(i) * 0.1;
            let _ = describe(&noise, 18, 18, angle_deg);
            for [p, q] in rotated_offsets(angle_deg, 37) {
                for offset in [p, q] {
                    let (u, v) = (offset % 37, offset / 37);
                    farthest = farthest.max(u.abs_diff(18)).max(v.abs_diff(18));
                }
            }
        }
        assert_eq!(farthest as usize, REACH, "the reach is needed and enough");
    }

    #[test]
    fn rounding_by_addition_is_half_to_even() {
        for (v, expected) in [
            (-2.5f32, -2),
            (-1.5, -2),
            (-0.5, 0),
            (0.499_999_97, 0),
            (0.5, 0),
            (0.500_000_06, 1),
            (1.5, 2),
            (2.5, 2),
            (17.999_998, 18),
        ] {
            assert_eq!(round_half_even(v), expected, "{v}");
        }
    }
}
