//! The colour of a Gaussian in the direction it is seen from (R7).

use garad_core::{GaussianMap, Real, sh};

/// max(0, ½ + Σₖ Yₖ(d) fₖ), d = (mean - c) / |mean - c|, c the camera's centre (R7).
///
/// `None` when a coefficient is not finite. A mean on the centre itself has no direction; the
/// near plane has removed it before.
pub(crate) fn color<T: Real>(map: &GaussianMap<T>, i: usize, center: [T; 3]) -> Option<[T; 3]> {
    let coefficients = map.sh_of(i);
    if !coefficients.iter().flatten().all(|v| v.is_finite()) {
        return None;
    }
    let mean = map.means[i];
    let [x, y, z] = [0, 1, 2].map(|k| mean[k] - center[k]);
    let norm = (x * x + y * y + z * z).sqrt();
    let direction = [x / norm, y / norm, z / norm];
    let rgb = sh::color(map.sh_degree(), coefficients, direction);
    rgb.iter().all(|v| v.is_finite()).then_some(rgb)
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
