//! [`Material`]: the colour of each point of a surface.
//!
//! Textures of furniture are here; walls in [`crate::walls`], pictures on the wall and print in
//! [`crate::decor`], people in [`crate::clothes`]. Colours are albedos as stored values (gamma 2): the
//! renderer squares them.

use crate::clothes::Cloth;
use crate::decor::{self, Picture};
use crate::hall::patterns::{self, Part};
use crate::pattern::{
    Rgb, band, bands, cell, disc, fade, fbm, grain, hash, lerp, mix, noise, part, print, scale,
    spots, step,
};
use crate::shape::Surface;

/// Material of a surface. `seed` distinguishes two things of one kind.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Material {
    /// Walls, floor and ceiling, by face; `plain` without bricks and wallpaper.
    Walls { plain: bool, seed: u32 },
    /// Enlarged patterns of the hall.
    Hall { part: Part, seed: u32 },
    /// Boards along the longer side.
    Wood { tone: Rgb, seed: u32 },
    /// Paint with fine scratches.
    Painted { tone: Rgb, seed: u32 },
    /// Woven or knitted; also clothes.
    Fabric { cloth: Cloth, seed: u32 },
    /// A closed book standing or lying: title, bands, pages.
    Book { seed: u32 },
    /// A printed sheet of paper.
    Page { seed: u32 },
    /// A framed picture with a white mat.
    Framed { picture: Picture, seed: u32 },
    /// A monitor: windows full of text.
    Screen { seed: u32 },
    /// Keys.
    Keyboard { seed: u32 },
    /// A carpet with a border and medallions.
    Rug { seed: u32 },
    /// Corrugated board with tape, label and print.
    Cardboard { seed: u32 },
    /// Leaves of a plant.
    Leaves { seed: u32 },
    /// Glazed pottery with a painted band.
    Pottery { tone: Rgb, seed: u32 },
    /// A window pane with a garden behind it.
    Window { seed: u32 },
    /// Hanging cloth in folds.
    Curtain { tone: Rgb, seed: u32 },
    /// A cork board with notes.
    Pinboard { seed: u32 },
    /// A ball made of panels.
    Ball { seed: u32 },
    /// Bare skin.
    Skin { tone: Rgb, seed: u32 },
    /// A head: the face looks along +x.
    Face { tone: Rgb, seed: u32 },
    /// Hair.
    Hair { tone: Rgb, seed: u32 },
    /// A lamp shade: emits light.
    Shade { tone: Rgb },
}

impl Material {
    /// Albedo at a point of a surface, each channel in [0, 1]; `fp` metres per pixel there.
    pub(crate) fn albedo(&self, s: &Surface, fp: f32) -> Rgb {
        let [u, v] = s.uv;
        let colour = match *self {
            Self::Walls { plain, seed } => crate::walls::walls(s, plain, fp, seed),
            Self::Hall { part, seed } => patterns::colour(part, s, fp, seed),
            Self::Wood { tone, seed } => wood(s, tone, fp, seed),
            Self::Painted { tone, seed } => painted(u, v, tone, fp, seed.wrapping_add(face(s))),
            Self::Fabric { cloth, seed } => cloth.colour(s, fp, seed),
            Self::Book { seed } => book(s, fp, seed),
            Self::Page { seed } => decor::page(s, fp, seed),
            Self::Framed { picture, seed } => decor::framed(s, picture, fp, seed),
            Self::Screen { seed } => screen(s, fp, seed),
            Self::Keyboard { seed } => keyboard(u, v, fp, seed),
            Self::Rug { seed } => decor::rug(s, fp, seed),
            Self::Cardboard { seed } => cardboard(s, fp, seed),
            Self::Leaves { seed } => leaves(u, v, fp, seed),
            Self::Pottery { tone, seed } => pottery(u, v, tone, fp, seed),
            Self::Window { seed } => decor::window(s, fp, seed),
            Self::Curtain { tone, seed } => decor::curtain(u, v, tone, fp, seed),
            Self::Pinboard { seed } => decor::pinboard(s, fp, seed),
            Self::Ball { seed } => ball(u, v, fp, seed),
            Self::Skin { tone, seed } => scale(tone, 1.0 + 0.10 * fbm(u, v, 0.03, 3, fp, seed)),
            Self::Face { tone, seed } => crate::clothes::face(u, v, tone, fp, seed),
            Self::Hair { tone, seed } => {
                let strand =
                    fbm(u, v * 0.15, 0.012, 3, fp, seed) + fbm(u, v, 0.05, 2, fp, seed ^ 9);
                scale(tone, 1.0 + 0.35 * strand)
            }
            Self::Shade { tone } => tone,
        };
        colour.map(|c| c.clamp(0.02, 0.98))
    }
}

/// The face as a seed.
#[allow(clippy::cast_possible_truncation, reason = "faces are 0..=6")]
fn face(s: &Surface) -> u32 {
    s.face as u32
}

fn painted(u: f32, v: f32, tone: Rgb, fp: f32, seed: u32) -> Rgb {
    let cloud = fbm(u, v, 0.25, 3, fp, seed);
    let (mark, h) = spots(u, v, 0.032, 0.18, fp, seed ^ 0x51);
    let scratch = noise(u, v * 0.12, 0.010, fp, seed ^ 0x52);
    scale(
        tone,
        (1.0 + 0.07 * cloud + 0.04 * scratch) * (1.0 - mark * (0.4 * part(h, 1) - 0.1)),
    )
}

fn wood(s: &Surface, tone: Rgb, fp: f32, seed: u32) -> Rgb {
    let along_u = s.half[0] >= s.half[1];
    let (along, across) = if along_u {
        (s.uv[0], s.uv[1])
    } else {
        (s.uv[1], s.uv[0])
    };
    grain(along, across, tone, fp, seed.wrapping_add(face(s)))
}

/// Spines differ in colour, bands and title.
fn book(s: &Surface, fp: f32, seed: u32) -> Rgb {
    const CLOTH: [Rgb; 10] = [
        [0.60, 0.16, 0.14],
        [0.15, 0.25, 0.45],
        [0.16, 0.38, 0.25],
        [0.80, 0.72, 0.52],
        [0.22, 0.20, 0.22],
        [0.78, 0.45, 0.15],
        [0.85, 0.83, 0.78],
        [0.40, 0.20, 0.36],
        [0.25, 0.48, 0.55],
        [0.70, 0.62, 0.20],
    ];
    let h = hash(11, 5, seed);
    let cover = CLOTH[(h % 10) as usize];
    let ink = if cover[0] + cover[1] > 0.9 {
        [0.12, 0.1, 0.12]
    } else {
        [0.92, 0.86, 0.62]
    };
    // text runs along the longer side of the face
    let (long, short) = if s.half[0] >= s.half[1] {
        (0, 1)
    } else {
        (1, 0)
    };
    let (a, b) = (s.uv[long] / s.half[long], s.uv[short]);
    let cloth = scale(
        cover,
        1.0 + 0.10 * fbm(s.uv[0], s.uv[1], 0.012, 2, fp, seed),
    );
    let fp_a = fp / s.half[long];
    let first = lerp(-0.9, -0.6, part(h, 1));
    let stripes = band(a, first, first + 0.06, fp_a)
        + band(a, first + 0.12, first + 0.18, fp_a)
        + band(a, 0.72, 0.80, fp_a);
    let (low, high) = (lerp(-0.5, -0.2, part(h, 2)), lerp(0.3, 0.6, part(h, 0)));
    let inside =
        band(a, low, high, fp_a) * band(b, -0.55 * s.half[short], 0.55 * s.half[short], fp);
    let title = inside
        * print(
            s.uv[long],
            b + 0.5 * s.half[short],
            1.1 * s.half[short].min(0.03),
            fp,
            h,
        );
    mix(cloth, ink, (0.8 * stripes + title).clamp(0.0, 0.9))
}

fn screen(s: &Surface, fp: f32, seed: u32) -> Rgb {
    let [u, v] = s.uv;
    // the screen is on both large faces: one of them is always at the wall
    if s.half[0].min(s.half[1]) < 0.05 || s.face / 2 == 2 {
        return [0.10, 0.10, 0.11];
    }
    let glass = band(u, -s.half[0] + 0.012, s.half[0] - 0.012, fp)
        * band(v, -s.half[1] + 0.02, s.half[1] - 0.012, fp);
    let desktop = mix(
        [0.16, 0.30, 0.48],
        [0.45, 0.30, 0.50],
        0.5 + 0.5 * v / s.half[1],
    );
    let mut colour = scale(desktop, 1.0 + 0.3 * fbm(u, v, 0.12, 3, fp, seed));
    for k in 0..3 {
        let h = hash(k, 3, seed);
        let (cx, cy) = (
            lerp(-0.5, 0.5, part(h, 0)) * s.half[0],
            lerp(-0.35, 0.35, part(h, 1)) * s.half[1],
        );
        let (w, t) = (lerp(0.35, 0.5, part(h, 2)) * s.half[0], 0.5 * s.half[1]);
        let pane = band(u - cx, -w, w, fp) * band(v - cy, -t, t, fp);
        let bar = band(v - cy, t - 0.018, t, fp);
        let dark = h.is_multiple_of(2);
        let (paper, ink) = if dark {
            ([0.10, 0.11, 0.14], [0.65, 0.85, 0.60])
        } else {
            ([0.93, 0.93, 0.90], [0.15, 0.15, 0.2])
        };
        let text = mix(paper, ink, print(u - cx, v - cy, 0.014, fp, h));
        colour = mix(colour, mix(text, [0.25, 0.45, 0.75], bar), pane);
    }
    mix([0.05, 0.05, 0.06], colour, glass)
}

fn keyboard(u: f32, v: f32, fp: f32, seed: u32) -> Rgb {
    let key = bands(u, 0.019, 0.08, 0.92, fp) * bands(v, 0.019, 0.08, 0.92, fp);
    let (i, x) = cell(u / 0.019);
    let (j, y) = cell(v / 0.019);
    let letter = disc(x - 0.4, y - 0.6, 0.22, fp / 0.019) * fade(0.019, fp);
    let tone = if hash(i, j, seed).is_multiple_of(9) {
        0.42
    } else {
        0.24
    };
    let cap = mix([tone; 3], [0.88; 3], letter);
    mix([0.09; 3], cap, key)
}

fn cardboard(s: &Surface, fp: f32, seed: u32) -> Rgb {
    let [u, v] = s.uv;
    let h = hash(1, 2, seed ^ face(s));
    let flute = noise(u, v * 0.02, 0.008, fp, seed);
    let board = scale(
        [0.68, 0.52, 0.35],
        1.0 + 0.06 * flute + 0.08 * fbm(u, v, 0.15, 3, fp, seed ^ face(s)),
    );
    let tape = band(u, -0.025, 0.025, fp);
    let mut colour = mix(board, [0.80, 0.70, 0.48], 0.8 * tape);
    let (cx, cy) = (
        lerp(-0.4, 0.3, part(h, 0)) * s.half[0],
        lerp(-0.4, 0.3, part(h, 1)) * s.half[1],
    );
    let label = band(u - cx, -0.07, 0.07, fp) * band(v - cy, -0.045, 0.045, fp);
    let bars = band(v - cy, -0.038, -0.01, fp) * bars(u - cx, fp, h);
    let text = print(u - cx, v - cy, 0.012, fp, h) * step(v - cy + 0.005, fp);
    colour = mix(
        colour,
        mix([0.95; 3], [0.08; 3], (bars + text).min(1.0)),
        label,
    );
    let stamp = print(u - 0.1, v - 0.02, 0.06, fp, h ^ 77)
        * band(v, 0.35 * s.half[1], 0.35 * s.half[1] + 0.06, fp);
    mix(colour, [0.25, 0.16, 0.12], 0.8 * stamp)
}

/// A bar code.
fn bars(u: f32, fp: f32, seed: u32) -> f32 {
    let (i, x) = cell(u / 0.005);
    let w = fade(0.01, fp);
    lerp(0.5, f32::from(u8::from(part(hash(i, 0, seed), 0) > x)), w)
}

/// Four layers of leaves, each a lattice with a different shear, over a dark ground.
fn leaves(u: f32, v: f32, fp: f32, seed: u32) -> Rgb {
    let mut colour: Rgb = [0.08, 0.20, 0.09];
    for layer in 0..4u32 {
        let tilt = 0.5 * layer as f32 - 0.75;
        let (x, y) = (u + tilt * v, v - 0.6 * tilt * u);
        let (leaf, h) = spots(
            x + 0.013 * layer as f32,
            y * 0.7,
            0.034,
            0.9,
            fp,
            seed ^ layer,
        );
        let green = mix([0.16, 0.40, 0.15], [0.52, 0.70, 0.30], part(h, 1));
        colour = mix(colour, green, leaf);
    }
    scale(colour, 1.0 + 0.2 * fbm(u, v, 0.05, 3, fp, seed))
}

fn pottery(u: f32, v: f32, tone: Rgb, fp: f32, seed: u32) -> Rgb {
    let glaze = scale(tone, 1.0 + 0.08 * fbm(u, v, 0.04, 3, fp, seed));
    let (mark, h) = spots(u, v, 0.035, 0.6, fp, seed);
    let paint = if h & 1 == 0 {
        [0.14, 0.2, 0.45]
    } else {
        [0.75, 0.3, 0.15]
    };
    mix(glaze, paint, 0.85 * mark)
}

fn ball(u: f32, v: f32, fp: f32, seed: u32) -> Rgb {
    let (i, x) = cell(u / 0.09);
    let (j, y) = cell(v / 0.07);
    let panel = hash(i, j, seed);
    let colour = match panel % 3 {
        0 => [0.85, 0.2, 0.15],
        1 => [0.92, 0.9, 0.85],
        _ => [0.15, 0.3, 0.65],
    };
    let seam = 1.0 - band(x, 0.04, 0.96, fp / 0.09) * band(y, 0.05, 0.95, fp / 0.07);
    mix(colour, [0.08; 3], seam * fade(0.07, fp))
}
