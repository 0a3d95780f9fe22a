//! Walls and floor: plaster, wallpaper, bricks, parquet.

use crate::decor::palette;
use crate::pattern::{
    Rgb, band, bands, cell, disc, fade, fbm, grain, hash, lerp, mix, noise, part, scale, spots,
};
use crate::shape::Surface;

/// -y and +y plaster with woodchip, +x bricks, -x wallpaper; parquet below, white above.
pub(crate) fn walls(s: &Surface, plain: bool, fp: f32, seed: u32) -> Rgb {
    let [u, v] = s.uv;
    let skirting = s.face < 4 && v < 0.09 - s.half[1];
    let surface = match s.face {
        4 => return parquet(u, v, fp, seed),
        5 => plaster(u, v, [0.86, 0.85, 0.82], fp, seed ^ 5),
        _ if plain => plaster(u, v, [0.74, 0.74, 0.70], fp, seed ^ 6),
        _ => wall(s, fp, seed),
    };
    if skirting {
        grain(u, v, [0.80, 0.78, 0.74], fp, seed)
    } else {
        surface
    }
}

/// Wallpaper, bricks or plaster, by face.
pub(crate) fn wall(s: &Surface, fp: f32, seed: u32) -> Rgb {
    let [u, v] = s.uv;
    match s.face {
        0 => wallpaper(u, v, fp, seed),
        1 => bricks(u, v, fp, seed),
        2 => plaster(u, v, [0.72, 0.76, 0.70], fp, seed ^ 7),
        _ => plaster(u, v, [0.80, 0.73, 0.60], fp, seed ^ 8),
    }
}

/// Cloudy paint, woodchips, and a few stains.
fn plaster(u: f32, v: f32, tone: Rgb, fp: f32, seed: u32) -> Rgb {
    let cloud = fbm(u, v, 0.9, 4, fp, seed);
    let chips = fbm(u, v, 0.035, 3, fp, seed ^ 0x33);
    // chips of two sizes under the paint, lit from the side: one edge light, one dark
    let chip = |pitch: f32, seed: u32| {
        let (light, h) = spots(u, v, pitch, 0.5, fp, seed);
        let (dark, _) = spots(u + 0.06 * pitch, v + 0.10 * pitch, pitch, 0.5, fp, seed);
        (light - dark) * (0.4 + 0.6 * part(h, 1))
    };
    let relief = 0.16 * chip(0.052, seed ^ 0x77) + 0.12 * chip(0.028, seed ^ 0x78);
    let (stain, h) = spots(u + 0.02 * chips, v, 0.21, 0.30, fp, seed ^ 0x79);
    let stain = stain * (0.5 + 0.5 * chips).clamp(0.0, 1.0) * (0.30 * part(h, 1) - 0.05);
    scale(
        tone,
        (1.0 + 0.05 * cloud + 0.06 * chips + relief) * (1.0 - stain),
    )
}

/// Sprigs on stripes: a leaf or a bloom per cell, all different.
fn wallpaper(u: f32, v: f32, fp: f32, seed: u32) -> Rgb {
    let stripe = bands(u, 0.30, 0.0, 0.5, fp);
    let ground = mix([0.80, 0.76, 0.66], [0.74, 0.69, 0.60], stripe);
    let ground = scale(ground, 1.0 + 0.04 * fbm(u, v, 0.3, 4, fp, seed));
    let pitch = 0.13;
    let ((i, x), (j, y)) = (cell(u / pitch), cell(v / pitch));
    let h = hash(i, j, seed);
    let fp = fp / pitch;
    if h.is_multiple_of(5) {
        return ground;
    }
    let (x, y) = (
        x - lerp(0.4, 0.6, part(h, 0)),
        y - lerp(0.4, 0.6, part(h, 1)),
    );
    let tilt = lerp(-1.0, 1.0, part(h, 2));
    let leaf = disc((x + tilt * y) * 2.6, y * 1.1, 0.33, 2.0 * fp);
    let bloom = disc(x - 0.1, y - 0.2, 0.14, fp);
    let heart = disc(x - 0.1, y - 0.2, 0.05, fp);
    let w = fade(pitch, fp * pitch);
    let colour = mix(ground, [0.34, 0.44, 0.34], 0.8 * w * leaf);
    let colour = mix(colour, palette(h >> 4), 0.8 * w * bloom);
    mix(colour, [0.92, 0.84, 0.5], w * heart)
}

/// Running bond of 25 x 7.5 cm with mortar; bricks differ in colour.
fn bricks(u: f32, v: f32, fp: f32, seed: u32) -> Rgb {
    let (row, y) = cell(v / 0.075);
    let shift = if row % 2 == 0 { 0.0 } else { 0.5 };
    let (column, x) = cell(u / 0.25 + shift);
    let h = hash(column, row, seed ^ 0xb);
    let fired = mix([0.58, 0.30, 0.22], [0.72, 0.48, 0.36], part(h, 0));
    let fired = if h.is_multiple_of(7) {
        scale(fired, 0.62)
    } else {
        fired
    };
    let rough = fbm(u, v, 0.05, 4, fp, seed ^ h);
    let (chip, _) = spots(u, v, 0.03, 0.35, fp, seed ^ 2);
    let brick = scale(fired, (1.0 + 0.16 * rough) * (1.0 - 0.35 * chip));
    let mortar = scale(
        [0.70, 0.68, 0.63],
        1.0 + 0.08 * fbm(u, v, 0.02, 2, fp, seed),
    );
    let joint = 0.006 * (1.0 + 0.5 * noise(u, v, 0.04, fp, seed));
    let inside =
        band(x * 0.25, joint, 0.25 - joint, fp) * band(y * 0.075, joint, 0.075 - joint, fp);
    mix(mortar, brick, inside)
}

/// Boards of 11 cm x 1.1 m, all different.
fn parquet(u: f32, v: f32, fp: f32, seed: u32) -> Rgb {
    let (row, y) = cell(v / 0.11);
    let (column, x) = cell(u / 1.1 + part(hash(row, 0, seed), 0));
    let h = hash(row, column, seed ^ 0xf);
    let tone = mix([0.50, 0.34, 0.21], [0.70, 0.52, 0.34], part(h, 0));
    let board = grain(u, v, tone, fp, h);
    let gap = band(y * 0.11, 0.0015, 0.1085, fp) * band(x * 1.1, 0.0015, 1.0985, fp);
    mix([0.16, 0.10, 0.07], board, gap)
}
