//! A renderer in f32 as GPUs have it: keys that are sorted, lists per tile, sums per tile. Its faults show only at
//! size, so they are looked for in cases that `garad golden make` makes.

use std::collections::BTreeMap;

use garad_conformance::Outputs;
use garad_conformance::make::{SceneKind, SceneOptions, splatting};
use garad_core::Par;
use garad_golden::Case;
use garad_golden::judge::judge;
use garad_golden::verdict::Outcome;

use super::answers::{Given, shaped};
use super::blend::{Images, finish, paint, pixel_backward, walk};
use super::faults::faults;
use super::number::N;
use super::raster::{column, gradients_out, images_out, rows, scene};
use super::rendering::{CELL, Density, How, Walk};
use super::splats::{ByPixel, Splat};

faults! {
    "raster" {
        SortBy16Bits "port"
        DepthIn4096Steps "port"
        TiesReversed "port"
        OneBatch "port"
        ListsTooShort "port"
        TileInOneByte "port"
        LastRowOfTilesLeftOut "port"
        TileEndsWithItsFirstPixel "port"
        RadiusCapped "port"
        CountInOneByte "port"
    }
    "raster_backward" {
        AtomicsLost "port"
        EightTilesAtMost "port"
        SumsInHalf "port"
        OneBatchBackward "port"
    }
}

type Number = N<false, false>;

/// Splats of a batch.
const BATCH: usize = 256;
/// Pixels of the largest radius, where it is capped.
const CAP_PX: i64 = 24;

const PLAIN: How = How {
    fault: None,
    walk: Walk::Rows,
    density: Density::Slanted,
    exp_ulp: 0,
};

/// Visible splats by their keys.
fn sorted(splats: &[Splat<false, false>], fault: Option<Fault>) -> Vec<usize> {
    let key = |i: usize| -> u32 {
        let depth = splats[i].depth_m.0;
        match fault {
            Some(Fault::SortBy16Bits) => depth.to_bits() >> 16,
            #[allow(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "up to 4096"
            )]
            Some(Fault::DepthIn4096Steps) => (depth * 512.0) as u32,
            _ => depth.to_bits(),
        }
    };
    let mut order: Vec<usize> = (0..splats.len()).filter(|&i| splats[i].visible).collect();
    if fault == Some(Fault::TiesReversed) {
        order.reverse();
    }
    order.sort_by_key(|&i| key(i));
    order
}

fn index(v: i64) -> usize {
    usize::try_from(v).expect("not negative")
}

struct Tiles {
    columns: usize,
    lists: Vec<Vec<usize>>,
}

impl Tiles {
    fn new(
        splats: &[Splat<false, false>],
        order: &[usize],
        size: [i64; 2],
        fault: Option<Fault>,
    ) -> Self {
        let [columns, rows] = size.map(|n| index((n + CELL - 1) / CELL));
        let mut lists = vec![Vec::new(); columns * rows];
        let mut room = match fault {
            Some(Fault::ListsTooShort) => 3 * order.len(),
            _ => usize::MAX,
        };
        for &i in order {
            let [x0, y0, x1, y1] = splats[i].footprint.map(|v| index((v + CELL - 1) / CELL));
            for tile in (y0..y1).flat_map(|y| (x0..x1).map(move |x| y * columns + x)) {
                let tile = match fault {
                    Some(Fault::TileInOneByte) => tile % 256,
                    _ => tile,
                };
                if room > 0 {
                    lists[tile].push(i);
                    room -= 1;
                }
            }
        }
        let whole = index(size[1] / CELL) * columns;
        for (tile, list) in lists.iter_mut().enumerate() {
            match fault {
                Some(Fault::OneBatch) => list.truncate(BATCH),
                Some(Fault::CountInOneByte) => list.truncate(list.len() % 256),
                Some(Fault::LastRowOfTilesLeftOut) if tile >= whole => list.clear(),
                Some(Fault::TileEndsWithItsFirstPixel) => {
                    let at = [tile % columns, tile / columns]
                        .map(|k| i64::try_from(k).unwrap_or(0) * CELL);
                    let first = walk(splats, list, (at[0], at[1]), &PLAIN);
                    // Done is a pixel that lets no more light through than this.
                    if first.left.0 < 1e-3 {
                        list.truncate(index(i64::from(first.last)));
                    }
                }
                _ => {}
            }
        }
        Self { columns, lists }
    }
}

fn half(v: Number) -> Number {
    let bits = v.0.to_bits();
    let kept = bits.wrapping_add(0x0fff + ((bits >> 13) & 1)) & !0x1fff;
    N(f32::from_bits(kept))
}

fn answer(case: Given<'_>, fault: Option<Fault>, how: &How) -> Outputs {
    let (gaussians, view, mut splats) = scene::<false, false>(case, how);
    if fault == Some(Fault::RadiusCapped) {
        for s in &mut splats {
            s.radius = s.radius.min(CAP_PX);
        }
    }
    let order = sorted(&splats, fault);
    let tiles = Tiles::new(&splats, &order, view.size, fault);
    let background = rows(case, "background")[0];
    let pixels = || (0..view.size[1]).flat_map(|y| (0..view.size[0]).map(move |x| (x, y)));
    let tile_of = |(x, y): (i64, i64)| index(y / CELL) * tiles.columns + index(x / CELL);
    if case.0.stage() == "raster" {
        let mut images = Images::default();
        for at in pixels() {
            let pixel = walk(&splats, &tiles.lists[tile_of(at)], at, how);
            paint(&splats, &pixel, &background, how, &mut images);
        }
        return images_out(&splats, &order, images);
    }
    let color = rows(case, "upstream_color");
    let (depth, opacity) = (
        column(case, "upstream_depth"),
        column(case, "upstream_opacity"),
    );
    let mut of_tile: BTreeMap<usize, Vec<(i64, i64)>> = BTreeMap::new();
    pixels().for_each(|at| of_tile.entry(tile_of(at)).or_default().push(at));
    let mut total = vec![ByPixel::default(); splats.len()];
    let mut tiles_of = vec![0; splats.len()];
    let mut part = vec![ByPixel::default(); splats.len()];
    for (tile, pixels) in of_tile {
        let list = &tiles.lists[tile];
        for (x, y) in pixels {
            let k = index(y * view.size[0] + x);
            let pixel = walk(&splats, list, (x, y), how);
            let up = (color[k], depth[k], opacity[k]);
            pixel_backward(&splats, &pixel, up, &background, false, how, &mut part);
            if fault == Some(Fault::SumsInHalf) {
                for &i in list {
                    part[i].color = part[i].color.map(half);
                    part[i].opacity = half(part[i].opacity);
                }
            }
        }
        for (rank, &i) in list.iter().enumerate() {
            let sum = std::mem::take(&mut part[i]);
            tiles_of[i] += 1;
            let lost = match fault {
                Some(Fault::AtomicsLost) => i % 1000 == 7 && tiles_of[i] % 2 == 1,
                Some(Fault::EightTilesAtMost) => tiles_of[i] > 8,
                Some(Fault::OneBatchBackward) => rank >= BATCH,
                _ => false,
            };
            if lost {
                continue;
            }
            total[i].add(&sum);
        }
    }
    finish(&splats, &mut total, how);
    gradients_out(&gaussians, &view, &splats, &total, false, how)
}

/// More than 256 tiles, the last row of them cut, and lists of several batches.
fn made(gaussians: usize) -> Vec<Case> {
    let options = SceneOptions {
        kind: SceneKind::Stack,
        gaussians,
        size: [272, 250],
        degree: 1,
        seed: 11,
    };
    let root = tempfile::tempdir().expect("a folder");
    let both = splatting(&options, Par::new(2)).expect("a scene");
    let load = |made: &garad_conformance::make::Made| {
        let folder = made.write(root.path()).expect("written");
        Case::load(&folder).expect("as written")
    };
    both.iter().map(load).collect()
}

fn failure(case: &Case, fault: Option<Fault>, how: &How) -> Option<String> {
    let answer = answer(Given(case.inputs()), fault, how);
    let verdict = judge(case, &shaped(case, &answer), false);
    let text = || garad_golden::report::table(std::slice::from_ref(&verdict));
    (verdict.outcome != Outcome::Pass).then(text)
}

fn faults_at_size(gaussians: usize) {
    let cases = made(gaussians);
    let entries = cases[0]
        .inputs()
        .tensor("tile_ranges")
        .expect("beside the case")
        .i64();
    let longest = entries.chunks(2).map(|r| r[1] - r[0]).max();
    assert!(
        entries.len() > 2 * 256 && longest > Some(2 * 256),
        "{longest:?} in a tile"
    );
    let mut wrong = Vec::new();
    for case in &cases {
        for (density, exp_ulp) in [
            (Density::Slanted, 0),
            (Density::Plain, 4),
            (Density::Product, 2),
        ] {
            let how = How {
                density,
                exp_ulp,
                ..PLAIN
            };
            let alarm = failure(case, None, &how);
            wrong.extend(alarm.map(|report| format!("false alarm, {how:?}: {report}")));
        }
    }
    for port in FAULTY_PORTS {
        let case = cases.iter().find(|c| c.stage() == port.stage);
        if failure(case.expect("made"), Some(port.fault), &PLAIN).is_none() {
            wrong.push(format!("{:?} is not found by {}", port.fault, port.stage));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_fault_at_size_is_caught_at_its_stage() {
    faults_at_size(4000);
}

#[test]
#[ignore = "a minute: 40 000 Gaussians"]
fn faults_are_caught_in_a_larger_scene() {
    faults_at_size(40_000);
}
