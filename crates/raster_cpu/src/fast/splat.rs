//! [`Splat`]: what a tile reads of a splat, and which of the tile's pixels it can reach.

use garad_core::lanes::{F32x8, Lanes};
use garad_core::{Par, Real};

use crate::project::FOOTPRINT_CELL_PX;
use crate::splat::Projected;

/// Splats prepared by one task.
const CHUNK: usize = 2048;

/// -½ log₂e.
const HALF_LOG2_E: f32 = -0.5 * std::f32::consts::LOG2_E;

/// What the pixels read of a [`Projected`], in one cache line.
#[derive(Debug, Clone, Copy, Default)]
#[repr(align(64))]
pub(crate) struct Splat {
    pub(crate) mean_px: [f32; 2],
    /// b/a of the conic.
    pub(crate) shear: f32,
    /// -½ log₂e a and -½ log₂e/Σ'yy: log₂ e^power = along (dx + (b/a) dy)² + across dy².
    pub(crate) along: f32,
    pub(crate) across: f32,
    pub(crate) opacity: f32,
    pub(crate) color: [f32; 3],
    pub(crate) depth_m: f32,
    /// ½ log₂e k with the k of R12, enlarged: alpha ≥ 1/255 only where log₂ e^power ≥ -k.
    k: f32,
    /// -1/`along`.
    var_along: f32,
    /// Half the sides of the rectangle about the ellipse, enlarged; -∞ for an empty one.
    half_px: [f32; 2],
    /// Footprint in cells, [x0, x1) x [y0, y1).
    pub(crate) cells: [u16; 4],
}

impl Splat {
    pub(crate) fn new(splat: &Projected<f32>) -> Self {
        // Bounds of the work and not of the image: 1 % and a tenth of a pixel are far
        // more than rounding can move.
        let k = 2.02 * Real::ln(255.0 * splat.opacity) + 0.02;
        let half = |axis: usize| {
            if k > 0.0 {
                Real::sqrt(k) * splat.sigma_px[axis] + margin(splat.mean_px[axis])
            } else {
                f32::NEG_INFINITY
            }
        };
        let f = &splat.footprint;
        let cell = |cells: usize| u16::try_from(cells).expect("at most 1024 cells per side");
        Self {
            mean_px: splat.mean_px,
            shear: splat.shear,
            along: HALF_LOG2_E * splat.conic[0],
            across: HALF_LOG2_E * splat.inv_var_y,
            opacity: splat.opacity,
            color: splat.color,
            depth_m: splat.depth_m,
            k: -HALF_LOG2_E * k,
            var_along: -1.0 / (HALF_LOG2_E * splat.conic[0]),
            half_px: [half(0), half(1)],
            cells: [
                cell(f.x0 / FOOTPRINT_CELL_PX),
                cell(f.x1.div_ceil(FOOTPRINT_CELL_PX)),
                cell(f.y0 / FOOTPRINT_CELL_PX),
                cell(f.y1.div_ceil(FOOTPRINT_CELL_PX)),
            ],
        }
    }

    /// The blocks of the 16 x 16 pixels at (`x`, `y`) in which alpha may reach 1/255: bit 8 q + r
    /// for the block of columns 4 q to 4 q + 3 and rows 2 r and 2 r + 1.
    ///
    /// alpha ≥ 1/255 ⟺ a (dx + (b/a) dy)² + dy²/Σ'yy ≤ k,  k = 2 ln(255 opacity)            (R12)
    ///
    /// solved for the columns of each row. A block that is left out would have failed the
    /// test against 1/255 in every pixel, so this changes the time and nothing else.
    #[inline(always)]
    pub(crate) fn reach<L: Lanes>(&self, lanes: L, [x, y]: [f32; 2]) -> u32 {
        let ([u, v], [half_u, half_v], side) = (self.mean_px, self.half_px, 15.0);
        let beside = (u + half_u < x) | (u - half_u > x + side);
        if beside | (v + half_v < y) | (v - half_v > y + side) {
            return 0;
        }
        let (upper, lower) = (
            self.columns_of(lanes, [x, y]),
            self.columns_of(lanes, [x, y + 1.0]),
        );
        // The columns that either row of a pair of rows reaches, from the tile's first.
        let first = upper.0.min(lower.0);
        let last = upper.1.max(lower.1);
        let mut reach = 0;
        for quarter in 0..4u8 {
            let column = 4.0 * f32::from(quarter);
            let starts = first.le(lanes.splat(column + 3.0));
            let ends = last.ge(lanes.splat(column));
            reach |= (starts & ends).signs() << (8 * quarter);
        }
        reach
    }

    /// The interval of columns from x on in which every second row from y on is reached; beyond the ellipse an empty one.
    #[inline(always)]
    fn columns_of<L: Lanes>(&self, lanes: L, [x, y]: [f32; 2]) -> (L::F32x8, L::F32x8) {
        let [u, v] = self.mean_px;
        let steps = lanes.load([0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0]);
        let dy = lanes.splat(y - v) + steps;
        let rest = lanes.splat(self.k) + lanes.splat(self.across) * dy * dy;
        // A positive floor: 0 times an infinite variance would be no number.
        let square = rest.max(lanes.splat(1e-30)) * lanes.splat(self.var_along);
        let lean = lanes.splat(self.shear) * dy;
        let middle = lanes.splat(u - x) - lean;
        let half = square.sqrt() + (lanes.splat(margin(u)) + lean.abs() * lanes.splat(1e-6));
        let inside = rest.ge(lanes.splat(0.0));
        let half = inside.select(half, lanes.splat(-1e30));
        (middle - half, middle + half)
    }
}

/// More than the rounding of a coordinate of this size can move, pixels.
#[inline(always)]
fn margin(coordinate: f32) -> f32 {
    0.1 + 1e-6 * coordinate.abs()
}

/// All splats, in their order.
pub(crate) fn prepare(projected: &[Projected<f32>], par: Par) -> Vec<Splat> {
    let mut splats = vec![Splat::default(); projected.len()];
    par.for_each_chunk_mut(&mut splats, CHUNK, |chunk, splats| {
        for (splat, projected) in splats.iter_mut().zip(&projected[chunk * CHUNK..]) {
            *splat = Splat::new(projected);
        }
    });
    splats
}
