//! Patterns of the hall: those of the room, enlarged, on walls and banners; floor and ceiling of its own.

use crate::decor::{self, Picture};
use crate::pattern::{Rgb, band, cell, fbm, hash, lerp, mix, part, scale, spots};
use crate::shape::Surface;
use crate::walls::wall;

/// Patterns of a room, made for 1 to 3 m, are enlarged by this factor for 8 to 25 m.
const ENLARGED: f32 = 8.0;

/// What the enlarged patterns show.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Part {
    /// Walls, floor and ceiling, by face.
    Shell,
    /// A picture as large as a banner.
    Banner(Picture),
    /// A window.
    Window,
}

/// Colour of a point of the hall.
pub(crate) fn colour(part: Part, s: &Surface, fp: f32, seed: u32) -> Rgb {
    let large = Surface {
        uv: s.uv.map(|x| x / ENLARGED),
        half: s.half.map(|x| x / ENLARGED),
        ..*s
    };
    match part {
        Part::Shell if s.face == 4 => floor(s, fp, seed),
        Part::Shell if s.face == 5 => ceiling(s, fp, seed),
        Part::Shell => wall(&large, fp / ENLARGED, seed),
        Part::Banner(picture) => decor::framed(&large, picture, fp / ENLARGED, seed),
        Part::Window => decor::window(&large, fp / ENLARGED, seed),
    }
}

/// Slabs of 1 m with faint joints, a darker square in a corner of every fourth, and faint chips of stone: more of
/// them, and stronger, in a strip along the camera's path, 2 m wide.
fn floor(s: &Surface, fp: f32, seed: u32) -> Rgb {
    let [u, v] = s.uv;
    let ((i, x), (j, y)) = (cell(u), cell(v));
    let h = hash(i, j, seed);
    let slab = 0.97 + 0.06 * part(h, 0);
    let cloud = fbm(u, v, 0.7, 3, fp, seed);
    let joint = 1.0 - band(x, 0.004, 0.996, fp) * band(y, 0.004, 0.996, fp);
    let corner = band(x, 0.0, 0.14, fp) * band(y, 0.0, 0.14, fp);
    let square = if part(h, 1) < 0.25 { corner } else { 0.0 };
    // distance from an ellipse half a metre inside the path, approximately
    let across_m = 6.4 * libm::hypotf(u / 7.5, v / 5.5) - 6.4;
    let strip = band(across_m, -1.0, 1.0, fp);
    let (chip, h) = spots(u, v, 0.14, lerp(0.25, 0.8, strip), fp, seed ^ 2);
    let chip = chip * lerp(0.24, 0.6, strip) * (part(h, 1) - 0.5);
    let stone = slab * (1.0 + 0.03 * cloud + chip) * (1.0 - 0.06 * strip);
    scale(
        [0.60, 0.60, 0.58],
        stone * (1.0 - 0.12 * joint) * (1.0 - 0.22 * square),
    )
}

/// Coffers of 2.5 m between dark ribs, each of another tone.
fn ceiling(s: &Surface, fp: f32, seed: u32) -> Rgb {
    let ((i, x), (j, y)) = (cell(s.uv[0] / 2.5), cell(s.uv[1] / 2.5));
    let tone = 0.75 + 0.25 * part(hash(i, j, seed), 0);
    let field = band(x * 2.5, 0.15, 2.35, fp) * band(y * 2.5, 0.15, 2.35, fp);
    let inner = band(x * 2.5, 0.7, 1.8, fp) * band(y * 2.5, 0.7, 1.8, fp);
    let coffer = mix(
        scale([0.88, 0.86, 0.80], tone),
        [0.48, 0.56, 0.60],
        0.7 * inner,
    );
    mix([0.36, 0.28, 0.20], coffer, field)
}
