//! What moves: the paper's sections III-A and III-B, and the one place that answers that question
//! (decision 005).
//!
//! ```text
//! first pose ─→ samples ─→ free space of the last seconds, patch motion ─→ evidence ─→ random field ←─┐
//!                                                                                          │          │
//! FrameLabels ←─ mask, keypoint labels ←───────────────────────────────────────────────────┴─→ flow check
//! ```
//!
//! The paper labels the tagged Gaussians once per keyframe. A person who walks in has no landmark
//! yet; so the same field also runs over the samples of every single frame (keypoints and a lattice of
//! pixels), whose one cue is the depth residual against the free space of earlier frames. At a
//! keyframe it runs over the landmarks of the local map with all four cues.
//!
//! | file | what | paper |
//! |---|---|---|
//! | `samples`, `field`, `mask` | a frame's field and its mask | III-A, eq. 1 to 6 |
//! | `cues`, [`landmarks`], `retention` | a keyframe's landmarks | III-A, eq. 1 to 7 |
//! | `free_space`, `evidence` | the depth cue | β of eq. 2 |
//! | `flow_check` | suspects restored | III-B, eq. 9, 10 |
//! | `gaussian_field`, `gaussian_mask` | the paper's loop (`labels.source`) | III-A, III-B |
//! | `bootstrap` | the first frames | III-A |
//! | `patch_motion` | motion within the own outline | decision 012 |
//! | `past` | what earlier frames saw | |

pub(crate) mod bootstrap;
pub(crate) mod cues;
pub(crate) mod evidence;
pub(crate) mod field;
pub(crate) mod flow_check;
pub(crate) mod free_space;
pub(crate) mod gaussian_field;
pub(crate) mod gaussian_mask;
pub mod landmarks;
pub(crate) mod mask;
pub(crate) mod past;
pub(crate) mod patch_motion;
pub(crate) mod retention;
pub(crate) mod samples;

use std::collections::{BTreeSet, VecDeque};
use std::io::{Read, Write};
use std::sync::Arc;

use garad_core::{DepthImage, FrameId, GaussianMap, KeyframeId, LandmarkId, MaskImage};
use garad_crf::Crf;
use garad_features::LkPyramid;

use self::bootstrap::{BootstrapBuffer, FutureView, future_views, patch_motion_pyramid};
use self::evidence::{FreeSpaceHistory, HistoryView};
use self::field::{label_by_flow, label_samples};
use self::free_space::FreeSpace;
use self::gaussian_mask::{CellCentres, MaskLabelling, label_by_mask};
use self::landmarks::{
    LandmarkCues, LandmarkLabel, TaggedLabel, label_landmarks, local_cues, take_labels_of_gaussians,
};
use self::past::{PastView, reference_images};
use self::samples::{FrameView, Lattice};
use crate::config::{ConfigError, LabelSource};
use crate::context::Context;
use crate::frame::{Frame, FrameLabels};
use crate::io::{FrameInput, SlamError, TrackingState};
use crate::map::Map;
use crate::mask::MOVING;
use crate::session::sections::{SectionReader, SectionWriter, SessionError};
use crate::trace::Recorder;

/// Share of the first frame's cells that must move for the run to restart: below, it is depth edges.
const MIN_MOVING: f64 = 0.02;

/// The state behind the labels.
#[derive(Debug)]
pub struct Dynamics {
    lattice: Lattice,
    crf: Crf,
    /// Free space seen in the last seconds, oldest first.
    pub(crate) past: VecDeque<PastView>,
    /// The first frames, until it is known whether the run must restart.
    bootstrap: Option<BootstrapBuffer>,
    /// Later frames, while the first ones are processed again.
    pub(crate) future: Vec<FutureView>,
    /// The dynamic Gaussians, as last handed over; empty before.
    dynamic_gaussians: GaussianMap,
    /// Landmarks that the flow check found at rest since the last mapping job.
    restored: BTreeSet<LandmarkId>,
    /// Where the Gaussian mask is read, if its cells are.
    centres: Option<CellCentres>,
}

/// A frame as it is added to the history.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NewView<'a> {
    pub(crate) frame: &'a Frame,
    pub(crate) reference: KeyframeId,
    pub(crate) depth: &'a DepthImage,
    pub(crate) image: Option<&'a Arc<LkPyramid>>,
    /// What moves in it, if that is known.
    pub(crate) cells: Option<&'a MaskImage>,
}

impl Dynamics {
    /// No frame seen yet.
    ///
    /// # Errors
    /// [`SlamError::Config`] for an invalid setting of the field.
    pub fn new(context: &Context) -> Result<Self, SlamError> {
        let labels = &context.config.labels;
        let restarts =
            labels.enabled && labels.bootstrap_restart && labels.source != LabelSource::Flow;
        let reads_cells =
            labels.source.has_gaussians() && labels.gaussian_mask.surface_share <= 0.0;
        Ok(Self {
            lattice: Lattice::new(&context.camera, labels.step_px),
            crf: Crf::new(context.config.crf.clone()).map_err(ConfigError::from)?,
            past: VecDeque::new(),
            bootstrap: restarts.then(BootstrapBuffer::default),
            future: Vec::new(),
            dynamic_gaussians: GaussianMap::new(0),
            restored: BTreeSet::new(),
            centres: reads_cells.then(|| CellCentres::new(&context.camera)),
        })
    }

    /// The first frames of a restarted run, with these future views.
    pub(crate) fn restarted(context: &Context, future: Vec<FutureView>) -> Result<Self, SlamError> {
        Ok(Self {
            bootstrap: None,
            future,
            ..Self::new(context)?
        })
    }

    /// What moves in a frame, from its first pose: the field over its samples, then the flow check of
    /// the suspects. `None` before the bootstrap is over, or if the history contradicts nearly
    /// everything.
    pub(crate) fn label_frame(
        &self,
        context: &Context,
        view: FrameView<'_>,
        map: &Map,
        recorder: &mut Recorder,
    ) -> Option<FrameLabels> {
        let now = view.frame.id;
        let is_empty = self.past.is_empty() && self.future.is_empty();
        if is_empty || !self.is_active(context, now) {
            return None;
        }
        let references = reference_images(context, map, &self.past, &self.future, now);
        let source = context.config.labels.source;
        if source == LabelSource::Flow {
            return label_by_flow(context, view, &self.lattice, &references, recorder);
        }
        let by_mask = source.has_gaussians().then(|| {
            let given = MaskLabelling {
                dynamic: &self.dynamic_gaussians,
                map,
                lattice: &self.lattice,
                centres: self.centres.as_ref(),
                references: &references,
            };
            label_by_mask(context, view, given, recorder)
        });
        // While the first frames are processed again, there are future views and hardly any Gaussian.
        if source == LabelSource::Gaussians && self.future.is_empty() {
            return by_mask;
        }
        let history = self.history(context, map, now);
        let labels = label_samples(
            context,
            view,
            &self.lattice,
            &self.crf,
            &history,
            &references,
            recorder,
        )?;
        Some(match by_mask {
            Some(by_mask) => labels.union(by_mask),
            None => labels,
        })
    }

    /// Keeps the landmarks that a frame's labels restored for the next mapping job.
    pub(crate) fn restore(&mut self, restored: &[LandmarkId]) {
        self.restored.extend(restored);
    }

    /// The landmarks restored since the last mapping job.
    pub(crate) fn take_restored(&mut self) -> BTreeSet<LandmarkId> {
        std::mem::take(&mut self.restored)
    }

    /// Takes over what a mapping job found: the labels of landmarks, and the dynamic Gaussians.
    pub(crate) fn take_feedback(
        &mut self,
        context: &Context,
        map: &mut Map,
        labels: &[TaggedLabel],
        dynamic: Option<GaussianMap>,
    ) {
        take_labels_of_gaussians(context, map, labels);
        self.dynamic_gaussians = dynamic.unwrap_or_else(|| GaussianMap::new(0));
    }

    /// Whether a frame's free space is to be added to the history: every keyframe's is, and between
    /// them one every `history_gap` frames.
    pub(crate) fn wants_view(&self, context: &Context, frame: FrameId) -> bool {
        let gap = context.config.labels.history_gap;
        let last = self.past.back();
        last.is_some_and(|view| view.frame.0 + gap <= frame.0)
    }

    /// Adds a frame to the history, and drops free space older than `memory_frames` and images older than
    /// patch motion wants them.
    pub(crate) fn add_view(&mut self, context: &Context, map: &Map, view: NewView<'_>) {
        let labels = &context.config.labels;
        let NewView {
            frame, reference, ..
        } = view;
        let mut free_space = FreeSpace::new(view.depth, context.config.features.max_depth_m);
        if let Some(cells) = view.cells {
            free_space.set_moving(cells.clone());
        }
        let reference_from_world = map.keyframe(reference).camera_from_world;
        self.past.push_back(PastView {
            frame: frame.id,
            reference,
            frame_from_reference: frame.camera_from_world * reference_from_world.inverse(),
            shutter: frame.shutter,
            free_space,
            image: view.image.cloned(),
        });
        let oldest = oldest_view(context, frame.id);
        while self.past.front().is_some_and(|view| view.frame < oldest) {
            self.past.pop_front();
        }
        let reach = labels.patch_motion.reach_frames();
        for view in &mut self.past {
            view.image.take_if(|_| view.frame.0 + reach < frame.id.0);
        }
    }

    /// Labels the landmarks of a keyframe's local map; its own free space is part of the history.
    pub(crate) fn label_keyframe(
        &mut self,
        context: &Context,
        map: &mut Map,
        keyframe: KeyframeId,
        recorder: &mut Recorder,
    ) -> Vec<LandmarkLabel> {
        let now = map.keyframe(keyframe).id;
        if !self.is_active(context, now) {
            return Vec::new();
        }
        let history = self.history(context, map, now);
        label_landmarks(context, map, keyframe, &self.crf, &history, recorder)
    }

    /// What the field over tagged Gaussians reads of a keyframe's landmarks.
    pub(crate) fn local_cues(
        &self,
        context: &Context,
        map: &Map,
        keyframe: KeyframeId,
    ) -> Vec<LandmarkCues> {
        let now = map.keyframe(keyframe).id;
        if !self.is_active(context, now) {
            return Vec::new();
        }
        local_cues(context, map, keyframe, &self.history(context, map, now))
    }

    /// Whether what moves can be told: not in the first frames, unless future views are known.
    fn is_active(&self, context: &Context, frame: FrameId) -> bool {
        frame.0 >= context.config.labels.bootstrap_frames || !self.future.is_empty()
    }

    /// The free space of the last `memory_frames` frames and of future views.
    pub(crate) fn history<'a>(
        &'a self,
        context: &'a Context,
        map: &Map,
        now: FrameId,
    ) -> FreeSpaceHistory<'a> {
        let oldest = oldest_view(context, now);
        let recent = self.past.iter().filter(|view| view.frame >= oldest);
        let recent = recent.map(|view| HistoryView {
            free_space: &view.free_space,
            camera_from_world: view.camera_from_world(map),
            age_frames: now.0 - view.frame.0,
        });
        let future = self.future.iter().map(|view| HistoryView {
            free_space: &view.free_space,
            camera_from_world: view.camera_from_world,
            age_frames: now.0.abs_diff(view.frame.0),
        });
        FreeSpaceHistory {
            camera: &context.camera,
            noise: &context.config.labels.noise,
            views: recent.chain(future).collect(),
        }
    }

    /// Buffers one of the first frames.
    pub(crate) fn buffer_frame(&mut self, input: &FrameInput<'_>, frame: &Frame) {
        if let Some(buffer) = &mut self.bootstrap {
            buffer.push(input, frame);
        }
    }

    /// Whether the run may still restart.
    pub(crate) fn may_restart(&self) -> bool {
        self.bootstrap.is_some()
    }

    /// No restart from here on.
    pub(crate) fn end_bootstrap(&mut self) {
        self.bootstrap = None;
    }

    /// Forgets everything seen, so that frames are tracked in a finished map.
    pub(crate) fn clear(&mut self) {
        self.end_bootstrap();
        self.past.clear();
    }

    /// The first frames are over and are no longer processed again.
    pub(crate) fn drop_future(&mut self) {
        self.future.clear();
    }

    /// Called after every frame, with the state it left: once the buffer is full, the buffered
    /// frames and their future views if something moves in the first of them.
    pub(crate) fn check_bootstrap(
        &mut self,
        context: &Context,
        state: TrackingState,
        map: &Map,
        recorder: &mut Recorder,
    ) -> Option<(BootstrapBuffer, Vec<FutureView>)> {
        match (state, &mut self.bootstrap) {
            (TrackingState::Tracking, _) | (_, None) => {}
            (TrackingState::NotInitialised, Some(buffer)) => buffer.frames.clear(),
            (TrackingState::Lost, lost) => *lost = None,
        }
        let enough = context.config.labels.bootstrap_frames as usize;
        let buffer = self.bootstrap.take_if(|b| b.frames.len() >= enough)?;
        let future = future_views(context, &buffer);
        let by_future_alone = Self {
            lattice: self.lattice.clone(),
            crf: self.crf.clone(),
            past: VecDeque::new(),
            bootstrap: None,
            future,
            dynamic_gaussians: GaussianMap::new(0),
            restored: BTreeSet::new(),
            centres: self.centres.clone(),
        };
        let moving = by_future_alone.moving_share(context, &buffer, map, recorder);
        (moving >= MIN_MOVING).then_some((buffer, by_future_alone.future))
    }

    /// Share of the first buffered frame's cells that move.
    fn moving_share(
        &self,
        context: &Context,
        buffer: &BootstrapBuffer,
        map: &Map,
        recorder: &mut Recorder,
    ) -> f64 {
        let Some(first) = buffer.frames.first() else {
            return 0.0;
        };
        let input = first.input();
        let pyramid = patch_motion_pyramid(context, input.rgb);
        let view = FrameView {
            frame: &first.frame,
            depth: input.depth,
            pyramid: pyramid.as_ref(),
        };
        let labels = self.label_frame(context, view, map, recorder);
        labels.map_or(0.0, |labels| {
            let cells = labels.cells.data();
            let moving = cells.iter().filter(|c| **c == MOVING).count();
            moving as f64 / cells.len() as f64
        })
    }

    /// Writes what a session must keep.
    pub(crate) fn save<W: Write>(&self, to: &mut SectionWriter<W>) -> Result<(), SessionError> {
        let Self {
            lattice: _, // from the camera
            crf: _,     // from the configuration
            past,
            bootstrap,
            future: _, // within one frame
            dynamic_gaussians,
            restored,
            centres: _, // from the camera
        } = self;
        to.put("past", past)?;
        to.put("bootstrap", bootstrap)?;
        to.put("dynamic_gaussians", dynamic_gaussians)?;
        to.put("restored", restored)
    }

    /// Reads what [`Dynamics::save`] wrote.
    pub(crate) fn load<R: Read>(
        from: &mut SectionReader<R>,
        context: &Context,
    ) -> Result<Self, SessionError> {
        Ok(Self {
            past: from.take("past")?,
            bootstrap: from.take("bootstrap")?,
            dynamic_gaussians: from.take("dynamic_gaussians")?,
            restored: from.take("restored")?,
            ..Self::new(context)?
        })
    }
}

/// The oldest frame whose free space a frame is compared with.
fn oldest_view(context: &Context, now: FrameId) -> FrameId {
    FrameId(now.0.saturating_sub(context.config.labels.memory_frames))
}

#[cfg(test)]
mod tests;
