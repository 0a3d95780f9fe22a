//! One tile: splats blended front to back into its pixels (R9 to R12), and what the pixels ask of
//! them, back to front (R13, R14).

use garad_core::Real;

use crate::backward::ClampGradient;
use crate::project::{PixelRect, Projected, to_index};

/// A splat thinner than this at a pixel is left out there (R10): it would move an 8-bit channel
/// by one step at most. Source: 3D Gaussian Splatting.
pub const MIN_ALPHA: f64 = 1.0 / 255.0;
/// No splat covers a pixel entirely (R10), so that 1 - alpha can be divided by. The two cuts
/// touch: (1 - 0.99)² is [`MIN_TRANSMITTANCE`]. A second full splat is still blended in f64 and
/// refused in f32, where 0.99 is rounded up.
pub const MAX_ALPHA: f64 = 0.99;
/// A pixel is finished before a splat that would let less light than this through (R11).
pub const MIN_TRANSMITTANCE: f64 = 1e-4;

/// What has arrived at one pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Pixel<T> {
    /// Σ w color, without background.
    pub(crate) color: [T; 3],
    /// Σ w z, metres.
    pub(crate) depth: T,
    /// Π (1 - alpha): the share of light that is left.
    pub(crate) transmittance: T,
    /// Splats blended.
    pub(crate) contributors: u32,
    /// One more than the position of the last of them in the tile's list; 0 if there is none.
    pub(crate) last: u32,
    /// May still take light.
    open: bool,
}

impl<T: Real> Pixel<T> {
    /// Nothing has arrived yet.
    pub(crate) const fn new() -> Self {
        Self {
            color: [T::ZERO; 3],
            depth: T::ZERO,
            transmittance: T::ONE,
            contributors: 0,
            last: 0,
            open: true,
        }
    }
}

/// -½ dᵀ [a, b; b, c] d for d = pixel - mean, as a sum of squares (R9):
///
/// power = -½ ( a (dx + (b/a) dy)² + dy²/Σ'yy )
///
/// Never positive, so the CUDA rasterizer's test for power > 0, which catches the rounding of
/// a dx² + 2 b dx dy + c dy² on needles, has nothing to catch here.
#[inline]
fn power<T: Real>(splat: &Projected<T>, dx: T, dy: T) -> T {
    let along = dx + splat.shear * dy;
    T::from_f64(-0.5) * (splat.conic[0] * along * along + splat.inv_var_y * dy * dy)
}

/// The pixels of one tile, row by row.
///
/// alpha = min(0.99, opacity e^power); skipped if alpha < 1/255                          (R10)
/// w = alpha T;  color += w c;  depth += w z;  T ← T (1 - alpha);
/// finished before T (1 - alpha) < 1e-4                                                  (R11)
///
/// Splats are the outer loop and pixels the inner one. Each pixel still meets its splats front
/// to back, so this is the same sum in the same order as a loop over pixels.
pub(crate) fn composite_tile<T: Real>(
    splats: &[Projected<T>],
    list: &[u32],
    rect: &PixelRect,
) -> Vec<Pixel<T>> {
    let (width, height) = (rect.x1 - rect.x0, rect.y1 - rect.y0);
    let mut pixels = vec![Pixel::new(); width * height];
    let mut open = pixels.len();
    let columns: Vec<T> = (rect.x0..rect.x1).map(coordinate).collect();
    let mut row_alpha = vec![T::ZERO; width];
    let [min_alpha, min_transmittance] = [MIN_ALPHA, MIN_TRANSMITTANCE].map(T::from_f64);

    for (&position, rank) in list.iter().zip(1u32..) {
        if open == 0 {
            break;
        }
        let splat = &splats[position as usize];
        let Some(reach) = Reach::new(splat, rect) else {
            continue;
        };
        for y in reach.rows() {
            let dy = coordinate::<T>(y) - splat.mean_px[1];
            let (first, end) = reach.columns(splat, dy);
            if first >= end {
                continue;
            }
            let part = first - rect.x0..end - rect.x0;
            let alphas = &mut row_alpha[part.clone()];
            alpha(splat, &columns[part.clone()], dy, alphas);
            let row = &mut pixels[(y - rect.y0) * width..][part];
            for (pixel, &alpha) in row.iter_mut().zip(alphas.iter()) {
                if alpha < min_alpha || !pixel.open {
                    continue;
                }
                let left = pixel.transmittance * (T::ONE - alpha);
                if left < min_transmittance {
                    pixel.open = false;
                    open -= 1;
                    continue;
                }
                let weight = alpha * pixel.transmittance;
                for channel in 0..3 {
                    pixel.color[channel] += weight * splat.color[channel];
                }
                pixel.depth += weight * splat.depth_m;
                pixel.transmittance = left;
                pixel.contributors += 1;
                pixel.last = rank;
            }
        }
    }
    pixels
}

/// min(0.99, opacity e^power) at the pixels of a row whose columns are `xs` (R10).
#[inline]
fn alpha<T: Real>(splat: &Projected<T>, xs: &[T], dy: T, out: &mut [T]) {
    let max_alpha = T::from_f64(MAX_ALPHA);
    for (&x, alpha) in xs.iter().zip(out) {
        *alpha = max_alpha.min(density(splat, x - splat.mean_px[0], dy));
    }
}

/// opacity e^power: alpha before it is clamped (R9).
#[inline]
fn density<T: Real>(splat: &Projected<T>, dx: T, dy: T) -> T {
    splat.opacity * power(splat, dx, dy).exp_nonpositive()
}

// Cached between the two, per pixel: the transmittance at the end and the rank of the last splat.
// Alphas are computed again by the same expression, so that both ways skip the same splats.

/// One pixel on the way back.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PixelBackward<T> {
    /// ∂L/∂color.
    pub(crate) d_color: [T; 3],
    /// ∂L/∂depth, 1/m.
    pub(crate) d_depth: T,
    /// T behind the splat that comes next on the way back; first what was left at the end.
    pub(crate) transmittance: T,
    /// What a ray that has come as far as there brings to L per unit of its light; first ∂L/∂T.
    pub(crate) behind: T,
    /// Rank of the last splat blended.
    pub(crate) last: u32,
}

/// Sums over pixels of one splat, from which all its gradients follow linearly. With
/// g = ∂L/∂power, r = dx + (b/a) dy and dy the distance from the centre as in [`power`]:
#[derive(Debug, Clone, Copy)]
pub(crate) struct SplatSums<T> {
    /// Σ g.
    pub(crate) g: T,
    /// Σ g r.
    pub(crate) r: T,
    /// Σ g dy.
    pub(crate) y: T,
    /// Σ g r².
    pub(crate) rr: T,
    /// Σ g r dy.
    pub(crate) ry: T,
    /// Σ g dy².
    pub(crate) yy: T,
    /// Σ w ∂L/∂(pixel's color).
    pub(crate) color: [T; 3],
    /// Σ w ∂L/∂(pixel's depth).
    pub(crate) depth: T,
}

impl<T: Real> SplatSums<T> {
    /// No pixel yet.
    pub(crate) const fn new() -> Self {
        Self {
            g: T::ZERO,
            r: T::ZERO,
            y: T::ZERO,
            rr: T::ZERO,
            ry: T::ZERO,
            yy: T::ZERO,
            color: [T::ZERO; 3],
            depth: T::ZERO,
        }
    }

    /// Adds another tile's.
    pub(crate) fn add(&mut self, other: &Self) {
        self.g += other.g;
        self.r += other.r;
        self.y += other.y;
        self.rr += other.rr;
        self.ry += other.ry;
        self.yy += other.yy;
        for (sum, part) in self.color.iter_mut().zip(other.color) {
            *sum += part;
        }
        self.depth += other.depth;
    }
}

/// ∂L/∂ of what [`composite_tile`] reads of a splat.
#[derive(Debug, Clone, Copy)]
pub(crate) struct SplatGradient<T> {
    /// px⁻¹.
    pub(crate) mean_px: [T; 2],
    /// By (a, b, c), px²; b stands for both entries off the diagonal.
    pub(crate) conic: [T; 3],
    /// By (Σ'xx, Σ'xy, Σ'yy), px⁻²; Σ'xy stands for both. The same derivative as `conic`, by the
    /// inverse matrix.
    pub(crate) covariance: [T; 3],
    pub(crate) opacity: T,
    pub(crate) color: [T; 3],
    /// m⁻¹.
    pub(crate) depth_m: T,
}

impl<T: Real> SplatGradient<T> {
    /// Gradients from the sums (R14), with v = Σ'⁻¹ d = (a r, (b/a) a r + dy/Σ'yy):
    ///
    /// by the mean Σ g v;  by Σ' ½ Σ g v vᵀ;  by the conic -½ Σ g d dᵀ;  by the opacity Σ g/opacity
    ///
    /// The form by Σ' needs no inverse of anything: going from the conic to Σ' would take
    /// differences that cancel on needles.
    pub(crate) fn new(splat: &Projected<T>, sums: &SplatSums<T>) -> Self {
        let (half, two) = (T::from_f64(0.5), T::from_f64(2.0));
        let (a, shear, inv) = (splat.conic[0], splat.shear, splat.inv_var_y);
        let up = shear * a; // v_y = up r + inv dy
        Self {
            mean_px: [a * sums.r, up * sums.r + inv * sums.y],
            conic: [
                -half * (sums.rr - two * shear * sums.ry + shear * shear * sums.yy),
                shear * sums.yy - sums.ry,
                -half * sums.yy,
            ],
            covariance: [
                half * a * a * sums.rr,
                a * (up * sums.rr + inv * sums.ry),
                half * (up * up * sums.rr + two * up * inv * sums.ry + inv * inv * sums.yy),
            ],
            // A splat of opacity 0 has met no pixel.
            opacity: if splat.opacity > T::ZERO {
                sums.g / splat.opacity
            } else {
                T::ZERO
            },
            color: sums.color,
            depth_m: sums.depth,
        }
    }
}

/// The way back through [`composite_tile`]: for each entry of the tile's list, its sums over the
/// tile's pixels.
///
/// eᵢ = ∂L/∂color · cᵢ + ∂L/∂depth zᵢ: what a unit of weight on splat i brings           (R13)
/// Bᵢ = what stands behind splat i brings per unit of light that reaches it
///
/// ∂L/∂alphaᵢ = Tᵢ (eᵢ - Bᵢ),  Bᵢ₋₁ = alphaᵢ eᵢ + (1 - alphaᵢ) Bᵢ,  Tᵢ = Tᵢ₊₁/(1 - alphaᵢ)
/// ∂L/∂powerᵢ = opacity e^power ∂L/∂alphaᵢ, and 0 where alpha is clamped                    (R14)
///
/// `pixels` is used up.
pub(crate) fn composite_tile_backward<T: Real>(
    splats: &[Projected<T>],
    list: &[u32],
    rect: &PixelRect,
    pixels: &mut [PixelBackward<T>],
    clamp: ClampGradient,
) -> Vec<SplatSums<T>> {
    let width = rect.x1 - rect.x0;
    let columns: Vec<T> = (rect.x0..rect.x1).map(coordinate).collect();
    let mut row_density = vec![T::ZERO; width];
    let [min_alpha, max_alpha] = [MIN_ALPHA, MAX_ALPHA].map(T::from_f64);
    let deepest = pixels.iter().map(|p| p.last).max().unwrap_or(0);
    let mut sums_of = vec![SplatSums::new(); list.len()];

    for entry in (0..list.len().min(deepest as usize)).rev() {
        let splat = &splats[list[entry] as usize];
        let Some(reach) = Reach::new(splat, rect) else {
            continue;
        };
        let mut sums = SplatSums::new();
        for y in reach.rows() {
            let dy = coordinate::<T>(y) - splat.mean_px[1];
            let (first, end) = reach.columns(splat, dy);
            if first >= end {
                continue;
            }
            let part = first - rect.x0..end - rect.x0;
            let (xs, densities) = (&columns[part.clone()], &mut row_density[part.clone()]);
            for (&x, out) in xs.iter().zip(densities.iter_mut()) {
                *out = density(splat, x - splat.mean_px[0], dy);
            }
            let row = &mut pixels[(y - rect.y0) * width..][part];
            for ((pixel, &x), &density) in row.iter_mut().zip(xs).zip(densities.iter()) {
                let alpha = max_alpha.min(density);
                if alpha < min_alpha || entry >= pixel.last as usize {
                    continue;
                }
                let through = T::ONE - alpha;
                let reached = pixel.transmittance / through;
                let weight = alpha * reached;
                let mut own = pixel.d_depth * splat.depth_m;
                for channel in 0..3 {
                    own += pixel.d_color[channel] * splat.color[channel];
                    sums.color[channel] += weight * pixel.d_color[channel];
                }
                sums.depth += weight * pixel.d_depth;
                let d_alpha = reached * (own - pixel.behind);
                pixel.behind = alpha * own + through * pixel.behind;
                pixel.transmittance = reached;
                if density > max_alpha && clamp == ClampGradient::True {
                    continue;
                }
                let g = density * d_alpha;
                let r = x - splat.mean_px[0] + splat.shear * dy;
                let (gr, gy) = (g * r, g * dy);
                sums.g += g;
                sums.r += gr;
                sums.y += gy;
                sums.rr += gr * r;
                sums.ry += gr * dy;
                sums.yy += gy * dy;
            }
        }
        sums_of[entry] = sums;
    }
    sums_of
}

/// An index as a coordinate; exact below [`crate::MAX_SIDE_PX`].
#[inline]
fn coordinate<T: Real>(index: usize) -> T {
    T::from_f64(index as f64)
}

/// Where in a tile a splat's alpha can reach 1/255. Everything outside would have been skipped
/// by that test, so this changes the time and nothing else.
///
/// alpha ≥ 1/255 ⟺ a (dx + (b/a) dy)² + dy²/Σ'yy ≤ k,  k = 2 ln(255 opacity)            (R12)
///
/// an ellipse; k is enlarged by 1 % and intervals by a pixel, far more than rounding can move.
struct Reach<T> {
    /// Footprint and tile in common, rows further cut to the ellipse.
    rect: PixelRect,
    /// k, enlarged.
    k: T,
}

impl<T: Real> Reach<T> {
    /// `None` when no pixel of the tile can be reached.
    fn new(splat: &Projected<T>, tile: &PixelRect) -> Option<Self> {
        let brightest = T::from_f64(255.0) * splat.opacity;
        // Not positive where no pixel can pass; -∞ for opacity 0.
        let k = T::from_f64(2.02) * brightest.ln() + T::from_f64(0.02);
        if k <= T::ZERO {
            return None;
        }
        let half = k.sqrt() * splat.sigma_px[1];
        let (y0, y1) = interval(splat.mean_px[1], half);
        let footprint = &splat.footprint;
        let rect = PixelRect {
            x0: tile.x0.max(footprint.x0),
            x1: tile.x1.min(footprint.x1),
            y0: tile.y0.max(footprint.y0).max(y0),
            y1: tile.y1.min(footprint.y1).min(y1),
        };
        (!rect.is_empty()).then_some(Self { rect, k })
    }

    fn rows(&self) -> std::ops::Range<usize> {
        self.rect.y0..self.rect.y1
    }

    /// First column, and the one after the last, of the row at distance `dy` from the centre.
    fn columns(&self, splat: &Projected<T>, dy: T) -> (usize, usize) {
        let rest = (self.k - splat.inv_var_y * dy * dy).max(T::ZERO);
        let half = (rest / splat.conic[0]).sqrt();
        let (x0, x1) = interval(splat.mean_px[0] - splat.shear * dy, half);
        (self.rect.x0.max(x0), self.rect.x1.min(x1))
    }
}

/// The pixels within `half` of `middle`, and one or two more on either side.
#[inline]
fn interval<T: Real>(middle: T, half: T) -> (usize, usize) {
    let (one, two) = (T::ONE, T::from_f64(2.0));
    (to_index(middle - half - one), to_index(middle + half + two))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Round, variance 1 px², on the centre of pixel (2, 1).
    fn splat(opacity: f64, color: [f64; 3], depth_m: f64) -> Projected<f64> {
        Projected {
            index: 0,
            mean_px: [2.0, 1.0],
            depth_m,
            conic: [1.0, 0.0, 1.0],
            shear: 0.0,
            inv_var_y: 1.0,
            sigma_px: [1.0, 1.0],
            opacity,
            color,
            radius_px: 3,
            footprint: TILE,
        }
    }

    const TILE: PixelRect = PixelRect {
        x0: 0,
        x1: 6,
        y0: 0,
        y1: 3,
    };

    #[test]
    fn two_splats_by_hand() {
        let red = splat(0.5, [1.0, 0.0, 0.0], 1.0);
        let green = splat(0.8, [0.0, 1.0, 0.0], 3.0);
        let pixels = composite_tile(&[green, red], &[1, 0], &TILE);
        let at = pixels[6 + 2];
        // red 0.5; green 0.8 of the half that is left; 0.1 goes through.
        assert!((at.color[0] - 0.5).abs() < 1e-15, "red {}", at.color[0]);
        assert!((at.color[1] - 0.4).abs() < 1e-15, "green {}", at.color[1]);
        assert!((at.depth - (0.5 + 1.2)).abs() < 1e-15, "depth {}", at.depth);
        assert!((at.transmittance - 0.1).abs() < 1e-15, "left");
        assert_eq!((at.contributors, at.last), (2, 2), "both");
        // Three pixels aside e^-4.5 = 0.0111: red 0.0056 and green 0.0089 both pass 1/255.
        assert_eq!(pixels[6 + 5].contributors, 2, "at three sigma");
    }

    /// L = red of the pixel both splats are centred on: ½ c₁ + ½ · 0.8 c₂ + ½ · 0.2 background.
    #[test]
    fn two_splats_on_the_way_back_by_hand() {
        let splats = [
            splat(0.5, [0.9, 0.0, 0.0], 1.0),
            splat(0.8, [0.3, 0.0, 0.0], 2.0),
        ];
        let background = 0.7;
        let mut pixels = [PixelBackward {
            d_color: [0.0; 3],
            d_depth: 0.0,
            transmittance: 1.0,
            behind: 0.0,
            last: 0,
        }; 18];
        pixels[6 + 2] = PixelBackward {
            d_color: [1.0, 0.0, 0.0],
            d_depth: 10.0,
            transmittance: 0.1,
            behind: background,
            last: 2,
        };
        let both =
            composite_tile_backward(&splats, &[0, 1], &TILE, &mut pixels, ClampGradient::True);
        let [near, far] = [0, 1].map(|k| SplatGradient::new(&splats[k], &both[k]));
        // A unit of weight brings red + 10 z: 10.9 and 20.3.
        let behind_near = 0.8 * 20.3 + 0.2 * background;
        assert!(
            (near.opacity - (10.9 - behind_near)).abs() < 1e-13,
            "{near:?}"
        );
        assert!(
            (far.opacity - 0.5 * (20.3 - background)).abs() < 1e-13,
            "{far:?}"
        );
        assert!(
            (near.color[0] - 0.5).abs() < 1e-15 && (far.color[0] - 0.4).abs() < 1e-15,
            "weights"
        );
        assert!(
            (near.depth_m - 5.0).abs() < 1e-14 && (far.depth_m - 4.0).abs() < 1e-14,
            "weights"
        );
        assert!(
            near.mean_px.iter().all(|v| v.abs() < 1e-15),
            "on its summit"
        );
        assert!(
            (pixels[6 + 2].transmittance - 1.0).abs() < 1e-15,
            "nothing stands before"
        );
    }

    /// The derivative by Σ' and that by its inverse are one: G = -Σ' G' Σ'.
    #[test]
    fn conic_and_covariance_agree() {
        let (xx, xy, yy) = (9.0, -4.0, 5.0);
        let det: f64 = xx * yy - xy * xy;
        let turned = Projected {
            conic: [yy / det, -xy / det, xx / det],
            shear: -xy / yy,
            inv_var_y: 1.0 / yy,
            ..splat(0.8, [1.0; 3], 1.0)
        };
        let sums = SplatSums {
            g: 1.0,
            r: 0.3,
            y: -0.2,
            rr: 2.0,
            ry: 0.7,
            yy: 3.0,
            color: [0.0; 3],
            depth: 0.0,
        };
        let d = SplatGradient::new(&turned, &sums);
        // Entries off the diagonal hold half of the derivative each.
        let s = nalgebra::Matrix2::new(xx, xy, xy, yy);
        let half = |[a, b, c]: [f64; 3]| nalgebra::Matrix2::new(a, b / 2.0, b / 2.0, c);
        let difference = half(d.conic) + s * half(d.covariance) * s;
        assert!(difference.norm() < 1e-13, "{difference}");
    }

    /// A tilted needle in f32: by Σ' straight from the sums against by Σ' through the conic.
    #[test]
    fn gradient_by_the_covariance_of_a_needle_keeps_its_digits_in_f32() {
        let (xx, xy, det) = (100.3f64, 100.0, 60.09);
        let needle = Projected {
            conic: [xx / det, -xy / det, xx / det],
            shear: -xy / xx,
            inv_var_y: 1.0 / xx,
            ..splat(1.0, [1.0; 3], 1.0)
        };
        // A pull on one pixel, 9 px along the axis and 1 px aside.
        let (dx, dy) = (9.0, 8.0);
        let r = dx + needle.shear * dy;
        let sums = SplatSums {
            g: 1.0,
            r,
            y: dy,
            rr: r * r,
            ry: r * dy,
            yy: dy * dy,
            color: [0.0; 3],
            depth: 0.0,
        };
        let narrow = Projected::<f32> {
            index: 0,
            mean_px: [2.0, 1.0],
            depth_m: 1.0,
            conic: needle.conic.map(Real::to_f32),
            shear: needle.shear.to_f32(),
            inv_var_y: needle.inv_var_y.to_f32(),
            sigma_px: [10.0, 10.0],
            opacity: 1.0,
            color: [1.0; 3],
            radius_px: 43,
            footprint: TILE,
        };
        let sums32 = SplatSums::<f32> {
            g: 1.0,
            r: r.to_f32(),
            y: 8.0,
            rr: (r * r).to_f32(),
            ry: (r * dy).to_f32(),
            yy: 64.0,
            color: [0.0; 3],
            depth: 0.0,
        };
        let exact = SplatGradient::new(&needle, &sums).covariance;
        let got = SplatGradient::new(&narrow, &sums32);
        let error = |by: [f32; 3]| {
            let pairs = by.into_iter().zip(exact);
            let worst = pairs
                .map(|(a, b)| (f64::from(a) - b).abs())
                .fold(0.0, f64::max);
            worst / exact[0].abs()
        };
        let straight = error(got.covariance);
        assert!(straight < 4e-6, "straight: {straight:e}");
        // -Σ'⁻¹ G Σ'⁻¹ with G = [p, q/2; q/2, s] and Σ'⁻¹ = [a, b; b, c].
        let ([a, b, c], [p, q, s]) = (narrow.conic, got.conic);
        let through = error([
            -(a * a * p + a * b * q + b * b * s),
            -(2.0 * a * b * p + (a * c + b * b) * q + 2.0 * b * c * s),
            -(b * b * p + b * c * q + c * c * s),
        ]);
        assert!(
            through > 10.0 * straight,
            "{straight:e} against {through:e}"
        );
    }

    #[test]
    fn a_splat_that_would_leave_too_little_ends_the_pixel() {
        let full = splat(1.0, [1.0; 3], 1.0);
        let most = splat(0.98, [1.0; 3], 1.0);
        let thin = splat(0.01, [1.0; 3], 2.0);
        let splats = [full, most, thin];
        // 0.01 · 0.02 = 2e-4 is left; the next full one is refused, and the thin one behind it,
        // which would have left 1.98e-4, is not asked any more.
        let at = composite_tile(&splats, &[0, 1, 0, 2], &TILE)[6 + 2];
        assert_eq!((at.contributors, at.last), (2, 2), "closed by the third");
        assert!((at.transmittance - 2e-4).abs() < 1e-15, "0.01 · 0.02");
        let at = composite_tile(&splats, &[0, 1, 2, 0], &TILE)[6 + 2];
        assert_eq!((at.contributors, at.last), (3, 3), "in front of it, it is");
    }

    #[test]
    fn footprint_and_tile_bound_a_splat() {
        let mut s = splat(0.9, [1.0; 3], 1.0);
        s.footprint.x1 = 3;
        let drawn: Vec<u32> = composite_tile(&[s], &[0], &TILE)
            .iter()
            .map(|p| p.contributors)
            .collect();
        #[rustfmt::skip]
        assert_eq!(drawn, [
            1, 1, 1, 0, 0, 0,
            1, 1, 1, 0, 0, 0,
            1, 1, 1, 0, 0, 0,
        ], "columns 0 to 2");
    }

    #[test]
    fn power_of_a_tilted_needle_keeps_its_digits_in_f32() {
        // Σ' = [100.3, 100; 100, 100.3] px², seen 30 px along its axis: xx yy - xy² = 60.09.
        let (xx, xy, yy, det) = (100.3f64, 100.0, 100.3, 60.09);
        let needle = Projected {
            conic: [yy / det, -xy / det, xx / det],
            shear: -xy / yy,
            inv_var_y: 1.0 / yy,
            ..splat(1.0, [1.0; 3], 1.0)
        };
        let narrow = Projected::<f32> {
            index: 0,
            mean_px: needle.mean_px.map(Real::to_f32),
            depth_m: 1.0,
            conic: needle.conic.map(Real::to_f32),
            shear: needle.shear.to_f32(),
            inv_var_y: needle.inv_var_y.to_f32(),
            sigma_px: [10.0, 10.0],
            opacity: 1.0,
            color: [1.0; 3],
            radius_px: 43,
            footprint: TILE,
        };
        // dᵀ Σ'⁻¹ d = 900 (1/200.3) · 2 along the long axis.
        let exact = -900.0 / 200.3;
        assert!((power(&needle, 30.0, 30.0) - exact).abs() < 1e-13, "f64");
        let error = f64::from(power(&narrow, 30.0f32, 30.0)) - exact;
        assert!(error.abs() < 1e-5, "f32: {error:e}");
        let [a, b, c] = narrow.conic;
        let literal = -0.5 * (a * 900.0 + c * 900.0) - b * 900.0;
        let error = f64::from(literal) - exact;
        assert!(error.abs() > 1e-5, "the literal form is worse: {error:e}");
    }
}
