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

/// [`moving_near`] of every pixel as a mask of 255 and 0: first along rows, then along columns.
#[must_use]
pub fn dilated(mask: &MaskImage, radius: usize) -> MaskImage {
    let (width, height) = mask.size();
    let rows = MaskImage::from_fn(width, height, |x, y| {
        let any = mask.row(y)[around(x, width, radius)].contains(&MOVING);
        if any { MOVING } else { 0 }
    });
    MaskImage::from_fn(width, height, |x, y| {
        let any = around(y, height, radius).any(|y| rows[(x, y)] == MOVING);
        if any { MOVING } else { 0 }
    })
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
}
