//! [`Mapper`]: the map of Gaussians and every stage that changes it.
//!
//! A keyframe comes in as a [`MappingJob`], with all that the mapper needs to know of tracking at
//! that moment; a [`MappingDone`] comes back. Nothing is shared, so a job gives the same answer
//! on whatever thread and at whatever time it runs; [`Mapping`](crate::mapping::Mapping) decides both.
//!
//! ```text
//! MappingJob ─→ loop correction ─→ relabel ─→ insert (landmarks, depth) ─→ train × n ─→ MappingDone
//! ```

use std::io::{Read, Write};
use std::ops::RangeInclusive;
use std::sync::Arc;

use garad_core::{GaussianMap, Label, Se3};
use nalgebra::Vector3;

use super::error::TrainError;
use super::insert::{insert_depth_samples, insert_landmarks, scale_by_neighbours, untag_dropped};
use super::job::{MapFeedback, MappingDone, MappingJob};
use super::loop_correction::apply_loop_correction;
use super::relabel::{Relabelled, assert_labels_agree, relabel};
use super::train::{Pick, TrainStep, Trainer, TrainingScene};
use super::view::TrainingView;
use super::view_mask::{LaterView, ViewDepth};
use crate::config::{DensifyConfig, InitialScale, TaggedLabels, TrackingMethod};
use crate::context::Context;
use crate::dynamics::free_space::FreeSpace;
use crate::io::SlamError;
use crate::observer::{Observer, Stage};
use crate::session::sections::{SectionReader, SectionWriter, SessionError};
use crate::trace::{Recorder, TraceRecord};

/// The map, the images it is trained on, and the optimiser's state.
#[derive(Debug)]
pub struct Mapper {
    context: Context,
    gaussians: GaussianMap,
    trainer: Trainer,
    /// camera_from_world of every keyframe.
    poses: Vec<Se3>,
    /// Extent of the camera's path, from `poses`.
    extent_m: f64,
    recorder: Recorder,
}

impl Mapper {
    /// An empty map.
    ///
    /// # Errors
    /// [`SlamError::Train`] (none for the settings used here).
    pub fn new(context: &Context) -> Result<Self, SlamError> {
        Ok(Self {
            context: context.clone(),
            gaussians: GaussianMap::new(0),
            trainer: Trainer::new(&context.camera, context.rng_seed).map_err(TrainError::from)?,
            poses: Vec::new(),
            extent_m: extent_m(&[]),
            recorder: Recorder::default(),
        })
    }

    /// The map.
    #[must_use]
    pub fn gaussians(&self) -> &GaussianMap {
        &self.gaussians
    }

    /// Records the jobs of these frames.
    pub(crate) fn record_frames(&mut self, frames: Option<RangeInclusive<u32>>) {
        self.recorder.set_frames(frames);
    }

    pub(crate) fn take_trace(&mut self) -> Vec<TraceRecord> {
        self.recorder.take()
    }

    /// Writes what a session must keep.
    pub(crate) fn save<W: Write>(&self, to: &mut SectionWriter<W>) -> Result<(), SessionError> {
        let Self {
            context: _,
            gaussians,
            trainer,
            poses,
            extent_m: _, // from the poses
            recorder: _, // changes no result
        } = self;
        to.put("gaussians", gaussians)?;
        to.put("poses", poses)?;
        trainer.save(to)
    }

    /// Reads what [`Mapper::save`] wrote, into a mapper made for the same context.
    pub(crate) fn load<R: Read>(
        &mut self,
        from: &mut SectionReader<R>,
    ) -> Result<(), SessionError> {
        self.gaussians = from.take("gaussians")?;
        self.poses = from.take("poses")?;
        self.extent_m = extent_m(&self.poses);
        self.trainer.load(from)
    }

    /// Labels the Gaussians that the keyframe sees, inserts new ones, and trains.
    pub fn run(&mut self, job: MappingJob, observer: &mut dyn Observer) -> MappingDone {
        self.recorder.begin_frame(job.frame);
        self.recorder
            .record("map_before", |record| record.gaussians(&self.gaussians));
        self.poses.clone_from(&job.poses);
        self.extent_m = extent_m(&self.poses);
        apply_loop_correction(&mut self.gaussians, &job.moved);
        observer.begin(Stage::Relabel);
        let relabelled = self.relabel(&job);
        observer.end(Stage::Relabel);
        let before = self.gaussians.len();
        observer.begin(Stage::Insert);
        let inserted = self.insert(&job);
        observer.end(Stage::Insert);
        self.recorder.record("insert", |record| {
            record.landmarks(&job.living, &job.new_landmarks);
            record.gaussians(&self.gaussians);
        });
        let mut done = MappingDone {
            keyframe: job.keyframe,
            frame: job.frame,
            relabelled,
            dynamic: 0,
            inserted: self.gaussians.len() - before,
            gaussians: 0,
            loss: None,
            error: None,
            feedback: MapFeedback::default(),
        };
        let iterations = job.iterations;
        self.add_view(job);
        let trained = inserted.and_then(|()| self.train(iterations, observer, &mut done.loss));
        if let Err(error) = trained {
            done.error = Some(format!("keyframe {}: training: {error}", done.keyframe.0));
        }
        self.recorder
            .record("map_after", |record| record.gaussians(&self.gaussians));
        let labels = self.gaussians.label.iter();
        done.dynamic = labels.filter(|l| **l == Label::Dynamic).count();
        done.gaussians = self.gaussians.len();
        let renders = self.context.config.tracking.method == TrackingMethod::Render;
        done.feedback.map = renders.then(|| Arc::new(self.gaussians.clone()));
        done
    }

    /// Labels the Gaussians, drops those that were dynamic for a whole window (eq. 7), and excludes from
    /// earlier views what the keyframe shows to be free space.
    ///
    /// A keyframe without a mask in cells speaks of landmarks alone, and only where these decide.
    fn relabel(&mut self, job: &MappingJob) -> Relabelled {
        let Context { camera, config, .. } = &self.context;
        let pose = self.poses[job.keyframe.index()];
        let free_space = job.cells.as_ref().map(|cells| {
            let mut free_space = FreeSpace::new(&job.depth, config.features.max_depth_m);
            free_space.set_moving(cells.clone());
            free_space
        });
        let by_landmarks = config.labels.tagged == TaggedLabels::Landmark;
        if free_space.is_none() && !by_landmarks {
            return Relabelled::default();
        }
        let windows = self.trainer.windows(&self.gaussians);
        let (counts, expired) = relabel(
            &mut self.gaussians,
            windows,
            &job.labels,
            free_space.as_ref(),
            camera,
            &pose,
            &config.labels,
        );
        if counts.removed > 0 {
            let keep: Vec<bool> = expired.into_iter().map(|e| !e).collect();
            self.trainer.retain(&mut self.gaussians, &keep);
        }
        if cfg!(debug_assertions) {
            assert_labels_agree(
                &self.gaussians,
                &job.labels,
                &job.living,
                config.labels.tagged,
            );
        }
        if let Some(free_space) = &free_space {
            let later = LaterView {
                frame: job.frame,
                free_space,
                camera_from_world: pose,
            };
            self.trainer
                .mask_freed_space(&later, &self.poses, camera, &config.labels);
        }
        counts
    }

    /// One Gaussian for each new landmark, and Gaussians where the map does not explain the keyframe yet.
    fn insert(&mut self, job: &MappingJob) -> Result<(), TrainError> {
        let pose = self.poses[job.keyframe.index()];
        untag_dropped(&mut self.gaussians, &job.living);
        let first = self.gaussians.len();
        if self.context.config.insertion.landmarks {
            insert_landmarks(&self.context, &mut self.gaussians, job, &pose);
        }
        insert_depth_samples(&self.context, &mut self.gaussians, job, &pose)?;
        if self.context.config.insertion.scale == InitialScale::Neighbours {
            scale_by_neighbours(&self.context, &mut self.gaussians, first, &pose);
        }
        Ok(())
    }

    /// Keeps the keyframe's image to train on.
    fn add_view(&mut self, job: MappingJob) {
        let Context { camera, config, .. } = &self.context;
        let (train, labels) = (&config.train, &config.labels);
        if !train.keeps_views() {
            return;
        }
        let mask_is_given = job.mask.is_some() && job.cells.is_none();
        let max_depth_m = config.features.max_depth_m;
        let view_depth = (labels.enabled && labels.mask_freed_space && !mask_is_given)
            .then(|| ViewDepth::new(job.frame, &job.depth, camera, max_depth_m));
        let depth = (train.lambda_depth > 0.0).then_some(job.depth);
        let (mask, dilate_px) = (job.mask.as_ref(), labels.dilate_px);
        let view = TrainingView::new(job.keyframe, job.rgb, depth, mask, dilate_px);
        self.trainer.add_view(view.with_view_depth(view_depth));
        self.trainer.thin_views(train.max_views, &self.poses);
    }

    /// Trains beside tracking: every second iteration on the newest keyframe, which the map knows
    /// least about.
    fn train(
        &mut self,
        iterations: usize,
        observer: &mut dyn Observer,
        loss: &mut Option<f32>,
    ) -> Result<(), TrainError> {
        let densify = self.context.config.densify.clone();
        for i in 0..iterations {
            let pick = match i % 2 {
                0 => Pick::Youngest,
                _ => Pick::Shuffled,
            };
            observer.begin(Stage::Train);
            let step = self.step(pick, Some(&densify));
            observer.end(Stage::Train);
            match step? {
                Some(step) => *loss = Some(step.loss),
                None => break,
            }
        }
        Ok(())
    }

    /// Trains for so many iterations on all keyframes after the last frame, then drops faded
    /// Gaussians. `poses` are those of the keyframes at the end; `on_step` is told of each iteration.
    /// Gaussians of any age are cloned and split, but in the first half only, so that the last ones
    /// are trained, too.
    ///
    /// # Errors
    /// [`TrainError`]; the map is then as it was after the last good iteration.
    pub fn train_final(
        &mut self,
        iterations: usize,
        poses: Vec<Se3>,
        on_step: &mut dyn FnMut(&TrainStep),
    ) -> Result<(), TrainError> {
        self.extent_m = extent_m(&poses);
        self.poses = poses;
        let of_any_age = DensifyConfig {
            young_keyframes: u32::MAX,
            ..self.context.config.densify.clone()
        };
        for i in 0..iterations {
            let densify = (2 * i < iterations).then_some(&of_any_age);
            match self.step(Pick::Shuffled, densify)? {
                Some(step) => on_step(&step),
                None => break,
            }
        }
        let min_opacity = self.context.config.densify.min_opacity;
        self.trainer.prune(&mut self.gaussians, min_opacity);
        Ok(())
    }

    fn step(
        &mut self,
        pick: Pick,
        densify: Option<&DensifyConfig>,
    ) -> Result<Option<TrainStep>, TrainError> {
        let scene = TrainingScene {
            poses: &self.poses,
            extent_m: self.extent_m,
        };
        self.trainer.step(
            &mut self.gaussians,
            pick,
            scene,
            &self.context.config.train,
            densify.filter(|config| config.enabled),
            self.context.par,
            &mut self.recorder,
        )
    }
}

/// Extent of the camera's path: 1.1 times the largest distance of a keyframe from their mean, at
/// least a metre.
fn extent_m(camera_from_world: &[Se3]) -> f64 {
    let centers: Vec<Vector3<f64>> = camera_from_world
        .iter()
        .map(|pose| pose.inverse().translation)
        .collect();
    let n = centers.len().max(1) as f64;
    let mean = centers.iter().fold(Vector3::zeros(), |sum, c| sum + c / n);
    let radius = centers
        .iter()
        .map(|c| (c - mean).norm())
        .fold(0.0, f64::max);
    (1.1 * radius).max(1.0)
}
