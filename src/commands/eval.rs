//! `garad eval`: results evaluated.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::{Args, Subcommand, ValueEnum};
use garad_dataset::write_bytes_atomically;
use garad_eval::plot::{trajectory_panel, widest_planes};
use garad_eval::{Alignment, Ate, AteOptions, RpeDelta, RpeOptions, Stats, ate, jitter, rpe};

use nalgebra::Vector3;

use super::{eval_render, read_poses, say};

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Absolute and relative trajectory error and jitter of an estimate.
    Trajectory(TrajectoryArgs),
    /// PSNR and SSIM of the map over all frames, rendered from their estimated poses.
    Render(eval_render::Args),
}

#[derive(Debug, Args)]
pub(crate) struct TrajectoryArgs {
    /// Ground truth, TUM format.
    ground_truth: PathBuf,
    /// Estimate, TUM format.
    estimate: PathBuf,
    /// Largest time difference of a pair, seconds.
    #[arg(long, default_value_t = garad_eval::MAX_DT_S)]
    max_dt: f64,
    /// Alignment before errors are measured.
    #[arg(long, value_enum, default_value_t = Align::Rigid)]
    align: Align,
    /// Interval of the relative error, seconds.
    #[arg(long, default_value_t = 1.0)]
    rpe_delta: f64,
    /// JSON instead of a table.
    #[arg(long)]
    json: bool,
    /// Also draws both trajectories into this SVG file.
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Align {
    /// No alignment.
    None,
    /// Rotation and translation.
    Rigid,
    /// Rotation, translation and scale.
    Sim3,
}

pub(crate) fn run(command: &Command) -> Result<()> {
    match command {
        Command::Trajectory(args) => trajectory(args),
        Command::Render(args) => eval_render::run(args),
    }
}

fn trajectory(args: &TrajectoryArgs) -> Result<()> {
    let ground_truth = read_poses(&args.ground_truth)?;
    let estimate = read_poses(&args.estimate)?;
    let options = AteOptions {
        alignment: match args.align {
            Align::None => Alignment::None,
            Align::Rigid => Alignment::Rigid,
            Align::Sim3 => Alignment::Similarity,
        },
        max_dt_s: args.max_dt,
    };
    let judged = ate(&ground_truth, &estimate, &options).with_context(|| {
        format!(
            "{} against {}",
            args.estimate.display(),
            args.ground_truth.display()
        )
    })?;
    let scale = judged.truth_from_estimate.scale;
    let relative = rpe(
        &ground_truth,
        &estimate,
        &RpeOptions {
            delta: RpeDelta::Seconds(args.rpe_delta),
            max_dt_s: args.max_dt,
        },
    );
    let jitter = jitter(&ground_truth, &estimate, args.max_dt);
    if let Some(path) = &args.plot {
        let [plane, _] = widest_planes(&judged.points);
        let svg = trajectory_panel(&judged.points, plane, &[])?;
        write_bytes_atomically(path, svg.as_bytes())?;
    }
    if args.json {
        let figures = serde_json::json!({
            "protocol": options.describe(),
            "scale": scale,
            "ate": to_json(&judged.stats),
            "rpe": relative.as_ref().ok().filter(|r| !r.is_of_another_body()).map(|r| serde_json::json!({
                "interval_s": args.rpe_delta,
                "trans_m": to_json(&r.trans_m),
                "rot_deg": to_json(&r.rot_deg),
            })),
            "jitter": jitter.as_ref().ok().map(|j| serde_json::json!({
                "rms_m": j.rms_m,
                "ground_truth_rms_m": j.ground_truth_rms_m,
                "triples": j.triples,
            })),
        });
        return say(&serde_json::to_string_pretty(&figures)?);
    }
    say(&format!(
        "protocol   {}, {} pairs",
        options.describe(),
        judged.stats.pairs
    ))?;
    if options.alignment == Alignment::Similarity {
        let doubt = match explains_half(&judged) {
            true => "",
            false => {
                "; uncertain: the aligned estimate explains less than half of the reference's motion"
            }
        };
        say(&format!(
            "scale      {scale:.6}, by which the estimate was multiplied{doubt}"
        ))?;
    }
    say(&format!("ATE [m]    {}", row(&judged.stats)))?;
    match relative {
        Ok(relative) if relative.is_of_another_body() => say(
            "RPE        left out: the reference turns by the estimate's angles about other axes, so it is of another body",
        )?,
        Ok(relative) => {
            let per = format!("per {} s", args.rpe_delta);
            say(&format!("RPE [m]    {}  {per}", row(&relative.trans_m)))?;
            say(&format!("RPE [deg]  {}  {per}", row(&relative.rot_deg)))?;
        }
        Err(error) => say(&format!("RPE        cannot be judged: {error}"))?,
    }
    match jitter {
        Ok(jitter) => say(&format!(
            "jitter [mm]  rms {:.3}, of the ground truth {:.3}  ({} triples)",
            1e3 * jitter.rms_m,
            1e3 * jitter.ground_truth_rms_m,
            jitter.triples
        )),
        Err(error) => say(&format!("jitter     cannot be judged: {error}")),
    }
}

/// Whether the squared error is below half of the reference's own variance.
fn explains_half(judged: &Ate) -> bool {
    let points = &judged.points;
    let sum = points
        .iter()
        .fold(Vector3::zeros(), |sum, p| sum + p.ground_truth);
    let mean = sum / points.len() as f64;
    let variance = points
        .iter()
        .fold(0.0, |sum, p| sum + (p.ground_truth - mean).norm_squared());
    judged.stats.sse < 0.5 * variance
}

fn row(s: &Stats) -> String {
    format!(
        "rmse {:.6}  mean {:.6}  median {:.6}  std {:.6}  min {:.6}  max {:.6}",
        s.rmse, s.mean, s.median, s.std, s.min, s.max
    )
}

fn to_json(s: &Stats) -> serde_json::Value {
    serde_json::json!({
        "rmse": s.rmse, "mean": s.mean, "median": s.median, "std": s.std,
        "min": s.min, "max": s.max, "sse": s.sse, "pairs": s.pairs,
    })
}
