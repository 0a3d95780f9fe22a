//! The colour of a Gaussian in the direction it is seen from (R7).

use garad_core::{GaussianMap, Real, sh};

use crate::scalar::{dot, three};

/// max(0, ½ + Σₖ Yₖ(d) fₖ), d = (mean - c) / |mean - c|, c the camera's centre (R7).
///
/// `None` when a coefficient or the square of a colour is not finite. A mean on the centre itself
/// has no direction; the near plane has removed it before.
#[inline]
pub(crate) fn color<T: Real>(map: &GaussianMap<T>, i: usize, center: [T; 3]) -> Option<[T; 3]> {
    let coefficients = map.sh_of(i);
    if !coefficients.iter().flatten().all(|v| v.is_finite()) {
        return None;
    }
    let (direction, _) = direction(map.means[i], center);
    let rgb = sh::color(map.sh_degree(), coefficients, direction);
    // A finite square leaves room for every product of the backward pass.
    rgb.iter().all(|v| (*v * *v).is_finite()).then_some(rgb)
}

/// d and the distance |mean - c|, metres.
#[inline]
fn direction<T: Real>(mean: [T; 3], center: [T; 3]) -> ([T; 3], T) {
    let offset = three(|k| mean[k] - center[k]);
    let norm = dot(offset, offset).sqrt();
    (three(|k| offset[k] / norm), norm)
}

// Cached between the two: the clamped colour, which is 0 where the clamp was active.

/// What [`color`] passes back.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ColorGradient<T> {
    /// Yₖ(d), zero beyond the map's degree, and g: ∂L/∂fₖ = Yₖ g.
    pub(crate) basis: [T; sh::MAX_COEFFICIENTS],
    pub(crate) g: [T; 3],
    /// ∂L/∂(mean - c) in the world, 1/m; across d.
    pub(crate) offset: [T; 3],
}

/// Backward pass of [`color`], from ∂L/∂color (R19):
///
/// ∂L/∂fₖ = Yₖ(d) g,   ∂L/∂(mean - c) = (1 - d dᵀ) Σₖ (fₖ·g) ∇Yₖ(d) / |mean - c|
///
/// g = ∂L/∂color, with 0 in the channels that are clamped.
#[inline]
pub(crate) fn color_backward<T: Real>(
    map: &GaussianMap<T>,
    i: usize,
    center: [T; 3],
    color: [T; 3],
    d_color: [T; 3],
) -> ColorGradient<T> {
    let g = three(|k| {
        if color[k] > T::ZERO {
            d_color[k]
        } else {
            T::ZERO
        }
    });
    let (direction, norm) = direction(map.means[i], center);
    let basis = sh::basis(map.sh_degree(), direction);
    if map.sh_degree() == 0 {
        // The same from everywhere.
        let offset = [T::ZERO; 3];
        return ColorGradient { basis, g, offset };
    }
    let slopes = sh::basis_gradient(map.sh_degree(), direction);
    let mut d_direction = [T::ZERO; 3];
    for (coefficient, slope) in map.sh_of(i).iter().zip(&slopes) {
        let d_basis = dot(*coefficient, g);
        for axis in 0..3 {
            d_direction[axis] += d_basis * slope[axis];
        }
    }
    let along = dot(direction, d_direction);
    ColorGradient {
        basis,
        g,
        offset: three(|k| (d_direction[k] - along * direction[k]) / norm),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::{KeyframeId, NewGaussian};

    #[test]
    fn direction_points_from_the_camera_to_the_gaussian() {
        let mut map = GaussianMap::<f64>::new(1);
        map.push(&NewGaussian {
            mean: [1.0, 1.0, 5.0],
            sigma_m: 0.1,
            opacity: 0.5,
            color: [0.5, 0.5, 0.5],
            landmark: None,
            born: KeyframeId(0),
        });
        // Red grows along +z: Y₁₀ = C1 z.
        map.sh[2] = [0.1, 0.0, f64::NAN];
        assert_eq!(color(&map, 0, [1.0, 1.0, 2.0]), None, "NaN in blue");
        map.sh[2] = [0.1, 0.0, -9.0];
        let rgb = color(&map, 0, [1.0, 1.0, 2.0]).expect("finite");
        assert!(
            (rgb[0] - (0.5 + 0.048_860_251_190_291_99)).abs() < 1e-15,
            "seen along +z: {rgb:?}"
        );
        assert!((rgb[1] - 0.5).abs() < 1e-15, "green has no slope");
        assert_eq!(rgb[2].to_bits(), 0.0f64.to_bits(), "clamped at 0");
        let behind = color(&map, 0, [1.0, 1.0, 9.0]).expect("finite");
        assert!(
            (behind[0] - (0.5 - 0.048_860_251_190_291_99)).abs() < 1e-15,
            "seen along -z"
        );
    }
}
