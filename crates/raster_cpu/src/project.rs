//! One Gaussian becomes one splat, [`Projected`] (R1 to R7), and the backward pass (R15 to R20).

use garad_core::{GaussianMap, Label, Par, Real, sh};

use crate::color::{color, color_backward};
use crate::covariance::{
    Covariance2, covariance, covariance_backward, half_axes, half_axes_backward, pixel_from_world,
    pixel_from_world_backward, rotation, rotation_backward,
};
use crate::options::{ClampGradient, Include};
use crate::scalar::{column, cross, dot, saturate, sigmoid, three, to_index, two};
use crate::splat::{PixelRect, Projected};
use crate::splat_gradient::SplatGradient;
use crate::view::View;

/// Gaussians at this distance along z or nearer are not drawn, metres: the projection is
/// singular at 0. Source: 3D Gaussian Splatting.
pub const NEAR_M: f64 = 0.2;

/// Side of the cells that a footprint is rounded out to, pixels (R6). This is the tile of the
/// CUDA rasterizer and part of the image's definition; [`crate::RenderOptions::tile_px`] is
/// how work is cut and does not change the image.
pub const FOOTPRINT_CELL_PX: usize = 16;

/// Gaussians projected by one task.
const CHUNK: usize = 512;

/// The visible splats of a map, in map order.
///
/// # Numerics
/// Each splat depends on its own row alone: the same bits for every `Par`.
pub(crate) fn project<T: Real>(
    map: &GaussianMap<T>,
    view: &View<T>,
    include: Include,
    par: Par,
) -> Vec<Projected<T>> {
    par.map_chunks(map.len(), CHUNK, |range| {
        project_range(map, view, include, range).collect::<Vec<_>>()
    })
    .concat()
}

/// The visible splats of some rows, in their order.
pub(crate) fn project_range<T: Real>(
    map: &GaussianMap<T>,
    view: &View<T>,
    include: Include,
    rows: std::ops::Range<usize>,
) -> impl Iterator<Item = Projected<T>> {
    rows.filter(move |&i| match include {
        Include::All => true,
        Include::StaticOnly => map.label[i] == Label::Static,
        Include::DynamicOnly => map.label[i] == Label::Dynamic,
    })
    .filter_map(|i| project_one(map, i, view))
}

/// One Gaussian, in the order of the formulas.
#[inline]
fn project_one<T: Real>(map: &GaussianMap<T>, i: usize, view: &View<T>) -> Option<Projected<T>> {
    // R1: p = R mean + t, (u, v) = (fx x/z + cx, fy y/z + cy).
    let p_cam = camera_point(view, map.means[i]);
    let [x, y, z] = p_cam;
    // A finite square leaves room for every product of the backward pass.
    if !(z * z).is_finite() || z <= T::from_f64(NEAR_M) {
        return None;
    }
    let mean_px = [
        view.focal_px[0] * (x / z) + view.principal_px[0],
        view.focal_px[1] * (y / z) + view.principal_px[1],
    ];

    // R2 to R5: the covariance in the image.
    let sigma_m = three(|k| map.log_scales[i][k].exp());
    let m = half_axes(
        &pixel_from_world(view, p_cam),
        &rotation(map.quaternions[i])?,
        sigma_m,
    );
    let cov = covariance(&m);

    // R6: the pixels it may touch.
    let radius = radius(&cov);
    if !(cov.det.is_finite() && radius.is_finite() && mean_px.iter().all(|v| v.is_finite())) {
        return None;
    }
    let footprint = footprint(mean_px, radius, view.size);
    if footprint.is_empty() {
        return None;
    }

    // R9, R7: opacity and colour.
    let opacity = sigmoid(map.opacity_logits[i]);
    if !opacity.is_finite() {
        return None;
    }
    Some(Projected {
        index: u32::try_from(i).expect("fewer than 2³² Gaussians"),
        mean_px,
        depth_m: z,
        conic: [cov.yy / cov.det, -cov.xy / cov.det, cov.xx / cov.det],
        shear: -cov.xy / cov.yy,
        inv_var_y: T::ONE / cov.yy,
        sigma_px: [cov.xx.sqrt(), cov.yy.sqrt()],
        opacity,
        color: color(map, i, view.center)?,
        radius_px: saturate(radius),
        footprint,
    })
}

// Cached between the two: the splat's colour, opacity and depth. The other steps from the
// parameters are cheap beside the pixels and are computed again.

/// The gradient of one Gaussian's row.
#[derive(Debug, Clone, Copy)]
pub(crate) struct RowGradient<T> {
    pub(crate) mean: [T; 3],
    pub(crate) log_scale: [T; 3],
    pub(crate) quaternion: [T; 4],
    pub(crate) opacity_logit: T,
    /// That of the k-th SH triple is `basis[k] color`.
    pub(crate) basis: [T; sh::MAX_COEFFICIENTS],
    pub(crate) color: [T; 3],
    /// Its term of the pose's gradient, (translation, rotation).
    pub(crate) pose: [T; 6],
}

impl<T: Real> RowGradient<T> {
    /// Writes the gradients of as many SH triples as `out` holds.
    pub(crate) fn write_sh(&self, out: &mut [[T; 3]]) {
        for (out, &basis) in out.iter_mut().zip(&self.basis) {
            *out = three(|k| basis * self.color[k]);
        }
    }
}

/// Backward pass of [`project_one`] (R15 to R20). `None` where the row cannot have been drawn.
///
/// With p = W mean + t and the pose on its left, exp(ρ, φ): ∂p/∂mean = W, ∂p/∂ρ = 1, φ moves p by
/// φ × p. The direction of view is Wᵀ p/|p|, which only ρ and the mean turn.
#[inline]
pub(crate) fn project_one_backward<T: Real>(
    map: &GaussianMap<T>,
    view: &View<T>,
    splat: &Projected<T>,
    d: &SplatGradient<T>,
    clamp: ClampGradient,
) -> Option<RowGradient<T>> {
    let i = splat.index as usize;
    let p_cam = camera_point(view, map.means[i]);
    let [x, y, z] = p_cam;
    let rotation = rotation(map.quaternions[i])?;
    let sigma_m = three(|k| map.log_scales[i][k].exp());
    let jw = pixel_from_world(view, p_cam);
    let m = half_axes(&jw, &rotation, sigma_m);

    // R2 to R5: from the covariance in the image to shape, orientation and place.
    let d_m = covariance_backward(&m, d.covariance);
    let d_axes = half_axes_backward(&jw, &rotation, sigma_m, &m, &d_m);
    let d_jw = pixel_from_world_backward(view, p_cam, &jw, &d_axes.pixel_from_world, clamp);

    // R1: the point in the camera moves the splat's centre, its depth and its shape.
    let [fx, fy] = view.focal_px;
    let [du, dv] = d.mean_px;
    let d_p = [
        d_jw.p_cam[0] + fx * du / z,
        d_jw.p_cam[1] + fy * dv / z,
        d_jw.p_cam[2] - (fx * du * (x / z) + fy * dv * (y / z)) / z + d.depth_m,
    ];

    // R7: and the direction it is seen from.
    let d_color = color_backward(map, i, view.center, splat.color, d.color);
    let w = &view.rotation;
    let across = three(|i| dot(w[i], d_color.offset));
    let lever = cross(p_cam, d_p);
    Some(RowGradient {
        mean: three(|j| dot(column(w, j), d_p) + d_color.offset[j]),
        log_scale: d_axes.log_scale,
        quaternion: rotation_backward(map.quaternions[i], &d_axes.rotation),
        // 1 - sigmoid(o) = sigmoid(-o), without the difference.
        opacity_logit: d.opacity * splat.opacity * sigmoid(-map.opacity_logits[i]),
        basis: d_color.basis,
        color: d_color.g,
        pose: [
            d_p[0] + across[0],
            d_p[1] + across[1],
            d_p[2] + across[2],
            lever[0] + d_jw.turn[0],
            lever[1] + d_jw.turn[1],
            lever[2] + d_jw.turn[2],
        ],
    })
}

/// R mean + t, metres.
#[inline]
pub(crate) fn camera_point<T: Real>(view: &View<T>, mean: [T; 3]) -> [T; 3] {
    let (r, t) = (&view.rotation, &view.translation);
    three(|i| dot(r[i], mean) + t[i])
}

/// ⌈3 √λ⌉, λ = mid + √max(0.1, ((xx - yy)/2)² + xy²), mid = (xx + yy)/2 (R6).
///
/// The radicand is mid² - det, written so that it does not cancel. The floor of 0.1 px⁴ comes
/// from the CUDA rasterizer and makes round splats a little wider.
#[inline]
fn radius<T: Real>(cov: &Covariance2<T>) -> T {
    let half = T::from_f64(0.5);
    let mid = half * (cov.xx + cov.yy);
    let difference = half * (cov.xx - cov.yy);
    let radicand = difference * difference + cov.xy * cov.xy;
    let largest = mid + radicand.max(T::from_f64(0.1)).sqrt();
    (T::from_f64(3.0) * largest.sqrt()).ceil()
}

/// The square mean ± radius rounded out to cells of 16 px and cut to the image (R6).
///
/// Per axis the cells ⌊(m - r)/16⌋ .. ⌊(m + r + 15)/16⌋, the second one excluded. Nothing is
/// drawn outside, even where alpha would still reach 1/255 (3 sigma cut off up to 1.1 % of an
/// opaque splat): trained maps assume this definition.
#[inline]
fn footprint<T: Real>(mean_px: [T; 2], radius: T, size: [usize; 2]) -> PixelRect {
    let cell = T::from_f64(FOOTPRINT_CELL_PX as f64);
    let last = T::from_f64((FOOTPRINT_CELL_PX - 1) as f64);
    let pixels = |cells: T, n: usize| to_index(cells.floor() * cell).min(n);
    let [(x0, x1), (y0, y1)] = two(|k| {
        (
            pixels((mean_px[k] - radius) / cell, size[k]),
            pixels((mean_px[k] + radius + last) / cell, size[k]),
        )
    });
    PixelRect { x0, x1, y0, y1 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn round(variance: f64) -> Covariance2<f64> {
        Covariance2 {
            xx: variance,
            xy: 0.0,
            yy: variance,
            det: variance * variance,
        }
    }

    #[test]
    fn radius_by_hand() {
        // A round splat gets √0.1 on top of its variance: 3 √(1 + 0.316) = 3.44.
        assert_eq!(saturate(radius(&round(1.0))), 4, "floor of the radicand");
        // 100 by 4 px²: mid 52, radicand 48², λ = 100, 3 √100 = 30.
        let long = Covariance2 {
            xx: 100.0,
            xy: 0.0,
            yy: 4.0,
            det: 400.0,
        };
        assert_eq!(saturate(radius(&long)), 30, "three sigma");
        // The same, turned by 45°: xx = yy = 52, xy = 48.
        let turned = Covariance2 {
            xx: 52.0,
            xy: 48.0,
            yy: 52.0,
            det: 400.0,
        };
        assert_eq!(saturate(radius(&turned)), 30, "whatever its angle");
    }

    #[test]
    fn footprints_are_whole_cells() {
        let at = |u: f64, r: f64| {
            let f = footprint([u, 8.0], r, [40, 16]);
            (f.x0, f.x1)
        };
        assert_eq!(at(8.0, 4.0), (0, 16), "inside the first cell");
        assert_eq!(at(8.0, 8.0), (0, 16), "up to its edge");
        assert_eq!(at(8.0, 9.0), (0, 32), "beyond it: 17 + 15 = 32");
        assert_eq!(at(20.0, 4.0), (16, 32), "starts on the edge");
        assert_eq!(at(20.0, 4.5), (0, 32), "or before it");
        assert_eq!(at(39.0, 5.0), (32, 40), "cut to the image");
        assert_eq!(at(8.0, 1e30), (0, 40), "everywhere");
        // -19 + 4 + 15 = 0: the cell before the first one is the last.
        assert!(footprint([-19.0, 8.0], 4.0, [40, 16]).is_empty(), "left");
        assert_eq!(at(-19.0, 20.0), (0, 16), "one pixel in");
        assert!(footprint([60.0, 8.0], 4.0, [40, 16]).is_empty(), "right");
    }
}
