//! Poses, cameras, two views and robust kernels, a second time, with their faults.

use garad_conformance::Outputs;

use super::answers::Given;
use super::second::{Fault, How, Sum};

type M3 = [[f64; 3]; 3];

fn times(a: &M3, b: &M3) -> M3 {
    [0, 1, 2].map(|i| [0, 1, 2].map(|j| a[i][0] * b[0][j] + a[i][1] * b[1][j] + a[i][2] * b[2][j]))
}

fn transposed(m: &M3) -> M3 {
    [0, 1, 2].map(|i| [m[0][i], m[1][i], m[2][i]])
}

fn apply(m: &M3, v: &[f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i| m[i][0] * v[0] + m[i][1] * v[1] + m[i][2] * v[2])
}

fn matrix(values: &[f64]) -> M3 {
    [0, 1, 2].map(|i| [values[3 * i], values[3 * i + 1], values[3 * i + 2]])
}

fn hat(v: &[f64]) -> M3 {
    [[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]]
}

/// Both faults replace one output by a product with another of garad's own.
pub(super) fn se3(case: Given<'_>, how: &How, out: &mut Outputs) {
    let rhos = case.rows::<3>("rho");
    if how.is(Fault::Se3LinearPartUnchanged) {
        out.put("log_translation", rhos.iter().copied());
    }
    if how.is(Fault::Se3RotationForJacobian) {
        // Below so small an angle the rotation stands in for the Jacobian.
        let of = |name: &str| out.tensors()[name].f64();
        let by = |name: &str| of(name).chunks(9).map(matrix).collect::<Vec<_>>();
        let (r, j, phi) = (by("rotation"), by("jacobian"), case.rows::<3>("phi"));
        let moved = (0..rhos.len()).map(|i| {
            let small = phi[i].iter().map(|v| v * v).sum::<f64>() < 1e-10;
            apply(if small { &r[i] } else { &j[i] }, &rhos[i])
        });
        out.put("translation", moved.collect::<Vec<_>>());
    }
}

pub(super) fn camera(case: Given<'_>, how: &How, out: &mut Outputs) {
    let n = |name| case.number(name);
    let [k1, k2, mut p1, mut p2, mut k3] = ["k1", "k2", "p1", "p2", "k3"].map(n);
    match how.fault {
        Some(Fault::CameraTangentialSwapped) => (p1, p2) = (p2, p1),
        Some(Fault::CameraTangentialFlipped) => p1 = -p1,
        Some(Fault::CameraRadialFirst) => (k3, p1, p2) = (p1, p2, k3),
        _ => {}
    }
    let bent = case.rows::<2>("pixels").into_iter().map(|[u, v]| {
        let (x, y) = ((u - n("cx")) / n("fx"), (v - n("cy")) / n("fy"));
        let mut r2 = x * x + y * y;
        let radial = match how.sum {
            Sum::Forwards => 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)),
            _ => how.sum.of(&[1.0, k1 * r2, k2 * r2 * r2, k3 * r2 * r2 * r2]),
        };
        let (mut tx, mut ty) = (x, y);
        if how.is(Fault::CameraRadiusUpdated) {
            (tx, ty) = (x * radial, y * radial);
            r2 = tx * tx + ty * ty;
        }
        let dx = 2.0 * p1 * tx * ty + p2 * (r2 + 2.0 * tx * tx);
        let dy = match how.is(Fault::CameraKalibr) {
            true => 2.0 * p1 * tx * ty + p2 * (r2 + 2.0 * ty * ty),
            false => 2.0 * p2 * tx * ty + p1 * (r2 + 2.0 * ty * ty),
        };
        let (x, y) = (x * radial + dx, y * radial + dy);
        [n("fx") * x + n("cx"), n("fy") * y + n("cy")]
    });
    out.put("distorted", bent);
}

pub(super) fn epipolar(case: Given<'_>, how: &How, out: &mut Outputs) {
    let k = case.reals("intrinsics");
    let inverse = [
        [1.0 / k[0], 0.0, -k[2] / k[0]],
        [0.0, 1.0 / k[1], -k[3] / k[1]],
        [0.0, 0.0, 1.0],
    ];
    let calibration = [[k[0], 0.0, k[2]], [0.0, k[1], k[3]], [0.0, 0.0, 1.0]];
    let r = matrix(&case.reals("rotation"));
    let t = hat(&case.reals("translation"));
    let essential = match how.is(Fault::EpipolarOrder) {
        true => times(&r, &t),
        false => times(&t, &r),
    };
    let right = match how.is(Fault::EpipolarCalibrationTransposed) {
        true => transposed(&calibration),
        false => inverse,
    };
    let f = times(&times(&transposed(&inverse), &essential), &right);
    let flat = f.as_flattened();
    let norm = how
        .sum
        .of(&flat.iter().map(|v| v * v).collect::<Vec<_>>())
        .sqrt();
    let largest = flat
        .iter()
        .fold(0.0f64, |a, b| if b.abs() > a.abs() { *b } else { a });
    let scale = largest.signum() / norm;
    out.put("fundamental", flat.iter().map(|v| v * scale));
    let [mut in_1, mut in_2, mut sampson] = [const { Vec::new() }; 3];
    let other = transposed(&f);
    for (a, b) in case.rows::<2>("uv1").iter().zip(case.rows::<2>("uv2")) {
        let (p, q) = ([a[0], a[1], 1.0], [b[0], b[1], 1.0]);
        let (l2, l1) = (apply(&f, &p), apply(&other, &q));
        let e = how.sum.of(&[q[0] * l2[0], q[1] * l2[1], l2[2]]);
        let (n1, n2) = (l1[0] * l1[0] + l1[1] * l1[1], l2[0] * l2[0] + l2[1] * l2[1]);
        in_1.push(e.abs() / n1.sqrt());
        in_2.push(e.abs() / n2.sqrt());
        sampson.push(e * e / (n1 + n2));
    }
    out.put("distance_in_1", in_1);
    out.put("distance_in_2", in_2);
    out.put("sampson", sampson);
}

/// Huber's kernel alone; the others are not touched.
pub(super) fn robust(case: Given<'_>, how: &How, out: &mut Outputs) {
    if case.word("kernel") != "huber" {
        return;
    }
    let delta = case.number("scale");
    let s = case.reals("s");
    let delta = if how.is(Fault::HuberKneeNotSquared) {
        delta.sqrt()
    } else {
        delta
    };
    let inside = |s: f64| s <= delta * delta;
    let constant = if how.is(Fault::HuberWithoutConstant) {
        0.0
    } else {
        delta * delta
    };
    let rho = s.iter().map(|&s| match how.sum {
        _ if inside(s) => s,
        Sum::Forwards => 2.0 * delta * s.sqrt() - constant,
        _ => delta * (2.0 * s.sqrt() - constant / delta),
    });
    let half = if how.is(Fault::HuberHalfWeight) {
        0.5
    } else {
        1.0
    };
    let weight = s.iter().map(|&s| {
        if inside(s) {
            1.0
        } else {
            half * delta / s.sqrt()
        }
    });
    out.put("rho", rho);
    out.put("weight", weight);
}
