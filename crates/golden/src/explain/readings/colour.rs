//! Gradients with one mistake, from the expected gradients of what lies between: docs/math.md R13 to R20.

use super::Reading;
use super::harmonics::slopes;
use super::splats::{Jacobian, Scene, cross, dot, transposed, turned};
use crate::explain::suspect::Suspect;
use crate::tensor::Tensor;

const DETACHED: &str = "the gradient through the view direction of the harmonics is left out; it belongs to means and pose (R19)";
const PASSED: &str =
    "the clamped slope is differentiated by z as if x were held; clamp_gradient is \"true\" (R17)";
const TRUE: &str = "the clamped slope is a constant; clamp_gradient is \"pass_through\" (R17)";
const HALVED: &str = "the gradient by the off-diagonal of the conic is halved: b stands for both entries, 2 b dx dy in the exponent (R14)";
const DOUBLED: &str = "the gradient by the off-diagonal of the conic is doubled: b stands for both entries, 2 b dx dy in the exponent (R14)";
const LENGTH: &str =
    "the gradient by the unit quaternion: it is not divided by the length of the parameter (R18)";
const WORLD: &str = "the pose's gradient is by a step in the world's frame; the step is taken in the camera's (R20)";

/// A part of the gradient of one Gaussian's mean that a mistake leaves out or adds: in the camera, and whether a turn of
/// the camera sees it.
struct Part {
    index: usize,
    in_camera: [f64; 3],
    arm: bool,
}

/// Of `raster_backward`.
pub(super) fn readings(s: &Suspect<'_>) -> Option<Vec<Reading>> {
    let scaled = |by: f64| -> Vec<f64> {
        let pairs = s.expected.iter().enumerate();
        pairs
            .map(|(i, e)| if i % 3 == 1 { e * by } else { *e })
            .collect()
    };
    match s.output {
        "d_conics" => Some(vec![(HALVED, scaled(0.5)), (DOUBLED, scaled(2.0))]),
        "d_quaternions" => {
            let rows = s.case.inputs().rows::<4>("quaternions").ok()?;
            let length = |q: &[f64; 4]| q.iter().map(|v| v * v).sum::<f64>().sqrt();
            let pairs = s.expected.iter().enumerate();
            let free = pairs.map(|(i, e)| e * length(&rows[i / 4])).collect();
            Some(vec![(LENGTH, free)])
        }
        "d_means" | "d_pose" => means_and_pose(s),
        _ => None,
    }
}

fn means_and_pose(s: &Suspect<'_>) -> Option<Vec<Reading>> {
    let scene = Scene::read(s.case.inputs()).ok()?;
    let expected = |name: &str| s.case.outputs().get(name).map(Tensor::f64);
    let (colors, conics) = (expected("d_colors")?, expected("d_conics")?);
    let (w, _) = scene.pose(None);
    let triple = |v: &[f64], i: usize| [v[3 * i], v[3 * i + 1], v[3 * i + 2]];
    let (mut direction, mut slope) = (Vec::new(), Vec::new());
    for splat in scene.visible(None) {
        let i = splat.index;
        let lit = [0, 1, 2].map(|c| {
            if splat.color[c] > 0.0 {
                triple(&colors, i)[c]
            } else {
                0.0
            }
        });
        let (d, distance) = scene.direction(i, None);
        let mut g = [0.0; 3];
        for (f, slope) in scene.sh[i].iter().zip(slopes(d)) {
            let weight = dot(*f, lit);
            g = [0, 1, 2].map(|k| g[k] + weight * slope[k]);
        }
        let along = dot(g, d);
        let tangent = [0, 1, 2].map(|k| (g[k] - along * d[k]) / distance);
        direction.push(Part {
            index: i,
            in_camera: turned(&w, tangent),
            arm: false,
        });
        let z = through_z(&splat.jacobian, splat.conic, triple(&conics, i), &w) / splat.p[2];
        slope.push(Part {
            index: i,
            in_camera: [0.0, 0.0, z],
            arm: true,
        });
    }
    let changed = |parts: &[Part], sign: f64| -> Vec<f64> {
        let mut out = s.expected.to_vec();
        for part in parts {
            let in_world = turned(&transposed(&w), part.in_camera);
            if s.output == "d_means" {
                (0..3).for_each(|k| out[3 * part.index + k] += sign * in_world[k]);
                continue;
            }
            let splat = scene.project(part.index, None);
            let arm = splat.map_or([0.0; 3], |splat| cross(splat.p, part.in_camera));
            for k in 0..3 {
                out[k] += sign * part.in_camera[k];
                out[3 + k] += if part.arm { sign * arm[k] } else { 0.0 };
            }
        }
        out
    };
    let mut all = vec![(DETACHED, changed(&direction, -1.0))];
    match s.case.inputs().word("clamp_gradient") {
        Ok("pass_through") => all.push((TRUE, changed(&slope, -1.0))),
        _ => all.push((PASSED, changed(&slope, 1.0))),
    }
    if s.output == "d_pose" {
        let mut world = s.expected.to_vec();
        let back = turned(&transposed(&w), triple(s.expected, 0));
        world[..3].copy_from_slice(&back);
        all.push((WORLD, world));
    }
    Some(all)
}

/// The gradient by ln z that reaches a clamped slope if x is held: - Σ slope ∂L/∂slope.
fn through_z(j: &Jacobian, conic: [f64; 3], g: [f64; 3], w: &[[f64; 3]; 3]) -> f64 {
    let product = |a: [[f64; 2]; 2], b: [[f64; 2]; 2]| {
        [0, 1].map(|r| [0, 1].map(|c| a[r][0] * b[0][c] + a[r][1] * b[1][c]))
    };
    let k = [[conic[0], conic[1]], [conic[1], conic[2]]];
    let by_conic = [[g[0], g[1] / 2.0], [g[1] / 2.0, g[2]]];
    let by_cov = product(product(k, by_conic), k).map(|row| row.map(|v| -v));
    let mut sum = 0.0;
    for a in (0..2).filter(|&a| j.clamped[a]) {
        let by_m = [0, 1, 2].map(|c| 2.0 * (by_cov[a][0] * j.m[0][c] + by_cov[a][1] * j.m[1][c]));
        let by_jw = turned(&j.own, by_m);
        sum += j.slope[a] * j.f_over_z[a] * dot(w[2], by_jw);
    }
    sum
}
