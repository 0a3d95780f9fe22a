//! The room: 5 x 4 x 2.7 m, furnished. World axes: x along the long walls, y along the short
//! ones, z up; the origin is the middle of the floor.

use std::f64::consts::{FRAC_PI_2, PI};

use garad_core::{Se3, So3};
use nalgebra::Vector3;

use crate::clothes::Cloth;
use crate::decor::Picture;
use crate::furniture as piece;
use crate::material::Material;
use crate::shape::Shape;
use crate::solid::{Builder, Solid};

/// Half the extent of the room along x, y, z, metres.
pub(crate) const HALF: [f64; 3] = [2.5, 2.0, 1.35];

/// Variants of the room, or the hall.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Furnishing {
    Room {
        /// Walls of one colour.
        plain_walls: bool,
        /// A table in the middle, where people walk in other scenes.
        middle_table: bool,
    },
    /// See [`crate::hall`].
    Hall,
}

/// Every solid of the room. The first one is the room itself.
pub(crate) fn furnished(furnishing: Furnishing, seed: u32) -> Vec<Solid> {
    let Furnishing::Room {
        plain_walls,
        middle_table,
    } = furnishing
    else {
        return crate::hall::furnished(seed);
    };
    let mut b = Builder::new(seed);
    let walls = Material::Walls {
        plain: plain_walls,
        seed: b.seed(),
    };
    let middle = Se3::new(So3::identity(), Vector3::new(0.0, 0.0, HALF[2]));
    b.solid(Shape::Room { half: HALF.into() }, middle, walls);
    ceiling(&mut b);
    desk_wall(&mut b);
    bookcase_wall(&mut b);
    sofa_wall(&mut b);
    window_wall(&mut b);
    floor(&mut b, middle_table);
    b.solids
}

/// A picture on a wall: centre, half size, direction of the wall.
fn picture(b: &mut Builder, middle: [f64; 3], half: [f64; 2], turn: f64, picture: Picture) {
    let seed = b.seed();
    let shape = [half[0], 0.012, half[1]];
    b.at(middle[0], middle[1], middle[2], turn);
    b.block([0.0; 3], shape, Material::Framed { picture, seed });
}

fn ceiling(b: &mut Builder) {
    b.at(0.0, 0.0, 0.0, 0.0);
    for x in [-1.6, -0.2, 1.2] {
        let beam = b.wood([0.38, 0.26, 0.17]);
        b.block([x, 0.0, 2.64], [0.07, HALF[1], 0.06], beam);
    }
    let cord = b.paint([0.2; 3]);
    b.rod([0.4, -0.1, 2.45], [0.4, -0.1, 2.69], 0.006, 0.006, cord);
    b.ellipsoid(
        [0.4, -0.1, 2.38],
        [0.20, 0.20, 0.12],
        Material::Shade {
            tone: [0.97, 0.93, 0.82],
        },
    );
}

/// +y: desk and chair, shelf, pinboard, wardrobe, pictures.
fn desk_wall(b: &mut Builder) {
    b.at(0.35, 1.60, 0.0, 0.0);
    crate::desk::desk(b);
    b.at(0.15, 1.05, 0.0, PI + 0.35);
    piece::chair(b);
    b.at(0.35, 1.88, 0.0, 0.0);
    let board = b.wood([0.68, 0.50, 0.31]);
    b.block([-0.05, 0.0, 1.62], [0.70, 0.11, 0.012], board);
    piece::books(b, [-0.72, 0.12], 0.10, 1.632, 0.28);
    piece::book_stack(b, 0.30, 0.0, 1.632, 4);
    piece::plant(b, 0.53, 0.0, 1.632, 0.30);
    let seed = b.seed();
    b.block(
        [-0.38, 0.10, 1.33],
        [0.42, 0.012, 0.21],
        Material::Pinboard { seed },
    );
    picture(b, [0.85, 1.985, 1.32], [0.20, 0.24], 0.0, Picture::Rings);
    picture(b, [1.55, 1.985, 1.55], [0.30, 0.42], 0.0, Picture::Poster);
    picture(b, [0.2, 1.985, 2.22], [0.45, 0.20], 0.0, Picture::Landscape);
    // the wardrobe in the corner to -x
    b.at(-1.75, 1.68, 0.0, 0.0);
    for x in [-0.30, 0.30] {
        let door = b.wood([0.58, 0.42, 0.27]);
        b.block([x, 0.0, 1.0], [0.296, 0.29, 1.0], door);
        let knob = b.paint([0.8, 0.7, 0.4]);
        b.ellipsoid([x * 0.15, -0.305, 1.0], [0.018; 3], knob);
    }
    let seed = b.seed();
    b.turned_block(
        [-0.1, 0.0, 2.12],
        [0.25, 0.20, 0.12],
        0.1,
        Material::Cardboard { seed },
    );
    picture(b, [-0.75, 1.985, 1.5], [0.22, 0.30], 0.0, Picture::Photos);
    picture(b, [-0.78, 1.985, 0.75], [0.20, 0.16], 0.0, Picture::Fields);
}

/// +x, of bricks: bookcase, door, pictures.
fn bookcase_wall(b: &mut Builder) {
    b.at(2.33, 0.55, 0.0, -FRAC_PI_2);
    piece::bookcase(b, 0.75, 1.95, [0.60, 0.42, 0.25]);
    b.at(2.46, -1.15, 0.0, -FRAC_PI_2);
    piece::door(b);
    picture(
        b,
        [2.485, -0.42, 1.60],
        [0.17, 0.24],
        -FRAC_PI_2,
        Picture::Fields,
    );
    picture(
        b,
        [2.485, 1.62, 1.55],
        [0.22, 0.30],
        -FRAC_PI_2,
        Picture::Map,
    );
    b.at(2.1, 1.65, 0.0, 0.0);
    piece::plant(b, 0.0, 0.0, 0.0, 1.0);
    b.at(2.25, -0.45, 0.0, 0.0);
    let basket = b.fabric(Cloth::Checked([0.55, 0.42, 0.26], [0.36, 0.25, 0.15]));
    b.drum([0.0, 0.0, 0.17], 0.15, 0.17, basket);
}

/// -x, papered: sofa, three pictures, lamp.
fn sofa_wall(b: &mut Builder) {
    b.at(-2.03, -0.25, 0.0, FRAC_PI_2);
    piece::sofa(b, 0.95);
    picture(
        b,
        [-2.485, -0.85, 1.55],
        [0.25, 0.32],
        FRAC_PI_2,
        Picture::Rings,
    );
    picture(
        b,
        [-2.485, -0.22, 1.62],
        [0.27, 0.22],
        FRAC_PI_2,
        Picture::Landscape,
    );
    picture(
        b,
        [-2.485, 0.40, 1.55],
        [0.25, 0.32],
        FRAC_PI_2,
        Picture::Poster,
    );
    b.at(-2.2, 1.05, 0.0, 0.0);
    piece::floor_lamp(b);
}

/// -y: window with curtains, radiator, sideboard, boxes.
fn window_wall(b: &mut Builder) {
    b.at(-0.6, -1.985, 1.5, PI);
    let seed = b.seed();
    b.block(
        [0.0, 0.0, 0.0],
        [0.8, 0.015, 0.6],
        Material::Window { seed },
    );
    for x in [-1.0, 1.0] {
        let curtain = Material::Curtain {
            tone: [0.72, 0.64, 0.48],
            seed: b.seed(),
        };
        b.block([x, -0.05, -0.10], [0.24, 0.03, 0.95], curtain);
    }
    let rail = b.wood([0.4, 0.28, 0.18]);
    b.rod(
        [-1.35, -0.06, 0.90],
        [1.35, -0.06, 0.90],
        0.016,
        0.016,
        rail,
    );
    b.at(-0.6, -1.93, 0.0, PI);
    for k in 0..9 {
        let fin = b.paint([0.86, 0.86, 0.84]);
        b.block(
            [-0.5 + 0.125 * f64::from(k), 0.0, 0.42],
            [0.052, 0.035, 0.28],
            fin,
        );
    }
    b.at(1.35, -1.76, 0.0, PI);
    piece::sideboard(b, 0.70);
    picture(b, [1.35, -1.985, 1.55], [0.45, 0.30], PI, Picture::Map);
    picture(b, [0.70, -1.985, 1.75], [0.13, 0.18], PI, Picture::Photos);
    b.at(-2.1, -1.62, 0.0, 0.2);
    piece::moving_boxes(b);
}

fn floor(b: &mut Builder, middle_table: bool) {
    b.at(0.1, -0.1, 0.0, 0.06);
    let seed = b.seed();
    b.block(
        [0.0, 0.0, 0.004],
        [1.25, 0.85, 0.004],
        Material::Rug { seed },
    );
    if middle_table {
        b.at(0.05, -0.15, 0.0, 0.15);
        piece::table(b, [0.45, 0.30], 0.46);
        piece::book_stack(b, 0.18, 0.08, 0.46, 4);
        for (x, y, turn) in [(-0.2, 0.0, 0.4), (-0.12, -0.12, -0.5)] {
            let seed = b.seed();
            b.turned_block(
                [x, y, 0.461 + 0.001 * turn],
                [0.105, 0.148, 0.0008],
                turn,
                Material::Page { seed },
            );
        }
        let bowl = Material::Pottery {
            tone: [0.3, 0.5, 0.55],
            seed: b.seed(),
        };
        b.drum([0.0, 0.18, 0.50], 0.10, 0.04, bowl);
    }
    // things along the edges
    b.at(-1.45, 1.12, 0.0, 0.7);
    piece::book_stack(b, 0.0, 0.0, 0.0, 5);
    b.at(1.72, 1.55, 0.0, 0.0);
    let toy = Material::Ball { seed: b.seed() };
    b.ellipsoid([0.0, 0.0, 0.12], [0.12; 3], toy);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn everything_is_inside_the_room() {
        let room = Furnishing::Room {
            plain_walls: false,
            middle_table: true,
        };
        for (furnishing, least) in [(room, 200), (Furnishing::Hall, 70)] {
            let solids = furnished(furnishing, 3);
            let Shape::Room { half } = solids[0].shape else {
                panic!("the room comes first");
            };
            assert!(solids.len() > least, "{} solids", solids.len());
            for solid in &solids[1..] {
                let [low, high] = solid.shape.bounds();
                let p = solid.world_from_solid * (0.5 * (low + high));
                assert!(
                    p.x.abs() < half.x && p.y.abs() < half.y && p.z > 0.0 && p.z < 2.0 * half.z,
                    "{solid:?}"
                );
            }
        }
    }
}
