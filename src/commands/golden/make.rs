//! `garad golden make`.

use std::path::PathBuf;

use anyhow::{Result, bail};
use clap::{Args, ValueEnum};
use garad_conformance::make::{Other, SPLATTING, SceneKind, SceneOptions, splatting};
use garad_core::Par;

use crate::commands::say;

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Kind {
    /// Flat discs on the walls of a room, thirty deep, mostly opaque.
    Room,
    /// A hundred times as long as wide.
    Needles,
    /// Large and faint: hundreds deep, few pixels end early.
    Soft,
    /// Half of them behind one another at three places: crowded tiles beside empty ones.
    Stack,
}

#[derive(Debug, Args)]
pub(crate) struct MakeArgs {
    /// Stage; may be given several times. Besides raster and raster_backward, which are of one scene: lk, orb, matching,
    /// mean_field, losses, adam, train_step [default: raster and raster_backward].
    #[arg(long, value_name = "S")]
    stage: Vec<String>,
    /// For raster and raster_backward: what the scene is made of.
    #[arg(long, value_enum, default_value = "room")]
    scene: Kind,
    /// Gaussians of the scene.
    #[arg(long, value_name = "N", default_value_t = 10_000)]
    gaussians: usize,
    /// Degree of their spherical harmonics, 0 to 3.
    #[arg(long, value_name = "D", default_value_t = 3, value_parser = clap::value_parser!(u8).range(0..=3))]
    sh: u8,
    /// Of the images.
    #[arg(long, value_name = "WxH", default_value = "640x480")]
    size: String,
    /// For the other stages: how many points (lk: 2000), features (orb: 5000), descriptors (matching: 5000), nodes
    /// (mean_field: 2000), parameters (adam: 100000), Gaussians (train_step: 20000).
    #[arg(long, value_name = "N")]
    count: Option<usize>,
    /// Everything random.
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Threads; the case does not depend on them.
    #[arg(long, value_name = "N", default_value_t = 2)]
    threads: usize,
    /// Cases are written to DIR/STAGE/CASE, in place of what was there.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
}

fn size(text: &str) -> Result<[usize; 2]> {
    let sides: Vec<_> = text.split('x').map(str::parse::<usize>).collect();
    let [Ok(width), Ok(height)] = sides[..] else {
        bail!("--size {text}: expected WxH");
    };
    if !(16..=4096).contains(&width) || !(16..=4096).contains(&height) {
        bail!("--size {text}: expected sides from 16 to 4096");
    }
    Ok([width, height])
}

pub(super) fn make(args: &MakeArgs) -> Result<()> {
    let (size, par) = (size(&args.size)?, Par::new(args.threads));
    let asked: Vec<&str> = match args.stage.as_slice() {
        [] => SPLATTING.to_vec(),
        some => some.iter().map(String::as_str).collect(),
    };
    let known = || {
        SPLATTING
            .into_iter()
            .chain(Other::stages().map(|(stage, ..)| stage))
    };
    for stage in &asked {
        if !known().any(|known| known == *stage) {
            let known: Vec<&str> = known().collect();
            bail!("--stage {stage}: expected one of {}", known.join(", "));
        }
    }
    let error = anyhow::Error::from_boxed;
    let mut made = Vec::new();
    if asked.iter().any(|stage| SPLATTING.contains(stage)) {
        let kind = match args.scene {
            Kind::Room => SceneKind::Room,
            Kind::Needles => SceneKind::Needles,
            Kind::Soft => SceneKind::Soft,
            Kind::Stack => SceneKind::Stack,
        };
        let options = SceneOptions {
            kind,
            gaussians: args.gaussians,
            size,
            degree: usize::from(args.sh),
            seed: args.seed,
        };
        let both = splatting(&options, par).map_err(error)?;
        let wanted = SPLATTING.into_iter().zip(both);
        made.extend(
            wanted
                .filter(|(stage, _)| asked.contains(stage))
                .map(|(_, case)| case),
        );
    }
    for (stage, _, count) in Other::stages().filter(|(stage, ..)| asked.contains(stage)) {
        let count = args.count.unwrap_or(count);
        let other = Other {
            size,
            count,
            seed: args.seed,
        };
        made.push(other.make(stage, par).map_err(error)?);
    }
    for case in made {
        say(&case.write(&args.out).map_err(error)?.display().to_string())?;
    }
    Ok(())
}
