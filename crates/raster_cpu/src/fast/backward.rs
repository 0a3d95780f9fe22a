//! The backward pass of one tile, eight pixels at a time (R13, R14), and the sums of its splats.

use garad_core::Real;
use wide::bytemuck::cast;
use wide::{f32x4, f32x8, i32x4};

use super::forward::{BLOCKS, LocalSplat};
use super::lanes::sums;
use super::splat::Splat;
use crate::composite::{MAX_ALPHA, MIN_ALPHA};
use crate::options::ClampGradient;
use crate::splat_gradient::SplatSums;

/// Upstream gradients beyond this size are masked and not multiplied by zero, lest 0 · ∞ reach
/// splats that the pixel did not blend.
const LARGE: f32 = 1e15;

/// [`SplatSums`] in three vectors: (g, r, y, rr), (ry, yy, red, green), (blue, depth, 0, 0).
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Sums([f32x4; 3]);

impl Sums {
    /// Adds another tile's or row of tiles'.
    #[inline(always)]
    pub(crate) fn add(&mut self, other: &Self) {
        for (sum, part) in self.0.iter_mut().zip(other.0) {
            *sum += part;
        }
    }

    /// The splat was blended into no pixel.
    pub(crate) fn are_zero(&self) -> bool {
        self.0
            .iter()
            .all(|v| v.to_array().iter().all(|v| v.abs() <= 0.0))
    }

    /// With names.
    pub(crate) fn named(&self) -> SplatSums<f32> {
        let [[g, r, y, rr], [ry, yy, red, green], [blue, depth, ..]] = self.0.map(|v| v.to_array());
        SplatSums {
            g,
            r,
            y,
            rr,
            ry,
            yy,
            color: [red, green, blue],
            depth,
        }
    }
}

/// Eight pixels: [`crate::composite::PixelGradient`], field by field, as the backward pass moves on.
#[derive(Debug, Clone, Copy)]
struct Block {
    d_color: [f32x8; 3],
    d_depth: f32x8,
    transmittance: f32x8,
    behind: f32x8,
    /// Rank of the last splat blended, exact below 2²⁴.
    last: f32x8,
}

impl Block {
    /// No splat was blended.
    const EMPTY: Self = Self {
        d_color: [f32x8::ZERO; 3],
        d_depth: f32x8::ZERO,
        transmittance: f32x8::ZERO,
        behind: f32x8::ZERO,
        last: f32x8::ZERO,
    };
}

/// The pixels of a tile in the backward pass.
#[derive(Debug)]
pub(crate) struct TileBackward {
    blocks: [Block; BLOCKS],
    /// The largest [`Block::last`] per block.
    deepest: [u32; BLOCKS],
    /// No upstream gradient is large or NaN.
    bounded: bool,
}

/// Rows of images that a tile starts from.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rows<'a> {
    pub(crate) d_color: &'a [[f32; 3]],
    pub(crate) d_depth: Option<&'a [f32]>,
    pub(crate) d_opacity: Option<&'a [f32]>,
    pub(crate) transmittance: &'a [f32],
    pub(crate) last: &'a [u32],
    pub(crate) background: [f32; 3],
}

impl Rows<'_> {
    /// `d_color`, `d_depth`, `transmittance`, `behind`, `last` of four pixels from column x on.
    #[inline(always)]
    fn four(&self, x: usize) -> [f32x4; 7] {
        let [a, b, c, d] = four(&self.d_color[x..]);
        let [red, green, blue] = [0, 1, 2].map(|k| f32x4::new([a[k], b[k], c[k], d[k]]));
        let of = |row: Option<&[f32]>| row.map_or(f32x4::ZERO, |row| f32x4::new(four(&row[x..])));
        let light = self.background.map(f32x4::splat);
        let behind = red * light[0] + green * light[1] + blue * light[2] - of(self.d_opacity);
        // Ranks are below 2²⁴, where signed and unsigned are one.
        let last = cast::<[u32; 4], i32x4>(four(&self.last[x..])).round_float();
        let transmittance = of(Some(self.transmittance));
        [
            red,
            green,
            blue,
            of(self.d_depth),
            transmittance,
            behind,
            last,
        ]
    }
}

/// The largest rank of four pixels.
#[inline(always)]
fn deepest(row: &Rows, x: usize) -> u32 {
    let [a, b, c, d] = four(&row.last[x..]);
    a.max(b).max(c.max(d))
}

/// The first four of a row, with zeros where it ends.
#[inline(always)]
fn four<A: Copy + Default>(row: &[A]) -> [A; 4] {
    row.first_chunk().copied().unwrap_or_else(|| {
        let mut four = [A::default(); 4];
        for (out, value) in four.iter_mut().zip(row) {
            *out = *value;
        }
        four
    })
}

impl TileBackward {
    /// Takes the pixels of the tile from up to 16 rows, whose slices begin at the tile's first
    /// column; pixels they do not have blended no splat. What each starts from is computed as by the
    /// reference, [`crate::backward()`].
    pub(crate) fn new(rows: &[Rows]) -> Self {
        let mut tile = Self {
            blocks: [Block::EMPTY; BLOCKS],
            deepest: [0; BLOCKS],
            bounded: true,
        };
        let mut size = f32x8::ZERO;
        for (pair, rows) in rows.chunks(2).enumerate() {
            for column in 0..rows[0].d_color.len().div_ceil(4).min(4) {
                let i = column * 8 + pair;
                let upper = rows[0].four(4 * column);
                let (lower, below) = rows.get(1).map_or_else(Default::default, |row| {
                    (row.four(4 * column), deepest(row, 4 * column))
                });
                tile.deepest[i] = deepest(&rows[0], 4 * column).max(below);
                let of = |k: usize| cast::<[f32x4; 2], f32x8>([upper[k], lower[k]]);
                let block = &mut tile.blocks[i];
                block.d_color = [of(0), of(1), of(2)];
                block.d_depth = of(3);
                block.transmittance = of(4);
                block.behind = of(5);
                block.last = of(6);
                for k in 0..6 {
                    size += of(k).abs();
                }
            }
        }
        tile.bounded = size.to_array().iter().all(|&size| size < LARGE);
        tile
    }

    /// Backward pass of [`super::forward::TilePixels::composite`]: hands the number of each entry
    /// that any pixel blended, with its sums over the tile's pixels, to `put`, last entry first.
    ///
    /// Each lane sums its own pixels in the order of blocks; eight lanes become one by
    /// [`sums`].
    pub(crate) fn accumulate<'a>(
        self,
        entries: usize,
        splat_of: impl Fn(usize) -> &'a Splat,
        corner: [f32; 2],
        clamp: ClampGradient,
        put: impl FnMut(usize, &Sums),
    ) {
        match (self.bounded, clamp) {
            (true, ClampGradient::True) => {
                self.walk::<true, true>(entries, splat_of, corner, put);
            }
            (true, ClampGradient::PassThrough) => {
                self.walk::<true, false>(entries, splat_of, corner, put);
            }
            (false, ClampGradient::True) => {
                self.walk::<false, true>(entries, splat_of, corner, put);
            }
            (false, ClampGradient::PassThrough) => {
                self.walk::<false, false>(entries, splat_of, corner, put);
            }
        }
    }

    fn walk<'a, const BOUNDED: bool, const CLAMP: bool>(
        mut self,
        entries: usize,
        splat_of: impl Fn(usize) -> &'a Splat,
        corner: [f32; 2],
        mut put: impl FnMut(usize, &Sums),
    ) {
        // A pixel that does not take has weight 0; where gradients are not bounded, it is masked once more.
        let only = |mask: f32x8, value: f32x8| if BOUNDED { value } else { mask & value };
        let [min_alpha, max_alpha] = [MIN_ALPHA, MAX_ALPHA].map(|v| f32x8::splat(f32::from_f64(v)));
        // Blocks ordered by the entry at which they begin; those that have begun.
        let mut waiting = [(0, 0); BLOCKS];
        for (i, waiting) in waiting.iter_mut().enumerate() {
            *waiting = (self.deepest[i] as usize, 1u32 << i);
        }
        waiting.sort_unstable();
        let mut waiting = waiting.iter().rev().peekable();
        let deepest = waiting.peek().map_or(0, |w| w.0).min(entries);
        let mut begun = 0u32;
        for entry in (0..deepest).rev() {
            while let Some(&(_, bit)) = waiting.next_if(|w| w.0 > entry) {
                begun |= bit;
            }
            let splat = splat_of(entry);
            let mut reach = splat.reach(corner) & begun;
            if reach == 0 {
                continue;
            }
            let local = LocalSplat::new(splat, corner);
            let rank = f32x8::splat(entry as f32);
            let color = splat.color.map(f32x8::splat);
            let depth = f32x8::splat(splat.depth_m);
            let mut sum = [f32x8::ZERO; 10];
            while reach != 0 {
                let i = reach.trailing_zeros() as usize % BLOCKS;
                reach &= reach - 1;
                let block = &mut self.blocks[i];
                let (density, r, dy) = local.density(i);
                let alpha = max_alpha.fast_min(density);
                let take = alpha.simd_ge(min_alpha) & block.last.simd_gt(rank);
                let alpha = alpha & take;
                let reached = block.transmittance / (f32x8::ONE - alpha);
                let weight = alpha * reached;
                block.transmittance = reached;
                let mut own = block.d_depth * depth;
                for channel in 0..3 {
                    own += block.d_color[channel] * color[channel];
                    sum[6 + channel] += only(take, weight * block.d_color[channel]);
                }
                sum[9] += only(take, weight * block.d_depth);
                let more = own - block.behind;
                block.behind += only(take, alpha * more);
                // density = alpha but where alpha is clamped.
                let g = if CLAMP {
                    (weight & density.simd_le(max_alpha)) * more
                } else {
                    (density & take) * reached * more
                };
                let g = only(take, g);
                let (gr, gy) = (g * r, g * dy);
                sum[0] += g;
                sum[1] += gr;
                sum[2] += gy;
                sum[3] += gr * r;
                sum[4] += gr * dy;
                sum[5] += gy * dy;
            }
            let total = Sums([
                sums([sum[0], sum[1], sum[2], sum[3]]),
                sums([sum[4], sum[5], sum[6], sum[7]]),
                sums([sum[8], sum[9], f32x8::ZERO, f32x8::ZERO]),
            ]);
            put(entry, &total);
        }
    }
}
