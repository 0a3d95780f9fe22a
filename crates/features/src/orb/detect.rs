//! Corners of one pyramid level, cell by cell, so that weakly textured cells have corners too.

use garad_core::GrayImage;

use super::OrbConfig;
use crate::fast9::{self, BORDER, Corner, Window};

/// The outermost pixels of a level hold no corner: 16 of margin and 3 of circle leave 19, room
/// for the disc of the orientation (15) and for any turned descriptor (18).
pub const MARGIN: usize = 16;

/// Corners of a level: (x, y) relative to (MARGIN, MARGIN), in the order of the cells.
///
/// The area inside the margin is cut into cells of about `cell_px`; each is searched with
/// `threshold`, and again with `min_threshold` if that leaves nothing. Suppression does not look
/// across the edge of a cell. `scores` is scratch.
pub fn cell_corners(image: &GrayImage, config: &OrbConfig, scores: &mut GrayImage) -> Vec<Corner> {
    let mut out = Vec::new();
    let Some((width, height)) = searched_size(image) else {
        return out;
    };
    let (columns, cell_w) = cells(width, config.cell_px);
    let (rows, cell_h) = cells(height, config.cell_px);
    let (first, last_x, last_y) = (
        MARGIN + BORDER,
        MARGIN + width - BORDER,
        MARGIN + height - BORDER,
    );
    let clipped = |i: usize, cell: usize, last: usize| {
        (
            (first + i * cell).min(last),
            (first + (i + 1) * cell).min(last),
        )
    };
    for row in 0..rows {
        let (y0, y1) = clipped(row, cell_h, last_y);
        // The first threshold runs along the whole row of cells, where it is fastest.
        let band = Window {
            x0: first,
            x1: last_x.max(first),
            y0,
            y1,
        };
        fast9::fast::score_window(image, config.threshold, band, scores);
        for column in 0..columns {
            let (x0, x1) = clipped(column, cell_w, last_x);
            let cell = Window { x0, x1, y0, y1 };
            let before = out.len();
            fast9::collect(scores, cell, true, &mut out);
            if out.len() == before {
                fast9::fast::score_window(image, config.min_threshold, cell, scores);
                fast9::collect(scores, cell, true, &mut out);
            }
        }
    }
    for corner in &mut out {
        corner.x -= MARGIN;
        corner.y -= MARGIN;
    }
    out
}

/// Size of the area inside the margin; `None` if no pixel of it has a full circle.
pub fn searched_size(image: &GrayImage) -> Option<(usize, usize)> {
    let inside = |n: usize| n.checked_sub(2 * MARGIN).filter(|&n| n > 2 * BORDER);
    Some((inside(image.width())?, inside(image.height())?))
}

/// How many cells, and how long each is: ⌊n / cell⌋ (at least 1) cells of ⌈n / count⌉.
fn cells(n: usize, cell_px: usize) -> (usize, usize) {
    let count = (n / cell_px).max(1);
    (count, n.div_ceil(count))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_cover_the_area() {
        assert_eq!(cells(608, 35), (17, 36), "640 pixels wide");
        assert_eq!(cells(20, 35), (1, 20), "smaller than a cell");
        for n in 7..2000 {
            let (count, length) = cells(n, 35);
            assert!(count * length >= n, "{n}");
        }
    }

    /// A square of 2 x 2 pixels, `contrast` above a grey of 100: a corner at its pixels.
    fn dots(places: &[(usize, usize, u8)]) -> GrayImage {
        let mut image = GrayImage::new(140, 120, 100);
        for &(x, y, contrast) in places {
            image[(x, y)] = 100 + contrast;
        }
        image
    }

    #[test]
    fn weak_corners_count_only_where_there_is_no_strong_one() {
        let config = OrbConfig::default();
        // Cells of 36 from x = 19: [19, 55), [55, 91), ...; (25, 25) and (45, 25) share one.
        let image = dots(&[(25, 25, 50), (45, 25, 10), (70, 25, 10)]);
        let mut scores = GrayImage::default();
        let found = cell_corners(&image, &config, &mut scores);
        let places: Vec<_> = found
            .iter()
            .map(|c| (c.x + MARGIN, c.y + MARGIN, c.score))
            .collect();
        assert_eq!(
            places,
            [(25, 25, 49), (70, 25, 9)],
            "the weak one beside the strong is dropped"
        );
    }

    #[test]
    fn nothing_is_found_in_the_margin_or_in_tiny_levels() {
        let config = OrbConfig::default();
        let mut scores = GrayImage::default();
        let edge = dots(&[(18, 40, 90), (19, 60, 90), (120, 40, 90), (121, 60, 90)]);
        let found = cell_corners(&edge, &config, &mut scores);
        let places: Vec<_> = found.iter().map(|c| c.x + MARGIN).collect();
        assert_eq!(
            places,
            [19, 120],
            "first and last column that may hold a corner"
        );
        for size in [(0, 0), (38, 200), (200, 38), (39, 39)] {
            let flat = GrayImage::new(size.0, size.1, 7);
            assert!(
                cell_corners(&flat, &config, &mut scores).is_empty(),
                "{size:?}"
            );
        }
    }

    /// A single brighter pixel passes a threshold that it exceeds. With cells of 60 pixels the area of 108 x 88 is one
    /// cell; with 30 there are three columns of 36.
    #[test]
    fn thresholds_and_cells_are_those_of_the_configuration() {
        let image = dots(&[(25, 25, 31), (70, 25, 13), (100, 25, 12), (110, 90, 30)]);
        let mut scores = GrayImage::default();
        let mut found = |threshold, min_threshold, cell_px| {
            let config = OrbConfig {
                threshold,
                min_threshold,
                cell_px,
                ..OrbConfig::default()
            };
            let found = cell_corners(&image, &config, &mut scores);
            let mut columns: Vec<_> = found.iter().map(|c| c.x + MARGIN).collect();
            columns.sort_unstable();
            columns
        };
        assert_eq!(found(30, 12, 30), [25, 70, 110], "12 is not above 12");
        assert_eq!(found(30, 11, 30), [25, 70, 100, 110], "but above 11");
        assert_eq!(found(30, 13, 30), [25, 110], "13 is not above 13");
        assert_eq!(found(30, 12, 60), [25], "one cell has one above 30");
        assert_eq!(found(29, 12, 60), [25, 110], "and two above 29");
        assert_eq!(found(31, 12, 60), [25, 70, 110], "none above 31");
    }
}
