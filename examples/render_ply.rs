//! A map in the standard layout of 3D Gaussian Splatting, read and drawn (chapter 9 of the book).
//! Without arguments a small map is made, written and read back.
//!
//! `cargo run --release --example render_ply [-- MAP.ply]`
#![allow(clippy::print_stdout, reason = "an example speaks to its reader")]

use std::error::Error;
use std::path::PathBuf;

use garad::core::{Camera, GaussianMap, KeyframeId, NewGaussian, Par, Real, Se3, So3};
use garad::dataset::{PlyOptions, read_ply, write_ply};
use garad::images::{color_image, save_png};
use garad::raster::{RenderOptions, fast};
use nalgebra::Vector3;

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::temp_dir();
    let path = match std::env::args_os().nth(1) {
        Some(path) => PathBuf::from(path),
        None => {
            let path = folder.join("garad_helix.ply");
            write_ply(&path, &helix(), &PlyOptions::default())?;
            path
        }
    };
    let map = read_ply(&path)?;
    let camera = Camera::pinhole((320, 240), [260.0, 260.0, 159.5, 119.5])?;
    // From a little above, looking down on what lies 3.5 m ahead.
    let tilt = So3::exp(&Vector3::new(-0.4, 0.0, 0.0));
    let target = Vector3::new(0.0, 0.0, 3.5);
    let camera_from_world = Se3::new(tilt, target - tilt * target);
    let options = RenderOptions::default();
    let picture = fast::render(&map, &camera, &camera_from_world, &options, Par::new(2))?;
    let out = folder.join("garad_render_ply.png");
    save_png(&out, &color_image(&picture))?;

    println!(
        "{}: {} Gaussians of degree {}",
        path.display(),
        map.len(),
        map.sh_degree()
    );
    println!(
        "{}: {} of them visible",
        out.display(),
        picture.projected.len()
    );
    // The same picture for the terminal: opacity in ten shades, one character per 5 x 10 pixels.
    for y in (5..camera.height).step_by(10) {
        let shade = |x: usize| {
            let tenths = 10.0 * picture.opacity[(x, y)];
            let full = (1u8..10).filter(|k| tenths >= f32::from(*k)).count();
            " .:-=+*#%@".chars().nth(full).unwrap_or('@')
        };
        let line: String = (2..camera.width).step_by(5).map(shade).collect();
        println!("{}", line.trim_end());
    }
    Ok(())
}

/// Two turns of a helix, its colour going from red to blue.
fn helix() -> GaussianMap<f32> {
    let mut map = GaussianMap::new(0);
    let steps = 120;
    for i in 0..steps {
        let share = i as f32 / (steps - 1) as f32;
        let (sin, cos) = Real::sin_cos(4.0 * std::f32::consts::PI * share);
        map.push(&NewGaussian {
            mean: [cos, 1.0 - 2.0 * share, 3.5 + sin],
            sigma_m: 0.05,
            opacity: 0.9,
            color: [1.0 - share, 0.3, share],
            landmark: None,
            born: KeyframeId(0),
        });
    }
    map
}
