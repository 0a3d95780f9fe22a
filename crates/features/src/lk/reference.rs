//! Windows of the tracker as their formulas read, pixel by pixel, in 64-bit integers.

use garad_core::{GrayImage, Image};

use super::pyramid::LkLevel;
use super::{DERIVATIVE_SHIFT, INTENSITY_SHIFT, Place, WINDOW, Windows};

/// Pixel by pixel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reference;

/// (intensity, dx, dy) per pixel of a window, row by row.
type Template = Vec<[i64; 3]>;

impl Windows for Reference {
    type Template = Template;

    fn template(level: &LkLevel, place: &Place, template: &mut Template) -> [i64; 3] {
        template.clear();
        template.extend(window(place).map(|(x, y)| {
            let derivative = |axis: usize| {
                sample(place, x, y, DERIVATIVE_SHIFT, |x, y| {
                    scharr_at(level, x, y)[axis]
                })
            };
            [intensity(level, place, x, y), derivative(0), derivative(1)]
        }));
        let sum = |f: fn(&[i64; 3]) -> i64| template.iter().map(f).sum();
        [
            sum(|[_, dx, _]| dx * dx),
            sum(|[_, dx, dy]| dx * dy),
            sum(|[_, _, dy]| dy * dy),
        ]
    }

    fn mismatch(template: &Template, level: &LkLevel, place: &Place) -> [i64; 2] {
        let mut sums = [0, 0];
        for ((x, y), [before, dx, dy]) in window(place).zip(template) {
            let diff = intensity(level, place, x, y) - before;
            sums[0] += diff * dx;
            sums[1] += diff * dy;
        }
        sums
    }

    fn absolute_difference(template: &Template, level: &LkLevel, place: &Place) -> i64 {
        window(place)
            .zip(template)
            .map(|((x, y), [before, _, _])| (intensity(level, place, x, y) - before).abs())
            .sum()
    }
}

/// The upper left pixel of each sample.
fn window(place: &Place) -> impl Iterator<Item = (isize, isize)> + use<> {
    let (x0, y0, n) = (place.x, place.y, WINDOW.cast_signed());
    (y0..y0 + n).flat_map(move |y| (x0..x0 + n).map(move |x| (x, y)))
}

fn intensity(level: &LkLevel, place: &Place, x: isize, y: isize) -> i64 {
    sample(place, x, y, INTENSITY_SHIFT, |x, y| pixel(level, x, y))
}

fn pixel(level: &LkLevel, x: isize, y: isize) -> i64 {
    i64::from(level.pairs_from(x, y)[0][0])
}

/// (Σ weight · neighbour + half) >> shift over the four neighbours.
fn sample(
    place: &Place,
    x: isize,
    y: isize,
    shift: u32,
    value: impl Fn(isize, isize) -> i64,
) -> i64 {
    let [w00, w01, w10, w11] = place.weights.map(i64::from);
    let upper = w00 * value(x, y) + w01 * value(x + 1, y);
    let lower = w10 * value(x, y + 1) + w11 * value(x + 1, y + 1);
    (upper + lower + (1 << (shift - 1))) >> shift
}

/// Derivatives by Scharr's filter, 32 times the grey levels per pixel:
///
/// dx = [3 10 3]ᵀ ⊗ [-1 0 1],  dy = [-1 0 1]ᵀ ⊗ [3 10 3]
///
/// on the mirrored image, and 0 outside of it. |value| ≤ 255 · 16.
fn scharr_at(level: &LkLevel, x: isize, y: isize) -> [i64; 2] {
    if !level.contains(x, y) {
        return [0, 0];
    }
    let p = |dx: isize, dy: isize| pixel(level, x + dx, y + dy);
    let smooth_y = |dx: isize| 3 * (p(dx, -1) + p(dx, 1)) + 10 * p(dx, 0);
    let smooth_x = |dy: isize| 3 * (p(-1, dy) + p(1, dy)) + 10 * p(0, dy);
    [smooth_y(1) - smooth_y(-1), smooth_x(1) - smooth_x(-1)]
}

/// The derivatives of a whole image, (dx, dy), as the tracker takes them in its windows.
///
/// Bit-equal to OpenCV's `Scharr`. Golden: `pyramid/*` (`scharr_x`, `scharr_y`).
#[must_use]
#[allow(clippy::cast_possible_truncation, reason = "at most 255 * 16")]
pub fn scharr(image: &GrayImage) -> (Image<i16>, Image<i16>) {
    let level = LkLevel::new(image);
    let along = |axis: usize| {
        Image::from_fn(image.width(), image.height(), |x, y| {
            scharr_at(&level, x.cast_signed(), y.cast_signed())[axis] as i16
        })
    };
    (along(0), along(1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_of_a_ramp() {
        // 2 grey levels per column, 3 per row; across the mirrored edge the slope is 0.
        let ramp = GrayImage::from_fn(6, 5, |x, y| u8::try_from(2 * x + 3 * y).expect("byte"));
        let (dx, dy) = scharr(&ramp);
        assert_eq!([dx[(2, 2)], dy[(2, 2)]], [64, 96], "32 x slope");
        assert_eq!(
            [dx[(0, 2)], dx[(5, 2)], dy[(2, 0)], dy[(2, 4)]],
            [0; 4],
            "mirrored edge"
        );
        let (dx, dy) = scharr(&GrayImage::new(1, 1, 9));
        assert_eq!([dx[(0, 0)], dy[(0, 0)]], [0, 0], "a single pixel");
    }

    #[test]
    fn largest_derivative_is_16_times_white() {
        let step = GrayImage::from_fn(4, 3, |x, _| if x < 2 { 0 } else { 255 });
        assert_eq!(scharr(&step).0[(1, 1)], 255 * 16, "16 bits are enough");
    }
}
