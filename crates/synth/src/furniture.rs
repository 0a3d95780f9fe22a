//! Pieces of furniture, each in its own frame: x to the right, y to the back, z up, the origin on
//! the floor below the middle. Lengths in metres.

use garad_core::Rng;

use crate::clothes::Cloth;
use crate::decor::Picture;
use crate::material::Material;
use crate::pattern::Rgb;
use crate::solid::Builder;

pub(crate) const OAK: Rgb = [0.68, 0.50, 0.31];
pub(crate) const WALNUT: Rgb = [0.40, 0.26, 0.17];
pub(crate) const WHITE: Rgb = [0.84, 0.83, 0.80];
pub(crate) const STEEL: Rgb = [0.42, 0.43, 0.46];

/// A table top on four legs.
pub(crate) fn table(b: &mut Builder, half: [f64; 2], height: f64) {
    let top = b.wood(OAK);
    b.block([0.0, 0.0, height - 0.02], [half[0], half[1], 0.02], top);
    for (sx, sy) in [(-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0), (1.0, 1.0)] {
        let leg = b.wood(OAK);
        let (x, y) = (sx * (half[0] - 0.05), sy * (half[1] - 0.05));
        let h = 0.5 * (height - 0.04);
        b.block([x, y, h], [0.028, 0.028, h], leg);
    }
}

/// A seat, four legs, a back of slats.
pub(crate) fn chair(b: &mut Builder) {
    let seat = b.fabric(Cloth::Checked([0.45, 0.16, 0.15], [0.75, 0.62, 0.40]));
    b.block([0.0, 0.0, 0.455], [0.21, 0.21, 0.025], seat);
    for (x, y, top) in [
        (-0.18, -0.18, 0.43),
        (0.18, -0.18, 0.43),
        (-0.18, 0.18, 0.92),
        (0.18, 0.18, 0.92),
    ] {
        let leg = b.wood(WALNUT);
        b.rod([x, y, 0.015], [x, y, top], 0.018, 0.016, leg);
    }
    for z in [0.62, 0.74, 0.86] {
        let slat = b.wood(WALNUT);
        b.block([0.0, 0.18, z], [0.175, 0.010, 0.032], slat);
    }
}

/// A row of upright books from `x0` to `x1` on a board at `z`, their backs at `y`.
pub(crate) fn books(b: &mut Builder, [x0, x1]: [f64; 2], y: f64, z: f64, tallest: f64) {
    let mut rng = Rng::keyed(u64::from(b.seed()), &[1]);
    let mut x = x0;
    while x < x1 - 0.02 {
        let width = rng.range(0.018, 0.055).min(x1 - x);
        let (height, depth) = (tallest * rng.range(0.68, 0.98), rng.range(0.14, 0.20));
        let seed = b.seed();
        if rng.uniform() < 0.9 {
            b.block(
                [x + 0.5 * width, y - 0.5 * depth, z + 0.5 * height],
                [0.5 * width - 0.001, 0.5 * depth, 0.5 * height],
                Material::Book { seed },
            );
        }
        x += width;
    }
}

/// A stack of books, the largest at the bottom.
pub(crate) fn book_stack(b: &mut Builder, x: f64, y: f64, z: f64, count: u32) {
    let mut rng = Rng::keyed(u64::from(b.seed()), &[2]);
    let mut top = z;
    for k in 0..count {
        let shrink = 1.0 - 0.07 * f64::from(k);
        let h = rng.range(0.009, 0.02);
        let seed = b.seed();
        b.turned_block(
            [
                x + rng.range(-0.01, 0.01),
                y + rng.range(-0.01, 0.01),
                top + h,
            ],
            [0.12 * shrink, 0.085 * shrink, h],
            rng.range(-0.35, 0.35),
            Material::Book { seed },
        );
        top += 2.0 * h;
    }
}

/// Sides, boards and five shelves full of books, vases and boxes. Front at -y.
pub(crate) fn bookcase(b: &mut Builder, half_width: f64, height: f64, tone: Rgb) {
    let depth = 0.14;
    for side in [-1.0, 1.0] {
        let board = b.wood(tone);
        b.block(
            [side * half_width, 0.0, 0.5 * height],
            [0.012, depth, 0.5 * height],
            board,
        );
    }
    let back = b.wood(tone);
    b.block(
        [0.0, depth - 0.006, 0.5 * height],
        [half_width - 0.012, 0.006, 0.5 * height],
        back,
    );
    // where the books end on each shelf, as a share of its width
    let cuts = [0.62, 0.40, 0.75, 0.30, 0.55];
    let levels = cuts.len();
    let pitch = (height - 0.06) / levels as f64;
    for level in 0..=levels {
        let z = 0.05 + pitch * level as f64;
        let board = b.wood(tone);
        b.block(
            [0.0, -0.006, z],
            [half_width - 0.012, depth - 0.006, 0.011],
            board,
        );
        if level == levels {
            break;
        }
        let (left, right) = (-half_width + 0.02, half_width - 0.02);
        let (base, room) = (z + 0.011, pitch - 0.03);
        let cut = left + (right - left) * cuts[level];
        match level % 3 {
            0 => {
                books(b, [left, cut], 0.11, base, room);
                book_stack(b, cut + 0.15, -0.01, base, 4);
            }
            1 => {
                books(b, [cut, right], 0.11, base, room);
                vase(b, left + 0.12, 0.0, base);
            }
            _ => {
                books(b, [left, cut], 0.11, base, room);
                let seed = b.seed();
                b.block(
                    [0.5 * (cut + right) + 0.01, -0.01, base + 0.09],
                    [0.4 * (right - cut), 0.1, 0.09],
                    Material::Cardboard { seed },
                );
            }
        }
    }
}

fn vase(b: &mut Builder, x: f64, y: f64, z: f64) {
    let seed = b.seed();
    let clay = Material::Pottery {
        tone: [0.82, 0.76, 0.66],
        seed,
    };
    b.ellipsoid([x, y, z + 0.08], [0.065, 0.065, 0.085], clay);
    b.drum([x, y, z + 0.18], 0.03, 0.035, clay);
}

/// A pot and a crown of leaves.
pub(crate) fn plant(b: &mut Builder, x: f64, y: f64, z: f64, size: f64) {
    let seed = b.seed();
    let clay = Material::Pottery {
        tone: [0.72, 0.42, 0.30],
        seed,
    };
    b.drum([x, y, z + 0.16 * size], 0.15 * size, 0.16 * size, clay);
    let mut rng = Rng::keyed(u64::from(seed), &[3]);
    for k in 0..9 {
        let angle = f64::from(k) * 2.4;
        let (dx, dy) = (
            libm::cos(angle) * 0.16 * size,
            libm::sin(angle) * 0.16 * size,
        );
        let up = size * rng.range(0.45, 0.95);
        let seed = b.seed();
        let r = size * rng.range(0.11, 0.17);
        b.ellipsoid(
            [x + dx, y + dy, z + up],
            [r, r, 1.3 * r],
            Material::Leaves { seed },
        );
    }
}

/// Seat, back, arms and three cushions. Front at -y.
pub(crate) fn sofa(b: &mut Builder, half_width: f64) {
    let tone = Cloth::Plain([0.30, 0.38, 0.42]);
    for (centre, half) in [
        ([0.0, 0.0, 0.22], [half_width, 0.42, 0.16]),
        ([0.0, 0.34, 0.58], [half_width, 0.10, 0.24]),
        ([-half_width + 0.09, 0.0, 0.44], [0.09, 0.42, 0.14]),
        ([half_width - 0.09, 0.0, 0.44], [0.09, 0.42, 0.14]),
    ] {
        let cover = b.fabric(tone);
        b.block(centre, half, cover);
    }
    let cloths = [
        Cloth::Strewn([0.85, 0.78, 0.62], [0.72, 0.22, 0.20]),
        Cloth::Striped([0.20, 0.34, 0.52], [0.88, 0.85, 0.78]),
        Cloth::Checked([0.62, 0.45, 0.14], [0.25, 0.30, 0.24]),
    ];
    for (k, cloth) in cloths.into_iter().enumerate() {
        let cushion = b.fabric(cloth);
        let x = half_width * (-0.55 + 0.55 * k as f64);
        b.ellipsoid([x, 0.17, 0.53], [0.21, 0.10, 0.17], cushion);
    }
    let throw = b.fabric(Cloth::Checked([0.20, 0.42, 0.38], [0.85, 0.80, 0.66]));
    b.block(
        [0.45 * half_width, -0.08, 0.383],
        [0.26, 0.345, 0.004],
        throw,
    );
}

/// A low cabinet with doors, knobs and things on it. Front at -y.
pub(crate) fn sideboard(b: &mut Builder, half_width: f64) {
    let body = b.wood(WALNUT);
    b.block([0.0, 0.0, 0.40], [half_width, 0.21, 0.34], body);
    let doors = 3;
    for k in 0..doors {
        let w = half_width / f64::from(doors);
        let x = -half_width + w * (2.0 * f64::from(k) + 1.0);
        let door = b.wood([0.50, 0.34, 0.22]);
        b.block([x, -0.215, 0.40], [w - 0.012, 0.008, 0.31], door);
        let knob = b.paint(STEEL);
        b.ellipsoid([x + 0.7 * w, -0.235, 0.45], [0.014; 3], knob);
    }
    vase(b, -0.6 * half_width, 0.0, 0.74);
    book_stack(b, 0.1 * half_width, -0.02, 0.74, 5);
    plant(b, 0.7 * half_width, 0.0, 0.74, 0.38);
    let seed = b.seed();
    b.turned_block(
        [-0.15, 0.05, 0.84],
        [0.10, 0.008, 0.10],
        0.2,
        Material::Framed {
            picture: Picture::Photos,
            seed,
        },
    );
}

/// A floor lamp.
pub(crate) fn floor_lamp(b: &mut Builder) {
    let metal = b.paint(STEEL);
    b.drum([0.0, 0.0, 0.012], 0.15, 0.012, metal);
    b.rod([0.0, 0.0, 0.03], [0.0, 0.0, 1.5], 0.013, 0.013, metal);
    b.drum(
        [0.0, 0.0, 1.58],
        0.20,
        0.14,
        Material::Shade {
            tone: [0.95, 0.88, 0.70],
        },
    );
}

/// Cardboard boxes.
pub(crate) fn moving_boxes(b: &mut Builder) {
    for (centre, half, turn) in [
        ([0.0, 0.0, 0.17], [0.26, 0.19, 0.17], 0.12),
        ([0.03, 0.02, 0.47], [0.19, 0.16, 0.13], -0.25),
        ([0.46, -0.08, 0.13], [0.17, 0.14, 0.13], 0.5),
    ] {
        let seed = b.seed();
        b.turned_block(centre, half, turn, Material::Cardboard { seed });
    }
}

/// A door leaf with panels, frame and handle, in a wall at +y.
pub(crate) fn door(b: &mut Builder) {
    let leaf = b.wood([0.62, 0.44, 0.28]);
    b.block([0.0, 0.0, 1.0], [0.42, 0.03, 1.0], leaf);
    for (z, h) in [(0.45, 0.32), (1.4, 0.45)] {
        for x in [-0.2, 0.2] {
            let panel = b.wood([0.54, 0.37, 0.23]);
            b.block([x, -0.03, z], [0.15, 0.012, h], panel);
        }
    }
    for x in [-0.46, 0.46] {
        let jamb = b.paint(WHITE);
        b.block([x, 0.0, 1.02], [0.045, 0.045, 1.02], jamb);
    }
    let lintel = b.paint(WHITE);
    b.block([0.0, 0.0, 2.08], [0.505, 0.045, 0.045], lintel);
    let handle = b.paint(STEEL);
    b.rod(
        [0.35, -0.06, 1.03],
        [0.24, -0.06, 1.03],
        0.011,
        0.009,
        handle,
    );
}
