//! One tile, eight pixels at a time (R9 to R12).

use garad_core::Real;
use garad_core::lanes::{F32x8, Kernel, Lanes, dispatch};

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
static PLACES: [[[f32; 8]; 2]; BLOCKS] = {
    let mut places = [[[0.0; 8]; 2]; BLOCKS];
    let mut i = 0;
    while i < BLOCKS {
        let (x, y) = corner(i);
        let mut lane = 0;
        while lane < 8 {
            places[i][0][lane] = (x + lane % 4) as f32;
            places[i][1][lane] = (y + lane / 4) as f32;
            lane += 1;
        }
        i += 1;
    }
    places
};

/// Eight pixels.
#[derive(Debug, Clone, Copy)]
#[repr(align(32))]
pub(crate) struct Block {
    /// Share of light that is left; negative once the pixel is finished.
    pub(crate) transmittance: [f32; 8],
    pub(crate) color: [[f32; 8]; 3],
    pub(crate) depth: [f32; 8],
    /// Splats blended, exact below 2²⁴.
    pub(crate) contributors: [f32; 8],
    /// Rank of the last of them.
    pub(crate) last: [f32; 8],
}

/// The pixels of a tile.
#[derive(Debug)]
pub(crate) struct TilePixels {
    pub(crate) blocks: [Block; BLOCKS],
}

/// A splat relative to one tile.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LocalSplat<L: Lanes> {
    lanes: L,
    mean: [L::F32x8; 2],
    shear: L::F32x8,
    along: L::F32x8,
    across: L::F32x8,
    opacity: L::F32x8,
    pub(crate) color: [L::F32x8; 3],
    pub(crate) depth: L::F32x8,
}

impl<L: Lanes> LocalSplat<L> {
    /// From the tile at (`x`, `y`).
    #[inline(always)]
    pub(crate) fn new(lanes: L, splat: &Splat, [x, y]: [f32; 2]) -> Self {
        let [red, green, blue] = splat.color;
        Self {
            lanes,
            mean: [
                lanes.splat(splat.mean_px[0] - x),
                lanes.splat(splat.mean_px[1] - y),
            ],
            shear: lanes.splat(splat.shear),
            along: lanes.splat(splat.along),
            across: lanes.splat(splat.across),
            opacity: lanes.splat(splat.opacity),
            color: [lanes.splat(red), lanes.splat(green), lanes.splat(blue)],
            depth: lanes.splat(splat.depth_m),
        }
    }

    /// In block i: opacity e^power, the density of [`crate::composite`], with r = dx + (b/a) dy
    /// and dy.
    #[inline(always)]
    pub(crate) fn density(&self, i: usize) -> (L::F32x8, L::F32x8, L::F32x8) {
        let [x, y] = PLACES[i % BLOCKS];
        let (x, y) = (self.lanes.load(x), self.lanes.load(y));
        let dy = y - self.mean[1];
        let r = (x - self.mean[0]) + self.shear * dy;
        let power = self.along * r * r + self.across * dy * dy;
        (self.opacity * exp2_nonpositive(self.lanes, power), r, dy)
    }
}

impl TilePixels {
    /// No splat blended yet; pixels beyond `width` x `height` are finished.
    fn new(width: usize, height: usize) -> Self {
        let empty = Block {
            transmittance: [1.0; 8],
            color: [[0.0; 8]; 3],
            depth: [0.0; 8],
            contributors: [0.0; 8],
            last: [0.0; 8],
        };
        let mut blocks = [empty; BLOCKS];
        if width < 16 || height < 16 {
            for (i, block) in blocks.iter_mut().enumerate() {
                let (x, y) = corner(i);
                let inside = |lane: usize| x + lane % 4 < width && y + lane / 4 < height;
                block.transmittance =
                    std::array::from_fn(|lane| if inside(lane) { 1.0 } else { -1.0 });
            }
        }
        Self { blocks }
    }

    /// Blends the splats of `list` front to back into the `width` x `height` pixels at
    /// (`x`, `y`). Without `COLOR` only transmittance and depth are blended.
    pub(crate) fn composite<'a, const COLOR: bool>(
        list: impl Iterator<Item = &'a Splat>,
        corner: [f32; 2],
        [width, height]: [usize; 2],
    ) -> Self {
        let mut pixels = Self::new(width, height);
        dispatch(Composite::<_, COLOR> {
            pixels: &mut pixels,
            list,
            corner,
        });
        pixels
    }
}

/// [`TilePixels::composite`], once there are pixels.
///
/// Branches of the reference are masks here. A finished pixel keeps its T with the sign
/// turned: whatever would be left of it is then below 1e-4, so it never takes again.
struct Composite<'p, I, const COLOR: bool> {
    pixels: &'p mut TilePixels,
    list: I,
    corner: [f32; 2],
}

impl<'a, I: Iterator<Item = &'a Splat>, const COLOR: bool> Kernel for Composite<'_, I, COLOR> {
    type Output = ();

    #[inline(always)]
    fn run<L: Lanes>(self, lanes: L) {
        let Self {
            pixels,
            list,
            corner,
        } = self;
        let mut open = 0;
        let min_alpha = lanes.splat(f32::from_f64(MIN_ALPHA));
        let max_alpha = lanes.splat(f32::from_f64(MAX_ALPHA));
        let min_t = lanes.splat(f32::from_f64(MIN_TRANSMITTANCE));
        let (one, sign) = (lanes.splat(1.0), lanes.splat(-0.0));
        let mut rank = lanes.splat(0.0);
        for (entry, splat) in list.enumerate() {
            if entry % SPLATS_PER_CHECK == 0 {
                open = pixels.open(lanes);
                if open == 0 {
                    break;
                }
            }
            rank += one;
            let mut reach = splat.reach(lanes, corner) & open;
            if reach == 0 {
                continue;
            }
            let local = LocalSplat::new(lanes, splat, corner);
            while reach != 0 {
                let i = reach.trailing_zeros() as usize % BLOCKS;
                reach &= reach - 1;
                let block = &mut pixels.blocks[i];
                let (density, ..) = local.density(i);
                let alpha = max_alpha.min(density);
                let visible = alpha.ge(min_alpha);
                let t = lanes.load(block.transmittance);
                let weight = alpha * t;
                let take = visible & (t - weight).ge(min_t);
                let weight = weight & take;
                block.depth = (lanes.load(block.depth) + weight * local.depth).to_array();
                if COLOR {
                    for channel in 0..3 {
                        let color = lanes.load(block.color[channel]);
                        block.color[channel] = (color + weight * local.color[channel]).to_array();
                    }
                    let contributors = lanes.load(block.contributors);
                    block.contributors = (contributors + (one & take)).to_array();
                    block.last = lanes.load(block.last).max(rank & take).to_array();
                }
                block.transmittance = ((t - weight) | ((visible ^ take) & sign)).to_array();
            }
        }
    }
}

impl TilePixels {
    /// Bit i: some pixel of block i may still take light.
    #[inline(always)]
    fn open<L: Lanes>(&self, lanes: L) -> u32 {
        let mut open = 0;
        for (i, block) in self.blocks.iter().enumerate() {
            let closed = lanes.load(block.transmittance).signs() == 0xff;
            open |= u32::from(!closed) << i;
        }
        open
    }
}
