//! The backward pass of one tile, eight pixels at a time (R13, R14), and the sums of its splats.

use garad_core::Real;
use garad_core::lanes::{F32x8, Kernel, Lanes, dispatch};
use wide::bytemuck::cast;
use wide::{f32x4, i32x4};

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
#[repr(align(32))]
struct Block {
    d_color: [[f32; 8]; 3],
    d_depth: [f32; 8],
    transmittance: [f32; 8],
    behind: [f32; 8],
    /// Rank of the last splat blended, exact below 2²⁴.
    last: [f32; 8],
}

impl Block {
    /// No splat was blended.
    const EMPTY: Self = Self {
        d_color: [[0.0; 8]; 3],
        d_depth: [0.0; 8],
        transmittance: [0.0; 8],
        behind: [0.0; 8],
        last: [0.0; 8],
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
        let mut size = f32x4::ZERO;
        for (pair, rows) in rows.chunks(2).enumerate() {
            for column in 0..rows[0].d_color.len().div_ceil(4).min(4) {
                let i = column * 8 + pair;
                let upper = rows[0].four(4 * column);
                let (lower, below) = rows.get(1).map_or_else(Default::default, |row| {
                    (row.four(4 * column), deepest(row, 4 * column))
                });
                tile.deepest[i] = deepest(&rows[0], 4 * column).max(below);
                let of = |k: usize| cast::<[f32x4; 2], [f32; 8]>([upper[k], lower[k]]);
                let block = &mut tile.blocks[i];
                block.d_color = [of(0), of(1), of(2)];
                block.d_depth = of(3);
                block.transmittance = of(4);
                block.behind = of(5);
                block.last = of(6);
                for k in 0..6 {
                    size += upper[k].abs() + lower[k].abs();
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
        &mut self,
        entries: usize,
        splat_of: impl Fn(usize) -> &'a Splat,
        corner: [f32; 2],
        clamp: ClampGradient,
        put: impl FnMut(usize, &Sums),
    ) {
        let Self {
            blocks,
            deepest,
            bounded,
        } = self;
        macro_rules! walk {
            ($bounded:literal, $clamp:literal) => {
                dispatch(Walk::<_, _, $bounded, $clamp> {
                    blocks,
                    deepest,
                    entries,
                    splat_of,
                    corner,
                    put,
                })
            };
        }
        match (bounded, clamp) {
            (true, ClampGradient::True) => walk!(true, true),
            (true, ClampGradient::PassThrough) => walk!(true, false),
            (false, ClampGradient::True) => walk!(false, true),
            (false, ClampGradient::PassThrough) => walk!(false, false),
        }
    }
}

/// [`TileBackward::accumulate`], whose arguments it has.
struct Walk<'t, S, P, const BOUNDED: bool, const CLAMP: bool> {
    blocks: &'t mut [Block; BLOCKS],
    deepest: &'t [u32; BLOCKS],
    entries: usize,
    splat_of: S,
    corner: [f32; 2],
    put: P,
}

impl<'a, S, P, const BOUNDED: bool, const CLAMP: bool> Kernel for Walk<'_, S, P, BOUNDED, CLAMP>
where
    S: Fn(usize) -> &'a Splat,
    P: FnMut(usize, &Sums),
{
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let Self {
            blocks,
            deepest,
            entries,
            splat_of,
            corner,
            mut put,
        } = self;
        // A pixel that does not take has weight 0; where gradients are not bounded, it is masked once more.
        let only = |mask: L::F32x8, value: L::F32x8| if BOUNDED { value } else { mask & value };
        let min_alpha = lanes.splat(f32::from_f64(MIN_ALPHA));
        let max_alpha = lanes.splat(f32::from_f64(MAX_ALPHA));
        let (zero, one) = (lanes.splat(0.0), lanes.splat(1.0));
        // Blocks ordered by the entry at which they begin; those that have begun.
        let mut waiting = [(0, 0); BLOCKS];
        for (i, waiting) in waiting.iter_mut().enumerate() {
            *waiting = (deepest[i] as usize, 1u32 << i);
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
            let mut reach = splat.reach(lanes, corner) & begun;
            if reach == 0 {
                continue;
            }
            let local = LocalSplat::new(lanes, splat, corner);
            let rank = lanes.splat(entry as f32);
            let mut sum = [zero; 10];
            while reach != 0 {
                let i = reach.trailing_zeros() as usize % BLOCKS;
                reach &= reach - 1;
                let block = &mut blocks[i];
                let (density, r, dy) = local.density(i);
                let alpha = max_alpha.min(density);
                let take = alpha.ge(min_alpha) & lanes.load(block.last).gt(rank);
                let alpha = alpha & take;
                let reached = lanes.load(block.transmittance) / (one - alpha);
                let weight = alpha * reached;
                block.transmittance = reached.to_array();
                let d_depth = lanes.load(block.d_depth);
                let mut own = d_depth * local.depth;
                for channel in 0..3 {
                    let d_color = lanes.load(block.d_color[channel]);
                    own += d_color * local.color[channel];
                    sum[6 + channel] += only(take, weight * d_color);
                }
                sum[9] += only(take, weight * d_depth);
                let behind = lanes.load(block.behind);
                let more = own - behind;
                block.behind = (behind + only(take, alpha * more)).to_array();
                // density = alpha but where alpha is clamped.
                let g = if CLAMP {
                    (weight & density.le(max_alpha)) * more
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
                sums([sum[8], sum[9], zero, zero]),
            ]);
            put(entry, &total);
        }
    }
}
