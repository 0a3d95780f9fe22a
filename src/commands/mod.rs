//! One file per command.

pub(crate) mod ablate;
pub(crate) mod compare;
pub(crate) mod demo;
pub(crate) mod eval;
pub(crate) mod eval_render;
pub(crate) mod golden;
pub(crate) mod input;
pub(crate) mod profiles;
pub(crate) mod render;
pub(crate) mod run;
pub(crate) mod synth;
pub(crate) mod trace;
mod variants;

use std::io::{self, ErrorKind, Write as _};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::builder::RangedU64ValueParser;
use clap::{Args, ValueEnum};
use garad::config_file::{self, Layer};
use garad::output::ResultFolder;
pub(crate) use garad::output::make_folder;
use garad::profiles::Profile;
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
    /// Configuration file; keys that are not given keep their defaults, or the profile's values.
    #[arg(long, value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
}

/// The profile of commands that run one.
#[derive(Debug, Args)]
pub(crate) struct ProfileArgs {
    /// Start from this profile instead of the defaults; `garad profiles` lists them.
    #[arg(long, value_name = "NAME", value_parser = Profile::find)]
    profile: Option<&'static Profile>,
}

impl ProfileArgs {
    pub(crate) fn get(&self) -> Option<&'static Profile> {
        self.profile
    }
}

impl PipelineArgs {
    /// Options of the run: the defaults, overridden by the profile, and that by the configuration file.
    pub(crate) fn run_options(
        &self,
        profile: Option<&Profile>,
        strict: bool,
    ) -> Result<RunOptions> {
        let mut layers: Vec<Layer> = profile.map(Profile::layer).into_iter().collect();
        if let Some(path) = &self.config {
            layers.push(Layer::read(path)?);
        }
        Ok(RunOptions {
            config: config_file::layered(&layers)?,
            threads: self.work.threads,
            seed: self.seed,
            strict,
            quiet: self.work.quiet,
        })
    }
}

/// Options shared by `run`, `demo`, `compare` and `ablate`.
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
#[value(rename_all = "snake_case")]
pub(crate) enum Part {
    /// No labels: everything counts as static. Table III means the same: its row has the figures of
    /// Photo-SLAM.
    Crf,
    /// No edges of the field: each label by its own evidence alone.
    Pairwise,
    /// Labels of the CRF are not checked by optical flow.
    Flow,
    /// Labels of keypoints alone (Table III, w/o Mapping): the map is made of everything.
    MapLabels,
    /// No penalty on dynamic Gaussians.
    Penalty,
    /// Dynamic Gaussians are removed at once.
    Retention,
    /// No map of Gaussians.
    Mapping,
    /// No loop closing.
    Loops,
}

impl Part {
    /// As on the command line.
    pub(crate) fn name(self) -> String {
        let value = self.to_possible_value();
        value.map_or_else(String::new, |value| value.get_name().to_owned())
    }

    pub(crate) fn leave_out(self, config: &mut garad_slam::Config) {
        match self {
            Self::Crf => config.labels.enabled = false,
            Self::Pairwise => {
                config.crf.kernels.feature_weight = 0.0;
                config.crf.kernels.position_weight = 0.0;
            }
            Self::Flow => config.flow.enabled = false,
            Self::MapLabels => {
                config.labels.map = false;
                config.insertion.avoid_moving = false;
                config.train.exclude_moving = false;
            }
            Self::Penalty => config.train.lambda_dynamic = 0.0,
            Self::Retention => config.labels.window.runs = 1,
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
    /// The folder for results, `out/NAME` unless given, made and tried before the work.
    pub(crate) fn out_folder(&self, name: &str, command: &str) -> Result<ResultFolder> {
        let default = || PathBuf::from("out").join(name);
        let out = self.out.clone().unwrap_or_else(default);
        ResultFolder::open(&out, command)
    }

    /// Options of the run.
    pub(crate) fn run_options(
        &self,
        profile: Option<&Profile>,
        strict: bool,
    ) -> Result<RunOptions> {
        let mut options = self.pipeline.run_options(profile, strict)?;
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
