//! [`Slam`]: the state of a run and the order of stages.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;
use std::sync::Arc;

use garad_core::{
    Camera, CameraError, DepthImage, FrameId, GaussianMap, GrayImage, KeyframeId, Label,
    LandmarkId, MaskImage, Par, RgbImage, Se3, StampedPose,
};
use garad_crf::Crf;
use garad_features::{FeatureError, LkPyramid, OrbConfig, OrbExtractor, PlaceConfig, PlaceIndex};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::config::{Config, ConfigError};
use crate::frame::{Frame, Levels};
use crate::labels::frame::{FrameLabels, Lattice};
use crate::labels::witness::Witness;
use crate::loop_closing::{LoopCloser, LoopClosure};
use crate::map::Map;
use crate::mapper::train::{TrainError, TrainStep};
use crate::mapper::{Mapper, MappingDone};
use crate::observer::{Observer, Stage};
use crate::opening::{Foresight, Opening, SecondSight};
use crate::schedule::{MappingObserver, Schedule};
use crate::trace::{Tape, TraceRecord};
use crate::tracker::TrackingState;

/// One picture of the recording.
#[derive(Debug, Clone, Copy)]
pub struct FrameInput<'a> {
    /// Time stamp of the colour picture, seconds, ascending.
    pub t_s: f64,
    /// Colour.
    pub rgb: &'a RgbImage,
    /// Metres along z, registered to colour; 0 and NaN are missing.
    pub depth: &'a DepthImage,
    /// 255 where something moves; features there take part in nothing.
    pub mask: Option<&'a MaskImage>,
}

/// What became of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FrameReport {
    /// Position in the recording.
    pub id: FrameId,
    /// Time stamp, seconds.
    pub t_s: f64,
    /// State after the frame.
    pub state: TrackingState,
    /// ORB features.
    pub keypoints: usize,
    /// Of these on moving things.
    pub dynamic_keypoints: usize,
    /// Landmarks that agree with the pose.
    pub inliers: usize,
    /// The keyframe it became.
    pub keyframe: Option<KeyframeId>,
    /// The pose, as far as known now; later adjustment may still move it.
    pub camera_from_world: Option<Se3>,
}

/// What stops a run.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SlamError {
    /// The configuration cannot be.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The calibration cannot be.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// A picture whose size is not the camera's.
    #[error(
        "frame {frame}: the {what} picture is {got:?} pixels, the calibration says {expected:?}"
    )]
    SizeMismatch {
        /// Which frame.
        frame: FrameId,
        /// colour, depth or mask.
        what: &'static str,
        /// Its size.
        got: (usize, usize),
        /// The calibrated size.
        expected: (usize, usize),
    },
    /// The map could not be drawn or trained.
    #[error("training: {0}")]
    Train(#[from] TrainError),
    /// The mapping thread broke down, and the map with it. The path stays.
    #[error("the mapping thread broke down; expected it to answer")]
    MappingLost,
    /// Features could not be found.
    #[error("frame {frame}: {source}")]
    Features {
        /// Which frame.
        frame: FrameId,
        /// Why.
        source: FeatureError,
    },
}

/// A frame's pose relative to a keyframe, so that it follows when the keyframe is adjusted.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
pub(crate) struct Record {
    t_s: f64,
    reference: KeyframeId,
    frame_from_reference: Se3,
}

/// A run of the system.
#[derive(Debug)]
pub struct Slam {
    pub(crate) camera: Camera,
    pub(crate) config: Config,
    pub(crate) scales: Vec<f64>,
    pub(crate) seed: u64,
    pub(crate) map: Map,
    pub(crate) last: Option<Frame>,
    pub(crate) velocity: Option<Se3>,
    pub(crate) reference: KeyframeId,
    pub(crate) last_keyframe_frame: FrameId,
    pub(crate) recent: Vec<LandmarkId>,
    /// Keyframes by what they look like.
    pub(crate) places: PlaceIndex,
    pub(crate) loops: LoopCloser,
    pub(crate) extractor: OrbExtractor,
    pub(crate) levels: Levels,
    /// Pictures of the youngest keyframes, for refinement.
    pub(crate) pyramids: BTreeMap<KeyframeId, Arc<LkPyramid>>,
    /// The last tracked frame's picture, for the flow check.
    pub(crate) last_pyramid: Option<Arc<LkPyramid>>,
    /// Depth of the keyframes, to ask what was where.
    pub(crate) witnesses: BTreeMap<KeyframeId, Witness>,
    pub(crate) lattice: Lattice,
    pub(crate) crf: Crf,
    /// What moves in the last tracked frame.
    pub(crate) frame_labels: Option<FrameLabels>,
    /// The first frames, until it is known whether the run must begin again.
    pub(crate) opening: Option<Opening>,
    /// Depth of frames yet to come, while the run begins again.
    pub(crate) foresight: Vec<Foresight>,
    pub(crate) second_sight: Vec<SecondSight>,
    pub(crate) schedule: Schedule,
    /// What became of every keyframe's job.
    pub(crate) mapped: Vec<MappingDone>,
    pub(crate) state: TrackingState,
    pub(crate) recovered_at: Option<FrameId>,
    pub(crate) next_frame: FrameId,
    pub(crate) records: Vec<Record>,
    /// The map is finished: frames are tracked in it and change nothing.
    pub(crate) localising: bool,
    pub(crate) tape: Tape,
    pub(crate) par: Par,
}

impl Slam {
    /// An empty map, waiting for its first frame.
    ///
    /// # Errors
    /// [`SlamError::Config`] or [`SlamError::Camera`] for values that cannot be.
    pub fn new(camera: Camera, config: Config, seed: u64, par: Par) -> Result<Self, SlamError> {
        config.validate()?;
        camera.validate()?;
        let features = &config.features;
        let mut scales = vec![1.0];
        for _ in 1..features.levels {
            scales.push(scales[scales.len() - 1] * features.scale);
        }
        #[allow(
            clippy::cast_possible_truncation,
            reason = "1.2 as the f32 it is defined in"
        )]
        let scale = features.scale as f32;
        let size = (camera.width, camera.height);
        let levels = Levels::new(size, scale, features.levels, features.exact_levels);
        let extractor = OrbExtractor::new(OrbConfig {
            features: features.count,
            scale,
            levels: features.levels,
            threshold: features.fast_threshold,
            min_threshold: features.fast_min_threshold,
            ..OrbConfig::default()
        })
        .map_err(|source| SlamError::Features {
            frame: FrameId(0),
            source,
        })?;
        let places = PlaceIndex::new(PlaceConfig::default(), seed);
        let places = places.map_err(|source| SlamError::Features {
            frame: FrameId(0),
            source,
        })?;
        let lattice = Lattice::new(&camera, config.labels.step_px);
        let crf = Crf::new(config.crf.clone()).map_err(ConfigError::from)?;
        let mapper = Mapper::new(&camera, &config, seed, par)?;
        let labels = &config.labels;
        let opening = (labels.enabled && labels.second_sight).then(Opening::default);
        let beside = par.threads() > 1;
        let schedule = Schedule::new(mapper, config.schedule.handover_frames, beside);
        Ok(Self {
            camera,
            config,
            scales,
            seed,
            map: Map::default(),
            last: None,
            velocity: None,
            reference: KeyframeId(0),
            last_keyframe_frame: FrameId(0),
            recent: Vec::new(),
            places,
            loops: LoopCloser::default(),
            extractor,
            levels,
            pyramids: BTreeMap::new(),
            last_pyramid: None,
            witnesses: BTreeMap::new(),
            lattice,
            crf,
            frame_labels: None,
            opening,
            foresight: Vec::new(),
            second_sight: Vec::new(),
            schedule,
            mapped: Vec::new(),
            state: TrackingState::NotInitialised,
            recovered_at: None,
            next_frame: FrameId(0),
            records: Vec::new(),
            localising: false,
            tape: Tape::default(),
            par,
        })
    }

    /// Tells `observer` of the mapper's stages, from whatever thread it runs in. To be called before
    /// the first frame.
    #[must_use]
    pub fn with_mapping_observer(mut self, observer: MappingObserver) -> Self {
        self.schedule.observe(observer);
        self
    }

    /// Writes down what goes into and comes out of every stage of these frames. To be called before
    /// the first frame. Nothing of the result changes.
    #[must_use]
    pub fn with_trace(mut self, frames: RangeInclusive<u32>) -> Self {
        if let Some(mapper) = self.schedule.mapper_mut() {
            mapper.watch(frames.clone());
        }
        self.tape.watch(frames);
        self
    }

    /// The trace so far, tracking and mapping of each frame together, in the order of the data. What
    /// the mapper wrote is missing while it is under way: call [`Slam::finish`] before.
    pub fn take_trace(&mut self) -> Vec<TraceRecord> {
        let mut records = self.tape.take();
        records.extend(
            self.schedule
                .mapper_mut()
                .map(Mapper::take_trace)
                .unwrap_or_default(),
        );
        records.sort_by_key(|record| record.frame); // stable
        records
    }

    /// Takes the next frame through tracking and, if it is kept, starts its mapping. Mapping jobs
    /// that are due are taken over first.
    ///
    /// After the last frame of the bootstrap the run may begin again, in this call
    /// ([`Slam::take_second_sight`]).
    ///
    /// A frame that cannot be tracked is not an error: the state turns to
    /// [`TrackingState::Lost`], and later frames are looked for among the keyframes.
    ///
    /// # Errors
    /// [`SlamError::SizeMismatch`] or [`SlamError::Features`]; the state before the frame stays,
    /// and the next frame may be given. [`SlamError::MappingLost`].
    pub fn process(
        &mut self,
        input: &FrameInput<'_>,
        observer: &mut dyn Observer,
    ) -> Result<FrameReport, SlamError> {
        let report = self.advance(input, observer)?;
        self.see_again(report, observer)
    }

    /// [`Slam::process`] without looking back.
    pub(crate) fn advance(
        &mut self,
        input: &FrameInput<'_>,
        observer: &mut dyn Observer,
    ) -> Result<FrameReport, SlamError> {
        let id = self.next_frame;
        self.next_frame = FrameId(id.0 + 1);
        self.check_sizes(id, input)?;
        self.tape.turn_to(id);
        while self.schedule.is_due(id) {
            observer.begin(Stage::Handover);
            let taken = self.take_over();
            observer.end(Stage::Handover);
            taken?;
        }

        observer.begin(Stage::Orb);
        let gray = input.rgb.to_gray();
        let wanted = self.wanted_keypoints();
        self.extractor.look_for(wanted);
        let found = self.extractor.extract(&gray, self.par);
        observer.end(Stage::Orb);
        let pyramid = self.picture(&gray).map(Arc::new);
        let features = found.map_err(|source| SlamError::Features { frame: id, source })?;
        let mut frame = Frame::new(
            id,
            input.t_s,
            features.keypoints,
            features.descriptors,
            input.depth,
            input.mask,
            &self.camera,
            &self.levels,
            &self.config,
        );
        self.tape.put("input", |page| page.input(input));
        let (scale, levels) = (self.config.features.scale, self.config.features.levels);
        self.tape
            .put("orb", |page| page.orb(&gray, scale, levels, wanted, &frame));
        self.tape.put("keypoints", |page| page.keypoints(&frame));
        if let Some(surface) = &frame.surface {
            self.tape.put("surface", |page| page.surface(surface));
        }

        if input.mask.is_some() || self.localising {
            self.opening = None;
        } else if let Some(opening) = &mut self.opening {
            opening.take(input, &frame);
        }
        let mut cells = None;
        let inliers = match self.state {
            TrackingState::NotInitialised => {
                cells = self.label_frame(&mut frame, input.depth, pyramid.as_deref());
                self.initialise(&mut frame)
            }
            TrackingState::Tracking | TrackingState::Lost => {
                self.track(&mut frame, pyramid.as_deref(), input, &mut cells, observer)
            }
        };
        self.frame_labels = cells.as_ref().map(|cells| FrameLabels {
            frame: id,
            keypoints: frame
                .px
                .iter()
                .map(|p| [p.x, p.y])
                .zip(frame.label.iter().copied())
                .collect(),
            cells: cells.clone(),
        });
        let mut report = FrameReport {
            id,
            t_s: input.t_s,
            state: self.state,
            keypoints: frame.len(),
            dynamic_keypoints: frame.label.iter().filter(|l| **l == Label::Dynamic).count(),
            inliers,
            keyframe: None,
            camera_from_world: None,
        };
        if self.state == TrackingState::Tracking {
            // Before any adjustment: both poses of the difference stand on the same map.
            self.velocity = self.velocity_to(&frame);
            let kept = !self.localising
                && (self.map.keyframes().is_empty() || self.needs_keyframe(&frame, inliers));
            self.tape
                .put("keyframe", |page| page.decision(inliers, &frame, kept));
            if kept {
                let keyframe = self.keep(frame.clone(), input, cells, observer)?;
                report.keyframe = Some(keyframe);
                self.remember_picture(keyframe, pyramid.clone());
                // The adjusted keyframe is what the next frame starts from.
                frame = self.map.keyframe(keyframe).clone();
            }
            let reference = self.map.keyframe(self.reference);
            self.records.push(Record {
                t_s: input.t_s,
                reference: self.reference,
                frame_from_reference: frame.camera_from_world
                    * reference.camera_from_world.inverse(),
            });
            self.tape
                .put("trajectory", |page| page.trajectory(&frame, &self.map));
            report.camera_from_world = Some(frame.camera_from_world);
            self.last = Some(frame);
            self.last_pyramid = pyramid;
        }
        Ok(report)
    }

    /// The path so far: every tracked frame, moved along with its adjusted keyframe.
    #[must_use]
    pub fn trajectory(&self) -> Vec<StampedPose> {
        self.records
            .iter()
            .map(|r| StampedPose {
                t_s: r.t_s,
                world_from_camera: (r.frame_from_reference
                    * self.map.keyframe(r.reference).camera_from_world)
                    .inverse(),
            })
            .collect()
    }

    /// The keyframes' poses.
    #[must_use]
    pub fn keyframe_trajectory(&self) -> Vec<StampedPose> {
        self.map
            .keyframes()
            .iter()
            .map(|k| StampedPose {
                t_s: k.t_s,
                world_from_camera: k.camera_from_world.inverse(),
            })
            .collect()
    }

    /// Takes over every mapping job under way. From here until the next keyframe
    /// [`Slam::gaussians`] has an answer.
    ///
    /// # Errors
    /// [`SlamError::MappingLost`].
    pub fn finish(&mut self) -> Result<(), SlamError> {
        while self.take_over()? {}
        self.schedule.come_home()
    }

    /// Trains the map on the keyframes' pictures for `config.train.refine` iterations, after the
    /// last frame; `on_step` is told of each. Gaussians that have faded are dropped.
    ///
    /// # Errors
    /// [`SlamError::Train`]; the map is then as it was after the last good iteration.
    /// [`SlamError::MappingLost`].
    pub fn refine_map(&mut self, on_step: &mut dyn FnMut(&TrainStep)) -> Result<(), SlamError> {
        self.finish()?;
        let poses = self.keyframe_poses();
        let iterations = self.config.train.refine;
        let mapper = self.schedule.mapper_mut().ok_or(SlamError::MappingLost)?;
        Ok(mapper.refine(iterations, poses, on_step)?)
    }

    /// Waits for the oldest job under way; `false` if there is none.
    fn take_over(&mut self) -> Result<bool, SlamError> {
        let Some(done) = self.schedule.take()? else {
            return Ok(false);
        };
        tracing::debug!(
            keyframe = done.keyframe.0,
            inserted = done.inserted,
            gaussians = done.gaussians,
            loss = done.loss,
            "mapped"
        );
        self.mapped.push(done);
        Ok(true)
    }

    pub(crate) fn keyframe_poses(&self) -> Vec<Se3> {
        self.map
            .keyframes()
            .iter()
            .map(|k| k.camera_from_world)
            .collect()
    }

    /// Landmarks and keyframes.
    #[must_use]
    pub fn map(&self) -> &Map {
        &self.map
    }

    /// The map of Gaussians; `None` while jobs are under way in another thread: call
    /// [`Slam::finish`] before.
    #[must_use]
    pub fn gaussians(&self) -> Option<&GaussianMap> {
        self.schedule.mapper().map(Mapper::gaussians)
    }

    /// What became of the mapping jobs handed over so far.
    #[must_use]
    pub fn mapped(&self) -> &[MappingDone] {
        &self.mapped
    }

    /// The loops that were closed, oldest first.
    #[must_use]
    pub fn loops(&self) -> &[LoopClosure] {
        self.loops.closed()
    }

    /// The last tracked frame, with the landmarks its keypoints were linked to.
    #[must_use]
    pub fn last_frame(&self) -> Option<&Frame> {
        self.last.as_ref()
    }

    /// What moves in the last frame; `None` if that was not asked: lost, bootstrap, or a mask given.
    #[must_use]
    pub fn frame_labels(&self) -> Option<&FrameLabels> {
        self.frame_labels.as_ref()
    }

    /// The camera.
    #[must_use]
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// The configuration.
    #[must_use]
    pub fn config(&self) -> &Config {
        &self.config
    }

    /// Where people cover half the picture, half of all keypoints are theirs. So as many are looked
    /// for as leave `features.count` to use if the share is that of the last frame.
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "between 1 and 10 times a usize of at most 100 000"
    )]
    fn wanted_keypoints(&self) -> usize {
        let config = &self.config.features;
        let last = self.last.as_ref().filter(|last| !last.is_empty());
        let times = last.map_or(1.0, |last| {
            let in_use = last.in_use.iter().filter(|in_use| **in_use).count();
            (last.len() as f64 / in_use as f64).min(config.most_times)
        });
        (config.count as f64 * times) as usize
    }

    /// The picture as Lucas-Kanade wants it, if anything does.
    pub(crate) fn picture(&self, gray: &GrayImage) -> Option<LkPyramid> {
        let (labels, flow) = (&self.config.labels, &self.config.flow);
        let for_labels = labels.enabled && (flow.enabled || labels.displacement.enabled);
        let wanted = self.config.refine.enabled || for_labels;
        wanted.then(|| LkPyramid::new(gray, self.picture_levels()).ok())?
    }

    fn check_sizes(&self, frame: FrameId, input: &FrameInput<'_>) -> Result<(), SlamError> {
        let expected = (self.camera.width, self.camera.height);
        let sizes = [
            ("colour", Some(input.rgb.size())),
            ("depth", Some(input.depth.size())),
            ("mask", input.mask.map(MaskImage::size)),
        ];
        for (what, got) in sizes {
            if let Some(got) = got.filter(|g| *g != expected) {
                return Err(SlamError::SizeMismatch {
                    frame,
                    what,
                    got,
                    expected,
                });
            }
        }
        Ok(())
    }
}
