//! The fast rasterizer: [`render()`] and [`backward()`] in f32, eight pixels at a time.
//!
//! Same signatures as [`crate::render()`] and [`crate::backward()`], which say what is computed;
//! here is only how. The splats are the reference's, bit for bit. Every pixel meets them in the
//! same order; alpha is computed in powers of two and differs in the last bits.
//!
//! ```text
//! depth keys ─ radix sort ─→ project ─→ Splat, 1 cache line ─→ Bands ─→ TilePixels ─→ images
//!   fast/bin                              fast/splat             bin   tiles, forward, lanes
//! ```
//!
//! What makes it fast: the ellipse outside which alpha < 1/255 is solved for all rows of a tile
//! at once and leaves a bit mask of blocks of 4 x 2 pixels to visit; branches are masks; a row of tiles is
//! binned, blended and written by one task, straight into its stripe of every image.

mod backward;
mod bin;
mod coverage;
mod forward;
mod gather;
mod lanes;
mod splat;
mod tiles;

use std::array::from_fn;
use std::slice::ChunksMut;

use garad_core::{Camera, GaussianMap, Image, Par, Real, Se3};

use self::backward::{Rows, Sums, TileBackward};
use self::bin::{Bands, Columns, Entry};
pub use self::coverage::{Coverage, coverage};
use self::forward::TilePixels;
use self::splat::{Splat, prepare};
use self::tiles::{TILE_PX, blend_band, can_serve, project_sorted, put, rows_of};
use crate::backward::Gradients;
use crate::error::RasterError;
use crate::options::RenderOptions;
use crate::rendered::{Rendered, Upstream};
use crate::validate::{check_images, check_scene, check_splats};
use crate::view::View;

/// [`crate::render()`] in a fraction of the time.
///
/// Formulas, shapes and units are those of the reference. Spec test: `fast_is_the_reference`.
///
/// # Numerics
/// f32; the same bits for every `par`, with and without AVX. Splats and radii are the reference's,
/// bit for bit. Against the reference in f64 images are as close as the reference in f32 is, but
/// where an alpha or a transmittance is within about 3e-7 of a cut (R10, R11): there a splat of
/// weight up to 0.01 may be blended by one and not by the other. Any `tile_px` but 16 is handed
/// to the reference.
/// # Errors
/// As [`crate::render()`].
/// # Example
/// ```
/// use garad_core::{Camera, GaussianMap, KeyframeId, NewGaussian, Par, Se3};
/// use garad_raster::{RenderOptions, fast, render};
///
/// let mut map = GaussianMap::<f32>::new(0);
/// map.push(&NewGaussian {
///     mean: [0.0, 0.0, 2.0],
///     sigma_m: 0.2,
///     opacity: 0.95,
///     color: [1.0, 0.5, 0.0],
///     landmark: None,
///     born: KeyframeId(0),
/// });
/// let camera = Camera::pinhole((40, 30), [30.0, 30.0, 19.5, 14.5])?;
/// let (pose, options) = (Se3::default(), RenderOptions::default());
/// let reference = render(&map, &camera, &pose, &options, Par::Seq)?;
/// let image = fast::render(&map, &camera, &pose, &options, Par::Threads(2))?;
/// assert_eq!(image.projected, reference.projected);
/// assert!((image.depth[(20, 15)] - reference.depth[(20, 15)]).abs() < 1e-6);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn render(
    map: &GaussianMap<f32>,
    camera: &Camera,
    camera_from_world: &Se3,
    options: &RenderOptions,
    par: Par,
) -> Result<Rendered<f32>, RasterError> {
    if !can_serve(map, options) {
        return crate::render(map, camera, camera_from_world, options, par);
    }
    check_scene(map, camera, camera_from_world, options)?;
    let view = View::new(camera, camera_from_world);
    let (projected, splats) = project_sorted(map, &view, options.include, par);
    let [width, height] = view.size;
    let bands = Bands::new(&splats, height.div_ceil(TILE_PX));
    let background = options.background.map(f32::from_f64);

    // As no splat leaves them: tiles without one are not written again.
    let mut rendered = Rendered {
        color: Image::new(width, height, background),
        depth: Image::new(width, height, 0.0),
        opacity: Image::new(width, height, 0.0),
        transmittance: Image::new(width, height, 1.0),
        contributors: Image::new(width, height, 0),
        last: Image::new(width, height, 0),
        radii: vec![0; map.len()],
        projected: Vec::new(),
    };
    let mut stripes = Stripe::cut(&mut rendered, width);
    par.for_each_chunk_mut(&mut stripes, 1, |band, stripe| {
        for stripe in stripe {
            stripe.draw(&splats, bands.list(band), band, background);
        }
    });
    for splat in &projected {
        rendered.radii[splat.index as usize] = splat.radius_px;
    }
    rendered.projected = projected;
    debug_assert_eq!(
        rendered.validate(),
        Ok(()),
        "the rendered images are consistent"
    );
    Ok(rendered)
}

/// [`crate::backward()`] in a fraction of the time.
///
/// Formulas, shapes and units are those of the reference. Spec test:
/// `fast_gradients_are_those_of_the_reference`.
///
/// # Numerics
/// f32. Per pixel the reference's formulas in its order; a splat's sums over pixels are added
/// lane by lane (a lane is one place in blocks of 4 x 2, blocks down the columns), lanes as
/// ((0 + 4) + (1 + 5)) + ((2 + 6) + (3 + 7)), tiles from left to right, rows of tiles from the
/// top. The pose is added in f64 over runs of 512 rows of the map. The same bits for every `par`,
/// with and without AVX; not those of the reference, whose sums run pixel by pixel.
/// # Errors
/// As [`crate::backward()`].
pub fn backward(
    map: &GaussianMap<f32>,
    camera: &Camera,
    camera_from_world: &Se3,
    options: &RenderOptions,
    rendered: &Rendered<f32>,
    upstream: &Upstream<f32>,
    par: Par,
) -> Result<Gradients<f32>, RasterError> {
    if !can_serve(map, options) {
        let pose = camera_from_world;
        return crate::backward(map, camera, pose, options, rendered, upstream, par);
    }
    check_scene(map, camera, camera_from_world, options)?;
    check_images(camera, rendered, upstream)?;
    check_splats(map, camera, &rendered.projected)?;
    let view = View::new(camera, camera_from_world);
    let [width, height] = view.size;
    let splats = prepare(&rendered.projected, par);
    let bands = Bands::new(&splats, height.div_ceil(TILE_PX));
    let background = options.background.map(f32::from_f64);

    let mut sums = vec![Sums::default(); bands.len()];
    let mut of_band = bands.cut(&mut sums);
    par.for_each_chunk_mut(&mut of_band, 1, |band, of_band| {
        let list = bands.list(band);
        let columns = Columns::new(&splats, list, width.div_ceil(TILE_PX));
        let sums = &mut *of_band[0];
        for column in 0..width.div_ceil(TILE_PX) {
            let places = columns.list(column);
            let (x0, y0) = (column * TILE_PX, band * TILE_PX);
            let rows = (y0..(y0 + TILE_PX).min(height)).map(|y| {
                let row = y * width + x0..(y + 1) * width;
                Rows {
                    d_color: &upstream.color.data()[row.clone()],
                    d_depth: upstream.depth.as_ref().map(|d| &d.data()[row.clone()]),
                    d_opacity: upstream.opacity.as_ref().map(|d| &d.data()[row.clone()]),
                    transmittance: &rendered.transmittance.data()[row.clone()],
                    last: &rendered.last.data()[row],
                    background,
                }
            });
            let rows: Vec<Rows> = rows.collect();
            TileBackward::new(&rows).accumulate(
                places.len(),
                |entry| &columns.splats[places[entry] as usize],
                [x0 as f32, y0 as f32],
                options.clamp_gradient,
                |entry, part| sums[places[entry] as usize].add(part),
            );
        }
    });
    let total = gather::over_bands(&splats, &bands, &sums, par);
    // Room for the gradients.
    drop((splats, bands, sums));
    let clamp = options.clamp_gradient;
    gather::to_map(map, &view, &rendered.projected, &total, clamp, par)
}

/// One row of tiles in every image.
#[derive(Debug)]
struct Stripe<'a> {
    width: usize,
    color: &'a mut [[f32; 3]],
    depth: &'a mut [f32],
    opacity: &'a mut [f32],
    transmittance: &'a mut [f32],
    contributors: &'a mut [u32],
    last: &'a mut [u32],
}

impl<'a> Stripe<'a> {
    /// Every image cut below each row of tiles.
    fn cut(rendered: &'a mut Rendered<f32>, width: usize) -> Vec<Self> {
        fn next<'b, A>(rows: &mut ChunksMut<'b, A>) -> &'b mut [A] {
            rows.next().expect("all images are of one size")
        }
        let n = width * TILE_PX;
        let mut depth = rendered.depth.data_mut().chunks_mut(n);
        let mut opacity = rendered.opacity.data_mut().chunks_mut(n);
        let mut transmittance = rendered.transmittance.data_mut().chunks_mut(n);
        let mut contributors = rendered.contributors.data_mut().chunks_mut(n);
        let mut last = rendered.last.data_mut().chunks_mut(n);
        let colors = rendered.color.data_mut().chunks_mut(n);
        let stripes = colors.map(|color| Self {
            width,
            color,
            depth: next(&mut depth),
            opacity: next(&mut opacity),
            transmittance: next(&mut transmittance),
            contributors: next(&mut contributors),
            last: next(&mut last),
        });
        stripes.collect()
    }

    /// Bins, blends and writes the band's tiles that have splats.
    fn draw(&mut self, splats: &[Splat], list: &[Entry], band: usize, background: [f32; 3]) {
        let size = [self.width, self.color.len() / self.width];
        blend_band::<true>(splats, list, band, size, |pixels, x0| {
            self.write(pixels, x0, background);
        });
    }

    fn write(&mut self, pixels: &TilePixels, x0: usize, background: [f32; 3]) {
        let size = [self.width, self.color.len() / self.width];
        for (i, block) in pixels.blocks.iter().enumerate() {
            let t = block.transmittance.map(f32::abs);
            let light = |k: usize| from_fn(|lane| block.color[k][lane] + t[lane] * background[k]);
            let color: [[f32; 8]; 3] = [light(0), light(1), light(2)];
            let opacity = t.map(|t| 1.0 - t);
            let [contributors, last] = [block.contributors, block.last].map(|v| v.map(whole));
            for (at, half) in rows_of(i, x0, size) {
                put(&mut self.transmittance[at.clone()], &t[half..]);
                put(&mut self.opacity[at.clone()], &opacity[half..]);
                put(&mut self.depth[at.clone()], &block.depth[half..]);
                put(&mut self.contributors[at.clone()], &contributors[half..]);
                put(&mut self.last[at.clone()], &last[half..]);
                let rgb = |lane: usize| [0, 1, 2].map(|k| color[k][half + lane]);
                put(&mut self.color[at], &[rgb(0), rgb(1), rgb(2), rgb(3)]);
            }
        }
    }
}

/// A whole number below 2²⁴.
#[inline(always)]
#[allow(
    clippy::cast_possible_truncation,
    reason = "whole and below 2²⁴; a conversion to 32 bits with a sign is one instruction"
)]
fn whole(value: f32) -> u32 {
    (value as i32).cast_unsigned()
}
