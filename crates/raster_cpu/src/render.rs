//! [`render`]: the whole forward pass.

use garad_core::{Camera, GaussianMap, Image, Par, Real, Se3};

use crate::bin::{Tiles, sort_front_to_back};
use crate::composite::{Pixel, composite_pixel};
use crate::error::RasterError;
use crate::options::RenderOptions;
use crate::project::project;
use crate::rendered::Rendered;
use crate::splat::Projected;
use crate::validate::check_scene;
use crate::view::View;

/// The visible splats of a map, front to back: [`render`] without its pixels.
///
/// # Errors
/// As [`render`].
pub fn splats<T: Real>(
    map: &GaussianMap<T>,
    camera: &Camera,
    camera_from_world: &Se3,
    options: &RenderOptions,
    par: Par,
) -> Result<Vec<Projected<T>>, RasterError> {
    check_scene(map, camera, camera_from_world, options)?;
    let view = View::new(camera, camera_from_world);
    Ok(sort_front_to_back(project(
        map,
        &view,
        options.include,
        par,
    )))
}

/// Draws a map as the camera at `camera_from_world` sees it.
///
/// A plain loop over the pixels: each blends the splats of its tile in order of depth, then of row
/// (`composite_pixel`), and gets T background on top (R11).
///
/// Source: paper eq. 15; Kerbl et al. 2023 and its rasterizer for the constants.
/// Spec test: `spec_render`. Golden: `raster/*`.
///
/// # Shapes and units
/// Images are `camera.height` x `camera.width`; `radii` has one entry per Gaussian. The camera
/// is taken as a pinhole: `distortion` is ignored, images to compare with are undistorted.
/// # Numerics
/// Everything in `T`; the same bits for every `par` and, `last` apart, every `tile_px`.
/// # Errors
/// [`RasterError`] for an invalid camera, pose, background, tile or image size, and for map arrays
/// of unequal length. A single bad Gaussian is invisible instead.
/// # Example
/// A wide splat in an image of 12 x 6, its opacity in ten shades:
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
/// let image = render(&map, &camera, &Se3::default(), &RenderOptions::default(), Par::Seq)?;
/// let shade = |opacity: &f64| b" .:-=+*#%@"[(opacity * 10.0) as usize] as char;
/// let rows: Vec<String> = (0..6).map(|y| image.opacity.row(y).iter().map(shade).collect()).collect();
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
    let splats = splats(map, camera, camera_from_world, options, par)?;
    let [width, height] = [camera.width, camera.height];
    let tiles = Tiles::new(&splats, [width, height], options.tile_px);
    let mut pixels = Image::new(width, height, Pixel::EMPTY);
    par.for_each_chunk_mut(pixels.data_mut(), width, |y, row| {
        for (x, pixel) in row.iter_mut().enumerate() {
            *pixel = composite_pixel(&splats, tiles.list(tiles.tile_of(x, y)), [x, y]);
        }
    });

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
    debug_assert_eq!(
        rendered.validate(),
        Ok(()),
        "the rendered images are consistent"
    );
    Ok(rendered)
}
