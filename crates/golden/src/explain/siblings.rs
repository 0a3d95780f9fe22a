//! Slips that other tensors of the case give away.

use super::Suspect;

/// Tries what the inputs and the other outputs suggest.
pub(super) fn find(s: &Suspect<'_>) -> Option<String> {
    inverse_motion(s)
        .or_else(|| quaternion_order(s))
        .or_else(|| activation(s))
        .or_else(|| background(s))
        .or_else(|| opacity(s))
}

/// Another output's expected numbers.
fn sibling(s: &Suspect<'_>, name: &str) -> Option<Vec<f64>> {
    let there = s.case.output_names().any(|output| output == name);
    there.then(|| s.case.output(name).f64())
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

/// Entries of rotations that agree with another reading of the quaternions to this.
const SAME_ROTATION: f64 = 1e-4;

/// Rotations from quaternions (x, y, z, w), or from ones of any length.
fn quaternion_order(s: &Suspect<'_>) -> Option<String> {
    let quaternions = s.case.try_input("quaternions")?.f64();
    if s.output != "rotation" || quaternions.len() * 9 != s.got.len() * 4 {
        return None;
    }
    let agrees = |read: fn([f64; 4]) -> [f64; 4]| {
        let rows = quaternions.as_chunks::<4>().0.iter();
        let other = rows.flat_map(|q| matrix(read(*q)));
        let mut pairs = other.zip(s.got);
        pairs.all(|(a, b)| (a - b).abs() < SAME_ROTATION)
    };
    if agrees(|[a, b, c, d]| [d, a, b, c].map(|v| v / (a * a + b * b + c * c + d * d).sqrt())) {
        return Some("quaternions were read as (x, y, z, w); they are (w, x, y, z)".to_owned());
    }
    agrees(|q| q).then(|| "the quaternions are used without bringing them to length 1".to_owned())
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

/// A gradient by the activated value instead of by the parameter.
fn activation(s: &Suspect<'_>) -> Option<String> {
    let (input, of) = match s.output {
        "d_log_scales" => ("log_scales", "scale"),
        "d_opacity_logits" => ("opacity_logits", "opacity"),
        _ => return None,
    };
    let parameters = s.case.try_input(input)?.f64();
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

/// A picture without its background, or with the background everywhere.
fn background(s: &Suspect<'_>) -> Option<String> {
    if s.output != "color" {
        return None;
    }
    let light = s.case.try_input("background")?.f64();
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
