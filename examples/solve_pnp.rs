//! Where is the camera, if 40 of 100 matches are wrong and nobody says where to look? Three points at
//! a time, then Levenberg-Marquardt on what agrees (chapters 6 and 8 of the book).
//!
//! `cargo run --release --example solve_pnp`
#![allow(clippy::print_stdout, reason = "an example speaks to its reader")]

use std::error::Error;

use garad::core::{Camera, Par, Rng, Se3};
use garad::optim::{PnpConfig, PoseObservation, solve_pnp_ransac};
use nalgebra::{Vector2, Vector3, Vector6};

fn main() -> Result<(), Box<dyn Error>> {
    let camera = Camera::pinhole((640, 480), [525.0, 525.0, 319.5, 239.5])?;
    let camera_from_world = Se3::exp(&Vector6::new(0.3, -0.2, 0.5, 0.1, 0.4, -0.2));
    let mut rng = Rng::new(3);
    let mut observations = Vec::new();
    for i in 0..100 {
        // A point that the camera sees, and its pixel with an error of half a pixel ...
        let pixel = Vector2::new(rng.range(0.0, 639.0), rng.range(0.0, 479.0));
        let p_cam = camera.unproject(&pixel, rng.range(1.0, 5.0));
        let mut uv_px = pixel + Vector2::new(rng.normal(), rng.normal()) * 0.5;
        // ... or, for four in ten, just anywhere.
        if i % 5 < 2 {
            uv_px = Vector2::new(rng.range(0.0, 639.0), rng.range(0.0, 479.0));
        }
        observations.push(PoseObservation {
            p_world: camera_from_world.inverse() * p_cam,
            uv_px,
            sigma_px: 0.5,
            depth: None,
        });
    }
    let found = solve_pnp_ransac(&camera, &observations, &PnpConfig::default(), Par::Seq)?
        .ok_or("no pose has enough matches that agree")?;

    let wrong_kept = (0..100).filter(|i| i % 5 < 2 && found.inlier[*i]).count();
    let error: Vector6<f64> = (found.camera_from_world * camera_from_world.inverse()).log();
    let moved: Vector3<f64> = error.fixed_rows::<3>(0).into();
    let turned: Vector3<f64> = error.fixed_rows::<3>(3).into();
    println!("triples drawn: {}", found.samples);
    println!(
        "matches that agree: {} of 100, {wrong_kept} of them wrong",
        found.n_inliers
    );
    println!(
        "pose is off by {:.2} mm and {:.3} degrees",
        1e3 * moved.norm(),
        turned.norm().to_degrees()
    );
    Ok(())
}
