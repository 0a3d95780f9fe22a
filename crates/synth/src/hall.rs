//! The hall: 30 x 20 x 8 m. Its patterns are on walls and ceiling, out of the depth sensor's range from
//! most of the camera's path; floor, columns and benches have little contrast.

use std::f64::consts::{FRAC_PI_2, PI};

use garad_core::{Se3, So3};
use nalgebra::Vector3;

use crate::decor::{self, Picture};
use crate::material::Material;
use crate::pattern::{Rgb, band, cell, fbm, hash, lerp, mix, part, scale, spots};
use crate::shape::{Shape, Surface};
use crate::solid::{Builder, Solid};
use crate::walls::wall;

/// Half the extent of the hall along x, y, z, metres.
pub(crate) const HALF: [f64; 3] = [15.0, 10.0, 4.0];
/// Patterns of a room, made for 1 to 3 m, are enlarged by this factor for 8 to 25 m.
const ENLARGED: f32 = 8.0;
/// Colour of the columns and benches.
const STONE: Rgb = [0.66, 0.65, 0.62];

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

/// Every solid of the hall. The first one is the hall itself.
pub(crate) fn furnished(seed: u32) -> Vec<Solid> {
    let mut b = Builder::new(seed);
    let middle = Se3::new(So3::identity(), Vector3::new(0.0, 0.0, HALF[2]));
    let shell = part_of(&mut b, Part::Shell);
    b.solid(Shape::Room { half: HALF.into() }, middle, shell);
    for (k, x) in [-12.0, -7.2, -2.4, 2.4, 7.2, 12.0].into_iter().enumerate() {
        hung(&mut b, [x, 9.97], PI, k);
        hung(&mut b, [x, -9.97], 0.0, k + 2);
    }
    for (k, y) in [-7.2, -2.4, 2.4, 7.2].into_iter().enumerate() {
        hung(&mut b, [14.97, y], FRAC_PI_2, k + 1);
        hung(&mut b, [-14.97, y], -FRAC_PI_2, k + 4);
    }
    b.at(0.0, 0.0, 0.0, 0.0);
    for x in [-9.0, -3.0, 3.0, 9.0] {
        for y in [-2.6, 2.6] {
            let stone = b.paint(STONE);
            b.drum([x, y, HALF[2]], 0.30, HALF[2], stone);
            let foot = b.paint(STONE);
            b.block([x, y, 0.15], [0.42, 0.42, 0.15], foot);
        }
    }
    for (x, y, turn) in [
        (0.0, 3.4, 0.1),
        (-6.0, 2.2, 0.9),
        (6.0, 2.2, -0.8),
        (0.3, -3.4, 0.0),
    ] {
        b.at(x, y, 0.0, turn);
        let seat = b.paint(STONE);
        b.block([0.0, 0.0, 0.42], [0.80, 0.22, 0.04], seat);
        for side in [-0.6, 0.6] {
            let leg = b.paint(STONE);
            b.block([side, 0.0, 0.19], [0.06, 0.18, 0.19], leg);
        }
    }
    b.at(0.0, 0.0, 0.0, 0.0);
    for at in crate::light::HALL_LAMPS.iter().map(|lamp| lamp.at) {
        let tone = [0.97, 0.93, 0.82];
        b.ellipsoid(
            [at[0], at[1], at[2] + 0.2],
            [0.5, 0.5, 0.12],
            Material::Shade { tone },
        );
    }
    b.solids
}

fn part_of(b: &mut Builder, part: Part) -> Material {
    let seed = b.seed();
    Material::Hall { part, seed }
}

/// A banner 3 m high and a window or a smaller banner above it, on a wall.
fn hung(b: &mut Builder, [x, y]: [f64; 2], turn: f64, k: usize) {
    const BELOW: [Picture; 6] = [
        Picture::Poster,
        Picture::Rings,
        Picture::Map,
        Picture::Fields,
        Picture::Photos,
        Picture::Landscape,
    ];
    b.at(x, y, 0.0, turn);
    let banner = part_of(b, Part::Banner(BELOW[k % BELOW.len()]));
    b.block([0.0, 0.0, 2.4], [1.5, 0.03, 1.7], banner);
    let above = match k % 3 {
        0 => Part::Banner(BELOW[(k + 2) % BELOW.len()]),
        _ => Part::Window,
    };
    let above = part_of(b, above);
    b.block([0.0, 0.0, 5.9], [1.7, 0.03, 1.3], above);
}
