//! The smaller stages, with their faults and orders of summation.

use garad_conformance::Outputs;
use garad_core::Real;

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

fn triples(case: Given<'_>, name: &str) -> Vec<[f64; 3]> {
    case.reals(name).as_chunks::<3>().0.to_vec()
}

fn pairs(case: Given<'_>, name: &str) -> Vec<[f64; 2]> {
    case.reals(name).as_chunks::<2>().0.to_vec()
}

/// Both faults replace one output by a product with another of garad's own.
pub(super) fn se3(case: Given<'_>, how: &How, out: &mut Outputs) {
    let rhos = triples(case, "rho");
    if how.is(Fault::Se3LinearPartUnchanged) {
        out.put("log_translation", rhos.iter().copied());
    }
    if how.is(Fault::Se3RotationForJacobian) {
        // Below so small an angle the rotation stands in for the Jacobian.
        let of = |name: &str| out.tensors()[name].f64();
        let by = |name: &str| of(name).chunks(9).map(matrix).collect::<Vec<_>>();
        let (r, j, phi) = (by("rotation"), by("jacobian"), triples(case, "phi"));
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
    let bent = pairs(case, "pixels").into_iter().map(|[u, v]| {
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
    for (a, b) in pairs(case, "uv1").iter().zip(pairs(case, "uv2")) {
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

/// Both kernels of all pairs, row by row.
fn kernels(case: Given<'_>, how: &How) -> [Vec<f64>; 2] {
    let (reproj, seen) = (case.reals("reproj_px"), case.reals("observations"));
    let (p, uv) = (triples(case, "p_world"), pairs(case, "uv_px"));
    let sigma = |name: &str| {
        let s = case.number(name);
        if how.is(Fault::KernelWithoutHalf) {
            s * s
        } else {
            2.0 * s * s
        }
    };
    let terms = case.word("terms");
    let linear = case.word("distance") == "linear";
    let kernel = |x: f64| if x.is_nan() { 0.0 } else { Real::exp(-x) };
    let (mut k1, mut k2) = (Vec::new(), Vec::new());
    for i in 0..p.len() {
        for j in 0..p.len() {
            let square = |a: f64| a * a;
            let first = square(reproj[i] - reproj[j]) / sigma("sigma_reproj_px")
                + square(seen[i] - seen[j]) / sigma("sigma_observations");
            k1.push(kernel(first));
            let differences = [0, 1, 2].map(|k| square(p[i][k] - p[j][k]));
            let mut space = how.sum.of(&differences);
            let mut pixel = square(uv[i][0] - uv[j][0]) + square(uv[i][1] - uv[j][1]);
            match terms {
                "both" if pixel.is_nan() => pixel = 0.0,
                "space" => pixel = 0.0,
                "pixel" => space = 0.0,
                _ => {}
            }
            if linear {
                (space, pixel) = (space.sqrt(), pixel.sqrt());
            }
            k2.push(kernel(space / sigma("sigma_m") + pixel / sigma("sigma_px")));
        }
    }
    [k1, k2]
}

pub(super) fn kernel(case: Given<'_>, how: &How, out: &mut Outputs) {
    let [k1, k2] = kernels(case, how);
    out.put("k1", k1);
    out.put("k2", k2);
}

pub(super) fn mean_field(case: Given<'_>, how: &How, out: &mut Outputs) {
    let u = case.reals("log_odds");
    let n = u.len();
    let mut coupling = vec![0.0; n * n];
    let weights = ["feature_weight", "position_weight"].map(|w| case.number(w));
    for (mut k, weight) in kernels(case, how).into_iter().zip(weights) {
        if !case.switch("self_message") {
            (0..n).for_each(|i| k[i * n + i] = 0.0);
        }
        let sums: Vec<f64> = k.chunks(n).map(|row| how.sum.of(row)).collect();
        let inverse: Vec<f64> = sums
            .iter()
            .map(|s| if *s > 0.0 { 1.0 / s } else { 0.0 })
            .collect();
        let kind = match (
            case.word("normalisation"),
            how.is(Fault::FieldNormalisedOtherwise),
        ) {
            ("rows", true) => "symmetric",
            ("symmetric", true) => "rows",
            (kind, _) => kind,
        };
        for i in 0..n {
            for j in 0..n {
                let norm = match kind {
                    "rows" => inverse[i],
                    "symmetric" => (inverse[i] * inverse[j]).sqrt(),
                    _ => 1.0,
                };
                coupling[i * n + j] += weight * k[i * n + j] * norm;
            }
        }
    }
    let sign = if how.is(Fault::FieldPushes) {
        -1.0
    } else {
        1.0
    };
    let sigmoid = |x: f64| {
        let e = Real::exp(-x.abs());
        (if x >= 0.0 { 1.0 } else { e }) / (1.0 + e)
    };
    let counts: Vec<usize> = case
        .word("iterations")
        .split(' ')
        .map(|c| c.parse().expect("a count"))
        .collect();
    let damping = case.number("damping");
    let mut q: Vec<f64> = u.iter().map(|v| sigmoid(*v)).collect();
    let (mut answers, mut done) = (Vec::new(), 0);
    for count in counts {
        let until = match how.is(Fault::FieldOneIterationLess) {
            true => count.saturating_sub(1),
            false => count,
        };
        while done < until {
            q = (0..n)
                .map(|i| {
                    let heard: Vec<f64> = (0..n)
                        .map(|j| coupling[i * n + j] * (2.0 * q[j] - 1.0))
                        .collect();
                    let new = sigmoid(u[i] + sign * how.sum.of(&heard));
                    (1.0 - damping) * new + damping * q[i]
                })
                .collect();
            done += 1;
        }
        answers.extend_from_slice(&q);
    }
    out.put("q", answers);
    out.put("labels", q.iter().map(|q| *q > 0.5));
}

/// The window of SSIM: its weights from the middle out.
fn window(how: &How) -> Vec<f64> {
    let taps: i32 = if how.is(Fault::SsimThirteenTaps) {
        6
    } else {
        5
    };
    let weight = |d: i32| match how.is(Fault::SsimFlatWindow) {
        true => 1.0,
        false => Real::exp(-f64::from(d * d) / (2.0 * 1.5 * 1.5)),
    };
    let all: Vec<f64> = (-taps..=taps).map(weight).collect();
    let sum = how.sum.of(&all);
    all.iter().map(|w| w / sum).collect()
}

/// Smoothed along both axes, zeros outside.
fn smooth(a: &[f64], (width, height): (usize, usize), how: &How) -> Vec<f64> {
    let w = window(how);
    let half = (w.len() / 2).cast_signed();
    let along = |a: &[f64], axis: usize| -> Vec<f64> {
        let n = [width, height][axis].cast_signed();
        let at = |i: isize| match how.is(Fault::SsimReflects) {
            true if n > 1 => {
                let period = 2 * (n - 1);
                let i = i.rem_euclid(period);
                Some(if i < n { i } else { period - i })
            }
            _ => (0..n).contains(&i).then_some(i),
        };
        (0..width * height)
            .map(|k| {
                let place = [k % width, k / width][axis].cast_signed();
                let step = [1, width][axis];
                let base = k - place.cast_unsigned() * step;
                let terms: Vec<f64> = (-half..=half)
                    .map(|d| {
                        let value =
                            at(place + d).map_or(0.0, |i| a[base + i.cast_unsigned() * step]);
                        w[(d + half).cast_unsigned()] * value
                    })
                    .collect();
                how.sum.of(&terms)
            })
            .collect()
    };
    match how.sum {
        Sum::Forwards => along(&along(a, 0), 1),
        _ => along(&along(a, 1), 0),
    }
}

pub(super) fn losses(case: Given<'_>, how: &How, out: &mut Outputs) {
    let kind = case.word("loss");
    if !["ssim", "photometric"].contains(&kind) {
        return;
    }
    let shape = case.tensor("rendered").shape();
    let size = (shape[1], shape[0]);
    let (x, y) = (case.reals("rendered"), case.reals("target"));
    let keep: Vec<bool> = match case.get("excluded") {
        Some(mask) => mask.f64().iter().map(|v| *v <= 0.0).collect(),
        None => vec![true; size.0 * size.1],
    };
    let scale = if how.is(Fault::SsimConstantsOfBytes) {
        255.0 * 255.0
    } else {
        1.0
    };
    let (c1, c2) = (1e-4 * scale, 9e-4 * scale);
    let (mut similar, mut apart) = (Vec::new(), Vec::new());
    for c in 0..3 {
        let b: Vec<f64> = y.iter().skip(c).step_by(3).copied().collect();
        let a = x.iter().skip(c).step_by(3).zip(&b).zip(&keep);
        let a: Vec<f64> = a
            .map(|((a, b), keep)| if *keep { *a } else { *b })
            .collect();
        let product =
            |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).collect::<Vec<_>>();
        let of = |v: &[f64]| smooth(v, size, how);
        let (ma, mb) = (of(&a), of(&b));
        let (aa, bb, ab) = (
            of(&product(&a, &a)),
            of(&product(&b, &b)),
            of(&product(&a, &b)),
        );
        for k in (0..a.len()).filter(|&k| keep[k]) {
            let (va, vb) = (aa[k] - ma[k] * ma[k], bb[k] - mb[k] * mb[k]);
            let both = ab[k] - ma[k] * mb[k];
            let above = (2.0 * ma[k] * mb[k] + c1) * (2.0 * both + c2);
            similar.push(above / ((ma[k] * ma[k] + mb[k] * mb[k] + c1) * (va + vb + c2)));
            apart.push((a[k] - b[k]).abs());
        }
    }
    let mean = |v: &[f64]| how.sum.of(v) / v.len() as f64;
    let value = match kind {
        "ssim" => mean(&similar),
        _ => {
            let lambda = case.number("lambda");
            (1.0 - lambda) * mean(&apart) + lambda * (1.0 - mean(&similar))
        }
    };
    out.put("value", [value]);
}

/// Every number by itself; a row that is not there has no moments.
pub(super) fn adam(case: Given<'_>, how: &How, out: &mut Outputs) {
    let [b1, b2, eps] = ["beta1", "beta2", "eps"].map(|n| case.number(n));
    let (start, rates) = (case.reals("start"), case.reals("learning_rates"));
    let gradients = case.reals("gradients");
    let n = start.len();
    let kept = case.get("kept").map(|k| k.f64());
    let change = kept
        .as_ref()
        .map_or(usize::MAX, |_| case.count("change_after"));
    let (mut x, mut m, mut v) = (start, vec![0.0; n], vec![0.0; n]);
    let mut path = Vec::new();
    let (mut power1, mut power2) = (1.0, 1.0);
    for (t, rate) in rates.iter().enumerate() {
        (power1, power2) = (power1 * b1, power2 * b2);
        let (mut c1, mut c2) = (1.0 - power1, 1.0 - power2);
        match how.fault {
            Some(Fault::AdamConstantCorrection) => (c1, c2) = (1.0 - b1, 1.0 - b2),
            Some(Fault::AdamNoCorrection) => (c1, c2) = (1.0, 1.0),
            _ => {}
        }
        for i in 0..n {
            let there = match &kept {
                Some(kept) if i < kept.len() => t < change || kept[i] > 0.0,
                Some(_) => t >= change,
                None => true,
            };
            if !there {
                path.push(f64::NAN);
                continue;
            }
            let g = gradients[t * n + i];
            match how.sum {
                Sum::Forwards => {
                    m[i] = b1 * m[i] + (1.0 - b1) * g;
                    v[i] = b2 * v[i] + (1.0 - b2) * g * g;
                }
                _ => {
                    m[i] += (1.0 - b1) * (g - m[i]);
                    v[i] += (1.0 - b2) * (g * g - v[i]);
                }
            }
            let below = match how.fault {
                Some(Fault::AdamEpsilonInRoot) => (v[i] / c2 + eps).sqrt(),
                Some(Fault::AdamEpsilonScaled) => (v[i].sqrt() + eps) / c2.sqrt(),
                _ if how.sum == Sum::Tree => v[i].sqrt() / c2.sqrt() + eps,
                _ => (v[i] / c2).sqrt() + eps,
            };
            x[i] -= rate * (m[i] / c1) / below;
            path.push(x[i]);
        }
    }
    out.put("path", path);
}
