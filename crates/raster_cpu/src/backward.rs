//! [`backward`]: from gradients on the images to gradients on the map and the pose.
//!
//! The backward pass of each step stands in the file of the step, below it; here they are joined.

use garad_core::{Camera, GaussianMap, Image, Par, Real, Se3};

use crate::bin::Tiles;
use crate::composite::{PixelGradient, composite_pixel_backward};
use crate::error::RasterError;
use crate::options::RenderOptions;
use crate::project::{RowGradient, project_one_backward};
use crate::rendered::{Rendered, Upstream};
use crate::scalar::dot;
use crate::splat_gradient::{SplatGradient, SplatSums};
use crate::validate::{check_images, check_scene, check_splats};
use crate::view::View;

/// Splats whose backward pass is one task.
const CHUNK: usize = 256;

/// ∂L/∂ of everything the image was made of. Row i belongs to Gaussian i of the map and is
/// zero where that Gaussian is invisible.
#[derive(Debug, Clone, PartialEq)]
pub struct Gradients<T> {
    /// By the mean, 1/m.
    pub means: Vec<[T; 3]>,
    /// By the log-scales.
    pub log_scales: Vec<[T; 3]>,
    /// By the quaternion as stored; orthogonal to it.
    pub quaternions: Vec<[T; 4]>,
    /// By the opacity logit.
    pub opacity_logits: Vec<T>,
    /// By the SH triples, as many per Gaussian as the map holds.
    pub sh: Vec<[T; 3]>,
    /// By ξ = (translation, rotation) of exp(ξ) * camera_from_world at 0: 1/m, 1/rad.
    pub pose: [T; 6],
    /// By the splat's centre, 1/px: what densification looks at.
    pub means2d: Vec<[T; 2]>,
    /// By (a, b, c) of the inverse covariance, px²; b stands for both entries off the diagonal.
    /// (The CUDA rasterizer stores half of the derivative by b.)
    pub conics: Vec<[T; 3]>,
    /// By the opacity.
    pub opacities: Vec<T>,
    /// By the splat's colour as it is blended, after the clamp at 0.
    pub colors: Vec<[T; 3]>,
    /// By the z that is blended into the depth image alone, 1/m.
    pub depths: Vec<T>,
}

impl<T: Real> Gradients<T> {
    /// Zero for `n` Gaussians of `coefficients` SH triples.
    pub(crate) fn zero(n: usize, coefficients: usize) -> Self {
        let o = T::ZERO;
        Self {
            means: vec![[o; 3]; n],
            log_scales: vec![[o; 3]; n],
            quaternions: vec![[o; 4]; n],
            opacity_logits: vec![o; n],
            sh: vec![[o; 3]; n * coefficients],
            pose: [o; 6],
            means2d: vec![[o; 2]; n],
            conics: vec![[o; 3]; n],
            opacities: vec![o; n],
            colors: vec![[o; 3]; n],
            depths: vec![o; n],
        }
    }

    /// Writes one Gaussian's row and adds its term to the pose.
    fn write(&mut self, i: usize, d: &SplatGradient<T>, row: &RowGradient<T>) {
        let k = self.sh.len() / self.means.len();
        self.means[i] = row.mean;
        self.log_scales[i] = row.log_scale;
        self.quaternions[i] = row.quaternion;
        self.opacity_logits[i] = row.opacity_logit;
        row.write_sh(&mut self.sh[i * k..(i + 1) * k]);
        for (sum, part) in self.pose.iter_mut().zip(row.pose) {
            *sum += part;
        }
        self.means2d[i] = d.mean_px;
        self.conics[i] = d.conic;
        self.opacities[i] = d.opacity;
        self.colors[i] = d.color;
        self.depths[i] = d.depth_m;
    }
}

/// The gradient of a scalar L of the images, by every parameter of every Gaussian and by the
/// pose.
///
/// `map`, `camera`, `camera_from_world` and `options` are those `rendered` was made with.
///
/// ```text
/// Upstream ─ composite_pixel_backward ─→ SplatSums ─ in tile order ─→ SplatGradient
///              R13, R14, per pixel                                       │
/// Gradients ←─────────────── project_one_backward, R15 to R20 ←──────────┘
/// ```
///
/// Source: the derivative of [`crate::render()`] by hand; Kerbl et al. 2023 for its outline.
/// Spec test: `every_parameter_against_differences`. Golden: `raster_backward/*`.
///
/// # Shapes and units
/// Images as in [`Rendered`]; rows as in the map.
/// # Numerics
/// Everything in `T`; the same bits for every `par`: a splat's sums run over the pixels of a tile
/// row by row, then over the tiles in their order. The image jumps where a splat crosses a
/// cut (1/255, 1e-4, its footprint, the order of depth): the gradient is that of the smooth
/// pieces. A NaN in `upstream` comes out as NaN.
/// # Errors
/// As [`crate::render()`]; [`RasterError::SizeMismatch`]; [`RasterError::NotThisMap`].
/// # Example
/// How much brighter one splat makes the image, by the logit of its opacity:
/// ```
/// use garad_core::{Camera, GaussianMap, Image, KeyframeId, NewGaussian, Par, Se3};
/// use garad_raster::{RenderOptions, Upstream, backward, render};
///
/// let mut map = GaussianMap::<f64>::new(0);
/// map.push(&NewGaussian {
///     mean: [0.0, 0.0, 2.0],
///     sigma_m: 0.2,
///     opacity: 0.5,
///     color: [1.0, 1.0, 1.0],
///     landmark: None,
///     born: KeyframeId(0),
/// });
/// let camera = Camera::pinhole((12, 6), [10.0, 10.0, 5.5, 2.5])?;
/// let (pose, options) = (Se3::default(), RenderOptions::default());
/// let image = render(&map, &camera, &pose, &options, Par::Seq)?;
/// // L = Σ red: one splat, so L = Σ alpha, and ∂alpha/∂logit = alpha (1 - opacity).
/// let red = Upstream { color: Image::new(12, 6, [1.0, 0.0, 0.0]), depth: None, opacity: None };
/// let gradients = backward(&map, &camera, &pose, &options, &image, &red, Par::Seq)?;
/// let total: f64 = image.opacity.data().iter().sum();
/// assert!((gradients.opacity_logits[0] - 0.5 * total).abs() < 1e-12);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn backward<T: Real>(
    map: &GaussianMap<T>,
    camera: &Camera,
    camera_from_world: &Se3,
    options: &RenderOptions,
    rendered: &Rendered<T>,
    upstream: &Upstream<T>,
    par: Par,
) -> Result<Gradients<T>, RasterError> {
    check_scene(map, camera, camera_from_world, options)?;
    check_images(camera, rendered, upstream)?;
    check_splats(map, camera, &rendered.projected)?;
    let view = View::new(camera, camera_from_world);
    let splats = &rendered.projected;
    let tiles = Tiles::new(splats, view.size, options.tile_px);
    let background = options.background.map(T::from_f64);
    let clamp = options.clamp_gradient;

    // Pixels to splats.
    let sums_of_tile = par.map(tiles.len(), |t| {
        let (list, rect) = (tiles.list(t), tiles.rect(t));
        let mut sums = vec![SplatSums::ZERO; list.len()];
        for y in rect.y0..rect.y1 {
            for x in rect.x0..rect.x1 {
                let pixel = pixel_gradient(rendered, upstream, background, (x, y));
                composite_pixel_backward(splats, list, [x, y], &pixel, clamp, &mut sums);
            }
        }
        sums
    });
    let mut sums = vec![SplatSums::ZERO; splats.len()];
    for (t, of_tile) in sums_of_tile.iter().enumerate() {
        for (&position, part) in tiles.list(t).iter().zip(of_tile) {
            sums[position as usize].add(part);
        }
    }

    // Splats to Gaussians.
    let rows = par.map_chunks(splats.len(), CHUNK, |range| {
        range
            .map(|position| {
                let splat = &splats[position];
                let d = SplatGradient::new(splat, &sums[position]);
                project_one_backward(map, &view, splat, &d, clamp)
                    .map(|row| (d, row))
                    .ok_or(RasterError::NotThisMap { splat: position })
            })
            .collect::<Result<Vec<_>, _>>()
    });
    let mut gradients = Gradients::zero(map.len(), map.coefficients());
    let mut splat = splats.iter();
    for chunk in rows {
        for ((d, row), splat) in chunk?.iter().zip(&mut splat) {
            gradients.write(splat.index as usize, d, row);
        }
    }
    Ok(gradients)
}

/// What the backward pass starts from at a pixel. color = … + T background and opacity = 1 - T, so
/// ∂L/∂T = ∂L/∂color · background - ∂L/∂opacity.
fn pixel_gradient<T: Real>(
    rendered: &Rendered<T>,
    upstream: &Upstream<T>,
    background: [T; 3],
    at: (usize, usize),
) -> PixelGradient<T> {
    let of = |image: &Option<Image<T>>| image.as_ref().map_or(T::ZERO, |p| p[at]);
    let d_color = upstream.color[at];
    PixelGradient {
        d_color,
        d_depth: of(&upstream.depth),
        d_transmittance: dot(d_color, background) - of(&upstream.opacity),
        transmittance: rendered.transmittance[at],
        last: rendered.last[at],
    }
}
