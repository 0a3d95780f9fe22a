//! `garad run`: a recording tracked, mapped and judged.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use garad::output::{self, Judged};
use garad::progress::note;
use garad::render_quality;
use garad::runner::{Run, RunOptions, RunResult, SourceFrame};
use garad::session::{self, Recording, fingerprint};
use garad_core::{MaskImage, Par};
use garad_dataset::{
    Dataset, Frame, MASK_FOLDER, OpenOptions, Preset, bonn_camera_from_marker,
    write_bytes_atomically,
};

use super::{CommonArgs, make_folder, say};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder, .tgz, .tar or .zip in TUM or BONN layout.
    dataset: PathBuf,
    #[command(flatten)]
    common: CommonArgs,
    #[command(flatten)]
    input: InputArgs,
    /// True masks (255 moving) named by colour time stamp, taken instead of finding out what moves; a
    /// folder that does not exist here is looked for inside the recording.
    #[arg(long, value_name = "DIR")]
    oracle_labels: Option<PathBuf>,
    /// Which ground truth to judge by. BONN records a marker on the camera; published figures
    /// are against those raw poses.
    #[arg(long, value_enum, default_value_t = GroundTruth::Raw)]
    ground_truth: GroundTruth,
    /// Put the whole state aside after the last frame, or after `--max-frames`, to go on from there.
    #[arg(long, value_name = "DIR")]
    save_session: Option<PathBuf>,
    /// Go on with the frame after the last one of a session; the results are those of a run without
    /// a break. Everything else must be given as it was then.
    #[arg(long, value_name = "DIR")]
    resume: Option<PathBuf>,
    /// Only track, in the finished map of a session, which stays as it is. The configuration is the
    /// session's; `frames.csv` says which frames were tracked.
    #[arg(long, value_name = "DIR", conflicts_with_all = [
        "resume", "save_session", "config", "without", "refine", "seed", "oracle_labels",
    ])]
    localise: Option<PathBuf>,
}

/// Which frames of a recording, seen by which camera.
#[derive(Debug, clap::Args)]
pub(crate) struct InputArgs {
    /// Calibration by name: freiburg1, freiburg2, freiburg3, bonn.
    #[arg(long)]
    preset: Option<Preset>,
    /// Calibration file: `width height fx fy cx cy depth_factor fps [k1 k2 p1 p2 k3]`.
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Stop after this many frames.
    #[arg(long, value_name = "N")]
    max_frames: Option<usize>,
    /// Leave out this many frames first.
    #[arg(long, value_name = "N", default_value_t = 0)]
    first_frame: usize,
    /// Stop at the first bad frame or disordered time instead of skipping it.
    #[arg(long)]
    pub(crate) strict: bool,
}

impl InputArgs {
    pub(crate) fn open(&self, path: &Path) -> Result<Dataset> {
        let options = OpenOptions {
            preset: self.preset,
            calibration: self.calibration.clone(),
            max_frames: self.max_frames,
            first_frame: self.first_frame,
            strict: self.strict,
            ..OpenOptions::default()
        };
        Ok(Dataset::open(path, &options)?)
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum GroundTruth {
    /// As recorded.
    Raw,
    /// BONN only: moved from the marker to the camera.
    Camera,
}

/// Frames decoded ahead of tracking.
const PREFETCH: usize = 4;
/// Skipped frames named on the terminal.
const SKIPPED_SHOWN: usize = 5;

pub(crate) fn run(args: &Args) -> Result<()> {
    let run_options = args.common.run_options(args.input.strict)?;
    let dataset = args.input.open(&args.dataset)?;
    if !args.common.quiet {
        say(&format!(
            "{}: {} frames, camera from {}",
            dataset.name(),
            dataset.len(),
            dataset.calibration().source
        ))?;
    }
    for warning in dataset.warnings() {
        note(&format!("warning: {warning}"));
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
    let ground_truth = dataset.ground_truth().map(|raw| match args.ground_truth {
        GroundTruth::Raw => raw.to_vec(),
        GroundTruth::Camera => bonn_camera_from_marker(raw),
    });

    let out = args
        .common
        .out
        .clone()
        .unwrap_or_else(|| PathBuf::from("out").join(dataset.name()));
    make_folder(&out)?;
    if let Some(folder) = &args.save_session {
        session::prepare(folder)?;
    }
    let mut run = begin(args, &dataset, oracle.as_ref(), &run_options)?;
    if run.done() > 0 && !run_options.quiet {
        say(&format!("resumed after {} frames", run.done()))?;
    }
    // What has come into the room since then is not asked for, so it is not judged.
    let judged_by = truth.as_ref().filter(|_| args.localise.is_none());
    let input = frames_from(run.done(), &dataset, oracle.as_ref(), judged_by);
    run.process(input, dataset.len());
    let saved = match &args.save_session {
        Some(folder) => {
            let recording = recording(&dataset, oracle.as_ref(), run.done());
            session::save(folder, &mut run, &recording)
        }
        None => Ok(()),
    };
    let result = run.finish()?;

    let protocol = match (args.ground_truth, dataset.preset()) {
        (GroundTruth::Camera, _) => "ground truth moved from marker to camera",
        (GroundTruth::Raw, Some(Preset::Bonn)) => "raw ground truth (marker)",
        (GroundTruth::Raw, _) => "raw ground truth",
    };
    let mut judged = Judged::new(dataset.name(), &result, ground_truth.as_deref(), protocol);
    if run_options.config.train.final_iterations > 0 {
        let quality = render_quality::judge(
            result.gaussians()?,
            result.slam.camera(),
            &result.trajectory,
            frames(&dataset, oracle.as_ref(), truth.as_ref()),
            Par::new(run_options.threads),
            run_options.quiet,
        )?;
        judged.metrics.render = quality.all;
        judged.metrics.render_static = quality.outside_mask;
        judged.metrics.render_depth = quality.depth;
    }
    output::write(&out, &result, &judged, dataset.warnings())?;
    if args.localise.is_some() {
        write_bytes_atomically(&out.join("frames.csv"), frames_csv(&result).as_bytes())?;
    }
    if result.stopped_by.is_none() {
        warn_of_skipped(&result.skipped);
    }
    for line in judged.summary() {
        say(&line)?;
    }
    say(&format!("results in {}", out.display()))?;
    saved.context("the session is not saved; results are written")?;
    if let Some(folder) = &args.save_session {
        say(&format!("session in {}", folder.display()))?;
    }
    if let Some(error) = result.stopped_by {
        return Err(error.context("stopped by --strict; results so far are written"));
    }
    if judged.metrics.tracked == 0 {
        bail!("no frame could be tracked; results are written");
    }
    Ok(())
}

/// A run from the start, from a session, or in the map of one.
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

/// What the recording is known by after so many frames.
fn recording(dataset: &Dataset, oracle: Option<&Masks>, done: usize) -> Recording {
    let seen = |i: usize| {
        let frame = dataset.read(i).ok().filter(|_| i < done)?;
        let mask = oracle.and_then(|masks| masks.read(dataset, i).ok()?);
        Some(fingerprint(&frame.rgb, &frame.depth, mask.as_ref()))
    };
    Recording {
        name: dataset.name().to_owned(),
        given_masks: oracle.is_some(),
        times_s: times(dataset, done),
        pictures: [0, done.saturating_sub(1)].map(seen),
    }
}

/// Times of the first n frames.
fn times(dataset: &Dataset, n: usize) -> Vec<f64> {
    (0..n).filter_map(|i| dataset.timestamp(i)).collect()
}

/// Frame by frame, whether it was tracked.
fn frames_csv(result: &RunResult) -> String {
    let mut rows = String::from("frame,t_s,state,inliers\n");
    for frame in &result.frames {
        let (state, inliers) = (frame.state.name(), frame.inliers);
        rows.push_str(&format!(
            "{},{:.6},{state},{inliers}\n",
            frame.id.0, frame.t_s
        ));
    }
    rows
}

/// The first few frames left out, and how many more; the report names them all.
fn warn_of_skipped(skipped: &[String]) {
    for why in skipped.iter().take(SKIPPED_SHOWN) {
        note(&format!("warning: frame skipped: {why}"));
    }
    if skipped.len() > SKIPPED_SHOWN {
        let more = skipped.len() - SKIPPED_SHOWN;
        note(&format!(
            "warning: {more} more skipped; report.html names them all"
        ));
    }
}

/// A recording's frames, decoded ahead, with the masks to be believed and those to judge by.
pub(crate) fn frames<'a>(
    dataset: &'a Dataset,
    oracle: Option<&'a Masks>,
    truth: Option<&'a Masks>,
) -> impl Iterator<Item = Result<SourceFrame>> + 'a {
    frames_from(0, dataset, oracle, truth)
}

/// [`frames`] without the first ones.
fn frames_from<'a>(
    first: usize,
    dataset: &'a Dataset,
    oracle: Option<&'a Masks>,
    truth: Option<&'a Masks>,
) -> impl Iterator<Item = Result<SourceFrame>> + 'a {
    dataset.frames_from(first, PREFETCH).map(move |frame| {
        let frame = frame?;
        let i = frame.id.index();
        let mask =
            match oracle {
                Some(masks) => Some(masks.read(dataset, i)?.with_context(|| {
                    format!("frame {i}: no mask; expected one for every frame")
                })?),
                None => None,
            };
        // What is only judged by may have holes: the frame is run, and not judged.
        let truth = truth.and_then(|masks| match masks.read(dataset, i) {
            Ok(mask) => mask,
            Err(error) => {
                tracing::warn!("labels of frame {i} are not judged: {error:#}");
                None
            }
        });
        let Frame {
            t_s, rgb, depth, ..
        } = frame;
        Ok(SourceFrame {
            t_s,
            rgb,
            depth,
            mask,
            truth,
        })
    })
}

/// Where masks come from.
#[derive(Debug)]
pub(crate) enum Masks {
    /// A folder here.
    Folder(PathBuf),
    /// A folder inside the recording, archives included.
    Inside(String),
}

impl Masks {
    /// A folder named by the user: here, or inside the recording.
    pub(crate) fn find(dataset: &Dataset, path: &Path, dir: &Path) -> Result<Self> {
        let name = dir.to_string_lossy();
        let name = name.trim_end_matches('/');
        if dir.is_dir() {
            Ok(Self::Folder(dir.to_path_buf()))
        } else if path.join(dir).is_dir() {
            Ok(Self::Folder(path.join(dir)))
        } else if dataset.has_folder(name) {
            Ok(Self::Inside(name.to_owned()))
        } else {
            bail!(
                "{}: no such folder; expected one of masks, here or inside {}",
                dir.display(),
                path.display()
            )
        }
    }

    /// The recording's own, if it has any.
    pub(crate) fn of_recording(dataset: &Dataset) -> Option<Self> {
        dataset
            .has_folder(MASK_FOLDER)
            .then(|| Self::Inside(MASK_FOLDER.to_owned()))
    }

    fn read(&self, dataset: &Dataset, i: usize) -> Result<Option<MaskImage>> {
        Ok(match self {
            Self::Folder(dir) => Some(dataset.read_mask(dir, i)?),
            Self::Inside(folder) => dataset.read_own_mask(folder, i)?,
        })
    }
}
