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
