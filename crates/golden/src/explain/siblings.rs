//! Mistakes that other tensors of the case show.

use super::suspect::Suspect;
use crate::tensor::Tensor;

/// Tries what the inputs and the other outputs suggest.
pub(super) fn find(s: &Suspect<'_>) -> Option<String> {
    inverse_motion(s)
        .or_else(|| quaternion_order(s))
        .or_else(|| pose_reading(s))
        .or_else(|| conic(s))
        .or_else(|| activation(s))
        .or_else(|| background(s))
        .or_else(|| opacity(s))
}

/// Another output's expected numbers.
fn sibling(s: &Suspect<'_>, name: &str) -> Option<Vec<f64>> {
    s.case.outputs().get(name).map(Tensor::f64)
}

/// -R times what was given, if the rotations are an output, too.
fn inverse_motion(s: &Suspect<'_>) -> Option<String> {
    let rotations = sibling(s, "rotation")?;
    if s.output != "translation" || rotations.len() != 3 * s.got.len() {
        return None;
    }
    let inverted = s.map(|i, _| {
        let (row, k) = (i / 3, i % 3);
        let r = &rotations[9 * row + 3 * k..][..3];
        let t = &s.got[3 * row..][..3];
        -(r[0] * t[0] + r[1] * t[1] + r[2] * t[2])
    });
    s.named(
        "the inverse motion: world_from_camera instead of camera_from_world",
        &inverted,
    )
}

/// Entries that agree with another reading of the input to this, relative to the largest, were read
/// that way.
const SAME: f64 = 1e-4;

fn same(got: &[f64], other: &[f64]) -> bool {
    let largest = got.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let mut pairs = other.iter().zip(got);
    got.len() == other.len() && pairs.all(|(a, b)| (a - b).abs() <= SAME * largest)
}

fn unit(q: [f64; 4]) -> [f64; 4] {
    let norm = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    q.map(|v| v / norm)
}

/// Rotations from quaternions (x, y, z, w), or from ones of any length.
fn quaternion_order(s: &Suspect<'_>) -> Option<String> {
    let quaternions = s.case.inputs().get("quaternions")?.f64();
    if s.output != "rotation" || quaternions.len() * 9 != s.got.len() * 4 {
        return None;
    }
    let rows = quaternions.as_chunks::<4>().0;
    let read = |f: fn([f64; 4]) -> [f64; 4]| -> Vec<f64> {
        rows.iter().flat_map(|q| matrix(f(*q))).collect()
    };
    if same(s.got, &read(|[a, b, c, d]| unit([d, a, b, c]))) {
        return Some("quaternions were read as (x, y, z, w); they are (w, x, y, z)".to_owned());
    }
    let free = same(s.got, &read(|q| q));
    free.then(|| "the quaternions are used without bringing them to length 1".to_owned())
}

/// Points in the camera from a pose that was read otherwise.
fn pose_reading(s: &Suspect<'_>) -> Option<String> {
    if s.output != "p_cam" {
        return None;
    }
    let input = |name: &str| s.case.inputs().get(name).map(|tensor| tensor.f64());
    let points = input("means")?;
    let q: [f64; 4] = input("camera_from_world_q")?.try_into().ok()?;
    let t: [f64; 3] = input("camera_from_world_t")?.try_into().ok()?;
    let [w, x, y, z] = unit(q);
    let (right, inverse) = (matrix([w, x, y, z]), matrix([w, -x, -y, -z]));
    let turned = |r: &[f64; 9], p: [f64; 3]| {
        [0, 1, 2].map(|k| r[3 * k] * p[0] + r[3 * k + 1] * p[1] + r[3 * k + 2] * p[2])
    };
    let moved = |f: &dyn Fn([f64; 3]) -> [f64; 3]| -> Vec<f64> {
        let rows = points.as_chunks::<3>().0.iter();
        rows.flat_map(|p| f(*p)).collect()
    };
    let plus = |a: [f64; 3], b: [f64; 3]| [0, 1, 2].map(|k| a[k] + b[k]);
    let minus = |a: [f64; 3], b: [f64; 3]| [0, 1, 2].map(|k| a[k] - b[k]);
    let shuffled = matrix([z, w, x, y]);
    let readings: [(&str, Vec<f64>); 4] = [
        (
            "the camera's rotation is transposed",
            moved(&|p| plus(turned(&inverse, p), t)),
        ),
        (
            "the pose is used as world_from_camera; it is camera_from_world",
            moved(&|p| turned(&inverse, minus(p, t))),
        ),
        (
            "the camera's quaternion was read as (x, y, z, w); it is (w, x, y, z)",
            moved(&|p| plus(turned(&shuffled, p), t)),
        ),
        (
            "the camera's translation is missing",
            moved(&|p| turned(&right, p)),
        ),
    ];
    let found = readings.into_iter().find(|(_, other)| same(s.got, other));
    found.map(|(name, _)| name.to_owned())
}

/// Row by row, by the formula for unit quaternions.
fn matrix([w, x, y, z]: [f64; 4]) -> [f64; 9] {
    [
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    ]
}

/// (a, b, c) of [a, b; b, c] to those of its inverse.
fn inverted([a, b, c]: [f64; 3]) -> [f64; 3] {
    let det = a * c - b * b;
    [c / det, -b / det, a / det]
}

/// A covariance instead of its inverse, or one without the blur of a pixel.
fn conic(s: &Suspect<'_>) -> Option<String> {
    let rows = s.got.as_chunks::<3>();
    if s.output != "conic" || !rows.1.is_empty() {
        return None;
    }
    let each = |f: fn([f64; 3]) -> [f64; 3]| -> Vec<f64> {
        rows.0.iter().flat_map(|row| f(*row)).collect()
    };
    let blurred = each(|row| {
        let [xx, xy, yy] = inverted(row);
        inverted([xx + 0.3, xy, yy + 0.3])
    });
    s.named("the covariance instead of its inverse", &each(inverted))
        .or_else(|| {
            s.named(
                "0.3 px² on the diagonal of the covariance are missing",
                &blurred,
            )
        })
}

/// A gradient by the activated value instead of by the parameter.
fn activation(s: &Suspect<'_>) -> Option<String> {
    let (input, of) = match s.output {
        "d_log_scales" => ("log_scales", "scale"),
        "d_opacity_logits" => ("opacity_logits", "opacity"),
        _ => return None,
    };
    let parameters = s.case.inputs().get(input)?.f64();
    if parameters.len() != s.got.len() {
        return None;
    }
    let chained = s.map(|i, g| {
        let e = libm::exp(parameters[i]);
        g * if of == "scale" {
            e
        } else {
            e / ((1.0 + e) * (1.0 + e))
        }
    });
    s.named(
        &format!("the gradient by the {of}, not by the parameter"),
        &chained,
    )
}

/// An image without its background, or with the background everywhere.
fn background(s: &Suspect<'_>) -> Option<String> {
    if s.output != "color" {
        return None;
    }
    let light = s.case.inputs().get("background")?.f64();
    let left = sibling(s, "transmittance")?;
    let n = light.len();
    if left.len() * n != s.got.len() {
        return None;
    }
    let without = s.map(|i, g| g + left[i / n] * light[i % n]);
    let everywhere = s.map(|i, g| g - (1.0 - left[i / n]) * light[i % n]);
    s.named("the background is missing", &without).or_else(|| {
        s.named(
            "the background is added in full, not times the transmittance",
            &everywhere,
        )
    })
}

/// Depth divided by opacity, or not.
fn opacity(s: &Suspect<'_>) -> Option<String> {
    let left = sibling(s, "transmittance")?;
    if s.output != "depth" || left.len() != s.got.len() {
        return None;
    }
    s.named(
        "the depth is divided by the opacity",
        &s.map(|i, g| {
            if left[i] < 1.0 {
                g * (1.0 - left[i])
            } else {
                g
            }
        }),
    )
}
