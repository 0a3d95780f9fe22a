//! L1, SSIM and their gradient in one sweep over the rows: what [`super::ssim()`] and
//! [`super::photometric()`] run.
//!
//! ```text
//! row v       x, y, x² + y², xy ─ along the row ─→ the last 11 rows of moments
//! row v - 5   down the moments ─→ S, its slopes ─ along the row ─→ the last 11 rows of slopes
//! row v - 10  down the slopes ─→ gradient
//! ```
//!
//! All that is kept between rows fits into the cache of a core. Rows are cut into bands that run
//! side by side; each begins ten rows early and ends ten rows late, so that bands need nothing of
//! each other. Loops run over the numbers of a row, three per pixel, and vectorise.

use std::ops::Range;

use garad_core::{Image, MaskImage, Par, Real};

use super::image_loss::count_included;
use super::reference::{C1, C2, RADIUS, TAPS, taps};

/// Numbers between a pixel and the next of its row.
const PIXEL: usize = 3;
/// Zeros before and after a row.
const MARGIN: usize = RADIUS * PIXEL;
/// Fewest rows of a band: each works on twenty more.
const LEAST_ROWS: usize = 32;
/// Bands per thread, so that one thread that is held up does not hold up the rest.
const BANDS_PER_THREAD: usize = 2;

/// What [`sweep`] finds.
#[derive(Debug)]
pub(super) struct Swept<T> {
    /// Mean |x - y|.
    pub(super) absolute: f64,
    /// Mean S.
    pub(super) structure: f64,
    /// Of the weighted sum of the two means.
    pub(super) gradient: Image<[T; 3]>,
    /// Included pixels.
    pub(super) pixels: usize,
}

/// Both means over included pixels, and the gradient by x of
/// `weights[0]` mean |x - y| + `weights[1]` mean S.
///
/// The images are known to be of one size.
///
/// # Numerics
/// Every number of the gradient is made by the same operations wherever bands begin. Sums run in
/// f64 within a row and from row to row, so they do not depend on bands either.
pub(super) fn sweep<T: Real>(
    x: &Image<[T; 3]>,
    y: &Image<[T; 3]>,
    excluded: Option<&MaskImage>,
    weights: [f64; 2],
    par: Par,
) -> Swept<T> {
    let (width, height) = x.size();
    let pixels = count_included(excluded, x.data().len());
    // Where no pixel is included the sums are 0, whatever they are divided by.
    let terms = 3.0 * pixels.max(1) as f64;
    let job = Job {
        x,
        y,
        excluded,
        weights: weights.map(|w| T::from_f64(w / terms)),
        taps: taps(),
    };
    let mut gradient = Image::new(width, height, [T::ZERO; 3]);
    let mut sums = vec![[0.0; 2]; height];
    let rows = height
        .div_ceil(par.threads().saturating_mul(BANDS_PER_THREAD))
        .max(LEAST_ROWS);
    if width > 0 {
        let pieces = gradient.data_mut().chunks_mut(rows * width);
        let mut bands: Vec<Band<T>> = pieces
            .zip(sums.chunks_mut(rows))
            .enumerate()
            .map(|(band, (gradient, sums))| Band {
                first: band * rows,
                gradient,
                sums,
            })
            .collect();
        par.for_each_chunk_mut(&mut bands, 1, |_, bands| {
            bands.iter_mut().for_each(|band| job.run(band));
        });
    }
    let [absolute, structure] = [0, 1].map(|k| sums.iter().fold(0.0, |sum, row| sum + row[k]));
    Swept {
        absolute: absolute / terms,
        structure: structure / terms,
        gradient,
        pixels,
    }
}

/// What all bands read.
struct Job<'a, T> {
    x: &'a Image<[T; 3]>,
    y: &'a Image<[T; 3]>,
    excluded: Option<&'a MaskImage>,
    /// Per term of |x - y| and of S.
    weights: [T; 2],
    taps: [T; TAPS],
}

/// What one band writes.
struct Band<'a, T> {
    /// Its first row.
    first: usize,
    gradient: &'a mut [[T; 3]],
    /// Per row Σ |x - y| and Σ S.
    sums: &'a mut [[f64; 2]],
}

impl<T: Real> Job<'_, T> {
    fn run(&self, band: &mut Band<T>) {
        let (width, height) = self.x.size();
        let n = width * PIXEL;
        let rows = band.first..band.first + band.sums.len();
        let around =
            |reach: usize| rows.start.saturating_sub(reach)..(rows.end + reach).min(height);
        let mut moments = LastRows::new(4 * n);
        let mut slopes = LastRows::new(3 * n);
        let mut padded = [(); 4].map(|()| vec![T::ZERO; n + 2 * MARGIN]);
        let mut blurred = vec![T::ZERO; 4 * n];
        let mut terms = vec![T::ZERO; n];

        // At each step three rows move on, the second and third 5 and 10 behind the first.
        for step in rows.start..rows.end + 4 * RADIUS {
            let row_behind = |delay: usize, of: Range<usize>| {
                step.checked_sub(delay).filter(|row| of.contains(row))
            };
            if let Some(row) = row_behind(2 * RADIUS, around(2 * RADIUS)) {
                self.products(row, &mut padded);
                self.along(&padded, moments.row_mut(row));
            }
            if let Some(row) = row_behind(3 * RADIUS, around(RADIUS)) {
                self.down(moments.around(row, height), &mut blurred);
                self.similarity(row, &blurred, &mut terms, &mut padded[..3]);
                self.along(&padded[..3], slopes.row_mut(row));
                if rows.contains(&row) {
                    band.sums[row - rows.start][1] = sum(&terms);
                }
            }
            if let Some(row) = row_behind(4 * RADIUS, rows.clone()) {
                let blurred = &mut blurred[..3 * n];
                self.down(slopes.around(row, height), blurred);
                let at = row - rows.start;
                let out = &mut band.gradient[at * width..(at + 1) * width];
                self.gradient(row, blurred, &mut terms, out);
                band.sums[at][0] = sum(&terms);
            }
        }
    }

    /// x, y, x² + y² and xy of a row; y in the place of x in excluded pixels.
    fn products(&self, row: usize, out: &mut [Vec<T>; 4]) {
        let [x, y, squares, product] = out.each_mut().map(|field| {
            let n = field.len() - 2 * MARGIN;
            &mut field[MARGIN..][..n]
        });
        x.copy_from_slice(self.x.row(row).as_flattened());
        y.copy_from_slice(self.y.row(row).as_flattened());
        for_excluded(self.excluded, row, |at| {
            x[at.clone()].copy_from_slice(&y[at])
        });
        for (((x, y), squares), product) in x.iter().zip(y.iter()).zip(squares).zip(product) {
            *squares = *x * *x + *y * *y;
            *product = *x * *y;
        }
    }

    /// S of a row and `weights[1]` times its slopes from the blurred moments; 0 in excluded
    /// pixels.
    fn similarity(&self, row: usize, moments: &[T], s: &mut [T], slopes: &mut [Vec<T>]) {
        let n = s.len();
        let two = T::from_f64(2.0);
        let (c1, c2) = (T::from_f64(C1), T::from_f64(C2));
        let weight = self.weights[1];
        let field = |k: usize| &moments[k * n..][..n];
        let (mx, my, squares, product) = (field(0), field(1), field(2), field(3));
        let [by_mean, by_square, by_product] = slopes else {
            unreachable!("three slopes per moment");
        };
        let [by_mean, by_square, by_product] =
            [by_mean, by_square, by_product].map(|field| &mut field[MARGIN..][..n]);
        for i in 0..n {
            let (x, y) = (mx[i], my[i]);
            let (xy, means) = (x * y, x * x + y * y);
            let one_b1 = T::ONE / (means + c1);
            let one_b2 = T::ONE / ((squares[i] - means) + c2);
            let luminance = (two * xy + c1) * one_b1;
            let contrast = (two * (product[i] - xy) + c2) * one_b2;
            let similarity = luminance * contrast;
            let d_product = two * luminance * one_b2;
            let d_square = similarity * one_b2;
            s[i] = similarity;
            by_product[i] = weight * d_product;
            by_square[i] = -(weight * d_square);
            by_mean[i] = weight
                * (two * ((y * contrast - x * similarity) * one_b1 + x * d_square) - y * d_product);
        }
        for_excluded(self.excluded, row, |at| {
            s[at.clone()].fill(T::ZERO);
            by_mean[at.clone()].fill(T::ZERO);
            by_square[at.clone()].fill(T::ZERO);
            by_product[at].fill(T::ZERO);
        });
    }

    /// The gradient of a row from the blurred slopes, and |x - y|; 0 in excluded pixels.
    fn gradient(&self, row: usize, slopes: &[T], absolute: &mut [T], out: &mut [[T; 3]]) {
        let n = absolute.len();
        let two = T::from_f64(2.0);
        let slope = self.weights[0];
        let (x, y) = (
            &self.x.row(row).as_flattened()[..n],
            &self.y.row(row).as_flattened()[..n],
        );
        let field = |k: usize| &slopes[k * n..][..n];
        let (by_mean, by_square, by_product) = (field(0), field(1), field(2));
        let out = &mut out.as_flattened_mut()[..n];
        for i in 0..n {
            let difference = x[i] - y[i];
            absolute[i] = difference.abs();
            let up = if difference > T::ZERO { slope } else { T::ZERO };
            let down = if difference < T::ZERO { slope } else { T::ZERO };
            let structure = by_mean[i] + two * x[i] * by_square[i] + y[i] * by_product[i];
            out[i] = (up - down) + structure;
        }
        for_excluded(self.excluded, row, |at| {
            absolute[at.clone()].fill(T::ZERO);
            out[at].fill(T::ZERO);
        });
    }

    /// g∗field along a row with its margins, field after field.
    fn along(&self, padded: &[Vec<T>], out: &mut [T]) {
        let n = out.len() / padded.len();
        for (field, out) in padded.iter().zip(out.chunks_exact_mut(n)) {
            weighted(
                &self.taps,
                std::array::from_fn(|k| &field[k * PIXEL..]),
                out,
            );
        }
    }

    /// g∗field across eleven rows.
    fn down(&self, rows: [&[T]; TAPS], out: &mut [T]) {
        weighted(&self.taps, rows, out);
    }
}

/// Σₖ tapₖ rowₖ, the middle first, then the pairs of equal taps outwards.
#[inline]
fn weighted<T: Real>(taps: &[T; TAPS], rows: [&[T]; TAPS], out: &mut [T]) {
    let n = out.len();
    let [r0, r1, r2, r3, r4, r5, r6, r7, r8, r9, r10] = rows.map(|row| &row[..n]);
    let [.., t5, t6, t7, t8, t9, t10] = *taps;
    for i in 0..n {
        let inner = t5 * r5[i] + t6 * (r4[i] + r6[i]);
        let inner = inner + t7 * (r3[i] + r7[i]);
        let inner = inner + t8 * (r2[i] + r8[i]);
        let inner = inner + t9 * (r1[i] + r9[i]);
        out[i] = inner + t10 * (r0[i] + r10[i]);
    }
}

/// The last eleven rows of something, and a row of zeros for what lies outside the image.
struct LastRows<T> {
    numbers: Vec<T>,
    n: usize,
}

impl<T: Real> LastRows<T> {
    fn new(n: usize) -> Self {
        Self {
            numbers: vec![T::ZERO; (TAPS + 1) * n],
            n,
        }
    }

    fn row_mut(&mut self, row: usize) -> &mut [T] {
        &mut self.numbers[row % TAPS * self.n..][..self.n]
    }

    /// Rows `middle` - 5 to `middle` + 5.
    fn around(&self, middle: usize, height: usize) -> [&[T]; TAPS] {
        std::array::from_fn(|k| {
            let row = (middle + k).checked_sub(RADIUS).filter(|&row| row < height);
            &self.numbers[row.map_or(TAPS, |row| row % TAPS) * self.n..][..self.n]
        })
    }
}

/// Hands the places of each excluded pixel of the row to `f`.
#[inline]
fn for_excluded(excluded: Option<&MaskImage>, row: usize, mut f: impl FnMut(Range<usize>)) {
    let Some(mask) = excluded else { return };
    for (column, &value) in mask.row(row).iter().enumerate() {
        if value != 0 {
            f(column * PIXEL..(column + 1) * PIXEL);
        }
    }
}

/// Σ in f64: every eighth number from each of the first eight, then these eight in their order.
fn sum<T: Real>(values: &[T]) -> f64 {
    let mut lanes = [0.0; 8];
    for eight in values.chunks(8) {
        for (lane, value) in lanes.iter_mut().zip(eight) {
            *lane += value.to_f64();
        }
    }
    lanes.iter().fold(0.0, |sum, lane| sum + lane)
}
