//! Both pyramids of the system: halving for training and flow, a factor of 1.2 for ORB.
//!
//! * Halving: smooth with [1 4 6 4 1]/16 along both axes, keep every second sample. Pixel (x, y)
//!   of the half picture lies exactly on pixel (2x, 2y), so f and c halve ([`crate::Camera::level`]).
//!   [`halve`] is the 8-bit form with one rounding (the bits of OpenCV's `pyrDown`),
//!   [`halve_real`] the same filter on numbers, for the training pictures of eq. 16.
//! * ORB: each level is the one before it, resized bilinearly in 11-bit integers
//!   ([`resize_linear`], the bits of OpenCV's `INTER_LINEAR`).
//!
//! Both are integer arithmetic on 8-bit pictures: one answer everywhere.

use crate::image::{GrayImage, Image};
use crate::real::Real;

/// A picture at several sizes, the largest first.
///
/// # Example
/// ```
/// use garad_core::{GrayImage, pyramid::GrayPyramid};
/// let pyramid = GrayPyramid::halved(GrayImage::new(9, 6, 7), 2);
/// let sizes: Vec<_> = pyramid.levels().iter().map(|l| l.size()).collect();
/// assert_eq!(sizes, [(9, 6), (5, 3), (3, 2)]);
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct GrayPyramid {
    levels: Vec<GrayImage>,
    scales: Vec<f32>,
}

impl GrayPyramid {
    /// The picture and `above` levels, each [`halve`] of the one before.
    #[must_use]
    pub fn halved(image: GrayImage, above: usize) -> Self {
        let mut levels = vec![image];
        let mut scales = vec![1.0f32];
        for l in 0..above {
            levels.push(halve(&levels[l]));
            scales.push(scales[l] * 2.0);
        }
        Self { levels, scales }
    }

    /// The ORB pyramid: `count` levels in all, sizes by [`level_sizes`], each level
    /// [`resize_linear`] of the one before.
    #[must_use]
    pub fn scaled(image: GrayImage, factor: f32, count: usize) -> Self {
        let sizes = level_sizes(image.size(), factor, count);
        let mut levels = vec![image];
        for l in 1..count {
            levels.push(resize_linear(&levels[l - 1], sizes[l]));
        }
        Self {
            levels,
            scales: level_scales(factor, count.max(1)),
        }
    }

    /// All levels, the largest first.
    #[must_use]
    pub fn levels(&self) -> &[GrayImage] {
        &self.levels
    }

    /// How many pixels of level 0 one pixel of `level` spans.
    ///
    /// # Panics
    /// If there is no such level.
    #[must_use]
    pub fn scale(&self, level: usize) -> f32 {
        self.scales[level]
    }
}

/// Mirror index without repeating the edge pixel (reflect-101): -1 → 1, n → n-2.
#[must_use]
pub fn reflect_101(mut i: isize, n: usize) -> usize {
    let last = n.cast_signed() - 1;
    if last <= 0 {
        return 0;
    }
    // A window may be wider than the picture: mirror until the index falls inside.
    while i < 0 || i > last {
        i = if i < 0 { -i } else { 2 * last - i };
    }
    i.unsigned_abs()
}

/// The five source columns (or rows) around sample 2i.
fn five_taps(i: usize, n: usize) -> [usize; 5] {
    let centre = (2 * i).cast_signed();
    [-2, -1, 0, 1, 2].map(|d: isize| reflect_101(centre + d, n))
}

/// Half the size, ⌈w/2⌉ x ⌈h/2⌉:
///
/// out(x, y) = (Σᵢⱼ wᵢ wⱼ in(2x+i, 2y+j) + 128) >> 8,   w = 1 4 6 4 1, i, j = -2..2
///
/// with reflect-101 at the edge and a single rounding. Bit-equal to OpenCV's `pyrDown`.
/// Source: Burt & Adelson 1983. Golden: `pyramid/*`.
#[must_use]
pub fn halve(image: &GrayImage) -> GrayImage {
    let (w, h) = image.size();
    let (half_w, half_h) = (w.div_ceil(2), h.div_ceil(2));
    // Rows first: 16 * 255 fits 16 bits, and so does 16 times that plus the rounding.
    let mut rows = Image::new(half_w, h, 0u16);
    for y in 0..h {
        let source = image.row(y);
        let smooth = |[a, b, c, d, e]: [u8; 5]| {
            (u16::from(a) + u16::from(e)) + 4 * (u16::from(b) + u16::from(d)) + 6 * u16::from(c)
        };
        let out = rows.row_mut(y);
        let inside = 1..w.saturating_sub(1) / 2; // 2x-2 >= 0 and 2x+2 <= w-1
        for (out, s) in out
            .iter_mut()
            .skip(1)
            .zip(source.windows(5).step_by(2))
            .take(inside.len())
        {
            *out = smooth([s[0], s[1], s[2], s[3], s[4]]);
        }
        for x in (0..half_w).filter(|x| !inside.contains(x)) {
            out[x] = smooth(five_taps(x, w).map(|i| source[i]));
        }
    }
    let mut out = Image::new(half_w, half_h, 0u8);
    for y in 0..half_h {
        let [a, b, c, d, e] = five_taps(y, h).map(|i| rows.row(i));
        let target = out.row_mut(y);
        for x in 0..half_w {
            let sum = (a[x] + e[x]) + 4 * (b[x] + d[x]) + 6 * c[x] + 128;
            target[x] = sum.to_be_bytes()[0]; // sum >> 8
        }
    }
    out
}

/// [`halve`] for pictures of numbers, channel by channel, without rounding to integers.
///
/// Both passes add as ((a + e) + 4 (b + d)) + 6 c over the taps a..e; the sum is scaled by 1/256
/// once at the end. One level of the pyramid GP of eq. 16.
///
/// # Example
/// ```
/// use garad_core::{Image, pyramid::halve_real};
/// // A constant keeps its value exactly.
/// let half = halve_real(&Image::new(5, 3, [0.25f32, 0.5, 0.75]));
/// assert_eq!(half, Image::new(3, 2, [0.25, 0.5, 0.75]));
/// ```
#[must_use]
pub fn halve_real<T: Real, const C: usize>(image: &Image<[T; C]>) -> Image<[T; C]> {
    let (w, h) = image.size();
    let (half_w, half_h) = (w.div_ceil(2), h.div_ceil(2));
    let (four, six) = (T::from_f64(4.0), T::from_f64(6.0));
    let smooth = |p: [&[T; C]; 5]| -> [T; C] {
        std::array::from_fn(|c| ((p[0][c] + p[4][c]) + four * (p[1][c] + p[3][c])) + six * p[2][c])
    };
    let taps: Vec<[usize; 5]> = (0..half_w).map(|x| five_taps(x, w)).collect();
    let rows = Image::from_fn(half_w, h, |x, y| {
        let row = image.row(y);
        smooth(taps[x].map(|i| &row[i]))
    });
    let scale = T::from_f64(1.0 / 256.0);
    let mut out = Image::new(half_w, half_h, [T::ZERO; C]);
    for y in 0..half_h {
        let five = five_taps(y, h).map(|i| rows.row(i));
        for (x, pixel) in out.row_mut(y).iter_mut().enumerate() {
            *pixel = smooth(five.map(|row| &row[x])).map(|sum| sum * scale);
        }
    }
    out
}

/// Scale of each ORB level: s₀ = 1, sₗ = f32(f64(sₗ₋₁) · f64(`factor`)), ORB-SLAM's order of
/// rounding.
#[must_use]
pub fn level_scales(factor: f32, count: usize) -> Vec<f32> {
    std::iter::successors(Some(1.0f32), |&s| {
        Some((f64::from(s) * f64::from(factor)).to_f32())
    })
    .take(count)
    .collect()
}

/// Size of each ORB level: round-half-even(w · (1/sₗ)) in f32, at least 1 pixel.
#[must_use]
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a positive number no larger than the picture's size"
)]
pub fn level_sizes(
    (width, height): (usize, usize),
    factor: f32,
    count: usize,
) -> Vec<(usize, usize)> {
    let round = |n: usize, s: f32| ((n as f32 * (1.0 / s)).round_ties_even() as usize).max(1);
    level_scales(factor, count)
        .into_iter()
        .map(|s| (round(width, s), round(height, s)))
        .collect()
}

/// One output sample of a bilinear resize along one axis: source index and 11-bit weights.
#[derive(Debug, Clone, Copy)]
struct LinearTap {
    low: usize,
    high: usize,
    weight_low: i16,
    weight_high: i16,
}

/// Taps of `to` samples out of `from`. Sample centres align: source = (i + ½) from/to - ½, in
/// f64 rounded to f32; weights are rounded to 1/2048 half to even.
#[allow(
    clippy::cast_possible_truncation,
    reason = "coordinates stay inside the picture, weights inside 0..=2048"
)]
fn linear_taps(from: usize, to: usize) -> Vec<LinearTap> {
    let scale = 1.0 / (to as f64 / from as f64);
    let last = from.cast_signed() - 1;
    let inside = |i: isize| i.clamp(0, last).unsigned_abs();
    (0..to)
        .map(|i| {
            let position = ((i as f64 + 0.5) * scale - 0.5) as f32;
            let floor = position.floor();
            let fraction = position - floor;
            let low = floor as isize;
            LinearTap {
                low: inside(low),
                high: inside(low + 1),
                weight_low: ((1.0 - fraction) * 2048.0).round_ties_even() as i16,
                weight_high: (fraction * 2048.0).round_ties_even() as i16,
            }
        })
        .collect()
}

/// Bilinear resize in fixed point, bit-equal to OpenCV's `INTER_LINEAR` for 8 bits:
///
/// row(x)  = (in(x₀) a₀ + in(x₁) a₁) >> 4
/// out(x, y) = ((row₀(x) b₀ >> 16) + (row₁(x) b₁ >> 16) + 2) >> 2
///
/// with a, b the weights in 1/2048. Golden: `pyramid/*`.
#[must_use]
pub fn resize_linear(image: &GrayImage, size: (usize, usize)) -> GrayImage {
    let mut out = GrayImage::default();
    resize_linear_into(image, size, &mut out);
    out
}

/// [`resize_linear`] into a picture whose memory is used again if the size fits.
pub fn resize_linear_into(image: &GrayImage, (width, height): (usize, usize), out: &mut GrayImage) {
    if out.size() != (width, height) {
        *out = GrayImage::new(width, height, 0);
    }
    if image.data().is_empty() {
        return;
    }
    let columns = pair_taps(image.width(), width);
    let rows = linear_taps(image.height(), height);
    // Two resized source rows are alive at a time; an output row often shares one with the next.
    let mut cache = [
        (usize::MAX, vec![0i16; width]),
        (usize::MAX, vec![0i16; width]),
    ];
    for (y, tap) in rows.iter().enumerate() {
        for (slot, wanted) in [tap.low, tap.high].into_iter().enumerate() {
            if cache[slot].0 == wanted {
                continue;
            }
            if slot == 0 && cache[1].0 == wanted {
                cache.swap(0, 1);
                continue;
            }
            cache[slot].0 = wanted;
            resize_row(image.row(wanted), &columns, &mut cache[slot].1);
        }
        let [(_, row0), (_, row1)] = &cache;
        blend_rows(
            row0,
            row1,
            [tap.weight_low, tap.weight_high],
            out.row_mut(y),
        );
    }
}

/// A tap along a row: a pixel, its right neighbour, and their weights.
#[derive(Debug, Clone, Copy)]
struct PairTap {
    low: usize,
    weights: [i16; 2],
}

/// [`linear_taps`] for rows. Beyond the outer centres OpenCV drops the fraction along x, where it
/// keeps it along y; the pixel at the right edge is spelled as the second of a pair.
fn pair_taps(from: usize, to: usize) -> Vec<PairTap> {
    let taps = linear_taps(from, to).into_iter();
    taps.map(|tap| match tap {
        LinearTap { low, high, .. } if low == high && low > 0 => PairTap {
            low: low - 1,
            weights: [0, 2048],
        },
        LinearTap { low, high, .. } if low == high => PairTap {
            low,
            weights: [2048, 0],
        },
        LinearTap {
            low,
            weight_low,
            weight_high,
            ..
        } => PairTap {
            low,
            weights: [weight_low, weight_high],
        },
    })
    .collect()
}

/// (in(x₀) a₀ + in(x₁) a₁) >> 4, at most 255 * 2048 / 16 = 32640.
#[allow(clippy::cast_possible_truncation, reason = "at most 32640")]
fn resize_row(source: &[u8], columns: &[PairTap], out: &mut [i16]) {
    if let &[only] = source {
        out.fill(i16::from(only) * 128); // 2048 / 16
        return;
    }
    for (out, tap) in out.iter_mut().zip(columns) {
        let pair = &source[tap.low..tap.low + 2];
        let sum = i32::from(pair[0]) * i32::from(tap.weights[0])
            + i32::from(pair[1]) * i32::from(tap.weights[1]);
        *out = (sum >> 4) as i16;
    }
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a convex combination of bytes"
)]
fn blend_rows(row0: &[i16], row1: &[i16], [b0, b1]: [i16; 2], out: &mut [u8]) {
    for ((out, &s0), &s1) in out.iter_mut().zip(row0).zip(row1) {
        let part = |s: i16, b: i16| ((i32::from(s) * i32::from(b)) >> 16) as i16;
        *out = ((part(s0, b0) + part(s1, b1) + 2) >> 2) as u8;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;
    use proptest::prelude::*;

    fn noise(width: usize, height: usize, seed: u64) -> GrayImage {
        let mut rng = Rng::new(seed);
        GrayImage::from_fn(width, height, |_, _| {
            u8::try_from(rng.below(256)).expect("below 256")
        })
    }

    #[test]
    fn mirror_does_not_repeat_the_edge() {
        let seen: Vec<usize> = (-4..8).map(|i| reflect_101(i, 4)).collect();
        assert_eq!(seen, [2, 3, 2, 1, 0, 1, 2, 3, 2, 1, 0, 1], "period 2(n-1)");
        assert_eq!(reflect_101(-5, 1), 0, "a single pixel");
    }

    #[test]
    fn impulse_becomes_the_taps() {
        // Half pixels lie at even samples, which see a white pixel at (4, 4) at distance 0 (weight
        // 6) or 2 (weight 1) along each axis.
        let mut image = GrayImage::new(9, 9, 0);
        image[(4, 4)] = 255;
        let half = halve(&image);
        let row = |y: usize| half.row(y).to_vec();
        let byte = |w: u32| u8::try_from((255 * w + 128) >> 8).expect("a byte");
        assert_eq!(
            row(2),
            [0, byte(6), byte(36), byte(6), 0],
            "through the centre"
        );
        assert_eq!(row(1), [0, byte(1), byte(6), byte(1), 0], "beside it");
    }

    /// The filter as written, pixel by pixel.
    fn spec_halve(image: &GrayImage) -> GrayImage {
        let (w, h) = image.size();
        let taps = [1u32, 4, 6, 4, 1];
        GrayImage::from_fn(w.div_ceil(2), h.div_ceil(2), |x, y| {
            let mut sum = 128;
            for (j, wj) in (-2isize..=2).zip(taps) {
                for (i, wi) in (-2isize..=2).zip(taps) {
                    let (sx, sy) = ((2 * x).cast_signed() + i, (2 * y).cast_signed() + j);
                    sum += wi * wj * u32::from(image[(reflect_101(sx, w), reflect_101(sy, h))]);
                }
            }
            u8::try_from(sum >> 8).expect("a byte")
        })
    }

    proptest! {
        #[test]
        fn halve_is_its_formula(w in 1usize..40, h in 1usize..40, seed: u64) {
            let image = noise(w, h, seed);
            prop_assert_eq!(halve(&image), spec_halve(&image));
            // The form on numbers rounds to the same picture: all its sums are exact in f64.
            let real = halve_real(&image.map(|&v| [f64::from(v)]));
            for (&byte, &[value]) in halve(&image).data().iter().zip(real.data()) {
                let rounded = (value + 0.5).floor();
                prop_assert!((f64::from(byte) - rounded).abs() < 1e-9, "{byte} against {value}");
            }
        }

        #[test]
        fn resize_keeps_constants_and_stays_between_neighbours(
            w in 2usize..50, h in 2usize..50, seed: u64, grey: u8
        ) {
            let size = (w.div_ceil(2) + 1, h.div_ceil(2) + 1);
            let flat = resize_linear(&GrayImage::new(w, h, grey), size);
            // Truncation in the second pass may lose one grey level, as it does in OpenCV.
            for &v in flat.data() {
                prop_assert!(v.abs_diff(grey) <= 1, "{v} from a constant {grey}");
            }
            let image = noise(w, h, seed);
            prop_assert_eq!(&resize_linear(&image, (w, h)), &image, "same size, same picture");
        }
    }

    #[test]
    fn sizes_and_scales_of_640x480() {
        let sizes = level_sizes((640, 480), 1.2, 8);
        assert_eq!(
            sizes,
            [
                (640, 480),
                (533, 400),
                (444, 333),
                (370, 278),
                (309, 231),
                (257, 193),
                (214, 161),
                (179, 134)
            ],
            "round(w / 1.2^l)"
        );
        let pyramid = GrayPyramid::scaled(noise(640, 480, 1), 1.2, 8);
        for (level, &size) in pyramid.levels().iter().zip(&sizes) {
            assert_eq!(level.size(), size, "as announced");
        }
        assert!((pyramid.scale(7) - 3.583_181_6).abs() < 1e-6, "1.2^7");
    }

    #[test]
    fn the_smallest_pictures_survive() {
        assert_eq!(halve(&GrayImage::new(1, 1, 9)), GrayImage::new(1, 1, 9));
        assert_eq!(halve(&GrayImage::default()).size(), (0, 0), "empty");
        let one = resize_linear(&GrayImage::new(1, 1, 9), (3, 2));
        assert_eq!(one, GrayImage::new(3, 2, 9), "enlarged");
        assert_eq!(
            GrayPyramid::scaled(GrayImage::new(2, 1, 3), 1.2, 8).levels()[7].size(),
            (1, 1)
        );
    }
}
