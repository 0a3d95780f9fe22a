//! Masks of what moves (255 moving, 0 static, 128 unknown): dilation, halving, cells.

use garad_core::MaskImage;
use nalgebra::Vector2;

use crate::frame::keypoint_depth::nearest_pixel;

/// Marks a moving pixel.
pub const MOVING: u8 = 255;

/// Side of the cells of a mask in cells, px.
pub(crate) const CELL_PX: usize = 4;

/// A mask in cells at the size of the image.
pub(crate) fn full_size(cells: &MaskImage, (width, height): (usize, usize)) -> MaskImage {
    MaskImage::from_fn(width, height, |x, y| {
        cells
            .get(x / CELL_PX, y / CELL_PX)
            .copied()
            .unwrap_or_default()
    })
}

/// Whether anything moves within the square of `radius` pixels around (x, y)?
#[must_use]
pub fn moving_near(mask: &MaskImage, x: usize, y: usize, radius: usize) -> bool {
    let columns = around(x, mask.width(), radius);
    around(y, mask.height(), radius).any(|y| mask.row(y)[columns.clone()].contains(&MOVING))
}

/// Whether the mask is moving at the pixel nearest to a position.
pub(crate) fn is_moving_at(mask: &MaskImage, px: &Vector2<f64>) -> bool {
    nearest_pixel(px, mask.size()).is_some_and(|at| mask[at] == MOVING)
}

/// [`moving_near`] of every pixel as a mask of 255 and 0, by two running counts: of the moving pixels of a column within
/// `radius` rows, and of the columns within `radius` that have any.
#[must_use]
pub fn dilated(mask: &MaskImage, radius: usize) -> MaskImage {
    let (width, height) = mask.size();
    let mut out = MaskImage::new(width, height, 0);
    let mut moving = vec![0u32; width];
    let row = |y: usize| mask.row(y).iter().map(|&m| u32::from(m == MOVING));
    for entering in 0..height + radius {
        if entering < height {
            moving
                .iter_mut()
                .zip(row(entering))
                .for_each(|(n, m)| *n += m);
        }
        if let Some(leaving) = entering.checked_sub(2 * radius + 1) {
            moving
                .iter_mut()
                .zip(row(leaving))
                .for_each(|(n, m)| *n -= m);
        }
        let Some(y) = entering.checked_sub(radius) else {
            continue;
        };
        let mut columns = 0;
        for entering in 0..width + radius {
            columns += u32::from(entering < width && moving[entering] > 0);
            if let Some(leaving) = entering.checked_sub(2 * radius + 1) {
                columns -= u32::from(moving[leaving] > 0);
            }
            if entering >= radius && columns > 0 {
                out[(entering - radius, y)] = MOVING;
            }
        }
    }
    out
}

/// Halves a mask: not 0 if any of the pixels under the 5-tap filter of a halved image is.
#[must_use]
pub fn halve(mask: &MaskImage) -> MaskImage {
    let (width, height) = (mask.width().div_ceil(2), mask.height().div_ceil(2));
    MaskImage::from_fn(width, height, |x, y| {
        let columns = around(2 * x, mask.width(), 2);
        let any = around(2 * y, mask.height(), 2)
            .any(|y| mask.row(y)[columns.clone()].iter().any(|m| *m != 0));
        if any { MOVING } else { 0 }
    })
}

/// The indices within `radius` of `center`, cut to `0..n`.
fn around(center: usize, n: usize, radius: usize) -> std::ops::RangeInclusive<usize> {
    center.saturating_sub(radius).min(n - 1)..=(center + radius).min(n - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dilated_is_moving_near_at_every_pixel() {
        let mut rng = garad_core::Rng::new(5);
        let mask = MaskImage::from_fn(13, 9, |_, _| [MOVING, 0, 128][rng.below(40).min(2)]);
        assert!(mask.data().contains(&MOVING), "something moves");
        for radius in [0, 1, 3, 20] {
            let all = dilated(&mask, radius);
            for y in 0..9 {
                for x in 0..13 {
                    let near = moving_near(&mask, x, y, radius);
                    assert_eq!(all[(x, y)] == MOVING, near, "({x}, {y}), radius {radius}");
                }
            }
        }
    }

    #[test]
    fn halving_spreads_over_the_filter() {
        let mut mask = MaskImage::new(9, 9, 0);
        mask[(4, 4)] = 128;
        let half = halve(&mask);
        let marked: Vec<_> = (0..5).map(|x| half[(x, 2)] != 0).collect();
        assert_eq!(
            marked,
            [false, true, true, true, false],
            "two pixels to each side"
        );
    }

    /// 7 x 5 pixels, one of which moves; another is unknown.
    fn one_pixel() -> MaskImage {
        let mut mask = MaskImage::new(7, 5, 0);
        mask[(4, 1)] = MOVING;
        mask[(1, 3)] = 128;
        mask
    }

    #[test]
    fn near_is_within_a_square() {
        for radius in [0, 1, 2] {
            for (x, y) in (0..5usize).flat_map(|y| (0..7usize).map(move |x| (x, y))) {
                let expected = x.abs_diff(4) <= radius && y.abs_diff(1) <= radius;
                let found = moving_near(&one_pixel(), x, y, radius);
                assert_eq!(found, expected, "({x}, {y}), radius {radius}");
            }
        }
    }

    #[test]
    fn the_nearest_pixel_decides() {
        for (x, y, expected) in [
            (3.4, 1.0, false),
            (3.5, 1.0, true),
            (4.4, 1.4, true),
            (4.5, 1.0, false),
            (4.0, 0.4, false),
            (4.0, 0.5, true),
            (4.0, 1.5, false),
            (1.0, 3.0, false),
            (1.0, 4.0, false),
            (-4.0, 1.0, false),
            (7.0, 1.0, false),
        ] {
            let found = is_moving_at(&one_pixel(), &Vector2::new(x, y));
            assert_eq!(found, expected, "({x}, {y})");
        }
    }

    /// Cells of 4 px over 10 x 7 pixels.
    #[test]
    fn a_cell_fills_its_pixels() {
        let mut cells = MaskImage::new(3, 2, 0);
        cells[(1, 0)] = MOVING;
        cells[(2, 1)] = 128;
        let full = full_size(&cells, (10, 7));
        let expected = MaskImage::from_fn(10, 7, |x, y| match (x, y) {
            (4..=7, 0..=3) => MOVING,
            (8..=9, 4..=6) => 128,
            _ => 0,
        });
        assert_eq!(full, expected);
        let larger = full_size(&cells, (13, 9));
        assert_eq!(
            (larger[(12, 0)], larger[(11, 8)]),
            (0, 0),
            "beyond the cells"
        );
    }

    /// Pixel (x, y) of the half covers 2 x - 2 to 2 x + 2: column 1 reaches the odd columns 0 and 1, row 6 is reached by 2 to 4.
    #[test]
    fn halving_covers_two_pixels_to_each_side_of_every_second() {
        let mut mask = MaskImage::new(9, 11, 0);
        mask[(1, 6)] = 1;
        let half = halve(&mask);
        assert_eq!(half.size(), (5, 6), "rounded up");
        for (x, y) in (0..6).flat_map(|y| (0..5).map(move |x| (x, y))) {
            let expected = if x < 2 && (2..5).contains(&y) {
                MOVING
            } else {
                0
            };
            assert_eq!(half[(x, y)], expected, "({x}, {y})");
        }
    }
}
