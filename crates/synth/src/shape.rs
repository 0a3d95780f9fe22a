//! [`Shape`]: solids with closed-form ray intersections, each in its own frame.

use nalgebra::Vector3;

/// A convex solid around the origin of its own frame; lengths in metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Shape {
    /// A box seen from inside: walls, floor and ceiling.
    Room { half: Vector3<f64> },
    /// A box.
    Block { half: Vector3<f64> },
    /// (x/a)² + (y/b)² + (z/c)² = 1.
    Ellipsoid { radii: Vector3<f64> },
    /// A cylinder about z.
    Drum { radius: f64, half_height: f64 },
    /// The convex hull of a ball of radius `r0` at the origin and one of radius `r1` at
    /// (0, 0, length); |r0 - r1| < length. Equal radii make a capsule.
    Limb { r0: f64, r1: f64, length: f64 },
}

/// A point on the surface of a shape, for its texture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Surface {
    /// 0..6: -x, +x, -y, +y, -z, +z; [`CURVED`] for everything round.
    pub(crate) face: usize,
    /// Metres from the centre of the face, to the right and up (for z faces: x and y).
    pub(crate) uv: [f32; 2],
    /// Half the extent of the face along u and v, metres.
    pub(crate) half: [f32; 2],
}

/// [`Surface::face`] of a curved surface.
pub(crate) const CURVED: usize = 6;

/// The axes along u and v of the faces across x, y and z.
pub(crate) const FACE_AXES: [(usize, usize); 3] = [(1, 2), (0, 2), (0, 1)];

/// Smallest ray parameter, so that a ray leaves the surface it starts on.
const T_MIN: f64 = 1e-9;

impl Shape {
    /// Smallest t > 0 at which o + t d enters the solid (for [`Shape::Room`]: leaves it).
    #[inline]
    pub(crate) fn intersect(&self, o: &Vector3<f64>, d: &Vector3<f64>) -> Option<f64> {
        let t = match self {
            Self::Room { half } => slab(half, o, d)[1],
            Self::Block { half } => {
                let [enter, leave] = slab(half, o, d);
                if enter > leave {
                    return None;
                }
                enter
            }
            Self::Ellipsoid { radii } => {
                let (o, d) = (o.component_div(radii), d.component_div(radii));
                first_root(d.norm_squared(), o.dot(&d), o.norm_squared() - 1.0)?
            }
            Self::Drum {
                radius,
                half_height,
            } => drum(*radius, *half_height, o, d)?,
            Self::Limb { r0, r1, length } => limb(*r0, *r1, *length, o, d)?,
        };
        (t > T_MIN).then_some(t)
    }

    /// Texture coordinates and outward unit normal (for [`Shape::Room`]: into the room) at a point of
    /// the surface.
    #[allow(
        clippy::cast_possible_truncation,
        reason = "textures are drawn in f32: a tenth of a micrometre is enough"
    )]
    pub(crate) fn surface(&self, p: &Vector3<f64>) -> (Surface, Vector3<f64>) {
        let flat = |face: usize, half: &Vector3<f64>| {
            let (a, b) = FACE_AXES[face / 2];
            Surface {
                face,
                uv: [p[a] as f32, p[b] as f32],
                half: [half[a] as f32, half[b] as f32],
            }
        };
        let round = |radius: f64, z: f64, half_height: f64| {
            let quarter = std::f64::consts::FRAC_PI_2 * radius;
            Surface {
                face: CURVED,
                uv: [(pseudo_angle(p.x, p.y) * quarter) as f32, z as f32],
                half: [(2.0 * quarter) as f32, half_height as f32],
            }
        };
        match self {
            Self::Room { half } => {
                let face = box_face(half, p);
                (flat(face, half), -face_normal(face))
            }
            Self::Block { half } => {
                let face = box_face(half, p);
                (flat(face, half), face_normal(face))
            }
            Self::Ellipsoid { radii } => {
                let normal = p.component_div(&radii.component_mul(radii));
                let normal = normal / length(&normal);
                (round(0.5 * (radii.x + radii.y), p.z, radii.z), normal)
            }
            Self::Drum {
                radius,
                half_height,
            } => {
                let half = Vector3::new(*radius, *radius, *half_height);
                let rho = p.xy().norm_squared().sqrt();
                if p.z.abs() / half_height > rho / radius {
                    let face = if p.z > 0.0 { 5 } else { 4 };
                    (flat(face, &half), face_normal(face))
                } else {
                    let normal = Vector3::new(p.x / rho, p.y / rho, 0.0);
                    (round(*radius, p.z, *half_height), normal)
                }
            }
            Self::Limb { r0, r1, length } => {
                let (sin, cos) = limb_slope(*r0, *r1, *length);
                let normal = if p.z <= r0 * sin {
                    p / *r0
                } else if p.z >= length + r1 * sin {
                    (p - Vector3::new(0.0, 0.0, *length)) / *r1
                } else {
                    let rho = p.xy().norm_squared().sqrt();
                    Vector3::new(p.x / rho * cos, p.y / rho * cos, sin)
                };
                (
                    round(0.5 * (r0 + r1), p.z - 0.5 * length, 0.5 * length),
                    normal,
                )
            }
        }
    }

    /// Bounding box (minimum, maximum) of the shape.
    pub(crate) fn bounds(&self) -> [Vector3<f64>; 2] {
        match self {
            Self::Room { half } | Self::Block { half } => [-half, *half],
            Self::Ellipsoid { radii } => [-radii, *radii],
            Self::Drum {
                radius,
                half_height,
            } => {
                let half = Vector3::new(*radius, *radius, *half_height);
                [-half, half]
            }
            Self::Limb { r0, r1, length } => {
                let r = r0.max(*r1);
                [Vector3::new(-r, -r, -r0), Vector3::new(r, r, length + r1)]
            }
        }
    }

    /// Corners of [`Shape::bounds`]: bit a of a corner's number is set where axis a is at its maximum.
    pub(crate) fn corners(&self) -> [Vector3<f64>; 8] {
        let [low, high] = self.bounds();
        std::array::from_fn(|k| {
            Vector3::from_fn(|a, _| if k >> a & 1 == 0 { low[a] } else { high[a] })
        })
    }

    /// Whether the point is inside the solid, not on its surface. Never for [`Shape::Room`].
    pub(crate) fn contains(&self, p: &Vector3<f64>) -> bool {
        match self {
            Self::Room { .. } => false,
            Self::Block { half } => (0..3).all(|a| p[a].abs() < half[a]),
            Self::Ellipsoid { radii } => p.component_div(radii).norm_squared() < 1.0,
            Self::Drum {
                radius,
                half_height,
            } => p.z.abs() < *half_height && p.xy().norm_squared() < radius * radius,
            Self::Limb { r0, r1, length } => {
                let s = (p.z / length).clamp(0.0, 1.0);
                let r = r0 + (r1 - r0) * s;
                (p - Vector3::new(0.0, 0.0, s * length)).norm_squared() < r * r
            }
        }
    }
}

/// |v|. Same bits as nalgebra's norm, which with `libm-force` computes the square root in software.
#[inline]
pub(crate) fn length(v: &Vector3<f64>) -> f64 {
    v.norm_squared().sqrt()
}

/// [enter, leave] of the box |x| ≤ half; `enter > leave` when the ray passes by.
#[inline]
fn slab(half: &Vector3<f64>, o: &Vector3<f64>, d: &Vector3<f64>) -> [f64; 2] {
    let (mut enter, mut leave) = (f64::NEG_INFINITY, f64::INFINITY);
    for a in 0..3 {
        let inv = 1.0 / d[a];
        // 0 * inf = NaN on a ray in a face: comparisons below then leave the bounds as they are
        let near = (-half[a].copysign(inv) - o[a]) * inv;
        let far = (half[a].copysign(inv) - o[a]) * inv;
        if near > enter {
            enter = near;
        }
        if far < leave {
            leave = far;
        }
    }
    [enter, leave]
}

/// Smaller root of a t² + 2 b t + c = 0.
#[inline]
fn first_root(a: f64, b: f64, c: f64) -> Option<f64> {
    let discriminant = b * b - a * c;
    (discriminant >= 0.0).then(|| (-b - discriminant.sqrt()) / a)
}

fn drum(radius: f64, half_height: f64, o: &Vector3<f64>, d: &Vector3<f64>) -> Option<f64> {
    let cap = (half_height.copysign(-d.z) - o.z) / d.z;
    let (x, y) = (o.x + cap * d.x, o.y + cap * d.y);
    if x * x + y * y <= radius * radius {
        return Some(cap);
    }
    let t = first_root(
        d.xy().norm_squared(),
        o.xy().dot(&d.xy()),
        o.xy().norm_squared() - radius * radius,
    )?;
    ((o.z + t * d.z).abs() <= half_height).then_some(t)
}

/// (sin, cos) of the angle between the side of a limb and its axis: sin a = (r0 - r1) / length.
fn limb_slope(r0: f64, r1: f64, length: f64) -> (f64, f64) {
    let sin = (r0 - r1) / length;
    (sin, (1.0 - sin * sin).sqrt())
}

/// The side touches the balls in the circles z = r0 sin a and z = length + r1 sin a, and between
/// them is the cone ρ = r0 / cos a - z tan a.
fn limb(r0: f64, r1: f64, length: f64, o: &Vector3<f64>, d: &Vector3<f64>) -> Option<f64> {
    let (sin, cos) = limb_slope(r0, r1, length);
    let (low, high) = (r0 * sin, length + r1 * sin);
    let tan = sin / cos;
    let rho = r0 / cos - o.z * tan;
    let slope = -d.z * tan;
    let a = d.xy().norm_squared() - slope * slope;
    let b = o.xy().dot(&d.xy()) - rho * slope;
    // a > 0: the ray enters the cone at the smaller root. a < 0: it is steeper than the cone and
    // enters at the larger one, if it ever was outside. The formula is the same.
    match first_root(a, b, o.xy().norm_squared() - rho * rho) {
        Some(t) if (low..=high).contains(&(o.z + t * d.z)) => return Some(t),
        None if a > 0.0 => return None,
        _ => {}
    }
    let ball = |z: f64, r: f64| {
        let o = Vector3::new(o.x, o.y, o.z - z);
        first_root(d.norm_squared(), o.dot(d), o.norm_squared() - r * r)
    };
    let first = ball(0.0, r0).filter(|t| o.z + t * d.z <= low);
    let second = ball(length, r1).filter(|t| o.z + t * d.z >= high);
    match (first, second) {
        (Some(s), Some(t)) => Some(if s < t { s } else { t }),
        (s, t) => s.or(t),
    }
}

/// The face of the box on which a point of its surface lies.
fn box_face(half: &Vector3<f64>, p: &Vector3<f64>) -> usize {
    let outside = |a: usize| p[a].abs() - half[a];
    let mut axis = 0;
    for a in 1..3 {
        if outside(a) > outside(axis) {
            axis = a;
        }
    }
    2 * axis + usize::from(p[axis] > 0.0)
}

/// Unit normal of a face, 0..6.
pub(crate) fn face_normal(face: usize) -> Vector3<f64> {
    let mut n = Vector3::zeros();
    n[face / 2] = if face % 2 == 1 { 1.0 } else { -1.0 };
    n
}

/// Angle of (x, y) in quarter turns, in [-2, 2], 0 along +x, to about 4 %: no transcendental, and
/// monotone, which is enough for a texture.
fn pseudo_angle(x: f64, y: f64) -> f64 {
    let sum = x.abs() + y.abs();
    if sum > 0.0 {
        let r = y / sum;
        if x >= 0.0 {
            r
        } else {
            (2.0 - r.abs()).copysign(r)
        }
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn v(x: f64, y: f64, z: f64) -> Vector3<f64> {
        Vector3::new(x, y, z)
    }

    fn shapes() -> [Shape; 6] {
        [
            Shape::Block {
                half: v(0.5, 0.3, 0.2),
            },
            Shape::Ellipsoid {
                radii: v(0.5, 0.3, 0.2),
            },
            Shape::Drum {
                radius: 0.4,
                half_height: 0.3,
            },
            Shape::Limb {
                r0: 0.3,
                r1: 0.1,
                length: 0.6,
            },
            Shape::Limb {
                r0: 0.1,
                r1: 0.3,
                length: 0.6,
            },
            Shape::Limb {
                r0: 0.2,
                r1: 0.2,
                length: 0.5,
            },
        ]
    }

    #[test]
    fn hand_numbers() {
        let meets = |shape: Shape, from: Vector3<f64>, expected: f64| {
            let t = shape.intersect(&from, &-from.normalize()).expect("a hit");
            assert!(
                (t - expected).abs() < 1e-15,
                "{shape:?}: {t} against {expected}"
            );
        };
        let [block, ellipsoid, drum, limb, _, capsule] = shapes();
        let along_x = v(-2.0, 0.0, 0.0);
        meets(block, along_x, 1.5);
        meets(ellipsoid, along_x, 1.5);
        meets(drum, along_x, 1.6);
        meets(capsule, along_x, 1.8);
        // sin a = 1/3: the cone begins at z = 0.1, at z = 0 the ball is the surface
        meets(limb, along_x, 1.7);
        let from_above = v(0.0, 0.0, 2.0);
        meets(drum, from_above, 1.7);
        meets(limb, from_above, 2.0 - 0.7);
        let room = Shape::Room {
            half: v(2.0, 2.0, 1.0),
        };
        assert_eq!(
            room.intersect(&v(0.5, 0.0, 0.0), &v(1.0, 0.0, 0.0)),
            Some(1.5),
            "wall"
        );
        assert_eq!(
            room.surface(&v(2.0, 0.3, 0.1)).1,
            v(-1.0, 0.0, 0.0),
            "into the room"
        );
    }

    #[test]
    fn misses_and_solids_behind() {
        for shape in shapes() {
            assert_eq!(
                shape.intersect(&v(-2.0, 1.0, 0.0), &v(1.0, 0.0, 0.0)),
                None,
                "{shape:?}"
            );
            assert_eq!(
                shape.intersect(&v(2.0, 0.0, 0.1), &v(1.0, 0.0, 0.0)),
                None,
                "{shape:?}"
            );
        }
    }

    proptest! {
        /// A hit is on the surface, enters through it, and nothing of the solid lies before it.
        #[test]
        fn hits_are_the_first_point_of_the_surface(
            from in proptest::array::uniform3(-1.0f64..1.0),
            to in proptest::array::uniform3(-0.4f64..0.4),
            which in 0usize..6,
        ) {
            let shape = shapes()[which];
            let o = v(from[0], from[1], from[2]).normalize() * 2.0;
            let d = v(to[0], to[1], to[2] + 0.1) - o;
            if let Some(t) = shape.intersect(&o, &d) {
                let p = o + d * t;
                let (_, n) = shape.surface(&p);
                prop_assert!((n.norm() - 1.0).abs() < 1e-12, "unit normal");
                prop_assert!(n.dot(&d) < 1e-9, "enters");
                prop_assert!(!shape.contains(&(p + n * 1e-6)), "outside");
                let [low, high] = shape.bounds();
                for a in 0..3 {
                    prop_assert!(p[a] > low[a] - 1e-9 && p[a] < high[a] + 1e-9, "bounds");
                }
                for k in 0..100 {
                    let before = o + d * (t * f64::from(k) / 100.0 - 1e-6);
                    prop_assert!(!shape.contains(&before), "nothing before");
                }
            } else {
                for k in 0..200 {
                    // a limb's `contains` is the hull of balls taken along its axis, which lies
                    // inside the hull proper: a miss must be outside it all the more
                    prop_assert!(!shape.contains(&(o + d * (f64::from(k) / 100.0))), "a miss");
                }
            }
        }

        #[test]
        fn pseudo_angle_is_close_to_the_angle(angle in -3.1f64..3.1) {
            let quarters = pseudo_angle(libm::cos(angle), libm::sin(angle));
            prop_assert!((quarters - angle / std::f64::consts::FRAC_PI_2).abs() < 0.06, "{quarters}");
        }
    }
}
