//! Windows of the tracker in 16-bit lanes, 24 columns for the 21 of the window.
//!
//! A bilinear sample is a product of the pair (p, right neighbour) with the upper two weights,
//! plus one of the pair below with the lower two. So each row of pairs is read once: it finishes
//! the samples above it and begins those below. Sums of two products of 16-bit numbers are one
//! instruction on every processor since 1997, and the loops are written so that the compiler
//! finds it (weights as lists in memory, `clamp` before narrowing).
//!
//! The three columns too many have derivative 0 in the template, so whatever the picture holds
//! there adds nothing. Products of difference and derivative are summed in 32 bits over three
//! rows, which cannot overflow: |difference| ≤ 8161 (255 · 32 and the rounding of weights),
//! |derivative| ≤ 4081, and 63 · 8161 · 4081 < 2³¹. Groups of rows are summed in 64 bits.
//! Integer sums have no order, so the numbers are those of [`super::reference`].

use super::pyramid::{LkLevel, Plane};
use super::{DERIVATIVE_SHIFT, INTENSITY_SHIFT, Place, WINDOW, Windows};

/// Columns computed, a multiple of 8.
const LANES: usize = 24;
/// Rows summed in 32 bits.
const ROWS: usize = 3;
const GROUPS: usize = WINDOW / ROWS;

/// A row of pairs (pixel, right neighbour).
type PairRow = [i16; 2 * LANES];
/// Three rows of samples.
type Group = [i16; ROWS * LANES];
/// All 21 rows of samples.
type Samples = [Group; GROUPS];

/// Row by row in 16-bit lanes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fast;

/// A window of the first picture.
#[derive(Debug, Clone)]
pub(super) struct Template {
    intensity: Samples,
    dx: Samples,
    dy: Samples,
}

impl Windows for Fast {
    type Template = Template;

    fn template(level: &LkLevel, place: &Place) -> (Template, [i64; 3]) {
        let weights = PairWeights::new(place.weights);
        let template = Template {
            intensity: sample_intensity(&level.intensity, place, &weights),
            dx: sample_derivative(&level.dx, place, &weights),
            dy: sample_derivative(&level.dy, place, &weights),
        };
        let (dx, dy) = (&template.dx, &template.dy);
        let gram = [dot(dx, dx), dot(dx, dy), dot(dy, dy)];
        (template, gram)
    }

    fn mismatch(template: &Template, level: &LkLevel, place: &Place) -> [i64; 2] {
        let weights = PairWeights::new(place.weights);
        let mut diff = sample_intensity(&level.intensity, place, &weights);
        let before = template.intensity.as_flattened();
        for (now, before) in diff.as_flattened_mut().iter_mut().zip(before) {
            *now -= before;
        }
        [dot(&diff, &template.dx), dot(&diff, &template.dy)]
    }

    fn absolute_difference(template: &Template, level: &LkLevel, place: &Place) -> i64 {
        let weights = PairWeights::new(place.weights);
        let now = sample_intensity(&level.intensity, place, &weights);
        let rows = rows_of(&now).iter().zip(rows_of(&template.intensity));
        rows.flat_map(|(a, b)| a[..WINDOW].iter().zip(&b[..WINDOW]))
            .map(|(a, b)| i64::from((a - b).abs()))
            .sum()
    }
}

/// (w00, w01) and (w10, w11), each repeated along a row.
struct PairWeights {
    upper: PairRow,
    lower: PairRow,
}

impl PairWeights {
    fn new([w00, w01, w10, w11]: [i16; 4]) -> Self {
        let repeat = |pair: [i16; 2]| std::array::from_fn(|i| pair[i % 2]);
        Self {
            upper: repeat([w00, w01]),
            lower: repeat([w10, w11]),
        }
    }
}

fn rows_of(samples: &Samples) -> &[[i16; LANES]] {
    samples.as_flattened().as_chunks().0
}

fn sample_intensity(plane: &Plane, place: &Place, weights: &PairWeights) -> Samples {
    sample::<INTENSITY_SHIFT>(plane, place, weights)
}

/// With zeros in the three columns too many.
fn sample_derivative(plane: &Plane, place: &Place, weights: &PairWeights) -> Samples {
    let mut samples = sample::<DERIVATIVE_SHIFT>(plane, place, weights);
    for row in samples.as_flattened_mut().as_chunks_mut::<LANES>().0 {
        row[WINDOW..].fill(0);
    }
    samples
}

/// (Σ weight · neighbour + half) >> SHIFT for 21 rows of samples from 22 rows of pairs.
#[inline]
fn sample<const SHIFT: u32>(plane: &Plane, place: &Place, weights: &PairWeights) -> Samples {
    let row = |y: usize| -> &PairRow {
        let pairs = plane.from(place.x, place.y + y.cast_signed());
        let row = pairs.as_flattened().first_chunk();
        row.expect("a window ends inside the border")
    };
    let mut samples = [[0; ROWS * LANES]; GROUPS];
    let mut begun = [0; LANES];
    finish_and_begin::<SHIFT>(row(0), weights, &mut begun, &mut [0; LANES]);
    for (y, out) in (1..).zip(samples.as_flattened_mut().as_chunks_mut().0) {
        finish_and_begin::<SHIFT>(row(y), weights, &mut begun, out);
    }
    samples
}

/// Adds the lower products of a row to what the row above began, and begins the next.
#[inline(never)]
#[allow(
    clippy::cast_possible_truncation,
    reason = "clamped to 16 bits, which no weighted mean of pixels exceeds"
)]
fn finish_and_begin<const SHIFT: u32>(
    row: &PairRow,
    weights: &PairWeights,
    begun: &mut [i32; LANES],
    out: &mut [i16; LANES],
) {
    let product = |w: &PairRow, x: usize| {
        i32::from(row[2 * x]) * i32::from(w[2 * x])
            + i32::from(row[2 * x + 1]) * i32::from(w[2 * x + 1])
    };
    for x in 0..LANES {
        let sum = (begun[x] + product(&weights.lower, x)) >> SHIFT;
        out[x] = sum.clamp(i32::from(i16::MIN), i32::from(i16::MAX)) as i16;
        begun[x] = product(&weights.upper, x) + (1 << (SHIFT - 1));
    }
}

/// Σ aᵢ bᵢ over the window.
fn dot(a: &Samples, b: &Samples) -> i64 {
    let group = |(a, b): (&Group, &Group)| -> i32 {
        let pairs = a.iter().zip(b);
        pairs.map(|(&a, &b)| i32::from(a) * i32::from(b)).sum()
    };
    a.iter().zip(b).map(group).map(i64::from).sum()
}
