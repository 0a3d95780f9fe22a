//! Colour by spherical harmonics: each function is a polynomial, and its gradient follows from that.

use super::number::N;
use super::rendering::{Fault, How};

/// (coefficient, powers of x, y, z), by function.
type Polynomial = &'static [(f64, [u32; 3])];

const C: [f64; 10] = [
    0.282_094_791_773_878_14,
    0.488_602_511_902_919_9,
    1.092_548_430_592_079_2,
    0.315_391_565_252_520_05,
    0.546_274_215_296_039_6,
    0.590_043_589_926_643_5,
    2.890_611_442_640_554,
    0.457_045_799_464_465_8,
    0.373_176_332_590_115_4,
    1.445_305_721_320_277,
];

#[rustfmt::skip]
const BASIS: [Polynomial; 16] = [
    &[(C[0], [0, 0, 0])],
    &[(-C[1], [0, 1, 0])], &[(C[1], [0, 0, 1])], &[(-C[1], [1, 0, 0])],
    &[(C[2], [1, 1, 0])], &[(-C[2], [0, 1, 1])],
    &[(2.0 * C[3], [0, 0, 2]), (-C[3], [2, 0, 0]), (-C[3], [0, 2, 0])],
    &[(-C[2], [1, 0, 1])], &[(C[4], [2, 0, 0]), (-C[4], [0, 2, 0])],
    &[(-3.0 * C[5], [2, 1, 0]), (C[5], [0, 3, 0])], &[(C[6], [1, 1, 1])],
    &[(-4.0 * C[7], [0, 1, 2]), (C[7], [2, 1, 0]), (C[7], [0, 3, 0])],
    &[(2.0 * C[8], [0, 0, 3]), (-3.0 * C[8], [2, 0, 1]), (-3.0 * C[8], [0, 2, 1])],
    &[(-4.0 * C[7], [1, 0, 2]), (C[7], [3, 0, 0]), (C[7], [1, 2, 0])],
    &[(C[9], [2, 0, 1]), (-C[9], [0, 2, 1])], &[(-C[5], [3, 0, 0]), (3.0 * C[5], [1, 2, 0])],
];

fn power<const M: bool, const Z: bool>(x: N<M, Z>, n: u32) -> N<M, Z> {
    (0..n).fold(N::ONE, |p, _| p * x)
}

fn monomial<const M: bool, const Z: bool>(c: f64, p: [u32; 3], d: &[N<M, Z>; 3]) -> N<M, Z> {
    N::new(c) * power(d[0], p[0]) * power(d[1], p[1]) * power(d[2], p[2])
}

/// What a fault makes of function k.
fn changed(k: usize, how: &How) -> (usize, f64) {
    match (how.fault, k) {
        (Some(Fault::ShSign), 1 | 3) => (k, -1.0),
        (Some(Fault::ShOrder), 1) => (3, 1.0),
        (Some(Fault::ShOrder), 3) => (1, 1.0),
        (Some(Fault::ShConstant), 0) => (k, 0.5 / C[0] * 0.5),
        (Some(Fault::ShDegreeThree), 9) => (15, 1.0),
        (Some(Fault::ShDegreeThree), 15) => (9, 1.0),
        _ => (k, 1.0),
    }
}

pub(crate) fn basis<const M: bool, const Z: bool>(
    d: &[N<M, Z>; 3],
    n: usize,
    how: &How,
) -> Vec<N<M, Z>> {
    let value = |k: usize| {
        let (k, sign) = changed(k, how);
        let terms = BASIS[k].iter().map(|(c, p)| monomial(sign * c, *p, d));
        terms.fold(N::ZERO, |sum, t| sum + t)
    };
    (0..n).map(value).collect()
}

/// The gradient of each function, less its part along the direction.
pub(crate) fn tangent_gradient<const M: bool, const Z: bool>(
    d: &[N<M, Z>; 3],
    n: usize,
    how: &How,
) -> Vec<[N<M, Z>; 3]> {
    let slope = |k: usize| {
        let (k, sign) = changed(k, how);
        let g = [0, 1, 2].map(|axis| {
            let terms = BASIS[k].iter().filter(|(_, p)| p[axis] > 0).map(|(c, p)| {
                let mut lower = *p;
                lower[axis] -= 1;
                monomial(sign * c * f64::from(p[axis]), lower, d)
            });
            terms.fold(N::ZERO, |sum, t| sum + t)
        });
        let along = g[0] * d[0] + g[1] * d[1] + g[2] * d[2];
        [0, 1, 2].map(|a| g[a] - along * d[a])
    };
    (0..n).map(slope).collect()
}
