//! [`p3p()`]: the poses from which three points are seen in three given directions.
//!
//! With unit directions f₁ f₂ f₃ and points P₁ P₂ P₃ the distances s₁ s₂ s₃ from the camera obey the
//! law of cosines in each of the three triangles it forms with two of the points:
//!
//! ```text
//! s₂² + s₃² - 2 s₂ s₃ cos α = a²      cos α = f₂·f₃      a = |P₂ - P₃|
//! s₁² + s₃² - 2 s₁ s₃ cos β = b²      cos β = f₁·f₃      b = |P₁ - P₃|                       (E18)
//! s₁² + s₂² - 2 s₁ s₂ cos γ = c²      cos γ = f₁·f₂      c = |P₁ - P₂|
//! ```
//!
//! With s₂ = u s₁, s₃ = v s₁ and q = 1 + v² - 2 v cos β the second says s₁² q = b². The first less the
//! third is linear in u,
//!
//! u = N / D,   N = 1 - v² + q (a² - c²)/b²,   D = 2 (cos γ - v cos α),
//!
//! and the third becomes a quartic in v alone: D² + N² - 2 N D cos γ - q D² c²/b² = 0. Its real roots
//! are found between the extrema of the polynomial, those in turn between the extrema of its
//! derivative. Newton's method on E18 itself then removes what was lost on the way.
//!
//! Source: Grunert 1841, in Haralick et al., *Review and analysis of solutions of the three point
//! perspective pose estimation problem*, 1994.

use garad_core::{Se3, So3};
use nalgebra::{Matrix3, Vector3};

/// Triangles whose height is less than this part of their longest side count as lines: their
/// plane, and with it the camera's rotation about them, would rest on rounding and noise.
const THINNEST: f64 = 1e-6;
/// E18 is solved when it holds to this part of the longest side squared.
const RESIDUAL: f64 = 1e-12;
/// Newton steps at most; from a root of the quartic two or three do.
const NEWTON_STEPS: usize = 10;

/// Every `camera_from_world` with `bearings[i]` ∥ R p_i + t, in front of the camera; at most four.
///
/// Empty for points on a line or in one place, for directions of length 0, for numbers that are not
/// finite, and where no camera could see them so.
///
/// # Shapes and units
/// `bearings` in the camera, of any length · `p_world` m
/// # Numerics
/// f64. Poses from exact directions are good to some 1e-12 unless two of the four nearly meet (the
/// camera near the cylinder around the triangle).
///
/// # Example
/// ```
/// use garad_optim::p3p;
/// use nalgebra::Vector3;
/// let points = [Vector3::new(0.0, 0.0, 3.0), Vector3::new(1.0, 0.0, 4.0), Vector3::new(0.0, 1.0, 5.0)];
/// let poses = p3p(&points, &points); // seen from the origin of the world
/// assert!(poses.iter().any(|pose| pose.log().norm() < 1e-10));
/// ```
#[must_use]
pub fn p3p(bearings: &[Vector3<f64>; 3], p_world: &[Vector3<f64>; 3]) -> Vec<Se3> {
    // Number the points so that b is the longest side: E18 is divided by it.
    let side2 = |i: usize, j: usize| (p_world[i] - p_world[j]).norm_squared();
    let sides = [side2(1, 2), side2(0, 2), side2(0, 1)];
    let order = if sides[0] > sides[1] && sides[0] >= sides[2] {
        [1, 0, 2]
    } else if sides[2] > sides[1] {
        [0, 2, 1]
    } else {
        [0, 1, 2]
    };
    let points = order.map(|i| p_world[i]);
    let unit = order.map(|i| bearings[i] / bearings[i].norm());
    let Some(world) = frame(&points) else {
        return Vec::new();
    };
    let triangles = Triangles::new(&unit, &points);
    let mut found: Vec<Vector3<f64>> = Vec::new();
    for v in triangles.quartic_roots() {
        for start in triangles.starts(v) {
            let Some(distances) = triangles.polish(start) else {
                continue;
            };
            let apart = |d: &Vector3<f64>| (d - distances).amax() > 1e-9 * distances.amax();
            if found.iter().all(apart) {
                found.push(distances);
            }
        }
    }
    let pose = |distances: &Vector3<f64>| {
        let seen = [0, 1, 2].map(|i| unit[i] * distances[i]);
        let rotation = So3::from_matrix(&(frame(&seen)? * world.transpose()));
        let translation = (0..3).fold(Vector3::zeros(), |sum: Vector3<f64>, i| {
            sum + (seen[i] - rotation * points[i]) / 3.0
        });
        Some(Se3::new(rotation, translation)).filter(Se3::is_finite)
    };
    found.iter().filter_map(pose).take(4).collect()
}

/// Axes of a triangle: along its longest side, in its plane, and across. `None` if it is too thin.
fn frame(points: &[Vector3<f64>; 3]) -> Option<Matrix3<f64>> {
    let (long, other) = (points[2] - points[0], points[1] - points[0]);
    let normal = long.cross(&other);
    let (length, twice_area) = (long.norm(), normal.norm());
    if !(twice_area > THINNEST * length * length && twice_area.is_finite()) {
        return None;
    }
    let (x, z) = (long / length, normal / twice_area);
    Some(Matrix3::from_columns(&[x, z.cross(&x), z]))
}

/// E18: the cosines and the squared sides.
struct Triangles {
    /// cos α, cos β, cos γ.
    cosine: Vector3<f64>,
    /// a², b², c².
    side2: Vector3<f64>,
}

impl Triangles {
    fn new(unit: &[Vector3<f64>; 3], points: &[Vector3<f64>; 3]) -> Self {
        let pairs = [(1, 2), (0, 2), (0, 1)];
        let cosine = pairs.map(|(i, j)| unit[i].dot(&unit[j]));
        let side2 = pairs.map(|(i, j)| (points[i] - points[j]).norm_squared());
        Self {
            cosine: Vector3::from(cosine),
            side2: Vector3::from(side2),
        }
    }

    /// q, N and D as polynomials in v, lowest power first.
    fn parts(&self) -> ([f64; 3], [f64; 3], [f64; 2]) {
        let [alpha, beta, gamma] = <[f64; 3]>::from(self.cosine);
        let k = (self.side2[0] - self.side2[2]) / self.side2[1];
        let q = [1.0, -2.0 * beta, 1.0];
        let n = [1.0 + k, k * q[1], k - 1.0];
        (q, n, [2.0 * gamma, -2.0 * alpha])
    }

    /// Every v > 0 at which the quartic vanishes or comes close to it.
    fn quartic_roots(&self) -> Vec<f64> {
        let (q, n, d) = self.parts();
        let ratio = self.side2[2] / self.side2[1];
        let d2 = product(&d, &d);
        let nd = product(&n, &d);
        let (n2, qd2) = (product(&n, &n), product(&q, &d2));
        let quartic: [f64; 5] = std::array::from_fn(|i| {
            let at = |p: &[f64]| p.get(i).copied().unwrap_or(0.0);
            at(&d2) + at(&n2) - 2.0 * self.cosine[2] * at(&nd) - ratio * at(&qd2)
        });
        positive_roots(&quartic)
    }

    /// Distances that go with a root: u = N / D, or both roots of the third equation where D
    /// vanishes.
    fn starts(&self, v: f64) -> Vec<Vector3<f64>> {
        let (q, n, d) = self.parts();
        let (q, n, d) = (value(&q, v), value(&n, v), value(&d, v));
        if q.is_nan() || q <= 0.0 {
            return Vec::new();
        }
        let s1 = (self.side2[1] / q).sqrt();
        let mut ratios = Vec::with_capacity(2);
        if d.abs() > 1e-6 {
            ratios.push(n / d);
        } else {
            // 1 + u² - 2 u cos γ = q c²/b²
            let gamma = self.cosine[2];
            let discriminant = gamma * gamma - 1.0 + q * self.side2[2] / self.side2[1];
            let root = discriminant.max(0.0).sqrt();
            ratios.extend([gamma + root, gamma - root]);
        }
        ratios
            .iter()
            .map(|u| Vector3::new(s1, u * s1, v * s1))
            .collect()
    }

    /// E18 as left less right, and its derivative.
    fn residual(&self, s: &Vector3<f64>) -> (Vector3<f64>, Matrix3<f64>) {
        let mut r = Vector3::zeros();
        let mut j = Matrix3::zeros();
        for (row, (i, k)) in [(1, 2), (0, 2), (0, 1)].into_iter().enumerate() {
            let cosine = self.cosine[row];
            r[row] = s[i] * s[i] + s[k] * s[k] - 2.0 * s[i] * s[k] * cosine - self.side2[row];
            j[(row, i)] = 2.0 * (s[i] - s[k] * cosine);
            j[(row, k)] = 2.0 * (s[k] - s[i] * cosine);
        }
        (r, j)
    }

    /// Newton's method; `None` if it does not end at positive distances that solve E18.
    fn polish(&self, start: Vector3<f64>) -> Option<Vector3<f64>> {
        let mut s = start;
        for _ in 0..NEWTON_STEPS {
            let (r, j) = self.residual(&s);
            let Some(inverse) = j.try_inverse() else {
                break;
            };
            let step = inverse * r;
            s -= step;
            if step.amax() <= 1e-15 * s.amax() {
                break;
            }
        }
        let solved = self.residual(&s).0.amax() <= RESIDUAL * self.side2[1].max(s.norm_squared());
        (solved && s.min() > 0.0).then_some(s)
    }
}

/// Coefficients of a product of polynomials, lowest power first.
fn product(a: &[f64], b: &[f64]) -> Vec<f64> {
    let mut c = vec![0.0; a.len() + b.len() - 1];
    for (i, x) in a.iter().enumerate() {
        for (j, y) in b.iter().enumerate() {
            c[i + j] += x * y;
        }
    }
    c
}

/// Horner's rule.
fn value(polynomial: &[f64], x: f64) -> f64 {
    polynomial.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

/// Where a polynomial vanishes for x > 0, and where it touches 0 to within what rounding may have
/// lifted it by (a double root). Between two neighbouring extrema a sign changes at most once.
fn positive_roots(polynomial: &[f64]) -> Vec<f64> {
    let degree = polynomial.len() - 1;
    if degree == 0 {
        return Vec::new();
    }
    let size = polynomial.iter().fold(0.0, |m: f64, c| m.max(c.abs()));
    // A leading coefficient that is rounding only moves one root towards infinity.
    if polynomial[degree].abs() <= 1e-14 * size {
        return positive_roots(&polynomial[..degree]);
    }
    let derivative: Vec<f64> = (1..=degree).map(|i| i as f64 * polynomial[i]).collect();
    let extrema = positive_roots(&derivative);
    // Cauchy: no root lies beyond.
    let bound = 1.0 + size / polynomial[degree].abs();
    let mut roots = Vec::new();
    let mut left = 0.0;
    for &right in extrema.iter().chain([&bound]) {
        roots.extend(between(polynomial, left, right));
        left = right;
    }
    let touches = |x: &&f64| {
        let magnitude: Vec<f64> = polynomial.iter().map(|c| c.abs()).collect();
        value(polynomial, **x).abs() <= 1e-10 * value(&magnitude, **x)
    };
    roots.extend(extrema.iter().filter(touches));
    roots.sort_by(f64::total_cmp);
    roots
}

/// The root in an interval over which the polynomial is monotonic, if the sign changes: halving,
/// until the ends are neighbours or nearly so.
fn between(polynomial: &[f64], left: f64, right: f64) -> Option<f64> {
    let (mut low, mut high) = (left, right);
    let rising = value(polynomial, low) < 0.0;
    if low >= high || (value(polynomial, high) < 0.0) == rising {
        return None;
    }
    for _ in 0..200 {
        let middle = 0.5 * (low + high);
        if high - low <= 1e-14 * high {
            break;
        }
        if (value(polynomial, middle) < 0.0) == rising {
            low = middle;
        } else {
            high = middle;
        }
    }
    Some(0.5 * (low + high))
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::Rng;
    use nalgebra::Vector6;
    use proptest::prelude::*;

    /// Fischler and Bolles 1981: an equilateral triangle of side 2√3 from above its centre, cosines
    /// 5/8: distances (4, 4, 4), (1, 4, 4), (4, 1, 4), (4, 4, 1).
    #[test]
    fn four_poses_by_hand() {
        // A triangle of circumradius 2 at height √(16 - 4).
        let height = 12f64.sqrt();
        let corner = |k: f64| {
            let angle = k * std::f64::consts::TAU / 3.0;
            Vector3::new(2.0 * libm::cos(angle), 2.0 * libm::sin(angle), height)
        };
        let points = [corner(0.0), corner(1.0), corner(2.0)];
        let poses = p3p(&points, &points);
        let mut distances: Vec<[String; 3]> = poses
            .iter()
            .map(|pose| points.map(|p| format!("{:.9}", (*pose * p).norm())))
            .collect();
        distances.sort_unstable();
        let whole = [[1, 4, 4], [4, 1, 4], [4, 4, 1], [4, 4, 4]];
        let expected = whole.map(|s| s.map(|s: i32| format!("{s}.000000000")));
        assert_eq!(distances, expected, "and no others");
    }

    #[test]
    fn degenerate_points_have_no_pose() {
        let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z() * 3.0];
        let seen = [z, z + x, z + y];
        assert!(!p3p(&seen, &seen).is_empty(), "a proper triangle");
        let line = [z, z + x, z + x * 2.0];
        assert!(p3p(&line, &line).is_empty(), "on a line");
        assert!(p3p(&seen, &[z, z, z]).is_empty(), "in one place");
        assert!(p3p(&seen, &[z, z, z + x]).is_empty(), "two in one place");
        assert!(
            p3p(&[z, z, z], &seen).is_empty(),
            "one direction for three points"
        );
        assert!(
            p3p(&[Vector3::zeros(); 3], &seen).is_empty(),
            "no direction"
        );
        let nan = Vector3::repeat(f64::NAN);
        assert!(p3p(&seen, &[nan, z, z + x]).is_empty(), "NaN point");
        assert!(p3p(&[nan, z, z + x], &seen).is_empty(), "NaN direction");
        let huge = seen.map(|p| p * 1e200);
        assert!(p3p(&seen, &huge).is_empty(), "overflow");
    }

    #[test]
    fn roots_by_hand() {
        // (x - 1)(x - 2)(x - 3)(x + 4)
        let roots = positive_roots(&[-24.0, 38.0, -13.0, -2.0, 1.0]);
        let worst = roots
            .iter()
            .zip([1.0, 2.0, 3.0])
            .map(|(r, e)| (r - e).abs());
        assert!(
            roots.len() == 3 && worst.fold(0.0, f64::max) < 1e-12,
            "{roots:?}"
        );
        // (x - 1)² touches, (x² + 1) does not.
        assert!(
            (positive_roots(&[1.0, -2.0, 1.0])[0] - 1.0).abs() < 1e-7,
            "double"
        );
        assert!(positive_roots(&[1.0, 0.0, 1.0]).is_empty(), "none");
        assert!(positive_roots(&[0.0; 5]).is_empty(), "the zero polynomial");
        assert!(positive_roots(&[f64::NAN; 5]).is_empty(), "NaN");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        /// The true pose is among the answers, and every answer sees the points where they are seen.
        #[test]
        fn the_pose_is_found(seed: u64) {
            let mut rng = Rng::new(seed);
            let camera_from_world = Se3::exp(&Vector6::from_fn(|_, _| rng.normal()));
            let seen = [0; 3].map(|_| {
                let ray = Vector3::new(rng.range(-0.6, 0.6), rng.range(-0.45, 0.45), 1.0);
                ray * rng.range(0.5, 8.0)
            });
            let points = seen.map(|p| camera_from_world.inverse() * p);
            let poses = p3p(&seen, &points);
            prop_assert!(poses.len() <= 4, "{}", poses.len());
            for pose in &poses {
                for (p, f) in points.iter().zip(&seen) {
                    let p_cam = *pose * *p;
                    let sine = p_cam.cross(f).norm() / (p_cam.norm() * f.norm());
                    prop_assert!(sine < 1e-8 && p_cam.dot(f) > 0.0, "{sine}");
                }
            }
            let error = |pose: &Se3| (*pose * camera_from_world.inverse()).log().norm();
            let nearest = poses.iter().map(error).fold(f64::INFINITY, f64::min);
            // Where poses nearly meet, digits are lost; the determinant of E18's derivative says how many.
            let unit = seen.map(|p| p / p.norm());
            let triangles = Triangles::new(&unit, &points);
            let distances = Vector3::from(seen.map(|p| p.norm()));
            let j = triangles.residual(&distances).1;
            let conditioning = j.determinant().abs() / (j.norm() * j.norm() * j.norm());
            let thin = frame(&points).is_none();
            prop_assert!(thin || nearest < 1e-13 / (conditioning * conditioning) + 1e-12, "{nearest} {conditioning}");
        }
    }
}
