//! `garad trace`: records every stage of some frames, and compares two such traces.

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::str::FromStr;

use anyhow::{Result, bail};
use garad::output::ResultFolder;
use garad::progress::note;
use garad::trace;
use garad_golden::trace::diff::{Judge, diff};
use serde_json::json;

use super::input::{InputArgs, Masks, frames};
use super::{PipelineArgs, ProfileArgs, say};

/// Exit code when two traces differ.
const DIFFER: u8 = 1;

#[derive(Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub(crate) struct Args {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    record: Record,
}

#[derive(Debug, clap::Args)]
struct Record {
    /// Folder, .tgz, .tar or .zip of a recording, as `garad run` takes it.
    #[arg(required = true)]
    dataset: Option<PathBuf>,
    /// Frames to record, first and last: `10..12`, or a single one. Earlier frames are run, later ones are
    /// not.
    #[arg(long, value_name = "A..B", required = true)]
    frames: Option<Frames>,
    /// Folder for the trace.
    #[arg(short = 'o', long = "out", value_name = "DIR", required = true)]
    out: Option<PathBuf>,
    #[command(flatten)]
    profile: ProfileArgs,
    #[command(flatten)]
    pipeline: PipelineArgs,
    /// Masks used instead of computed labels, as for `run`.
    #[arg(long, value_name = "DIR")]
    oracle_labels: Option<PathBuf>,
    #[command(flatten)]
    input: InputArgs,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Compare two traces, or a trace and a folder of the same layout. Exit code 0: no difference, 1:
    /// differences, 2: invalid command.
    Diff(Diff),
}

#[derive(Debug, clap::Args)]
struct Diff {
    /// A trace.
    first: PathBuf,
    /// Another trace, or the folder of a port; without a trace.json only existing files are compared.
    second: PathBuf,
    /// Allow each tensor the tolerance of a correct port, instead of no difference at all.
    #[arg(long)]
    tolerances: bool,
}

#[derive(Debug, Clone)]
struct Frames(RangeInclusive<u32>);

impl FromStr for Frames {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (first, last) = text.split_once("..").unwrap_or((text, text));
        let number = |s: &str| s.trim_start_matches('=').parse::<u32>();
        match (number(first), number(last)) {
            (Ok(first), Ok(last)) if first <= last => Ok(Self(first..=last)),
            _ => Err("expected FIRST..LAST, both included, or one frame".to_owned()),
        }
    }
}

pub(crate) fn run(args: &Args) -> Result<ExitCode> {
    match &args.command {
        Some(Command::Diff(args)) => compare(args),
        None => record(&args.record).map(|()| ExitCode::SUCCESS),
    }
}

fn record(args: &Record) -> Result<()> {
    let (Some(path), Some(Frames(range)), Some(out)) = (&args.dataset, &args.frames, &args.out)
    else {
        bail!("expected a recording, --frames and --out");
    };
    let options = args
        .pipeline
        .run_options(args.profile.get(), args.input.strict)?;
    let dataset = args.input.open(path)?;
    if *range.start() as usize >= dataset.len() {
        bail!(
            "{}: has {} frames; --frames starts at {}",
            path.display(),
            dataset.len(),
            range.start()
        );
    }
    let oracle = args
        .oracle_labels
        .as_ref()
        .map(|dir| Masks::find(&dataset, path, dir))
        .transpose()?;
    let folder = ResultFolder::open(out, "trace")?;
    check_empty(out)?;
    let calibration = dataset.calibration();
    let camera = &calibration.camera;
    let source = frames(&dataset, oracle.as_ref(), None);
    let (records, skipped) = trace::record(camera, source, range.clone(), &options)?;
    for why in &skipped {
        note(&format!("warning: frame skipped: {why}"));
    }
    let lens = &camera.distortion;
    let about = json!({
        "program": concat!("garad ", env!("CARGO_PKG_VERSION")),
        "recording": dataset.name(),
        "frames": [range.start(), range.end()],
        "seed": options.seed,
        "camera": {
            "size": [camera.width, camera.height],
            "fx_fy_cx_cy": [camera.fx, camera.fy, camera.cx, camera.cy],
            "k1_k2_p1_p2_k3": [lens.k1, lens.k2, lens.p1, lens.p2, lens.k3],
        },
        "config": "config.toml",
    });
    trace::write(folder, &records, about, &options.config)?;
    say(&format!(
        "{} tensors of frames {} to {} in {}",
        records.len(),
        range.start(),
        range.end(),
        out.display()
    ))
}

/// Tensors of an earlier trace must not mix with the new ones.
fn check_empty(folder: &Path) -> Result<()> {
    let there = std::fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some());
    if there {
        bail!(
            "{}: is not empty; expected a new folder for the trace",
            folder.display()
        );
    }
    Ok(())
}

fn compare(args: &Diff) -> Result<ExitCode> {
    if !args.second.is_dir() {
        bail!("{}: no such folder", args.second.display());
    }
    let judge = match args.tolerances {
        true => Judge::Tolerances,
        false => Judge::Exact,
    };
    let found = diff(&args.first, &args.second, judge)?;
    if found.compared == 0 {
        bail!(
            "{}: nothing to compare; expected files like 000010/pose_0/after.npy",
            args.second.display()
        );
    }
    say(&found.to_string())?;
    Ok(match found.differences.is_empty() {
        true => ExitCode::SUCCESS,
        false => ExitCode::from(DIFFER),
    })
}
