//! The score with early rejection, row by row.
//!
//! An arc of 9 out of 16 holds at least one pixel of every opposite pair. So a bright corner has,
//! in each pair, a larger pixel above I(q) + t, and a dark one a smaller pixel below I(q) - t:
//!
//! bright possible ⇔ min over pairs of max(p, p') > I(q) + t
//! dark possible   ⇔ max over pairs of min(p, p') < I(q) - t
//!
//! That is `min` and `max` of bytes without a branch, which the compiler turns into 16 pixels at
//! a time. Only the few pixels that pass get their arcs looked at.

use garad_core::GrayImage;

use super::{BORDER, CIRCLE, Window};

/// Pixels tested together.
const LANES: usize = 16;

/// As [`super::reference::score_window`], with the same numbers.
///
/// # Panics
/// If the window is nearer to the edge than [`BORDER`].
pub fn score_window(image: &GrayImage, threshold: u8, window: Window, scores: &mut GrayImage) {
    if scores.size() != image.size() {
        *scores = GrayImage::new(image.width(), image.height(), 0);
    }
    let Window { x0, x1, y0, y1 } = window;
    for y in y0..y1 {
        if x0 >= x1 {
            break;
        }
        // The seven rows of the circle, each from 3 left of the window to 3 right of it.
        let rows: [&[u8]; 7] =
            std::array::from_fn(|j| &image.row(y + j - BORDER)[x0 - BORDER..x1 + BORDER]);
        let out = &mut scores.row_mut(y)[x0..x1];
        out.fill(0);
        let mut x = 0;
        while x + LANES <= out.len() {
            score_block(&rows, x, threshold, out);
            x += LANES;
        }
        for (x, out) in out.iter_mut().enumerate().skip(x) {
            *out = score_pixel(&rows, x, threshold);
        }
    }
}

/// Tests 16 pixels together and scores those that pass.
fn score_block(rows: &[&[u8]; 7], x: usize, threshold: u8, out: &mut [u8]) {
    let load = |(dx, dy): (isize, isize)| -> &[u8; LANES] {
        let row = rows[3usize.wrapping_add_signed(dy)];
        let start = (x + 3).wrapping_add_signed(dx);
        row[start..].first_chunk().unwrap_or(&[0; LANES])
    };
    let mut smallest_max = [255u8; LANES];
    let mut largest_min = [0u8; LANES];
    for k in 0..8 {
        let (a, b) = (load(CIRCLE[k]), load(CIRCLE[k + 8]));
        for i in 0..LANES {
            smallest_max[i] = smallest_max[i].min(a[i].max(b[i]));
            largest_min[i] = largest_min[i].max(a[i].min(b[i]));
        }
    }
    let centre = load((0, 0));
    let mut possible = [0u8; LANES];
    for i in 0..LANES {
        let bright = smallest_max[i].saturating_sub(centre[i]);
        let dark = centre[i].saturating_sub(largest_min[i]);
        possible[i] = bright.max(dark).saturating_sub(threshold);
    }
    if u128::from_le_bytes(possible) == 0 {
        return;
    }
    for i in 0..LANES {
        if possible[i] > 0 {
            out[x + i] = score_pixel(rows, x + i, threshold);
        }
    }
}

/// The score of one pixel, 0 if below the threshold.
///
/// Minima over 9 in a row come from minima over 2, 4 and 8 in a row, all around the circle:
/// 64 comparisons instead of 128.
fn score_pixel(rows: &[&[u8]; 7], x: usize, threshold: u8) -> u8 {
    let centre = rows[3][x + 3];
    let p: [u8; 16] = std::array::from_fn(|k| {
        let (dx, dy) = CIRCLE[k];
        rows[3usize.wrapping_add_signed(dy)][(x + 3).wrapping_add_signed(dx)]
    });
    let darkest_of_best_arc = nine_in_a_row(p, u8::min).into_iter().fold(0, u8::max);
    let brightest_of_best_arc = nine_in_a_row(p, u8::max).into_iter().fold(255, u8::min);
    let contrast = darkest_of_best_arc
        .saturating_sub(centre)
        .max(centre.saturating_sub(brightest_of_best_arc));
    // contrast 0 has no score; score >= threshold is contrast > threshold.
    if contrast > threshold {
        contrast - 1
    } else {
        0
    }
}

/// `pick` over each run of 9 consecutive values of the ring.
fn nine_in_a_row(ring: [u8; 16], pick: fn(u8, u8) -> u8) -> [u8; 16] {
    let merge = |a: [u8; 16], b: [u8; 16], shift: usize| -> [u8; 16] {
        std::array::from_fn(|k| pick(a[k], b[(k + shift) % 16]))
    };
    let two = merge(ring, ring, 1);
    let four = merge(two, two, 2);
    let eight = merge(four, four, 4);
    merge(eight, ring, 8)
}
