//! The pictures of the book, made by the code that the book is about.
//!
//! `cargo run --release --example book_pictures -- docs/book/src/images`
//!
//! The same bytes on every run and machine. With names after the folder only those are drawn.
#![allow(
    clippy::print_stdout,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "an example that draws: it says what it wrote, and numbers become pixels"
)]

use std::error::Error;
use std::path::PathBuf;

use garad::core::{Par, RgbImage};
use garad::images::save_png;

mod canvas;
mod chart;
mod features;
mod maps;
mod moving;
mod paper_loop;
mod poses;
mod splats;
mod training;

type Draw = fn() -> Drawn;
type Drawn = Result<RgbImage, Box<dyn Error>>;

/// No picture depends on it.
fn par() -> Par {
    Par::new(2)
}

/// File name and who draws it, in the order of the chapters.
const PICTURES: &[(&str, Draw)] = &[
    ("pixels", features::pixels),
    ("keypoints", features::keypoints),
    ("matches", features::matches),
    ("tracks", features::tracks),
    ("flow_check", moving::flow_check),
    ("pose", poses::kernels_and_damping),
    ("field", moving::field),
    ("loop_nodes", paper_loop::nodes),
    ("loop_levels", paper_loop::levels),
    ("loop_suspects", paper_loop::suspects),
    ("depth_rays", paper_loop::depth_rays),
    ("bundle", maps::bundle),
    ("loop", maps::closed_loop),
    ("splat", splats::one_splat),
    ("ray", splats::along_a_ray),
    ("gradient", splats::gradient_by_mean),
    ("losses", splats::two_kinds_of_error),
    ("training", training::coarse_to_fine),
    ("orders", training::orders_of_a_sum),
    ("ate", maps::trajectory_error),
];

fn main() -> Result<(), Box<dyn Error>> {
    let mut args = std::env::args_os().skip(1);
    let folder = PathBuf::from(args.next().ok_or("which folder?")?);
    let wanted: Vec<String> = args
        .map(|name| name.to_string_lossy().into_owned())
        .collect();
    std::fs::create_dir_all(&folder)?;
    for (name, draw) in PICTURES {
        if wanted.is_empty() || wanted.iter().any(|w| w == name) {
            let path = folder.join(format!("{name}.png"));
            save_png(&path, &draw()?)?;
            println!(
                "{}: {} bytes",
                path.display(),
                std::fs::metadata(&path)?.len()
            );
        }
    }
    Ok(())
}
