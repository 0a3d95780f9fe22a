//! The hall: 30 x 20 x 8 m. Its patterns are on walls and ceiling, out of the depth sensor's range from
//! most of the camera's path; floor, columns and benches have little contrast.

pub(crate) mod patterns;

use std::f64::consts::{FRAC_PI_2, PI};

use garad_core::{Se3, So3};
use nalgebra::Vector3;

use self::patterns::Part;
use crate::decor::Picture;
use crate::material::Material;
use crate::pattern::Rgb;
use crate::shape::Shape;
use crate::solid::{Builder, Solid};

/// Half the extent of the hall along x, y, z, metres.
pub(crate) const HALF: [f64; 3] = [15.0, 10.0, 4.0];
/// Colour of the columns and benches.
const STONE: Rgb = [0.66, 0.65, 0.62];

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
