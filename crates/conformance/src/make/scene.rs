//! Scenes of any number of Gaussians that a pinhole camera sees.

use garad_core::{Camera, GaussianMap, KeyframeId, Label, Par, Rng, Se3, So3};
use garad_raster::{FOOTPRINT_CELL_PX, NEAR_M, Projected, RenderOptions, splats};
use nalgebra::Vector3;

use super::f32_of;
use super::masks;
use crate::outputs::Error;

/// What a scene is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SceneKind {
    /// Flat discs on the walls of a room, about thirty deep at a pixel, most of them opaque.
    Room,
    /// A hundred times as long as wide.
    Needles,
    /// Large and faint: hundreds deep at a pixel, few pixels end early.
    Soft,
    /// Half of them behind one another at three places: crowded tiles beside empty ones.
    Stack,
}

impl SceneKind {
    /// Every kind with its name.
    pub const ALL: [(&'static str, Self); 4] = [
        ("room", Self::Room),
        ("needles", Self::Needles),
        ("soft", Self::Soft),
        ("stack", Self::Stack),
    ];

    fn name(self) -> &'static str {
        let found = Self::ALL.iter().find(|(_, kind)| *kind == self);
        found.map_or("", |(name, _)| name)
    }
}

/// A scene and its image.
#[derive(Debug, Clone, Copy)]
pub struct SceneOptions {
    /// What it is made of.
    pub kind: SceneKind,
    /// How many.
    pub gaussians: usize,
    /// Columns and rows.
    pub size: [usize; 2],
    /// Degree of the spherical harmonics.
    pub degree: usize,
    /// Seed.
    pub seed: u64,
}

impl SceneOptions {
    /// Name of the case.
    pub(super) fn name(&self) -> String {
        let [width, height] = self.size;
        let (kind, n) = (self.kind.name(), self.gaussians);
        format!(
            "{kind}_{n}_{width}x{height}_sh{}_{}",
            self.degree, self.seed
        )
    }
}

/// One Gaussian in so many has the mean of an earlier one: equal depths, which the row decides.
const TIES: usize = 64;
/// Rounds of drawing again what cannot be decided in f32.
const ROUNDS: u64 = 20;
/// Pixels around the image in which centres lie, as a share of its size.
const MARGIN: f64 = 0.05;

pub(super) struct Scene {
    pub(super) map: GaussianMap<f64>,
    pub(super) camera: Camera,
    pub(super) q: [f64; 4],
    pub(super) t: [f64; 3],
    pub(super) background: [f64; 3],
}

impl Scene {
    /// Draws rows until the rectangle of each is certain in f32: which tiles it is in, and whether it is visible.
    pub(super) fn new(o: &SceneOptions, par: Par) -> Result<Self, Error> {
        let [width, height] = o.size;
        if o.gaussians == 0 || width < 16 || height < 16 {
            return Err("a scene has Gaussians, and an image of at least 16 x 16".into());
        }
        let (w, h) = (width as f64, height as f64);
        let camera = Camera::pinhole((width, height), [1.05 * w, 1.08 * w, 0.47 * w, 0.53 * h])?;
        let (q, t) = ([0.45, -0.69, 0.28, 0.49], [1.0, -2.0, 0.7]);
        let mut map = GaussianMap::new(o.degree);
        let (n, k) = (o.gaussians, (o.degree + 1) * (o.degree + 1));
        map.means = vec![[0.0; 3]; n];
        map.log_scales = vec![[0.0; 3]; n];
        map.quaternions = vec![[0.0; 4]; n];
        map.opacity_logits = vec![0.0; n];
        map.sh = vec![[0.0; 3]; n * k];
        map.landmark = vec![None; n];
        map.parent = vec![None; n];
        map.born = vec![KeyframeId(0); n];
        map.label = vec![Label::Static; n];
        let background = [0.1, 0.2, 0.3].map(f32_of);
        let mut scene = Self {
            map,
            camera,
            q,
            t,
            background,
        };
        let mut rows: Vec<usize> = (0..n).collect();
        for round in 0..ROUNDS {
            for &row in &rows {
                scene.draw_row(o, row, round)?;
            }
            rows = scene.uncertain(par)?;
            if rows.is_empty() {
                return Ok(scene);
            }
        }
        Err(format!("{} rows stay uncertain; another seed", rows.len()).into())
    }

    pub(super) fn pose(&self) -> Result<Se3, Error> {
        let [w, x, y, z] = self.q;
        let rotation = So3::from_quaternion(w, x, y, z).ok_or("a quaternion without direction")?;
        Ok(Se3::new(rotation, Vector3::from(self.t)))
    }

    fn draw_row(&mut self, o: &SceneOptions, i: usize, round: u64) -> Result<(), Error> {
        let rng = &mut Rng::keyed(o.seed, &[o.kind as u64, i as u64, round]);
        let (f, c) = (
            [self.camera.fx, self.camera.fy],
            [self.camera.cx, self.camera.cy],
        );
        let size = o.size.map(|n| n as f64);
        let area = size[0] * size[1];
        let hot = o.kind == SceneKind::Stack && rng.uniform() < 0.5;
        let mut px = [0, 1].map(|k| size[k] * rng.range(-MARGIN, 1.0 + MARGIN));
        if hot {
            let place = rng.below(3) as f64;
            let center = [0.2 + 0.3 * place, 0.3 + 0.2 * place];
            px = [0, 1].map(|k| size[k] * center[k] + 6.0 * rng.normal().clamp(-3.0, 3.0));
        }
        let slope = [0, 1].map(|k| (px[k] - c[k]) / f[k]);
        // Splats of so many pixels across lie this deep at each pixel: n π (3 sigma)² = depth area.
        let sigma_px = |deep: f64| {
            let sigma2 = deep * area / (o.gaussians as f64 * 9.0 * std::f64::consts::PI);
            sigma2.sqrt().clamp(0.3, 0.1 * size[0])
        };
        let (mut depth, sigma, aspect, opacity) = match o.kind {
            SceneKind::Room => (
                wall(slope),
                sigma_px(30.0),
                [1.0, 1.0, 0.2],
                rng.range(0.3, 0.995),
            ),
            SceneKind::Needles => (
                rng.range(0.8, 4.0),
                3.0 * sigma_px(30.0),
                [1.0, 0.01, 0.01],
                rng.range(0.1, 0.98),
            ),
            SceneKind::Soft => (
                rng.range(0.8, 4.0),
                sigma_px(200.0),
                [1.0, 0.8, 0.9],
                rng.range(0.01, 0.12),
            ),
            SceneKind::Stack if hot => (
                rng.range(0.8, 4.0),
                2.0,
                [1.0, 0.7, 0.5],
                rng.range(0.004, 0.9),
            ),
            SceneKind::Stack => (
                rng.range(0.8, 4.0),
                sigma_px(10.0),
                [1.0, 0.6, 0.8],
                rng.range(0.2, 0.98),
            ),
        };
        if o.kind == SceneKind::Room {
            depth *= 1.0 + 0.01 * rng.normal().clamp(-3.0, 3.0);
        }
        let sigma_m = sigma * depth / f[0] * rng.range(0.6, 1.5);
        let p = [slope[0] * depth, slope[1] * depth, depth];
        let back = self.pose()?.inverse();
        let world = back.rotation.matrix() * Vector3::from(p) + back.translation;
        let map = &mut self.map;
        map.means[i] = [world.x, world.y, world.z].map(f32_of);
        if i % TIES == TIES - 1 && round == 0 {
            map.means[i] = map.means[rng.below(i)];
        }
        map.log_scales[i] = aspect.map(|a| f32_of(libm::log(a * sigma_m * rng.range(0.8, 1.25))));
        map.quaternions[i] = [0; 4].map(|_| f32_of(rng.normal()));
        map.opacity_logits[i] = f32_of(libm::log(opacity / (1.0 - opacity)));
        let k = map.sh.len() / map.means.len();
        for (j, triple) in map.sh[i * k..(i + 1) * k].iter_mut().enumerate() {
            let (mean, spread) = if j == 0 { (0.4, 0.9) } else { (0.0, 0.2) };
            *triple = [0; 3].map(|_| f32_of(mean + spread * rng.normal()));
        }
        Ok(())
    }

    /// Rows whose rectangle f32 may round to other cells. They are projected into an image with a border of
    /// whole cells, where even those outside of the real image are visible; centres are never so far out that the clamp of
    /// the Jacobian, which depends on the size, matters.
    fn uncertain(&self, par: Par) -> Result<Vec<usize>, Error> {
        let (w, h) = (self.camera.width, self.camera.height);
        let side = w.max(h).next_multiple_of(FOOTPRINT_CELL_PX);
        let shift = side as f64;
        let k = [
            self.camera.fx,
            self.camera.fy,
            self.camera.cx + shift,
            self.camera.cy + shift,
        ];
        let wide = Camera::pinhole((w + 2 * side, h + 2 * side), k)?;
        let options = RenderOptions::default();
        let seen = splats(&self.map, &wide, &self.pose()?, &options, par)?;
        let mut certain = vec![false; self.map.len()];
        for splat in &seen {
            let row = splat.index as usize;
            let error = masks::center_error_px(self, row)?;
            certain[row] = splat.depth_m > 2.0 * NEAR_M && certain_cells(splat, error);
        }
        Ok((0..certain.len()).filter(|&i| !certain[i]).collect())
    }
}

/// Whether no edge of the rectangle is near the edge of a cell, for either radius where that is not certain.
fn certain_cells(splat: &Projected<f64>, error: [f64; 2]) -> bool {
    let exact = masks::radius_px(splat);
    let radii = [
        exact * (1.0 - masks::RADIUS_MARGIN),
        exact * (1.0 + masks::RADIUS_MARGIN),
    ];
    let cell = FOOTPRINT_CELL_PX as f64;
    let mut cells = radii.into_iter().map(f64::ceil).flat_map(|r| {
        [0, 1].into_iter().flat_map(move |k| {
            let (m, last) = (splat.mean_px[k], cell - 1.0);
            [m - r, m + r + last].map(|edge| {
                let near = (edge / cell).round() * cell;
                ((edge / cell).floor(), (edge - near).abs() > error[k])
            })
        })
    });
    let found: Vec<(f64, bool)> = cells.by_ref().collect();
    let (first, second) = found.split_at(4);
    #[allow(clippy::float_cmp, reason = "whole numbers")]
    let same = first.iter().zip(second).all(|(a, b)| a.0 == b.0);
    same && found.iter().all(|(_, clear)| *clear)
}

/// Distance along z to the walls of a room 4 m wide, 2.6 m high and 4.5 m deep, and to a box in front of its back.
fn wall(slope: [f64; 2]) -> f64 {
    let side = [2.0, 1.3].into_iter().zip(slope);
    let walls = side.map(|(half, s)| if s.abs() > 1e-9 { half / s.abs() } else { 4.5 });
    let room = walls.fold(4.5, f64::min);
    let inside = (-0.25..0.1).contains(&slope[0]) && (-0.05..0.3).contains(&slope[1]);
    if inside { room.min(2.2) } else { room }
}
