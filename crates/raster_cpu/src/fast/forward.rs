//! One tile, eight pixels at a time (R9 to R12).

use garad_core::Real;
use wide::f32x8;

use super::lanes::{COLUMNS, ROWS, exp_nonpositive};
use super::splat::Splat;
use crate::composite::{MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE};

/// Blocks of 4 x 2 pixels in a tile: fewer of them than of rows of eight are cut by an ellipse.
pub(crate) const BLOCKS: usize = 32;

/// Column and row of block i's first pixel: blocks run down the tile's first four columns, then
/// the next four.
#[inline(always)]
pub(crate) const fn corner(i: usize) -> (usize, usize) {
    (i / 8 * 4, i % 8 * 2)
}

/// The pixels of a tile.
#[derive(Debug)]
pub(crate) struct TilePixels {
    /// Share of light that is left; negative once the pixel is finished.
    pub(crate) transmittance: [f32x8; BLOCKS],
    pub(crate) color: [[f32x8; 3]; BLOCKS],
    pub(crate) depth: [f32x8; BLOCKS],
    /// Splats blended, as a number: fewer than 2400 fit between T = 1 and 1e-4.
    pub(crate) contributors: [f32x8; BLOCKS],
    /// Rank of the last of them, exact below 2²⁴.
    pub(crate) last: [f32x8; BLOCKS],
}

/// What [`crate::composite`] calls density: opacity e^power, at eight distances from the centre.
/// Same operations, same order.
#[inline(always)]
pub(crate) fn density(splat: &Splat, dx: f32x8, dy: f32x8) -> f32x8 {
    let along = dx + f32x8::splat(splat.shear) * dy;
    let across = f32x8::splat(splat.inv_var_y) * dy * dy;
    let power = f32x8::splat(-0.5) * (f32x8::splat(splat.a) * along * along + across);
    f32x8::splat(splat.opacity) * exp_nonpositive(power)
}

/// Distances from the centre of block i of the tile at (`x`, `y`).
#[inline(always)]
pub(crate) fn distances(splat: &Splat, [x, y]: [f32; 2], i: usize) -> [f32x8; 2] {
    let (column, row) = corner(i);
    [
        (f32x8::splat(x + column as f32) + COLUMNS) - f32x8::splat(splat.mean_px[0]),
        (f32x8::splat(y + row as f32) + ROWS) - f32x8::splat(splat.mean_px[1]),
    ]
}

impl TilePixels {
    /// Nothing has arrived yet; pixels beyond `width` x `height` are finished.
    fn new(width: usize, height: usize) -> Self {
        let mut transmittance = [f32x8::splat(-1.0); BLOCKS];
        for (i, t) in transmittance.iter_mut().enumerate() {
            let (x, y) = corner(i);
            let inside = |lane: usize| x + lane % 4 < width && y + lane / 4 < height;
            let lanes = [0, 1, 2, 3, 4, 5, 6, 7];
            *t = f32x8::new(lanes.map(|lane| if inside(lane) { 1.0 } else { -1.0 }));
        }
        Self {
            transmittance,
            color: [[f32x8::ZERO; 3]; BLOCKS],
            depth: [f32x8::ZERO; BLOCKS],
            contributors: [f32x8::ZERO; BLOCKS],
            last: [f32x8::ZERO; BLOCKS],
        }
    }

    /// Blends the splats of `list` front to back into the `width` x `height` pixels at
    /// (`x`, `y`).
    ///
    /// Branches of the reference are masks here. A finished pixel keeps its T with the sign
    /// turned: whatever would be left of it is then below 1e-4, so it never takes again.
    pub(crate) fn composite<'a>(
        list: impl Iterator<Item = &'a Splat>,
        [x, y]: [f32; 2],
        [width, height]: [usize; 2],
    ) -> Self {
        let mut pixels = Self::new(width, height);
        let mut open = u32::MAX;
        for i in 0..BLOCKS {
            pixels.note_closed(i, &mut open);
        }
        let [min_alpha, max_alpha, min_t] =
            [MIN_ALPHA, MAX_ALPHA, MIN_TRANSMITTANCE].map(|v| f32x8::splat(f32::from_f64(v)));
        let sign = f32x8::splat(-0.0);
        let mut rank = f32x8::ZERO;
        for splat in list {
            if open == 0 {
                break;
            }
            rank += f32x8::ONE;
            let mut reach = splat.reach(x, y) & open;
            if reach == 0 {
                continue;
            }
            let color = splat.color.map(f32x8::splat);
            let depth = f32x8::splat(splat.depth_m);
            while reach != 0 {
                let i = reach.trailing_zeros() as usize % BLOCKS;
                reach &= reach - 1;
                let [dx, dy] = distances(splat, [x, y], i);
                let alpha = max_alpha.fast_min(density(splat, dx, dy));
                let visible = alpha.simd_ge(min_alpha);
                let t = pixels.transmittance[i];
                let left = t * (f32x8::ONE - alpha);
                let take = visible & left.simd_ge(min_t);
                let weight = (alpha * t) & take;
                for channel in 0..3 {
                    pixels.color[i][channel] += weight * color[channel];
                }
                pixels.depth[i] += weight * depth;
                pixels.contributors[i] += take & f32x8::ONE;
                pixels.last[i] = take.bitselect(rank, pixels.last[i]);
                pixels.transmittance[i] = take.bitselect(left, t | (visible & sign));
                pixels.note_closed(i, &mut open);
            }
        }
        pixels
    }

    /// Clears bit i of `open` when no pixel of block i may still take light.
    #[inline(always)]
    fn note_closed(&self, i: usize, open: &mut u32) {
        // The mask of a vector's signs.
        if self.transmittance[i].to_bitmask() == 0xff {
            *open &= !(1 << i);
        }
    }
}
