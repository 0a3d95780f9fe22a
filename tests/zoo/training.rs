//! SSIM and Adam, a second time, with their faults.

use garad_conformance::Outputs;
use garad_core::Real;

use super::answers::Given;
use super::second::{Fault, How, Sum};

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
