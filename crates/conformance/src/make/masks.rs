//! What arithmetic in f32 may decide otherwise: pixels near a cut, radii, the order of depths.

use garad_raster::{MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE, Projected};

use super::scene::Scene;
use crate::outputs::Error;

/// Unit roundoff of f32.
const U32: f64 = 1.0 / 16_777_216.0;
/// Distance of alpha from 1/255, and of T from 1e-4, relative; as in the committed cases.
const CUT_MARGIN: f64 = 1e-3;
/// T is a product of many 1 - alpha, each of which has lost up to two digits.
const LIGHT_MARGIN: f64 = 1e-2;
/// Distance of a radius from a whole number, relative.
pub(super) const RADIUS_MARGIN: f64 = 1e-4;
/// Roundings by which a coordinate in the camera may be off.
const ROUNDINGS: f64 = 8.0;

/// By how much coordinate `k` of a point in the camera may be off in f32, metres.
fn camera_error_m(scene: &Scene, turn: &nalgebra::Matrix3<f64>, row: usize, k: usize) -> f64 {
    let mean = scene.map.means[row];
    let terms: f64 = (0..3).map(|j| (turn[(k, j)] * mean[j]).abs()).sum();
    ROUNDINGS * U32 * (terms + scene.t[k].abs())
}

/// By how much a centre may be off in f32, pixels.
pub(super) fn center_error_px(scene: &Scene, row: usize) -> Result<[f64; 2], Error> {
    let pose = scene.pose()?;
    let turn = pose.rotation.matrix();
    let p = turn * nalgebra::Vector3::from(scene.map.means[row]) + pose.translation;
    let e = [0, 1, 2].map(|k| camera_error_m(scene, &turn, row, k));
    let f = [scene.camera.fx, scene.camera.fy];
    let size = scene.camera.width.max(scene.camera.height) as f64;
    Ok([0, 1].map(|k| f[k] * (e[k] + p[k].abs() * e[2] / p.z) / p.z + ROUNDINGS * U32 * size))
}

/// 3 √λmax as the footprint has it, before it is rounded up.
pub(super) fn radius_px(splat: &Projected<f64>) -> f64 {
    let [xx, yy] = splat.sigma_px.map(|s| s * s);
    let xy = -splat.shear * yy;
    let half = 0.5 * (xx - yy);
    3.0 * (0.5 * (xx + yy) + (half * half + xy * xy).max(0.1).sqrt()).sqrt()
}

/// Per Gaussian: its radius is the same in f32. Invisible ones have none, certainly.
pub(super) fn radii(gaussians: usize, splats: &[Projected<f64>]) -> Vec<u8> {
    let mut robust = vec![1; gaussians];
    for splat in splats {
        let r = radius_px(splat);
        let clear = (r - r.round()).abs() > RADIUS_MARGIN * r;
        robust[splat.index as usize] = u8::from(clear);
    }
    robust
}

/// Depths too close to tell apart in f32. The same mean gives the same depth, and there the row decides.
pub(super) struct Depths(Vec<f64>);

impl Depths {
    /// Of splats, front to back.
    pub(super) fn new(scene: &Scene, splats: &[Projected<f64>]) -> Result<Self, Error> {
        let turn = scene.pose()?.rotation.matrix();
        let error = |s: &Projected<f64>| camera_error_m(scene, &turn, s.index as usize, 2);
        Ok(Self(splats.iter().map(error).collect()))
    }

    fn told_apart(&self, scene: &Scene, splats: &[Projected<f64>], a: usize, b: usize) -> bool {
        let gap = (splats[a].depth_m - splats[b].depth_m).abs();
        let mean = |k: usize| scene.map.means[splats[k].index as usize].map(f64::to_bits);
        mean(a) == mean(b) || gap > self.0[a] + self.0[b]
    }

    /// Per place in the order: the same Gaussian stands there in f32.
    pub(super) fn order(&self, scene: &Scene, splats: &[Projected<f64>]) -> Vec<u8> {
        let clear =
            |k: usize| k == 0 || k >= splats.len() || self.told_apart(scene, splats, k - 1, k);
        (0..splats.len())
            .map(|k| u8::from(clear(k) && clear(k + 1)))
            .collect()
    }
}

/// Whether a pixel is away from every cut, and what it draws in an order that is certain.
pub(super) fn pixel(
    scene: &Scene,
    depths: &Depths,
    splats: &[Projected<f64>],
    list: &[u32],
    [x, y]: [usize; 2],
) -> bool {
    let mut left = 1.0f64;
    let mut before: Option<(usize, bool)> = None;
    for &position in list {
        let position = position as usize;
        let s = &splats[position];
        let f = &s.footprint;
        let inside = (f.x0..f.x1).contains(&x) && (f.y0..f.y1).contains(&y);
        let (dx, dy) = (x as f64 - s.mean_px[0], y as f64 - s.mean_px[1]);
        let along = dx + s.shear * dy;
        let power = -0.5 * (s.conic[0] * along * along + s.inv_var_y * dy * dy);
        let alpha = if inside {
            MAX_ALPHA.min(s.opacity * libm::exp(power))
        } else {
            0.0
        };
        if (alpha / MIN_ALPHA - 1.0).abs() < CUT_MARGIN {
            return false;
        }
        let thick = alpha >= MIN_ALPHA;
        let close = |other| !depths.told_apart(scene, splats, other, position);
        if before.is_some_and(|(other, drawn)| (drawn || thick) && close(other)) {
            return false;
        }
        before = Some((position, thick));
        if !thick {
            continue;
        }
        let behind = left * (1.0 - alpha);
        if (behind / MIN_TRANSMITTANCE - 1.0).abs() < LIGHT_MARGIN {
            return false;
        }
        if behind < MIN_TRANSMITTANCE {
            break;
        }
        left = behind;
    }
    true
}
