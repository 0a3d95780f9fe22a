//! Where exactly a corner is: the point that the gradients around it agree on.

use garad_core::GrayImage;

/// Half the side of the window, pixels of the level.
const RADIUS: i32 = 3;
/// Standard deviation of the window's weights, pixels.
const SIGMA_PX: f64 = 1.5;
/// Rounds; each centres the weights on the last answer.
const ROUNDS: usize = 3;
/// A corner does not move farther than this from its pixel, px.
const MAX_SHIFT_PX: f64 = 1.0;
/// Smallest ratio of the eigenvalues of N: below it the window holds an edge, not a corner.
const MIN_RATIO: f64 = 0.03;

/// Offset (dx, dy) of the corner near pixel (x, y), or zero where the window holds no corner.
///
/// At a corner q every gradient g of the window is either zero or lies on an edge through q, so
/// that gᵢᵀ(q - pᵢ) = 0. In least squares, with Gaussian weights w around the last estimate,
///
/// N q = Σ wᵢ gᵢ gᵢᵀ pᵢ,   N = Σ wᵢ gᵢ gᵢᵀ                                                (E20)
///
/// Source: Förstner & Gülch 1987. Gradients are central differences of whole pixels.
///
/// # Numerics
/// f64, fixed order. The answer is (0, 0) if N is nearly singular, if q leaves the unit square
/// around the pixel, or within 4 pixels of the picture's edge.
#[must_use]
pub fn corner_offset(image: &GrayImage, x: usize, y: usize) -> (f64, f64) {
    let margin = RADIUS.unsigned_abs() as usize + 1;
    let (width, height) = image.size();
    if x < margin || y < margin || x + margin >= width || y + margin >= height {
        return (0.0, 0.0);
    }
    let (mut qx, mut qy) = (0.0, 0.0);
    for _ in 0..ROUNDS {
        let [mut nxx, mut nxy, mut nyy, mut bx, mut by] = [0.0; 5];
        for dy in -RADIUS..=RADIUS {
            let wy = weight(f64::from(dy) - qy);
            let row = |offset: i32| image.row(y.wrapping_add_signed((dy + offset) as isize));
            let (above, here, below) = (row(-1), row(0), row(1));
            for dx in -RADIUS..=RADIUS {
                let at = x.wrapping_add_signed(dx as isize);
                let gx = f64::from(here[at + 1]) - f64::from(here[at - 1]);
                let gy = f64::from(below[at]) - f64::from(above[at]);
                let w = wy * weight(f64::from(dx) - qx);
                let (px, py) = (f64::from(dx), f64::from(dy));
                nxx += w * gx * gx;
                nxy += w * gx * gy;
                nyy += w * gy * gy;
                bx += w * gx * (gx * px + gy * py);
                by += w * gy * (gx * px + gy * py);
            }
        }
        let det = nxx * nyy - nxy * nxy;
        let trace = nxx + nyy;
        // λ₁ λ₂ / (λ₁ + λ₂)² grows with the ratio of the eigenvalues; NaN loses.
        let round_enough = det > MIN_RATIO / ((1.0 + MIN_RATIO) * (1.0 + MIN_RATIO)) * trace * trace;
        if !round_enough {
            return (0.0, 0.0);
        }
        qx = (nyy * bx - nxy * by) / det;
        qy = (nxx * by - nxy * bx) / det;
        if qx.abs() > MAX_SHIFT_PX || qy.abs() > MAX_SHIFT_PX {
            return (0.0, 0.0);
        }
    }
    (qx, qy)
}

fn weight(distance_px: f64) -> f64 {
    libm::exp(-distance_px * distance_px / (2.0 * SIGMA_PX * SIGMA_PX))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bright quarter plane whose corner is at (16 + u, 16 + v), each pixel its share of it.
    fn quarter(u: f64, v: f64) -> GrayImage {
        let share = |c: usize, corner: f64| (c as f64 + 0.5 - corner).clamp(0.0, 1.0);
        GrayImage::from_fn(33, 33, |x, y| {
            let bright = share(x, 16.0 + u) * share(y, 16.0 + v);
            #[allow(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "20..=220"
            )]
            let value = (20.0 + 200.0 * bright + 0.5) as u8;
            value
        })
    }

    /// Two edges through one point: the answer does not depend on where the pixel grid lies.
    #[test]
    fn a_quarter_plane_is_found_between_pixels() {
        for (u, v) in [(0.0, 0.0), (0.3, -0.2), (-0.45, 0.4), (0.25, 0.25)] {
            let (dx, dy) = corner_offset(&quarter(u, v), 16, 16);
            let error = libm::hypot(dx - u, dy - v);
            assert!(error < 0.06, "({u}, {v}): found ({dx:.3}, {dy:.3})");
        }
    }

    #[test]
    fn an_edge_a_plain_picture_and_the_rim_do_not_move() {
        let edge = GrayImage::from_fn(33, 33, |x, _| if x > 16 { 200 } else { 20 });
        assert_eq!(corner_offset(&edge, 16, 16), (0.0, 0.0), "an edge has no point");
        let plain = GrayImage::new(33, 33, 90);
        assert_eq!(corner_offset(&plain, 16, 16), (0.0, 0.0), "nothing there");
        assert_eq!(corner_offset(&quarter(0.3, 0.0), 3, 16), (0.0, 0.0), "too near the rim");
    }

    /// Mirrored pictures have mirrored corners.
    #[test]
    fn offsets_mirror_with_the_picture() {
        let picture = quarter(0.3, -0.2);
        let mirrored = GrayImage::from_fn(33, 33, |x, y| picture[(32 - x, y)]);
        let (a, b) = (corner_offset(&picture, 16, 16), corner_offset(&mirrored, 16, 16));
        assert!((a.0 + b.0).abs() < 1e-12 && (a.1 - b.1).abs() < 1e-12, "{a:?} {b:?}");
    }
}
