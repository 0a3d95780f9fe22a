//! One tile, eight pixels at a time (R9 to R12).

use garad_core::Real;
use wide::bytemuck::cast;
use wide::{f32x8, i32x8};

use super::lanes::exp2_nonpositive;
use super::splat::Splat;
use crate::composite::{MAX_ALPHA, MIN_ALPHA, MIN_TRANSMITTANCE};

/// Blocks of 4 x 2 pixels in a tile: fewer of them than of rows of eight are cut by an ellipse.
pub(crate) const BLOCKS: usize = 32;

/// Splats between two searches for finished blocks.
const SPLATS_PER_CHECK: usize = 16;

/// Column and row of block i's first pixel: blocks run down the tile's first four columns, then
/// the next four.
#[inline(always)]
pub(crate) const fn corner(i: usize) -> (usize, usize) {
    (i / 8 * 4, i % 8 * 2)
}

/// Columns and rows of each block's pixels from the tile's corner.
static PLACES: [[f32x8; 2]; BLOCKS] = {
    let mut places = [[f32x8::ZERO; 2]; BLOCKS];
    let mut i = 0;
    while i < BLOCKS {
        let (x, y) = corner(i);
        let mut lanes = [[0.0; 8]; 2];
        let mut lane = 0;
        while lane < 8 {
            lanes[0][lane] = (x + lane % 4) as f32;
            lanes[1][lane] = (y + lane / 4) as f32;
            lane += 1;
        }
        places[i] = [f32x8::new(lanes[0]), f32x8::new(lanes[1])];
        i += 1;
    }
    places
};

/// Eight pixels.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Block {
    /// Share of light that is left; negative once the pixel is finished.
    pub(crate) transmittance: f32x8,
    pub(crate) color: [f32x8; 3],
    pub(crate) depth: f32x8,
    /// Splats blended.
    pub(crate) contributors: i32x8,
    /// Rank of the last of them, exact below 2²⁴.
    pub(crate) last: f32x8,
}

/// The pixels of a tile.
#[derive(Debug)]
pub(crate) struct TilePixels {
    pub(crate) blocks: [Block; BLOCKS],
}

/// A splat relative to one tile.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LocalSplat {
    mean: [f32x8; 2],
    pub(crate) shear: f32x8,
    along: f32x8,
    across: f32x8,
    opacity: f32x8,
}

impl LocalSplat {
    /// From the tile at (`x`, `y`).
    #[inline(always)]
    pub(crate) fn new(splat: &Splat, [x, y]: [f32; 2]) -> Self {
        Self {
            mean: [splat.mean_px[0] - x, splat.mean_px[1] - y].map(f32x8::splat),
            shear: f32x8::splat(splat.shear),
            along: f32x8::splat(splat.along),
            across: f32x8::splat(splat.across),
            opacity: f32x8::splat(splat.opacity),
        }
    }

    /// In block i: opacity e^power, the density of [`crate::composite`], with r = dx + (b/a) dy
    /// and dy.
    #[inline(always)]
    pub(crate) fn density(&self, i: usize) -> (f32x8, f32x8, f32x8) {
        let [x, y] = PLACES[i % BLOCKS];
        let dy = y - self.mean[1];
        let r = (x - self.mean[0]) + self.shear * dy;
        let power = self.along * r * r + self.across * dy * dy;
        (self.opacity * exp2_nonpositive(power), r, dy)
    }
}

impl TilePixels {
    /// No splat blended yet; pixels beyond `width` x `height` are finished.
    fn new(width: usize, height: usize) -> Self {
        let empty = Block {
            transmittance: f32x8::ONE,
            color: [f32x8::ZERO; 3],
            depth: f32x8::ZERO,
            contributors: i32x8::ZERO,
            last: f32x8::ZERO,
        };
        let mut blocks = [empty; BLOCKS];
        if width < 16 || height < 16 {
            for (i, block) in blocks.iter_mut().enumerate() {
                let (x, y) = corner(i);
                let inside = |lane: usize| x + lane % 4 < width && y + lane / 4 < height;
                let lanes = [0, 1, 2, 3, 4, 5, 6, 7];
                block.transmittance =
                    f32x8::new(lanes.map(|lane| if inside(lane) { 1.0 } else { -1.0 }));
            }
        }
        Self { blocks }
    }

    /// Blends the splats of `list` front to back into the `width` x `height` pixels at
    /// (`x`, `y`).
    ///
    /// Branches of the reference are masks here. A finished pixel keeps its T with the sign
    /// turned: whatever would be left of it is then below 1e-4, so it never takes again. Without `COLOR` only
    /// transmittance and depth are blended.
    pub(crate) fn composite<'a, const COLOR: bool>(
        list: impl Iterator<Item = &'a Splat>,
        corner: [f32; 2],
        [width, height]: [usize; 2],
    ) -> Self {
        let mut pixels = Self::new(width, height);
        let mut open = 0;
        let [min_alpha, max_alpha, min_t] =
            [MIN_ALPHA, MAX_ALPHA, MIN_TRANSMITTANCE].map(|v| f32x8::splat(f32::from_f64(v)));
        let sign = f32x8::splat(-0.0);
        let mut rank = f32x8::ZERO;
        for (entry, splat) in list.enumerate() {
            if entry % SPLATS_PER_CHECK == 0 {
                open = pixels.open();
                if open == 0 {
                    break;
                }
            }
            rank += f32x8::ONE;
            let mut reach = splat.reach(corner) & open;
            if reach == 0 {
                continue;
            }
            let local = LocalSplat::new(splat, corner);
            let color = splat.color.map(f32x8::splat);
            let depth = f32x8::splat(splat.depth_m);
            while reach != 0 {
                let i = reach.trailing_zeros() as usize % BLOCKS;
                reach &= reach - 1;
                let block = &mut pixels.blocks[i];
                let (density, ..) = local.density(i);
                let alpha = max_alpha.fast_min(density);
                let visible = alpha.simd_ge(min_alpha);
                let t = block.transmittance;
                let weight = alpha * t;
                let take = visible & (t - weight).simd_ge(min_t);
                let weight = weight & take;
                block.depth += weight * depth;
                if COLOR {
                    for channel in 0..3 {
                        block.color[channel] += weight * color[channel];
                    }
                    // A mask is -1.
                    block.contributors -= cast::<f32x8, i32x8>(take);
                    block.last = block.last.fast_max(rank & take);
                }
                block.transmittance = (t - weight) | ((visible ^ take) & sign);
            }
        }
        pixels
    }

    /// Bit i: some pixel of block i may still take light.
    #[inline(always)]
    fn open(&self) -> u32 {
        // The mask of a vector's signs.
        let closed = |block: &Block| block.transmittance.to_bitmask() == 0xff;
        let blocks = self.blocks.iter().enumerate();
        blocks.fold(0, |open, (i, block)| open | u32::from(!closed(block)) << i)
    }
}
