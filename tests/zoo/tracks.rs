//! Pyramidal Lucas-Kanade, written a second time pixel by pixel, with its faults.

use garad_conformance::Outputs;

use super::answers::Given;
use super::second::{Fault, How};

/// A level of the pyramid: whole grey levels.
struct Level {
    width: isize,
    height: isize,
    grey: Vec<i64>,
}

/// Reflected without repeating the edge.
fn mirrored(i: isize, n: isize) -> isize {
    let i = i.rem_euclid(2 * (n - 1));
    if i < n { i } else { 2 * (n - 1) - i }
}

impl Level {
    fn at(&self, x: isize, y: isize, how: &How) -> i64 {
        let (x, y) = match how.is(Fault::LkBorderRepeats) {
            true => (x.clamp(0, self.width - 1), y.clamp(0, self.height - 1)),
            false => (mirrored(x, self.width), mirrored(y, self.height)),
        };
        self.grey[(y * self.width + x).cast_unsigned()]
    }

    /// Taps 1 4 6 4 1 each way, rounded once, every second pixel.
    fn half(&self) -> Self {
        let (width, height) = ((self.width + 1) / 2, (self.height + 1) / 2);
        let taps = [1, 4, 6, 4, 1];
        let at = |x: isize, y: isize| {
            let (x, y) = (mirrored(x, self.width), mirrored(y, self.height));
            self.grey[(y * self.width + x).cast_unsigned()]
        };
        let pixel = |x: isize, y: isize| {
            let mut sum = 128;
            for (dy, b) in (-2..).zip(taps) {
                for (dx, a) in (-2..).zip(taps) {
                    sum += a * b * at(2 * x + dx, 2 * y + dy);
                }
            }
            sum >> 8
        };
        let grey = (0..height).flat_map(|y| (0..width).map(move |x| pixel(x, y)));
        let grey = grey.collect();
        Self {
            width,
            height,
            grey,
        }
    }

    /// 32 times the slope: Scharr's, or what stands for it.
    fn slope(&self, x: isize, y: isize, how: &How) -> [i64; 2] {
        if !(0..self.width).contains(&x) || !(0..self.height).contains(&y) {
            return [0, 0];
        }
        let (side, middle) = match how.fault {
            Some(Fault::LkSobel) => (1, 2),
            Some(Fault::LkPlainDifferences) => (0, 16),
            _ => (3, 10),
        };
        let weights = [side, middle, side];
        let (mut dx, mut dy) = (0, 0);
        for (d, w) in (-1..).zip(weights) {
            dx += w * (self.at(x + 1, y + d, how) - self.at(x - 1, y + d, how));
            dy += w * (self.at(x + d, y + 1, how) - self.at(x + d, y - 1, how));
        }
        [dx, dy]
    }
}

fn levels(case: Given<'_>, name: &str) -> Vec<Level> {
    let tensor = case.tensor(name);
    let mut level = Level {
        width: tensor.shape()[1].cast_signed(),
        height: tensor.shape()[0].cast_signed(),
        grey: tensor.i64(),
    };
    let mut all = Vec::new();
    for _ in 0..case.count("levels") {
        let next = level.half();
        if next.width.min(next.height) <= 21 {
            break;
        }
        all.push(std::mem::replace(&mut level, next));
    }
    all.push(level);
    all
}

/// Upper left pixel of a window and the four weights, 14 bits; `None` if it lies outside.
#[allow(
    clippy::cast_possible_truncation,
    reason = "weights of 14 bits, corners near the image"
)]
fn place(corner: [f32; 2], level: &Level, how: &How) -> Option<(isize, isize, [i64; 4])> {
    let inside = |v: f32, n: isize| v >= -21.0 && v < n as f32;
    if !(inside(corner[0], level.width) && inside(corner[1], level.height)) {
        return None;
    }
    let whole = corner.map(f32::floor);
    let [a, b] = match how.is(Fault::LkWholePixels) {
        true => [0.0, 0.0],
        false => [corner[0] - whole[0], corner[1] - whole[1]],
    };
    let weight = |v: f32| (v * 16384.0).round_ties_even() as i64;
    let w = [
        weight((1.0 - a) * (1.0 - b)),
        weight(a * (1.0 - b)),
        weight((1.0 - a) * b),
    ];
    let rest = 16384 - w[0] - w[1] - w[2];
    Some((
        whole[0] as isize,
        whole[1] as isize,
        [w[0], w[1], w[2], rest],
    ))
}

struct Tracker<'a> {
    how: &'a How,
    side: isize,
}

impl Tracker<'_> {
    fn corner(&self, p: [f32; 2]) -> [f32; 2] {
        p.map(|v| v - (self.side - 1) as f32 / 2.0)
    }

    /// An image's window, weighted and rounded.
    fn window(
        &self,
        (x0, y0, w): (isize, isize, [i64; 4]),
        shift: u32,
        of: impl Fn(isize, isize) -> i64,
    ) -> Vec<i64> {
        let places = (y0..y0 + self.side).flat_map(|y| (x0..x0 + self.side).map(move |x| (x, y)));
        let sample = |(x, y)| {
            let upper = w[0] * of(x, y) + w[1] * of(x + 1, y);
            let lower = w[2] * of(x, y + 1) + w[3] * of(x + 1, y + 1);
            (upper + lower + (1 << (shift - 1))) >> shift
        };
        places.map(sample).collect()
    }

    fn dot(a: &[i64], b: &[i64]) -> f32 {
        let sum: i64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
        sum as f32 / 1_048_576.0
    }

    /// The new estimate, whether it stayed inside, and the first image's window. `None` if the level holds too
    /// little.
    fn follow(
        &self,
        [from, to]: [&Level; 2],
        point: [f32; 2],
        start: [f32; 2],
    ) -> Option<([f32; 2], bool, Vec<i64>)> {
        let how = self.how;
        let here = place(self.corner(point), from, how)?;
        let grey = self.window(here, 9, |x, y| from.at(x, y, how));
        let dx = self.window(here, 14, |x, y| from.slope(x, y, how)[0]);
        let dy = self.window(here, 14, |x, y| from.slope(x, y, how)[1]);
        let (gxx, gxy, gyy) = (
            Self::dot(&dx, &dx),
            Self::dot(&dx, &dy),
            Self::dot(&dy, &dy),
        );
        let determinant = gxx * gyy - gxy * gxy;
        let root = ((gxx - gyy) * (gxx - gyy) + 4.0 * gxy * gxy).sqrt();
        let least = (gyy + gxx - root) / (2 * self.side * self.side) as f32;
        let gate = match how.fault {
            Some(Fault::LkGateUnscaled) => 1e-4 / 1_048_576.0,
            Some(Fault::LkGateOfGreyLevels) => 1e-4 / 1024.0,
            _ => 1e-4,
        };
        if least < gate || determinant < f32::EPSILON {
            return None;
        }
        let (mut corner, mut estimate, mut before) = (self.corner(start), start, [0.0f32; 2]);
        let steps = if how.is(Fault::LkOneStep) { 1 } else { 30 };
        for step in 0..steps {
            let Some(there) = place(corner, to, how) else {
                return Some((estimate, false, grey));
            };
            let seen = self.window(there, 9, |x, y| to.at(x, y, how));
            let apart: Vec<i64> = seen.iter().zip(&grey).map(|(j, i)| j - i).collect();
            let (bx, by) = (Self::dot(&apart, &dx), Self::dot(&apart, &dy));
            let inverse = 1.0 / determinant;
            let mut delta = [
                (gxy * by - gyy * bx) * inverse,
                (gxy * bx - gxx * by) * inverse,
            ];
            if how.is(Fault::LkStepBackwards) {
                delta = delta.map(|d| -d);
            }
            corner = [corner[0] + delta[0], corner[1] + delta[1]];
            estimate = corner.map(|v| v + (self.side - 1) as f32 / 2.0);
            let [x, y] = delta.map(f64::from);
            if x * x + y * y <= 0.01 * 0.01 {
                break;
            }
            let undone = |i: usize| f64::from((delta[i] + before[i]).abs()) < 0.01;
            if step > 0 && undone(0) && undone(1) {
                estimate = [estimate[0] - 0.5 * delta[0], estimate[1] - 0.5 * delta[1]];
                break;
            }
            before = delta;
        }
        Some((estimate, true, grey))
    }
}

pub(super) fn lucas_kanade(case: Given<'_>, how: &How, out: &mut Outputs) {
    let (prev, next) = (levels(case, "prev"), levels(case, "next"));
    let side = match how.fault {
        Some(Fault::LkWindowOfTwenty) => 20,
        Some(Fault::LkWindowOfTwentyThree) => 23,
        _ => 21,
    };
    let tracker = Tracker { how, side };
    let points = case.tensor("points").f32();
    let points = points.as_chunks::<2>().0;
    let (mut status, mut found, mut residuals) = (Vec::new(), Vec::new(), Vec::new());
    for &point in points {
        let at = |level: usize| {
            let level = level + usize::from(how.is(Fault::LkLevelOffByOne));
            point.map(|v| v / (1u32 << level) as f32)
        };
        let mut estimate = at(prev.len() - 1);
        let mut last = None;
        for level in (0..prev.len()).rev() {
            if how.is(Fault::LkStartNotCarried) {
                estimate = at(level);
            } else if level + 1 < prev.len() && !how.is(Fault::LkNotDoubled) {
                estimate = estimate.map(|v| v * 2.0);
            }
            last = tracker.follow([&prev[level], &next[level]], at(level), estimate);
            if let Some((better, ..)) = &last {
                estimate = *better;
            }
        }
        let mut residual = 0.0;
        let mut tracked = false;
        if let Some((_, true, grey)) = last
            && let Some(there) = place(tracker.corner(estimate), &next[0], how)
        {
            let seen = tracker.window(there, 9, |x, y| next[0].at(x, y, how));
            let apart: i64 = seen.iter().zip(&grey).map(|(j, i)| (j - i).abs()).sum();
            let per_level = if how.is(Fault::LkResidualUnscaled) {
                1
            } else {
                32
            };
            residual = apart as f32 / (per_level * side * side) as f32;
            tracked = true;
        }
        status.push(tracked);
        found.push(estimate);
        residuals.push(residual);
    }
    out.put("status", status);
    // Positions are compared on the corners, which come first: the eight others are flat or outside.
    let corners = || found.iter().take(points.len() - 8);
    for suffix in ["", "_opencv"] {
        out.put(&format!("xy{suffix}"), corners().copied());
        let residuals = corners().zip(&residuals).map(|(_, r)| *r);
        out.put(&format!("residual{suffix}"), residuals);
    }
    let moved = corners().zip(points);
    out.put("flow_truth", moved.map(|(f, p)| [f[0] - p[0], f[1] - p[1]]));
}
