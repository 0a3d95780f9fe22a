//! From splats to images and back, by the formulas of docs/math.md R8 to R14.

use super::number::{N, rough_exp};
use super::rendering::{CELL, Density, Fault, How, Walk};
use super::splats::{ByPixel, Splat};

const MIN_ALPHA: f64 = 1.0 / 255.0;
const MAX_ALPHA: f64 = 0.99;
const MIN_T: f64 = 1e-4;

#[derive(Debug, Clone, Default)]
pub(crate) struct Images<const M: bool, const Z: bool> {
    pub(crate) color: Vec<[N<M, Z>; 3]>,
    pub(crate) depth: Vec<N<M, Z>>,
    pub(crate) left: Vec<N<M, Z>>,
    pub(crate) count: Vec<i32>,
    pub(crate) last: Vec<i32>,
}

/// Splats front to back.
pub(crate) fn order<const M: bool, const Z: bool>(splats: &[Splat<M, Z>], how: &How) -> Vec<usize> {
    let mut order: Vec<usize> = (0..splats.len()).filter(|&i| splats[i].visible).collect();
    let near = |i: usize| -> f32 {
        let s = &splats[i];
        match how.fault {
            Some(Fault::SortInHalf) => f32::from_bits(s.depth_m.0.to_bits() & 0xffff_0000),
            Some(Fault::SortByDistance) => s.p.iter().map(|v| v.0 * v.0).sum(),
            Some(Fault::SortReversed) => -s.depth_m.0,
            _ => s.depth_m.0,
        }
    };
    order.sort_by(|&a, &b| near(a).total_cmp(&near(b)).then(a.cmp(&b)));
    match how.fault {
        Some(Fault::SortDropsOne) => {
            order.pop();
        }
        Some(Fault::SortDoublesOne) => order.extend(order.last().copied()),
        Some(Fault::PaddingDrawsZero) if !splats.is_empty() => order.insert(0, 0),
        Some(Fault::PayloadOverwritten) if order.len() > 2 => order.swap(0, 1),
        // The mask is that of the list, read at the place in the sorted one.
        Some(Fault::MaskBySortedIndex) => {
            order = (0..splats.len()).collect();
            order.sort_by(|&a, &b| near(a).total_cmp(&near(b)).then(a.cmp(&b)));
            let mask: Vec<bool> = splats.iter().map(|s| s.visible).collect();
            let mut at = 0..;
            order.retain(|_| at.next().is_some_and(|k| mask[k]));
        }
        _ => {}
    }
    order
}

/// What one splat does to one pixel.
struct Touch<const M: bool, const Z: bool> {
    splat: usize,
    alpha: N<M, Z>,
    dense: N<M, Z>,
    /// What is left before it.
    left: N<M, Z>,
    d: [N<M, Z>; 2],
    /// Conic times d.
    v: [N<M, Z>; 2],
}

pub(crate) struct Pixel<const M: bool, const Z: bool> {
    touches: Vec<Touch<M, Z>>,
    pub(crate) left: N<M, Z>,
    pub(crate) last: i32,
}

fn inside(footprint: &[i64; 4], x: i64, y: i64) -> bool {
    let [x0, y0, x1, y1] = *footprint;
    x >= x0 && x < x1 && y >= y0 && y < y1
}

pub(crate) fn walk<const M: bool, const Z: bool>(
    splats: &[Splat<M, Z>],
    order: &[usize],
    (x, y): (i64, i64),
    how: &How,
) -> Pixel<M, Z> {
    let mut pixel = Pixel {
        touches: Vec::new(),
        left: N::ONE,
        last: 0,
    };
    let shift = if how.fault == Some(Fault::HalfPixel) {
        0.5
    } else {
        0.0
    };
    let at = [N::new(x as f64 + shift), N::new(y as f64 + shift)];
    let stop = N::new(if how.fault == Some(Fault::EarlyStop) {
        1e-3
    } else {
        MIN_T
    });
    let mut rank = 0;
    for &i in order {
        let s = &splats[i];
        if !inside(&s.footprint, x, y) {
            continue;
        }
        rank += 1;
        let d = [at[0] - s.mean_px[0], at[1] - s.mean_px[1]];
        let [a, b, c] = s.conic;
        let v = [a.times_plus(d[0], b * d[1]), b.times_plus(d[0], c * d[1])];
        let q = match how.density {
            // As CUDA rasterizers have it.
            Density::Plain => {
                let square = (a * d[0]).times_plus(d[0], c * d[1] * d[1]);
                square + N::new(2.0) * b * d[0] * d[1]
            }
            // Conic times d, times d.
            Density::Product => d[0].times_plus(v[0], d[1] * v[1]),
            Density::Slanted => {
                let (shear, inverse) = (-s.cov[1] / s.cov[2], N::ONE / s.cov[2]);
                let slant = shear.times_plus(d[1], d[0]);
                (a * slant).times_plus(slant, d[1] * d[1] * inverse)
            }
        };
        let dense = s.opacity * rough_exp(N::new(-0.5) * q, how.exp_ulp);
        let highest = match how.fault {
            Some(Fault::NoAlphaLimit) => 1.0,
            Some(Fault::AlphaLimitOfGsplat) => 0.999,
            _ => MAX_ALPHA,
        };
        let alpha = dense.min(N::new(highest));
        if alpha < N::new(MIN_ALPHA) && how.fault != Some(Fault::NoAlphaThreshold) {
            continue;
        }
        let behind = pixel.left * (N::ONE - alpha);
        if behind < stop && how.fault != Some(Fault::NoStop) {
            break;
        }
        let left = pixel.left;
        pixel.touches.push(Touch {
            splat: i,
            alpha,
            dense,
            left,
            d,
            v,
        });
        pixel.left = behind;
        pixel.last = rank;
    }
    if how.fault == Some(Fault::LastCountsSkipped) {
        pixel.last = rank;
    }
    pixel
}

pub(crate) fn blend<const M: bool, const Z: bool>(
    splats: &[Splat<M, Z>],
    order: &[usize],
    [width, height]: [i64; 2],
    background: &[N<M, Z>; 3],
    how: &How,
) -> Images<M, Z> {
    let mut out = Images::default();
    for y in 0..height {
        for x in 0..width {
            let launched = x < width / CELL * CELL && y < height / CELL * CELL;
            let order = match how.fault {
                Some(Fault::TooFewTiles) if !launched => &[],
                _ => order,
            };
            let pixel = walk(splats, order, (x, y), how);
            paint(splats, &pixel, background, how, &mut out);
        }
    }
    out
}

/// Adds a pixel to the images.
pub(crate) fn paint<const M: bool, const Z: bool>(
    splats: &[Splat<M, Z>],
    pixel: &Pixel<M, Z>,
    background: &[N<M, Z>; 3],
    how: &How,
    out: &mut Images<M, Z>,
) {
    let (mut color, mut depth) = ([N::ZERO; 3], N::ZERO);
    for t in &pixel.touches {
        let weight = t.alpha * t.left;
        let s = &splats[t.splat];
        for c in 0..3 {
            color[c] = weight.times_plus(s.color[c], color[c]);
        }
        depth = weight.times_plus(s.depth_m, depth);
    }
    for c in 0..3 {
        match how.fault {
            Some(Fault::BackgroundInFull) => color[c] += background[c],
            Some(Fault::BackgroundMissing) => {}
            Some(Fault::PremultipliedTwice) => {
                color[c] = color[c] * (N::ONE - pixel.left) + pixel.left * background[c];
            }
            _ => color[c] = pixel.left.times_plus(background[c], color[c]),
        }
    }
    if how.fault == Some(Fault::ChannelsReversed) {
        color.reverse();
    }
    if how.fault == Some(Fault::DepthNormalised) && pixel.left < N::ONE {
        depth = depth / (N::ONE - pixel.left);
    }
    out.color.push(color);
    out.depth.push(depth);
    out.left.push(pixel.left);
    out.count
        .push(i32::try_from(pixel.touches.len()).unwrap_or(i32::MAX));
    out.last.push(pixel.last);
}

/// The pixels in the order of `walk`, in blocks whose sums are added up at the end.
fn blocks(walk: Walk, [width, height]: [i64; 2]) -> Vec<Vec<(i64, i64)>> {
    let rows = || (0..height).flat_map(move |y| (0..width).map(move |x| (x, y)));
    match walk {
        Walk::Rows => vec![rows().collect()],
        Walk::Columns => vec![
            (0..width)
                .flat_map(|x| (0..height).map(move |y| (x, y)))
                .collect(),
        ],
        Walk::Backwards => {
            let mut all: Vec<_> = rows().collect();
            all.reverse();
            vec![all]
        }
        Walk::Tiles(n) => {
            let mut tiles = Vec::new();
            for ty in 0..(height + n - 1) / n {
                for tx in 0..(width + n - 1) / n {
                    let of = |(x, y): &(i64, i64)| x / n == tx && y / n == ty;
                    tiles.push(rows().filter(of).collect());
                }
            }
            tiles
        }
        Walk::Pairs => rows()
            .collect::<Vec<_>>()
            .chunks(2)
            .map(<[_]>::to_vec)
            .collect(),
    }
}

/// Gradients of the images.
pub(crate) struct Up<'a, const M: bool, const Z: bool> {
    pub(crate) color: &'a [[N<M, Z>; 3]],
    pub(crate) depth: &'a [N<M, Z>],
    pub(crate) opacity: &'a [N<M, Z>],
}

pub(crate) fn blend_backward<const M: bool, const Z: bool>(
    splats: &[Splat<M, Z>],
    order: &[usize],
    size: [i64; 2],
    background: &[N<M, Z>; 3],
    up: &Up<'_, M, Z>,
    pass_through: bool,
    how: &How,
) -> Vec<ByPixel<M, Z>> {
    let mut total = vec![ByPixel::default(); splats.len()];
    for block in blocks(how.walk, size) {
        let mut part = vec![ByPixel::default(); splats.len()];
        for (x, y) in block {
            let k = usize::try_from(y * size[0] + x).unwrap_or(0);
            let pixel = walk(splats, order, (x, y), how);
            pixel_backward(
                splats,
                &pixel,
                (up.color[k], up.depth[k], up.opacity[k]),
                background,
                pass_through,
                how,
                &mut part,
            );
        }
        total.iter_mut().zip(&part).for_each(|(t, p)| t.add(p));
    }
    finish(splats, &mut total, how);
    total
}

/// From sums over pixels to gradients.
pub(crate) fn finish<const M: bool, const Z: bool>(
    splats: &[Splat<M, Z>],
    total: &mut [ByPixel<M, Z>],
    how: &How,
) {
    for (sum, s) in total.iter_mut().zip(splats) {
        sum.opacity = sum.opacity / s.opacity;
        if how.fault == Some(Fault::ConicFactor) {
            sum.cov[1] = sum.cov[1] * N::new(0.5);
            sum.conic[1] = sum.conic[1] * N::new(0.5);
        }
        if how.fault == Some(Fault::SubtleConic) {
            sum.cov[1] = sum.cov[1] * N::new(0.9995);
        }
    }
}

pub(crate) fn pixel_backward<const M: bool, const Z: bool>(
    splats: &[Splat<M, Z>],
    pixel: &Pixel<M, Z>,
    (color, depth, opacity): ([N<M, Z>; 3], N<M, Z>, N<M, Z>),
    background: &[N<M, Z>; 3],
    pass_through: bool,
    how: &How,
    sums: &mut [ByPixel<M, Z>],
) {
    let product = |a: &[N<M, Z>; 3]| (0..3).fold(N::ZERO, |sum, c| color[c].times_plus(a[c], sum));
    let behind_all = match how.fault {
        Some(Fault::BackgroundNotInGradient) => N::ZERO,
        Some(Fault::BackgroundTwiceInGradient) => product(background) + product(background),
        _ => product(background),
    };
    let mut light = behind_all - opacity;
    for t in pixel.touches.iter().rev() {
        let (s, sum) = (&splats[t.splat], &mut sums[t.splat]);
        let by_depth = if how.fault == Some(Fault::DepthNotInGradient) {
            N::ZERO
        } else {
            depth
        };
        let gain = by_depth.times_plus(s.depth_m, product(&s.color));
        let left = match how.fault {
            Some(Fault::TransmittanceBehind) => t.left * (N::ONE - t.alpha),
            _ => t.left,
        };
        let d_alpha = left * (gain - light);
        light = t.alpha.times_plus(gain, (N::ONE - t.alpha) * light);
        let weight = t.alpha * t.left;
        for c in 0..3 {
            sum.color[c] = weight.times_plus(color[c], sum.color[c]);
        }
        sum.depth = weight.times_plus(depth, sum.depth);
        let limited = t.dense > N::new(MAX_ALPHA);
        let passes = pass_through || !limited || how.fault == Some(Fault::AlphaLimitIgnored);
        let power = if passes { t.dense * d_alpha } else { N::ZERO };
        let half = N::new(0.5);
        for a in 0..2 {
            let pull = power * t.v[a];
            sum.mean_px[a] += if how.fault == Some(Fault::AbsoluteGradient) {
                pull.abs()
            } else {
                pull
            };
        }
        sum.cov[0] = (half * power * t.v[0]).times_plus(t.v[0], sum.cov[0]);
        sum.cov[1] = (power * t.v[0]).times_plus(t.v[1], sum.cov[1]);
        sum.cov[2] = (half * power * t.v[1]).times_plus(t.v[1], sum.cov[2]);
        sum.conic[0] = (-half * power * t.d[0]).times_plus(t.d[0], sum.conic[0]);
        sum.conic[1] = (-power * t.d[0]).times_plus(t.d[1], sum.conic[1]);
        sum.conic[2] = (-half * power * t.d[1]).times_plus(t.d[1], sum.conic[2]);
        sum.opacity += power;
    }
}
