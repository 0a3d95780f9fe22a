//! Images with one mistake: docs/math.md R8 to R11.

use super::splats::{Scene, Slip, Splat, column, told_by};
use super::{MAX_TERMS, Reading};
use crate::explain::suspect::Suspect;

const MIN_ALPHA: f64 = 1.0 / 255.0;

/// What one pixel shows.
#[derive(Default)]
struct Pixel {
    color: [f64; 3],
    depth: f64,
    left: f64,
}

fn front_to_back(splats: &mut [Splat], slip: Option<Slip>) {
    let key = |s: &Splat| match slip {
        Some(Slip::OrderByRange) => s.p.iter().map(|v| v * v).sum(),
        Some(Slip::OrderReversed) => -s.p[2],
        _ => s.p[2],
    };
    splats.sort_by(|a, b| key(a).total_cmp(&key(b)).then(a.index.cmp(&b.index)));
}

fn pixel(splats: &[Splat], x: f64, y: f64, slip: Option<Slip>) -> Pixel {
    let mut out = Pixel {
        left: 1.0,
        ..Pixel::default()
    };
    let shift = if slip == Some(Slip::PixelsAtHalves) {
        0.5
    } else {
        0.0
    };
    let limit = match slip {
        Some(Slip::NoAlphaLimit) => 1.0,
        _ => 0.99,
    };
    let stop = match slip {
        Some(Slip::NoStop) => 0.0,
        Some(Slip::EarlyStop) => 1e-3,
        _ => 1e-4,
    };
    for s in splats {
        let [x0, y0, x1, y1] = s.footprint;
        let outside = x < x0 || x >= x1 || y < y0 || y >= y1;
        if outside && slip != Some(Slip::NoFootprint) {
            continue;
        }
        let (dx, dy) = (x + shift - s.mean_px[0], y + shift - s.mean_px[1]);
        // A sum of squares: nothing cancels along a needle.
        let slant = dx - s.cov[1] / s.cov[2] * dy;
        let power = s.conic[0] * slant * slant + dy * dy / s.cov[2];
        let alpha = (s.opacity * libm::exp(-power / 2.0)).min(limit);
        if alpha < MIN_ALPHA && slip != Some(Slip::NoAlphaCut) {
            continue;
        }
        let behind = out.left * (1.0 - alpha);
        if behind < stop {
            break;
        }
        let weight = alpha * out.left;
        out.color = [0, 1, 2].map(|c| out.color[c] + weight * s.color[c]);
        out.depth += weight * s.depth_m;
        out.left = behind;
    }
    out
}

fn image(scene: &Scene, splats: &[Splat], slip: Option<Slip>) -> Vec<Pixel> {
    let [width, height] = scene.size;
    let mut pixels = Vec::new();
    let mut y = 0.0;
    while y < height {
        let mut x = 0.0;
        while x < width {
            pixels.push(pixel(splats, x, y, slip));
            x += 1.0;
        }
        y += 1.0;
    }
    pixels
}

fn numbers(
    scene: &Scene,
    background: [f64; 3],
    output: &str,
    slip: Option<Slip>,
) -> Option<Vec<f64>> {
    let mut splats = scene.visible(slip);
    if output == "radii" {
        let mut radii = vec![0.0; scene.means.len()];
        splats.iter().for_each(|s| radii[s.index] = s.radius);
        return Some(radii);
    }
    front_to_back(&mut splats, slip);
    if output == "order" {
        return Some(splats.iter().map(|s| s.index as f64).collect());
    }
    if let Some(column) = column(&splats, output) {
        return Some(column);
    }
    let of: fn(&Pixel) -> f64 = match output {
        "color" => {
            let pixels = image(scene, &splats, slip);
            let lit = |p: &Pixel| [0, 1, 2].map(|c| p.color[c] + p.left * background[c]);
            return Some(pixels.iter().flat_map(lit).collect());
        }
        "depth" => |p| p.depth,
        "transmittance" => |p| p.left,
        _ => return None,
    };
    Some(image(scene, &splats, slip).iter().map(of).collect())
}

/// Of `raster`.
pub(super) fn readings(s: &Suspect<'_>) -> Option<Vec<Reading>> {
    let scene = Scene::read(s.case.inputs()).ok()?;
    let background = s.case.inputs().row("background").ok()?;
    if scene.means.len() * s.expected.len() > MAX_TERMS {
        return None;
    }
    let one = |(slip, name)| Some((name, numbers(&scene, background, s.output, Some(slip))?));
    Some(told_by(s.output).filter_map(one).collect())
}
