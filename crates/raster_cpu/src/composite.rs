//! One pixel: splats blended front to back (R9 to R11, the paper's Eq. 15), and its backward pass,
//! back to front (R13, R14).

use garad_core::Real;

use crate::options::ClampGradient;
use crate::scalar::coordinate;
use crate::splat::Projected;
use crate::splat_gradient::SplatSums;

/// A splat thinner than this at a pixel is left out there (R10): it would move an 8-bit channel
/// by one step at most. Source: 3D Gaussian Splatting.
pub const MIN_ALPHA: f64 = 1.0 / 255.0;
/// No splat covers a pixel entirely (R10), so that 1 - alpha can be divided by. The two cuts
/// touch: (1 - 0.99)² is [`MIN_TRANSMITTANCE`]. A second full splat is still blended in f64 and
/// refused in f32, where 0.99 is rounded up.
pub const MAX_ALPHA: f64 = 0.99;
/// A pixel is finished before a splat that would let less light than this through (R11).
pub const MIN_TRANSMITTANCE: f64 = 1e-4;

/// One pixel of the rendered images.
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
}

impl<T: Real> Pixel<T> {
    /// No splat blended.
    pub(crate) const EMPTY: Self = Self {
        color: [T::ZERO; 3],
        depth: T::ZERO,
        transmittance: T::ONE,
        contributors: 0,
        last: 0,
    };
}

/// A splat at one pixel.
pub(crate) struct Sample<T> {
    /// Pixel minus centre, pixels.
    pub(crate) dx: T,
    pub(crate) dy: T,
    /// opacity e^power: alpha before it is clamped.
    pub(crate) density: T,
    pub(crate) alpha: T,
}

/// alpha = min(0.99, opacity e^power); `None` outside the footprint and for alpha < 1/255 (R10).
#[inline]
pub(crate) fn sample<T: Real>(splat: &Projected<T>, [x, y]: [usize; 2]) -> Option<Sample<T>> {
    if !splat.footprint.contains(x, y) {
        return None;
    }
    let dx = coordinate::<T>(x) - splat.mean_px[0];
    let dy = coordinate::<T>(y) - splat.mean_px[1];
    let density = splat.opacity * power(splat, dx, dy).exp_nonpositive();
    let alpha = T::from_f64(MAX_ALPHA).min(density);
    if alpha < T::from_f64(MIN_ALPHA) {
        return None;
    }
    Some(Sample {
        dx,
        dy,
        density,
        alpha,
    })
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

/// The pixel in column `x` and row `y` from the sorted splats of its tile.
///
/// C = Σᵢ cᵢ αᵢ Πⱼ₍ⱼ₌₁..ᵢ₋₁₎ (1 - αⱼ)                                             (Eq. 15, R11)
///
/// The product is the transmittance T in front of splat i. The depth is the same sum with zᵢ for
/// cᵢ. The pixel is finished before T (1 - αᵢ) < 1e-4.
/// With [`crate::Include::StaticOnly`] the splats are the static Gaussians, as in the paper.
///
/// Spec test: `spec_render`.
pub(crate) fn composite_pixel<T: Real>(
    splats: &[Projected<T>],
    list: &[u32],
    [x, y]: [usize; 2],
) -> Pixel<T> {
    let mut pixel = Pixel::EMPTY;
    for (&position, rank) in list.iter().zip(1u32..) {
        let splat = &splats[position as usize];
        let Some(Sample { alpha, .. }) = sample(splat, [x, y]) else {
            continue;
        };
        let left = pixel.transmittance * (T::ONE - alpha);
        if left < T::from_f64(MIN_TRANSMITTANCE) {
            break;
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
    pixel
}

// Cached between the two, per pixel: the transmittance at the end and the rank of the last splat.
// Alphas are computed again by the same function, so both passes skip the same splats.

/// What the backward pass of a pixel starts from.
#[derive(Debug, Clone, Copy)]
pub(crate) struct PixelGradient<T> {
    /// ∂L/∂color.
    pub(crate) d_color: [T; 3],
    /// ∂L/∂depth, 1/m.
    pub(crate) d_depth: T,
    /// ∂L/∂transmittance.
    pub(crate) d_transmittance: T,
    /// As in [`Pixel`].
    pub(crate) transmittance: T,
    /// As in [`Pixel`].
    pub(crate) last: u32,
}

/// Backward pass of [`composite_pixel`], back to front: adds the pixel's terms to `sums`, which has
/// one place per entry of the list.
///
/// eᵢ = ∂L/∂color · cᵢ + ∂L/∂depth zᵢ: by the weight of splat i                          (R13)
/// Bᵢ = ∂L/∂Tᵢ₊₁: by the light behind splat i
///
/// ∂L/∂alphaᵢ = Tᵢ (eᵢ - Bᵢ),  Bᵢ₋₁ = alphaᵢ eᵢ + (1 - alphaᵢ) Bᵢ,  Tᵢ = Tᵢ₊₁/(1 - alphaᵢ)
/// ∂L/∂powerᵢ = opacity e^power ∂L/∂alphaᵢ, and 0 where alpha is clamped                    (R14)
pub(crate) fn composite_pixel_backward<T: Real>(
    splats: &[Projected<T>],
    list: &[u32],
    [x, y]: [usize; 2],
    pixel: &PixelGradient<T>,
    clamp: ClampGradient,
    sums: &mut [SplatSums<T>],
) {
    let mut transmittance = pixel.transmittance;
    let mut behind = pixel.d_transmittance;
    for entry in (0..list.len().min(pixel.last as usize)).rev() {
        let splat = &splats[list[entry] as usize];
        let Some(Sample {
            dx,
            dy,
            density,
            alpha,
        }) = sample(splat, [x, y])
        else {
            continue;
        };
        let sums = &mut sums[entry];
        let through = T::ONE - alpha;
        transmittance /= through;
        let weight = alpha * transmittance;
        let mut own = pixel.d_depth * splat.depth_m;
        for channel in 0..3 {
            own += pixel.d_color[channel] * splat.color[channel];
            sums.color[channel] += weight * pixel.d_color[channel];
        }
        sums.depth += weight * pixel.d_depth;
        let d_alpha = transmittance * (own - behind);
        behind = alpha * own + through * behind;
        if density > T::from_f64(MAX_ALPHA) && clamp == ClampGradient::True {
            continue;
        }
        let g = density * d_alpha;
        let r = dx + splat.shear * dy;
        let (gr, gy) = (g * r, g * dy);
        sums.g += g;
        sums.r += gr;
        sums.y += gy;
        sums.rr += gr * r;
        sums.ry += gr * dy;
        sums.yy += gy * dy;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::splat::PixelRect;
    use crate::splat_gradient::SplatGradient;

    /// Round, variance 1 px², on the centre of pixel (2, 1).
    fn splat(opacity: f64, color: [f64; 3], depth_m: f64) -> Projected<f64> {
        Projected {
            mean_px: [2.0, 1.0],
            depth_m,
            conic: [1.0, 0.0, 1.0],
            inv_var_y: 1.0,
            sigma_px: [1.0, 1.0],
            opacity,
            color,
            radius_px: 3,
            footprint: PixelRect {
                x0: 0,
                x1: 6,
                y0: 0,
                y1: 3,
            },
            ..Projected::ZERO
        }
    }

    #[test]
    fn two_splats_by_hand() {
        let red = splat(0.5, [1.0, 0.0, 0.0], 1.0);
        let green = splat(0.8, [0.0, 1.0, 0.0], 3.0);
        let at = composite_pixel(&[green, red], &[1, 0], [2, 1]);
        // red 0.5; green 0.8 of the half that is left; 0.1 goes through.
        assert!((at.color[0] - 0.5).abs() < 1e-15, "red {}", at.color[0]);
        assert!((at.color[1] - 0.4).abs() < 1e-15, "green {}", at.color[1]);
        assert!((at.depth - (0.5 + 1.2)).abs() < 1e-15, "depth {}", at.depth);
        assert!((at.transmittance - 0.1).abs() < 1e-15, "left");
        assert_eq!((at.contributors, at.last), (2, 2), "both");
        // Three pixels aside e^-4.5 = 0.0111: red 0.0056 and green 0.0089 both pass 1/255.
        let aside = composite_pixel(&[green, red], &[1, 0], [5, 1]);
        assert_eq!(aside.contributors, 2, "at three sigma");
    }

    /// L = red of the pixel both splats are centred on: ½ c₁ + ½ · 0.8 c₂ + ½ · 0.2 background.
    #[test]
    fn two_splats_backward_by_hand() {
        let splats = [
            splat(0.5, [0.9, 0.0, 0.0], 1.0),
            splat(0.8, [0.3, 0.0, 0.0], 2.0),
        ];
        let background = 0.7;
        let pixel = PixelGradient {
            d_color: [1.0, 0.0, 0.0],
            d_depth: 10.0,
            d_transmittance: background,
            transmittance: 0.1,
            last: 2,
        };
        let mut sums = [SplatSums::ZERO; 2];
        let clamp = ClampGradient::True;
        composite_pixel_backward(&splats, &[0, 1], [2, 1], &pixel, clamp, &mut sums);
        let [near, far] = [0, 1].map(|k| SplatGradient::new(&splats[k], &sums[k]));
        // By the weight: red + 10 z, 10.9 and 20.3.
        let behind_near = 0.8 * 20.3 + 0.2 * background;
        assert!(
            (near.opacity - (10.9 - behind_near)).abs() < 1e-13,
            "{near:?}"
        );
        assert!(
            (far.opacity - 0.5 * (20.3 - background)).abs() < 1e-13,
            "{far:?}"
        );
        // The weight of the near one is ½ only if nothing stands in front of it.
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
    }

    #[test]
    fn a_splat_that_would_leave_too_little_ends_the_pixel() {
        let full = splat(1.0, [1.0; 3], 1.0);
        let most = splat(0.98, [1.0; 3], 1.0);
        let thin = splat(0.01, [1.0; 3], 2.0);
        let splats = [full, most, thin];
        // 0.01 · 0.02 = 2e-4 is left; the next full one is refused, and the thin one behind it,
        // which would have left 1.98e-4, is skipped as well.
        let at = composite_pixel(&splats, &[0, 1, 0, 2], [2, 1]);
        assert_eq!((at.contributors, at.last), (2, 2), "closed by the third");
        assert!((at.transmittance - 2e-4).abs() < 1e-15, "0.01 · 0.02");
        let at = composite_pixel(&splats, &[0, 1, 2, 0], [2, 1]);
        assert_eq!((at.contributors, at.last), (3, 3), "in front of it, it is");
    }

    #[test]
    fn the_footprint_bounds_a_splat() {
        let mut s = splat(0.9, [1.0; 3], 1.0);
        s.footprint = PixelRect {
            x0: 1,
            x1: 3,
            y0: 0,
            y1: 2,
        };
        let drawn = [0, 1, 2]
            .map(|y| [0, 1, 2, 3].map(|x| composite_pixel(&[s], &[0], [x, y]).contributors));
        let expected = [[0, 1, 1, 0], [0, 1, 1, 0], [0; 4]];
        assert_eq!(drawn, expected, "columns 1 and 2 of rows 0 and 1");
    }

    #[test]
    fn power_of_a_tilted_needle_keeps_its_digits_in_f32() {
        // Σ' = [100.3, 100; 100, 100.3] px², seen 30 px along its axis: xx yy - xy² = 60.09.
        let (xx, xy, yy, det) = (100.3f64, 100.0, 100.3, 60.09);
        let needle = Projected {
            conic: [yy / det, -xy / det, xx / det],
            shear: -xy / yy,
            inv_var_y: 1.0 / yy,
            ..Projected::ZERO
        };
        let narrow = Projected::<f32> {
            conic: needle.conic.map(Real::to_f32),
            shear: needle.shear.to_f32(),
            inv_var_y: needle.inv_var_y.to_f32(),
            ..Projected::ZERO
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
