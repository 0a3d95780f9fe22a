//! The desk and the things on it.

use crate::furniture::{OAK, STEEL, WALNUT, WHITE, book_stack, table};
use crate::material::Material;
use crate::pattern::Rgb;
use crate::solid::Builder;

/// Drawers below a slab, on short feet, to stand under a desk.
fn drawers(b: &mut Builder, x: f64) {
    let body = b.paint(WHITE);
    b.block([x, 0.0, 0.33], [0.20, 0.30, 0.31], body);
    for k in 0..3 {
        let z = 0.14 + 0.19 * f64::from(k);
        let front = b.wood(OAK);
        b.block([x, -0.306, z], [0.185, 0.008, 0.085], front);
        let handle = b.paint(STEEL);
        b.rod(
            [x - 0.06, -0.33, z + 0.03],
            [x + 0.06, -0.33, z + 0.03],
            0.007,
            0.007,
            handle,
        );
    }
}

/// A desk of 1.6 m with the things on it. Front at -y.
pub(crate) fn desk(b: &mut Builder) {
    let top_z = 0.74;
    table(b, [0.80, 0.36], top_z);
    drawers(b, 0.52);
    monitor(b, 0.05, 0.16, top_z);
    let seed = b.seed();
    b.turned_block(
        [0.03, -0.14, top_z + 0.010],
        [0.20, 0.065, 0.010],
        0.05,
        Material::Keyboard { seed },
    );
    let mouse = b.paint([0.16, 0.16, 0.18]);
    b.ellipsoid([0.33, -0.15, top_z + 0.012], [0.03, 0.05, 0.018], mouse);
    for (x, y, turn) in [
        (-0.42, -0.16, 0.3),
        (-0.36, -0.05, -0.2),
        (-0.58, 0.06, 1.1),
        (0.55, -0.20, -0.45),
    ] {
        let seed = b.seed();
        let lift = 0.001 + 0.0012 * (x + 1.0);
        b.turned_block(
            [x, y, top_z + lift],
            [0.105, 0.148, 0.0008],
            turn,
            Material::Page { seed },
        );
    }
    book_stack(b, -0.62, 0.20, top_z, 6);
    book_stack(b, 0.62, 0.05, top_z + 0.004, 3);
    mug(b, 0.42, 0.02, top_z, [0.78, 0.30, 0.22]);
    mug(b, -0.27, 0.14, top_z, [0.30, 0.45, 0.62]);
    pens(b, 0.45, 0.24, top_z);
    globe(b, -0.36, 0.25, top_z);
    desk_lamp(b, 0.70, 0.24, top_z);
    for k in 0..6 {
        let seed = b.seed();
        let tone = [[0.85, 0.2, 0.2], [0.2, 0.5, 0.8], [0.9, 0.75, 0.2]][k % 3];
        let (x, z) = (
            0.20 + 0.043 * (k % 4) as f64,
            top_z + 0.02 + 0.04 * (k / 4) as f64,
        );
        b.turned_block(
            [x + 0.09, -0.27, z],
            [0.02; 3],
            0.3 * k as f64,
            Material::Painted { tone, seed },
        );
    }
}

fn monitor(b: &mut Builder, x: f64, y: f64, z: f64) {
    let stand = b.paint([0.15, 0.15, 0.16]);
    b.drum([x, y, z + 0.008], 0.12, 0.008, stand);
    b.block([x, y + 0.03, z + 0.12], [0.03, 0.015, 0.11], stand);
    let seed = b.seed();
    b.block(
        [x, y, z + 0.31],
        [0.29, 0.018, 0.175],
        Material::Screen { seed },
    );
}

fn mug(b: &mut Builder, x: f64, y: f64, z: f64, tone: Rgb) {
    let seed = b.seed();
    let clay = Material::Pottery { tone, seed };
    b.drum([x, y, z + 0.048], 0.04, 0.048, clay);
    b.rod(
        [x + 0.045, y, z + 0.025],
        [x + 0.055, y, z + 0.07],
        0.008,
        0.008,
        clay,
    );
}

fn pens(b: &mut Builder, x: f64, y: f64, z: f64) {
    let seed = b.seed();
    b.drum(
        [x, y, z + 0.05],
        0.036,
        0.05,
        Material::Pottery {
            tone: [0.25, 0.26, 0.3],
            seed,
        },
    );
    let tones = [
        [0.8, 0.2, 0.15],
        [0.2, 0.3, 0.7],
        [0.9, 0.8, 0.3],
        [0.1, 0.1, 0.1],
    ];
    for (k, tone) in tones.into_iter().enumerate() {
        let angle = 1.7 * k as f64;
        let (dx, dy) = (0.03 * libm::cos(angle), 0.03 * libm::sin(angle));
        let pen = b.paint(tone);
        b.rod(
            [x - dx * 0.4, y - dy * 0.4, z + 0.06],
            [x + dx, y + dy, z + 0.17],
            0.0045,
            0.003,
            pen,
        );
    }
}

fn globe(b: &mut Builder, x: f64, y: f64, z: f64) {
    let foot = b.wood(WALNUT);
    b.drum([x, y, z + 0.012], 0.06, 0.012, foot);
    b.rod([x, y, z + 0.02], [x, y, z + 0.08], 0.01, 0.008, foot);
    let seed = b.seed();
    b.ellipsoid([x, y, z + 0.17], [0.10; 3], Material::Ball { seed });
}

fn desk_lamp(b: &mut Builder, x: f64, y: f64, z: f64) {
    let metal = b.paint([0.70, 0.18, 0.14]);
    b.drum([x, y, z + 0.012], 0.07, 0.012, metal);
    b.rod(
        [x, y, z + 0.02],
        [x - 0.08, y + 0.02, z + 0.26],
        0.009,
        0.009,
        metal,
    );
    b.rod(
        [x - 0.08, y + 0.02, z + 0.26],
        [x - 0.22, y - 0.12, z + 0.40],
        0.009,
        0.009,
        metal,
    );
    b.rod(
        [x - 0.22, y - 0.12, z + 0.40],
        [x - 0.27, y - 0.17, z + 0.34],
        0.03,
        0.065,
        metal,
    );
}
