//! [`run`]: a recording through the system, frame by frame; [`Run`]: the same, to be saved and resumed.

pub mod judge;
pub mod snapshot;

use std::io::{Read, Write};
use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use garad_core::{Camera, GaussianMap, Par, StampedPose};
use garad_slam::mapping::train::TrainStep;
use garad_slam::session::{SectionReader, SectionWriter};
use garad_slam::{Config, FrameReport, SessionError, Slam};

use self::judge::LabelLog;
use self::snapshot::Snapshot;
use crate::interrupt;
use crate::progress::{Progress, note};
use crate::reason::reason;
use crate::recording::Recording;
use crate::source::SourceFrame;
use crate::stopwatch::{SharedStopwatch, Stopwatch};
use crate::usage::{FrameCost, processor_ms, resident_mb};

/// How a recording is run.
#[derive(Debug, Clone)]
pub struct RunOptions {
    /// The pipeline's configuration.
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

/// What a run collects on its way.
#[derive(Debug, Default)]
pub struct RunLog {
    /// One report per frame processed.
    pub frames: Vec<FrameReport>,
    /// Frames that could not be read or used, and failed mapping jobs, with the reason.
    pub skipped: Vec<String>,
    /// The error that ended a strict run early.
    pub stopped_by: Option<anyhow::Error>,
    /// Ended early by [`interrupt::asked`].
    pub interrupted: bool,
    /// Durations per stage.
    pub stopwatch: Stopwatch,
    /// Images for the report.
    pub snapshots: Vec<Snapshot>,
    /// Labels of the frames.
    pub labels: LabelLog,
    /// What every frame cost.
    pub costs: Vec<FrameCost>,
    /// The iterations of the training after the last frame.
    pub refined: Vec<TrainStep>,
}

/// The result of a run.
#[derive(Debug)]
pub struct RunResult {
    /// The system after the last frame.
    pub slam: Slam,
    /// Threads it ran on.
    pub threads: usize,
    /// Frames of the recording that are done, skipped ones included.
    pub done: usize,
    /// The path, one pose per tracked frame.
    pub trajectory: Vec<StampedPose>,
    /// Wall time of the run, seconds.
    pub wall_s: f64,
    /// What was collected on the way.
    pub log: RunLog,
}

impl RunResult {
    /// The map of Gaussians.
    ///
    /// # Panics
    /// Never: [`Run::finish`] waits for mapping.
    #[must_use]
    pub fn gaussians(&self) -> &GaussianMap {
        self.slam.gaussians().expect("mapping has finished")
    }

    /// Where a run of `total` frames was interrupted, if it was.
    #[must_use]
    pub fn interruption(&self, total: usize) -> Option<String> {
        self.log.interrupted.then(|| match self.done < total {
            true => format!("interrupted after {} of {total} frames", self.done),
            false => format!("interrupted after all {total} frames, in training or evaluation"),
        })
    }
}

/// Takes every frame through the system.
///
/// # Errors
/// An invalid configuration or camera. A frame that cannot be read is skipped and counted, or, if
/// `strict`, ends the run: what was computed until then is still returned.
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

/// A run: started or resumed, taken through frames, saved, finished.
#[derive(Debug)]
pub struct Run {
    slam: Slam,
    options: RunOptions,
    mapping: SharedStopwatch,
    log: RunLog,
    /// Frames of the recording that are done, skipped ones included.
    done: usize,
    begun: Instant,
    /// Wall time of the parts before this one.
    earlier_s: f64,
}

impl Run {
    /// Before the first frame.
    ///
    /// # Errors
    /// An invalid configuration or camera.
    pub fn new(camera: &Camera, options: &RunOptions) -> Result<Self> {
        let par = Par::new(options.threads);
        let slam = Slam::new(*camera, options.config.clone(), options.seed, par)
            .context("the run cannot start")?;
        Ok(Self::with(slam, options.clone()))
    }

    /// A run saved by [`Run::save`], and the recording it was made from. Camera, configuration and seed
    /// must be the saved ones; the number of threads and of final training iterations may differ.
    ///
    /// # Errors
    /// A state that cannot be read, or the first difference between the two.
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
        run.log = RunLog::load(&mut from)?;
        run.log.stopwatch.record("load_session", begun.elapsed());
        Ok((run, recording))
    }

    /// Tracking alone, in the unchanged map of a run saved by [`Run::save`]. Configuration and seed are
    /// the saved ones.
    ///
    /// # Errors
    /// A state that cannot be read, or a different camera.
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
        run.log.stopwatch.record("load_session", loaded);
        Ok(run)
    }

    fn with(slam: Slam, options: RunOptions) -> Self {
        let mapping = SharedStopwatch::default();
        Self {
            slam: slam.with_mapping_observer(Box::new(mapping.clone())),
            options,
            mapping,
            log: RunLog::default(),
            done: 0,
            begun: Instant::now(),
            earlier_s: 0.0,
        }
    }

    /// Frames of the recording that are done, skipped ones included.
    #[must_use]
    pub fn done(&self) -> usize {
        self.done
    }

    /// The system after the last frame.
    #[must_use]
    pub fn slam(&self) -> &Slam {
        &self.slam
    }

    /// Writes everything that the rest of the run and its results depend on. Images for the report are
    /// not included: the report of a resumed run shows frames of its last part.
    ///
    /// # Errors
    /// A failed write; a mapping thread that panicked.
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
            log,
            done,
            begun,
            earlier_s,
        } = self;
        log.stopwatch.merge(&mapping.take());
        let mut to = SectionWriter::new(out)?;
        to.put("recording", recording)?;
        to.put("done", done)?;
        to.put("earlier_s", &(*earlier_s + begun.elapsed().as_secs_f64()))?;
        log.save(&mut to)?;
        log.stopwatch.record("save_session", saving.elapsed());
        Ok(())
    }

    /// Takes the next frames through the system. `total` is the number of frames of the recording, those
    /// done before included. A frame that cannot be read is skipped and counted, or, if `strict`, ends
    /// the run, as an interrupt does.
    pub fn process(&mut self, mut frames: impl Iterator<Item = Result<SourceFrame>>, total: usize) {
        let left = total.saturating_sub(self.done);
        let mut progress = Progress::new("tracking", left, self.options.quiet);
        let (slam, log) = (&mut self.slam, &mut self.log);
        let mut waiting = Instant::now();
        while !log.interrupt_at(self.done < total) {
            let Some(frame) = frames.next() else {
                break;
            };
            let i = self.done;
            self.done += 1;
            log.stopwatch.record("wait_for_frame", waiting.elapsed());
            let outcome = frame.and_then(|frame| {
                let report = log.process(slam, &frame)?;
                Ok((frame, report))
            });
            match outcome {
                Ok((frame, report)) => {
                    if snapshot::is_wanted(i, total) {
                        log.snapshots.push(Snapshot::new(slam, frame, &report));
                    }
                    progress.step(&state_line(&report, slam.map().keyframes().len()));
                    log.frames.push(report);
                }
                Err(error) => {
                    progress.step("frame skipped");
                    log.skipped.push(reason(&error));
                    if self.options.strict {
                        log.stopped_by = Some(error);
                        break;
                    }
                }
            }
            waiting = Instant::now();
        }
        progress.finish();
    }

    /// Waits for the last mapping jobs and trains the map, if that was asked for.
    ///
    /// # Errors
    /// A mapping thread that panicked.
    pub fn finish(self) -> Result<RunResult> {
        let Self {
            mut slam,
            options,
            mapping,
            mut log,
            done,
            begun,
            earlier_s,
        } = self;
        let waiting = Instant::now();
        slam.finish().context("the map is lost")?;
        log.stopwatch.record("handover", waiting.elapsed());
        log.train(&mut slam, &options);
        log.stopwatch.merge(&mapping.take());
        let failed = slam.mapped().iter().filter_map(|done| done.error.clone());
        log.skipped.extend(failed);
        Ok(RunResult {
            trajectory: slam.trajectory(),
            slam,
            threads: options.threads.max(1),
            done,
            wall_s: earlier_s + begun.elapsed().as_secs_f64(),
            log,
        })
    }
}

impl RunLog {
    fn save<W: Write>(&self, to: &mut SectionWriter<W>) -> Result<(), SessionError> {
        let Self {
            frames,
            skipped,
            stopped_by: _,  // the frame is counted among those skipped
            interrupted: _, // the part that follows is not
            stopwatch,
            snapshots: _, // of one part only
            labels,
            costs,
            refined: _, // only after the last frame
        } = self;
        to.put("frames", frames)?;
        to.put("skipped", skipped)?;
        to.put("stopwatch", stopwatch)?;
        labels.save(to)?;
        to.put("costs", costs)
    }

    fn load<R: Read>(from: &mut SectionReader<R>) -> Result<Self, SessionError> {
        Ok(Self {
            frames: from.take("frames")?,
            skipped: from.take("skipped")?,
            stopwatch: from.take("stopwatch")?,
            labels: LabelLog::load(from)?,
            costs: from.take("costs")?,
            ..Self::default()
        })
    }

    /// Whether the run is to end here. It is interrupted only if there is work left.
    fn interrupt_at(&mut self, work_left: bool) -> bool {
        if work_left && !self.interrupted && interrupt::asked() {
            self.interrupted = true;
            note("interrupted: results so far are being written; once more to stop at once");
        }
        self.interrupted
    }

    fn process(&mut self, slam: &mut Slam, frame: &SourceFrame) -> Result<FrameReport> {
        let waited_ms = self.stopwatch.total_ms("handover");
        let begun = Instant::now();
        let report = slam.process(&frame.input(), &mut self.stopwatch)?;
        // Waiting for the map is not tracking; it has an entry of its own.
        let waited_ms = self.stopwatch.total_ms("handover") - waited_ms;
        let waited = Duration::from_secs_f64(waited_ms.max(0.0) / 1e3);
        let tracked = begun.elapsed().saturating_sub(waited);
        self.stopwatch.record("frame", tracked);
        self.labels.add(slam, frame, &report);
        let replayed = slam.take_replayed();
        for again in &replayed {
            if let Some(old) = self.frames.iter_mut().find(|f| f.id == again.report.id) {
                *old = again.report;
            }
        }
        self.labels.replace(&replayed);
        self.costs.push(FrameCost {
            frame: report.id.0,
            tracking_ms: tracked.as_secs_f64() * 1e3,
            waiting_ms: waited.as_secs_f64() * 1e3,
            resident_mb: resident_mb(),
            processor_ms: processor_ms(),
        });
        Ok(report)
    }

    /// Trains the map after the last frame. An error leaves the map as it was before, and is added to
    /// `skipped`: the trajectory does not depend on it.
    fn train(&mut self, slam: &mut Slam, options: &RunOptions) {
        let iterations = options.config.train.final_iterations;
        if iterations == 0 || self.interrupt_at(true) {
            return;
        }
        let mut progress = Progress::new("training", iterations, options.quiet);
        let mut begun = Instant::now();
        let outcome = slam.train_final(&mut |step| {
            self.stopwatch.record("refine", begun.elapsed());
            self.refined.push(*step);
            begun = Instant::now();
            progress.step(&format!("loss {:.4} at 1/{}", step.loss, 1 << step.level));
            match self.interrupt_at(self.refined.len() < iterations) {
                true => ControlFlow::Break(()),
                false => ControlFlow::Continue(()),
            }
        });
        progress.finish();
        if let Err(error) = outcome {
            self.skipped.push(error.to_string());
        }
    }
}

fn state_line(report: &FrameReport, keyframes: usize) -> String {
    let (state, inliers) = (report.state.name(), report.inliers);
    format!("{state}, {inliers} inliers, {keyframes} keyframes")
}
