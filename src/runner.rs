//! [`run`]: a recording through the system, frame by frame; [`Run`]: the same with a pause.

use std::io::{Read, Write};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use garad_core::{Camera, FrameId, GaussianMap, Label, MaskImage, Par, RgbImage, StampedPose};
use garad_eval::{Confusion, RunLabels};
use garad_slam::LabelledFrame;
use garad_slam::mapping::train::TrainStep;
use garad_slam::session::{SectionReader, SectionWriter};
use garad_slam::{
    Config, FrameInput, FrameReport, ReplayedFrame, SessionError, Slam, TrackingState,
};

use crate::packed_labels::PackedLabels;
use crate::progress::Progress;
use crate::session::Recording;
use crate::stopwatch::{FrameCost, SharedStopwatch, Stopwatch, memory_mb, processor_ms};

/// A frame as the runner wants it.
#[derive(Debug, Clone)]
pub struct SourceFrame {
    /// Colour time stamp, seconds.
    pub t_s: f64,
    /// Colour.
    pub rgb: RgbImage,
    /// Metres.
    pub depth: garad_core::DepthImage,
    /// 255 where something moves; taken for true instead of finding out.
    pub mask: Option<MaskImage>,
    /// 255 where something moves, 0 where nothing does; what labels are judged by.
    pub truth: Option<MaskImage>,
}

/// What a run is made with.
#[derive(Debug, Clone)]
pub struct RunOptions {
    /// The pipeline's numbers.
    pub config: Config,
    /// Threads; never changes a result.
    pub threads: usize,
    /// Seed of everything random.
    pub seed: u64,
    /// Stop at the first frame that cannot be read, instead of skipping it.
    pub strict: bool,
    /// No progress.
    pub quiet: bool,
}

impl Default for RunOptions {
    fn default() -> Self {
        Self {
            config: Config::default(),
            threads: 2,
            seed: 0,
            strict: false,
            quiet: false,
        }
    }
}

/// An input picture kept for the report, with the labels of its keypoints.
#[derive(Debug, Clone)]
pub struct Snapshot {
    /// Position in the recording.
    pub frame: usize,
    /// Time stamp.
    pub t_s: f64,
    /// The input.
    pub rgb: RgbImage,
    /// What was found, or given, to move.
    pub mask: Option<MaskImage>,
    /// Keypoints (x, y) and what they were taken for.
    pub keypoints: Vec<(f32, f32, KeypointRole)>,
}

/// What tracking made of a keypoint.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum KeypointRole {
    /// Agrees with a landmark.
    Tracked,
    /// Static, but no landmark.
    Free,
    /// On something that moves.
    Dynamic,
}

/// Everything a run leaves behind.
#[derive(Debug)]
pub struct RunResult {
    /// The system after the last frame.
    pub slam: Slam,
    /// Threads it ran on.
    pub threads: usize,
    /// One line per frame given.
    pub frames: Vec<FrameReport>,
    /// The path.
    pub trajectory: Vec<StampedPose>,
    /// Frames that could not be read or used, with the reason.
    pub skipped: Vec<String>,
    /// The error that ended a strict run early.
    pub stopped_by: Option<anyhow::Error>,
    /// Durations per stage.
    pub stopwatch: Stopwatch,
    /// Wall time of the run, seconds.
    pub wall_s: f64,
    /// Pictures for the report.
    pub snapshots: Vec<Snapshot>,
    /// Labels against the truth, for the frames that have one; `None` if nothing was labelled.
    pub labels: Option<RunLabels>,
    /// What was found to move, frame by frame.
    pub found: Vec<PackedLabels>,
    /// What every frame cost.
    pub costs: Vec<FrameCost>,
    /// The iterations of the training after the last frame, one by one.
    pub refined: Vec<TrainStep>,
}

impl RunResult {
    /// The map of Gaussians.
    ///
    /// # Errors
    /// If mapping is still under way (never after [`run`]).
    pub fn gaussians(&self) -> Result<&GaussianMap> {
        self.slam.gaussians().context("the map is not at rest")
    }

    /// Frames with a pose.
    #[must_use]
    pub fn tracked(&self) -> usize {
        self.trajectory.len()
    }
}

/// Pictures kept for the report.
const SNAPSHOTS: usize = 5;

/// Takes every frame through the system.
///
/// # Errors
/// Configuration or camera that cannot be. A frame that cannot be read is skipped and counted, or,
/// if `strict`, ends the run: what was computed until then is still returned.
pub fn run(
    camera: &Camera,
    frames: impl Iterator<Item = Result<SourceFrame>>,
    total: usize,
    options: &RunOptions,
) -> Result<RunResult> {
    let mut run = Run::new(camera, options)?;
    run.process(frames, total);
    run.finish()
}

/// A run that can be put aside: begun or resumed, taken through frames, saved, finished.
#[derive(Debug)]
pub struct Run {
    slam: Slam,
    options: RunOptions,
    mapping: SharedStopwatch,
    collected: Collected,
    /// Frames of the recording that are done, those left out included.
    done: usize,
    begun: Instant,
    /// Wall time of the parts before this one.
    earlier_s: f64,
}

impl Run {
    /// Nothing seen yet.
    ///
    /// # Errors
    /// Configuration or camera that cannot be.
    pub fn new(camera: &Camera, options: &RunOptions) -> Result<Self> {
        let par = Par::new(options.threads);
        let slam = Slam::new(*camera, options.config.clone(), options.seed, par)
            .context("the run cannot start")?;
        Ok(Self::with(slam, options.clone()))
    }

    /// A run that [`Run::save`] put aside, and the recording it was made from. Camera, configuration and
    /// seed must be those of then; the number of threads and how long the map is refined at the end
    /// may be others.
    ///
    /// # Errors
    /// A state that cannot be read, or the first thing in which the two differ.
    pub fn resume(
        input: &mut impl Read,
        camera: &Camera,
        options: &RunOptions,
    ) -> Result<(Self, Recording)> {
        let begun = Instant::now();
        let mut slam = Slam::load(input, Par::new(options.threads))?;
        slam.resume_with(camera, &options.config, options.seed)?;
        let mut run = Self::with(slam, options.clone());
        let mut from = SectionReader::new(input)?;
        let recording = from.take("recording")?;
        run.done = from.take("done")?;
        run.earlier_s = from.take("earlier_s")?;
        run.collected.load(&mut from)?;
        let stopwatch = &mut run.collected.stopwatch;
        stopwatch.record("load_session", begun.elapsed());
        Ok((run, recording))
    }

    /// Tracking in the map of a run that [`Run::save`] put aside, which stays as it is. Configuration
    /// and seed are those of then.
    ///
    /// # Errors
    /// A state that cannot be read, or a camera that is another.
    pub fn localise(input: &mut impl Read, camera: &Camera, options: &RunOptions) -> Result<Self> {
        let begun = Instant::now();
        let mut slam = Slam::load(input, Par::new(options.threads))?;
        let loaded = begun.elapsed();
        slam.same_camera(camera)?;
        slam.localise_only()?;
        let mut options = RunOptions {
            config: slam.config().clone(),
            seed: slam.seed(),
            ..options.clone()
        };
        options.config.train.final_iterations = 0;
        let mut run = Self::with(slam, options);
        run.collected.stopwatch.record("load_session", loaded);
        Ok(run)
    }

    fn with(slam: Slam, options: RunOptions) -> Self {
        let mapping = SharedStopwatch::default();
        Self {
            slam: slam.with_mapping_observer(Box::new(mapping.clone())),
            options,
            mapping,
            collected: Collected::default(),
            done: 0,
            begun: Instant::now(),
            earlier_s: 0.0,
        }
    }

    /// Frames of the recording that are done, those left out included.
    #[must_use]
    pub fn done(&self) -> usize {
        self.done
    }

    /// The system after the last frame.
    #[must_use]
    pub fn slam(&self) -> &Slam {
        &self.slam
    }

    /// Writes everything that the rest of the run and its results depend on. Pictures kept for the report
    /// are not among it: that of a resumed run shows moments of its last part.
    ///
    /// # Errors
    /// What cannot be written; a mapping thread that broke down.
    pub fn save(
        &mut self,
        out: &mut impl Write,
        recording: &Recording,
    ) -> Result<(), SessionError> {
        let saving = Instant::now();
        self.slam.save(out)?;
        let Self {
            slam: _,    // written
            options: _, // threads and the like; the rest is in the system
            mapping,
            collected,
            done,
            begun,
            earlier_s,
        } = self;
        collected.stopwatch.merge(&mapping.take());
        let mut to = SectionWriter::new(out)?;
        to.put("recording", recording)?;
        to.put("done", done)?;
        to.put("earlier_s", &(*earlier_s + begun.elapsed().as_secs_f64()))?;
        collected.save(&mut to)?;
        collected.stopwatch.record("save_session", saving.elapsed());
        Ok(())
    }

    /// Takes the next frames through the system. `total` is the number of frames of the recording, those
    /// done before included. A frame that cannot be read is skipped and counted, or, if `strict`, ends
    /// the run.
    pub fn process(&mut self, frames: impl Iterator<Item = Result<SourceFrame>>, total: usize) {
        let Self {
            slam,
            options,
            collected: result,
            done,
            ..
        } = self;
        let left = total.saturating_sub(*done);
        let mut progress = Progress::new("tracking", left, options.quiet);
        let mut waiting = Instant::now();
        for frame in frames {
            let i = *done;
            *done += 1;
            result.stopwatch.record("wait_for_frame", waiting.elapsed());
            let outcome = frame.and_then(|frame| {
                let report = result.process(slam, &frame)?;
                Ok((frame, report))
            });
            match outcome {
                Ok((frame, report)) => {
                    if is_snapshot(i, total) {
                        result.snapshots.push(snapshot(slam, frame, &report));
                    }
                    progress.step(&state_line(&report, slam.map().keyframes().len()));
                    result.frames.push(report);
                }
                Err(error) => {
                    progress.step("frame skipped");
                    result.skipped.push(format!("{error:#}"));
                    if options.strict {
                        result.stopped_by = Some(error);
                        break;
                    }
                }
            }
            waiting = Instant::now();
        }
        progress.finish();
    }

    /// Takes over the last mapping jobs and trains the map, if that was asked for.
    ///
    /// # Errors
    /// A mapping thread that broke down.
    pub fn finish(self) -> Result<RunResult> {
        let Self {
            mut slam,
            options,
            mapping,
            collected: mut result,
            done: _,
            begun,
            earlier_s,
        } = self;
        let waiting = Instant::now();
        slam.finish().context("the map is lost")?;
        result.stopwatch.record("handover", waiting.elapsed());
        train(&mut slam, &mut result, &options);
        result.stopwatch.merge(&mapping.take());
        let failed = slam.mapped().iter().filter_map(|done| done.error.clone());
        result.skipped.extend(failed);
        Ok(RunResult {
            trajectory: slam.trajectory(),
            slam,
            threads: options.threads.max(1),
            frames: result.frames,
            skipped: result.skipped,
            stopped_by: result.stopped_by,
            stopwatch: result.stopwatch,
            wall_s: earlier_s + begun.elapsed().as_secs_f64(),
            snapshots: result.snapshots,
            labels: (!result.judged.frames.is_empty()).then_some(result.judged),
            found: result.found,
            costs: result.costs,
            refined: result.refined,
        })
    }
}

/// Trains the map after the last frame. An error leaves the map as it was then, and is named among
/// what was skipped: the path is not touched by it.
fn train(slam: &mut Slam, result: &mut Collected, options: &RunOptions) {
    let iterations = options.config.train.final_iterations;
    if iterations == 0 {
        return;
    }
    let mut progress = Progress::new("training", iterations, options.quiet);
    let mut begun = Instant::now();
    let (stopwatch, refined) = (&mut result.stopwatch, &mut result.refined);
    let outcome = slam.train_final(&mut |step| {
        stopwatch.record("refine", begun.elapsed());
        refined.push(*step);
        begun = Instant::now();
        progress.step(&format!("loss {:.4} at 1/{}", step.loss, 1 << step.level));
    });
    progress.finish();
    if let Err(error) = outcome {
        result.skipped.push(error.to_string());
    }
}

#[derive(Debug, Default)]
struct Collected {
    frames: Vec<FrameReport>,
    skipped: Vec<String>,
    stopped_by: Option<anyhow::Error>,
    stopwatch: Stopwatch,
    snapshots: Vec<Snapshot>,
    judged: RunLabels,
    /// True masks of the first frames, while the run may still begin again.
    early_truth: Vec<(FrameId, MaskImage)>,
    found: Vec<PackedLabels>,
    costs: Vec<FrameCost>,
    refined: Vec<TrainStep>,
}

impl Collected {
    fn save<W: Write>(&self, to: &mut SectionWriter<W>) -> Result<(), SessionError> {
        let Self {
            frames,
            skipped,
            stopped_by: _, // the frame is counted among those skipped
            stopwatch,
            snapshots: _, // of one part only
            judged,
            early_truth,
            found,
            costs,
            refined: _, // only after the last frame
        } = self;
        to.put("frames", frames)?;
        to.put("skipped", skipped)?;
        to.put("stopwatch", stopwatch)?;
        to.put("judged", judged)?;
        to.put("early_truth", early_truth)?;
        to.put("found", found)?;
        to.put("costs", costs)
    }

    fn load<R: Read>(&mut self, from: &mut SectionReader<R>) -> Result<(), SessionError> {
        self.frames = from.take("frames")?;
        self.skipped = from.take("skipped")?;
        self.stopwatch = from.take("stopwatch")?;
        self.judged = from.take("judged")?;
        self.early_truth = from.take("early_truth")?;
        self.found = from.take("found")?;
        self.costs = from.take("costs")?;
        Ok(())
    }

    fn process(&mut self, slam: &mut Slam, frame: &SourceFrame) -> Result<FrameReport> {
        let input = FrameInput {
            t_s: frame.t_s,
            rgb: &frame.rgb,
            depth: &frame.depth,
            mask: frame.mask.as_ref(),
        };
        let waited_ms = self.stopwatch.total_ms("handover");
        let begun = Instant::now();
        let report = slam.process(&input, &mut self.stopwatch)?;
        // Waiting for the map is not tracking; it has a line of its own.
        let waited_ms = self.stopwatch.total_ms("handover") - waited_ms;
        let waited = Duration::from_secs_f64(waited_ms.max(0.0) / 1e3);
        let tracked = begun.elapsed().saturating_sub(waited);
        self.stopwatch.record("frame", tracked);
        self.keep_labels(slam, frame, &report);
        if let Some(truth) = frame.truth.clone().filter(|_| slam.may_restart()) {
            self.early_truth.push((report.id, truth));
        }
        self.correct(&slam.take_replayed(), frame.rgb.size());
        self.costs.push(FrameCost {
            frame: report.id.0,
            tracking_ms: tracked.as_secs_f64() * 1e3,
            waiting_ms: waited.as_secs_f64() * 1e3,
            resident_mb: memory_mb("VmRSS:"),
            processor_ms: processor_ms(),
        });
        Ok(report)
    }

    /// Puts what came of the first frames when they were seen again in the place of what was said
    /// of them before.
    fn correct(&mut self, again: &[ReplayedFrame], size: (usize, usize)) {
        for ReplayedFrame { report, labels } in again {
            if let Some(before) = self.frames.iter_mut().find(|f| f.id == report.id) {
                *before = *report;
            }
            let Some(found) = labels else { continue };
            let after = self.found.partition_point(|f| f.frame < found.frame);
            match self.found.get_mut(after) {
                Some(before) if before.frame == found.frame => *before = PackedLabels::new(found),
                _ => self.found.insert(after, PackedLabels::new(found)),
            }
            let judged = self.judged.frames.iter_mut();
            let truth = self.early_truth.iter().find(|(id, _)| *id == report.id);
            for before in judged.filter(|j| j.t_s.total_cmp(&report.t_s).is_eq()) {
                if let Some((_, truth)) = truth {
                    *before = judge_found(found, report.t_s, size, truth);
                }
            }
        }
        if !again.is_empty() {
            self.early_truth.clear();
        }
    }

    /// Keeps what was found to move, and judges it. A frame in which nothing was found, because it
    /// is one of the first or because the camera is lost, counts as one where nothing moves.
    fn keep_labels(&mut self, slam: &Slam, frame: &SourceFrame, report: &FrameReport) {
        let on = slam.config().labels.enabled && frame.mask.is_none();
        if let (true, Some(truth)) = (on, &frame.truth) {
            let size = frame.rgb.size();
            let judged = slam.labelled_frame().map_or_else(
                || {
                    let last = slam.last_frame().filter(|l| l.id == report.id);
                    let px = last.map_or(&[][..], |l| &l.px);
                    let keypoints = px.iter().map(|p| ([p.x, p.y], false)).collect();
                    judge(
                        keypoints,
                        &MaskImage::new(size.0, size.1, 0),
                        report.t_s,
                        truth,
                    )
                },
                |found| judge_found(found, report.t_s, size, truth),
            );
            self.judged.frames.push(judged);
        }
        self.found
            .extend(slam.labelled_frame().map(PackedLabels::new));
    }
}

fn judge_found(
    found: &LabelledFrame,
    t_s: f64,
    size: (usize, usize),
    truth: &MaskImage,
) -> garad_eval::FrameLabels {
    let moves = |(px, label): &([f64; 2], Label)| (*px, *label == Label::Dynamic);
    let keypoints = found.keypoints.iter().map(moves).collect();
    judge(keypoints, &found.mask(size), t_s, truth)
}

fn judge(
    keypoints: Vec<([f64; 2], bool)>,
    mask: &MaskImage,
    t_s: f64,
    truth: &MaskImage,
) -> garad_eval::FrameLabels {
    garad_eval::FrameLabels {
        t_s,
        keypoints: Some(Confusion::of_keypoints(keypoints, truth)),
        pixels: Confusion::of_masks(mask, truth).ok(),
    }
}

fn state_line(report: &FrameReport, keyframes: usize) -> String {
    format!(
        "{}, {} inliers, {keyframes} keyframes",
        report.state.name(),
        report.inliers
    )
}

/// Evenly spread over the recording, not its very first frame.
fn is_snapshot(i: usize, total: usize) -> bool {
    (1..=SNAPSHOTS).any(|k| i + 1 == (k * total).div_ceil(SNAPSHOTS))
}

fn snapshot(slam: &Slam, frame: SourceFrame, report: &FrameReport) -> Snapshot {
    let keypoints = match slam.last_frame() {
        Some(last) if report.state == TrackingState::Tracking => (0..last.len())
            .map(|k| {
                let role = match (last.label[k], last.landmark[k]) {
                    (Label::Dynamic, _) => KeypointRole::Dynamic,
                    (Label::Static, Some(_)) => KeypointRole::Tracked,
                    (Label::Static, None) => KeypointRole::Free,
                };
                (last.keypoints[k].x, last.keypoints[k].y, role)
            })
            .collect(),
        _ => Vec::new(),
    };
    Snapshot {
        frame: report.id.index(),
        t_s: frame.t_s,
        mask: match slam.labelled_frame() {
            Some(found) => Some(found.mask(frame.rgb.size())),
            None => frame.mask,
        },
        rgb: frame.rgb,
        keypoints,
    }
}

#[cfg(test)]
mod tests {
    use super::is_snapshot;

    #[test]
    fn snapshots_are_spread_and_include_the_last_frame() {
        let taken: Vec<_> = (0..100).filter(|&i| is_snapshot(i, 100)).collect();
        assert_eq!(taken, [19, 39, 59, 79, 99], "of 100");
        let few: Vec<_> = (0..3).filter(|&i| is_snapshot(i, 3)).collect();
        assert_eq!(few, [0, 1, 2], "of 3");
    }
}
