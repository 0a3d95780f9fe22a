//! One file per command.

pub(crate) mod ablate;
pub(crate) mod demo;
pub(crate) mod eval;
pub(crate) mod eval_render;
pub(crate) mod golden;
pub(crate) mod input;
pub(crate) mod render;
pub(crate) mod run;
pub(crate) mod synth;
pub(crate) mod trace;

use std::io::{self, ErrorKind, Write as _};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::builder::RangedU64ValueParser;
use clap::{Args, ValueEnum};
pub(crate) use garad::output::make_folder;
use garad::run::RunOptions;
use garad_core::StampedPose;

/// Options of every command that computes.
#[derive(Debug, Args)]
pub(crate) struct WorkArgs {
    /// Threads; results have the same bits for any number.
    #[arg(long, default_value_t = default_threads(), value_parser = threads())]
    pub(crate) threads: usize,
    /// No progress, only results.
    #[arg(long)]
    pub(crate) quiet: bool,
}

/// Options of every command that runs the pipeline.
#[derive(Debug, Args)]
pub(crate) struct PipelineArgs {
    #[command(flatten)]
    pub(crate) work: WorkArgs,
    /// Seed of everything random.
    #[arg(long, default_value_t = 0)]
    pub(crate) seed: u64,
    /// Configuration file; keys that are not given keep their defaults.
    #[arg(long, value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
}

impl PipelineArgs {
    /// Options of the run.
    pub(crate) fn run_options(&self, strict: bool) -> Result<RunOptions> {
        Ok(RunOptions {
            config: match &self.config {
                Some(path) => garad::config_file::read(path)?,
                None => garad_slam::Config::default(),
            },
            threads: self.work.threads,
            seed: self.seed,
            strict,
            quiet: self.work.quiet,
        })
    }
}

/// Options shared by `run`, `demo` and `ablate`.
#[derive(Debug, Args)]
pub(crate) struct CommonArgs {
    /// Folder for the results.
    #[arg(short = 'o', long = "out", value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    #[command(flatten)]
    pub(crate) pipeline: PipelineArgs,
    /// Train the map for this many iterations after the last frame.
    #[arg(long, value_name = "N")]
    pub(crate) refine: Option<usize>,
    /// Leave a part out (paper, Table III); may be given more than once.
    #[arg(long, value_enum, value_name = "PART")]
    pub(crate) without: Vec<Part>,
}

/// Parts that can be left out.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Part {
    /// No labels: everything counts as static.
    Crf,
    /// Labels of the CRF are not checked by optical flow.
    Flow,
    /// No map of Gaussians.
    Mapping,
    /// No loop closing.
    Loops,
}

impl Part {
    pub(crate) fn leave_out(self, config: &mut garad_slam::Config) {
        match self {
            Self::Crf => config.labels.enabled = false,
            Self::Flow => config.flow.enabled = false,
            Self::Mapping => config.insertion.enabled = false,
            Self::Loops => config.loops.enabled = false,
        }
    }
}

/// More threads cost time and memory without any gain.
const MAX_THREADS: usize = 256;

fn default_threads() -> usize {
    std::thread::available_parallelism().map_or(1, |n| n.get().min(MAX_THREADS))
}

fn threads() -> RangedU64ValueParser<usize> {
    RangedU64ValueParser::new().range(1..=MAX_THREADS as u64)
}

impl CommonArgs {
    /// The folder for results, `out/NAME` unless given, made before the work.
    pub(crate) fn out_folder(&self, name: &str) -> Result<PathBuf> {
        let default = || PathBuf::from("out").join(name);
        let out = self.out.clone().unwrap_or_else(default);
        make_folder(&out)?;
        Ok(out)
    }

    /// Options of the run.
    pub(crate) fn run_options(&self, strict: bool) -> Result<RunOptions> {
        let mut options = self.pipeline.run_options(strict)?;
        if let Some(iterations) = self.refine {
            options.config.train.final_iterations = iterations;
        }
        for part in &self.without {
            part.leave_out(&mut options.config);
        }
        Ok(options)
    }
}

/// Prints a line of the result on stdout. A closed stream (`garad ... | head`) is not an error.
pub(crate) fn say(line: &str) -> Result<()> {
    match writeln!(io::stdout(), "{line}") {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(error).context("stdout: cannot write the result")
        }
        _ => Ok(()),
    }
}

/// A trajectory with at least one pose.
pub(crate) fn read_poses(path: &Path) -> Result<Vec<StampedPose>> {
    let poses = garad_dataset::read_trajectory(path)?;
    if poses.is_empty() {
        bail!(
            "{}: holds no pose; expected lines `timestamp tx ty tz qx qy qz qw`",
            path.display()
        );
    }
    Ok(poses)
}
