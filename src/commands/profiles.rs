//! `garad profiles`: the named configurations.

use anyhow::Result;
use garad::profiles::{PROFILES, Profile};

use super::say;

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Print this profile as TOML, instead of the list.
    #[arg(value_parser = Profile::find)]
    name: Option<&'static Profile>,
}

pub(crate) fn run(args: &Args) -> Result<()> {
    match args.name {
        Some(profile) => say(profile.toml.trim_end()),
        None => (PROFILES.iter()).try_for_each(|p| say(&format!("{:<12} {}", p.name, p.about))),
    }
}
