//! `garad render`: a map rendered from a pose or along a trajectory.

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::ValueEnum;
use garad::images;
use garad::output::ResultFolder;
use garad::progress::Progress;
use garad_core::{Camera, Par, Se3, So3, StampedPose};
use garad_dataset::{Calibration, Preset};
use garad_raster::{Include, RenderOptions, fast};
use nalgebra::Vector3;

use super::{WorkArgs, read_poses, say};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The map, 3DGS PLY.
    map: PathBuf,
    /// Folder for the images.
    #[arg(short = 'o', long = "out", value_name = "DIR")]
    out: PathBuf,
    /// One pose, world from camera: "tx ty tz qx qy qz qw".
    #[arg(long, value_name = "POSE", value_parser = pose, conflicts_with = "trajectory",
          allow_hyphen_values = true)]
    pose: Option<Se3>,
    /// Poses, TUM format; an image each.
    #[arg(long, value_name = "FILE")]
    trajectory: Option<PathBuf>,
    /// Render every Nth pose of the trajectory.
    #[arg(long, default_value_t = 1)]
    every: usize,
    /// Camera by name: freiburg1, freiburg2, freiburg3, bonn.
    #[arg(long, conflicts_with = "calibration")]
    preset: Option<Preset>,
    /// Camera by file: `width height fx fy cx cy depth_factor fps`.
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// What to render.
    #[arg(long, value_enum, default_values_t = [What::Color])]
    what: Vec<What>,
    /// Which Gaussians.
    #[arg(long, value_enum, default_value_t = Which::All)]
    include: Which,
    #[command(flatten)]
    work: WorkArgs,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum What {
    Color,
    Depth,
    Opacity,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Which {
    All,
    Static,
    Dynamic,
}

fn pose(text: &str) -> Result<Se3, String> {
    let numbers: Vec<f64> = text
        .split_whitespace()
        .map(|v| v.parse().map_err(|_| format!("`{v}` is not a number")))
        .collect::<Result<_, _>>()?;
    let [tx, ty, tz, qx, qy, qz, qw] = numbers[..] else {
        return Err(format!(
            "{} numbers; expected tx ty tz qx qy qz qw",
            numbers.len()
        ));
    };
    let rotation =
        So3::from_quaternion(qw, qx, qy, qz).ok_or("the quaternion is zero or not finite")?;
    let pose = Se3::new(rotation, Vector3::new(tx, ty, tz));
    if pose.is_finite() {
        Ok(pose)
    } else {
        Err("a number is not finite".to_owned())
    }
}

pub(crate) fn run(args: &Args) -> Result<()> {
    let map = garad_dataset::read_ply(&args.map)?;
    let camera = camera(args)?;
    let poses = poses(args)?;
    let mut out = ResultFolder::open(&args.out, "render")?;
    let options = RenderOptions {
        include: match args.include {
            Which::All => Include::All,
            Which::Static => Include::StaticOnly,
            Which::Dynamic => Include::DynamicOnly,
        },
        ..RenderOptions::default()
    };
    let mut progress = Progress::new("drawing", poses.len(), args.work.quiet);
    for (i, pose) in poses.iter().enumerate() {
        let camera_from_world = pose.world_from_camera.inverse();
        let rendered = fast::render(
            &map,
            &camera,
            &camera_from_world,
            &options,
            Par::new(args.work.threads),
        )?;
        for what in &args.what {
            let (name, image) = match what {
                What::Color => ("color", images::color_image(&rendered)),
                What::Opacity => ("opacity", images::opacity_image(&rendered)),
                What::Depth => {
                    let depth = rendered.normalized_depth();
                    let range = images::depth_range(&depth);
                    ("depth", images::depth_image(&depth, range))
                }
            };
            let file = format!("{i:06}_{name}.png");
            out.write(&file, |path| images::save_png(path, &image));
        }
        progress.step("");
    }
    progress.finish();
    out.finish()?;
    if !args.work.quiet {
        let (n, count) = (map.len(), poses.len());
        say(&format!(
            "{count} pose(s), {n} Gaussians, images in {}",
            args.out.display()
        ))?;
    }
    Ok(())
}

fn camera(args: &Args) -> Result<Camera> {
    if let Some(preset) = args.preset {
        return Ok(preset.calibration().camera);
    }
    let Some(path) = &args.calibration else {
        bail!("no camera; expected --preset NAME or --calibration FILE");
    };
    Ok(Calibration::read(path)?.camera)
}

fn poses(args: &Args) -> Result<Vec<StampedPose>> {
    if let Some(world_from_camera) = args.pose {
        return Ok(vec![StampedPose {
            t_s: 0.0,
            world_from_camera,
        }]);
    }
    let Some(path) = &args.trajectory else {
        bail!("no pose; expected --pose \"tx ty tz qx qy qz qw\" or --trajectory FILE");
    };
    let poses = read_poses(path)?;
    Ok(poses.into_iter().step_by(args.every.max(1)).collect())
}

#[cfg(test)]
mod tests {
    use super::pose;

    #[test]
    fn poses_are_parsed_or_refused_with_a_reason() {
        let read = pose("1 2 3 0 0 0 2").expect("any length of quaternion");
        assert_eq!(read.translation.z.to_bits(), 3.0f64.to_bits(), "tz");
        assert!(
            pose("1 2 3").expect_err("too few").contains("3 numbers"),
            "count"
        );
        assert!(
            pose("a 2 3 0 0 0 1").expect_err("letter").contains("`a`"),
            "names it"
        );
        assert!(pose("0 0 0 0 0 0 0").is_err(), "zero quaternion");
        assert!(pose("NaN 0 0 0 0 0 1").is_err(), "NaN");
    }
}
