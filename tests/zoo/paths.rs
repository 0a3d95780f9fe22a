//! Trajectories laid over each other and judged, and the window of labels, a second time, with their faults.

use garad_conformance::Outputs;
use nalgebra::{Matrix3, Vector3};

use super::answers::Given;
use super::second::{Fault, How};

/// x ↦ s R x + t.
struct Motion {
    rotation: Matrix3<f64>,
    shift: Vector3<f64>,
    scale: f64,
}

/// Umeyama's closed form.
fn align(from: &[Vector3<f64>], to: &[Vector3<f64>], scaled: bool, how: &How) -> Motion {
    let n = from.len() as f64;
    let mean = |all: &[Vector3<f64>]| {
        let axis = |k: usize| how.sum.of(&all.iter().map(|p| p[k]).collect::<Vec<_>>()) / n;
        Vector3::from_fn(|k, _| axis(k))
    };
    let (middle, target) = (mean(from), mean(to));
    let pairs = || from.iter().zip(to).map(|(f, t)| (f - middle, t - target));
    let entry = |i: usize, j: usize| {
        how.sum
            .of(&pairs().map(|(f, t)| t[i] * f[j]).collect::<Vec<_>>())
    };
    let m = Matrix3::from_fn(entry);
    let svd = m.svd(true, true);
    let (u, v) = (svd.u.expect("asked"), svd.v_t.expect("asked"));
    let v = if how.is(Fault::AlignTransposed) {
        v.transpose()
    } else {
        v
    };
    let sign = match how.is(Fault::AlignMirrored) {
        true => 1.0,
        false => (u * v).determinant().signum(),
    };
    let mut rotation = u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v;
    if how.fault.is_none() {
        rotation = polished(rotation, &m);
    }
    let spread = |side: fn(&(Vector3<f64>, Vector3<f64>)) -> f64| {
        how.sum.of(&pairs().map(|p| side(&p)).collect::<Vec<_>>())
    };
    let variance = match how.is(Fault::AlignSpreadOfTarget) {
        true => spread(|(_, t)| t.norm_squared()),
        false => spread(|(f, _)| f.norm_squared()),
    };
    let scaled = match how.fault {
        Some(Fault::AlignScaledUnasked) => true,
        Some(Fault::AlignNeverScaled) => false,
        _ => scaled,
    };
    let scale = if scaled {
        (rotation.transpose() * m).trace() / variance
    } else {
        1.0
    };
    let shift = match how.fault {
        Some(Fault::AlignShiftUnscaled) => target - rotation * middle,
        Some(Fault::AlignShiftBackwards) => middle - rotation * target * scale,
        _ => target - rotation * middle * scale,
    };
    Motion {
        rotation,
        shift,
        scale,
    }
}

/// Rotations are compared to a few roundings, and a decomposition loses more. At the best R the matrix Rᵀ M is
/// symmetric; Newton's steps bring R there.
fn polished(mut rotation: Matrix3<f64>, m: &Matrix3<f64>) -> Matrix3<f64> {
    for _ in 0..4 {
        let s = rotation.transpose() * m;
        let skew = Vector3::new(
            s[(2, 1)] - s[(1, 2)],
            s[(0, 2)] - s[(2, 0)],
            s[(1, 0)] - s[(0, 1)],
        );
        let symmetric = (s + s.transpose()) * 0.5;
        let slope = Matrix3::identity() * symmetric.trace() - symmetric;
        let Some(inverse) = slope.try_inverse() else {
            break;
        };
        let w = inverse * skew;
        let turned = rotation + rotation * w.cross_matrix();
        // Back to a rotation: one step of Newton's towards the polar factor.
        rotation = turned * 1.5 - turned * turned.transpose() * turned * 0.5;
    }
    rotation
}

fn points(values: &[f64], stride: usize) -> Vec<Vector3<f64>> {
    let rows = values.chunks(stride);
    rows.map(|r| Vector3::new(r[0], r[1], r[2])).collect()
}

fn put_motion(out: &mut Outputs, name: &str, motion: &Motion) {
    let rows = motion.rotation.transpose();
    out.put(&format!("{name}_rotation"), rows.iter().copied());
    out.put(&format!("{name}_translation"), motion.shift.iter().copied());
    out.put(&format!("{name}_scale"), [motion.scale]);
}

fn summary(errors: &[f64], how: &How) -> [f64; 7] {
    let n = errors.len() as f64;
    let sse = how
        .sum
        .of(&errors.iter().map(|e| e * e).collect::<Vec<_>>());
    let mean = how.sum.of(errors) / n;
    let apart = how.sum.of(&errors
        .iter()
        .map(|e| (e - mean) * (e - mean))
        .collect::<Vec<_>>());
    let mut sorted = errors.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rmse = match how.fault {
        Some(Fault::AteMeanForRmse) => mean,
        Some(Fault::AteRootOverCount) => sse.sqrt() / n,
        _ => (sse / n).sqrt(),
    };
    let median = match how.is(Fault::AteUpperMedian) {
        true => sorted[errors.len() / 2],
        false => 0.5 * (sorted[(errors.len() - 1) / 2] + sorted[errors.len() / 2]),
    };
    let degrees = if how.is(Fault::AteSampleDeviation) {
        n - 1.0
    } else {
        n
    };
    let (least, most) = (sorted[0], sorted[errors.len() - 1]);
    [
        rmse,
        mean,
        median,
        (apart / degrees).sqrt(),
        least,
        most,
        sse,
    ]
}

/// Alignment and absolute errors; pairs and relative errors are garad's own.
pub(super) fn trajectory(case: Given<'_>, how: &How, out: &mut Outputs) {
    let ways = [("rigid", false), ("similarity", true)];
    if case.word("kind") == "alignment" {
        let of = |name: &str| points(&case.reals(name), 3);
        for (name, scaled) in ways {
            put_motion(out, name, &align(&of("from"), &of("to"), scaled, how));
        }
        return;
    }
    let (truth, estimate) = (
        points(&case.reals("truth"), 7),
        points(&case.reals("estimate"), 7),
    );
    let (truth_t, estimate_t) = (case.reals("truth_t"), case.reals("estimate_t"));
    let times = out.tensors()["pair_times"].f64();
    let index = |all: &[f64], t: f64| all.iter().position(|other| other.total_cmp(&t).is_eq());
    let mut pairs: Vec<(usize, usize)> = times
        .chunks(2)
        .map(|t| {
            let pair = index(&truth_t, t[0]).zip(index(&estimate_t, t[1]));
            pair.expect("times of the case")
        })
        .collect();
    if how.is(Fault::PairsByIndex) {
        pairs = (0..truth.len().min(estimate.len()))
            .map(|i| (i, i))
            .collect();
        out.put("pairs", [pairs.len()]);
        let times = pairs.iter().map(|&(g, e)| [truth_t[g], estimate_t[e]]);
        out.put("pair_times", times);
    }
    let to: Vec<_> = pairs.iter().map(|p| truth[p.0]).collect();
    let from: Vec<_> = pairs.iter().map(|p| estimate[p.1]).collect();
    let rest = Motion {
        rotation: Matrix3::identity(),
        shift: Vector3::zeros(),
        scale: 1.0,
    };
    let all = ways.map(|(name, scaled)| (name, align(&from, &to, scaled, how)));
    for (name, motion) in all.into_iter().chain([("none", rest)]) {
        let apart = |(f, t): (&Vector3<f64>, &Vector3<f64>)| {
            (t - (motion.rotation * f * motion.scale + motion.shift)).norm()
        };
        let errors: Vec<f64> = from.iter().zip(&to).map(apart).collect();
        out.put(&format!("{name}_ate"), summary(&errors, how));
        out.put(&format!("{name}_errors"), errors);
        if name != "none" {
            put_motion(out, name, &motion);
        }
    }
}

/// Eq. 7, in both readings.
pub(super) fn label_window(case: Given<'_>, how: &How, out: &mut Outputs) {
    let labels = case.tensor("labels").u8();
    let runs = case.count("runs");
    let literal = match how.is(Fault::WindowOtherReading) {
        true => case.word("reading") != "literal",
        false => case.word("reading") == "literal",
    };
    let length = match how.fault {
        Some(Fault::WindowOneShort) => runs - 1 + usize::from(literal),
        Some(Fault::WindowOneLong) => runs + 1 + usize::from(literal),
        _ => runs + usize::from(literal),
    };
    let at_rest = u8::from(how.is(Fault::WindowCountsDynamic));
    let (mut scores, mut removed) = (Vec::new(), Vec::new());
    for now in 1..=labels.len() {
        let full = now >= length || how.is(Fault::WindowNotYetFull);
        let window = match how.is(Fault::WindowNeverSlides) {
            true => &labels[..now.min(length)],
            false => &labels[now.saturating_sub(length)..now],
        };
        let still = window.iter().filter(|l| **l == at_rest).count();
        let share = still as f64 / runs as f64;
        if full {
            scores.push(if literal { 1.0 - share } else { share });
        }
        let gone = match literal {
            true => still == runs,
            false => still == 0,
        };
        removed.push(full && gone);
    }
    out.put("score", scores);
    out.put("removed", removed);
}
