//! FAST-9/16: corners by comparing a pixel with the circle of 16 around it.
//!
//! A pixel is a corner if 9 neighbours in a row on the circle are all brighter, or all darker,
//! than the centre by more than a threshold. The largest threshold for which that still holds is
//! the pixel's *score*:
//!
//! score(q) = max( max_a min_{p ∈ a} (I(p) - I(q)),  max_a min_{p ∈ a} (I(q) - I(p)) ) - 1
//!
//! over the 16 arcs a of 9 consecutive circle pixels; q is a corner at threshold t if and only if
//! score(q) ≥ t. [`mod@reference`] computes just that; [`fast`] computes it only where four pairs
//! of opposite pixels leave it possible, and gives the same numbers. Source: Rosten & Drummond
//! 2006; the score is OpenCV's.

pub mod fast;
pub mod reference;

use garad_core::GrayImage;

/// The circle of radius 3, clockwise on the screen from the pixel below the centre.
pub const CIRCLE: [(isize, isize); 16] = [
    (0, 3),
    (1, 3),
    (2, 2),
    (3, 1),
    (3, 0),
    (3, -1),
    (2, -2),
    (1, -3),
    (0, -3),
    (-1, -3),
    (-2, -2),
    (-3, -1),
    (-3, 0),
    (-3, 1),
    (-2, 2),
    (-1, 3),
];

/// Pixels nearer than this to the edge have no full circle and are never corners.
pub const BORDER: usize = 3;

/// A corner at an integer pixel.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Corner {
    /// Column.
    pub x: usize,
    /// Row.
    pub y: usize,
    /// The largest threshold at which it is a corner.
    pub score: u8,
}

/// A rectangle of pixels, x0 ≤ x < x1 and y0 ≤ y < y1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Window {
    /// First column.
    pub x0: usize,
    /// Column after the last.
    pub x1: usize,
    /// First row.
    pub y0: usize,
    /// Row after the last.
    pub y1: usize,
}

impl Window {
    /// Every pixel that has a full circle.
    #[must_use]
    pub fn inside(image: &GrayImage) -> Self {
        let (w, h) = image.size();
        Self {
            x0: BORDER.min(w),
            x1: w.saturating_sub(BORDER).max(BORDER.min(w)),
            y0: BORDER.min(h),
            y1: h.saturating_sub(BORDER).max(BORDER.min(h)),
        }
    }
}

/// All corners of an image in raster order.
///
/// With `suppress`, only those whose score is strictly greater than the scores of all 8
/// neighbours, where a neighbour that is no corner counts 0; two equal neighbours remove each
/// other. Bit-equal to OpenCV's `FAST` (type 9/16). Golden: `fast/*`.
#[must_use]
pub fn corners(image: &GrayImage, threshold: u8, suppress: bool) -> Vec<Corner> {
    let mut scores = GrayImage::default();
    let window = Window::inside(image);
    fast::score_window(image, threshold, window, &mut scores);
    let mut out = Vec::new();
    collect(&scores, window, suppress, &mut out);
    out
}

/// Appends the corners of `window` in raster order; `scores` holds 0 where there is none.
/// Neighbours outside the window count 0.
pub(crate) fn collect(scores: &GrayImage, window: Window, suppress: bool, out: &mut Vec<Corner>) {
    let Window { x0, x1, y0, y1 } = window;
    for y in y0..y1 {
        let row = &scores.row(y)[x0..x1];
        // Nearly all scores are 0: look at 16 at a time.
        for (block, lanes) in row.chunks(16).enumerate() {
            if lanes.iter().fold(0, |any, score| any | score) == 0 {
                continue;
            }
            for (i, &score) in lanes.iter().enumerate().filter(|&(_, &s)| s > 0) {
                let x = x0 + 16 * block + i;
                if !suppress || is_peak(scores, window, x, y) {
                    out.push(Corner { x, y, score });
                }
            }
        }
    }
}

/// Strictly greater than all 8 neighbours inside the window.
fn is_peak(scores: &GrayImage, window: Window, x: usize, y: usize) -> bool {
    let score = scores[(x, y)];
    let columns = x.saturating_sub(1).max(window.x0)..(x + 2).min(window.x1);
    let mut rows = y.saturating_sub(1).max(window.y0)..(y + 2).min(window.y1);
    rows.all(|ny| {
        let row = &scores.row(ny)[columns.clone()];
        let rivals = row.iter().filter(|&&s| s >= score).count();
        rivals == usize::from(ny == y) // itself
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::Rng;
    use proptest::prelude::*;

    /// A 7x7 image of `centre` whose circle pixels are given one by one.
    fn circle_image(centre: u8, circle: [u8; 16]) -> GrayImage {
        let mut image = GrayImage::new(7, 7, centre);
        for ((dx, dy), value) in CIRCLE.into_iter().zip(circle) {
            image[((3 + dx).unsigned_abs(), (3 + dy).unsigned_abs())] = value;
        }
        image
    }

    /// The same laws for both implementations of the score.
    macro_rules! score_laws {
        ($name:ident, $score_window:path) => {
            mod $name {
                use super::*;

                fn score(image: &GrayImage, threshold: u8) -> u8 {
                    let mut scores = GrayImage::default();
                    $score_window(image, threshold, Window::inside(image), &mut scores);
                    assert_eq!(scores.size(), image.size(), "one score per pixel");
                    scores[(3, 3)]
                }

                #[test]
                fn nine_in_a_row_make_a_corner_and_eight_do_not() {
                    for start in 0..16 {
                        for (length, expected) in [(8, 0), (9, 49), (16, 49)] {
                            for value in [150, 50] {
                                let mut circle = [100; 16];
                                for k in 0..length {
                                    circle[(start + k) % 16] = value;
                                }
                                let image = circle_image(100, circle);
                                assert_eq!(
                                    score(&image, 20),
                                    expected,
                                    "{length} pixels of {value} from {start}"
                                );
                            }
                        }
                    }
                }

                #[test]
                fn threshold_is_met_by_equality() {
                    // Contrast 21 has score 20: a corner at 20, none at 21.
                    let image = circle_image(100, [121; 16]);
                    assert_eq!(
                        [score(&image, 20), score(&image, 21)],
                        [20, 0],
                        "both sides"
                    );
                }

                #[test]
                fn extremes_do_not_wrap() {
                    let bright = circle_image(0, [255; 16]);
                    let dark = circle_image(255, [0; 16]);
                    assert_eq!(
                        [score(&bright, 1), score(&dark, 254)],
                        [254, 254],
                        "full contrast"
                    );
                    assert_eq!(score(&bright, 255), 0, "no contrast reaches 256");
                    assert_eq!(score(&circle_image(7, [7; 16]), 1), 0, "flat");
                }

                #[test]
                fn only_the_window_is_touched() {
                    let image = noise(40, 30, 1);
                    let mut scores = GrayImage::new(40, 30, 77);
                    let window = Window {
                        x0: 10,
                        x1: 29,
                        y0: 5,
                        y1: 9,
                    };
                    $score_window(&image, 5, window, &mut scores);
                    for y in 0..30 {
                        for x in 0..40 {
                            let within = (10..29).contains(&x) && (5..9).contains(&y);
                            assert_eq!(scores[(x, y)] == 77, !within, "({x}, {y})");
                        }
                    }
                }
            }
        };
    }
    score_laws!(reference_laws, reference::score_window);
    score_laws!(fast_laws, fast::score_window);

    fn noise(width: usize, height: usize, seed: u64) -> GrayImage {
        let mut rng = Rng::new(seed);
        // Half of the pixels grey, so that some circles are nearly corners.
        GrayImage::from_fn(width, height, |_, _| match rng.below(512) {
            v @ 0..256 => u8::try_from(v).expect("below 256"),
            _ => 128,
        })
    }

    proptest! {
        #[test]
        fn both_give_the_same_scores(w in 0usize..90, h in 0usize..20, t in 1u8.., seed: u64) {
            let image = noise(w, h, seed);
            let window = Window::inside(&image);
            let (mut slow, mut quick) = (GrayImage::default(), GrayImage::default());
            reference::score_window(&image, t, window, &mut slow);
            fast::score_window(&image, t, window, &mut quick);
            prop_assert_eq!(slow, quick);
        }

        #[test]
        fn dark_and_bright_are_alike(seed: u64) {
            let image = noise(30, 20, seed);
            let negative = image.map(|v| 255 - v);
            prop_assert_eq!(corners(&image, 10, true), corners(&negative, 10, true));
        }

        #[test]
        fn survivors_are_strict_peaks(seed: u64) {
            let image = noise(40, 30, seed);
            let all = corners(&image, 10, false);
            let kept = corners(&image, 10, true);
            for a in &all {
                let beaten = all.iter().any(|b| {
                    a != b && a.x.abs_diff(b.x) <= 1 && a.y.abs_diff(b.y) <= 1 && b.score >= a.score
                });
                prop_assert_eq!(kept.contains(a), !beaten, "{:?}", a);
            }
            prop_assert!(kept.windows(2).all(|p| (p[0].y, p[0].x) < (p[1].y, p[1].x)), "raster order");
        }
    }

    #[test]
    fn equal_neighbours_remove_each_other() {
        let mut scores = GrayImage::new(6, 3, 0);
        scores[(1, 1)] = 9;
        scores[(2, 1)] = 9;
        scores[(5, 0)] = 4;
        let window = Window {
            x0: 0,
            x1: 6,
            y0: 0,
            y1: 3,
        };
        let mut out = Vec::new();
        collect(&scores, window, true, &mut out);
        assert_eq!(
            out,
            [Corner {
                x: 5,
                y: 0,
                score: 4
            }],
            "equal scores remove each other"
        );
        // Cut between the two, each is alone in its window.
        for (x0, x1) in [(0, 2), (2, 5)] {
            let mut out = Vec::new();
            collect(&scores, Window { x0, x1, ..window }, true, &mut out);
            assert_eq!(out.len(), 1, "neighbours outside the window count nothing");
        }
    }

    #[test]
    fn images_without_a_full_circle_have_no_corner() {
        for size in [(0, 0), (1, 1), (6, 40), (40, 6)] {
            assert!(
                corners(&noise(size.0, size.1, 3), 1, false).is_empty(),
                "{size:?}"
            );
        }
    }
}
