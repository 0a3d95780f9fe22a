//! `garad eval render`: image quality of a finished map.

use std::path::PathBuf;

use anyhow::{Context, Result};
use garad::render_quality;
use garad_core::Par;
use garad_dataset::write_bytes_atomically;
use garad_eval::{Metrics, RenderMetrics};

use super::input::{InputArgs, Masks, frames};
use super::{WorkArgs, read_poses, say};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// What `garad run` wrote: map.ply, trajectory.txt, metrics.json.
    out: PathBuf,
    /// The recording it ran on.
    dataset: PathBuf,
    #[command(flatten)]
    input: InputArgs,
    /// Masks (255 moving): also evaluates the pixels outside them. Default: the recording's own, if it
    /// has any.
    #[arg(long, value_name = "DIR")]
    masks: Option<PathBuf>,
    #[command(flatten)]
    work: WorkArgs,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    let map = garad_dataset::read_ply(&args.out.join("map.ply"))?;
    let trajectory = read_poses(&args.out.join("trajectory.txt"))?;
    let dataset = args.input.open(&args.dataset)?;
    let masks = match &args.masks {
        Some(dir) => Some(Masks::find(&dataset, &args.dataset, dir)?),
        None => Masks::of_recording(&dataset),
    };
    let quality = render_quality::judge(
        &map,
        &dataset.calibration().camera,
        &trajectory,
        frames(&dataset, None, masks.as_ref()),
        Par::new(args.work.threads),
        args.work.quiet,
    )?;
    let row = |m: &RenderMetrics| match (m.psnr_db, m.ssim) {
        (Some(psnr), Some(ssim)) => format!("PSNR {psnr:.2} dB  SSIM {ssim:.4}"),
        _ => "cannot be judged".to_owned(),
    };
    say(&format!(
        "protocol       means over {} frames at estimated poses, static Gaussians",
        quality.frames
    ))?;
    say(&format!("whole image    {}", row(&quality.all)))?;
    if masks.is_some() {
        say(&format!("outside masks  {}", row(&quality.outside_mask)))?;
    }

    if let (Some(l1_m), Some(coverage)) = (quality.depth.l1_m, quality.depth.coverage) {
        let percent = 100.0 * coverage;
        say(&format!(
            "depth          L1 {l1_m:.4} m where both are known, {percent:.1} % of measured pixels"
        ))?;
    }
    if let Some(ghosts) = quality.depth.ghosts {
        let percent = 100.0 * ghosts;
        say(&format!(
            "ghosts         {percent:.2} % of static pixels stand more than 10 cm in front"
        ))?;
    }

    let path = args.out.join("metrics.json");
    if let Ok(text) = std::fs::read_to_string(&path) {
        let mut metrics = Metrics::from_json(&text).with_context(|| path.display().to_string())?;
        metrics.render = quality.all;
        metrics.render_static = quality.outside_mask;
        metrics.render_depth = quality.depth;
        write_bytes_atomically(&path, metrics.to_json().as_bytes())?;
    }
    Ok(())
}
