//! What a tile loop of every kind needs: the splats in their order, the loop itself, and where a block's pixels go.

use std::ops::Range;

use garad_core::{GaussianMap, Par};

use super::bin::{Columns, Entry, sorted};
use super::forward::{TilePixels, corner};
use super::splat::Splat;
use crate::options::{Include, RenderOptions};
use crate::project::{FOOTPRINT_CELL_PX, project_range};
use crate::splat::Projected;
use crate::view::View;

/// Gaussians of one task.
const CHUNK: usize = 1024;
/// Tiles here are the footprint's cells, so that a footprint covers a tile or misses it.
pub(super) const TILE_PX: usize = FOOTPRINT_CELL_PX;
/// Ranks are kept as f32 and exact below this.
const MAX_SPLATS: usize = 1 << 24;

/// Other options and larger maps are left to the reference.
pub(super) fn can_serve(map: &GaussianMap<f32>, options: &RenderOptions) -> bool {
    options.tile_px == TILE_PX && map.len() < MAX_SPLATS
}

/// The visible splats in places of their own, and the numbers of these front to back, as the reference sorts them.
fn project_places(
    map: &GaussianMap<f32>,
    view: &View<f32>,
    include: Include,
    par: Par,
) -> (Vec<Projected<f32>>, Vec<u32>) {
    // Every chunk has places of its own, of which it fills the first.
    let mut places = vec![Projected::ZERO; map.len()];
    let mut filled: Vec<_> = places.chunks_mut(CHUNK).map(|chunk| (0, chunk)).collect();
    par.for_each_chunk_mut(&mut filled, 1, |chunk, filled| {
        for (count, places) in filled {
            let first = chunk * CHUNK;
            let splats = project_range(map, view, include, first..first + places.len());
            for (place, splat) in places.iter_mut().zip(splats) {
                *place = splat;
                *count += 1;
            }
        }
    });
    // Numbers of places ascend with the rows of the map.
    let numbered = filled.iter().zip((0u32..).step_by(CHUNK));
    let numbered = numbered.flat_map(|((count, places), first)| {
        let keys = places[..*count].iter().map(|s| s.depth_m.to_bits());
        keys.zip(first..)
    });
    let order = sorted(numbered.collect());
    (places, order)
}

/// What the pixels read of the visible splats, front to back.
pub(super) fn splats_sorted(
    map: &GaussianMap<f32>,
    view: &View<f32>,
    include: Include,
    par: Par,
) -> Vec<Splat> {
    let (places, order) = project_places(map, view, include, par);
    let mut splats = vec![Splat::default(); order.len()];
    par.for_each_chunk_mut(&mut splats, CHUNK, |chunk, splats| {
        for (splat, &number) in splats.iter_mut().zip(&order[chunk * CHUNK..]) {
            *splat = Splat::new(&places[number as usize]);
        }
    });
    splats
}

/// The visible splats front to back, and what the pixels read of them.
pub(super) fn project_sorted(
    map: &GaussianMap<f32>,
    view: &View<f32>,
    include: Include,
    par: Par,
) -> (Vec<Projected<f32>>, Vec<Splat>) {
    // What stays is given room before what goes, so that no hole is left between.
    let mut projected = Vec::with_capacity(map.len());
    let mut splats = Vec::with_capacity(map.len());
    let (places, order) = project_places(map, view, include, par);
    projected.resize(order.len(), Projected::ZERO);
    splats.resize(order.len(), Splat::default());
    let pieces = projected.chunks_mut(CHUNK).zip(splats.chunks_mut(CHUNK));
    let mut pieces: Vec<_> = pieces.zip(order.chunks(CHUNK)).collect();
    par.for_each_chunk_mut(&mut pieces, 1, |_, pieces| {
        for ((projected, splats), order) in pieces {
            // Copied first, in a loop that waits for many rows at a time.
            for (projected, &number) in projected.iter_mut().zip(*order) {
                *projected = places[number as usize];
            }
            for (splat, projected) in splats.iter_mut().zip(projected.iter()) {
                *splat = Splat::new(projected);
            }
        }
    });
    (projected, splats)
}

/// Bins and blends the tiles of a band that have splats; `write` gets each with its first column.
pub(super) fn blend_band<const COLOR: bool>(
    splats: &[Splat],
    list: &[Entry],
    band: usize,
    [width, height]: [usize; 2],
    mut write: impl FnMut(&TilePixels, usize),
) {
    let columns = Columns::new(splats, list, width.div_ceil(TILE_PX));
    for column in 0..width.div_ceil(TILE_PX) {
        let entries = columns.list(column);
        if entries.is_empty() {
            continue;
        }
        let pixels = TilePixels::composite::<COLOR>(
            entries.iter().map(|&place| &columns.splats[place as usize]),
            [(column * TILE_PX) as f32, (band * TILE_PX) as f32],
            [width - column * TILE_PX, height],
        );
        write(&pixels, column * TILE_PX);
    }
}

/// Where the two rows of block `i` of the tile that begins in column `x0` lie in a band, as far as they are inside,
/// and the first lane of each.
#[inline(always)]
pub(super) fn rows_of(
    i: usize,
    x0: usize,
    [width, height]: [usize; 2],
) -> impl Iterator<Item = (Range<usize>, usize)> {
    let (column, row) = corner(i);
    let x = x0 + column;
    let rows = [(row, 0), (row + 1, 4)].into_iter();
    rows.filter(move |(y, _)| *y < height && x < width)
        .map(move |(y, half)| (y * width + x..y * width + (x + 4).min(width), half))
}

/// Four values, or as many as there is room for.
#[inline(always)]
pub(super) fn put<A: Copy>(out: &mut [A], values: &[A]) {
    if let (Some(out), Some(values)) = (out.first_chunk_mut::<4>(), values.first_chunk::<4>()) {
        *out = *values;
    } else {
        for (out, value) in out.iter_mut().zip(values) {
            *out = *value;
        }
    }
}
