//! `garad run`: a recording tracked, mapped and evaluated.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use garad::interrupt::{self, Interrupted};
use garad::output::{self, Judged};
use garad::progress::note;
use garad::reason::reason;
use garad::render_quality;
use garad::run::{Run, RunOptions};
use garad::session;
use garad::untracked::why_untracked;
use garad_core::Par;
use garad_dataset::{Dataset, Preset};

use super::input::{GroundTruth, InputArgs, Masks, frames, frames_from, recording, times};
use super::{CommonArgs, ProfileArgs, input, say};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder, .tgz, .tar or .zip of a recording: TUM, BONN, ICL-NUIM, Replica, ScanNet, 7-Scenes, nerfstudio,
    /// Polycam, Open3D.
    dataset: PathBuf,
    #[command(flatten)]
    profile: ProfileArgs,
    #[command(flatten)]
    common: CommonArgs,
    #[command(flatten)]
    input: InputArgs,
    /// Folder of true masks (255 moving), named by colour time stamp, used instead of computed labels; one
    /// that does not exist is looked for inside the recording.
    #[arg(long, value_name = "DIR")]
    oracle_labels: Option<PathBuf>,
    /// Ground truth to compare with. BONN records the poses of a marker on the camera; published figures
    /// are against those raw poses. RPE and jitter are of the camera either way.
    #[arg(long, value_enum, default_value_t = GroundTruth::Raw)]
    ground_truth: GroundTruth,
    /// Save the complete state after the last frame, after `--max-frames` or on Ctrl-C, to be resumed.
    #[arg(long, value_name = "DIR")]
    save_session: Option<PathBuf>,
    /// Resume a saved session after its last frame; the results are those of an uninterrupted run. All
    /// other options must be the same.
    #[arg(long, value_name = "DIR")]
    resume: Option<PathBuf>,
    /// Only track, in the finished map of a session, which is not changed. The configuration is the
    /// session's; `frames.csv` lists which frames were tracked.
    #[arg(long, value_name = "DIR", conflicts_with_all = [
        "resume", "save_session", "profile", "config", "without", "refine", "seed", "oracle_labels",
    ])]
    localise: Option<PathBuf>,
}

/// Skipped frames listed on the terminal.
const SKIPPED_SHOWN: usize = 5;

pub(crate) fn run(args: &Args) -> Result<()> {
    let run_options = args
        .common
        .run_options(args.profile.get(), args.input.strict)?;
    let dataset = args.input.open(&args.dataset)?;
    if !run_options.quiet {
        say(&format!(
            "{}: {} frames, layout {}, camera from {}",
            dataset.name(),
            dataset.len(),
            dataset.layout(),
            dataset.calibration().source
        ))?;
        for assumed in dataset.notes() {
            note(&format!("note: {assumed}"));
        }
    }
    let oracle = args
        .oracle_labels
        .as_ref()
        .map(|dir| Masks::find(&dataset, &args.dataset, dir))
        .transpose()?;
    let truth = Masks::of_recording(&dataset);
    if args.ground_truth == GroundTruth::Camera && dataset.preset() != Some(Preset::Bonn) {
        bail!(
            "{}: --ground-truth camera is for BONN recordings; expected one, or --preset bonn",
            args.dataset.display()
        );
    }
    let out = args.common.out_folder(dataset.name(), "run")?;
    let out_path = out.path().display().to_string();
    if let Some(folder) = &args.save_session {
        session::prepare(folder)?;
    }
    let look = dataset.first_look(run_options.config.features.max_depth_m)?;
    let warnings = [dataset.warnings(), &look.warnings].concat();
    for warning in &warnings {
        note(&format!("warning: {warning}"));
    }
    interrupt::listen()?;
    let mut run = begin(args, &dataset, oracle.as_ref(), &run_options)?;
    let resumed_after = run.done();
    if run.done() > 0 && !run_options.quiet {
        say(&format!("resumed after {} frames", run.done()))?;
    }
    // Localisation does not label, so there is nothing to judge.
    let judged_by = truth.as_ref().filter(|_| args.localise.is_none());
    let images = frames_from(run.done(), &dataset, oracle.as_ref(), judged_by);
    run.process(images, dataset.len());
    if interrupt::asked() && run.done() == resumed_after {
        return Err(Interrupted::before("the first frame").into());
    }
    let saved = match &args.save_session {
        Some(folder) => {
            let recording = recording(&dataset, oracle.as_ref(), run.done());
            session::save(folder, &mut run, &recording)
        }
        None => Ok(()),
    };
    let mut result = run.finish()?;

    let path_truth = input::truth(&dataset, args.ground_truth);
    let mut judged =
        Judged::new(dataset.name(), &result, path_truth.as_ref()).of_recording(&dataset);
    if run_options.config.train.final_iterations > 0 && !result.log.interrupted {
        let images = frames(&dataset, oracle.as_ref(), truth.as_ref());
        let quality = render_quality::judge(
            result.gaussians(),
            result.slam.camera(),
            &result.trajectory,
            images.take_while(|_| !interrupt::asked()),
            Par::new(run_options.threads),
            run_options.quiet,
        )?;
        // Means over a part of the frames are not comparable.
        result.log.interrupted = interrupt::asked();
        if !result.log.interrupted {
            judged.add_render(&quality);
        }
    }
    let written = output::write(out, &result, &judged, &warnings);
    if result.log.stopped_by.is_none() {
        warn_of_skipped(&result.log.skipped);
    }
    for line in judged.summary() {
        say(&line)?;
    }
    for warning in &judged.warnings {
        note(&format!("warning: {warning}"));
    }
    match (written, saved) {
        (Err(written), Err(saved)) => {
            let unsaved = format!("the session is not saved either: {}", reason(&saved));
            bail!("{}; {unsaved}", reason(&written));
        }
        (Err(written), Ok(())) => return Err(written),
        (Ok(()), saved) => {
            say(&format!("results in {out_path}"))?;
            saved.context("the session is not saved; results are written")?;
        }
    }
    if let Some(folder) = &args.save_session {
        say(&format!("session in {}", folder.display()))?;
    }
    if let Some(how) = result.interruption(dataset.len()) {
        let more = match (&args.save_session, &args.localise) {
            (Some(folder), _) => format!("; `--resume {}` continues it", folder.display()),
            (None, None) => "; with --save-session DIR it could be resumed".to_owned(),
            (None, Some(_)) => String::new(),
        };
        return Err(Interrupted(format!("{how}; results so far are written{more}")).into());
    }
    let nothing = (judged.metrics.tracked == 0)
        .then(|| why_untracked(&result, &look.depth, dataset.calibration()));
    if let Some(error) = result.log.stopped_by {
        return Err(error.context("stopped by --strict; results so far are written"));
    }
    if let Some(why) = nothing {
        bail!("no frame could be tracked: {why}; results are written");
    }
    Ok(())
}

/// A new run, one resumed from a session, or localisation in its map.
fn begin(
    args: &Args,
    dataset: &Dataset,
    oracle: Option<&Masks>,
    options: &RunOptions,
) -> Result<Run> {
    let camera = &dataset.calibration().camera;
    if let Some(folder) = &args.localise {
        let (mut input, path) = session::open(folder)?;
        return Run::localise(&mut input, camera, options)
            .with_context(|| path.display().to_string());
    }
    let Some(folder) = &args.resume else {
        return Run::new(camera, options);
    };
    let (mut input, path) = session::open(folder)?;
    let (run, then) =
        Run::resume(&mut input, camera, options).with_context(|| path.display().to_string())?;
    let mut now = recording(dataset, oracle, run.done());
    now.times_s = times(dataset, dataset.len());
    then.check(&now)
        .with_context(|| folder.display().to_string())?;
    Ok(run)
}

/// The first few skipped frames, and the number of the others; the report lists all.
fn warn_of_skipped(skipped: &[String]) {
    for why in skipped.iter().take(SKIPPED_SHOWN) {
        note(&format!("warning: frame skipped: {why}"));
    }
    if skipped.len() > SKIPPED_SHOWN {
        let more = skipped.len() - SKIPPED_SHOWN;
        note(&format!(
            "warning: {more} more skipped; report.html lists them all"
        ));
    }
}
