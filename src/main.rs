//! The `garad` command line.

use std::process::ExitCode;

use clap::{Parser, Subcommand};
use garad::reason::reason;
use garad::{interrupt, progress};

mod commands;

/// Gaussian-splatting SLAM on the CPU for scenes in which people move.
#[derive(Debug, Parser)]
#[command(name = "garad", version, propagate_version = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Make a small dynamic sequence, run on it, evaluate and draw the result.
    Demo(commands::demo::Args),
    /// Track a TUM or BONN recording (folder, .tgz or .zip) and build its map.
    Run(commands::run::Args),
    /// Run a recording with several profiles, and print the results side by side.
    Compare(commands::compare::Args),
    /// Run a recording with and without each part, and print the results side by side.
    Ablate(commands::ablate::Args),
    /// List the profiles, or print one.
    Profiles(commands::profiles::Args),
    /// Evaluate results.
    #[command(subcommand)]
    Eval(commands::eval::Command),
    /// Render a map from a pose or along a trajectory.
    Render(commands::render::Args),
    /// Make a dynamic RGB-D recording with masks and exact poses.
    Synth(commands::synth::Args),
    /// Check any implementation, in any language, against the golden cases.
    #[command(subcommand)]
    Golden(commands::golden::Command),
    /// Record the inputs and outputs of every stage of some frames, or compare two such traces.
    Trace(commands::trace::Args),
}

/// Exit code of bad input or usage.
const BAD_INPUT: u8 = 2;

fn main() -> ExitCode {
    let cli = Cli::parse();
    tracing_subscriber::fmt()
        .with_writer(std::io::stderr)
        .with_max_level(log_level())
        .without_time()
        .with_target(false)
        .log_internal_errors(false)
        .init();
    // Where it fails, such a signal ends the program, as without it.
    let _ = interrupt::survive_file_size_limit();
    let outcome = match cli.command {
        Command::Demo(args) => commands::demo::run(&args),
        Command::Run(args) => commands::run::run(&args),
        Command::Compare(args) => commands::compare::run(&args),
        Command::Profiles(args) => commands::profiles::run(&args),
        Command::Ablate(args) => commands::ablate::run(&args),
        Command::Eval(command) => commands::eval::run(&command),
        Command::Render(args) => commands::render::run(&args),
        Command::Synth(args) => commands::synth::run(&args),
        Command::Golden(command) => match commands::golden::run(&command) {
            Ok(code) => return code,
            Err(error) => Err(error),
        },
        Command::Trace(args) => match commands::trace::run(&args) {
            Ok(code) => return code,
            Err(error) => Err(error),
        },
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if error.is::<interrupt::Interrupted>() => {
            progress::note(&reason(&error));
            ExitCode::from(interrupt::EXIT_CODE)
        }
        Err(error) => {
            progress::note(&format!("error: {}", reason(&error)));
            ExitCode::from(BAD_INPUT)
        }
    }
}

/// `GARAD_LOG=debug` logs each keyframe; results do not depend on it.
fn log_level() -> tracing::Level {
    std::env::var("GARAD_LOG")
        .ok()
        .and_then(|level| level.parse().ok())
        .unwrap_or(tracing::Level::WARN)
}
