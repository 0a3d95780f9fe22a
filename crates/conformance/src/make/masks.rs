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

    /// Whether f32 may put two of them in the other order.
    fn close(&self, scene: &Scene, splats: &[Projected<f64>], a: usize, b: usize) -> bool {
        let gap = (splats[a].depth_m - splats[b].depth_m).abs();
        let mean = |k: usize| scene.map.means[splats[k].index as usize].map(f64::to_bits);
        gap <= self.0[a] + self.0[b] && mean(a) != mean(b)
    }

    /// Whether the second of two places is too far behind the first for any error.
    fn far(&self, splats: &[Projected<f64>], a: usize, b: usize) -> bool {
        splats[b].depth_m - splats[a].depth_m > 2.0 * self.0[a].max(self.0[b])
    }

    /// Per place in the order: the same Gaussian stands there in f32.
    pub(super) fn order(&self, scene: &Scene, splats: &[Projected<f64>]) -> Vec<u8> {
        let mut robust = vec![1; splats.len()];
        for a in 0..splats.len() {
            let near = (a + 1..splats.len()).take_while(|&b| !self.far(splats, a, b));
            for b in near.filter(|&b| self.close(scene, splats, a, b)) {
                (robust[a], robust[b]) = (0, 0);
            }
        }
        robust
    }
}

/// What f32 may decide otherwise at a pixel.
pub(super) struct Uncertain {
    /// Whether anything.
    pub(super) any: bool,
    /// Rows of pairs that are both drawn and may change places: each stands in the light of the other, or not.
    pub(super) swapped: Vec<u32>,
}

/// Cuts near which a pixel is, and splats there whose order is not certain.
pub(super) fn pixel(
    scene: &Scene,
    depths: &Depths,
    splats: &[Projected<f64>],
    list: &[u32],
    [x, y]: [usize; 2],
) -> Uncertain {
    let mut left = 1.0f64;
    let mut found = Uncertain {
        any: false,
        swapped: Vec::new(),
    };
    // Positions and whether they are drawn.
    let mut before: Vec<(usize, bool)> = Vec::new();
    for &position in list {
        let position = position as usize;
        let s = &splats[position];
        let (dx, dy) = (x as f64 - s.mean_px[0], y as f64 - s.mean_px[1]);
        let along = dx + s.shear * dy;
        let power = -0.5 * (s.conic[0] * along * along + s.inv_var_y * dy * dy);
        let alpha = MAX_ALPHA.min(s.opacity * libm::exp(power));
        found.any |= (alpha / MIN_ALPHA - 1.0).abs() < CUT_MARGIN;
        let thick = alpha >= MIN_ALPHA;
        let recent = before.iter().rev();
        let recent = recent.take_while(|(other, _)| !depths.far(splats, *other, position));
        for &(other, drawn) in recent {
            if (thick || drawn) && depths.close(scene, splats, other, position) {
                found.any = true;
                if thick && drawn {
                    found.swapped.extend([splats[other].index, s.index]);
                }
            }
        }
        before.push((position, thick));
        if !thick {
            continue;
        }
        let behind = left * (1.0 - alpha);
        found.any |= (behind / MIN_TRANSMITTANCE - 1.0).abs() < LIGHT_MARGIN;
        if behind < MIN_TRANSMITTANCE {
            break;
        }
        left = behind;
    }
    found
}
