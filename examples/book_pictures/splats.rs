//! Chapters 9 to 11: one splat, a ray, a gradient, two losses.

use garad::core::{
    Camera, GaussianMap, Image, KeyframeId, NewGaussian, Par, Real, RgbImage, Rng, Se3,
};
use garad::eval::{psnr_db, ssim, ssim_map};
use garad::images::color_image;
use garad::raster::{RenderOptions, Rendered, Upstream, backward, render};
use garad::synth::SceneName;

use crate::canvas::{BLACK, BLUE, Canvas, GRAY, ORANGE, PALE, ink, signed};
use crate::chart::Chart;
use crate::features::scene;
use crate::{Drawn, par};

/// The Gaussian of chapter 9, tilted, seen by a camera of 24 x 18 pixels.
fn tilted() -> (GaussianMap<f64>, Result<Camera, garad::core::CameraError>) {
    let mut map = GaussianMap::<f64>::new(0);
    map.push(&NewGaussian {
        mean: [0.05, -0.03, 1.5],
        sigma_m: 0.1,
        opacity: 0.77,
        color: [0.9, 0.45, 0.1],
        landmark: None,
        born: KeyframeId(0),
    });
    map.quaternions[0] = [0.9, 0.2, -0.3, 0.25];
    map.log_scales[0] = [0.22, 0.09, 0.05].map(Real::ln);
    let camera = Camera::pinhole((24, 18), [25.0, 27.0, 11.5, 8.5]);
    (map, camera)
}

/// Its picture, the ellipses of 1, 2 and 3 sigma, where alpha is 1/255, and the footprint.
pub(crate) fn one_splat() -> Drawn {
    let (map, camera) = tilted();
    let options = RenderOptions {
        background: [1.0; 3],
        ..RenderOptions::default()
    };
    let drawn = render(&map, &camera?, &Se3::identity(), &options, Par::Seq)?;
    let splat = drawn.projected[0];
    let (zoom, left, top) = (26.0, 10.0, 10.0);
    let mut canvas = Canvas::new(900, 490);
    canvas.paste(&color_image(&narrow(&drawn)), [10, 10], 26);
    let at = |x: f64, y: f64| [left + zoom * (x + 0.5), top + zoom * (y + 0.5)];
    let reach = (2.0 * Real::ln(255.0 * splat.opacity)).sqrt();
    let rings = [(1.0, BLACK), (2.0, BLACK), (3.0, BLACK), (reach, BLUE)];
    for (sigmas, color) in rings {
        let ring: Vec<[f64; 2]> = (0..=160)
            .map(|k| {
                // d with A (dx + shear dy)^2 + dy^2 / var_y = sigmas^2.
                let (sin, cos) = Real::sin_cos(std::f64::consts::TAU * f64::from(k) / 160.0);
                let dy = sigmas * sin / splat.inv_var_y.sqrt();
                let dx = sigmas * cos / splat.conic[0].sqrt() - splat.shear * dy;
                at(splat.mean_px[0] + dx, splat.mean_px[1] + dy)
            })
            .collect();
        canvas.path(&ring, 1.5, color);
    }
    canvas.disc(at(splat.mean_px[0], splat.mean_px[1]), 3.0, BLACK);
    let f = splat.footprint;
    let corner = |x: usize, y: usize| at(x as f64 - 0.5, y as f64 - 0.5);
    canvas.rect(corner(f.x0, f.y0), corner(f.x1, f.y1), 3.0, ORANGE);
    canvas.rect(corner(0, 0), corner(24, 18), 1.0, GRAY);
    let lines = [
        ("1, 2, 3 sigma", BLACK),
        ("alpha = 1/255", BLUE),
        ("footprint", ORANGE),
        ("", BLACK),
        ("mean (12.33, 7.96)", BLACK),
        ("radius 9 px", BLACK),
    ];
    for (i, (text, color)) in lines.into_iter().enumerate() {
        canvas.text([660.0, 20.0 + 26.0 * i as f64], text, color);
    }
    Ok(canvas.picture)
}

#[allow(clippy::cast_possible_truncation, reason = "a picture to look at")]
fn narrow(drawn: &Rendered<f64>) -> Rendered<f32> {
    let thin = |image: &Image<f64>| image.map(|v| *v as f32);
    Rendered {
        color: drawn.color.map(|c| c.map(|v| v as f32)),
        depth: thin(&drawn.depth),
        opacity: thin(&drawn.opacity),
        transmittance: thin(&drawn.transmittance),
        contributors: drawn.contributors.clone(),
        last: drawn.last.clone(),
        radii: drawn.radii.clone(),
        projected: Vec::new(),
    }
}

/// Four splats behind each other along one ray: alpha, the light that is left, the weights.
pub(crate) fn along_a_ray() -> Drawn {
    let splats = [
        (1.0, 0.5, [0.84, 0.37, 0.0]),
        (1.6, 0.4, [0.0, 0.62, 0.45]),
        (2.5, 0.8, [0.0, 0.45, 0.7]),
        (3.2, 0.6, [0.8, 0.47, 0.65]),
    ];
    let mut map = GaussianMap::<f64>::new(0);
    for (z, opacity, color) in splats {
        map.push(&NewGaussian {
            mean: [0.0, 0.0, z],
            sigma_m: 0.1 * z,
            opacity,
            color,
            landmark: None,
            born: KeyframeId(0),
        });
    }
    let camera = Camera::pinhole((33, 33), [40.0, 40.0, 16.0, 16.0])?;
    let drawn = render(
        &map,
        &camera,
        &Se3::identity(),
        &RenderOptions::default(),
        Par::Seq,
    )?;
    let mut canvas = Canvas::new(760, 330);
    let chart = Chart::new(
        &mut canvas,
        [[50.0, 34.0], [560.0, 290.0]],
        [[0.5, 4.0], [0.0, 1.0]],
        [&[1.0, 2.0, 3.0, 4.0], &[0.0, 0.5, 1.0]],
        |v| format!("{v}"),
    );
    canvas.text(
        [50.0, 8.0],
        "along the ray of the middle pixel, z in m",
        BLACK,
    );
    let mut light = 1.0;
    let mut steps = vec![[0.5, light]];
    for (z, opacity, color) in splats {
        let rgb = color.map(|v: f64| (255.0 * v) as u8);
        canvas.line(chart.at([z, 0.0]), chart.at([z, opacity]), 3.0, rgb);
        let (low, high) = (
            chart.at([z + 0.2, 0.0]),
            chart.at([z + 0.07, light * opacity]),
        );
        canvas.area([high[0], high[1]], [low[0], low[1]], rgb);
        canvas.circle(chart.at([z, opacity]), 5.0, 2.0, rgb);
        steps.push([z, light]);
        light *= 1.0 - opacity;
        steps.push([z, light]);
    }
    steps.push([4.0, light]);
    chart.curve(&mut canvas, &steps, 2.5, BLACK);
    let at_center = drawn.color[(16, 16)].map(|v| (255.0 * v) as u8);
    canvas.text([590.0, 40.0], "ring: α", BLACK);
    canvas.text([590.0, 66.0], "bar: α T", BLACK);
    canvas.text([590.0, 92.0], "line: T", BLACK);
    canvas.text([590.0, 140.0], "the pixel:", BLACK);
    canvas.area([590.0, 170.0], [700.0, 230.0], at_center);
    let left = drawn.transmittance[(16, 16)];
    canvas.text([590.0, 250.0], &format!("T = {left:.3}"), BLACK);
    Ok(canvas.picture)
}

/// The tilted Gaussian, and what its picture does if it moves to the right or one axis grows: each
/// pixel's derivative from a backward pass that asks for this pixel alone.
pub(crate) fn gradient_by_mean() -> Drawn {
    let (map, camera) = tilted();
    let camera = camera?;
    let (pose, options) = (Se3::identity(), RenderOptions::default());
    let drawn = render(&map, &camera, &pose, &options, Par::Seq)?;
    let (width, height) = drawn.color.size();
    let mut by = [0, 1, 2].map(|_| Image::new(width, height, 0.0f64));
    for (x, y) in (0..height).flat_map(|y| (0..width).map(move |x| (x, y))) {
        let mut color = Image::new(width, height, [0.0; 3]);
        color[(x, y)] = [1.0; 3];
        let one = Upstream {
            color,
            depth: None,
            opacity: None,
        };
        let g = backward(&map, &camera, &pose, &options, &drawn, &one, Par::Seq)?;
        by[0][(x, y)] = g.means[0][0];
        by[1][(x, y)] = g.log_scales[0][0];
        by[2][(x, y)] = g.opacity_logits[0];
    }
    let zoom = 9;
    let mut canvas = Canvas::new(4 * (zoom * width + 10), zoom * height + 36);
    canvas.text([4.0, 8.0], "picture", BLACK);
    let gray = drawn.opacity.map(|o| ink(*o));
    canvas.paste(&gray, [2, 32], zoom);
    let titles = ["by the mean, x", "by a log-scale", "by the opacity"];
    for (k, (image, title)) in by.iter().zip(titles).enumerate() {
        let left = (k + 1) * (zoom * width + 10);
        canvas.text([left as f64 + 4.0, 8.0], title, BLACK);
        let largest = image.data().iter().fold(0.0f64, |m, v| m.max(v.abs()));
        canvas.paste(&image.map(|v| signed(v / largest)), [left + 2, 32], zoom);
    }
    for k in 0..4 {
        let left = (k * (zoom * width + 10)) as f64 + 1.0;
        let right = left + (zoom * width) as f64 + 1.0;
        canvas.rect(
            [left, 31.0],
            [right, 33.0 + (zoom * height) as f64],
            1.0,
            PALE,
        );
    }
    Ok(canvas.picture)
}

/// A picture, made brighter and made noisy by the same mean square: what SSIM says of the two.
pub(crate) fn two_kinds_of_error() -> Drawn {
    let frame = scene(SceneName::QuietDesk)?.frame(8, par());
    let crop = Image::from_fn(200, 150, |x, y| {
        frame.rgb[(x + 110, y + 100)].map(|v| f32::from(v) / 255.0)
    });
    let mut rng = Rng::new(1);
    let error = 0.06f32;
    let brighter = crop.map(|p| p.map(|v| v + error));
    let noisy = crop.map(|p| p.map(|v| v + error * rng.normal() as f32));
    let blurred = Image::from_fn(200, 150, |x, y| {
        let mut sum = [0.0f32; 3];
        for (dx, dy) in (0..9).flat_map(|dy| (0..9).map(move |dx| (dx, dy))) {
            let p = crop[(
                (x + dx).saturating_sub(4).min(199),
                (y + dy).saturating_sub(4).min(149),
            )];
            for (sum, v) in sum.iter_mut().zip(p) {
                *sum += v / 81.0;
            }
        }
        sum
    });
    let mut canvas = Canvas::new(4 * 212, 386);
    let cases = [
        ("target", &crop),
        ("brighter", &brighter),
        ("noise", &noisy),
        ("blurred", &blurred),
    ];
    for (k, (title, picture)) in cases.into_iter().enumerate() {
        let left = 6 + 212 * k;
        let bytes: RgbImage = picture.map(|p| p.map(|v| (v.clamp(0.0, 1.0) * 255.0 + 0.5) as u8));
        canvas.text([left as f64, 6.0], title, BLACK);
        canvas.paste(&bytes, [left, 28], 1);
        if k == 0 {
            canvas.text([left as f64, 210.0], "black where the", GRAY);
            canvas.text([left as f64, 232.0], "structure is lost", GRAY);
            continue;
        }
        let map = ssim_map(picture, &crop, par())?;
        canvas.paste(&map.map(|s| ink(1.0 - s)), [left, 184], 1);
        let (db, s) = (
            psnr_db(picture, &crop, None)?,
            ssim(picture, &crop, None, par())?,
        );
        canvas.text([left as f64, 342.0], &format!("psnr {db:.1}"), BLUE);
        canvas.text([left as f64, 364.0], &format!("ssim {s:.3}"), ORANGE);
    }
    Ok(canvas.picture)
}
