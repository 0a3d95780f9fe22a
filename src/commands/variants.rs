//! One recording run several times, for `compare` and `ablate`.

use anyhow::{Result, anyhow, bail};
use garad::interrupt::{self, Interrupted};
use garad::output::{self, Compared, Judged, ResultFolder, try_folder};
use garad::progress::note;
use garad::render_quality;
use garad::run::{self, RunOptions};
use garad::usage::processor_ms;
use garad_core::Par;
use garad_dataset::Dataset;
use garad_eval::{AteOptions, Comparison, Row};

use super::input::{GroundTruth, Masks, frames};
use super::{input, say};

/// A run to be compared with others.
#[derive(Debug)]
pub(crate) struct Variant {
    /// Name of its row; with `_` for spaces, that of its folder.
    pub(crate) name: String,
    pub(crate) options: RunOptions,
}

/// How the columns were measured.
const MEASURED: &str = "Render and ghosts: the static Gaussians from the estimated poses of all frames. \
                        CPU: all threads, decoding and training included.";

/// The table that belongs to some variants.
#[derive(Debug)]
pub(crate) struct Table {
    /// Name of its files.
    pub(crate) stem: &'static str,
    /// Rows of others.
    pub(crate) published: Vec<Row>,
    /// What else is to be said.
    pub(crate) notes: Vec<String>,
}

/// Runs every variant, its results to OUT/NAME, and writes the table. A variant that fails is a row with the
/// reason.
pub(crate) fn compare(
    dataset: &Dataset,
    variants: &[Variant],
    table: Table,
    mut out: ResultFolder,
) -> Result<()> {
    let path = out.path().to_path_buf();
    interrupt::listen()?;
    let limit_m = (variants.iter())
        .map(|variant| variant.options.config.features.max_depth_m)
        .fold(0.0, f64::max);
    let look = dataset.first_look(limit_m)?;
    for warning in dataset.warnings().iter().chain(&look.warnings) {
        note(&format!("warning: {warning}"));
    }
    let mut compared = Vec::new();
    let (mut complete, mut interrupted) = (0, false);
    for (i, Variant { name, options }) in variants.iter().enumerate() {
        if interrupt::asked() {
            interrupted = true;
            compared.push(Compared::failed(name, &anyhow!("not run: interrupted")));
            continue;
        }
        if !options.quiet {
            note(&format!("{name} ({} of {})", i + 1, variants.len()));
        }
        let one = run_one(dataset, name, options, &mut out);
        match &one {
            Ok(_) => complete += 1,
            Err(error) => interrupted |= error.is::<Interrupted>(),
        }
        compared.push(one.unwrap_or_else(|error| Compared::failed(name, &error)));
    }
    if interrupted && complete == 0 {
        return Err(Interrupted::before("a run was complete").into());
    }
    let mut notes = vec![MEASURED.to_owned()];
    if let Some(truth) = input::truth(dataset, GroundTruth::Raw) {
        let how = AteOptions::default().describe();
        notes.insert(0, format!("ATE: {how}, {}.", truth.protocol));
    }
    notes.extend(table.notes);
    let comparison = Comparison {
        recording: dataset.name().to_owned(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        rows: compared.iter().map(|run| run.row.clone()).collect(),
        published: table.published,
        notes,
    };
    output::write_comparison(out, table.stem, &comparison, &compared)?;
    say(comparison.markdown().trim_end())?;
    say(&format!("results in {}", path.display()))?;
    if interrupted {
        let of = variants.len();
        let what =
            format!("interrupted; the table has the {complete} of {of} runs that are complete");
        return Err(Interrupted(what).into());
    }
    if compared
        .iter()
        .all(|run| run.row.figures.tracked.unwrap_or(0) == 0)
    {
        bail!("no run has tracked a frame; the table has the reasons");
    }
    Ok(())
}

fn folder_name(variant: &str) -> String {
    variant.replace(' ', "_")
}

/// A run that is interrupted writes nothing: its figures would not be comparable.
fn run_one(
    dataset: &Dataset,
    name: &str,
    options: &RunOptions,
    out: &mut ResultFolder,
) -> Result<Compared> {
    let folder = out.path().join(folder_name(name));
    if folder.exists() {
        try_folder(&folder)?;
    }
    let masks = Masks::of_recording(dataset);
    let camera = &dataset.calibration().camera;
    let images = || frames(dataset, None, masks.as_ref());
    let before_ms = processor_ms();
    let result = run::run(camera, images(), dataset.len(), options)?;
    if let Some(how) = result.interruption(dataset.len()) {
        return Err(Interrupted(how).into());
    }
    let spent_ms = before_ms.zip(processor_ms()).map(|(a, b)| b - a);
    let truth = input::truth(dataset, GroundTruth::Raw);
    let mut judged = Judged::new(dataset.name(), &result, truth.as_ref()).of_recording(dataset);
    if !result.gaussians().is_empty() {
        let (map, path) = (result.gaussians(), &result.trajectory);
        let par = Par::new(options.threads);
        let shown = images().take_while(|_| !interrupt::asked());
        let quality = render_quality::judge(map, camera, path, shown, par, options.quiet)?;
        if interrupt::asked() {
            return Err(Interrupted("interrupted in its evaluation".to_owned()).into());
        }
        judged.add_render(&quality);
    }
    let folder = out.child(&folder_name(name))?;
    output::write(folder, &result, &judged, dataset.warnings())?;
    Compared::new(name, &result, &judged, spent_ms)
}
