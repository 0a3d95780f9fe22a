//! One file per command.

pub(crate) mod demo;
pub(crate) mod eval;
pub(crate) mod render;
pub(crate) mod run;
pub(crate) mod synth;

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use garad::runner::RunOptions;

/// What `run` and `demo` share.
#[derive(Debug, Args)]
pub(crate) struct CommonArgs {
    /// Where results go.
    #[arg(short = 'o', long = "out", value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// Threads; the result has the same bits for any number.
    #[arg(long, default_value_t = default_threads())]
    pub(crate) threads: usize,
    /// Seed of everything random.
    #[arg(long, default_value_t = 0)]
    pub(crate) seed: u64,
    /// Configuration file; keys that are not given keep their defaults.
    #[arg(long, value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
    /// No progress, only the result.
    #[arg(long)]
    pub(crate) quiet: bool,
}

fn default_threads() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

impl CommonArgs {
    /// Options for the runner.
    pub(crate) fn run_options(&self, strict: bool) -> Result<RunOptions> {
        let config = match &self.config {
            Some(path) => garad::config_file::read(path)?,
            None => garad_slam::Config::default(),
        };
        Ok(RunOptions {
            config,
            threads: self.threads,
            seed: self.seed,
            strict,
            quiet: self.quiet,
        })
    }
}

/// Prints a line of the result on stdout.
#[allow(clippy::print_stdout, reason = "the one place that prints results")]
pub(crate) fn say(line: &str) {
    println!("{line}");
}
