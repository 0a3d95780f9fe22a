//! [`Rendered`]: the images that come out, and [`Upstream`]: a loss's gradient by them.

use garad_core::{Image, Real};

use crate::composite::MIN_TRANSMITTANCE;
use crate::splat::Projected;

/// The rendered images and the splats they were made of.
#[derive(Debug, Clone, PartialEq)]
pub struct Rendered<T> {
    /// Σ w c + T background.
    pub color: Image<[T; 3]>,
    /// Σ w z, metres: the expected depth times the opacity, without background.
    pub depth: Image<T>,
    /// Σ w = 1 - T.
    pub opacity: Image<T>,
    /// T, the transmittance: the share of light no splat has absorbed. Kept beside `opacity`
    /// because 1 - (1 - T) has lost most digits of a small T.
    pub transmittance: Image<T>,
    /// Number of splats blended into each pixel.
    pub contributors: Image<u32>,
    /// One more than the position of the last blended splat in its tile's list (0: none): where
    /// the backward pass starts. With 16-pixel tiles this is `n_contrib` of the CUDA rasterizer.
    pub last: Image<u32>,
    /// Per Gaussian of the map, ⌈3 √λmax⌉ pixels; 0 where invisible.
    pub radii: Vec<i32>,
    /// The visible splats, front to back.
    pub projected: Vec<Projected<T>>,
}

impl<T: Real> Rendered<T> {
    /// Expected depth Σ w z / Σ w, metres; 0 (missing) where nothing was drawn.
    #[must_use]
    pub fn normalized_depth(&self) -> Image<T> {
        let (width, height) = self.depth.size();
        Image::from_fn(width, height, |x, y| {
            let opacity = self.opacity[(x, y)];
            // Whatever was drawn has left at least 1/255.
            if opacity > T::ZERO {
                self.depth[(x, y)] / opacity
            } else {
                T::ZERO
            }
        })
    }

    /// Finite everywhere, T in [1e-4, 1], depths and counts consistent; what debug builds check.
    ///
    /// # Errors
    /// A sentence naming the first bad pixel.
    pub fn validate(&self) -> Result<(), String> {
        let (width, height) = self.color.size();
        let floor = T::from_f64(MIN_TRANSMITTANCE);
        for y in 0..height {
            for x in 0..width {
                let at = (x, y);
                let t = self.transmittance[at];
                let finite = self.color[at].iter().all(|v| v.is_finite())
                    && self.depth[at].is_finite()
                    && t >= floor
                    && t <= T::ONE;
                let untouched = self.contributors[at] == 0;
                let consistent = untouched == (t >= T::ONE)
                    && untouched == (self.last[at] == 0)
                    && self.contributors[at] <= self.last[at];
                if !(finite && consistent) {
                    return Err(format!(
                        "pixel ({x}, {y}): color {:?}, depth {}, transmittance {t}, {} splats, last {}",
                        self.color[at], self.depth[at], self.contributors[at], self.last[at]
                    ));
                }
            }
        }
        Ok(())
    }
}

/// ∂L/∂ of the images of a [`Rendered`]. An image that is absent is zero.
#[derive(Debug, Clone, PartialEq)]
pub struct Upstream<T> {
    /// By [`Rendered::color`].
    pub color: Image<[T; 3]>,
    /// By [`Rendered::depth`] (Σ w z, not divided by the opacity), 1/m.
    pub depth: Option<Image<T>>,
    /// By [`Rendered::opacity`].
    pub opacity: Option<Image<T>>,
}
