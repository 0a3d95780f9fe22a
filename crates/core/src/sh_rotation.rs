//! [`ShRotation`]: spherical harmonics that turn with what they colour.
//!
//! When a Gaussian is turned by R, what was seen from direction d is to be seen from R d. A turned
//! harmonic of degree l is a sum of harmonics of the same degree, so there is one matrix per degree:
//!
//! f'(d) = f(R⁻¹ d),   f' = M_l f,   M_l = Y_l(D)⁻¹ Y_l(R⁻¹ D)                              (E21)
//!
//! with Y_l(D) the 2l + 1 functions of the degree (columns) in 2l + 1 directions D (rows). Two
//! polynomials of a degree that agree in enough directions agree everywhere; the directions are chosen so
//! that the condition of Y_l(D) is below 3.1, and nothing is lost by the inverse.
//!
//! *Alternative.* Ivanic and Ruedenberg 1996: M_l from M_{l-1} by a recursion. No table of directions, and
//! a page of coefficients instead.

use nalgebra::SMatrix;

use crate::Real;
use crate::sh::basis;
use crate::so3::So3;

/// Directions in which the functions are compared: the first 3, 5 and 7 for degrees 1, 2 and 3. Of all
/// sets of small integers tried, the one that holds degree 3 best (condition 2.4; 2.9 and 3.0 for
/// degrees 2 and 1).
const DIRECTIONS: [[f64; 3]; 7] = [
    [2.0, -1.0, -2.0],
    [2.0, 1.0, 2.0],
    [2.0, -1.0, 2.0],
    [1.0, 0.0, 0.0],
    [2.0, 1.0, -2.0],
    [0.0, 1.0, -1.0],
    [0.0, 1.0, 1.0],
];

/// What a rotation does to the coefficients of degrees 1, 2 and 3.
///
/// # Example
/// A lobe along x, turned by 90° about z, is a lobe along y:
/// ```
/// use garad_core::So3;
/// use garad_core::sh::color;
/// use garad_core::sh_rotation::ShRotation;
/// use nalgebra::Vector3;
/// let quarter = So3::exp(&Vector3::new(0.0, 0.0, std::f64::consts::FRAC_PI_2));
/// let mut sh = [[0.0_f64; 3], [0.0; 3], [0.0; 3], [-0.5; 3]];
/// let before = color(1, &sh, [1.0, 0.0, 0.0]);
/// ShRotation::new(&quarter).turn(&mut sh);
/// let after = color(1, &sh, [0.0, 1.0, 0.0]);
/// assert!((before[0] - after[0]).abs() < 1e-15);
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct ShRotation {
    one: SMatrix<f64, 3, 3>,
    two: SMatrix<f64, 5, 5>,
    three: SMatrix<f64, 7, 7>,
}

impl ShRotation {
    /// For things that are turned by `after_from_before` (E21).
    ///
    /// Spec test: `a_turned_colour_is_seen_from_the_turned_direction`. Outside basis:
    /// `coefficients_are_those_of_scipy`.
    ///
    /// # Numerics
    /// f64; entries are good to 1e-14.
    #[must_use]
    pub fn new(after_from_before: &So3) -> Self {
        let back = after_from_before.inverse();
        Self {
            one: matrix(1, &back),
            two: matrix(2, &back),
            three: matrix(3, &back),
        }
    }

    /// Turns one Gaussian's coefficients: 1, 4, 9 or 16 triples (r, g, b), constant term first. Others
    /// than these are left as they are.
    pub fn turn<T: Real>(&self, sh: &mut [[T; 3]]) {
        turn_degree(&self.one, sh.get_mut(1..4));
        turn_degree(&self.two, sh.get_mut(4..9));
        turn_degree(&self.three, sh.get_mut(9..16));
    }
}

fn matrix<const N: usize>(degree: usize, back: &So3) -> SMatrix<f64, N, N> {
    let first = degree * degree;
    let row = |d: &nalgebra::Vector3<f64>| {
        let all = basis(degree, [d.x, d.y, d.z]);
        std::array::from_fn::<f64, N, _>(|k| all[first + k])
    };
    let mut here = SMatrix::<f64, N, N>::zeros();
    let mut there = SMatrix::<f64, N, N>::zeros();
    for (i, direction) in DIRECTIONS.iter().take(N).enumerate() {
        let d = nalgebra::Vector3::from(*direction).normalize();
        let (a, b) = (row(&d), row(&(*back * d)));
        for k in 0..N {
            here[(i, k)] = a[k];
            there[(i, k)] = b[k];
        }
    }
    let inverse = here.try_inverse();
    inverse.expect("the functions of a degree are independent on the constant directions") * there
}

fn turn_degree<T: Real, const N: usize>(m: &SMatrix<f64, N, N>, sh: Option<&mut [[T; 3]]>) {
    let Some(sh) = sh else { return };
    for channel in 0..3 {
        let before: [f64; N] = std::array::from_fn(|k| sh[k][channel].to_f64());
        for k in 0..N {
            let sum = (0..N).fold(0.0, |sum, j| sum + m[(k, j)] * before[j]);
            sh[k][channel] = T::from_f64(sum);
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::Rng;
    use crate::sh::{MAX_COEFFICIENTS, color};

    fn random_sh(rng: &mut Rng) -> [[f64; 3]; MAX_COEFFICIENTS] {
        let mut sh = [[0.0; 3]; MAX_COEFFICIENTS].map(|c| c.map(|_: f64| rng.range(-0.1, 0.1)));
        sh[0] = [0.0; 3]; // colours stay away from the clamp at black
        sh
    }

    fn random_turn(rng: &mut Rng) -> So3 {
        So3::exp(&Vector3::from_fn(|_, _| rng.range(-2.0, 2.0)))
    }

    /// f'(R d) = f(d), in every direction, for every degree.
    #[test]
    fn a_turned_colour_is_seen_from_the_turned_direction() {
        let mut rng = Rng::new(3);
        for _ in 0..200 {
            let turn = random_turn(&mut rng);
            let before = random_sh(&mut rng);
            let mut after = before;
            ShRotation::new(&turn).turn(&mut after);
            let d = Vector3::from_fn(|_, _| rng.range(-1.0, 1.0)).normalize();
            let turned = turn * d;
            for degree in 0..=3 {
                let n = crate::sh::coefficients(degree);
                let was = color(degree, &before[..n], [d.x, d.y, d.z]);
                let is = color(degree, &after[..n], [turned.x, turned.y, turned.z]);
                for c in 0..3 {
                    assert!(was[c] > 0.0, "not clamped");
                    assert!(
                        (was[c] - is[c]).abs() < 1e-13,
                        "degree {degree}: {was:?} {is:?}"
                    );
                }
            }
        }
    }

    /// Two turns in a row are one, no turn is none, and no energy is lost (M is orthogonal).
    #[test]
    fn turns_compose_and_keep_lengths() {
        let mut rng = Rng::new(4);
        let (a, b) = (random_turn(&mut rng), random_turn(&mut rng));
        let sh = random_sh(&mut rng);
        let (mut twice, mut once, mut same) = (sh, sh, sh);
        ShRotation::new(&a).turn(&mut twice);
        ShRotation::new(&b).turn(&mut twice);
        ShRotation::new(&(b * a)).turn(&mut once);
        ShRotation::new(&So3::identity()).turn(&mut same);
        for k in 0..MAX_COEFFICIENTS {
            assert!((twice[k][1] - once[k][1]).abs() < 1e-14, "{k}: b after a");
            assert!((same[k][1] - sh[k][1]).abs() < 1e-15, "{k}: identity");
        }
        let ShRotation { one, two, three } = ShRotation::new(&a);
        let off = [
            (one.transpose() * one - SMatrix::identity()).amax(),
            (two.transpose() * two - SMatrix::identity()).amax(),
            (three.transpose() * three - SMatrix::identity()).amax(),
        ];
        assert!(off.iter().all(|o| *o < 1e-14), "MᵀM = 1: {off:?}");
    }

    #[test]
    fn lists_of_other_lengths_turn_as_far_as_they_are_whole() {
        let turn = ShRotation::new(&So3::exp(&Vector3::new(0.3, 0.2, 0.1)));
        let mut none: [[f32; 3]; 0] = [];
        turn.turn(&mut none);
        let mut five = [[1.0f32; 3]; 5];
        turn.turn(&mut five);
        assert!((five[1][0] - 1.0).abs() > 1e-3, "degree 1 has turned");
        let untouched = [five[0][0], five[4][0]].map(f32::to_bits);
        assert_eq!(
            untouched,
            [1.0f32.to_bits(); 2],
            "constant, and half a degree"
        );
    }

    /// Turned by scipy 1.17.1: `sph_harm_y`, made real (√2 Re for m > 0, √2 Im of |m| for m < 0), and
    /// f'ₖ = ∫ Yₖ(d) f(R⁻¹ d) by Gauss and Legendre with 12 x 24 nodes; R = exp(0.3, -0.5, 0.7),
    /// fₖ = (-1)ᵏ (k + 1) / 100.
    #[test]
    fn coefficients_are_those_of_scipy() {
        #[rustfmt::skip]
        let expected = [
            0.010000000000000057, -0.02337391188692782, 0.0484457161489184, -0.0025831821307364107,
            0.06494740617074111, -0.05064929636866193, 0.1355556409349341, 0.018157316495143502,
            -0.0033857462200560127, -0.027882681914408333, 0.18215531213272942, -0.0665453090892878,
            0.272176565869378, 0.06956249326787908, 0.0027399541140547823, 0.0615401439928447,
        ];
        let mut sh: [[f64; 3]; MAX_COEFFICIENTS] = std::array::from_fn(|k| {
            let sign = if k % 2 == 0 { 0.01 } else { -0.01 };
            [sign * (k + 1) as f64; 3]
        });
        ShRotation::new(&So3::exp(&Vector3::new(0.3, -0.5, 0.7))).turn(&mut sh);
        for k in 0..MAX_COEFFICIENTS {
            assert!(
                (sh[k][2] - expected[k]).abs() < 1e-13,
                "{k}: {} {}",
                sh[k][2],
                expected[k]
            );
        }
    }
}
