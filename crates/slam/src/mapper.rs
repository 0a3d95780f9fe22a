//! [`Mapper`]: the map of Gaussians and everything that changes it.
//!
//! A keyframe comes in as a [`MappingJob`], with all that the mapper needs to know of tracking's
//! side at that moment; what comes back is a [`MappingDone`]. Nothing is shared, so a job gives the
//! same answer on whatever thread and at whatever time it runs; [`schedule`](crate::schedule)
//! decides both.
//!
//! ```text
//! MappingJob ─→ follow a closed loop ─→ relabel ─→ insert (landmarks, depth) ─→ train × n ─→ MappingDone
//! ```

pub mod densify;
pub mod follow;
pub(crate) mod hindsight;
pub mod insert;
pub mod relabel;
pub mod train;
pub mod view;

use std::io::{Read, Write};
use std::ops::RangeInclusive;

use garad_core::{
    Camera, DepthImage, FrameId, GaussianMap, KeyframeId, Label, LandmarkId, MaskImage, Par,
    RgbImage, Se3,
};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use self::hindsight::{Later, Shown};
use self::insert::{Picture, insert_landmarks, seed_from_depth, untag_dropped};
use self::relabel::{Relabelled, relabel};
use self::train::{Pick, TrainError, TrainStep, Trainer};
use self::view::TrainingView;
use crate::config::{Config, DensifyConfig};
use crate::labels::witness::Witness;
use crate::observer::{Observer, Stage};
use crate::session::{SectionReader, SectionWriter, SessionError};
use crate::system::SlamError;
use crate::trace::TraceRecord;

/// A keyframe, for the mapper.
#[derive(Debug, Clone)]
pub struct MappingJob {
    /// The keyframe.
    pub keyframe: KeyframeId,
    /// The frame it was.
    pub frame: FrameId,
    /// Colour.
    pub rgb: RgbImage,
    /// Metres; 0 and NaN are missing.
    pub depth: DepthImage,
    /// 255 where something moves.
    pub mask: Option<MaskImage>,
    /// The same in the cells of the label stage, if it ran: Gaussians are then labelled, too.
    pub cells: Option<MaskImage>,
    /// Landmarks whose label has changed.
    pub labels: Vec<(LandmarkId, Label)>,
    /// camera_from_world of every keyframe so far, as adjusted.
    pub poses: Vec<Se3>,
    /// If a loop was closed at this keyframe: what it did to every keyframe so far,
    /// after_from_before in the world.
    pub moved: Vec<Se3>,
    /// What the keyframe made.
    pub new_landmarks: Vec<NewLandmark>,
    /// All landmarks that live, ascending: the tags of others are taken off.
    pub living: Vec<LandmarkId>,
    /// Training iterations.
    pub iterations: usize,
}

/// A landmark as the map first sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NewLandmark {
    /// Its id: what its Gaussian is tagged with.
    pub id: LandmarkId,
    /// Where it is, metres.
    pub p_world: Vector3<f64>,
    /// Its keypoint's place in the recorded picture, px.
    pub px: [usize; 2],
}

/// What a job did.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MappingDone {
    /// The keyframe.
    pub keyframe: KeyframeId,
    /// The frame it was.
    pub frame: FrameId,
    /// Labels changed, and Gaussians dropped for theirs.
    pub relabelled: Relabelled,
    /// Gaussians that move.
    pub dynamic: usize,
    /// Gaussians inserted.
    pub inserted: usize,
    /// Gaussians there are now.
    pub gaussians: usize,
    /// Loss of the last iteration, if there was one.
    pub loss: Option<f32>,
    /// Why training stopped early. The map is as it was after the last good iteration.
    pub error: Option<String>,
}

/// The map, what it learns from, and the optimiser's state.
#[derive(Debug)]
pub struct Mapper {
    camera: Camera,
    config: Config,
    gaussians: GaussianMap,
    trainer: Trainer,
    poses: Vec<Se3>,
    /// Of the camera's path, from `poses`.
    extent_m: f64,
    par: Par,
}

impl Mapper {
    /// An empty map.
    ///
    /// # Errors
    /// [`SlamError::Config`] or [`SlamError::Camera`] for values that cannot be.
    pub fn new(camera: &Camera, config: &Config, seed: u64, par: Par) -> Result<Self, SlamError> {
        config.validate()?;
        camera.validate()?;
        Ok(Self {
            camera: *camera,
            config: config.clone(),
            gaussians: GaussianMap::new(0),
            trainer: Trainer::new(camera, seed).map_err(TrainError::from)?,
            poses: Vec::new(),
            extent_m: extent_m(&[]),
            par,
        })
    }

    /// The map.
    #[must_use]
    pub fn gaussians(&self) -> &GaussianMap {
        &self.gaussians
    }

    /// Writes down what the jobs of these frames do.
    pub(crate) fn watch(&mut self, frames: RangeInclusive<u32>) {
        self.trainer.tape.watch(frames);
    }

    pub(crate) fn take_trace(&mut self) -> Vec<TraceRecord> {
        self.trainer.tape.take()
    }

    pub(crate) fn save<W: Write>(&self, to: &mut SectionWriter<W>) -> Result<(), SessionError> {
        let Self {
            camera: _,
            config: _,
            gaussians,
            trainer,
            poses,
            extent_m: _, // from the poses
            par: _,
        } = self;
        to.put("gaussians", gaussians)?;
        to.put("poses", poses)?;
        trainer.save(to)
    }

    /// Into a mapper made for the same camera and configuration.
    pub(crate) fn load<R: Read>(
        &mut self,
        from: &mut SectionReader<R>,
    ) -> Result<(), SessionError> {
        let Self {
            camera: _,
            config: _,
            gaussians,
            trainer,
            poses,
            extent_m: extent,
            par: _,
        } = self;
        *gaussians = from.take("gaussians")?;
        *poses = from.take("poses")?;
        *extent = extent_m(poses);
        trainer.load(from)
    }

    /// Labels what the keyframe sees, inserts what it shows anew, and trains.
    pub fn run(&mut self, job: MappingJob, observer: &mut dyn Observer) -> MappingDone {
        self.trainer.tape.turn_to(job.frame);
        self.trainer
            .tape
            .put("map_before", |page| page.gaussians(&self.gaussians));
        self.poses.clone_from(&job.poses);
        self.extent_m = extent_m(&self.poses);
        follow::follow(&mut self.gaussians, &job.moved);
        observer.begin(Stage::Relabel);
        let relabelled = self.relabel(&job);
        observer.end(Stage::Relabel);
        let before = self.gaussians.len();
        observer.begin(Stage::Insert);
        self.insert(&job);
        observer.end(Stage::Insert);
        self.trainer.tape.put("insert", |page| {
            page.landmarks(&job.living, &job.new_landmarks);
            page.gaussians(&self.gaussians);
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
        };
        let train = &self.config.train;
        if train.keeps_views() {
            let max_depth_m = self.config.features.max_depth_m;
            let labels = &self.config.labels;
            let mask_is_given = job.mask.is_some() && job.cells.is_none();
            let shown = (labels.enabled && labels.hindsight && !mask_is_given)
                .then(|| Shown::new(job.frame, &job.depth, &self.camera, max_depth_m));
            let depth = (train.lambda_depth > 0.0).then_some(job.depth);
            let dilate_px = self.config.labels.dilate_px;
            let mask = job.mask.as_ref();
            let view = TrainingView::new(job.keyframe, job.rgb, depth, mask, dilate_px);
            self.trainer.add_view(match shown {
                Some(shown) => view.judged_later(shown),
                None => view,
            });
            let poses = &self.poses;
            let pose_of = |k: KeyframeId| poses.get(k.index()).copied().unwrap_or_default();
            self.trainer.thin_views(train.max_views, pose_of);
        }
        let grow = self.config.densify.clone();
        for i in 0..job.iterations {
            // Half of the time is the newest keyframe's: it is what the map knows least about.
            let pick = if i % 2 == 0 {
                Pick::Youngest
            } else {
                Pick::Shuffled
            };
            observer.begin(Stage::Train);
            let step = self.step(pick, Some(&grow));
            observer.end(Stage::Train);
            match step {
                Ok(Some(step)) => done.loss = Some(step.loss),
                Ok(None) => break,
                Err(error) => {
                    done.error = Some(format!("keyframe {}: training: {error}", job.keyframe.0));
                    break;
                }
            }
        }
        self.trainer
            .tape
            .put("map_after", |page| page.gaussians(&self.gaussians));
        let labels = self.gaussians.label.iter();
        done.dynamic = labels.filter(|l| **l == Label::Dynamic).count();
        done.gaussians = self.gaussians.len();
        done
    }

    /// One Gaussian for each new landmark, and Gaussians where the map does not explain the keyframe yet.
    fn insert(&mut self, job: &MappingJob) {
        let Some(pose) = self.poses.get(job.keyframe.index()).copied() else {
            return;
        };
        let picture = Picture {
            rgb: &job.rgb,
            depth: &job.depth,
            mask: job.mask.as_ref(),
        };
        let seed = &self.config.seed;
        untag_dropped(&mut self.gaussians, &job.living);
        if seed.landmarks {
            insert_landmarks(
                &mut self.gaussians,
                &job.new_landmarks,
                &job.rgb,
                &self.camera,
                &pose,
                job.keyframe,
                seed,
            );
        }
        seed_from_depth(
            &mut self.gaussians,
            &picture,
            &self.camera,
            &pose,
            job.keyframe,
            seed,
            self.config.features.max_depth_m,
            self.par,
        );
    }

    /// Labels what the keyframe sees, drops what has moved for a whole window, and tells the views
    /// before it what it sees through there.
    fn relabel(&mut self, job: &MappingJob) -> Relabelled {
        let pose = self.poses.get(job.keyframe.index()).copied();
        let (Some(cells), Some(pose)) = (&job.cells, pose) else {
            return Relabelled::default();
        };
        let mut witness = Witness::new(&job.depth, self.config.features.max_depth_m);
        witness.set_moving(cells.clone());
        let windows = self.trainer.windows(&self.gaussians);
        let (mut counts, expired) = relabel(
            &mut self.gaussians,
            windows,
            &job.labels,
            &witness,
            &self.camera,
            &pose,
            &self.config.labels,
        );
        let keep: Vec<bool> = expired.into_iter().map(|e| !e).collect();
        if counts.removed > 0 && self.trainer.retain(&mut self.gaussians, &keep).is_err() {
            counts.removed = 0; // never: there is a decision for every Gaussian
        }
        let later = Later {
            frame: job.frame,
            witness: &witness,
            camera_from_world: pose,
        };
        let poses = &self.poses;
        let pose_of = |k: KeyframeId| poses.get(k.index()).copied().unwrap_or_default();
        self.trainer
            .look_back(&later, &self.camera, &self.config.labels, pose_of);
        counts
    }

    /// Trains for so many iterations on all keyframes, then drops what has faded. `poses` are
    /// those of the keyframes at the end; `on_step` is told of each iteration. Gaussians of any age are
    /// cloned and split, but in the first half only, so that the last ones have time to learn.
    ///
    /// # Errors
    /// [`TrainError`]; the map is then as it was after the last good iteration.
    pub fn refine(
        &mut self,
        iterations: usize,
        poses: Vec<Se3>,
        on_step: &mut dyn FnMut(&TrainStep),
    ) -> Result<(), TrainError> {
        self.extent_m = extent_m(&poses);
        self.poses = poses;
        let of_any_age = DensifyConfig {
            young_keyframes: u32::MAX,
            ..self.config.densify.clone()
        };
        for i in 0..iterations {
            let grow = (2 * i < iterations).then_some(&of_any_age);
            match self.step(Pick::Shuffled, grow)? {
                Some(step) => on_step(&step),
                None => break,
            }
        }
        let min_opacity = self.config.densify.min_opacity;
        self.trainer.prune(&mut self.gaussians, min_opacity)
    }

    fn step(
        &mut self,
        pick: Pick,
        grow: Option<&DensifyConfig>,
    ) -> Result<Option<TrainStep>, TrainError> {
        let grow = grow.filter(|config| config.enabled);
        let poses = &self.poses;
        let pose_of = |k: KeyframeId| poses.get(k.index()).copied().unwrap_or_default();
        self.trainer.step(
            &mut self.gaussians,
            pick,
            pose_of,
            self.extent_m,
            &self.config.train,
            grow,
            self.par,
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
