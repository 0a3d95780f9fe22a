//! [`gradient_scales`]: how precise each row of [`crate::backward()`] can be.
//!
//! A gradient is a sum over pixels, and what it cancels to says nothing about its rounding. So the same sums are
//! taken without signs, each term times its condition: by how many roundings of its own its relative error is multiplied.
//! Everything in f64, by first-order error analysis.

use garad_core::{Camera, GaussianMap, Par, Se3};

use crate::backward::Gradients;
use crate::bin::Tiles;
use crate::composite::{MAX_ALPHA, Sample, sample};
use crate::error::RasterError;
use crate::options::{ClampGradient, RenderOptions};
use crate::project::{camera_point, project_one_backward};
use crate::rendered::{Rendered, Upstream};
use crate::splat::Projected;
use crate::splat_gradient::{SplatGradient, SplatSums};
use crate::validate::{check_images, check_scene, check_splats};
use crate::view::View;

/// One number per row of a [`Gradients`], in the unit of the row: u times it bounds, up to a small factor, what
/// arithmetic with the unit roundoff u loses. 0 where no pixel is touched.
#[derive(Debug, Clone, PartialEq)]
#[allow(missing_docs, reason = "the names are those of `Gradients`")]
pub struct GradientScales {
    pub means: Vec<f64>,
    pub log_scales: Vec<f64>,
    pub quaternions: Vec<f64>,
    pub opacity_logits: Vec<f64>,
    pub sh: Vec<f64>,
    /// One per element.
    pub pose: [f64; 6],
    pub means2d: Vec<f64>,
    pub conics: Vec<f64>,
    pub opacities: Vec<f64>,
    pub colors: Vec<f64>,
    pub depths: Vec<f64>,
}

/// Numbers of a [`SplatSums`].
const SUMS: usize = 10;
/// Splats that are one task.
const CHUNK: usize = 256;

/// The condition of a splat's numbers, from its row of the map.
#[derive(Clone, Copy)]
struct Condition {
    /// Absolute error of the centre over u, pixels.
    center_px: [f64; 2],
    /// Relative error of the conic over u.
    conic: f64,
}

/// Roundings of a number that is a few operations away from its inputs.
const FEW: f64 = 4.0;

impl Condition {
    fn new(map: &GaussianMap<f64>, view: &View<f64>, splat: &Projected<f64>) -> Self {
        let mean = map.means[splat.index as usize];
        let [x, y, z] = camera_point(view, mean);
        // A coordinate in the camera is a sum of four terms.
        let size = |k: usize| {
            let terms = (0..3).map(|j| (view.rotation[k][j] * mean[j]).abs());
            terms.sum::<f64>() + view.translation[k].abs()
        };
        let of_depth = size(2) / z;
        let center = |k: usize, along: f64| {
            let focal = view.focal_px[k];
            focal * (size(k) + along.abs() * of_depth) / z + view.principal_px[k].abs()
        };
        Self {
            center_px: [center(0, x), center(1, y)],
            conic: FEW * (1.0 + of_depth),
        }
    }

    /// Relative error of alpha over u. The exponent may be a dx² + 2 b dx dy + c dy², whose terms cancel.
    fn alpha(&self, splat: &Projected<f64>, dx: f64, dy: f64) -> f64 {
        let [a, b, c] = splat.conic;
        let terms = 0.5 * a * dx * dx + (b * dx * dy).abs() + 0.5 * c * dy * dy;
        let slope = [(a * dx + b * dy).abs(), (b * dx + c * dy).abs()];
        let moved = slope[0] * self.center_px[0] + slope[1] * self.center_px[1];
        FEW + self.conic * terms + moved
    }
}

/// The scales of a gradient. The arguments are those of [`crate::backward()`].
///
/// # Numerics
/// The same bits for every `par`.
/// # Errors
/// As [`crate::backward()`].
pub fn gradient_scales(
    map: &GaussianMap<f64>,
    camera: &Camera,
    camera_from_world: &Se3,
    options: &RenderOptions,
    rendered: &Rendered<f64>,
    upstream: &Upstream<f64>,
    par: Par,
) -> Result<GradientScales, RasterError> {
    check_scene(map, camera, camera_from_world, options)?;
    check_images(camera, rendered, upstream)?;
    check_splats(map, camera, &rendered.projected)?;
    let view = View::new(camera, camera_from_world);
    let splats = &rendered.projected;
    let tiles = Tiles::new(splats, view.size, options.tile_px);
    let conditions: Vec<Condition> = splats
        .iter()
        .map(|splat| Condition::new(map, &view, splat))
        .collect();
    let pixel = |x: usize, y: usize| {
        let at = (x, y);
        let of = |image: &Option<garad_core::Image<f64>>| image.as_ref().map_or(0.0, |p| p[at]);
        let color = upstream.color[at].map(f64::abs);
        let background = [0, 1, 2].map(|k| color[k] * options.background[k].abs());
        Unsigned {
            color,
            depth: of(&upstream.depth).abs(),
            transmittance: background.iter().sum::<f64>() + of(&upstream.opacity).abs(),
            left: rendered.transmittance[at],
            last: rendered.last[at] as usize,
        }
    };
    let sums_of_tile = par.map(tiles.len(), |t| {
        let (list, rect) = (tiles.list(t), tiles.rect(t));
        let mut sums = vec![[0.0; SUMS]; list.len()];
        for y in rect.y0..rect.y1 {
            for x in rect.x0..rect.x1 {
                let list = &list[..pixel(x, y).last.min(list.len())];
                add_pixel(
                    splats,
                    &conditions,
                    list,
                    [x, y],
                    &pixel(x, y),
                    options.clamp_gradient,
                    &mut sums,
                );
            }
        }
        sums
    });
    let mut sums = vec![[0.0; SUMS]; splats.len()];
    for (t, of_tile) in sums_of_tile.iter().enumerate() {
        for (&position, part) in tiles.list(t).iter().zip(of_tile) {
            let sums = &mut sums[position as usize];
            sums.iter_mut().zip(part).for_each(|(sum, v)| *sum += v);
        }
    }
    let rows = par.map_chunks(splats.len(), CHUNK, |range| {
        range
            .map(|p| row(map, &view, &splats[p], &sums[p], options.clamp_gradient))
            .collect::<Vec<_>>()
    });
    let zero = || vec![0.0; map.len()];
    let mut scales = GradientScales {
        means: zero(),
        log_scales: zero(),
        quaternions: zero(),
        opacity_logits: zero(),
        sh: zero(),
        pose: [0.0; 6],
        means2d: zero(),
        conics: zero(),
        opacities: zero(),
        colors: zero(),
        depths: zero(),
    };
    for (splat, (row, pose)) in splats.iter().zip(rows.into_iter().flatten()) {
        let i = splat.index as usize;
        let all = [
            &mut scales.means,
            &mut scales.log_scales,
            &mut scales.quaternions,
            &mut scales.opacity_logits,
            &mut scales.sh,
            &mut scales.means2d,
            &mut scales.conics,
            &mut scales.opacities,
            &mut scales.colors,
            &mut scales.depths,
        ];
        for (column, value) in all.into_iter().zip(row) {
            column[i] = value;
        }
        scales
            .pose
            .iter_mut()
            .zip(pose)
            .for_each(|(sum, v)| *sum += v);
    }
    Ok(scales)
}

/// What the backward pass of a pixel starts from, without signs.
struct Unsigned {
    color: [f64; 3],
    depth: f64,
    transmittance: f64,
    /// Transmittance at the end.
    left: f64,
    last: usize,
}

/// As `composite_pixel_backward`, with terms that are not negative, times their condition.
fn add_pixel(
    splats: &[Projected<f64>],
    conditions: &[Condition],
    list: &[u32],
    [x, y]: [usize; 2],
    pixel: &Unsigned,
    clamp: ClampGradient,
    sums: &mut [[f64; SUMS]],
) {
    // T is a product of 1 - alpha, each of which multiplies the error of its alpha.
    let mut of_light = 0.0;
    let drawn = |&position: &u32| {
        let position = position as usize;
        sample(&splats[position], [x, y]).map(|s| (position, s))
    };
    for (position, Sample { dx, dy, alpha, .. }) in list.iter().filter_map(drawn) {
        let own = conditions[position].alpha(&splats[position], dx, dy);
        of_light += alpha / (1.0 - alpha) * own + 1.0;
    }
    let (mut light, mut behind) = (pixel.left, pixel.transmittance);
    for (entry, &position) in list.iter().enumerate().rev() {
        let position = position as usize;
        let splat = &splats[position];
        let Some(Sample {
            dx,
            dy,
            density,
            alpha,
        }) = sample(splat, [x, y])
        else {
            continue;
        };
        let condition = of_light + conditions[position].alpha(splat, dx, dy);
        let sums = &mut sums[entry];
        light /= 1.0 - alpha;
        let weight = alpha * light * condition;
        let mut own = pixel.depth * splat.depth_m;
        for k in 0..3 {
            own += pixel.color[k] * splat.color[k];
            sums[6 + k] += weight * pixel.color[k];
        }
        sums[9] += weight * pixel.depth;
        let d_alpha = light * (own + behind);
        behind = alpha * own + (1.0 - alpha) * behind;
        if density > MAX_ALPHA && clamp == ClampGradient::True {
            continue;
        }
        let g = density * d_alpha * condition;
        let r = (dx + splat.shear * dy).abs();
        let dy = dy.abs();
        // The centre's error moves r and dy as well.
        let [px, py] = conditions[position].center_px;
        let (r, dy) = (
            r + (px + splat.shear.abs() * py) / condition,
            dy + py / condition,
        );
        for (sum, factor) in sums.iter_mut().zip([1.0, r, dy, r * r, r * dy, dy * dy]) {
            *sum += g * factor;
        }
    }
}

/// The largest of each row of parameters, and the pose's: |∂row/∂sum| times the sum, over all sums.
fn row(
    map: &GaussianMap<f64>,
    view: &View<f64>,
    splat: &Projected<f64>,
    sums: &[f64; SUMS],
    clamp: ClampGradient,
) -> ([f64; 10], [f64; 6]) {
    let mut total = Gradients::<f64>::zero(1, garad_core::sh::MAX_COEFFICIENTS);
    for (k, &size) in sums.iter().enumerate().filter(|(_, size)| **size > 0.0) {
        let mut unit = [0.0; SUMS];
        unit[k] = size;
        let [g, r, y, rr, ry, yy, c0, c1, c2, depth] = unit;
        let color = [c0, c1, c2];
        let one = SplatSums {
            g,
            r,
            y,
            rr,
            ry,
            yy,
            color,
            depth,
        };
        let d = SplatGradient::new(splat, &one);
        let Some(row) = project_one_backward(map, view, splat, &d, clamp) else {
            continue;
        };
        let add = |sum: &mut f64, v: f64| *sum += v.abs();
        let lists: [(&mut [f64], &[f64]); 10] = [
            (&mut total.means[0], &row.mean),
            (&mut total.log_scales[0], &row.log_scale),
            (&mut total.quaternions[0], &row.quaternion),
            (&mut total.opacity_logits, &[row.opacity_logit]),
            (&mut total.pose, &row.pose),
            (&mut total.means2d[0], &d.mean_px),
            (&mut total.conics[0], &d.conic),
            (&mut total.opacities, &[d.opacity]),
            (&mut total.colors[0], &d.color),
            (&mut total.depths, &[d.depth_m]),
        ];
        for (sums, values) in lists {
            sums.iter_mut()
                .zip(values)
                .for_each(|(sum, v)| add(sum, *v));
        }
        for (sum, basis) in total.sh.iter_mut().zip(&row.basis[..map.coefficients()]) {
            for (sum, g) in sum.iter_mut().zip(&row.color) {
                add(sum, basis * g);
            }
        }
    }
    let largest = |values: &[f64]| values.iter().fold(0.0, |a: f64, v| a.max(*v));
    let sh: Vec<f64> = total.sh.iter().flatten().copied().collect();
    let rows = [
        largest(&total.means[0]),
        largest(&total.log_scales[0]),
        largest(&total.quaternions[0]),
        total.opacity_logits[0],
        largest(&sh),
        largest(&total.means2d[0]),
        largest(&total.conics[0]),
        total.opacities[0],
        largest(&total.colors[0]),
        total.depths[0],
    ];
    (rows, total.pose)
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::{Image, KeyframeId, NewGaussian};

    /// By the logit of one splat: Σ alpha (1 - opacity) in red, where a sign that changes from pixel to pixel cancels and
    /// the scale does not, and each term counts FEW roundings at least.
    #[test]
    fn a_scale_is_the_sum_without_signs() {
        let mut map = GaussianMap::<f64>::new(0);
        map.push(&NewGaussian {
            mean: [0.03, -0.02, 2.0],
            sigma_m: 0.2,
            opacity: 0.5,
            color: [1.0, 0.0, 0.0],
            landmark: None,
            born: KeyframeId(0),
        });
        let camera = Camera::pinhole((12, 6), [10.0, 11.0, 5.5, 2.5]).unwrap();
        let (pose, options) = (Se3::default(), RenderOptions::default());
        let image = crate::render(&map, &camera, &pose, &options, Par::Seq).unwrap();
        let scales = |sign: fn(usize, usize) -> f64| {
            let color = Image::from_fn(12, 6, |x, y| [sign(x, y), 0.0, 0.0]);
            let up = Upstream {
                color,
                depth: None,
                opacity: None,
            };
            gradient_scales(&map, &camera, &pose, &options, &image, &up, Par::new(2)).unwrap()
        };
        let plain = scales(|_, _| 1.0);
        let mixed = scales(|x, y| if (x + y) % 2 == 0 { 1.0 } else { -1.0 });
        assert_eq!(plain, mixed, "signs");
        let total: f64 = image.opacity.data().iter().sum();
        let exact = 0.5 * total;
        let scale = plain.opacity_logits[0];
        assert!(
            scale > FEW * exact && scale < 1000.0 * exact,
            "{scale} of {exact}"
        );
        assert!(
            (plain.opacities[0] - scale / 0.25).abs() < 1e-9 * scale,
            "by the opacity"
        );
        assert!(plain.pose.iter().all(|v| v.is_finite()), "{:?}", plain.pose);
        assert_eq!(plain.depths, [0.0], "no gradient by depth");
    }
}
