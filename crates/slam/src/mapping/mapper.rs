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
use std::ops::{ControlFlow, RangeInclusive};
use std::sync::Arc;

use garad_core::{GaussianMap, Label, LandmarkId, Se3};
use garad_crf::{Crf, LabelWindow};
use nalgebra::Vector3;

use super::error::TrainError;
use super::insert::{insert_depth_samples, insert_landmarks, scale_by_neighbours, untag_dropped};
use super::job::{MapFeedback, MappingDone, MappingJob};
use super::loop_correction::apply_loop_correction;
use super::relabel::{Relabelled, assert_labels_agree, push_labels, relabel};
use super::train::{Pick, TrainStep, Trainer, TrainingScene, extent_m};
use super::view::TrainingView;
use super::view_mask::{LaterView, ViewDepth};
use crate::config::{
    ConfigError, DensifyConfig, InitialScale, PointSource, TaggedLabels, TrackingMethod,
};
use crate::context::Context;
use crate::dynamics::free_space::FreeSpace;
use crate::dynamics::gaussian_field::{LabelledGaussian, label_tagged, labels_by_vote};
use crate::dynamics::landmarks::TaggedLabel;
use crate::io::SlamError;
use crate::mask::is_moving_at;
use crate::observer::{Observer, Stage};
use crate::session::sections::{SectionReader, SectionWriter, SessionError};
use crate::trace::{Recorder, TraceRecord};

/// The map, the images it is trained on, and the optimiser's state.
#[derive(Debug)]
pub struct Mapper {
    context: Context,
    gaussians: GaussianMap,
    trainer: Trainer,
    crf: Crf,
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
    /// [`SlamError::Config`] for an invalid setting of the field; [`SlamError::Train`] (none for the settings used
    /// here).
    pub fn new(context: &Context) -> Result<Self, SlamError> {
        Ok(Self {
            context: context.clone(),
            gaussians: GaussianMap::new(0),
            trainer: Trainer::new(&context.camera, context.rng_seed).map_err(TrainError::from)?,
            crf: Crf::new(context.config.crf.clone()).map_err(ConfigError::from)?,
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
            crf: _, // from the configuration
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
        let by_field = self.context.config.labels.source.has_gaussians();
        let before = self.gaussians.len();
        let (relabelled, inserted, feedback) = match by_field {
            true => self.label_by_field_and_insert(&job, observer),
            false => self.label_by_evidence_and_insert(&job, observer),
        };
        self.recorder.record("insert", |record| {
            record.landmarks(&job.living, &job.new_landmarks);
            record.gaussians(&self.gaussians);
        });
        let mut done = MappingDone {
            keyframe: job.keyframe,
            frame: job.frame,
            relabelled,
            dynamic: 0,
            inserted: self.gaussians.len() + relabelled.removed - before,
            gaussians: 0,
            iterations: 0,
            loss: None,
            error: None,
            feedback,
        };
        let iterations = job.iterations;
        self.add_view(job);
        let trained = inserted.and_then(|()| self.train(iterations, observer, &mut done));
        if let Err(error) = trained {
            done.error = Some(format!("keyframe {}: training: {error}", done.keyframe.0));
        }
        self.recorder
            .record("map_after", |record| record.gaussians(&self.gaussians));
        let labels = self.gaussians.label.iter();
        done.dynamic = labels.filter(|l| **l == Label::Dynamic).count();
        done.gaussians = self.gaussians.len();
        self.complete_feedback(&mut done.feedback);
        done
    }

    /// As the default has it: labels from landmarks, the keyframe's mask and its free space; then new Gaussians.
    fn label_by_evidence_and_insert(
        &mut self,
        job: &MappingJob,
        observer: &mut dyn Observer,
    ) -> (Relabelled, Result<(), TrainError>, MapFeedback) {
        observer.begin(Stage::Relabel);
        let relabelled = self.relabel(job);
        self.mask_freed_space(job);
        observer.end(Stage::Relabel);
        observer.begin(Stage::Insert);
        let first = self.gaussians.len();
        self.insert_landmarks(job);
        let inserted = self.insert_depth_samples(job, first);
        observer.end(Stage::Insert);
        (relabelled, inserted, MapFeedback::default())
    }

    /// The paper's loop: the landmarks' Gaussians first, so that those of the keyframe itself are nodes of the field;
    /// the field; Gaussians from depth, with the vote of the labelled ones.
    fn label_by_field_and_insert(
        &mut self,
        job: &MappingJob,
        observer: &mut dyn Observer,
    ) -> (Relabelled, Result<(), TrainError>, MapFeedback) {
        observer.begin(Stage::Insert);
        self.insert_landmarks(job);
        observer.end(Stage::Insert);
        observer.begin(Stage::Relabel);
        self.show_labels();
        let (relabelled, voters, feedback) = self.relabel_by_field(job);
        self.hide_labels();
        self.mask_freed_space(job);
        observer.end(Stage::Relabel);
        observer.begin(Stage::Insert);
        let first = self.gaussians.len();
        let inserted = self.insert_depth_samples(job, first);
        self.label_inserted(job, first, &voters);
        self.hide_labels();
        observer.end(Stage::Insert);
        (relabelled, inserted, feedback)
    }

    /// With `labels.map` off the Gaussians of the map are all static, and what the field called them is the last run
    /// of their windows: shown for the field and for the mask alone.
    fn show_labels(&mut self) {
        if !self.context.config.labels.map {
            let windows = self.trainer.windows(&self.gaussians);
            for (label, window) in self.gaussians.label.iter_mut().zip(windows) {
                *label = match window.dynamic_runs(1) {
                    0 => Label::Static,
                    _ => Label::Dynamic,
                };
            }
        }
    }

    /// Ends [`Mapper::show_labels`].
    fn hide_labels(&mut self) {
        if !self.context.config.labels.map {
            self.gaussians.label.fill(Label::Static);
        }
    }

    /// The field over the tagged Gaussians; the vote of those for the others; and the Gaussians that were dynamic
    /// for a whole window are removed (eq. 7), with `labels.map` off from the field and the mask alone. Restored ones
    /// are static before.
    fn relabel_by_field(
        &mut self,
        job: &MappingJob,
    ) -> (Relabelled, Vec<LabelledGaussian>, MapFeedback) {
        let (map, config) = (&mut self.gaussians, &self.context.config.labels);
        let windows = self.trainer.windows(map);
        let before = self.recorder.is_recording().then(|| {
            let of_window = |w: &LabelWindow| [w.seen(), w.dynamic_runs(config.window.runs - 1)];
            let windows: Vec<_> = windows.iter().map(of_window).collect();
            (map.label.clone(), windows)
        });
        let restored: Vec<Option<LandmarkId>> = (map.landmark.iter())
            .map(|tag| tag.filter(|id| job.restored.contains(id)))
            .collect();
        let as_static: Vec<_> = restored.iter().map(|r| r.map(|_| Label::Static)).collect();
        push_labels(map, windows, &as_static, &config.window);
        let voters = label_tagged(&self.context, &self.crf, map, &job.cues, &mut self.recorder);
        let mut labels = match config.spread.enabled {
            true => labels_by_vote(&self.context, map, 0..map.len(), &voters, &config.spread),
            false => vec![None; map.len()],
        };
        for (label, tag) in labels.iter_mut().zip(&map.landmark) {
            *label = label.filter(|_| tag.is_none());
        }
        for voter in &voters {
            labels[voter.row] = Some(voter.label);
        }
        let (mut counts, expired) = push_labels(map, windows, &labels, &config.window);
        if let Some((label, windows)) = before {
            self.recorder.record("label_gaussians", |record| {
                let restored = restored.iter().flatten().copied();
                record.label_gaussians(map, (&label, &windows), restored, &voters, &expired);
            });
        }
        let tagged = |id, label, removed| TaggedLabel { id, label, removed };
        let restored = restored.iter().flatten();
        let restored = restored.map(|id| tagged(*id, Label::Static, false));
        let by_field = voters.iter().filter_map(|voter| {
            let id = map.landmark[voter.row]?;
            Some(tagged(id, voter.label, expired[voter.row]))
        });
        let feedback = MapFeedback {
            labels: restored.chain(by_field).collect(),
            ..MapFeedback::default()
        };
        if !config.map {
            counts.removed = 0;
            for row in (0..map.len()).filter(|row| expired[*row]) {
                windows[row] = LabelWindow::default();
                map.landmark[row] = None;
            }
        } else if counts.removed > 0 {
            let keep: Vec<bool> = expired.into_iter().map(|e| !e).collect();
            self.trainer.retain(&mut self.gaussians, &keep);
        }
        (counts, voters, feedback)
    }

    /// Labels the Gaussians inserted from row `first` on: by the vote of the labelled ones, and by the keyframe's mask
    /// where that is to decide.
    fn label_inserted(&mut self, job: &MappingJob, first: usize, voters: &[LabelledGaussian]) {
        let (map, config) = (&mut self.gaussians, &self.context.config.labels);
        if !config.spread.enabled {
            return;
        }
        let windows = self.trainer.windows(map);
        let rows = first..map.len();
        let mut labels = vec![None; first];
        labels.extend(labels_by_vote(
            &self.context,
            map,
            rows,
            voters,
            &config.spread,
        ));
        if let Some(mask) = job.mask.as_ref().filter(|_| config.spread.from_mask) {
            let pose = self.poses[job.keyframe.index()];
            let is_in = |mean: &[f32; 3]| {
                let p_cam = pose * Vector3::from(mean.map(f64::from));
                let uv_px = self.context.camera.project(&p_cam);
                let px = uv_px.map(|uv_px| self.context.camera.distort_pixel(&uv_px));
                px.is_some_and(|px| is_moving_at(mask, &px))
            };
            for (label, mean) in labels.iter_mut().zip(&map.means).skip(first) {
                if is_in(mean) {
                    *label = Some(Label::Dynamic);
                }
            }
        }
        push_labels(map, windows, &labels, &config.window);
    }

    /// What tracking needs of the map as it is after the job.
    fn complete_feedback(&mut self, feedback: &mut MapFeedback) {
        let (map, config) = (&self.gaussians, &self.context.config);
        if config.tracking.points == PointSource::Gaussians {
            let tagged = (0..map.len()).filter_map(|row| {
                let mean = Vector3::from(map.means[row].map(f64::from));
                Some((map.landmark[row]?, mean))
            });
            feedback.positions = tagged.collect();
        }
        let renders = config.tracking.method == TrackingMethod::Render;
        feedback.map = renders.then(|| Arc::new(map.clone()));
        if config.labels.source.has_gaussians() {
            self.show_labels();
            let map = &self.gaussians;
            let mut dynamic = map.clone();
            dynamic.retain(|row| map.label[row] == Label::Dynamic);
            feedback.dynamic = Some(dynamic);
            self.hide_labels();
        }
    }

    /// Labels the Gaussians, and drops those that were dynamic for a whole window (eq. 7).
    ///
    /// A keyframe without a mask in cells speaks of landmarks alone, and only where these decide. With
    /// `labels.map` off there is nothing to do.
    fn relabel(&mut self, job: &MappingJob) -> Relabelled {
        let Context { camera, config, .. } = &self.context;
        let pose = self.poses[job.keyframe.index()];
        let free_space = self.free_space(job);
        let by_landmarks = config.labels.tagged == TaggedLabels::Landmark;
        if !config.labels.map || (free_space.is_none() && !by_landmarks) {
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
        counts
    }

    /// Excludes from earlier views what the keyframe shows to be free space.
    fn mask_freed_space(&mut self, job: &MappingJob) {
        let Context { camera, config, .. } = &self.context;
        if let Some(free_space) = self.free_space(job) {
            let later = LaterView {
                frame: job.frame,
                free_space: &free_space,
                camera_from_world: self.poses[job.keyframe.index()],
            };
            self.trainer
                .mask_freed_space(&later, &self.poses, camera, &config.labels);
        }
    }

    /// The free space of a keyframe that was labelled.
    fn free_space(&self, job: &MappingJob) -> Option<FreeSpace> {
        let cells = job.cells.as_ref()?;
        let max_depth_m = self.context.config.features.max_depth_m;
        let mut free_space = FreeSpace::new(&job.depth, max_depth_m);
        free_space.set_moving(cells.clone());
        Some(free_space)
    }

    /// One Gaussian for each new landmark.
    fn insert_landmarks(&mut self, job: &MappingJob) {
        let pose = self.poses[job.keyframe.index()];
        untag_dropped(&mut self.gaussians, &job.living);
        if self.context.config.insertion.landmarks {
            insert_landmarks(&self.context, &mut self.gaussians, job, &pose);
        }
    }

    /// Gaussians where the map does not explain the keyframe yet; the new ones are those from row `first` on.
    fn insert_depth_samples(&mut self, job: &MappingJob, first: usize) -> Result<(), TrainError> {
        let pose = self.poses[job.keyframe.index()];
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
        let finds_freed = labels.enabled && labels.mask_freed_space && train.exclude_moving;
        let view_depth = (finds_freed && !mask_is_given)
            .then(|| ViewDepth::new(job.frame, &job.depth, camera, max_depth_m));
        let depth = (train.lambda_depth > 0.0).then_some(job.depth);
        let mask = job.mask.as_ref().filter(|_| train.exclude_moving);
        let dilate_px = labels.dilate_px;
        let view = TrainingView::new(job.keyframe, job.rgb, depth, mask, dilate_px);
        self.trainer.add_view(view.with_view_depth(view_depth));
        self.trainer.thin_views(train.max_views, &self.poses);
    }

    /// Trains beside tracking ([`Pick::beside_tracking`]).
    fn train(
        &mut self,
        iterations: usize,
        observer: &mut dyn Observer,
        done: &mut MappingDone,
    ) -> Result<(), TrainError> {
        let densify = self.context.config.densify.clone();
        for i in 0..iterations {
            observer.begin(Stage::Train);
            let step = self.step(Pick::beside_tracking(i), Some(&densify));
            observer.end(Stage::Train);
            match step? {
                Some(step) => {
                    done.iterations += 1;
                    done.loss = Some(step.loss);
                }
                None => break,
            }
        }
        Ok(())
    }

    /// Trains for so many iterations on all keyframes after the last frame, then drops faded
    /// Gaussians. `poses` are those of the keyframes at the end; `on_step` is told of each iteration
    /// and may end them.
    /// Gaussians of any age are cloned and split, but in the first half only, so that the last ones
    /// are trained, too.
    ///
    /// # Errors
    /// [`TrainError`]; the map is then as it was after the last good iteration.
    pub fn train_final(
        &mut self,
        iterations: usize,
        poses: Vec<Se3>,
        on_step: &mut dyn FnMut(&TrainStep) -> ControlFlow<()>,
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
                Some(step) if on_step(&step).is_continue() => {}
                _ => break,
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
            window_runs: self.context.config.labels.window.runs,
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

#[cfg(test)]
mod tests;
