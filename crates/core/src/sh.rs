//! Real spherical harmonics to degree 3: colour that depends on the direction of view.
//!
//! Signs and order are those of 3D Gaussian Splatting, so that maps agree with its viewers:
//! within degree l the order m = -l..l, with the Condon-Shortley phase left out of the constants
//! and kept in the signs below.

use crate::Real;

/// Y₀₀ = ½ √(1/π): colour = 0.5 + Y₀₀ · f_dc.
pub const SH_C0: f64 = 0.282_094_791_773_878_1;
const C1: f64 = 0.488_602_511_902_919_9; // ½ √(3/π)
const C2: [f64; 5] = [
    1.092_548_430_592_079_1, // ½ √(15/π)
    -1.092_548_430_592_079_1,
    0.315_391_565_252_52, // ¼ √(5/π)
    -1.092_548_430_592_079_1,
    0.546_274_215_296_039_6, // ¼ √(15/π)
];
const C3: [f64; 7] = [
    -0.590_043_589_926_643_5, // ¼ √(35/2π)
    2.890_611_442_640_554,    // ½ √(105/π)
    -0.457_045_799_464_465_7, // ¼ √(21/2π)
    0.373_176_332_590_115_4,  // ¼ √(7/π)
    -0.457_045_799_464_465_7,
    1.445_305_721_320_277, // ¼ √(105/π)
    -0.590_043_589_926_643_5,
];

/// Highest degree of the map's colour.
pub const MAX_DEGREE: usize = 3;
/// Coefficients per channel at [`MAX_DEGREE`].
pub const MAX_COEFFICIENTS: usize = 16;

/// (degree + 1)²: coefficients per channel.
#[inline]
#[must_use]
pub const fn coefficients(degree: usize) -> usize {
    (degree + 1) * (degree + 1)
}

/// The basis functions in direction `(x, y, z)` (unit length); those above `degree` are 0.
///
/// Spec test: `basis_is_orthonormal`.
///
/// # Example
/// ```
/// let basis = garad_core::sh::basis(1, [0.0f64, 0.0, 1.0]);
/// assert!((basis[0] - 0.28209479).abs() < 1e-8); // the same in every direction
/// assert!((basis[2] - 0.48860251).abs() < 1e-8); // grows along z
/// ```
#[must_use]
pub fn basis<T: Real>(degree: usize, [x, y, z]: [T; 3]) -> [T; MAX_COEFFICIENTS] {
    let c = T::from_f64;
    let mut b = [T::ZERO; MAX_COEFFICIENTS];
    b[0] = c(SH_C0);
    if degree >= 1 {
        b[1] = -c(C1) * y;
        b[2] = c(C1) * z;
        b[3] = -c(C1) * x;
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    if degree >= 2 {
        b[4] = c(C2[0]) * x * y;
        b[5] = c(C2[1]) * y * z;
        b[6] = c(C2[2]) * (c(2.0) * zz - xx - yy);
        b[7] = c(C2[3]) * x * z;
        b[8] = c(C2[4]) * (xx - yy);
    }
    if degree >= 3 {
        b[9] = c(C3[0]) * y * (c(3.0) * xx - yy);
        b[10] = c(C3[1]) * x * y * z;
        b[11] = c(C3[2]) * y * (c(4.0) * zz - xx - yy);
        b[12] = c(C3[3]) * z * (c(2.0) * zz - c(3.0) * xx - c(3.0) * yy);
        b[13] = c(C3[4]) * x * (c(4.0) * zz - xx - yy);
        b[14] = c(C3[5]) * z * (xx - yy);
        b[15] = c(C3[6]) * x * (xx - c(3.0) * yy);
    }
    b
}

/// ∂[`basis`]ₖ/∂(x, y, z), of the polynomials as they are written there.
///
/// Only the part across `direction` means anything: along it the polynomials leave the unit
/// sphere, and a caller who normalises a vector first projects that part out.
///
/// Spec test: `gradient_is_the_slope_of_the_basis`.
#[must_use]
#[rustfmt::skip]
pub fn basis_gradient<T: Real>(degree: usize, [x, y, z]: [T; 3]) -> [[T; 3]; MAX_COEFFICIENTS] {
    let c = T::from_f64;
    let o = T::ZERO;
    let scaled = |k: f64, v: [T; 3]| v.map(|v| c(k) * v);
    let mut g = [[o; 3]; MAX_COEFFICIENTS];
    if degree >= 1 {
        g[1] = [o, -c(C1), o];
        g[2] = [o, o, c(C1)];
        g[3] = [-c(C1), o, o];
    }
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let (xy, xz, yz) = (x * y, x * z, y * z);
    if degree >= 2 {
        g[4] = scaled(C2[0], [y, x, o]);
        g[5] = scaled(C2[1], [o, z, y]);
        g[6] = scaled(C2[2], [-c(2.0) * x, -c(2.0) * y, c(4.0) * z]);
        g[7] = scaled(C2[3], [z, o, x]);
        g[8] = scaled(C2[4], [c(2.0) * x, -c(2.0) * y, o]);
    }
    if degree >= 3 {
        let (three, six, eight) = (c(3.0), c(6.0), c(8.0));
        g[9] = scaled(C3[0], [six * xy, three * (xx - yy), o]);
        g[10] = scaled(C3[1], [yz, xz, xy]);
        g[11] = scaled(C3[2], [-c(2.0) * xy, c(4.0) * zz - xx - three * yy, eight * yz]);
        g[12] = scaled(C3[3], [-six * xz, -six * yz, six * zz - three * (xx + yy)]);
        g[13] = scaled(C3[4], [c(4.0) * zz - three * xx - yy, -c(2.0) * xy, eight * xz]);
        g[14] = scaled(C3[5], [c(2.0) * xz, -c(2.0) * yz, xx - yy]);
        g[15] = scaled(C3[6], [three * (xx - yy), -six * xy, o]);
    }
    g
}

/// Colour seen from a direction: max(0, ½ + Σₖ basisₖ · shₖ) per channel.
///
/// `sh` holds `coefficients(degree)` triples (r, g, b), constant term first; `direction` points
/// from the camera to the Gaussian and has unit length.
#[must_use]
pub fn color<T: Real>(degree: usize, sh: &[[T; 3]], direction: [T; 3]) -> [T; 3] {
    let basis = basis(degree, direction);
    let mut rgb = [T::from_f64(0.5); 3];
    for (b, coefficient) in basis.iter().zip(sh) {
        for channel in 0..3 {
            rgb[channel] += *b * coefficient[channel];
        }
    }
    rgb.map(|v| v.max(T::ZERO))
}

/// The constant coefficient that shows `value` in [0, 1] from everywhere.
#[inline]
#[must_use]
pub fn dc_from_color<T: Real>(value: T) -> T {
    (value - T::from_f64(0.5)) / T::from_f64(SH_C0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// ∫ Yᵢ Yⱼ over the sphere is 1 for i = j and 0 otherwise: holds only if every constant and
    /// every polynomial is right. Gauss-free quadrature on 200 x 400 cells of equal cos θ.
    #[test]
    fn basis_is_orthonormal() {
        let (rows, columns) = (400, 64);
        let mut gram = [[0.0f64; 16]; 16];
        for i in 0..rows {
            let z = -1.0 + (2.0 * f64::from(i) + 1.0) / f64::from(rows);
            let r = (1.0 - z * z).sqrt();
            for j in 0..columns {
                let angle = std::f64::consts::TAU * (f64::from(j) + 0.5) / f64::from(columns);
                let (sin, cos) = libm::sincos(angle);
                let b = basis(3, [r * cos, r * sin, z]);
                let area = 4.0 * std::f64::consts::PI / f64::from(rows * columns);
                for m in 0..16 {
                    for n in 0..16 {
                        gram[m][n] += b[m] * b[n] * area;
                    }
                }
            }
        }
        for m in 0..16 {
            for n in 0..16 {
                let expected = if m == n { 1.0 } else { 0.0 };
                assert!(
                    (gram[m][n] - expected).abs() < 1e-4,
                    "({m}, {n}): {}",
                    gram[m][n]
                );
            }
        }
    }

    /// Polynomials of degree 3: a five-point difference is exact but for rounding.
    #[test]
    fn gradient_is_the_slope_of_the_basis() {
        let d = [0.36f64, -0.48, 0.8];
        let h = 0.01;
        for degree in 0..=3 {
            let gradient = basis_gradient(degree, d);
            for axis in 0..3 {
                let at = |shift: f64| {
                    let mut moved = d;
                    moved[axis] += shift;
                    basis(degree, moved)
                };
                let (near, far) = ([at(h), at(-h)], [at(2.0 * h), at(-2.0 * h)]);
                for k in 0..MAX_COEFFICIENTS {
                    let slope =
                        (8.0 * (near[0][k] - near[1][k]) - (far[0][k] - far[1][k])) / (12.0 * h);
                    assert!(
                        (gradient[k][axis] - slope).abs() < 1e-12,
                        "degree {degree}, basis {k}, axis {axis}"
                    );
                    assert!(
                        k < coefficients(degree) || gradient[k].iter().all(|v| v.abs() < 1e-300),
                        "beyond {degree}"
                    );
                }
            }
        }
    }

    #[test]
    fn dc_and_color_undo_each_other_and_dark_is_clamped() {
        let sh = [[dc_from_color(0.2f64), dc_from_color(0.9), -9.0]];
        let rgb = color(0, &sh, [0.0, 0.0, 1.0]);
        assert!(
            (rgb[0] - 0.2).abs() < 1e-15 && (rgb[1] - 0.9).abs() < 1e-15,
            "{rgb:?}"
        );
        assert_eq!(rgb[2].to_bits(), 0.0f64.to_bits(), "max(., 0)");
    }
}
