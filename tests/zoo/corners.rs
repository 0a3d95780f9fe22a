//! Corners, descriptors and their matches, written a second time, with their faults.

use garad_conformance::Outputs;
use garad_core::pyramid::{level_scales, level_sizes, resize_linear_into};
use garad_core::{GrayImage, Real};
use garad_features::orb::pattern::PATTERN;

use super::answers::Given;
use super::second::{Fault, How};

/// Offsets of the circle of radius 3, clockwise from below.
const CIRCLE: [[isize; 2]; 16] = [
    [0, 3],
    [1, 3],
    [2, 2],
    [3, 1],
    [3, 0],
    [3, -1],
    [2, -2],
    [1, -3],
    [0, -3],
    [-1, -3],
    [-2, -2],
    [-3, -1],
    [-3, 0],
    [-3, 1],
    [-2, 2],
    [-1, 3],
];

fn gray(case: Given<'_>, name: &str) -> GrayImage {
    let tensor = case.tensor(name);
    let size = (tensor.shape()[1], tensor.shape()[0]);
    GrayImage::from_vec(size.0, size.1, tensor.u8()).expect("an image")
}

fn near(image: &GrayImage, x: usize, y: usize, [dx, dy]: [isize; 2]) -> i32 {
    let at = [x.checked_add_signed(dx), y.checked_add_signed(dy)].map(|c| c.expect("inside"));
    i32::from(image[(at[0], at[1])])
}

/// How far the pixel stands out: the largest threshold that still leaves a corner, plus 1.
fn contrast(image: &GrayImage, x: usize, y: usize, how: &How) -> i32 {
    let middle = i32::from(image[(x, y)]);
    let mut ring = CIRCLE;
    if how.is(Fault::FastCircleSwapped) {
        ring.swap(4, 8);
    }
    let differences = ring.map(|offset| near(image, x, y, offset) - middle);
    let length = if how.is(Fault::FastArcOfTwelve) {
        12
    } else {
        9
    };
    let starts = if how.is(Fault::FastArcOpen) {
        17 - length
    } else {
        16
    };
    let arc = |start: usize| (start..start + length).map(|i| differences[i % 16]);
    let brighter = (0..starts).filter_map(|start| arc(start).min()).max();
    let darker = (0..starts)
        .filter_map(|start| arc(start).map(|d| -d).min())
        .max();
    brighter.max(darker).unwrap_or(0)
}

/// The test as bytes have it that do not saturate: centre ± threshold, modulo 256.
fn wrapped_test(image: &GrayImage, x: usize, y: usize, threshold: u8) -> bool {
    let middle = image[(x, y)];
    let (high, low) = (
        middle.wrapping_add(threshold),
        middle.wrapping_sub(threshold),
    );
    let ring = CIRCLE.map(|offset| near(image, x, y, offset));
    let arc = |start: usize| (start..start + 9).map(move |i| ring[i % 16]);
    (0..16).any(|s| arc(s).all(|v| v > i32::from(high)) || arc(s).all(|v| v < i32::from(low)))
}

pub(super) fn fast(case: Given<'_>, how: &How, out: &mut Outputs) {
    let image = gray(case, "image");
    let threshold = u8::try_from(case.count("threshold")).expect("a byte");
    let (width, height) = image.size();
    let border = if how.is(Fault::FastBorderOfFour) {
        4
    } else {
        3
    };
    // 0: no corner. Scores of corners are at least the threshold.
    let mut score = vec![0i32; width * height];
    let mut corners = Vec::new();
    for y in border..height - border {
        for x in border..width - border {
            let contrast = contrast(&image, x, y, how);
            let corner = match how.fault {
                Some(Fault::FastNotStrict) => contrast >= i32::from(threshold),
                Some(Fault::FastBytesWrap) => wrapped_test(&image, x, y, threshold),
                _ => contrast > i32::from(threshold),
            };
            if corner {
                corners.push([x, y]);
                score[y * width + x] = match how.is(Fault::FastSumForScore) {
                    true => {
                        let middle = i32::from(image[(x, y)]);
                        let apart = |offset| (near(&image, x, y, offset) - middle).abs();
                        CIRCLE.into_iter().map(apart).sum()
                    }
                    false => contrast - 1,
                };
            }
        }
    }
    let is_peak = |&[x, y]: &[usize; 2]| {
        let own = score[y * width + x];
        let around = (y - 1..=y + 1).flat_map(|v| (x - 1..=x + 1).map(move |u| [u, v]));
        around
            .filter(|at| *at != [x, y])
            .all(|[u, v]| match how.is(Fault::FastTiesStay) {
                true => own >= score[v * width + u],
                false => own > score[v * width + u],
            })
    };
    let mut kept: Vec<[usize; 2]> = match how.is(Fault::FastNoSuppression) {
        true => corners.clone(),
        false => corners.iter().copied().filter(is_peak).collect(),
    };
    if how.is(Fault::FastRowEndLost) {
        let last = |i: usize| kept.get(i + 1).is_none_or(|next| next[1] != kept[i][1]);
        kept = (0..kept.len())
            .filter(|i| !last(*i))
            .map(|i| kept[i])
            .collect();
    }
    out.put("xy", kept.iter().copied());
    out.put("score", kept.iter().map(|[x, y]| score[y * width + x]));
    out.put("count_without_nms", [corners.len()]);
}

/// Degrees of the point (x, y), by the polynomial that everybody's descriptors depend on.
fn atan2_deg(y: f32, x: f32) -> f32 {
    let degrees = (180.0 / std::f64::consts::PI).to_f32();
    let factors = [
        0.9997878412794807,
        -0.3258083974640975,
        0.1555786518463281,
        -0.04432655554792128,
    ];
    let [p1, p3, p5, p7] = factors.map(|p: f64| p.to_f32() * degrees);
    let (small, large) = (x.abs().min(y.abs()), x.abs().max(y.abs()));
    let c = small / (large + f64::EPSILON.to_f32());
    let c2 = c * c;
    let mut angle = (((p7 * c2 + p5) * c2 + p3) * c2 + p1) * c;
    if y.abs() > x.abs() {
        angle = 90.0 - angle;
    }
    if x < 0.0 {
        angle = 180.0 - angle;
    }
    if y < 0.0 {
        angle = 360.0 - angle;
    }
    angle
}

/// Of the intensities in a disc of radius 15, or in the square around it.
fn angle(image: &GrayImage, x: usize, y: usize, how: &How) -> f32 {
    let reach = [15, 15, 15, 15, 14, 14, 14, 13, 13, 12, 11, 10, 9, 8, 6, 3];
    let (mut m10, mut m01) = (0, 0);
    for v in -15..=15isize {
        let half = match how.is(Fault::OrbSquarePatch) {
            true => 15,
            false => reach[v.unsigned_abs()],
        };
        for u in -half..=half {
            let value = i64::from(near(image, x, y, [u, v]));
            m10 += u as i64 * value;
            m01 += v as i64 * value;
        }
    }
    let (m10, m01) = ((m10 as f64).to_f32(), (m01 as f64).to_f32());
    match how.is(Fault::OrbMomentsExchanged) {
        true => atan2_deg(m10, m01),
        false => atan2_deg(m01, m10),
    }
}

/// 7 taps each way with one rounding at the end; mirrored without repeating the edge.
fn blurred(image: &GrayImage) -> GrayImage {
    let taps = [18u32, 34, 48, 56, 48, 34, 18];
    let (width, height) = image.size();
    let mirrored = |i: usize, d: usize, n: usize| {
        let i = (i + d).cast_signed() - 3;
        let i = i.unsigned_abs();
        if i < n { i } else { 2 * (n - 1) - i }
    };
    GrayImage::from_fn(width, height, |x, y| {
        let row = |v: usize| -> u32 {
            let one = |d: usize| taps[d] * u32::from(image[(mirrored(x, d, width), v)]);
            (0..7).map(one).sum()
        };
        let sum: u32 = (0..7).map(|d| taps[d] * row(mirrored(y, d, height))).sum();
        u8::try_from((sum + (1 << 15)) >> 16).expect("a mean of bytes")
    })
}
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "places and levels inside of an image"
)]
fn describe(image: &GrayImage, x: usize, y: usize, degrees: f32, how: &How) -> [u8; 32] {
    let factor = match how.is(Fault::OrbDegreesForRadians) {
        true => 1.0,
        false => (std::f64::consts::PI / 180.0).to_f32(),
    };
    let (sin, cos) = Real::sin_cos(f64::from(degrees * factor));
    let (sin, cos) = match how.fault {
        Some(Fault::OrbNotTurned) => (0.0, 1.0),
        Some(Fault::OrbTurnedBack) => (-sin.to_f32(), cos.to_f32()),
        _ => (sin.to_f32(), cos.to_f32()),
    };
    let value = |px: i8, py: i8| {
        let (px, py) = (f32::from(px), f32::from(py));
        let (u, v) = (px * cos - py * sin, px * sin + py * cos);
        let [u, v] = [u, v].map(|c| match how.is(Fault::OrbPlacesCutOff) {
            true => c.trunc() as isize,
            false => c.round_ties_even() as isize,
        });
        near(image, x, y, [u, v])
    };
    let mut bytes = [0u8; 32];
    for (k, [x0, y0, x1, y1]) in PATTERN.into_iter().enumerate() {
        let (a, b) = (value(x0, y0), value(x1, y1));
        let bit = if how.is(Fault::OrbComparedTheOtherWay) {
            a > b
        } else {
            a < b
        };
        let place = if how.is(Fault::OrbBitsReversed) {
            7 - k % 8
        } else {
            k % 8
        };
        bytes[k / 8] |= u8::from(bit) << place;
    }
    bytes
}

/// Which keypoints there are is garad's own answer; angles and descriptors are computed here.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "places and levels inside of an image"
)]
pub(super) fn orb(case: Given<'_>, how: &How, out: &mut Outputs) {
    if case.get("image").is_none() {
        let (y, x) = (case.tensor("y").f32(), case.tensor("x").f32());
        out.put("atan2", y.iter().zip(&x).map(|(y, x)| atan2_deg(*y, *x)));
        return;
    }
    let of = |name: &str| out.tensors()[name].f64();
    let (levels, places) = (of("level"), of("pt"));
    let scales = level_scales(1.2, 8);
    let image = gray(case, "image");
    let sizes = level_sizes(image.size(), 1.2, 8);
    let mut images = vec![image];
    for size in &sizes[1..] {
        let mut smaller = GrayImage::new(size.0, size.1, 0);
        resize_linear_into(&images[images.len() - 1], *size, &mut smaller);
        images.push(smaller);
    }
    let soft: Vec<GrayImage> = images.iter().map(blurred).collect();
    let (mut angles, mut descriptors, mut points) = (Vec::new(), Vec::new(), Vec::new());
    for (level, place) in levels.iter().zip(places.as_chunks::<2>().0) {
        let level = *level as usize;
        let at = place.map(|v| (v / f64::from(scales[level])).round() as usize);
        let [x, y] = at;
        let (seen, described) = match how.fault {
            Some(Fault::OrbNotBlurred) => (&images, &images),
            Some(Fault::OrbAngleOfBlurred) => (&soft, &soft),
            _ => (&images, &soft),
        };
        let degrees = angle(&seen[level], x, y, how);
        descriptors.push(describe(&described[level], x, y, degrees, how));
        angles.push(match how.is(Fault::OrbAngleInRadians) {
            true => degrees.to_radians(),
            false => degrees,
        });
        let scale = if how.is(Fault::OrbPlaceOfTheLevel) {
            1.0
        } else {
            scales[level]
        };
        points.push(at.map(|c| c as f32 * scale));
    }
    out.put("pt", points);
    out.put("angle", angles);
    out.put("descriptor", descriptors);
}

fn distance(a: &[u8], b: &[u8], how: &How) -> u32 {
    let lanes = if how.is(Fault::MatchLaneForgotten) {
        24
    } else {
        32
    };
    let pairs = a.iter().zip(b).take(lanes);
    let one = |(a, b): (&u8, &u8)| match how.fault {
        Some(Fault::MatchBytes) => u32::from(a != b),
        Some(Fault::MatchEuclid) => u32::from(a.abs_diff(*b)).pow(2),
        Some(Fault::MatchPairsOfBits) => ((a ^ b) | (a ^ b) >> 1 & 0x55).count_ones().min(4),
        _ => (a ^ b).count_ones(),
    };
    pairs.map(one).sum()
}

pub(super) fn matching(case: Given<'_>, how: &How, out: &mut Outputs) {
    let (query, train) = (case.tensor("query").u8(), case.tensor("train").u8());
    let (query, train) = (query.as_chunks::<32>().0, train.as_chunks::<32>().0);
    let best_of = |one: &[u8; 32], all: &[[u8; 32]]| {
        let mut best = (usize::MAX, u32::MAX, u32::MAX);
        for (j, other) in all.iter().enumerate() {
            let d = distance(one, other, how);
            let nearer = d < best.1 || how.is(Fault::MatchLaterOfEquals) && d == best.1;
            best = match nearer {
                true if how.is(Fault::MatchSecondForgotten) => (j, d, best.2),
                true => (j, d, best.1),
                false => (best.0, best.1, best.2.min(d)),
            };
        }
        best
    };
    let found: Vec<_> = query.iter().map(|q| best_of(q, train)).collect();
    let back: Vec<_> = train.iter().map(|t| best_of(t, query)).collect();
    out.put("nearest", found.iter().map(|f| f.0));
    out.put("distance", found.iter().map(|f| f.1));
    out.put("second", found.iter().map(|f| f.2));
    let mut mutual = Vec::new();
    for (i, (j, ..)) in found.iter().enumerate() {
        let partner = match how.fault {
            Some(Fault::MatchOneWay) => Some(*j),
            // The nearest of those who think of i as their nearest.
            Some(Fault::MatchHalfMutual) => {
                let suitors = (0..train.len()).filter(|j| back[*j].0 == i);
                suitors.min_by_key(|j| back[*j].1)
            }
            _ => Some(*j).filter(|j| back[*j].0 == i),
        };
        mutual.extend(partner.map(|j| [i, j]));
    }
    out.put("mutual", mutual);
}
