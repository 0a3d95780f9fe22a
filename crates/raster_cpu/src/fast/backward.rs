//! One tile on the way back, eight pixels at a time (R13, R14), and the sums of its splats.

use garad_core::Real;
use wide::f32x8;

use super::forward::{BLOCKS, corner, density, distances};
use super::lanes::sums;
use super::splat::Splat;
use crate::backward::ClampGradient;
use crate::composite::{MAX_ALPHA, MIN_ALPHA, PixelBackward, SplatSums};

/// The pixels of a tile on the way back: [`PixelBackward`], field by field.
#[derive(Debug)]
pub(crate) struct TileBackward {
    d_color: [[f32x8; 3]; BLOCKS],
    d_depth: [f32x8; BLOCKS],
    transmittance: [f32x8; BLOCKS],
    behind: [f32x8; BLOCKS],
    /// Rank of the last splat blended, exact below 2²⁴.
    last: [f32x8; BLOCKS],
    /// The largest of them per block.
    deepest: [u32; BLOCKS],
}

impl TileBackward {
    /// Takes each pixel of the tile, in columns and rows from its corner, from `pixel`; those
    /// beyond `width` x `height` have met no splat.
    pub(crate) fn new(
        [width, height]: [usize; 2],
        pixel: impl Fn(usize, usize) -> PixelBackward<f32>,
    ) -> Self {
        let mut tile = Self {
            d_color: [[f32x8::ZERO; 3]; BLOCKS],
            d_depth: [f32x8::ZERO; BLOCKS],
            transmittance: [f32x8::ZERO; BLOCKS],
            behind: [f32x8::ZERO; BLOCKS],
            last: [f32x8::ZERO; BLOCKS],
            deepest: [0; BLOCKS],
        };
        for i in 0..BLOCKS {
            let (x, y) = corner(i);
            let mut lanes = [[0.0f32; 8]; 7];
            for lane in 0..8 {
                let (x, y) = (x + lane % 4, y + lane / 4);
                if x >= width || y >= height {
                    continue;
                }
                let p = pixel(x, y);
                let values = [
                    p.d_color[0],
                    p.d_color[1],
                    p.d_color[2],
                    p.d_depth,
                    p.transmittance,
                    p.behind,
                    p.last as f32,
                ];
                for (lanes, value) in lanes.iter_mut().zip(values) {
                    lanes[lane] = value;
                }
                tile.deepest[i] = tile.deepest[i].max(p.last);
            }
            let [r, g, b, depth, transmittance, behind, last] = lanes.map(f32x8::new);
            tile.d_color[i] = [r, g, b];
            tile.d_depth[i] = depth;
            tile.transmittance[i] = transmittance;
            tile.behind[i] = behind;
            tile.last[i] = last;
        }
        tile
    }

    /// The way back through [`super::forward::TilePixels::composite`]: hands the number of each
    /// entry of `list` that any pixel has met, with its sums over the tile's pixels, to `put`,
    /// last entry first.
    ///
    /// Each lane sums its own pixels in the order of blocks; eight lanes become one by
    /// [`sums`].
    pub(crate) fn take_back<'a>(
        mut self,
        entries: usize,
        splat_of: impl Fn(usize) -> &'a Splat,
        [x, y]: [f32; 2],
        clamp: ClampGradient,
        mut put: impl FnMut(usize, &SplatSums<f32>),
    ) {
        let [min_alpha, max_alpha] = [MIN_ALPHA, MAX_ALPHA].map(|v| f32x8::splat(f32::from_f64(v)));
        // Blocks ordered by where their way back begins; those that have begun.
        let mut waiting: Vec<(usize, u32)> = (0..BLOCKS)
            .map(|i| (self.deepest[i] as usize, 1u32 << i))
            .collect();
        waiting.sort_unstable();
        let deepest = waiting.last().map_or(0, |w| w.0).min(entries);
        let mut begun = 0u32;
        for entry in (0..deepest).rev() {
            while let Some(&(rank, bit)) = waiting.last()
                && rank > entry
            {
                begun |= bit;
                waiting.pop();
            }
            let splat = splat_of(entry);
            let mut reach = splat.reach(x, y) & begun;
            if reach == 0 {
                continue;
            }
            let rank = f32x8::splat(entry as f32);
            let color = splat.color.map(f32x8::splat);
            let depth = f32x8::splat(splat.depth_m);
            let mut sum = [f32x8::ZERO; 10];
            while reach != 0 {
                let i = reach.trailing_zeros() as usize % BLOCKS;
                reach &= reach - 1;
                let [dx, dy] = distances(splat, [x, y], i);
                let density = density(splat, dx, dy);
                let alpha = max_alpha.fast_min(density);
                let take = alpha.simd_ge(min_alpha) & self.last[i].simd_gt(rank);
                let through = f32x8::ONE - alpha;
                let reached = self.transmittance[i] / through;
                let weight = alpha * reached;
                let (d_color, d_depth) = (self.d_color[i], self.d_depth[i]);
                let mut own = d_depth * depth;
                for channel in 0..3 {
                    own += d_color[channel] * color[channel];
                    // Products are masked, not weights: a NaN stays in its pixel.
                    sum[6 + channel] += (weight * d_color[channel]) & take;
                }
                sum[9] += (weight * d_depth) & take;
                let behind = self.behind[i];
                let d_alpha = reached * (own - behind);
                self.behind[i] = take.bitselect(alpha * own + through * behind, behind);
                self.transmittance[i] = take.bitselect(reached, self.transmittance[i]);
                let felt = match clamp {
                    ClampGradient::True => take & density.simd_le(max_alpha),
                    ClampGradient::PassThrough => take,
                };
                let g = (density * d_alpha) & felt;
                let r = dx + f32x8::splat(splat.shear) * dy;
                let (gr, gy) = (g * r, g * dy);
                sum[0] += g;
                sum[1] += gr;
                sum[2] += gy;
                sum[3] += gr * r;
                sum[4] += gr * dy;
                sum[5] += gy * dy;
            }
            let [g, r, y, rr] = sums([sum[0], sum[1], sum[2], sum[3]]);
            let [ry, yy, red, green] = sums([sum[4], sum[5], sum[6], sum[7]]);
            let [blue, depth, ..] = sums([sum[8], sum[9], f32x8::ZERO, f32x8::ZERO]);
            let total = SplatSums {
                g,
                r,
                y,
                rr,
                ry,
                yy,
                color: [red, green, blue],
                depth,
            };
            put(entry, &total);
        }
    }
}
