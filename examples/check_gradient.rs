//! Is the gradient the derivative? Every parameter of a small map, and the pose, against central
//! differences of the picture (chapter 10 of the book).
//!
//! `cargo run --release --example check_gradient`
#![allow(clippy::print_stdout, reason = "an example speaks to its reader")]

use garad::core::{Camera, GaussianMap, KeyframeId, NewGaussian, Par, Se3};
use garad::raster::{RasterError, RenderOptions, Upstream, backward, render};
use nalgebra::Vector6;

const STEP: f64 = 1e-6;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let camera = Camera::pinhole((24, 18), [22.0, 22.0, 11.3, 8.6])?;
    let mut map = GaussianMap::<f64>::new(1);
    let red = NewGaussian {
        mean: [-0.1, 0.05, 1.4],
        sigma_m: 0.25,
        opacity: 0.7,
        color: [0.8, 0.4, 0.2],
        landmark: None,
        born: KeyframeId(0),
    };
    map.push(&red);
    map.push(&NewGaussian {
        mean: [0.15, -0.1, 1.9],
        ..red
    });
    map.quaternions = vec![[0.9, 0.2, -0.3, 0.25], [0.7, -0.1, 0.5, 0.3]];
    map.log_scales[0][0] += 0.5;
    map.sh[2] = [0.1, -0.2, 0.15];
    let (pose, options) = (Se3::identity(), RenderOptions::default());

    // L is half the sum of the squares of the picture, so its gradient by the picture is the picture.
    let loss = |map: &GaussianMap<f64>, pose: &Se3| -> Result<f64, RasterError> {
        let drawn = render(map, &camera, pose, &options, Par::Seq)?;
        let values = drawn.color.data().as_flattened().iter();
        Ok(values.map(|v| 0.5 * v * v).sum())
    };
    let drawn = render(&map, &camera, &pose, &options, Par::Seq)?;
    let (color, depth, opacity) = (drawn.color.clone(), None, None);
    let above = Upstream {
        color,
        depth,
        opacity,
    };
    let g = backward(&map, &camera, &pose, &options, &drawn, &above, Par::Seq)?;
    let groups = [
        ("means", g.means.as_flattened()),
        ("log-scales", g.log_scales.as_flattened()),
        ("quaternions", g.quaternions.as_flattened()),
        ("opacities", &g.opacity_logits),
        ("harmonics", g.sh.as_flattened()),
        ("pose", &g.pose),
    ];
    println!("parameter    numbers  largest gradient  worst difference, of that");
    for (name, gradient) in groups {
        let at = |i: usize, h: f64| {
            let (mut moved, mut xi) = (map.clone(), Vector6::zeros());
            match name {
                "means" => moved.means.as_flattened_mut()[i] += h,
                "log-scales" => moved.log_scales.as_flattened_mut()[i] += h,
                "quaternions" => moved.quaternions.as_flattened_mut()[i] += h,
                "opacities" => moved.opacity_logits[i] += h,
                "harmonics" => moved.sh.as_flattened_mut()[i] += h,
                _ => xi[i] = h,
            }
            loss(&moved, &(Se3::exp(&xi) * pose))
        };
        let largest = gradient.iter().fold(0.0f64, |m, g| m.max(g.abs()));
        let mut worst = 0.0f64;
        for (i, g) in gradient.iter().enumerate() {
            worst = worst.max(((at(i, STEP)? - at(i, -STEP)?) / (2.0 * STEP) - g).abs());
        }
        let (numbers, share) = (gradient.len(), worst / largest);
        println!("{name:<12}{numbers:>8}{largest:>18.2}{share:>18.0e}");
    }
    Ok(())
}
