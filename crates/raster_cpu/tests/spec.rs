//! The image by the formulas as they are written, pixel by pixel over all splats.

mod common;

use garad_core::{GaussianMap, Par, Real};
use garad_raster::{Projected, RenderOptions, render};

/// `power` as a conic, -½ (a dx² + c dy²) - b dx dy, and as the rasterizer's sum of squares.
fn powers<T: Real>(s: &Projected<T>, x: usize, y: usize) -> (T, T) {
    let c = T::from_f64;
    let (dx, dy) = (c(x as f64) - s.mean_px[0], c(y as f64) - s.mean_px[1]);
    let [a, b, d] = s.conic;
    let conic = c(-0.5) * (a * dx * dx + d * dy * dy) - b * dx * dy;
    let along = dx + s.shear * dy;
    (conic, c(-0.5) * (a * along * along + s.inv_var_y * dy * dy))
}

/// Eq. 15 typed again, over all splats: colour without background, depth, transmittance, splats
/// blended.
fn dense_pixel<T: Real>(
    splats: &[Projected<T>],
    (x, y): (usize, usize),
    exp: fn(T) -> T,
    power: fn((T, T)) -> T,
) -> ([T; 3], T, T, u32) {
    let c = T::from_f64;
    let (mut color, mut depth, mut left, mut count) = ([T::ZERO; 3], T::ZERO, T::ONE, 0);
    for s in splats {
        let f = s.footprint;
        if !(f.x0..f.x1).contains(&x) || !(f.y0..f.y1).contains(&y) {
            continue;
        }
        let power = power(powers(s, x, y));
        if power > T::ZERO {
            continue;
        }
        let alpha = c(0.99).min(s.opacity * exp(power));
        if alpha < c(1.0 / 255.0) {
            continue;
        }
        if left * (T::ONE - alpha) < c(1e-4) {
            break;
        }
        for k in 0..3 {
            color[k] += alpha * left * s.color[k];
        }
        depth += alpha * left * s.depth_m;
        left *= T::ONE - alpha;
        count += 1;
    }
    (color, depth, left, count)
}

/// Tiles and their lists change no bit of the image.
fn spec_bits<T: Real>(map: &GaussianMap<T>) -> usize {
    let options = RenderOptions::default();
    let image =
        render(map, &common::camera(), &common::pose(), &options, Par::Seq).expect("an image");
    let mut drawn = 0;
    for y in 0..50 {
        for x in 0..70 {
            let at = (x, y);
            let (color, depth, left, count) =
                dense_pixel(&image.projected, at, T::exp_nonpositive, |p| p.1);
            // Black background: adding T · 0 changes nothing.
            assert!(image.color[at] == color, "colour at {at:?}");
            assert!(image.depth[at] == depth, "depth at {at:?}");
            assert!(image.transmittance[at] == left, "transmittance at {at:?}");
            assert_eq!(image.contributors[at], count, "count at {at:?}");
            drawn += count as usize;
        }
    }
    drawn
}

#[test]
fn spec_render() {
    for seed in 0..6 {
        let map = common::map(seed, 150);
        let drawn = spec_bits(&map);
        assert!(drawn > 10_000, "the scene tests something: {drawn}");
        spec_bits(&map.cast::<f32>());
    }
}

/// The sum of squares is the conic, and `exp_nonpositive` is exp.
#[test]
fn spec_alpha() {
    for seed in 0..6 {
        let map = common::map(seed, 150);
        let options = RenderOptions::default();
        let image =
            render(&map, &common::camera(), &common::pose(), &options, Par::Seq).expect("an image");
        for y in 0..50 {
            for x in 0..70 {
                let (color, depth, left, count) =
                    dense_pixel(&image.projected, (x, y), Real::exp, |p| p.0);
                assert_eq!(image.contributors[(x, y)], count, "count at {x}, {y}");
                let close = |a: f64, b: f64| (a - b).abs() < 1e-11;
                let colors = image.color[(x, y)].iter().zip(color);
                assert!(
                    colors.into_iter().all(|(a, b)| close(*a, b))
                        && close(image.depth[(x, y)], depth)
                        && close(image.transmittance[(x, y)], left),
                    "pixel {x}, {y}"
                );
            }
        }
    }
}
