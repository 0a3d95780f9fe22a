//! [`backward`]: from gradients on the picture to gradients on the map and the pose.
//!
//! Each step's way back stands in the file of the step, below it; here they are only joined.

use garad_core::{Camera, GaussianMap, Image, Par, Real, Se3};

use crate::bin::Tiles;
use crate::composite::{PixelBackward, SplatGradient, SplatSums, composite_tile_backward};
use crate::error::RasterError;
use crate::project::{Projected, RowGradient, project_one_backward};
use crate::render::{RenderOptions, Rendered, check};
use crate::view::View;

/// Splats taken back to their Gaussians by one task.
const CHUNK: usize = 256;

/// What passes back through a clamp that is active.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ClampGradient {
    /// Nothing: the derivative of the picture as it is.
    #[default]
    True,
    /// As the CUDA rasterizer of 3D Gaussian Splatting: alpha = min(0.99, ·) passes as if it were
    /// not there, so that saturated splats still learn, and the clamp in the Jacobian holds
    /// s z instead of s while z moves. A clamped colour passes nothing there either.
    PassThrough,
}

/// ∂L/∂ of the pictures that [`crate::render()`] returns. A picture that is not there is zero.
#[derive(Debug, Clone, PartialEq)]
pub struct Upstream<T> {
    /// By [`Rendered::color`].
    pub color: Image<[T; 3]>,
    /// By [`Rendered::depth`] (Σ w z, not divided by the opacity), 1/m.
    pub depth: Option<Image<T>>,
    /// By [`Rendered::opacity`].
    pub opacity: Option<Image<T>>,
}

/// ∂L/∂ of everything the picture was made of. Row i belongs to Gaussian i of the map and is
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
    /// By the z that is blended into the depth picture alone, 1/m.
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

    /// Writes one Gaussian's row and adds its share to the pose.
    fn put(&mut self, i: usize, d: &SplatGradient<T>, row: &RowGradient<T>) {
        let k = self.sh.len() / self.means.len();
        self.means[i] = row.mean;
        self.log_scales[i] = row.log_scale;
        self.quaternions[i] = row.quaternion;
        self.opacity_logits[i] = row.opacity_logit;
        row.put_sh(&mut self.sh[i * k..(i + 1) * k]);
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

/// The gradient of a scalar L of the pictures, by every parameter of every Gaussian and by the
/// pose.
///
/// `map`, `camera`, `camera_from_world` and `options` are those `rendered` was made with.
///
/// ```text
/// Upstream ─ composite_tile_backward ─→ SplatSums ─ in tile order ─→ SplatGradient
///              R13, R14, per tile                                        │
/// Gradients ←─────────────── project_one_backward, R15 to R20 ←──────────┘
/// ```
///
/// Source: the derivative of [`crate::render()`] by hand; Kerbl et al. 2023 for the plan.
/// Spec test: `every_parameter_against_differences`. Golden: `raster_backward/*`.
///
/// # Shapes and units
/// Pictures as in [`Rendered`]; rows as in the map.
/// # Numerics
/// Everything in `T`; the same bits for every `par`. The picture jumps where a splat crosses a
/// cut (1/255, 1e-4, its footprint, the order of depth): the gradient is that of the smooth
/// pieces. A NaN in `upstream` comes out as NaN.
/// # Errors
/// As [`crate::render()`]; [`RasterError::SizeMismatch`]; [`RasterError::NotThisMap`].
/// # Example
/// How much brighter one splat makes the picture, by the logit of its opacity:
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
/// let picture = render(&map, &camera, &pose, &options, Par::Seq)?;
/// // L = Σ red: one splat, so L = Σ alpha, and ∂alpha/∂logit = alpha (1 - opacity).
/// let red = Upstream { color: Image::new(12, 6, [1.0, 0.0, 0.0]), depth: None, opacity: None };
/// let gradients = backward(&map, &camera, &pose, &options, &picture, &red, Par::Seq)?;
/// let total: f64 = picture.opacity.data().iter().sum();
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
    check(map, camera, camera_from_world, options)?;
    check_pictures(camera, rendered, upstream)?;
    check_splats(map, camera, &rendered.projected)?;
    let view = View::new(camera, camera_from_world);
    let splats = &rendered.projected;
    let tiles = Tiles::new(splats, view.size, options.tile_px);
    let background = options.background.map(T::from_f64);

    // Pixels to splats. A splat's share of each tile is added in the order of tiles.
    let sums_of_tile = par.map(tiles.len(), |t| {
        let mut pixels = Vec::new();
        let rect = tiles.rect(t);
        for y in rect.y0..rect.y1 {
            for x in rect.x0..rect.x1 {
                pixels.push(pixel(rendered, upstream, background, (x, y)));
            }
        }
        composite_tile_backward(
            splats,
            tiles.list(t),
            &rect,
            &mut pixels,
            options.clamp_gradient,
        )
    });
    let mut sums = vec![SplatSums::new(); splats.len()];
    for (t, part) in sums_of_tile.iter().enumerate() {
        for (&position, share) in tiles.list(t).iter().zip(part) {
            sums[position as usize].add(share);
        }
    }

    // Splats to Gaussians.
    let rows = par.map_chunks(splats.len(), CHUNK, |range| {
        range
            .map(|position| {
                let splat = &splats[position];
                let d = SplatGradient::new(splat, &sums[position]);
                project_one_backward(map, &view, splat, &d, options.clamp_gradient)
                    .map(|row| (d, row))
                    .ok_or(RasterError::NotThisMap { splat: position })
            })
            .collect::<Result<Vec<_>, _>>()
    });
    let mut gradients = Gradients::zero(map.len(), map.coefficients());
    let mut splat = splats.iter();
    for chunk in rows {
        for ((d, row), splat) in chunk?.iter().zip(&mut splat) {
            gradients.put(splat.index as usize, d, row);
        }
    }
    Ok(gradients)
}

/// What the way back starts with at a pixel. color = … + T background and opacity = 1 - T, so
/// ∂L/∂T = ∂L/∂color · background - ∂L/∂opacity.
pub(crate) fn pixel<T: Real>(
    rendered: &Rendered<T>,
    upstream: &Upstream<T>,
    background: [T; 3],
    at: (usize, usize),
) -> PixelBackward<T> {
    let of = |picture: &Option<Image<T>>| picture.as_ref().map_or(T::ZERO, |p| p[at]);
    let d_color = upstream.color[at];
    PixelBackward {
        d_color,
        d_depth: of(&upstream.depth),
        transmittance: rendered.transmittance[at],
        behind: d_color[0] * background[0]
            + d_color[1] * background[1]
            + d_color[2] * background[2]
            - of(&upstream.opacity),
        last: rendered.last[at],
    }
}

pub(crate) fn check_pictures<T: Real>(
    camera: &Camera,
    rendered: &Rendered<T>,
    upstream: &Upstream<T>,
) -> Result<(), RasterError> {
    let expected = (camera.width, camera.height);
    let size = |p: &Option<Image<T>>| p.as_ref().map_or(expected, Image::size);
    let pictures = [
        ("rendered.transmittance", rendered.transmittance.size()),
        ("rendered.last", rendered.last.size()),
        ("upstream.color", upstream.color.size()),
        ("upstream.depth", size(&upstream.depth)),
        ("upstream.opacity", size(&upstream.opacity)),
    ];
    for (picture, got) in pictures {
        if got != expected {
            return Err(RasterError::SizeMismatch {
                picture,
                expected,
                got,
            });
        }
    }
    Ok(())
}

/// Every splat names a row of the map and lies in the picture.
pub(crate) fn check_splats<T: Real>(
    map: &GaussianMap<T>,
    camera: &Camera,
    splats: &[Projected<T>],
) -> Result<(), RasterError> {
    let fits = |s: &Projected<T>| {
        let f = &s.footprint;
        (s.index as usize) < map.len()
            && !f.is_empty()
            && f.x1 <= camera.width
            && f.y1 <= camera.height
    };
    match splats.iter().position(|s| !fits(s)) {
        Some(splat) => Err(RasterError::NotThisMap { splat }),
        None => Ok(()),
    }
}
