//! Windows of the tracker in 16-bit lanes, 24 columns for the 21 of the window.
//!
//! A bilinear sample is a product of the pair (p, right neighbour) with the upper two weights,
//! plus one of the pair below with the lower two. So each row of pairs is read once: it finishes
//! the samples above it and begins those below. Sums of two products of 16-bit numbers are one
//! instruction on every processor since 1997, and the loops are written so that the compiler
//! finds it (weights as lists in memory, `clamp` before narrowing).
//!
//! The three columns too many have derivative 0 in the template, so whatever the image holds
//! there adds nothing. Products of difference and derivative are summed in 32 bits over three
//! rows, which cannot overflow: |difference| ≤ 8161 (255 · 32 and the rounding of weights),
//! |derivative| ≤ 4081, and 63 · 8161 · 4081 < 2³¹. Groups of rows are summed in 64 bits.
//! Integer sums have no order, so the numbers are those of [`super::reference`].

use garad_core::lanes::{Kernel, Lanes, dispatch};

use super::pyramid::LkLevel;
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
const NO_SAMPLES: Samples = [[0; ROWS * LANES]; GROUPS];

/// Row by row in 16-bit lanes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fast;

/// A window of the first image.
#[derive(Debug, Clone)]
pub(super) struct Template {
    intensity: Samples,
    dx: Samples,
    dy: Samples,
}

impl Default for Template {
    fn default() -> Self {
        Self {
            intensity: NO_SAMPLES,
            dx: NO_SAMPLES,
            dy: NO_SAMPLES,
        }
    }
}

impl Windows for Fast {
    type Template = Template;

    fn template(level: &LkLevel, place: &Place, template: &mut Template) -> [i64; 3] {
        dispatch(FillTemplate {
            level,
            place,
            template,
        })
    }

    fn mismatch(template: &Template, level: &LkLevel, place: &Place) -> [i64; 2] {
        dispatch(Mismatch {
            template,
            level,
            place,
        })
    }

    fn absolute_difference(template: &Template, level: &LkLevel, place: &Place) -> i64 {
        let weights = PairWeights::new(place.weights);
        let mut now = NO_SAMPLES;
        sample_image(level, place, &weights, &mut now);
        let rows = rows_of(&now).iter().zip(rows_of(&template.intensity));
        rows.flat_map(|(a, b)| a[..WINDOW].iter().zip(&b[..WINDOW]))
            .map(|(a, b)| i64::from((a - b).abs()))
            .sum()
    }
}

/// [`Windows::template`].
struct FillTemplate<'a> {
    level: &'a LkLevel,
    place: &'a Place,
    template: &'a mut Template,
}

impl Kernel for FillTemplate<'_> {
    type Output = [i64; 3];

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) -> [i64; 3] {
        let Self {
            level,
            place,
            template,
        } = self;
        let weights = PairWeights::new(place.weights);
        let Template { intensity, dx, dy } = template;
        sample_image(level, place, &weights, intensity);
        let (dx_pairs, dy_pairs) = derivatives(level, place);
        for (pairs, out) in [(&dx_pairs, &mut *dx), (&dy_pairs, &mut *dy)] {
            sample::<DERIVATIVE_SHIFT>(&weights, |y| &pairs[y], out);
            silence_extra_columns(out);
        }
        [dot(dx, dx), dot(dx, dy), dot(dy, dy)]
    }
}

/// [`Windows::mismatch`].
struct Mismatch<'a> {
    template: &'a Template,
    level: &'a LkLevel,
    place: &'a Place,
}

impl Kernel for Mismatch<'_> {
    type Output = [i64; 2];

    #[inline(always)]
    fn run<L: Lanes>(self, _: L) -> [i64; 2] {
        let Self {
            template,
            level,
            place,
        } = self;
        let weights = PairWeights::new(place.weights);
        let mut diff = NO_SAMPLES;
        sample_image(level, place, &weights, &mut diff);
        let before = template.intensity.as_flattened();
        for (now, before) in diff.as_flattened_mut().iter_mut().zip(before) {
            *now -= before;
        }
        [dot(&diff, &template.dx), dot(&diff, &template.dy)]
    }
}

/// (w00, w01) and (w10, w11), each repeated along a row.
struct PairWeights {
    upper: PairRow,
    lower: PairRow,
}

impl PairWeights {
    #[inline(always)]
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

/// The row of pairs that starts at (x, y).
#[inline(always)]
fn pair_row<const N: usize>(level: &LkLevel, x: isize, y: isize) -> &[i16; N] {
    let row = level.pairs_from(x, y).as_flattened().first_chunk();
    row.expect("a window ends inside the border")
}

#[inline(always)]
fn sample_image(level: &LkLevel, place: &Place, weights: &PairWeights, out: &mut Samples) {
    let row = |y: usize| pair_row(level, place.x, place.y + y.cast_signed());
    sample::<INTENSITY_SHIFT>(weights, row, out);
}

/// Scharr derivatives (dx, dy) of the 22 rows under a window, in pairs like the pixels.
///
/// In a row of pairs p₀p₁ p₁p₂ p₂p₃ ... the same filter applies to both members, with neighbours
/// two places apart.
#[inline(always)]
fn derivatives(level: &LkLevel, place: &Place) -> ([PairRow; WINDOW + 1], [PairRow; WINDOW + 1]) {
    const WITH_NEIGHBOURS: usize = 2 * LANES + 4;
    let mut dx = [[0; 2 * LANES]; WINDOW + 1];
    let mut dy = [[0; 2 * LANES]; WINDOW + 1];
    for (row, (dx, dy)) in (place.y..).zip(dx.iter_mut().zip(&mut dy)) {
        let [above, here, below]: [&[i16; WITH_NEIGHBOURS]; 3] =
            [-1, 0, 1].map(|d| pair_row(level, place.x - 1, row + d));
        let (mut smooth, mut slope) = ([0; WITH_NEIGHBOURS], [0; WITH_NEIGHBOURS]);
        for i in 0..WITH_NEIGHBOURS {
            smooth[i] = 3 * (above[i] + below[i]) + 10 * here[i];
            slope[i] = below[i] - above[i];
        }
        for i in 0..2 * LANES {
            dx[i] = smooth[i + 4] - smooth[i];
            dy[i] = 3 * (slope[i] + slope[i + 4]) + 10 * slope[i + 2];
        }
    }
    let last = WINDOW.cast_signed();
    if !(level.contains(place.x, place.y) && level.contains(place.x + last, place.y + last)) {
        silence_border(level, place, &mut dx);
        silence_border(level, place, &mut dy);
    }
    (dx, dy)
}

/// Zeros outside of the image, where it has no derivative.
fn silence_border(level: &LkLevel, place: &Place, rows: &mut [PairRow; WINDOW + 1]) {
    let columns = 0..level.width.cast_signed();
    let mask: PairRow = std::array::from_fn(|i| {
        let x = place.x + (i / 2 + i % 2).cast_signed();
        if columns.contains(&x) { -1 } else { 0 } // all bits or none
    });
    for (y, row) in (place.y..).zip(rows) {
        if !(0..level.height.cast_signed()).contains(&y) {
            row.fill(0);
        }
        for (value, mask) in row.iter_mut().zip(&mask) {
            *value &= mask;
        }
    }
}

/// Zeros in the three columns too many.
#[inline(always)]
fn silence_extra_columns(samples: &mut Samples) {
    for row in samples.as_flattened_mut().as_chunks_mut::<LANES>().0 {
        row[WINDOW..].fill(0);
    }
}

/// (Σ weight · neighbour + half) >> SHIFT for 21 rows of samples from 22 rows of pairs.
#[inline(always)]
fn sample<'a, const SHIFT: u32>(
    weights: &PairWeights,
    row: impl Fn(usize) -> &'a PairRow,
    out: &mut Samples,
) {
    let mut begun = [0; LANES];
    finish_and_begin::<SHIFT>(row(0), weights, &mut begun, &mut [0; LANES]);
    for (y, out) in (1..).zip(out.as_flattened_mut().as_chunks_mut().0) {
        finish_and_begin::<SHIFT>(row(y), weights, &mut begun, out);
    }
}

/// Adds the lower products of a row to what the row above began, and begins the next.
#[inline(always)]
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
    let PairWeights { upper, lower } = weights;
    for x in 0..LANES {
        let (p, q) = (2 * x, 2 * x + 1);
        // In this order the compiler keeps each sum of two products together.
        let below =
            i32::from(row[p]) * i32::from(upper[p]) + i32::from(row[q]) * i32::from(upper[q]);
        let above =
            i32::from(row[p]) * i32::from(lower[p]) + i32::from(row[q]) * i32::from(lower[q]);
        let sum = (begun[x] + above) >> SHIFT;
        out[x] = sum.clamp(i32::from(i16::MIN), i32::from(i16::MAX)) as i16;
        begun[x] = below + (1 << (SHIFT - 1));
    }
}

/// Σ aᵢ bᵢ over the window.
#[inline(always)]
fn dot(a: &Samples, b: &Samples) -> i64 {
    let group = |(a, b): (&Group, &Group)| -> i32 {
        let pairs = a.iter().zip(b);
        pairs.map(|(&a, &b)| i32::from(a) * i32::from(b)).sum()
    };
    a.iter().zip(b).map(group).map(i64::from).sum()
}
