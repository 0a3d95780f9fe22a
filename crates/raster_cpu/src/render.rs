//! [`render`]: the whole forward pass.

use garad_core::{Camera, GaussianMap, Image, Par, Real, Se3};

use crate::backward::ClampGradient;
use crate::bin::{Tiles, sort_front_to_back};
use crate::composite::{Pixel, composite_tile};
use crate::error::RasterError;
use crate::project::{Projected, project};
use crate::view::View;

/// Largest side of a picture, pixels. Coordinates up to here are exact in f32 with room for
/// fractions.
pub const MAX_SIDE_PX: usize = 16_384;

/// Which Gaussians are drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Include {
    /// Every one.
    #[default]
    All,
    /// Those labelled static: the paper's render (eq. 15).
    StaticOnly,
    /// Those labelled dynamic.
    DynamicOnly,
}

/// How a map is drawn.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RenderOptions {
    /// Colour behind everything, (r, g, b).
    pub background: [f64; 3],
    /// Side of the squares that work is cut into, pixels. Of the picture only [`Rendered::last`]
    /// depends on it; of gradients, the last bits.
    pub tile_px: usize,
    /// Which Gaussians are drawn.
    pub include: Include,
    /// What [`crate::backward()`] passes through an active clamp; the picture knows nothing of it.
    pub clamp_gradient: ClampGradient,
}

impl Default for RenderOptions {
    /// Black background, 16-pixel tiles, every Gaussian, true derivatives.
    fn default() -> Self {
        Self {
            background: [0.0; 3],
            tile_px: 16,
            include: Include::All,
            clamp_gradient: ClampGradient::True,
        }
    }
}

/// A picture and what it was made of.
#[derive(Debug, Clone, PartialEq)]
pub struct Rendered<T> {
    /// Σ w c + T background.
    pub color: Image<[T; 3]>,
    /// Σ w z, metres: the expected depth times the opacity, without background.
    pub depth: Image<T>,
    /// Σ w = 1 - T.
    pub opacity: Image<T>,
    /// T, the share of light no splat has taken. Kept beside `opacity` because 1 - (1 - T) has
    /// lost most digits of a small T.
    pub transmittance: Image<T>,
    /// Number of splats blended into each pixel.
    pub contributors: Image<u32>,
    /// One more than the position of the last blended splat in its tile's list (0: none): where
    /// the way back starts. With 16-pixel tiles this is `n_contrib` of the CUDA rasterizer.
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
        let floor = T::from_f64(crate::MIN_TRANSMITTANCE);
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

/// Draws a map as the camera at `camera_from_world` sees it.
///
/// I(p) = Σᵢ cᵢ αᵢ Πⱼ₍ⱼ₌₁..ᵢ₋₁₎ (1 - αⱼ) + T background, splats in order of depth, then of row (R11)
///
/// Source: paper eq. 15; Kerbl et al. 2023 and its rasterizer for the constants.
/// Spec test: `spec_render`. Golden: `raster/*`.
///
/// # Shapes and units
/// Pictures are `camera.height` x `camera.width`; `radii` has one entry per Gaussian. The camera
/// is taken as a pinhole: `distortion` is ignored, pictures to compare with are undistorted.
/// # Numerics
/// Everything in `T`; the same bits for every `par` and, `last` apart, every `tile_px`.
/// # Errors
/// [`RasterError`] for a camera, pose, background, tile or picture size that cannot be, and for
/// map arrays of unequal length. A single bad Gaussian is invisible instead.
/// # Example
/// A wide splat in a picture of 12 x 6, its opacity in ten shades:
/// ```
/// use garad_core::{Camera, GaussianMap, KeyframeId, NewGaussian, Par, Real, Se3};
/// use garad_raster::{RenderOptions, render};
///
/// let mut map = GaussianMap::<f64>::new(0);
/// let i = map.push(&NewGaussian {
///     mean: [0.0, 0.0, 2.0],
///     sigma_m: 0.2,
///     opacity: 0.95,
///     color: [1.0, 0.5, 0.0],
///     landmark: None,
///     born: KeyframeId(0),
/// });
/// map.log_scales[i][0] = Real::ln(0.5); // wider than high
/// let camera = Camera::pinhole((12, 6), [10.0, 10.0, 5.5, 2.5])?;
/// let picture = render(&map, &camera, &Se3::default(), &RenderOptions::default(), Par::Seq)?;
/// let shade = |opacity: &f64| b" .:-=+*#%@"[(opacity * 10.0) as usize] as char;
/// let rows: Vec<String> = (0..6).map(|y| picture.opacity.row(y).iter().map(shade).collect()).collect();
/// assert_eq!(rows, [
///     "            ",
///     "  .:----:.  ",
///     " .-+#%%#+-. ",
///     " .-+#%%#+-. ",
///     "  .:----:.  ",
///     "            ",
/// ]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn render<T: Real>(
    map: &GaussianMap<T>,
    camera: &Camera,
    camera_from_world: &Se3,
    options: &RenderOptions,
    par: Par,
) -> Result<Rendered<T>, RasterError> {
    check(map, camera, camera_from_world, options)?;
    let view = View::new(camera, camera_from_world);
    let splats = sort_front_to_back(project(map, &view, options.include, par));
    let tiles = Tiles::new(&splats, view.size, options.tile_px);
    let pixels_of_tile = par.map(tiles.len(), |t| {
        composite_tile(&splats, tiles.list(t), &tiles.rect(t))
    });
    let pixels = assemble(&tiles, &pixels_of_tile, view.size);

    let background = options.background.map(T::from_f64);
    let mut radii = vec![0; map.len()];
    for splat in &splats {
        radii[splat.index as usize] = splat.radius_px;
    }
    let rendered = Rendered {
        color: pixels.map(|p| [0, 1, 2].map(|k| p.color[k] + p.transmittance * background[k])),
        depth: pixels.map(|p| p.depth),
        opacity: pixels.map(|p| T::ONE - p.transmittance),
        transmittance: pixels.map(|p| p.transmittance),
        contributors: pixels.map(|p| p.contributors),
        last: pixels.map(|p| p.last),
        radii,
        projected: splats,
    };
    debug_assert_eq!(rendered.validate(), Ok(()), "what render promises");
    Ok(rendered)
}

/// Puts the tiles' pixels where they belong.
fn assemble<T: Real>(tiles: &Tiles, parts: &[Vec<Pixel<T>>], size: [usize; 2]) -> Image<Pixel<T>> {
    let mut picture = Image::new(size[0], size[1], Pixel::new());
    for (t, part) in parts.iter().enumerate() {
        let rect = tiles.rect(t);
        for (y, row) in (rect.y0..rect.y1).zip(part.chunks(rect.x1 - rect.x0)) {
            picture.row_mut(y)[rect.x0..rect.x1].copy_from_slice(row);
        }
    }
    picture
}

pub(crate) fn check<T: Real>(
    map: &GaussianMap<T>,
    camera: &Camera,
    camera_from_world: &Se3,
    options: &RenderOptions,
) -> Result<(), RasterError> {
    camera.validate()?;
    let (width, height) = (camera.width, camera.height);
    if width > MAX_SIDE_PX || height > MAX_SIDE_PX {
        return Err(RasterError::PictureSize { width, height });
    }
    if !camera_from_world.is_finite() {
        return Err(RasterError::PoseNotFinite);
    }
    for (channel, &value) in options.background.iter().enumerate() {
        if !T::from_f64(value).is_finite() {
            return Err(RasterError::BackgroundNotFinite { channel, value });
        }
    }
    if !(1..=MAX_SIDE_PX).contains(&options.tile_px) {
        let tile_px = options.tile_px;
        return Err(RasterError::TileSize { tile_px });
    }
    let n = map.len();
    let lengths = [
        ("log_scales", n, map.log_scales.len()),
        ("quaternions", n, map.quaternions.len()),
        ("opacity_logits", n, map.opacity_logits.len()),
        ("sh", n * map.coefficients(), map.sh.len()),
        ("label", n, map.label.len()),
    ];
    for (array, expected, got) in lengths {
        if got != expected {
            return Err(RasterError::MapLength {
                array,
                expected,
                got,
            });
        }
    }
    Ok(())
}
