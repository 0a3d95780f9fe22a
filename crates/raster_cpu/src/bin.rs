//! The splats of each tile, front to back.

use garad_core::Real;

use crate::splat::{PixelRect, Projected};

/// Sorts by depth, then by row in the map (R8): a total order, so the image does
/// not depend on the sort algorithm, and on the order of the map's rows only where depths are equal.
pub(crate) fn sort_front_to_back<T: Real>(splats: Vec<Projected<T>>) -> Vec<Projected<T>> {
    // Keys are sorted and rows gathered once: a row is ten times the size of a key.
    let mut order: Vec<(T, u32)> = splats.iter().map(|s| s.depth_m).zip(0..).collect();
    order.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    order.iter().map(|&(_, i)| splats[i as usize]).collect()
}

/// The image cut into squares of `tile_px` pixels, and for each the splats whose footprint
/// reaches into it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Tiles {
    tile_px: usize,
    size: [usize; 2],
    /// Tiles per row.
    columns: usize,
    /// Tile t owns `entries[starts[t]..starts[t + 1]]`.
    starts: Vec<usize>,
    /// Positions in the sorted splats; ascending within a tile, hence front to back.
    entries: Vec<u32>,
}

impl Tiles {
    /// Counts, then fills: the splats are walked in depth order, so every list comes out sorted.
    pub(crate) fn new<T>(splats: &[Projected<T>], size: [usize; 2], tile_px: usize) -> Self {
        let [columns, rows] = size.map(|n| n.div_ceil(tile_px));
        let mut starts = vec![0usize; columns * rows + 1];
        for splat in splats {
            for_each_tile(&splat.footprint, tile_px, columns, |t| starts[t + 1] += 1);
        }
        for t in 0..columns * rows {
            starts[t + 1] += starts[t];
        }
        let mut entries = vec![0u32; starts[columns * rows]];
        let mut next = starts.clone();
        for (splat, position) in splats.iter().zip(0u32..) {
            for_each_tile(&splat.footprint, tile_px, columns, |t| {
                entries[next[t]] = position;
                next[t] += 1;
            });
        }
        Self {
            tile_px,
            size,
            columns,
            starts,
            entries,
        }
    }

    /// Number of tiles.
    pub(crate) fn len(&self) -> usize {
        self.starts.len() - 1
    }

    /// The pixels of a tile, cut to the image.
    pub(crate) fn rect(&self, tile: usize) -> PixelRect {
        let [x0, y0] = [tile % self.columns, tile / self.columns].map(|k| k * self.tile_px);
        PixelRect {
            x0,
            x1: (x0 + self.tile_px).min(self.size[0]),
            y0,
            y1: (y0 + self.tile_px).min(self.size[1]),
        }
    }

    /// The tile that a pixel belongs to.
    pub(crate) fn tile_of(&self, x: usize, y: usize) -> usize {
        y / self.tile_px * self.columns + x / self.tile_px
    }

    /// The tile's splats as positions in the sorted array, front to back.
    pub(crate) fn list(&self, tile: usize) -> &[u32] {
        &self.entries[self.starts[tile]..self.starts[tile + 1]]
    }
}

/// The numbers of the tiles that a rectangle (not empty) overlaps.
fn for_each_tile(rect: &PixelRect, tile_px: usize, columns: usize, mut f: impl FnMut(usize)) {
    for row in rect.y0 / tile_px..rect.y1.div_ceil(tile_px) {
        for column in rect.x0 / tile_px..rect.x1.div_ceil(tile_px) {
            f(row * columns + column);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn splat(index: u32, depth_m: f64, x: [usize; 2], y: [usize; 2]) -> Projected<f64> {
        Projected {
            index,
            depth_m,
            footprint: PixelRect {
                x0: x[0],
                x1: x[1],
                y0: y[0],
                y1: y[1],
            },
            ..Projected::ZERO
        }
    }

    #[test]
    fn near_before_far_and_rows_in_order_at_equal_depth() {
        let depths = [2.0, 1.0, 2.0, 0.5, 1.0];
        let splats = (0..5u32).zip(depths);
        let sorted = sort_front_to_back(splats.map(|(i, z)| splat(i, z, [0, 1], [0, 1])).collect());
        let order: Vec<u32> = sorted.iter().map(|s| s.index).collect();
        assert_eq!(order, [3, 1, 4, 0, 2], "depth, then row");
    }

    #[test]
    fn lists_of_an_image_of_two_by_two_tiles() {
        // 20 x 18 px in tiles of 16: the right and lower ones are cut.
        let splats = [
            splat(7, 1.0, [0, 20], [0, 18]),  // everywhere
            splat(8, 2.0, [16, 20], [0, 16]), // upper right
            splat(9, 3.0, [0, 16], [16, 18]), // lower left
            splat(5, 4.0, [15, 17], [3, 4]),  // upper two, across the seam
        ];
        let tiles = Tiles::new(&splats, [20, 18], 16);
        assert_eq!(tiles.len(), 4, "tiles");
        let lists: Vec<&[u32]> = (0..4).map(|t| tiles.list(t)).collect();
        assert_eq!(lists, [&[0, 3][..], &[0, 1, 3], &[0, 2], &[0]], "positions");
        let corner = tiles.rect(3);
        assert_eq!((corner.x0, corner.x1), (16, 20), "columns");
        assert_eq!((corner.y0, corner.y1), (16, 18), "rows");
        let corners = [(0, 0), (16, 15), (15, 16), (19, 17)];
        let of_pixels = corners.map(|(x, y)| tiles.tile_of(x, y));
        assert_eq!(of_pixels, [0, 1, 2, 3], "tiles of pixels");
    }
}
