//! [`Projected`]: one Gaussian as a splat of the image.

use garad_core::Real;

/// A half-open rectangle of pixels, [x0, x1) x [y0, y1).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PixelRect {
    /// First column.
    pub x0: usize,
    /// Column after the last.
    pub x1: usize,
    /// First row.
    pub y0: usize,
    /// Row after the last.
    pub y1: usize,
}

impl PixelRect {
    /// Holds no pixel.
    #[inline]
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.x0 >= self.x1 || self.y0 >= self.y1
    }

    /// Holds the pixel in column `x` and row `y`.
    #[inline]
    pub(crate) fn contains(&self, x: usize, y: usize) -> bool {
        (self.x0..self.x1).contains(&x) && (self.y0..self.y1).contains(&y)
    }
}

/// A visible Gaussian, projected into the image.
///
/// A Gaussian is invisible, and never an error, when its label is not asked for, when its
/// z ≤ 0.2 m, when its footprint misses the image, when one of its numbers is not finite, when
/// its quaternion has no direction, or when its projection or the square of its depth or colour
/// overflows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Projected<T> {
    /// Row in the map.
    pub index: u32,
    /// Centre, pixels.
    pub mean_px: [T; 2],
    /// z of the mean in the camera, metres: the sort key.
    pub depth_m: T,
    /// (a, b, c) of the inverse covariance [a, b; b, c], px⁻².
    pub conic: [T; 3],
    /// b/a, computed as -Σ'xy / Σ'yy.
    pub shear: T,
    /// 1/Σ'yy, px⁻².
    pub inv_var_y: T,
    /// √(Σ'xx), √(Σ'yy), pixels.
    pub sigma_px: [T; 2],
    /// sigmoid(logit), in [0, 1].
    pub opacity: T,
    /// ≥ 0 per channel.
    pub color: [T; 3],
    /// ⌈3 √λmax⌉, pixels.
    pub radius_px: i32,
    /// The pixels it may touch.
    pub footprint: PixelRect,
}

impl<T: Real> Projected<T> {
    /// All zero, with an empty footprint: fills places before splats are written to them.
    pub(crate) const ZERO: Self = Self {
        index: 0,
        mean_px: [T::ZERO; 2],
        depth_m: T::ZERO,
        conic: [T::ZERO; 3],
        shear: T::ZERO,
        inv_var_y: T::ZERO,
        sigma_px: [T::ZERO; 2],
        opacity: T::ZERO,
        color: [T::ZERO; 3],
        radius_px: 0,
        footprint: PixelRect {
            x0: 0,
            x1: 0,
            y0: 0,
            y1: 0,
        },
    };
}
