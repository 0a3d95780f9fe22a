//! Textures of pictures on the wall, print, rug, window, curtain and pinboard.

use crate::pattern::{
    Rgb, band, bands, cell, disc, fade, fbm, hash, lerp, mix, noise, part, print, scale, spots,
    step,
};
use crate::shape::Surface;

/// Motif of a framed picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Picture {
    /// Hills, a lake and the sun.
    Landscape,
    /// Coloured fields between black bars.
    Fields,
    /// Rings in squares.
    Rings,
    /// A poster: a title, a block of colour, small print.
    Poster,
    /// Many small photographs.
    Photos,
    /// Contour lines, roads and names.
    Map,
}

const PALETTE: [Rgb; 8] = [
    [0.80, 0.22, 0.18],
    [0.90, 0.68, 0.18],
    [0.16, 0.32, 0.58],
    [0.92, 0.88, 0.78],
    [0.20, 0.48, 0.36],
    [0.12, 0.12, 0.14],
    [0.58, 0.30, 0.48],
    [0.45, 0.66, 0.74],
];

pub(crate) fn palette(h: u32) -> Rgb {
    PALETTE[(h % 8) as usize]
}

/// A rug: a border of blocks and a field of medallions.
pub(crate) fn rug(s: &Surface, fp: f32, seed: u32) -> Rgb {
    let [u, v] = s.uv;
    let inset = (s.half[0] - u.abs()).min(s.half[1] - v.abs());
    let pitch = if inset < 0.16 { 0.08 } else { 0.24 };
    let ((i, x), (j, y)) = (cell(u / pitch), cell(v / pitch));
    let h = hash(i, j, seed);
    let (x, y) = (x - 0.5, y - 0.5);
    let diamond = step(
        lerp(0.25, 0.45, part(h, 0)) - (x.abs() + y.abs()),
        fp / pitch,
    );
    let core = step(0.14 - x.abs().max(y.abs()), fp / pitch);
    let ground = if inset < 0.16 {
        [0.20, 0.22, 0.36]
    } else {
        [0.52, 0.17, 0.16]
    };
    let w = fade(pitch, fp);
    let colour = mix(ground, palette(h >> 3), 0.85 * w * diamond);
    let colour = mix(colour, palette(h >> 9), 0.85 * w * core);
    let line = band(inset, 0.02, 0.035, fp) + band(inset, 0.15, 0.17, fp);
    let colour = mix(colour, [0.85, 0.76, 0.55], line.min(1.0));
    scale(
        colour,
        1.0 + 0.14 * fbm(u, v, 0.02, 2, fp, seed) + 0.06 * noise(u, v, 0.3, fp, seed),
    )
}

/// A printed page: a title, paragraphs, a figure.
pub(crate) fn page(s: &Surface, fp: f32, seed: u32) -> Rgb {
    let [u, v] = s.uv;
    let h = hash(3, 1, seed);
    let paper = scale([0.93, 0.92, 0.88], 1.0 + 0.02 * noise(u, v, 0.05, fp, seed));
    let (w, t) = (s.half[0], s.half[1]);
    let margin = band(u, -0.8 * w, 0.8 * w, fp) * band(v, -0.85 * t, 0.85 * t, fp);
    let title = band(v, 0.62 * t, 0.78 * t, fp) * print(u, v - 0.62 * t, 0.16 * t, fp, h);
    let body = step(0.5 * t - v, fp) * print(u, v, 0.013, fp, h ^ 5);
    let ink = margin * (title + body).min(1.0);
    let (cx, cy) = (
        lerp(-0.3, 0.3, part(h, 0)) * w,
        lerp(-0.5, 0.1, part(h, 1)) * t,
    );
    let figure = band(u - cx, -0.4 * w, 0.4 * w, fp) * band(v - cy, -0.22 * t, 0.22 * t, fp);
    let hue = palette(h >> 5);
    let drawing = mix(hue, scale(hue, 0.4), disc(u - cx, v - cy, 0.15 * t, fp));
    mix(mix(paper, [0.12, 0.12, 0.14], 0.85 * ink), drawing, figure)
}

/// A picture with a white mat in a wooden frame.
pub(crate) fn framed(s: &Surface, picture: Picture, fp: f32, seed: u32) -> Rgb {
    let [u, v] = s.uv;
    let (w, t) = (s.half[0], s.half[1]);
    if w.min(t) < 0.04 {
        return [0.25, 0.16, 0.10];
    }
    let (frame, mat) = (0.022, 0.05);
    let inside = |inset: f32| band(u, inset - w, w - inset, fp) * band(v, inset - t, t - inset, fp);
    let (a, b) = ((u + w) / (2.0 * w), (v + t) / (2.0 * t));
    let image = match picture {
        Picture::Landscape => landscape(u, b, fp, 2.0 * t, seed),
        Picture::Fields => fields(u, v, fp, seed),
        Picture::Rings => rings(u, v, fp, seed),
        Picture::Poster => poster(u, a, b, 2.0 * t, fp, seed),
        Picture::Photos => photos(u, v, fp, seed),
        Picture::Map => map(u, v, fp, seed),
    };
    let mat = mix([0.92, 0.91, 0.87], image, inside(frame + mat));
    mix([0.20, 0.13, 0.09], mat, inside(frame))
}

fn landscape(u: f32, b: f32, fp: f32, height: f32, seed: u32) -> Rgb {
    let fp_b = fp / height;
    let mut colour = mix(
        [0.92, 0.78, 0.58],
        [0.38, 0.58, 0.80],
        ((b - 0.4) * 1.7).clamp(0.0, 1.0),
    );
    colour = scale(
        colour,
        1.0 + 0.10 * fbm(u, b * height * 2.0, 0.12, 3, fp, seed),
    );
    let sun = disc(u - 0.1, (b - 0.78) * height, 0.05, fp);
    colour = mix(colour, [0.98, 0.92, 0.62], sun);
    for k in 0..3u32 {
        let ridge = 0.58 - 0.13 * k as f32 + 0.10 * fbm(u, k as f32, 0.18, 4, fp, seed ^ k);
        let rock = mix([0.46, 0.52, 0.62], [0.16, 0.30, 0.18], 0.5 * k as f32);
        let rough = scale(rock, 1.0 + 0.25 * fbm(u, b * height, 0.03, 3, fp, seed ^ k));
        colour = mix(colour, rough, step(ridge - b, fp_b));
    }
    let lake = mix(
        [0.30, 0.42, 0.55],
        [0.75, 0.80, 0.82],
        bands(b, 0.035, 0.0, 0.3, fp_b),
    );
    mix(colour, lake, step(0.16 - b, fp_b))
}

fn fields(u: f32, v: f32, fp: f32, seed: u32) -> Rgb {
    let ((i, x), (j, y)) = (cell(u / 0.11), cell(v / 0.14));
    // a bar stands between two cells unless they are of one field
    let field = |i: i32, j: i32| hash(i.div_euclid(2), j.div_euclid(2), seed) % 3;
    let of = |i: i32, j: i32| hash(i >> field(i, j).min(1), j >> field(i, j).min(1), seed ^ 4);
    let bar = |other: u32, t: f32, fp: f32| {
        if other == of(i, j) {
            0.0
        } else {
            step(0.05 - t, fp)
        }
    };
    let ink = bar(of(i - 1, j), x, fp / 0.11)
        .max(bar(of(i + 1, j), 1.0 - x, fp / 0.11))
        .max(bar(of(i, j - 1), y, fp / 0.14))
        .max(bar(of(i, j + 1), 1.0 - y, fp / 0.14));
    let paint = scale(palette(of(i, j)), 1.0 + 0.08 * fbm(u, v, 0.04, 3, fp, seed));
    mix(paint, [0.06; 3], ink)
}

fn rings(u: f32, v: f32, fp: f32, seed: u32) -> Rgb {
    let ((i, x), (j, y)) = (cell(u / 0.10), cell(v / 0.10));
    let h = hash(i, j, seed);
    let fp = fp / 0.10;
    let mut colour = palette(h);
    for (k, radius) in [0.46, 0.34, 0.21, 0.09].into_iter().enumerate() {
        let wobble = lerp(0.9, 1.05, part(hash(i, j, seed ^ 8), 0));
        let shift = 3 * k + 3;
        colour = mix(
            colour,
            palette(h >> shift),
            disc(x - 0.5, y - 0.5, radius * wobble, fp),
        );
    }
    colour
}

fn poster(u: f32, a: f32, b: f32, height: f32, fp: f32, seed: u32) -> Rgb {
    let h = hash(2, 2, seed);
    let ground = palette(h);
    let ink = if ground[0] + ground[1] > 0.9 {
        [0.10, 0.10, 0.14]
    } else {
        [0.94, 0.90, 0.80]
    };
    let fp_b = fp / height;
    let y = b * height;
    let title = band(b, 0.76, 0.93, fp_b) * print(u, y - 0.76 * height, 0.17 * height, fp, h);
    let line = band(b, 0.66, 0.72, fp_b) * print(u, y - 0.66 * height, 0.06 * height, fp, h ^ 1);
    let small = band(b, 0.04, 0.22, fp_b) * print(u, y, 0.022 * height, fp, h ^ 2);
    let mut colour = mix(ground, ink, 0.9 * (title + line + small).min(1.0));
    let block = band(b, 0.27, 0.62, fp_b) * band(a, 0.1, 0.9, fp_b);
    let wave = 0.45 + 0.12 * fbm(u, 0.0, 0.15, 3, fp, h);
    let art = mix(palette(h >> 6), palette(h >> 10), step(wave - b, fp_b));
    let art = mix(
        art,
        palette(h >> 14),
        disc((a - 0.65) * height, (b - 0.5) * height, 0.06 * height, fp),
    );
    colour = mix(
        colour,
        scale(art, 1.0 + 0.15 * fbm(u, y, 0.05, 3, fp, h)),
        block,
    );
    colour
}

fn photos(u: f32, v: f32, fp: f32, seed: u32) -> Rgb {
    let ((i, x), (j, y)) = (cell(u / 0.12), cell(v / 0.09));
    let h = hash(i, j, seed);
    let fp_x = fp / 0.10;
    let inside = band(x, 0.06, 0.94, fp_x) * band(y, 0.07, 0.93, fp_x);
    let sky = mix(palette(h), [0.80, 0.85, 0.90], y);
    let hill = 0.35 + 0.25 * noise(u, 0.0, 0.06, fp, h);
    let scene = mix(sky, palette(h >> 7), step(hill - y, fp_x));
    let head = disc((x - part(h, 2)) * 1.3, y - 0.55, 0.16, fp_x);
    let scene = mix(scene, [0.78, 0.58, 0.45], head);
    let scene = scale(scene, 1.0 + 0.2 * fbm(u, v, 0.02, 2, fp, h));
    mix([0.95; 3], scene, inside)
}

fn map(u: f32, v: f32, fp: f32, seed: u32) -> Rgb {
    let height = fbm(u, v, 0.25, 4, 0.001, seed);
    let land = mix(
        [0.62, 0.74, 0.52],
        [0.82, 0.72, 0.50],
        (0.5 + height).clamp(0.0, 1.0),
    );
    let shore = step(height + 0.25, 8.0 * fp);
    let colour = mix([0.45, 0.62, 0.80], land, shore);
    let contour = bands(height, 0.25, 0.0, 0.10, 10.0 * fp) * shore;
    let colour = mix(colour, [0.50, 0.36, 0.22], 0.7 * contour);
    let road = (noise(u, v, 0.30, 0.001, seed ^ 21)).abs();
    let colour = mix(colour, [0.75, 0.20, 0.15], step(0.02 - road, 6.0 * fp));
    let (town, h) = spots(u, v, 0.05, 0.5, fp, seed ^ 3);
    let colour = mix(colour, [0.1; 3], town);
    let names = print(u, v, 0.016, fp, seed) * f32::from(u8::from(h % 3 == 0));
    mix(colour, [0.12; 3], 0.7 * names)
}

/// A garden under a bright sky behind four panes.
pub(crate) fn window(s: &Surface, fp: f32, seed: u32) -> Rgb {
    let [u, v] = s.uv;
    let cross = band(u, -0.025, 0.025, fp).max(band(v, 0.15, 0.19, fp));
    let edge = (s.half[0] - u.abs()).min(s.half[1] - v.abs());
    let frame = cross.max(step(0.05 - edge, fp));
    let sky = mix(
        [0.80, 0.88, 0.95],
        [0.62, 0.78, 0.95],
        (v + 0.5).clamp(0.0, 1.0),
    );
    let sky = scale(sky, 1.0 + 0.06 * fbm(u, v, 0.4, 4, fp, seed));
    let crown = -0.1 + 0.22 * fbm(u, 0.0, 0.35, 5, fp, seed);
    let green = scale(
        [0.32, 0.46, 0.24],
        1.0 + 0.35 * fbm(u, v, 0.09, 4, fp, seed ^ 1),
    );
    let garden = mix(sky, green, step(crown - v, fp));
    mix(garden, [0.88, 0.87, 0.84], frame)
}

pub(crate) fn curtain(u: f32, v: f32, tone: Rgb, fp: f32, seed: u32) -> Rgb {
    let sway = u + 0.02 * noise(u, v, 0.6, fp, seed);
    let fold =
        noise(sway, v * 0.03, 0.09, fp, seed ^ 1) + 0.5 * noise(sway, v * 0.03, 0.04, fp, seed ^ 2);
    let (dot, h) = spots(u, v, 0.07, 0.7, fp, seed ^ 3);
    let cloth = mix(tone, palette(h), 0.7 * dot);
    scale(cloth, 1.0 + 0.22 * fold)
}

/// A cork board with nearly upright notes in jittered cells.
pub(crate) fn pinboard(s: &Surface, fp: f32, seed: u32) -> Rgb {
    let [u, v] = s.uv;
    let edge = (s.half[0] - u.abs()).min(s.half[1] - v.abs());
    let cork = scale(
        [0.62, 0.46, 0.30],
        1.0 + 0.25 * fbm(u, v, 0.012, 2, fp, seed),
    );
    let ((i, x), (j, y)) = (cell(u / 0.17), cell(v / 0.19));
    let h = hash(i, j, seed);
    let (w, t) = (lerp(0.03, 0.07, part(h, 0)), lerp(0.03, 0.08, part(h, 1)));
    let (x, y) = ((x - 0.5) * 0.17 + 0.01 * part(h, 2), (y - 0.5) * 0.19);
    let tilt = lerp(-0.25, 0.25, part(hash(j, i, seed), 0));
    let (x, y) = (x + tilt * y, y - tilt * x);
    let note = band(x, -w, w, fp) * band(y, -t, t, fp);
    let paper = match h % 5 {
        0 => [0.95, 0.90, 0.45],
        1 => [0.60, 0.82, 0.88],
        2 => [0.92, 0.62, 0.60],
        _ => [0.94, 0.93, 0.90],
    };
    let ink = print(x + w, y + t, lerp(0.010, 0.022, part(h, 2)), fp, h);
    let colour = mix(cork, mix(paper, [0.15, 0.15, 0.3], 0.8 * ink), note);
    let colour = mix(
        colour,
        [0.85, 0.12, 0.12],
        disc(x, y - t + 0.012, 0.006, fp),
    );
    mix([0.35, 0.24, 0.15], colour, step(edge - 0.02, fp))
}
