//! [`coverage()`]: how much of each pixel a map covers, and how far away, without its colour.

use garad_core::{Camera, GaussianMap, Image, Par, Se3};

use super::bin::Bands;
use super::tiles::{TILE_PX, blend_band, can_serve, put, rows_of, splats_sorted};
use crate::error::RasterError;
use crate::options::RenderOptions;
use crate::validate::check_scene;
use crate::view::View;

/// Two images of a [`crate::Rendered`].
#[derive(Debug, Clone, PartialEq)]
pub struct Coverage {
    /// Σ w = 1 - T.
    pub opacity: Image<f32>,
    /// Σ w z, metres: the expected depth times the opacity.
    pub depth: Image<f32>,
}

/// Opacity and depth of [`render()`](super::render) with the default options, bit for bit, in less time: no other
/// image is made.
///
/// # Numerics
/// As [`render()`](super::render). Spec test: `coverage_is_two_images_of_the_render`.
/// # Errors
/// As [`crate::render()`].
pub fn coverage(
    map: &GaussianMap<f32>,
    camera: &Camera,
    camera_from_world: &Se3,
    par: Par,
) -> Result<Coverage, RasterError> {
    let options = RenderOptions::default();
    if !can_serve(map, &options) {
        let rendered = crate::render(map, camera, camera_from_world, &options, par)?;
        return Ok(Coverage {
            opacity: rendered.opacity,
            depth: rendered.depth,
        });
    }
    check_scene(map, camera, camera_from_world, &options)?;
    let view = View::new(camera, camera_from_world);
    let splats = splats_sorted(map, &view, options.include, par);
    let [width, height] = view.size;
    let bands = Bands::new(&splats, height.div_ceil(TILE_PX));
    let mut opacity = Image::new(width, height, 0.0);
    let mut depth = Image::new(width, height, 0.0);
    let n = width * TILE_PX;
    let opacities = opacity.data_mut().chunks_mut(n);
    let mut stripes: Vec<_> = opacities.zip(depth.data_mut().chunks_mut(n)).collect();
    par.for_each_chunk_mut(&mut stripes, 1, |band, stripe| {
        for (opacity, depth) in stripe {
            let size = [width, opacity.len() / width];
            blend_band::<false>(&splats, bands.list(band), band, size, |pixels, x0| {
                for (i, block) in pixels.blocks.iter().enumerate() {
                    let covered = block.transmittance.map(|t| 1.0 - t.abs());
                    for (at, half) in rows_of(i, x0, size) {
                        put(&mut opacity[at.clone()], &covered[half..]);
                        put(&mut depth[at], &block.depth[half..]);
                    }
                }
            });
        }
    });
    Ok(Coverage { opacity, depth })
}
