//! The elements of every texture: hashed noise, and edges blurred to the footprint of a pixel.
//!
//! `fp` is the width in metres that one pixel covers on the surface. Each function returns its average over
//! about that width: an octave finer than two pixels is replaced by its mean, an edge becomes a ramp one
//! pixel wide. So textures do not alias when the camera moves, and depend only on place and distance.
#![allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::imprecise_flops,
    reason = "lattice cells of a room fit i32, hashing wraps on purpose, and lengths are of order 1"
)]

/// A colour as stored in an image, [0, 1], red first.
pub(crate) type Rgb = [f32; 3];

/// 32 bits from a cell of the plane.
#[inline]
pub(crate) fn hash(x: i32, y: i32, seed: u32) -> u32 {
    let mut h = (x as u32).wrapping_mul(0x9E37_79B1)
        ^ (y as u32).wrapping_mul(0x85EB_CA77).rotate_left(13)
        ^ seed.wrapping_mul(0xC2B2_AE3D);
    h = (h ^ (h >> 16)).wrapping_mul(0x7FEB_352D);
    h = (h ^ (h >> 15)).wrapping_mul(0x846C_A68B);
    h ^ (h >> 16)
}

/// The k-th number in [0, 1) of a hash, k = 0, 1, 2: ten bits each.
#[inline]
pub(crate) fn part(h: u32, k: u32) -> f32 {
    ((h >> (10 * k)) & 1023) as f32 * (1.0 / 1024.0)
}

/// Largest integer not above x. `f32::floor` is a library call on processors without SSE 4.1.
#[inline]
pub(crate) fn floor(x: f32) -> i32 {
    let i = x as i32;
    i - i32::from(x < i as f32)
}

/// (cell, position within it in [0, 1)).
#[inline]
pub(crate) fn cell(x: f32) -> (i32, f32) {
    let i = floor(x);
    (i, x - i as f32)
}

#[inline]
pub(crate) fn lerp(a: f32, b: f32, t: f32) -> f32 {
    a + (b - a) * t
}

/// a for t = 0, b for t = 1.
#[inline]
pub(crate) fn mix(a: Rgb, b: Rgb, t: f32) -> Rgb {
    [
        lerp(a[0], b[0], t),
        lerp(a[1], b[1], t),
        lerp(a[2], b[2], t),
    ]
}

/// The colour times a number.
#[inline]
pub(crate) fn scale(a: Rgb, k: f32) -> Rgb {
    [a[0] * k, a[1] * k, a[2] * k]
}

/// 1 while a wavelength is longer than 4 footprints, 0 from 2 footprints down.
#[inline]
pub(crate) fn fade(wavelength: f32, fp: f32) -> f32 {
    (0.5 * wavelength / fp - 1.0).clamp(0.0, 1.0)
}

/// Value noise with unit lattice, in [-1, 1].
#[inline]
fn value_noise(u: f32, v: f32, seed: u32) -> f32 {
    let ((i, x), (j, y)) = (cell(u), cell(v));
    let smooth = |t: f32| t * t * (3.0 - 2.0 * t);
    let corner = |di: i32, dj: i32| (hash(i + di, j + dj, seed) >> 8) as f32;
    let (x, y) = (smooth(x), smooth(y));
    let low = lerp(corner(0, 0), corner(1, 0), x);
    let high = lerp(corner(0, 1), corner(1, 1), x);
    lerp(low, high, y) * (2.0 / 16_777_215.0) - 1.0
}

/// Noise of one wavelength (metres), faded by the footprint.
#[inline]
pub(crate) fn noise(u: f32, v: f32, wavelength: f32, fp: f32, seed: u32) -> f32 {
    let w = fade(wavelength, fp);
    if w > 0.0 {
        w * value_noise(u / wavelength, v / wavelength, seed)
    } else {
        0.0
    }
}

/// Σₖ 0.6ᵏ noise of wavelength / 2.1ᵏ.
pub(crate) fn fbm(u: f32, v: f32, wavelength: f32, octaves: u32, fp: f32, seed: u32) -> f32 {
    let (mut sum, mut amplitude, mut wavelength) = (0.0, 1.0, wavelength);
    for k in 0..octaves {
        sum += amplitude * noise(u, v, wavelength, fp, seed.wrapping_add(k));
        amplitude *= 0.6;
        wavelength /= 2.1;
    }
    sum
}

/// 0 for x < 0, 1 for x > 0, averaged over the footprint.
#[inline]
pub(crate) fn step(x: f32, fp: f32) -> f32 {
    (x / fp + 0.5).clamp(0.0, 1.0)
}

/// Share of the footprint around x that lies in [a, b].
#[inline]
pub(crate) fn band(x: f32, a: f32, b: f32, fp: f32) -> f32 {
    let h = 0.5 * fp;
    ((x + h).min(b) - (x - h).max(a)).max(0.0) / fp
}

/// Bands [a, b] of every period, a and b as shares of the period.
#[inline]
pub(crate) fn bands(x: f32, period: f32, a: f32, b: f32, fp: f32) -> f32 {
    let w = fade(period, fp);
    if w > 0.0 {
        let (_, t) = cell(x / period);
        let fp = fp / period;
        let here =
            band(t, a, b, fp) + band(t, a - 1.0, b - 1.0, fp) + band(t, a + 1.0, b + 1.0, fp);
        lerp(b - a, here, w)
    } else {
        b - a
    }
}

/// A disc, averaged over the footprint.
#[inline]
pub(crate) fn disc(u: f32, v: f32, radius: f32, fp: f32) -> f32 {
    step(radius - (u * u + v * v).sqrt(), fp)
}

/// Spots: a share `density` of the cells of a lattice holds a disc. Returns (cover, its hash).
#[inline]
pub(crate) fn spots(u: f32, v: f32, pitch: f32, density: f32, fp: f32, seed: u32) -> (f32, u32) {
    let ((i, x), (j, y)) = (cell(u / pitch), cell(v / pitch));
    let h = hash(i, j, seed);
    let w = fade(pitch, fp);
    if part(h, 0) >= density || w <= 0.0 {
        return (0.0, h);
    }
    let shape = hash(j, i, seed ^ 0x5bd1);
    let radius = lerp(0.08, 0.28, part(shape, 0));
    let (cx, cy) = (
        lerp(0.3, 0.7, part(shape, 1)),
        lerp(0.3, 0.7, part(shape, 2)),
    );
    (w * disc(x - cx, y - cy, radius, fp / pitch), h)
}

/// Print: rows of words made of letters, each letter 2x3 dots. Returns the share of ink.
pub(crate) fn print(u: f32, v: f32, pitch: f32, fp: f32, seed: u32) -> f32 {
    const MEAN: f32 = 0.25;
    let w = fade(0.7 * pitch, fp);
    if w <= 0.0 {
        return MEAN * fade(4.0 * pitch, fp).max(0.6);
    }
    let (row, y) = cell(v / pitch);
    let (column, x) = cell(u / (0.6 * pitch));
    let letter = hash(column, row, seed);
    // about every sixth letter is a gap
    if letter.is_multiple_of(6) || !(0.2..0.8).contains(&y) || x > 0.8 {
        return lerp(MEAN, 0.0, w);
    }
    let dot = floor(x / 0.4).min(1) + 2 * floor((y - 0.2) / 0.2).min(2);
    lerp(MEAN, ((letter >> (8 + dot)) & 1) as f32, w)
}

/// Wood: fibres along the first coordinate, with rings and knots.
pub(crate) fn grain(along: f32, across: f32, tone: Rgb, fp: f32, seed: u32) -> Rgb {
    let bend = 0.03 * noise(along, across, 0.5, fp, seed);
    let rings = fbm(along * 0.08, across + bend, 0.03, 3, fp, seed ^ 1);
    let fibre = noise(along * 0.05, across, 0.006, fp, seed ^ 2);
    let cloud = noise(along, across, 0.3, fp, seed ^ 3);
    let (knot, h) = spots(along * 0.5 + bend, across, 0.075, 0.16, fp, seed ^ 4);
    let knot = knot * (0.25 + 0.3 * part(h, 1));
    let shade = (1.0 + 0.20 * rings + 0.14 * fibre + 0.08 * cloud) * (1.0 - knot);
    // dark wood is redder
    let dark = (1.0 - shade).clamp(0.0, 0.6);
    [
        tone[0] * shade,
        tone[1] * shade * (1.0 - 0.12 * dark),
        tone[2] * shade * (1.0 - 0.35 * dark),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn floor_rounds_down_on_both_sides_of_zero() {
        for (x, expected) in [(1.5, 1), (-0.5, -1), (-2.0, -2), (0.0, 0), (3.0, 3)] {
            assert_eq!(floor(x), expected, "{x}");
        }
    }

    /// A band's average over the footprint, against the overlap counted by hand.
    #[test]
    fn bands_are_box_filtered() {
        let close = |a: f32, b: f32| assert!((a - b).abs() < 1e-4, "{a} against {b}");
        close(band(0.0, -1.0, 1.0, 0.5), 1.0);
        close(band(1.0, -1.0, 1.0, 0.5), 0.5);
        close(band(0.0, -0.1, 0.1, 1.0), 0.2);
        close(bands(0.25, 1.0, 0.0, 0.5, 1e-3), 1.0);
        close(bands(-0.25, 1.0, 0.0, 0.5, 1e-3), 0.0);
        close(bands(7.0, 1.0, 0.0, 0.5, 0.1), 0.5);
        close(bands(0.1, 1.0, 0.2, 0.6, 9.0), 0.4);
        close(step(0.0, 1.0), 0.5);
    }

    /// Noise is within [-1, 1], continuous across cells, has mean 0, and fades to nothing.
    #[test]
    fn noise_is_bounded_continuous_and_fades() {
        let mut sum = 0.0;
        for k in 0..4000 {
            let (u, v) = (k as f32 * 0.173, k as f32 * 0.091 - 100.0);
            let n = noise(u, v, 1.0, 1e-3, 7);
            assert!(n.abs() <= 1.0, "{n}");
            let beside = noise(u + 1e-3, v, 1.0, 1e-3, 7);
            assert!((n - beside).abs() < 0.01, "a jump at {u}, {v}");
            sum += n;
        }
        assert!((sum / 4000.0).abs() < 0.03, "mean {}", sum / 4000.0);
        assert!(
            noise(0.3, 0.4, 1.0, 0.5, 7).abs() < 1e-9,
            "two footprints a wave: gone"
        );
    }

    #[test]
    fn parts_of_a_hash_are_uniform_and_independent() {
        let mut mean = [0.0f32; 3];
        let mut cross = 0.0f32;
        for i in 0..100 {
            for j in 0..100 {
                let h = hash(i, j, 3);
                for k in 0..3u8 {
                    mean[usize::from(k)] += part(h, u32::from(k)) * 1e-4;
                }
                cross += (part(h, 0) - 0.5) * (part(h, 1) - 0.5) * 1e-4;
            }
        }
        assert!(mean.iter().all(|m| (m - 0.5).abs() < 0.01), "{mean:?}");
        assert!(cross.abs() < 0.003, "{cross}");
    }
}
