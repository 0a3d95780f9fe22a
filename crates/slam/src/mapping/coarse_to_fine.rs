//! Coarse to fine: the Gaussian pyramid of a view's target, and the level of each iteration (eq. 16).

use garad_core::Image;
use garad_core::pyramid::halve_real;

/// Index n of the coarsest level: three levels, 2, 1, 0.
pub(crate) const TOP_LEVEL: usize = 2;

/// The level of a view's next iteration, by the number of iterations it was used in before. Eq. 16:
///
/// tᵢ: argmin L(Iᵣⁱ, GPⁱ(I_gt)), i = n, ..., 1, 0
///
/// The argmin of each level but the last is approximated by `per_level` iterations.
#[must_use]
pub fn level_of_iteration(uses: usize, per_level: usize) -> usize {
    let mut end = 0;
    for level in (1..=TOP_LEVEL).rev() {
        end += per_level;
        if uses < end {
            return level;
        }
    }
    0
}

/// GPⁱ(I): an image after `level` halvings (the pyramid of eq. 16).
pub(crate) fn gaussian_pyramid(image: Image<[f32; 3]>, level: usize) -> Image<[f32; 3]> {
    (0..level).fold(image, |image, _| halve_real(&image))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_coarse_level_has_its_uses_and_the_finest_the_rest() {
        for (per_level, expected) in [
            (3, [2, 2, 2, 1, 1, 1, 0, 0]),
            (1, [2, 1, 0, 0, 0, 0, 0, 0]),
            (0, [0; 8]),
        ] {
            let levels: Vec<_> = (0..8)
                .map(|uses| level_of_iteration(uses, per_level))
                .collect();
            assert_eq!(levels, expected, "{per_level} each");
        }
    }

    /// One white pixel: (6/16)² of it after a halving.
    #[test]
    fn each_level_is_smoothed_and_halved() {
        let white = |x, y| [if (x, y) == (8, 4) { 1.0 } else { 0.0 }, 0.5, 0.0];
        let image = Image::from_fn(16, 12, white);
        assert_eq!(gaussian_pyramid(image.clone(), 0), image, "as it is");
        let half = gaussian_pyramid(image.clone(), 1);
        assert_eq!((half.size(), half[(4, 2)]), ((8, 6), [0.140_625, 0.5, 0.0]));
        let quarter = gaussian_pyramid(image, 2);
        assert_eq!((quarter.size(), quarter[(2, 1)][1]), ((4, 3), 0.5));
    }
}
