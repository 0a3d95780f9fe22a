//! The score with early rejection, row by row.
//!
//! An arc of 9 out of 16 holds at least one pixel of every opposite pair. So a bright corner has,
//! in each pair, a larger pixel above I(q) + t, and a dark one a smaller pixel below I(q) - t:
//!
//! bright possible ⇔ min over pairs of max(p, p') > I(q) + t
//! dark possible   ⇔ max over pairs of min(p, p') < I(q) - t
//!
//! That is `min` and `max` of bytes without a branch, which the compiler turns into 16 pixels per
//! instruction. A block in which no pixel passes is done; in the few others all pixels are scored
//! the same way, which costs less than selecting those that passed.

use garad_core::GrayImage;

use super::{BORDER, CIRCLE, Window};

/// Pixels handled together.
const LANES: usize = 32;

type Lanes = [u8; LANES];

/// As [`super::reference::score_window`], with the same numbers.
///
/// # Panics
/// If the window is nearer to the edge than [`BORDER`].
pub fn score_window(image: &GrayImage, threshold: u8, window: Window, scores: &mut GrayImage) {
    if scores.size() != image.size() {
        *scores = GrayImage::new(image.width(), image.height(), 0);
    }
    let (mut ring, mut block) = ([[0; LANES]; 16], [0; LANES]);
    let Window { x0, x1, y0, y1 } = window;
    for y in y0..y1 {
        let rows: [&[u8]; 7] = std::array::from_fn(|j| image.row(y + j - BORDER));
        let out = scores.row_mut(y);
        let mut x = x0;
        while x < x1 {
            // The last block starts earlier, to end with the row; what is written twice is equal.
            let first = x.min((image.width() - BORDER).saturating_sub(LANES));
            let end = (x + LANES).min(x1);
            if first >= BORDER {
                score_block(&rows, first, threshold, &mut ring, &mut block);
                out[x..end].copy_from_slice(&block[x - first..end - first]);
            } else {
                for (x, out) in (x..end).zip(&mut out[x..end]) {
                    *out = score_pixel(&rows, x, threshold);
                }
            }
            x = end;
        }
    }
}

/// Scores of the pixels `x..x + LANES` of the middle row; `ring` is scratch.
fn score_block(
    rows: &[&[u8]; 7],
    x: usize,
    threshold: u8,
    ring: &mut [Lanes; 16],
    out: &mut Lanes,
) {
    let load = |(dx, dy): (isize, isize)| -> Lanes {
        let start = x.wrapping_add_signed(dx);
        let mut lanes = [0; LANES];
        lanes.copy_from_slice(&rows[3usize.wrapping_add_signed(dy)][start..start + LANES]);
        lanes
    };
    let centre = load((0, 0));
    let mut smallest_max = [255u8; LANES];
    let mut largest_min = [0u8; LANES];
    for k in 0..8 {
        let (a, b) = (load(CIRCLE[k]), load(CIRCLE[k + 8]));
        for i in 0..LANES {
            smallest_max[i] = smallest_max[i].min(a[i].max(b[i]));
            largest_min[i] = largest_min[i].max(a[i].min(b[i]));
        }
    }
    let mut possible = 0;
    for i in 0..LANES {
        possible |= above(
            contrast(centre[i], smallest_max[i], largest_min[i]),
            threshold,
        );
    }
    if possible == 0 {
        *out = [0; LANES];
        return;
    }
    for (lanes, offset) in ring.iter_mut().zip(CIRCLE) {
        *lanes = load(offset);
    }
    let (darkest, brightest) = best_arcs(ring);
    for i in 0..LANES {
        out[i] = above(contrast(centre[i], darkest[i], brightest[i]), threshold);
    }
}

/// By how much an arc whose darkest pixel is `darkest` is brighter than the centre, or one whose
/// brightest is `brightest` darker; 0 if neither.
#[inline]
fn contrast(centre: u8, darkest: u8, brightest: u8) -> u8 {
    let brighter_by = darkest.saturating_sub(centre);
    let darker_by = centre.saturating_sub(brightest);
    brighter_by.max(darker_by)
}

/// The score contrast - 1 if that is at least the threshold (not 0), else 0.
#[inline]
fn above(contrast: u8, threshold: u8) -> u8 {
    if contrast > threshold {
        contrast - 1
    } else {
        0
    }
}

/// Over the 16 arcs of 9: the largest minimum and the smallest maximum, lane by lane.
///
/// Two arcs share the 8 pixels from k to k + 7 and differ in one more, before or behind; the
/// better of them has min(m, max(p_before, p_behind)) with m the minimum of the 8: 8 steps for 16
/// arcs.
fn best_arcs<const N: usize>(ring: &[[u8; N]; 16]) -> ([u8; N], [u8; N]) {
    let (mut largest_min, mut smallest_max) = ([0; N], [255; N]);
    for k in (1..16).step_by(2) {
        let run: [&[u8; N]; 10] = std::array::from_fn(|j| &ring[(k + 15 + j) % 16]);
        for i in 0..N {
            let [before, a, b, c, d, e, f, g, h, behind] = run.map(|lanes| lanes[i]);
            let low = a.min(b).min(c.min(d)).min(e.min(f).min(g.min(h)));
            let high = a.max(b).max(c.max(d)).max(e.max(f).max(g.max(h)));
            largest_min[i] = largest_min[i].max(low.min(before.max(behind)));
            smallest_max[i] = smallest_max[i].min(high.max(before.min(behind)));
        }
    }
    (largest_min, smallest_max)
}

/// One pixel, where the image is too narrow for a block.
fn score_pixel(rows: &[&[u8]; 7], x: usize, threshold: u8) -> u8 {
    let ring =
        CIRCLE.map(|(dx, dy)| [rows[3usize.wrapping_add_signed(dy)][x.wrapping_add_signed(dx)]]);
    let ([darkest], [brightest]) = best_arcs(&ring);
    above(contrast(rows[3][x], darkest, brightest), threshold)
}
