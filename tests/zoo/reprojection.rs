//! Residuals and their derivatives, a second time, with their faults.

use garad_conformance::Outputs;
use nalgebra::{Matrix3, SMatrix, Vector2, Vector3};

use super::answers::Given;
use super::second::{Fault, How};

/// Points nearer than this are behind the camera, metres.
pub(super) const NEAREST_M: f64 = 0.05;

/// camera_from_world.
#[derive(Clone)]
pub(super) struct Pose {
    pub(super) rotation: Matrix3<f64>,
    pub(super) shift: Vector3<f64>,
}

/// A point seen: where, how surely, and its virtual right coordinate, if there is one.
pub(super) struct Seen {
    pub(super) pose: usize,
    pub(super) point: usize,
    pub(super) uv: Vector2<f64>,
    pub(super) sigma: f64,
    pub(super) right: Option<[f64; 2]>,
}

impl Seen {
    pub(super) fn rows(&self) -> usize {
        if self.right.is_some() { 3 } else { 2 }
    }
}

pub(super) struct Lens {
    f: [f64; 2],
    c: [f64; 2],
    bf: f64,
}

impl Lens {
    pub(super) fn of(case: Given<'_>) -> Self {
        let n = |name| case.number(name);
        Self {
            f: [n("fx"), n("fy")],
            c: [n("cx"), n("cy")],
            bf: n("bf"),
        }
    }
}

/// Rodrigues' formula, by its series where the angle is small.
pub(super) fn turn(w: &Vector3<f64>) -> Matrix3<f64> {
    let angle2 = w.norm_squared();
    let (a, b) = match angle2 < 1e-4 {
        true => (
            1.0 - angle2 / 6.0 * (1.0 - angle2 / 20.0),
            0.5 - angle2 / 24.0 * (1.0 - angle2 / 30.0),
        ),
        false => {
            let (sin, cos) = garad_core::Real::sin_cos(angle2.sqrt());
            (sin / angle2.sqrt(), (1.0 - cos) / angle2)
        }
    };
    let k = w.cross_matrix();
    Matrix3::identity() + k * a + k * k * b
}

/// Residual of three rows, the third 0 without depth, and its derivative by the point in the camera.
pub(super) fn residual(
    lens: &Lens,
    p: &Vector3<f64>,
    seen: &Seen,
    how: &How,
) -> (Vector3<f64>, Matrix3<f64>) {
    let (iz, [fx, fy]) = (1.0 / p.z, lens.f);
    let fy = if how.is(Fault::FxForFy) { fx } else { fy };
    let (u, v) = (fx * p.x * iz + lens.c[0], fy * p.y * iz + lens.c[1]);
    let mut r = Vector3::new(u - seen.uv.x, v - seen.uv.y, 0.0);
    let mut j = Matrix3::new(
        fx * iz,
        0.0,
        -fx * p.x * iz * iz, //
        0.0,
        fy * iz,
        -fy * p.y * iz * iz, //
        0.0,
        0.0,
        0.0,
    );
    if how.is(Fault::NormalisedForPixels) {
        r = Vector3::new(p.x * iz - seen.uv.x, p.y * iz - seen.uv.y, 0.0);
    }
    let sigma = match how.fault {
        Some(Fault::SigmaForgotten) => 1.0,
        Some(Fault::SigmaSquared) => seen.sigma * seen.sigma,
        _ => seen.sigma,
    };
    let mut sigmas = [sigma, sigma, 1.0];
    if let Some([u_right, sigma_right]) = seen.right {
        let sign = if how.is(Fault::RightOnTheLeft) {
            -1.0
        } else {
            1.0
        };
        r.z = u - sign * lens.bf * iz - u_right;
        let slope = j[(0, 2)] + sign * lens.bf * iz * iz;
        j.set_row(2, &nalgebra::RowVector3::new(fx * iz, 0.0, slope));
        sigmas[2] = sigma_right;
    }
    for (row, sigma) in sigmas.into_iter().enumerate() {
        r[row] /= sigma;
        j.row_mut(row).unscale_mut(sigma);
    }
    (r, j)
}

/// By a pose that is moved on the left, translation first.
pub(super) fn by_pose(
    j: &Matrix3<f64>,
    pose: &Pose,
    p_world: &Vector3<f64>,
    how: &How,
) -> SMatrix<f64, 3, 6> {
    let p = pose.rotation * p_world + pose.shift;
    let (shift, rotation) = match how.fault {
        Some(Fault::PerturbedOnTheRight) => (
            j * pose.rotation,
            -j * pose.rotation * p_world.cross_matrix(),
        ),
        Some(Fault::RotationSign) => (*j, j * p.cross_matrix()),
        Some(Fault::ShiftNotTurned) => (*j, -j * (pose.rotation * p_world).cross_matrix()),
        _ => (*j, -j * p.cross_matrix()),
    };
    let parts = match how.is(Fault::RotationFirst) {
        true => [rotation, shift],
        false => [shift, rotation],
    };
    SMatrix::from_fn(|i, k| parts[k / 3][(i, k % 3)])
}

pub(super) fn vectors(values: &[f64]) -> Vec<Vector3<f64>> {
    values.chunks(3).map(Vector3::from_column_slice).collect()
}

pub(super) fn observations(case: Given<'_>, of: &[usize]) -> Vec<Seen> {
    let (uv, sigma) = (case.reals("uv"), case.reals("sigma"));
    let right = case.reals("right");
    let one = |i: usize| Seen {
        pose: of[2 * i],
        point: of[2 * i + 1],
        uv: Vector2::new(uv[2 * i], uv[2 * i + 1]),
        sigma: sigma[i],
        right: (right[2 * i].is_finite()).then(|| [right[2 * i], right[2 * i + 1]]),
    };
    (0..sigma.len()).map(one).collect()
}

pub(super) fn reprojection(case: Given<'_>, how: &How, out: &mut Outputs) {
    let lens = Lens::of(case);
    let input = |name: &str| vectors(&case.reals(name));
    let (phi, t, p_world) = (input("phi"), input("t"), input("p_world"));
    let own: Vec<usize> = (0..phi.len()).flat_map(|i| [i, i]).collect();
    let [mut residuals, mut poses, mut points] = [const { Vec::<f64>::new() }; 3];
    for (i, seen) in observations(case, &own).iter().enumerate() {
        let pose = Pose {
            rotation: turn(&phi[i]),
            shift: t[i],
        };
        let (r, j) = residual(&lens, &(pose.rotation * p_world[i] + pose.shift), seen, how);
        residuals.extend(r.iter());
        poses.extend(by_pose(&j, &pose, &p_world[i], how).transpose().iter());
        let slope = match how.is(Fault::PointNotTurned) {
            true => j,
            false => j * pose.rotation,
        };
        points.extend(slope.fixed_rows::<2>(0).transpose().iter());
    }
    out.put("residual", residuals);
    out.put("by_pose", poses);
    out.put("by_point", points);
}
