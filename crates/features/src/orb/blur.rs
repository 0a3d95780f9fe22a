//! The 7x7 Gaussian, σ = 2, applied to an image before descriptors are computed.

use garad_core::pyramid::reflect_101;
use garad_core::{GrayImage, Image};

/// Taps in 1/256, rounded so that they add up to 256 (the error of each is carried to the next).
pub const TAPS: [u16; 7] = [18, 34, 48, 56, 48, 34, 18];

/// All taps are even. With half of each, a row's sums stay below 2¹⁵ and their pairs below 2¹⁶,
/// so that twice as many fit into an instruction; nothing is rounded.
const HALF_TAPS: [u16; 4] = [TAPS[0] / 2, TAPS[1] / 2, TAPS[2] / 2, TAPS[3] / 2];

/// Blurs with reflect-101 at the edge:
///
/// out(x, y) = (Σᵢⱼ wᵢ wⱼ in(x+i, y+j) + 2¹⁵) >> 16,   i, j = -3..3
///
/// Two passes of integers and one rounding: bit-equal to OpenCV's `GaussianBlur` of a whole
/// 8-bit image, which is what ORB-SLAM2 and 3 describe. `out` and `rows` are scratch whose
/// memory is used again. Golden: `pyramid/*` (`gauss7`).
pub fn blur_into(image: &GrayImage, rows: &mut Image<u16>, out: &mut GrayImage) {
    let (w, h) = image.size();
    if rows.size() != (w, h) {
        *rows = Image::new(w, h, 0);
        *out = GrayImage::new(w, h, 0);
    }
    for y in 0..h {
        blur_row(image.row(y), rows.row_mut(y));
    }
    for y in 0..h {
        let y_signed = y.cast_signed();
        let seven: [&[u16]; 7] =
            std::array::from_fn(|j| rows.row(reflect_101(y_signed + j.cast_signed() - 3, h)));
        blur_columns(seven, out.row_mut(y));
    }
}

/// Σᵢ wᵢ/2 in(x+i), at most 255 * 128.
fn blur_row(source: &[u8], out: &mut [u16]) {
    let w = source.len();
    let weigh = |p: [u8; 7]| -> u16 {
        let p = p.map(u16::from);
        let [t0, t1, t2, t3] = HALF_TAPS;
        t0 * (p[0] + p[6]) + t1 * (p[1] + p[5]) + t2 * (p[2] + p[4]) + t3 * p[3]
    };
    if let Some(inside) = out.get_mut(3..w.saturating_sub(3)) {
        for (out, s) in inside.iter_mut().zip(source.windows(7)) {
            *out = weigh([s[0], s[1], s[2], s[3], s[4], s[5], s[6]]);
        }
    }
    for x in (0..w.min(3)).chain(w.saturating_sub(3).max(3)..w) {
        let x_signed = x.cast_signed();
        out[x] = weigh(std::array::from_fn(|i| {
            source[reflect_101(x_signed + i.cast_signed() - 3, w)]
        }));
    }
}

/// (Σⱼ wⱼ/2 rowⱼ + 2¹³) >> 14: both passes have left out a factor of 2.
#[allow(clippy::cast_possible_truncation, reason = "a weighted mean of bytes")]
fn blur_columns(rows: [&[u16]; 7], out: &mut [u8]) {
    let w = out.len();
    let [a, b, c, d, e, f, g] = rows.map(|row| &row[..w]);
    let [t0, t1, t2, t3] = HALF_TAPS.map(u32::from);
    for x in 0..w {
        let sum = t0 * u32::from(a[x] + g[x])
            + t1 * u32::from(b[x] + f[x])
            + t2 * u32::from(c[x] + e[x])
            + t3 * u32::from(d[x])
            + (1 << 13);
        out[x] = (sum >> 14) as u8;
    }
}

/// [`blur_into`] with fresh memory.
#[must_use]
pub fn blur(image: &GrayImage) -> GrayImage {
    let (mut rows, mut out) = (Image::default(), GrayImage::default());
    blur_into(image, &mut rows, &mut out);
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::Rng;
    use proptest::prelude::*;

    #[test]
    fn taps_are_the_gaussian_and_lose_nothing() {
        assert_eq!(TAPS.iter().sum::<u16>(), 256, "unit gain");
        let gauss = |i: f64| libm::exp(-i * i / 8.0);
        let norm: f64 = (-3..=3).map(|i| gauss(f64::from(i))).sum();
        for (i, &tap) in (-3..=3).zip(&TAPS) {
            let exact = 256.0 * gauss(f64::from(i)) / norm;
            assert!(
                (f64::from(tap) - exact).abs() < 1.0,
                "tap {i}: {tap} against {exact}"
            );
        }
    }

    proptest! {
        #[test]
        fn blur_is_its_formula(w in 1usize..24, h in 1usize..24, seed: u64) {
            let mut rng = Rng::new(seed);
            let image = GrayImage::from_fn(w, h, |_, _| u8::try_from(rng.below(256)).expect("byte"));
            let expected = GrayImage::from_fn(w, h, |x, y| {
                let mut sum = 1u32 << 15;
                for (j, wj) in (-3isize..=3).zip(TAPS) {
                    for (i, wi) in (-3isize..=3).zip(TAPS) {
                        let x = reflect_101(x.cast_signed() + i, w);
                        let y = reflect_101(y.cast_signed() + j, h);
                        sum += u32::from(wi) * u32::from(wj) * u32::from(image[(x, y)]);
                    }
                }
                u8::try_from(sum >> 16).expect("a byte")
            });
            prop_assert_eq!(blur(&image), expected);
        }

        #[test]
        fn constants_stay(w in 1usize..20, h in 1usize..20, grey: u8) {
            let image = GrayImage::new(w, h, grey);
            prop_assert_eq!(blur(&image), image);
        }
    }
}
