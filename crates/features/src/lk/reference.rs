//! Windows of the tracker as their formulas read, pixel by pixel, in 64-bit integers.

use super::pyramid::{LkLevel, Plane};
use super::{DERIVATIVE_SHIFT, INTENSITY_SHIFT, Place, WINDOW, Windows};

/// Pixel by pixel.
#[derive(Debug, Clone, Copy)]
pub(super) struct Reference;

/// (intensity, dx, dy) per pixel of a window, row by row.
type Template = Vec<[i64; 3]>;

impl Windows for Reference {
    type Template = Template;

    fn template(level: &LkLevel, place: &Place) -> (Template, [i64; 3]) {
        let template: Template = pixels()
            .map(|(x, y)| {
                [
                    intensity(level, place, x, y),
                    derivative(&level.dx, place, x, y),
                    derivative(&level.dy, place, x, y),
                ]
            })
            .collect();
        let sum = |f: fn(&[i64; 3]) -> i64| template.iter().map(f).sum();
        let gram = [
            sum(|[_, dx, _]| dx * dx),
            sum(|[_, dx, dy]| dx * dy),
            sum(|[_, _, dy]| dy * dy),
        ];
        (template, gram)
    }

    fn mismatch(template: &Template, level: &LkLevel, place: &Place) -> [i64; 2] {
        let mut sums = [0, 0];
        for ((x, y), [before, dx, dy]) in pixels().zip(template) {
            let diff = intensity(level, place, x, y) - before;
            sums[0] += diff * dx;
            sums[1] += diff * dy;
        }
        sums
    }

    fn absolute_difference(template: &Template, level: &LkLevel, place: &Place) -> i64 {
        pixels()
            .zip(template)
            .map(|((x, y), [before, _, _])| (intensity(level, place, x, y) - before).abs())
            .sum()
    }
}

fn pixels() -> impl Iterator<Item = (isize, isize)> {
    let n = WINDOW.cast_signed();
    (0..n).flat_map(move |y| (0..n).map(move |x| (x, y)))
}

fn intensity(level: &LkLevel, place: &Place, x: isize, y: isize) -> i64 {
    sample(&level.intensity, place, x, y, INTENSITY_SHIFT)
}

fn derivative(plane: &Plane, place: &Place, x: isize, y: isize) -> i64 {
    sample(plane, place, x, y, DERIVATIVE_SHIFT)
}

/// (Σ weight · neighbour + half) >> shift over the four neighbours.
fn sample(plane: &Plane, place: &Place, x: isize, y: isize, shift: u32) -> i64 {
    let (x, y) = (place.x + x, place.y + y);
    let value = |dx, dy| i64::from(plane.from(x + dx, y + dy)[0][0]);
    let [w00, w01, w10, w11] = place.weights.map(i64::from);
    let sum = w00 * value(0, 0) + w01 * value(1, 0) + w10 * value(0, 1) + w11 * value(1, 1);
    (sum + (1 << (shift - 1))) >> shift
}
