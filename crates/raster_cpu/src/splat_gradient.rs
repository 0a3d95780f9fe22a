//! [`SplatGradient`]: ∂L/∂ of one splat, from [`SplatSums`] over the pixels it was blended into (R14).

use garad_core::Real;

use crate::splat::Projected;

/// Sums over pixels of one splat, from which all its gradients follow linearly. With
/// g = ∂L/∂power, r = dx + (b/a) dy and dy as in the power of R9:
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
    pub(crate) const ZERO: Self = Self {
        g: T::ZERO,
        r: T::ZERO,
        y: T::ZERO,
        rr: T::ZERO,
        ry: T::ZERO,
        yy: T::ZERO,
        color: [T::ZERO; 3],
        depth: T::ZERO,
    };

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

/// ∂L/∂ of what the pixels read of a splat.
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
            // A splat of opacity 0 was blended into no pixel.
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Of opacity `opacity`, with the covariance [xx, xy; xy, yy].
    fn splat(opacity: f64, [xx, xy, yy]: [f64; 3], det: f64) -> Projected<f64> {
        Projected {
            conic: [yy / det, -xy / det, xx / det],
            shear: -xy / yy,
            inv_var_y: 1.0 / yy,
            opacity,
            ..Projected::ZERO
        }
    }

    /// The derivative by Σ' and that by its inverse are one: G = -Σ' G' Σ'.
    #[test]
    fn conic_and_covariance_agree() {
        let (xx, xy, yy) = (9.0, -4.0, 5.0);
        let det: f64 = xx * yy - xy * xy;
        let turned = splat(0.8, [xx, xy, yy], det);
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
        let needle = splat(1.0, [xx, xy, xx], det);
        // A gradient at one pixel, 9 px along the axis and 1 px aside.
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
            conic: needle.conic.map(Real::to_f32),
            shear: needle.shear.to_f32(),
            inv_var_y: needle.inv_var_y.to_f32(),
            opacity: 1.0,
            ..Projected::ZERO
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
}
