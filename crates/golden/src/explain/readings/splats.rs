//! Projection with one mistake: docs/math.md R1 to R7.

use super::Reading;
use crate::explain::suspect::Suspect;
use crate::inputs::{InputError, Inputs};

const BLUR_PX2: f64 = 0.3;
const CLAMP: f64 = 1.3;
const CELL: f64 = 16.0;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Slip {
    NoClamp,
    GsplatClamp,
    NoBlur,
    LinearScale,
    QuaternionLast,
    QuaternionFree,
    RotationTransposed,
    CameraTransposed,
    CameraInverted,
    Range,
    OrderByRange,
    OrderReversed,
    Near,
    NoFootprint,
    TwoSigma,
    PixelsAtHalves,
    OpacityRaw,
    OpacityTwice,
    NoAlphaCut,
    NoAlphaLimit,
    NoStop,
    EarlyStop,
    NoHalf,
    NoColourLimit,
    DirectionBackwards,
    DirectionInCamera,
    ShSigns,
}

/// What is said of each.
const SLIPS: &[(Slip, &str)] = &[
    (
        Slip::NoClamp,
        "the slope in the projection's Jacobian is not clamped to 1.3 tan(fov/2) (R3)",
    ),
    (
        Slip::GsplatClamp,
        "the slope in the projection's Jacobian is clamped as gsplat does, by the principal point; it is ±1.3 tan(fov/2) (R3)",
    ),
    (
        Slip::NoBlur,
        "0.3 px² on the diagonal of the covariance are missing",
    ),
    (
        Slip::LinearScale,
        "log_scales are used as scales: the exponential is missing",
    ),
    (
        Slip::QuaternionLast,
        "quaternions were read as (x, y, z, w); they are (w, x, y, z)",
    ),
    (
        Slip::QuaternionFree,
        "the quaternions are used without bringing them to length 1",
    ),
    (
        Slip::RotationTransposed,
        "the rotation of the Gaussians is transposed",
    ),
    (
        Slip::CameraTransposed,
        "the camera's rotation is transposed",
    ),
    (
        Slip::CameraInverted,
        "the pose is used as world_from_camera; it is camera_from_world",
    ),
    (
        Slip::Range,
        "the depth is the distance from the camera; it is z",
    ),
    (
        Slip::OrderByRange,
        "Gaussians are sorted by their distance from the camera; by z (R8)",
    ),
    (
        Slip::OrderReversed,
        "Gaussians are blended back to front; front to back (R8)",
    ),
    (
        Slip::Near,
        "the near plane is at 0.01 m; it is at 0.2 m (R1)",
    ),
    (
        Slip::NoFootprint,
        "pixels outside of the footprint are drawn (R6)",
    ),
    (
        Slip::TwoSigma,
        "the footprint reaches two standard deviations; three (R6)",
    ),
    (
        Slip::PixelsAtHalves,
        "pixel centres are half a pixel off, at integers + 0.5; they are at integers (R1)",
    ),
    (
        Slip::OpacityRaw,
        "opacity_logits are used as opacities: the sigmoid is missing",
    ),
    (
        Slip::OpacityTwice,
        "the sigmoid is applied to the opacity twice",
    ),
    (
        Slip::NoAlphaCut,
        "alpha below 1/255 is drawn; it is left out (R10)",
    ),
    (
        Slip::NoAlphaLimit,
        "alpha is not limited to 0.99 (R10); gsplat has 0.999",
    ),
    (
        Slip::NoStop,
        "blending does not end where T falls below 1e-4 (R11)",
    ),
    (
        Slip::EarlyStop,
        "blending ends where T falls below 1e-3; at 1e-4 (R11)",
    ),
    (
        Slip::NoHalf,
        "0.5 is not added to the colour of the harmonics (R7)",
    ),
    (Slip::NoColourLimit, "colours below 0 are not set to 0 (R7)"),
    (
        Slip::DirectionBackwards,
        "the view direction points to the camera; it points from it (R7)",
    ),
    (
        Slip::DirectionInCamera,
        "the view direction is in the camera's frame; it is in the world's (R7)",
    ),
    (
        Slip::ShSigns,
        "the harmonics of degree 1 lack their signs (-y, z, -x) (R7)",
    ),
];

/// What a case says of its map and camera.
pub(super) struct Scene {
    pub(super) size: [f64; 2],
    k: [f64; 4],
    q: [f64; 4],
    t: [f64; 3],
    pub(super) means: Vec<[f64; 3]>,
    log_scales: Vec<[f64; 3]>,
    quaternions: Vec<[f64; 4]>,
    opacity_logits: Vec<f64>,
    /// Coefficients of each Gaussian; empty without colours.
    pub(super) sh: Vec<Vec<[f64; 3]>>,
}

pub(super) struct Splat {
    pub(super) index: usize,
    pub(super) p: [f64; 3],
    pub(super) mean_px: [f64; 2],
    pub(super) depth_m: f64,
    /// xx, xy, yy.
    pub(super) cov: [f64; 3],
    pub(super) conic: [f64; 3],
    pub(super) radius: f64,
    /// x0 y0 x1 y1, ends excluded.
    pub(super) footprint: [f64; 4],
    pub(super) opacity: f64,
    pub(super) color: [f64; 3],
    pub(super) jacobian: Jacobian,
}

/// What the backward pass of the slope needs.
pub(super) struct Jacobian {
    pub(super) f_over_z: [f64; 2],
    pub(super) slope: [f64; 2],
    pub(super) clamped: [bool; 2],
    /// Half-axes in pixels, and R S.
    pub(super) m: [[f64; 3]; 2],
    pub(super) own: [[f64; 3]; 3],
}

pub(super) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

pub(super) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}

pub(super) fn turned(r: &[[f64; 3]; 3], p: [f64; 3]) -> [f64; 3] {
    r.map(|row| dot(row, p))
}

pub(super) fn transposed(r: &[[f64; 3]; 3]) -> [[f64; 3]; 3] {
    [0, 1, 2].map(|a| [0, 1, 2].map(|b| r[b][a]))
}

/// (w, x, y, z) of any length.
fn rotation(q: [f64; 4], normalise: bool) -> [[f64; 3]; 3] {
    let length = if normalise {
        q.iter().map(|v| v * v).sum::<f64>().sqrt()
    } else {
        1.0
    };
    let [w, x, y, z] = q.map(|v| v / length);
    [
        [
            1.0 - 2.0 * (y * y + z * z),
            2.0 * (x * y - w * z),
            2.0 * (x * z + w * y),
        ],
        [
            2.0 * (x * y + w * z),
            1.0 - 2.0 * (x * x + z * z),
            2.0 * (y * z - w * x),
        ],
        [
            2.0 * (x * z - w * y),
            2.0 * (y * z + w * x),
            1.0 - 2.0 * (x * x + y * y),
        ],
    ]
}

fn sigmoid(v: f64) -> f64 {
    1.0 / (1.0 + libm::exp(-v))
}

impl Scene {
    pub(super) fn read(inputs: &Inputs) -> Result<Self, InputError> {
        let means = inputs.rows::<3>("means")?;
        let triples = inputs.rows::<3>("sh").unwrap_or_default();
        let per = triples.len() / means.len().max(1);
        Ok(Self {
            size: [inputs.number("width")?, inputs.number("height")?],
            k: inputs.row("intrinsics")?,
            q: inputs.row("camera_from_world_q")?,
            t: inputs.row("camera_from_world_t")?,
            log_scales: inputs.rows("log_scales")?,
            quaternions: inputs.rows("quaternions")?,
            opacity_logits: inputs.reals("opacity_logits").unwrap_or_default(),
            sh: match per {
                0 => vec![Vec::new(); means.len()],
                per => triples.chunks(per).map(<[_]>::to_vec).collect(),
            },
            means,
        })
    }

    /// camera_from_world and the camera's centre times -1.
    pub(super) fn pose(&self, slip: Option<Slip>) -> ([[f64; 3]; 3], [f64; 3]) {
        let w = rotation(self.q, true);
        match slip {
            Some(Slip::CameraTransposed) => (transposed(&w), self.t),
            Some(Slip::CameraInverted) => {
                (transposed(&w), turned(&transposed(&w), self.t).map(|v| -v))
            }
            _ => (w, self.t),
        }
    }

    /// Gaussian `i` in the image, if it is visible.
    pub(super) fn project(&self, i: usize, slip: Option<Slip>) -> Option<Splat> {
        let (w, t) = self.pose(slip);
        let moved = turned(&w, self.means[i]);
        let p = [0, 1, 2].map(|k| moved[k] + t[k]);
        let z = p[2];
        let near = if slip == Some(Slip::Near) { 0.01 } else { 0.2 };
        if z <= near {
            return None;
        }
        let f = [self.k[0], self.k[1]];
        let c = [self.k[2], self.k[3]];
        let mean_px = [0, 1].map(|a| f[a] * p[a] / z + c[a]);
        let free = [0, 1].map(|a| p[a] / z);
        let slope = [0, 1].map(|a| {
            let half = self.size[a] / (2.0 * f[a]);
            match slip {
                Some(Slip::NoClamp) => free[a],
                Some(Slip::GsplatClamp) => free[a].clamp(
                    -(c[a] + 0.5) / f[a] - 0.3 * half,
                    (self.size[a] - c[a] - 0.5) / f[a] + 0.3 * half,
                ),
                _ => free[a].clamp(-CLAMP * half, CLAMP * half),
            }
        });
        let f_over_z = f.map(|f| f / z);
        let q = self.quaternions[i];
        let r = match slip {
            Some(Slip::QuaternionLast) => rotation([q[3], q[0], q[1], q[2]], true),
            Some(Slip::QuaternionFree) => rotation(q, false),
            Some(Slip::RotationTransposed) => transposed(&rotation(q, true)),
            _ => rotation(q, true),
        };
        let sigma = self.log_scales[i].map(|s| match slip {
            Some(Slip::LinearScale) => s,
            _ => libm::exp(s),
        });
        let own = r.map(|row| [0, 1, 2].map(|k| row[k] * sigma[k]));
        let columns = transposed(&own);
        let m = [0, 1].map(|a| {
            let jw = [0, 1, 2].map(|k| f_over_z[a] * (w[a][k] - slope[a] * w[2][k]));
            columns.map(|column| dot(jw, column))
        });
        let blur = if slip == Some(Slip::NoBlur) {
            0.0
        } else {
            BLUR_PX2
        };
        let (xx, xy, yy) = (dot(m[0], m[0]), dot(m[0], m[1]), dot(m[1], m[1]));
        let minors = cross(m[0], m[1]);
        let det = dot(minors, minors) + blur * (xx + yy) + blur * blur;
        let cov = [xx + blur, xy, yy + blur];
        let half = (xx - yy) / 2.0;
        let largest = f64::midpoint(cov[0], cov[2]) + (half * half + xy * xy).max(0.1).sqrt();
        let sigmas = if slip == Some(Slip::TwoSigma) {
            2.0
        } else {
            3.0
        };
        let radius = (sigmas * largest.sqrt()).ceil();
        let edge = |a: usize, reach: f64| {
            let cells = (self.size[a] / CELL).ceil();
            let cell = ((mean_px[a] + reach) / CELL).floor().clamp(0.0, cells);
            (CELL * cell).min(self.size[a])
        };
        let (low, high) = (-radius, radius + CELL - 1.0);
        let footprint = [edge(0, low), edge(1, low), edge(0, high), edge(1, high)];
        if footprint[0] >= footprint[2] || footprint[1] >= footprint[3] {
            return None;
        }
        let logit = self.opacity_logits.get(i).copied().unwrap_or(0.0);
        Some(Splat {
            index: i,
            p,
            mean_px,
            depth_m: match slip {
                Some(Slip::Range) => dot(p, p).sqrt(),
                _ => z,
            },
            cov,
            conic: [cov[2] / det, -xy / det, cov[0] / det],
            radius,
            footprint,
            opacity: match slip {
                Some(Slip::OpacityRaw) => logit,
                Some(Slip::OpacityTwice) => sigmoid(sigmoid(logit)),
                _ => sigmoid(logit),
            },
            color: self.color(i, slip),
            jacobian: Jacobian {
                f_over_z,
                slope,
                clamped: [0, 1].map(|a| (slope[a] - free[a]).abs() > 0.0),
                m,
                own,
            },
        })
    }

    /// From the camera to Gaussian `i`, and how far.
    pub(super) fn direction(&self, i: usize, slip: Option<Slip>) -> ([f64; 3], f64) {
        let (w, t) = self.pose(slip);
        let back = turned(&transposed(&w), t);
        let offset = [0, 1, 2].map(|k| self.means[i][k] + back[k]);
        let length = dot(offset, offset).sqrt();
        let unit = offset.map(|v| v / length);
        match slip {
            Some(Slip::DirectionBackwards) => (unit.map(|v| -v), length),
            Some(Slip::DirectionInCamera) => (turned(&w, unit), length),
            _ => (unit, length),
        }
    }

    fn color(&self, i: usize, slip: Option<Slip>) -> [f64; 3] {
        let sh = &self.sh[i];
        let basis = super::harmonics::basis(self.direction(i, slip).0);
        let half = if slip == Some(Slip::NoHalf) { 0.0 } else { 0.5 };
        [0, 1, 2].map(|c| {
            let signs = |k: usize| match (slip, k) {
                (Some(Slip::ShSigns), 1 | 3) => -1.0,
                _ => 1.0,
            };
            let terms = basis.iter().zip(sh).enumerate();
            let sum = terms.fold(half, |sum, (k, (b, f))| sum + signs(k) * b * f[c]);
            match slip {
                Some(Slip::NoColourLimit) => sum,
                _ => sum.max(0.0),
            }
        })
    }

    /// All that are visible, in the order of the map.
    pub(super) fn visible(&self, slip: Option<Slip>) -> Vec<Splat> {
        (0..self.means.len())
            .filter_map(|i| self.project(i, slip))
            .collect()
    }
}

/// The mistakes that an output is compared with. Whole numbers agree by chance with many; what colours show is named there.
pub(super) fn told_by(output: &str) -> impl Iterator<Item = (Slip, &'static str)> {
    let slips: Option<&[Slip]> = match output {
        "order" => Some(&[Slip::OrderByRange, Slip::OrderReversed]),
        "radius" | "radii" | "footprint" => Some(&[Slip::TwoSigma]),
        "last" | "contributors" => Some(&[]),
        _ => None,
    };
    let all = SLIPS.iter().copied();
    all.filter(move |(slip, _)| slips.is_none_or(|some| some.contains(slip)))
}

/// One column of what splats are, by the name of the output.
pub(super) fn column(splats: &[Splat], output: &str) -> Option<Vec<f64>> {
    let of = |f: fn(&Splat) -> &[f64]| splats.iter().flat_map(f).copied().collect();
    Some(match output {
        "p_cam" => of(|s| &s.p),
        "mean_px" => of(|s| &s.mean_px),
        "depth_m" => of(|s| std::slice::from_ref(&s.depth_m)),
        "conic" => of(|s| &s.conic),
        "radius" => of(|s| std::slice::from_ref(&s.radius)),
        "footprint" => of(|s| &s.footprint),
        "splat_color" => of(|s| &s.color),
        _ => return None,
    })
}

/// Of `projection_covariance`.
pub(super) fn readings(s: &Suspect<'_>) -> Option<Vec<Reading>> {
    let scene = Scene::read(s.case.inputs()).ok()?;
    let one = |(slip, name)| Some((name, column(&scene.visible(Some(slip)), s.output)?));
    Some(told_by(s.output).filter_map(one).collect())
}
