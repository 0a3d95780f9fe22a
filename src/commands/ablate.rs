//! `garad ablate`: results with and without each part, as the paper's Table III.

use std::path::PathBuf;

use anyhow::{Result, bail};
use garad::published;

use super::input::InputArgs;
use super::variants::{Table, Variant, compare};
use super::{CommonArgs, Part, ProfileArgs};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder, .tgz, .tar or .zip of a recording, as `garad run` takes it, with ground truth.
    dataset: PathBuf,
    #[command(flatten)]
    profile: ProfileArgs,
    #[command(flatten)]
    common: CommonArgs,
    #[command(flatten)]
    input: InputArgs,
}

/// The parts left out, one in each row below the full system. [`Part::Mapping`] is none of them: the only
/// figures it changes are those that a map has.
const ROWS: [Part; 7] = [
    Part::Crf,
    Part::Pairwise,
    Part::Flow,
    Part::MapLabels,
    Part::Penalty,
    Part::Retention,
    Part::Loops,
];

pub(crate) fn run(args: &Args) -> Result<()> {
    let profile = args.profile.get();
    let full = (args.common).run_options(profile, args.input.strict)?;
    let dataset = args.input.open(&args.dataset)?;
    if dataset.ground_truth().is_none() {
        bail!(
            "{}: no ground truth; expected groundtruth.txt",
            args.dataset.display()
        );
    }
    let out = (args.common).out_folder(&format!("ablate_{}", dataset.name()), "ablate")?;
    let without = ROWS.map(|part| {
        let mut options = full.clone();
        part.leave_out(&mut options.config);
        Variant {
            name: format!("without {}", part.name()),
            options,
        }
    });
    let mut variants = vec![Variant {
        name: "full".to_owned(),
        options: full,
    }];
    variants.extend(without);
    let table = Table {
        stem: "ablation",
        published: published::ablation_rows(),
        notes: vec![
            format!(
                "Profile: {}.",
                profile.map_or("default", |profile| profile.name)
            ),
            format!(
                "Published: {}, eight whole recordings each; the other rows: {}.",
                published::ABLATION_SOURCE,
                args.input.part(&dataset)
            ),
        ],
    };
    compare(&dataset, &variants, table, out)
}
