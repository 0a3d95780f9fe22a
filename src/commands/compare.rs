//! `garad compare`: a recording run with several profiles, beside the figures of the paper.

use std::path::PathBuf;

use anyhow::{Result, bail};
use garad::profiles::{PROFILES, Profile};
use garad::published;

use super::CommonArgs;
use super::input::InputArgs;
use super::variants::{Table, Variant, compare};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder, .tgz, .tar or .zip of a recording, as `garad run` takes it.
    dataset: PathBuf,
    /// Profiles, in the order of the table; all unless given. A configuration file overrides each.
    #[arg(long, value_name = "NAME,...", value_delimiter = ',', value_parser = Profile::find)]
    profiles: Vec<&'static Profile>,
    #[command(flatten)]
    common: CommonArgs,
    #[command(flatten)]
    input: InputArgs,
}

/// What the table of the paper has and this one has not.
const NOT_RUN: &str = "DDN-SLAM needs a detector network and has no profile.";

pub(crate) fn run(args: &Args) -> Result<()> {
    let profiles: Vec<&Profile> = match args.profiles.is_empty() {
        true => PROFILES.iter().collect(),
        false => args.profiles.clone(),
    };
    for (i, profile) in profiles.iter().enumerate() {
        if profiles[..i].contains(profile) {
            bail!("--profiles: {} is named twice", profile.name);
        }
    }
    let variants = profiles.iter().map(|profile| {
        let options = args.common.run_options(Some(profile), args.input.strict)?;
        Ok(Variant {
            name: profile.name.to_owned(),
            options,
        })
    });
    let variants = variants.collect::<Result<Vec<_>>>()?;
    let dataset = args.input.open(&args.dataset)?;
    let out = args
        .common
        .out_folder(&format!("compare_{}", dataset.name()), "compare")?;
    let published = published::rows(dataset.name());
    let mut notes = vec![NOT_RUN.to_owned()];
    if published.is_some() {
        notes.push(format!(
            "Published: {}, whole recording; the other rows: {}.",
            published::SOURCE,
            args.input.part(&dataset)
        ));
    }
    let table = Table {
        stem: "compare",
        published: published.unwrap_or_default(),
        notes,
    };
    compare(&dataset, &variants, table, out)
}
