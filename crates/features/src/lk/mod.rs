//! Pyramidal Lucas-Kanade: the displacement of a small window from one image to the next.
//!
//! On each level, from the coarsest down, the displacement d solves the least-squares problem of
//! a window W of 21 x 21 pixels around the point (Lucas & Kanade 1981):
//!
//! min_d Σ_W (J(x + d) - I(x))²,   G δ = -b,   G = Σ ∇I ∇Iᵀ,   b = Σ (J(x + d) - I(x)) ∇I   (E14)
//!
//! by repeating d ← d + δ with G of the first image; the answer, doubled, starts the next level
//! (Bouguet 2000). Everything is OpenCV's `calcOpticalFlowPyrLK`: bilinear weights of 14 bits,
//! intensities times 32, Scharr derivatives, f32 from the sums on. OpenCV adds the sums in f32 and
//! in an order that depends on the processor; here they are exact integers.
//!
//! [`pyramid`] prepares a frame once; [`mod@reference`] and `fast` compute the sums over a window,
//! and the loop below is the same for both.

mod fast;
pub mod pyramid;
pub mod reference;

use garad_core::Par;

use crate::error::FeatureError;
use fast::Fast;
use pyramid::LkLevel;
pub use pyramid::LkPyramid;

/// Side of the window, pixels.
pub const WINDOW: usize = 21;

/// Fraction bits of bilinear weights.
const WEIGHT_BITS: u32 = 14;
/// Intensities keep 5 of these bits: they are 32 times the grey level.
const INTENSITY_SHIFT: u32 = WEIGHT_BITS - 5;
const DERIVATIVE_SHIFT: u32 = WEIGHT_BITS;

/// Settings of the tracker; the defaults are OpenCV's.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LkConfig {
    /// Most steps per level.
    pub iterations: usize,
    /// A step shorter than this ends a level, pixels.
    pub epsilon_px: f64,
    /// Smallest eigenvalue of G / 441 that counts as texture, in OpenCV's units: 2⁻¹⁰ times
    /// (grey levels per pixel)². 1e-4 is a slope of 0.32 grey levels per pixel (E14).
    pub min_eigenvalue: f32,
    /// Largest mean absolute difference of the two windows, grey levels; `None` for any.
    pub max_residual: Option<f32>,
    /// The level the search starts on, if the pyramids have it: 0 is the full image.
    pub coarsest_level: usize,
}

impl Default for LkConfig {
    fn default() -> Self {
        Self {
            iterations: 30,
            epsilon_px: 0.01,
            min_eigenvalue: 1e-4,
            max_residual: None,
            coarsest_level: usize::MAX,
        }
    }
}

/// The result for one point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum LkStatus {
    /// Found.
    Tracked,
    /// The window left the image by more than its own size, or the point is not a number.
    OutOfImage,
    /// Too little texture (smallest eigenvalue below the gate).
    FlatTexture,
    /// Found, but the windows differ by more than [`LkConfig::max_residual`].
    HighResidual,
}

/// A point in the second image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LkTrack {
    /// Position, pixels; the last estimate if the point was lost.
    pub xy: [f32; 2],
    /// Found, or why not.
    pub status: LkStatus,
    /// Mean absolute difference of the two windows, grey levels; 0 if the point was lost.
    pub residual: f32,
    /// Smallest eigenvalue of G / 441 on the full image; 0 if the window lay outside.
    pub min_eigenvalue: f32,
}

impl LkTrack {
    /// Whether the point was found.
    #[must_use]
    pub fn is_tracked(&self) -> bool {
        self.status == LkStatus::Tracked
    }
}

/// Points handled as one piece of work.
const CHUNK: usize = 16;

/// Follows `points` (pixels of `prev`) into `next`, starting at `initial` if given, else where
/// they were.
///
/// # Numerics
/// Sums over the window in integers, all else in f32 in OpenCV's order of operations; the same
/// bits for every `par`. Golden: `lk/*`.
///
/// # Errors
/// [`FeatureError::SizeMismatch`] if the pyramids differ in size or levels, or the two lists of
/// points in length.
///
/// # Example
/// ```
/// use garad_core::{GrayImage, Par};
/// use garad_features::{LkConfig, LkPyramid, lk};
/// // A smooth bump that moves by (2, 1) pixels.
/// let bump = |cx: i32, cy: i32| GrayImage::from_fn(64, 64, |x, y| {
///     let (dx, dy) = (x as i32 - cx, y as i32 - cy);
///     (255 - (dx * dx + dy * dy).min(255)) as u8
/// });
/// let prev = LkPyramid::new(&bump(30, 30), 1)?;
/// let next = LkPyramid::new(&bump(32, 31), 1)?;
/// let found = lk::track(&prev, &next, &[[30.0, 30.0]], None, &LkConfig::default(), Par::Seq)?;
/// assert!(found[0].is_tracked());
/// assert!((found[0].xy[0] - 32.0).abs() < 0.02 && (found[0].xy[1] - 31.0).abs() < 0.02);
/// # Ok::<(), garad_features::FeatureError>(())
/// ```
pub fn track(
    prev: &LkPyramid,
    next: &LkPyramid,
    points: &[[f32; 2]],
    initial: Option<&[[f32; 2]]>,
    config: &LkConfig,
    par: Par,
) -> Result<Vec<LkTrack>, FeatureError> {
    track_with::<Fast>(prev, next, points, initial, config, par)
}

/// [`track`] with the sums written as their formulas: the same bits, slowly.
///
/// # Errors
/// As [`track`].
pub fn track_reference(
    prev: &LkPyramid,
    next: &LkPyramid,
    points: &[[f32; 2]],
    initial: Option<&[[f32; 2]]>,
    config: &LkConfig,
    par: Par,
) -> Result<Vec<LkTrack>, FeatureError> {
    track_with::<reference::Reference>(prev, next, points, initial, config, par)
}

fn track_with<W: Windows>(
    prev: &LkPyramid,
    next: &LkPyramid,
    points: &[[f32; 2]],
    initial: Option<&[[f32; 2]]>,
    config: &LkConfig,
    par: Par,
) -> Result<Vec<LkTrack>, FeatureError> {
    let mismatch = |what, left, right| Err(FeatureError::SizeMismatch { what, left, right });
    if prev.size() != next.size() {
        return mismatch("images", prev.size(), next.size());
    }
    if prev.levels() != next.levels() {
        return mismatch("numbers of levels", (prev.levels(), 0), (next.levels(), 0));
    }
    let starts = initial.unwrap_or(points);
    if starts.len() != points.len() {
        return mismatch("numbers of points", (points.len(), 0), (starts.len(), 0));
    }
    let chunks = par.map_chunks(points.len(), CHUNK, |range| {
        let mut template = W::Template::default(); // memory for one window
        range
            .map(|i| track_point::<W>(prev, next, points[i], starts[i], config, &mut template))
            .collect::<Vec<_>>()
    });
    Ok(chunks.concat())
}

/// The sums over a window that the loop needs; integers, so every implementation agrees.
trait Windows {
    /// Samples of the first image's window.
    type Template: Default;
    /// Takes the window of `level` at `place`; Σ (dx², dx dy, dy²).
    fn template(level: &LkLevel, place: &Place, template: &mut Self::Template) -> [i64; 3];
    /// Σ (J - I) (dx, dy).
    fn mismatch(template: &Self::Template, level: &LkLevel, place: &Place) -> [i64; 2];
    /// Σ |J - I|.
    fn absolute_difference(template: &Self::Template, level: &LkLevel, place: &Place) -> i64;
}

/// Upper left pixel of a window, and the weights of the four pixels around each sample.
#[derive(Debug, Clone, Copy)]
struct Place {
    x: isize,
    y: isize,
    weights: [i16; 4],
}

impl Place {
    /// Where a window with its upper left corner at `corner` reads; `None` if that lies more than
    /// a window before the image or behind its last pixel (or is NaN).
    #[allow(
        clippy::cast_possible_truncation,
        reason = "coordinates near the image, weights within 0..=2^14"
    )]
    fn new(corner: [f32; 2], level: &LkLevel) -> Option<Self> {
        let inside = |v: f32, n: usize| v >= -(WINDOW as f32) && v < n as f32;
        if !(inside(corner[0], level.width) && inside(corner[1], level.height)) {
            return None;
        }
        let floor = corner.map(f32::floor);
        let (a, b) = (corner[0] - floor[0], corner[1] - floor[1]);
        let one = (1 << WEIGHT_BITS) as f32;
        let weight = |product: f32| (product * one).round_ties_even() as i16;
        let w00 = weight((1.0 - a) * (1.0 - b));
        let w01 = weight(a * (1.0 - b));
        let w10 = weight((1.0 - a) * b);
        Some(Self {
            x: floor[0] as isize,
            y: floor[1] as isize,
            weights: [w00, w01, w10, (1 << WEIGHT_BITS) - w00 - w01 - w10],
        })
    }
}

/// From the coarsest level to the full image.
fn track_point<W: Windows>(
    prev: &LkPyramid,
    next: &LkPyramid,
    point: [f32; 2],
    start: [f32; 2],
    config: &LkConfig,
    template: &mut W::Template,
) -> LkTrack {
    let top = config.coarsest_level.min(prev.levels() - 1);
    let at_level = |p: [f32; 2], level: usize| p.map(|v| v * (1.0 / (1u32 << level) as f32));
    let mut estimate = at_level(start, top);
    for level in (1..=top).rev() {
        let (from, to) = (prev.level(level), next.level(level));
        // A level without a solution keeps the estimate for the next finer one.
        let step = LevelStep::<W>::prepare(from, at_level(point, level), config, template);
        if let Ok(step) = step {
            estimate = step.solve(to, estimate, config).0;
        }
        estimate = estimate.map(|v| v * 2.0);
    }
    finish::<W>(
        prev.level(0),
        next.level(0),
        point,
        estimate,
        config,
        template,
    )
}

/// The full image: here failures are reported.
fn finish<W: Windows>(
    from: &LkLevel,
    to: &LkLevel,
    point: [f32; 2],
    estimate: [f32; 2],
    config: &LkConfig,
    template: &mut W::Template,
) -> LkTrack {
    let lost = |xy, status, min_eigenvalue| LkTrack {
        xy,
        status,
        residual: 0.0,
        min_eigenvalue,
    };
    let step = match LevelStep::<W>::prepare(from, point, config, template) {
        Ok(step) => step,
        Err((status, min_eigenvalue)) => return lost(estimate, status, min_eigenvalue),
    };
    let (xy, stayed_inside) = step.solve(to, estimate, config);
    let place = Place::new(corner_of(xy), to).filter(|_| stayed_inside);
    let Some(place) = place else {
        return lost(xy, LkStatus::OutOfImage, step.min_eigenvalue);
    };
    let sum = W::absolute_difference(step.template, to, &place);
    let residual = sum as f32 / (32 * WINDOW * WINDOW) as f32;
    let acceptable = config.max_residual.is_none_or(|max| residual <= max);
    LkTrack {
        xy,
        status: if acceptable {
            LkStatus::Tracked
        } else {
            LkStatus::HighResidual
        },
        residual,
        min_eigenvalue: step.min_eigenvalue,
    }
}

const HALF_WINDOW: f32 = (WINDOW - 1) as f32 * 0.5;

fn corner_of(centre: [f32; 2]) -> [f32; 2] {
    centre.map(|v| v - HALF_WINDOW)
}

/// OpenCV's scale of the integer sums. Their products carry 2¹⁰ (intensities and slopes are 32 times
/// their values), so 2⁻¹⁰ remains: it cancels in the step and is part of the gate (E14).
const SUM_SCALE: f32 = 1.0 / (1 << 20) as f32;

/// The normal equations of one level.
struct LevelStep<'a, W: Windows> {
    template: &'a W::Template,
    g11: f32,
    g12: f32,
    g22: f32,
    inverse_determinant: f32,
    min_eigenvalue: f32,
}

impl<'a, W: Windows> LevelStep<'a, W> {
    /// The window of the first image, unless it lies outside or holds too little texture.
    fn prepare(
        from: &LkLevel,
        point: [f32; 2],
        config: &LkConfig,
        template: &'a mut W::Template,
    ) -> Result<Self, (LkStatus, f32)> {
        let place = Place::new(corner_of(point), from).ok_or((LkStatus::OutOfImage, 0.0))?;
        let gram = W::template(from, &place, template);
        let [g11, g12, g22] = gram.map(|sum| sum as f32 * SUM_SCALE);
        let determinant = g11 * g22 - g12 * g12;
        let root = ((g11 - g22) * (g11 - g22) + 4.0 * g12 * g12).sqrt();
        let min_eigenvalue = (g22 + g11 - root) / (2 * WINDOW * WINDOW) as f32;
        if min_eigenvalue >= config.min_eigenvalue && determinant >= f32::EPSILON {
            Ok(Self {
                template,
                g11,
                g12,
                g22,
                inverse_determinant: 1.0 / determinant,
                min_eigenvalue,
            })
        } else {
            Err((LkStatus::FlatTexture, min_eigenvalue))
        }
    }

    /// Steps until they are short, cancel each other, run out or leave the image; the position
    /// and whether it stayed inside.
    fn solve(&self, to: &LkLevel, start: [f32; 2], config: &LkConfig) -> ([f32; 2], bool) {
        let mut corner = corner_of(start);
        let mut estimate = start;
        let mut previous = [0.0f32; 2];
        for iteration in 0..config.iterations {
            let Some(place) = Place::new(corner, to) else {
                return (estimate, false);
            };
            let [b1, b2] = W::mismatch(self.template, to, &place).map(|sum| sum as f32 * SUM_SCALE);
            let delta = [
                (self.g12 * b2 - self.g22 * b1) * self.inverse_determinant,
                (self.g12 * b1 - self.g11 * b2) * self.inverse_determinant,
            ];
            corner = [corner[0] + delta[0], corner[1] + delta[1]];
            estimate = corner.map(|v| v + HALF_WINDOW);
            let [dx, dy] = delta.map(f64::from);
            if dx * dx + dy * dy <= config.epsilon_px * config.epsilon_px {
                break;
            }
            // Two steps that cancel: the solution lies half-way.
            let cancels = |i: usize| f64::from((delta[i] + previous[i]).abs()) < 0.01;
            if iteration > 0 && cancels(0) && cancels(1) {
                estimate = [estimate[0] - delta[0] * 0.5, estimate[1] - delta[1] * 0.5];
                break;
            }
            previous = delta;
        }
        (estimate, true)
    }
}

#[cfg(test)]
mod tests;
