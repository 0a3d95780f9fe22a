//! [`Lighting`]: irradiance of static surfaces, computed once.
//!
//! Light comes from a lamp, a window (four points) and a uniform ambient term. Flat static faces have a
//! grid of irradiance with shadows and ambient occlusion; round static solids have one value of ambient
//! occlusion; moving objects are lit without occlusion. So a static surface has the same light in every
//! frame, with and without moving objects, and these cast no shadow: a scene and its twin differ exactly
//! where a moving object is visible.

use garad_core::{Par, Se3};
use nalgebra::{Matrix3, Vector3};

use crate::config::SceneName;
use crate::material::Material;
use crate::pattern::{Rgb, lerp};
use crate::shape::{FACE_AXES, Shape, Surface, face_normal, length};
use crate::solid::{Solid, rotation_along};

const AMBIENT: Rgb = [0.44, 0.45, 0.48];
/// Largest distance of an obstacle that occludes ambient light, metres.
const CORNER_M: f64 = 0.9;
/// Distance between the nodes of a grid, metres.
const NODE_M: f64 = 0.11;
/// Most nodes along one side of a face; a wall of 5 m has 47.
const MAX_NODES: usize = 100;
const DIRECTIONS: usize = 20;

#[derive(Debug)]
pub(crate) struct Lamp {
    pub(crate) at: [f64; 3],
    /// Direction of the strongest light; `None` for uniform light.
    faces: Option<[f64; 3]>,
    power: f64,
    colour: Rgb,
}

const DAYLIGHT: Rgb = [0.95, 1.0, 1.08];
const LAMPS: [Lamp; 5] = [
    Lamp {
        at: [0.4, -0.1, 2.2],
        faces: None,
        power: 0.62,
        colour: [1.08, 0.98, 0.84],
    },
    window_point(-1.0, 1.2),
    window_point(-0.2, 1.2),
    window_point(-1.0, 1.8),
    window_point(-0.2, 1.8),
];

const fn window_point(x: f64, z: f64) -> Lamp {
    Lamp {
        at: [x, -1.95, z],
        faces: Some([0.0, 1.0, -0.1]),
        power: 0.36,
        colour: DAYLIGHT,
    }
}

/// Spotlights below the ceiling of the hall.
pub(crate) const HALL_LAMPS: [Lamp; 8] = [
    spotlight(-11.0, -4.5),
    spotlight(-4.0, -4.5),
    spotlight(4.0, -4.5),
    spotlight(11.0, -4.5),
    spotlight(-11.0, 4.5),
    spotlight(-4.0, 4.5),
    spotlight(4.0, 4.5),
    spotlight(11.0, 4.5),
];

const fn spotlight(x: f64, y: f64) -> Lamp {
    Lamp {
        at: [x, y, 7.4],
        faces: Some([0.0, 0.0, -1.0]),
        power: 5.0,
        colour: [1.02, 0.99, 0.92],
    }
}

/// The lamps of a scene.
pub(crate) fn lamps(name: SceneName) -> &'static [Lamp] {
    match name {
        SceneName::Hall => &HALL_LAMPS,
        _ => &LAMPS,
    }
}

impl Lamp {
    /// Irradiance on a surface with normal `n`, without shadows.
    fn unshadowed(&self, p: &Vector3<f64>, n: &Vector3<f64>) -> f64 {
        let to_lamp = Vector3::from(self.at) - p;
        let r2 = to_lamp.norm_squared();
        let r = r2.sqrt();
        let out = self
            .faces
            .map_or(1.0, |f| (-Vector3::from(f).dot(&to_lamp) / r).max(0.0));
        // extended slightly beyond the horizon, as for a source of finite size
        let incidence = ((n.dot(&to_lamp) / r + 0.15) / 1.15).max(0.0);
        self.power * out * incidence / (0.35 + 0.30 * r2)
    }
}

/// Intervals in which the light is off in [`SceneName::LightsOut`], seconds.
const DARK_S: [[f64; 2]; 2] = [[1.2, 1.4], [3.0, 3.5]];
/// Brightness in these intervals: white is 11 of 255.
const DARK_BRIGHTNESS: f32 = 0.002;

/// Brightness of the light.
pub(crate) fn brightness(name: SceneName, t_s: f64) -> f32 {
    let dark = DARK_S.iter().any(|&[from, to]| (from..to).contains(&t_s));
    if name == SceneName::LightsOut && dark {
        DARK_BRIGHTNESS
    } else {
        1.0
    }
}

/// Irradiance of every static solid.
#[derive(Debug, Clone)]
pub(crate) struct Lighting {
    solids: Vec<Baked>,
    lamps: &'static [Lamp],
}

#[derive(Debug, Clone)]
enum Baked {
    /// One grid per face.
    Faces(Vec<Grid>),
    /// Share of ambient light that is not occluded.
    Round(f32),
}

/// Irradiance at the nodes of a face, rows along u.
#[derive(Debug, Clone)]
struct Grid {
    nodes: [usize; 2],
    half: [f32; 2],
    values: Vec<Rgb>,
}

impl Lighting {
    /// Computes the light in the first solid, the room; the result is the same for every `par`.
    pub(crate) fn bake(solids: &[Solid], lamps: &'static [Lamp], par: Par) -> Self {
        let Some(Shape::Room { half }) = solids.first().map(|solid| solid.shape) else {
            panic!("the first solid of a scene is its room");
        };
        let site = Site {
            half,
            lamps,
            obstacles: solids.iter().skip(1).filter_map(Obstacle::new).collect(),
        };
        let bake = |i: usize| -> Baked {
            let solid = &solids[i];
            match solid.shape {
                Shape::Room { half } => faces(solid, &half, -1.0, &site),
                Shape::Block { half } => faces(solid, &half, 1.0, &site),
                _ => {
                    let centre = solid.world_from_solid.translation;
                    let near: Vec<&Obstacle> = site
                        .obstacles
                        .iter()
                        .filter(|o| o.is_near(&centre))
                        .filter(|o| !o.contains(&centre))
                        .collect();
                    #[allow(clippy::cast_possible_truncation, reason = "light is f32")]
                    let free = open_sky(&centre, &Vector3::z(), &site.half, &near) as f32;
                    Baked::Round(free)
                }
            }
        };
        Self {
            solids: par.map(solids.len(), bake),
            lamps: site.lamps,
        }
    }

    /// Irradiance at a point of solid `index`; later solids than the baked ones are moving objects. `placed`
    /// gives point and normal in the world, which flat faces do not need.
    pub(crate) fn at(
        &self,
        index: usize,
        s: &Surface,
        placed: impl FnOnce() -> (Vector3<f64>, Vector3<f64>),
    ) -> Rgb {
        match self.solids.get(index) {
            Some(Baked::Faces(grids)) => grids[s.face].at(s.uv),
            Some(Baked::Round(open)) => {
                let (p, n) = placed();
                lit(&p, &n, *open, self.lamps, |_| true)
            }
            None => {
                let (p, n) = placed();
                // more occlusion near the floor
                #[allow(clippy::cast_possible_truncation, reason = "light is f32")]
                let open = (0.55 + 0.35 * p.z).min(0.92) as f32;
                lit(&p, &n, open, self.lamps, |_| true)
            }
        }
    }
}

fn lit(
    p: &Vector3<f64>,
    n: &Vector3<f64>,
    open: f32,
    lamps: &[Lamp],
    sees: impl Fn(&Lamp) -> bool,
) -> Rgb {
    // the ceiling reflects more than the floor
    #[allow(clippy::cast_possible_truncation, reason = "light is f32")]
    let above = (0.88 + 0.12 * n.z) as f32;
    let mut e = AMBIENT.map(|a| a * open * above);
    for lamp in lamps {
        let direct = lamp.unshadowed(p, n);
        if direct > 1e-4 && sees(lamp) {
            for c in 0..3 {
                #[allow(clippy::cast_possible_truncation, reason = "light is f32")]
                let direct = direct as f32;
                e[c] += direct * lamp.colour[c];
            }
        }
    }
    e
}

fn faces(solid: &Solid, half: &Vector3<f64>, outward: f64, site: &Site) -> Baked {
    let grid = |face: usize| {
        let axis = face / 2;
        let (a, b) = FACE_AXES[axis];
        #[allow(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "at most MAX_NODES"
        )]
        let nodes = [a, b].map(|axis| (2 + (2.0 * half[axis] / NODE_M) as usize).min(MAX_NODES));
        let normal = face_normal(face);
        let n_world = solid.world_from_solid.rotation * (normal * outward);
        let middle = solid.world_from_solid * normal.component_mul(half);
        let reach = libm::hypot(half[a], half[b]);
        let near: Vec<&Obstacle> = site
            .obstacles
            .iter()
            .filter(|o| length(&(o.centre - middle)) < reach + CORNER_M + o.radius)
            .filter(|o| (o.centre - middle).dot(&n_world) > -o.radius)
            .collect();
        let mut values = Vec::with_capacity(nodes[0] * nodes[1]);
        for j in 0..nodes[1] {
            for i in 0..nodes[0] {
                let along = |k: usize, n: usize, half: f64| {
                    // slightly inside the edge, so that a node at a corner is not inside a neighbour
                    (2.0 * k as f64 / (n - 1) as f64 - 1.0) * (half - 0.01f64.min(0.3 * half))
                };
                let mut p = normal.component_mul(half) + normal * (outward * 1e-3);
                p[a] = along(i, nodes[0], half[a]);
                p[b] = along(j, nodes[1], half[b]);
                values.push(node(&(solid.world_from_solid * p), &n_world, &near, site));
            }
        }
        #[allow(clippy::cast_possible_truncation, reason = "light is f32")]
        let half = [half[a] as f32, half[b] as f32];
        Grid {
            nodes,
            half,
            values,
        }
    };
    Baked::Faces((0..6).map(grid).collect())
}

/// Irradiance at a point of a static surface.
fn node(p: &Vector3<f64>, n: &Vector3<f64>, near: &[&Obstacle], site: &Site) -> Rgb {
    let near: Vec<&Obstacle> = near.iter().filter(|o| o.is_near(p)).copied().collect();
    if near.iter().any(|o| o.contains(p)) {
        // inside another solid: invisible, but interpolated with its neighbours
        return AMBIENT.map(|a| 0.25 * a);
    }
    #[allow(clippy::cast_possible_truncation, reason = "light is f32")]
    let open = open_sky(p, n, &site.half, &near) as f32;
    lit(p, n, open, site.lamps, |lamp| {
        let to_lamp = Vector3::from(lamp.at) - p;
        let way = length(&to_lamp);
        let d = to_lamp / way;
        !site
            .obstacles
            .iter()
            .any(|o| o.distance(p, &d, way).is_some_and(|t| t < way))
    })
}

/// Mean over the half space above a point of min(distance / [`CORNER_M`], 1).
fn open_sky(p: &Vector3<f64>, n: &Vector3<f64>, half: &Vector3<f64>, near: &[&Obstacle]) -> f64 {
    let frame = rotation_along(n, &Vector3::new(0.36, 0.48, 0.8)).matrix();
    let mut sum = 0.0;
    for k in 0..DIRECTIONS {
        // cosine-weighted: equal areas of the disc below the half sphere, on a golden spiral
        let r2 = (k as f64 + 0.5) / DIRECTIONS as f64;
        let (sin, cos) = libm::sincos(2.399_963 * k as f64);
        let r = r2.sqrt();
        let d = frame * Vector3::new(r * cos, r * sin, (1.0 - r2).sqrt());
        let mut free = wall_distance(p, &d, half).min(CORNER_M);
        for o in near {
            if let Some(t) = o.distance(p, &d, free) {
                free = free.min(t);
            }
        }
        sum += free / CORNER_M;
    }
    // interreflection in a corner reduces the occlusion
    0.35 + 0.65 * sum / DIRECTIONS as f64
}

fn wall_distance(p: &Vector3<f64>, d: &Vector3<f64>, half: &Vector3<f64>) -> f64 {
    let o = p - Vector3::new(0.0, 0.0, half.z);
    Shape::Room { half: *half }.intersect(&o, d).unwrap_or(0.0)
}

/// What the light of a surface depends on.
struct Site {
    /// Half the extent of the room, metres.
    half: Vector3<f64>,
    lamps: &'static [Lamp],
    obstacles: Vec<Obstacle>,
}

/// A static solid that occludes light.
struct Obstacle {
    shape: Shape,
    rotation: Matrix3<f64>,
    solid_from_world: Se3,
    centre: Vector3<f64>,
    radius: f64,
}

impl Obstacle {
    /// `None` for light sources, and for sheets and carpets, which are too flat to occlude anything.
    fn new(solid: &Solid) -> Option<Self> {
        let shines = matches!(
            solid.material,
            Material::Shade { .. } | Material::Window { .. }
        );
        let flat = matches!(solid.shape, Shape::Block { half } if half.min() < 0.006);
        let lets_through = shines || flat;
        let [low, high] = solid.shape.bounds();
        let solid_from_world = solid.world_from_solid.inverse();
        (!lets_through).then(|| Self {
            shape: solid.shape,
            rotation: solid_from_world.rotation.matrix(),
            solid_from_world,
            centre: solid.world_from_solid * (0.5 * (low + high)),
            radius: 0.5 * (high - low).norm(),
        })
    }

    fn to_solid(&self, p: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * p + self.solid_from_world.translation
    }

    /// Whether it can occlude ambient light at p.
    fn is_near(&self, p: &Vector3<f64>) -> bool {
        let reach = CORNER_M + self.radius;
        (self.centre - p).norm_squared() < reach * reach
    }

    fn contains(&self, p: &Vector3<f64>) -> bool {
        (p - self.centre).norm_squared() < self.radius * self.radius
            && self.shape.contains(&self.to_solid(p))
    }

    /// Distance along a unit direction; may be `None` if it is `limit` or more. The bounding sphere is
    /// tested first.
    fn distance(&self, p: &Vector3<f64>, d: &Vector3<f64>, limit: f64) -> Option<f64> {
        let to_centre = self.centre - p;
        let along = to_centre.dot(d);
        let miss2 = to_centre.norm_squared() - along * along;
        let ends = along < -self.radius || along > limit + self.radius;
        if ends || miss2 > self.radius * self.radius {
            return None;
        }
        self.shape
            .intersect(&self.to_solid(p), &(self.rotation * d))
    }
}

impl Grid {
    /// Bilinear interpolation.
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to the grid"
    )]
    fn at(&self, uv: [f32; 2]) -> Rgb {
        let place = |axis: usize| {
            let steps = (self.nodes[axis] - 1) as f32;
            let x = ((uv[axis] / self.half[axis] + 1.0) * 0.5 * steps).clamp(0.0, steps);
            let i = (x as usize).min(self.nodes[axis] - 2);
            (i, x - i as f32)
        };
        let ((i, x), (j, y)) = (place(0), place(1));
        let value = |di: usize, dj: usize| &self.values[(j + dj) * self.nodes[0] + i + di];
        let (a, b, c, d) = (value(0, 0), value(1, 0), value(0, 1), value(1, 1));
        std::array::from_fn(|k| lerp(lerp(a[k], b[k], x), lerp(c[k], d[k], x), y))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cast::furnishing;
    use crate::config::SceneName;
    use crate::room::furnished;

    fn floor_light(lighting: &Lighting, x: f32, y: f32) -> f32 {
        let s = Surface {
            face: 4,
            uv: [x, y],
            half: [2.5, 2.0],
        };
        lighting.at(0, &s, || (Vector3::zeros(), Vector3::z()))[1]
    }

    #[test]
    fn corners_and_the_floor_below_the_desk_are_darker() {
        let room = furnishing(SceneName::Walking);
        let lighting = Lighting::bake(&furnished(room, 1), lamps(SceneName::Walking), Par::Seq);
        let open = floor_light(&lighting, 1.6, -0.6);
        let below_desk = floor_light(&lighting, 0.2, 1.7);
        let corner = floor_light(&lighting, 2.45, -1.95);
        assert!(below_desk < 0.7 * open, "{below_desk} against {open}");
        assert!(corner < 0.9 * open, "{corner} against {open}");
    }

    #[test]
    fn light_does_not_depend_on_threads() {
        let room = furnishing(SceneName::Crowd);
        let mut solids = furnished(room, 2);
        solids.truncate(40);
        let bits = |par: Par| {
            format!(
                "{:?}",
                Lighting::bake(&solids, lamps(SceneName::Crowd), par)
            )
        };
        assert_eq!(bits(Par::Seq), bits(Par::Threads(3)), "bits");
    }
}
