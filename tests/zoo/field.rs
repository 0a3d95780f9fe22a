//! Kernels and the mean field, a second time, with their faults.

use garad_conformance::Outputs;
use garad_core::Real;

use super::answers::Given;
use super::second::{Fault, How};

/// Both kernels of all pairs, row by row.
fn kernels(case: Given<'_>, how: &How) -> [Vec<f64>; 2] {
    let (reproj, seen) = (case.reals("reproj_px"), case.reals("observations"));
    let (p, uv) = (case.rows::<3>("p_world"), case.rows::<2>("uv_px"));
    let sigma = |name: &str| {
        let s = case.number(name);
        match how.fault {
            Some(Fault::KernelWithoutHalf) => s * s,
            Some(Fault::KernelSigmaNotSquared) => 2.0 * s,
            _ => 2.0 * s * s,
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
            let mut next = q.clone();
            for i in 0..n {
                let read = if how.is(Fault::FieldInPlace) {
                    &next
                } else {
                    &q
                };
                let message = |q: f64| match how.is(Fault::FieldUnsigned) {
                    true => q,
                    false => 2.0 * q - 1.0,
                };
                let heard: Vec<f64> = (0..n)
                    .map(|j| coupling[i * n + j] * message(read[j]))
                    .collect();
                let new = sigmoid(u[i] + sign * how.sum.of(&heard));
                next[i] = (1.0 - damping) * new + damping * q[i];
            }
            q = next;
            done += 1;
        }
        answers.extend_from_slice(&q);
    }
    out.put("q", answers);
    out.put("labels", q.iter().map(|q| *q > 0.5));
}
