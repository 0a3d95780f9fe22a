//! From Gaussians to splats and back, by the formulas of docs/math.md R1 to R7 and R15 to R20.

use super::harmonics::{basis, tangent_gradient};
use super::number::{Mat, N, apply, cross, dot, transposed};
use super::rendering::{Fault, How};

const NEAR_M: f64 = 0.2;
const BLUR_PX2: f64 = 0.3;
const CLAMP: f64 = 1.3;

/// Rows as a case has them.
#[derive(Debug, Clone, Default)]
pub(crate) struct Gaussians<const M: bool, const Z: bool> {
    pub(crate) means: Vec<[N<M, Z>; 3]>,
    pub(crate) log_scales: Vec<[N<M, Z>; 3]>,
    pub(crate) quaternions: Vec<[N<M, Z>; 4]>,
    pub(crate) opacity_logits: Vec<N<M, Z>>,
    pub(crate) sh: Vec<Vec<[N<M, Z>; 3]>>,
}

#[derive(Debug, Clone)]
pub(crate) struct View<const M: bool, const Z: bool> {
    pub(crate) w: Mat<M, Z>,
    pub(crate) t: [N<M, Z>; 3],
    /// fx, fy, cx, cy.
    pub(crate) k: [N<M, Z>; 4],
    pub(crate) size: [i64; 2],
}

#[derive(Debug, Clone)]
pub(crate) struct Splat<const M: bool, const Z: bool> {
    pub(crate) p: [N<M, Z>; 3],
    pub(crate) mean_px: [N<M, Z>; 2],
    pub(crate) depth_m: N<M, Z>,
    slope: [N<M, Z>; 2],
    clamped: [bool; 2],
    f_over_z: [N<M, Z>; 2],
    jw: [[N<M, Z>; 3]; 2],
    pub(crate) r: Mat<M, Z>,
    sigma: [N<M, Z>; 3],
    m: [[N<M, Z>; 3]; 2],
    pub(crate) cov: [N<M, Z>; 3],
    pub(crate) conic: [N<M, Z>; 3],
    pub(crate) radius: i64,
    /// x0 y0 x1 y1.
    pub(crate) footprint: [i64; 4],
    pub(crate) visible: bool,
    pub(crate) opacity: N<M, Z>,
    pub(crate) color: [N<M, Z>; 3],
    lit: [bool; 3],
    basis: Vec<N<M, Z>>,
    direction: [N<M, Z>; 3],
    distance: N<M, Z>,
}

fn unit<const M: bool, const Z: bool>(q: &[N<M, Z>; 4]) -> ([N<M, Z>; 4], N<M, Z>) {
    let length = dot(q, q).sqrt();
    (q.map(|v| v / length), length)
}

/// Of (w, x, y, z).
pub(crate) fn rotation<const M: bool, const Z: bool>(q: &[N<M, Z>; 4], how: &How) -> Mat<M, Z> {
    let q = match how.fault {
        Some(Fault::QuaternionOrder) => [q[3], q[0], q[1], q[2]],
        _ => *q,
    };
    let [w, x, y, z] = match how.fault {
        Some(Fault::QuaternionNotNormalised) => q,
        _ => unit(&q).0,
    };
    let (one, two) = (N::ONE, N::new(2.0));
    let m = [
        [
            one - two * (y * y + z * z),
            two * (x * y - w * z),
            two * (x * z + w * y),
        ],
        [
            two * (x * y + w * z),
            one - two * (x * x + z * z),
            two * (y * z - w * x),
        ],
        [
            two * (x * z - w * y),
            two * (y * z + w * x),
            one - two * (x * x + y * y),
        ],
    ];
    match how.fault {
        Some(Fault::ColumnMajor) => transposed(&m),
        _ => m,
    }
}

fn sigmoid<const M: bool, const Z: bool>(x: N<M, Z>) -> N<M, Z> {
    N::ONE / (N::ONE + (-x).exp())
}

fn whole(v: f32) -> i64 {
    #[allow(clippy::cast_possible_truncation, reason = "saturates, as on a GPU")]
    let v = v as i64;
    v
}

pub(crate) fn project<const M: bool, const Z: bool>(
    g: &Gaussians<M, Z>,
    i: usize,
    view: &View<M, Z>,
    how: &How,
) -> Splat<M, Z> {
    let (w, [fx, fy, mut cx, mut cy], [width, height]) = (&view.w, view.k, view.size);
    let two = N::new(2.0);
    let size = [width, height].map(|n| N::new(n as f64));
    if how.fault == Some(Fault::PrincipalPoint) {
        (cx, cy) = ((size[0] - N::ONE) / two, (size[1] - N::ONE) / two);
    }
    let turned = apply(w, &g.means[i]);
    let p = [0, 1, 2].map(|k| turned[k] + view.t[k]);
    let z = p[2];
    let mean_px = [(fx * p[0] / z) + cx, (fy * p[1] / z) + cy];
    let f = [fx, fy];
    let (mut slope, mut clamped) = ([N::ZERO; 2], [false; 2]);
    for a in 0..2 {
        let limit = N::new(CLAMP) * size[a] / (two * f[a]);
        let free = p[a] / z;
        slope[a] = free.max(-limit).min(limit);
        clamped[a] = free.abs() > limit;
        match how.fault {
            Some(Fault::NoClamp) => (slope[a], clamped[a]) = (free, false),
            // z against the limit of x/z.
            Some(Fault::ClampOfZ) => slope[a] = p[a] / z.min(limit),
            Some(Fault::JacobianAtCamera) => slope[a] = view.t[a] / z,
            _ => {}
        }
    }
    let f_over_z = [fx / z, fy / z];
    let jw = [0, 1].map(|a| [0, 1, 2].map(|c| f_over_z[a] * (w[a][c] - slope[a] * w[2][c])));
    let r = rotation(&g.quaternions[i], how);
    let sigma = match how.fault {
        Some(Fault::ScaleNotExponential) => g.log_scales[i],
        _ => g.log_scales[i].map(N::exp),
    };
    let m = [0, 1].map(|a| [0, 1, 2].map(|c| dot(&jw[a], &[r[0][c], r[1][c], r[2][c]]) * sigma[c]));
    let blur = N::new(if how.fault == Some(Fault::NoDilation) {
        0.0
    } else {
        BLUR_PX2
    });
    let (xx, xy, yy) = (dot(&m[0], &m[0]), dot(&m[0], &m[1]), dot(&m[1], &m[1]));
    let minor = |j: usize, k: usize| m[0][j] * m[1][k] - m[0][k] * m[1][j];
    let minors = [minor(0, 1), minor(1, 2), minor(0, 2)];
    let sharp = dot(&minors, &minors);
    let cov = [xx + blur, xy, yy + blur];
    let det = match how.fault {
        Some(Fault::PlainDeterminant) => cov[0] * cov[2] - xy * xy,
        _ => sharp + blur * (xx + yy) + blur * blur,
    };
    let conic = [cov[2] / det, -xy / det, cov[0] / det];
    let half = (xx - yy) / two;
    let largest = (cov[0] + cov[2]) / two + (half * half + xy * xy).max(N::new(0.1)).sqrt();
    let mut radius = N::new(3.0) * largest.sqrt();
    if how.fault == Some(Fault::TwoSigma) {
        radius = two * largest.sqrt();
    }
    let radius = whole(radius.0.ceil());
    let cell = how.footprint_cell();
    let edges = |at: N<M, Z>, n: i64| {
        let (at, r) = (at.0, radius as f32);
        let cells = (n + cell - 1) / cell;
        let low = whole(((at - r) / cell as f32).floor()).clamp(0, cells);
        let high = whole(((at + r + (cell - 1) as f32) / cell as f32).floor()).clamp(0, cells);
        [(low * cell).min(n), (high * cell).min(n)]
    };
    let ([x0, x1], [y0, y1]) = (edges(mean_px[0], width), edges(mean_px[1], height));
    let visible = z > N::new(NEAR_M) && x0 < x1 && y0 < y1;

    // Colour and opacity.
    let back = transposed(w);
    let center = apply(&back, &view.t);
    let offset = match how.fault {
        // The camera of another view.
        Some(Fault::DirectionOfOtherCamera) => g.means[i],
        _ => [0, 1, 2].map(|k| g.means[i][k] + center[k]),
    };
    let distance = dot(&offset, &offset).sqrt();
    let direction = offset.map(|v| v / distance);
    let sh = g.sh.get(i).map_or(&[][..], Vec::as_slice);
    let basis = basis(&direction, sh.len(), how);
    let color = [0, 1, 2].map(|c| {
        let terms = basis.iter().zip(sh);
        let terms = terms.enumerate().map(|(k, (b, f))| match how.fault {
            // Coefficients that the file lacks are what stood there before.
            Some(Fault::ShRestNotZeroed) if k > 0 && sh.len() == 4 => *b * sh[0][c],
            _ => *b * f[c],
        });
        terms.fold(N::new(0.5), |sum, t| sum + t)
    });
    let logit = g.opacity_logits.get(i).copied().unwrap_or_default();
    let mut opacity = sigmoid(logit);
    match how.fault {
        Some(Fault::ActivatedTwice) => opacity = sigmoid(opacity),
        Some(Fault::OpacityNotActivated) => opacity = logit,
        Some(Fault::OpacityCompensated) => opacity = opacity * (sharp / det).sqrt(),
        Some(Fault::CoarseExp) => opacity = opacity * N::new(1.0 + 1e-4),
        _ => {}
    }
    Splat {
        p,
        mean_px,
        depth_m: match how.fault {
            Some(Fault::DepthIsRange) => dot(&p, &p).sqrt(),
            _ => z,
        },
        slope,
        clamped,
        f_over_z,
        jw,
        r,
        sigma,
        m,
        cov,
        conic,
        radius: if visible { radius } else { 0 },
        footprint: [x0, y0, x1, y1],
        visible,
        opacity,
        lit: color.map(|c| c > N::ZERO),
        color: color.map(|c| c.max(N::ZERO)),
        basis,
        direction,
        distance,
    }
}

/// Gradients by what the image is made of.
#[derive(Debug, Clone, Default)]
pub(crate) struct ByPixel<const M: bool, const Z: bool> {
    pub(crate) mean_px: [N<M, Z>; 2],
    pub(crate) cov: [N<M, Z>; 3],
    pub(crate) conic: [N<M, Z>; 3],
    pub(crate) opacity: N<M, Z>,
    pub(crate) color: [N<M, Z>; 3],
    pub(crate) depth: N<M, Z>,
}

impl<const M: bool, const Z: bool> ByPixel<M, Z> {
    pub(crate) fn add(&mut self, other: &Self) {
        let pairs = [
            (&mut self.mean_px[..], &other.mean_px[..]),
            (&mut self.cov, &other.cov),
            (&mut self.conic, &other.conic),
            (&mut self.color, &other.color),
        ];
        for (a, b) in pairs {
            a.iter_mut().zip(b).for_each(|(a, b)| *a += *b);
        }
        self.opacity += other.opacity;
        self.depth += other.depth;
    }
}

/// Gradients by the parameters of one Gaussian, and its part of the pose's.
#[derive(Debug, Clone, Default)]
pub(crate) struct ByParameter<const M: bool, const Z: bool> {
    pub(crate) mean: [N<M, Z>; 3],
    pub(crate) log_scale: [N<M, Z>; 3],
    pub(crate) quaternion: [N<M, Z>; 4],
    pub(crate) opacity_logit: N<M, Z>,
    pub(crate) sh: Vec<[N<M, Z>; 3]>,
    pub(crate) pose: [N<M, Z>; 6],
}

pub(crate) fn project_backward<const M: bool, const Z: bool>(
    d: &ByPixel<M, Z>,
    s: &Splat<M, Z>,
    g: &Gaussians<M, Z>,
    i: usize,
    view: &View<M, Z>,
    pass_through: bool,
    how: &How,
) -> ByParameter<M, Z> {
    let n = g.sh[i].len();
    if !s.visible {
        return ByParameter {
            sh: vec![[N::ZERO; 3]; n],
            ..ByParameter::default()
        };
    }
    let (w, [fx, fy, ..], z, two) = (&view.w, view.k, s.p[2], N::new(2.0));
    let [gxx, gxy, gyy] = d.cov;
    let dm = [
        [0, 1, 2].map(|k| two * gxx * s.m[0][k] + gxy * s.m[1][k]),
        [0, 1, 2].map(|k| gxy * s.m[0][k] + two * gyy * s.m[1][k]),
    ];
    let scaled = dm.map(|row| [0, 1, 2].map(|k| row[k] * s.sigma[k]));
    let d_jw = scaled.map(|row| apply(&s.r, &row));
    let d_r: Mat<M, Z> =
        [0, 1, 2].map(|a| [0, 1, 2].map(|b| s.jw[0][a] * scaled[0][b] + s.jw[1][a] * scaled[1][b]));
    let mut log_scale = [0, 1, 2].map(|k| s.m[0][k] * dm[0][k] + s.m[1][k] * dm[1][k]);
    if how.fault == Some(Fault::ScaleForLogScale) {
        log_scale = [0, 1, 2].map(|k| log_scale[k] / s.sigma[k]);
    }
    let h = d_jw.map(|row| apply(w, &row));
    let ds = [0, 1].map(|a| -s.f_over_z[a] * h[a][2]);
    let held = [0, 1].map(|a| if s.clamped[a] { N::ZERO } else { ds[a] });
    let pass_through = pass_through || how.fault == Some(Fault::ClampGradientIgnored);
    let in_z = if pass_through { ds } else { held };
    let mut d_p = [held[0] / z, held[1] / z, N::ZERO];
    let along = dot(&d_jw[0], &s.jw[0]) + dot(&d_jw[1], &s.jw[1]);
    d_p[2] = -(along + s.slope[0] * in_z[0] + s.slope[1] * in_z[1]) / z;
    let mut j = [[N::ZERO; 3]; 2];
    for a in 0..2 {
        j[a][a] = s.f_over_z[a];
        j[a][2] = -s.f_over_z[a] * s.slope[a];
    }
    let (t0, t1) = (cross(&h[0], &j[0]), cross(&h[1], &j[1]));
    let [gu, gv] = d.mean_px;
    d_p[0] += fx * gu / z;
    d_p[1] += fy * gv / z;
    d_p[2] += -(fx * gu * s.p[0] + fy * gv * s.p[1]) / (z * z) + d.depth;
    let lit = [0, 1, 2].map(|c| if s.lit[c] { d.color[c] } else { N::ZERO });
    let sh: Vec<_> = s.basis.iter().map(|b| lit.map(|l| *b * l)).collect();
    let mut d_offset = [N::ZERO; 3];
    if how.fault != Some(Fault::NoGradientThroughDirection) {
        let slopes = tangent_gradient(&s.direction, n, how);
        for (f, slope) in g.sh[i].iter().zip(&slopes) {
            let weight = dot(f, &lit);
            for k in 0..3 {
                d_offset[k] = weight.times_plus(slope[k], d_offset[k]);
            }
        }
        d_offset = d_offset.map(|v| v / s.distance);
    }
    let back = apply(&transposed(w), &d_p);
    let moved = apply(w, &d_offset);
    let arm = cross(&s.p, &d_p);
    let mut opacity_logit = d.opacity * s.opacity * (N::ONE - s.opacity);
    if how.fault == Some(Fault::OpacityForLogit) {
        opacity_logit = d.opacity;
    }
    let mut pose = [N::ZERO; 6];
    for k in 0..3 {
        pose[k] = d_p[k] + moved[k];
        pose[3 + k] = arm[k] + t0[k] + t1[k];
        if how.fault == Some(Fault::PoseFromTheRight) {
            pose[k] = back[k] + d_offset[k];
        }
        if how.fault == Some(Fault::PoseWithoutJacobian) {
            pose[3 + k] = arm[k];
        }
    }
    ByParameter {
        mean: [0, 1, 2].map(|k| back[k] + d_offset[k]),
        log_scale,
        quaternion: rotation_backward(&d_r, &g.quaternions[i], how),
        opacity_logit,
        sh,
        pose,
    }
}

/// The entries of R are quadratic in the unit quaternion; the result is orthogonal to q.
fn rotation_backward<const M: bool, const Z: bool>(
    e: &Mat<M, Z>,
    q: &[N<M, Z>; 4],
    how: &How,
) -> [N<M, Z>; 4] {
    let (u, length) = unit(q);
    let [w, x, y, z] = u;
    let two = N::new(2.0);
    let f = [
        x * (e[2][1] - e[1][2]) + y * (e[0][2] - e[2][0]) + z * (e[1][0] - e[0][1]),
        y * (e[0][1] + e[1][0]) + z * (e[0][2] + e[2][0]) + w * (e[2][1] - e[1][2])
            - two * x * (e[1][1] + e[2][2]),
        x * (e[0][1] + e[1][0]) + z * (e[1][2] + e[2][1]) + w * (e[0][2] - e[2][0])
            - two * y * (e[0][0] + e[2][2]),
        x * (e[0][2] + e[2][0]) + y * (e[1][2] + e[2][1]) + w * (e[1][0] - e[0][1])
            - two * z * (e[0][0] + e[1][1]),
    ]
    .map(|v| two * v);
    let along = dot(&f, &u);
    [0, 1, 2, 3].map(|k| match how.fault {
        Some(Fault::LengthForgotten) => f[k] - along * u[k],
        Some(Fault::QuaternionNotProjected) => f[k] / length,
        _ => (f[k] - along * u[k]) / length,
    })
}
