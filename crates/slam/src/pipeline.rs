//! [`Slam`]: the method, stage after stage.
//!
//! ```text
//! FrameInput ─→ Frame ─→ first pose ─→ Dynamics ─→ FrameLabels ─→ local map, final pose
//!                                                                       │
//!        MappingDone ←─ Mapping ←─ MappingJob ←─ keyframing ←── keyframe?
//! ```

use std::borrow::Cow;
use std::ops::RangeInclusive;
use std::sync::Arc;

use garad_core::undistort::Undistortion;
use garad_core::{Camera, DepthImage, FrameId, KeyframeId, Label, Par};
use garad_features::{LkPyramid, PlaceConfig, PlaceIndex};

use crate::config::{Config, LabelSource, TrackingMethod};
use crate::context::Context;
use crate::dynamics::bootstrap::{BootstrapBuffer, FutureView};
use crate::dynamics::samples::FrameView;
use crate::dynamics::{Dynamics, NewView};
use crate::frame::depth_time::depth_at_colour_time;
use crate::frame::extract::{FrameExtractor, wanted_keypoints};
use crate::frame::{Frame, FrameLabels};
use crate::images::{ImageStore, lk_pyramid};
use crate::io::{FrameInput, FrameReport, LabelledFrame, ReplayedFrame, SlamError, TrackingState};
use crate::keyframing::Keyframing;
use crate::keyframing::culling::cull_keyframes;
use crate::keyframing::decide::needs_keyframe;
use crate::keyframing::landmarks::{add_keyframe, landmarks_first_measured_in};
use crate::keyframing::local_ba::local_ba;
use crate::map::Map;
use crate::mapping::Mapping;
use crate::mapping::job::{MapFeedback, MappingJob};
use crate::mapping::view::Target;
use crate::mask::full_size;
use crate::observer::{Observer, Stage};
use crate::trace::Recorder;
use crate::tracking::Tracker;
use crate::tracking::depth_pose::drop_old_depth_planes;
use crate::tracking::relocalise::static_descriptors;
use crate::trajectory::Trajectory;

/// A run of the system: the owners of its state.
#[derive(Debug)]
pub struct Slam {
    pub(crate) context: Context,
    pub(crate) extractor: FrameExtractor,
    /// Straightens the images that are compared with rendered ones.
    pub(crate) straight: Undistortion,
    pub(crate) tracker: Tracker,
    pub(crate) dynamics: Dynamics,
    pub(crate) map: Map,
    pub(crate) keyframing: Keyframing,
    pub(crate) mapping: Mapping,
    /// Keyframes by appearance.
    pub(crate) places: PlaceIndex,
    pub(crate) images: ImageStore,
    pub(crate) trajectory: Trajectory,
    /// What moves in the last frame.
    pub(crate) labelled: Option<LabelledFrame>,
    pub(crate) replayed: Vec<ReplayedFrame>,
    pub(crate) next_frame: FrameId,
    /// The map is finished: frames are tracked in it and change nothing.
    pub(crate) localising: bool,
    pub(crate) recorder: Recorder,
}

impl Slam {
    /// An empty map, before the first frame.
    ///
    /// # Errors
    /// [`SlamError::Config`] or [`SlamError::Camera`] for invalid values.
    pub fn new(camera: Camera, config: Config, rng_seed: u64, par: Par) -> Result<Self, SlamError> {
        let context = Context::new(camera, config, rng_seed, par)?;
        let frame = FrameId(0);
        let places = PlaceIndex::new(PlaceConfig::default(), rng_seed);
        Ok(Self {
            extractor: FrameExtractor::new(&context)?,
            straight: Undistortion::new(&context.camera),
            tracker: Tracker::default(),
            dynamics: Dynamics::new(&context)?,
            map: Map::default(),
            keyframing: Keyframing::default(),
            mapping: Mapping::new(&context)?,
            places: places.map_err(|source| SlamError::Features { frame, source })?,
            images: ImageStore::default(),
            trajectory: Trajectory::default(),
            labelled: None,
            replayed: Vec::new(),
            next_frame: FrameId(0),
            localising: false,
            recorder: Recorder::default(),
            context,
        })
    }

    /// Takes the next frame through tracking and, if it becomes a keyframe, starts its mapping.
    /// Mapping jobs that are due are handed over first.
    ///
    /// After the last frame of the bootstrap the run may restart, within this call
    /// ([`Slam::take_replayed`]).
    ///
    /// A frame that cannot be tracked is not an error: the state turns to
    /// [`TrackingState::Lost`], and later frames are searched for among the keyframes.
    ///
    /// # Errors
    /// [`SlamError::SizeMismatch`] or [`SlamError::Features`]; the state before the frame stays,
    /// and the next frame may be given. [`SlamError::MappingLost`].
    pub fn process(
        &mut self,
        input: &FrameInput<'_>,
        observer: &mut dyn Observer,
    ) -> Result<FrameReport, SlamError> {
        let report = self.process_once(input, observer)?;
        self.restart_if_dynamic(report, observer)
    }

    fn process_once(
        &mut self,
        input: &FrameInput<'_>,
        observer: &mut dyn Observer,
    ) -> Result<FrameReport, SlamError> {
        let id = self.next_frame;
        self.next_frame = FrameId(id.0 + 1);
        input.check_sizes(id, &self.context.camera)?;
        self.recorder.begin_frame(id);
        while self.mapping.is_due(id) {
            observer.begin(Stage::Handover);
            let feedback = self.mapping.hand_over();
            observer.end(Stage::Handover);
            if let Some(feedback) = feedback? {
                self.take_feedback(feedback);
            }
        }

        let depth = self.depth_at_colour_time(input);
        let input = &FrameInput {
            depth: &depth,
            ..*input
        };
        let (mut frame, pyramid) = self.extract(id, input, observer)?;
        if input.mask.is_some() || self.localising {
            self.dynamics.end_bootstrap();
        } else {
            self.dynamics.buffer_frame(input, &frame);
        }
        let (inliers, labels) = match self.tracker.state() {
            TrackingState::NotInitialised => {
                let labels = self.label(&mut frame, input, pyramid.as_deref(), observer);
                let tracker = &mut self.tracker;
                let usable = tracker.initialise(&self.context, &mut frame, input.depth);
                (usable, labels)
            }
            TrackingState::Tracking | TrackingState::Lost => {
                match self.context.config.tracking.method {
                    TrackingMethod::Features => {
                        self.track(&mut frame, input, pyramid.as_deref(), observer)
                    }
                    TrackingMethod::Render => {
                        self.track_by_rendering(&mut frame, input, pyramid.as_deref(), observer)
                    }
                }
            }
        };
        self.labelled = labels.as_ref().map(|labels| labelled_frame(&frame, labels));
        let is_dynamic = |l: &&Label| **l == Label::Dynamic;
        let mut report = FrameReport {
            id,
            t_s: input.t_s,
            state: self.tracker.state(),
            weak: self.tracker.is_weak(),
            keypoints: frame.len(),
            dynamic_keypoints: frame.label.iter().filter(is_dynamic).count(),
            inliers,
            keyframe: None,
            camera_from_world: None,
        };
        if report.state == TrackingState::Tracking {
            self.tracker.update_velocity(&frame);
            if self.becomes_keyframe(&frame, inliers) {
                let keyframe = self.add_keyframe(frame, input, pyramid, labels, observer)?;
                report.keyframe = Some(keyframe);
                // The next frame is tracked from the adjusted keyframe.
                frame = self.map.keyframe(keyframe).clone();
            } else {
                self.add_view(&frame, input, pyramid.as_ref());
            }
            let reference = self.tracker.reference();
            self.trajectory.push(&frame, reference, &self.map);
            self.recorder
                .record("trajectory", |record| record.trajectory(&frame, &self.map));
            report.camera_from_world = Some(frame.camera_from_world);
            self.tracker.set_last(frame);
        }
        Ok(report)
    }

    /// Takes over what the map gives back of a keyframe's job.
    pub(crate) fn take_feedback(&mut self, feedback: MapFeedback) {
        let MapFeedback {
            labels,
            positions,
            dynamic,
            map: gaussians,
        } = feedback;
        let (context, map) = (&self.context, &mut self.map);
        (self.dynamics).take_feedback(context, map, &labels, dynamic);
        if let Some(gaussians) = gaussians {
            self.tracker.set_gaussians(gaussians);
        }
        for (id, p_world) in positions {
            map.set_position(id, p_world, &context.scales);
        }
    }

    /// The frame's depth, moved to the time of its colour image by the motion of the frame before.
    fn depth_at_colour_time<'a>(&self, input: &FrameInput<'a>) -> Cow<'a, DepthImage> {
        let offset_s = input.depth_t_s - input.t_s;
        let moved = self.tracker.expected_motion(input.t_s, offset_s);
        match moved.filter(|_| self.context.config.features.sync_depth) {
            Some(motion) => Cow::Owned(depth_at_colour_time(
                input.depth,
                &self.context.camera,
                &motion,
                self.context.par,
            )),
            None => Cow::Borrowed(input.depth),
        }
    }

    /// Features and their depth, unless frames are tracked by rendering, and the image for Lucas-Kanade.
    fn extract(
        &mut self,
        id: FrameId,
        input: &FrameInput<'_>,
        observer: &mut dyn Observer,
    ) -> Result<(Frame, Option<Arc<LkPyramid>>), SlamError> {
        let context = &self.context;
        if context.config.tracking.method == TrackingMethod::Render {
            let frame = self.extractor.without_features(context, id, input);
            self.recorder
                .record("input", |record| record.frame_input(input));
            let pyramid = lk_pyramid(&input.rgb.to_gray(), &context.config);
            return Ok((frame, pyramid.map(Arc::new)));
        }
        observer.begin(Stage::Orb);
        let gray = input.rgb.to_gray();
        let wanted = wanted_keypoints(context, self.tracker.last());
        let frame = self.extractor.extract(context, id, input, &gray, wanted);
        observer.end(Stage::Orb);
        let frame = frame?;
        let recorder = &mut self.recorder;
        recorder.record("input", |record| record.frame_input(input));
        let features = &context.config.features;
        recorder.record("orb", |record| {
            record.orb(&gray, features.scale, features.levels, wanted, &frame);
        });
        recorder.record("keypoints", |record| record.keypoints(&frame));
        if let Some(planes) = &frame.depth_planes {
            recorder.record("depth_planes", |record| record.depth_planes(planes));
        }
        Ok((frame, lk_pyramid(&gray, &context.config).map(Arc::new)))
    }

    /// First pose, what moves, local map. Returns the number of inliers and the labels.
    fn track(
        &mut self,
        frame: &mut Frame,
        input: &FrameInput<'_>,
        pyramid: Option<&LkPyramid>,
        observer: &mut dyn Observer,
    ) -> (usize, Option<FrameLabels>) {
        if self.tracker.state() == TrackingState::Tracking {
            let motion = &self.context.config.motion;
            frame.expected = (self.trajectory).expected_centre(frame.t_s, &self.map, motion);
        }
        let found = self.tracker.first_pose(
            &self.context,
            &self.map,
            &self.places,
            frame,
            observer,
            &mut self.recorder,
        );
        let (mut inliers, mut labels) = (0, None);
        if found {
            labels = self.label(frame, input, pyramid, observer);
            observer.begin(Stage::TrackLocalMap);
            inliers = self.tracker.track_local_map(
                &self.context,
                &mut self.map,
                &self.images,
                frame,
                (pyramid, input.depth),
                self.localising,
                &mut self.recorder,
            );
            observer.end(Stage::TrackLocalMap);
        }
        self.tracker.update_state(&self.context, frame.id, inliers);
        (inliers, labels)
    }

    /// Pose by rendering, then what moves. Returns the number of pixels compared and the labels.
    fn track_by_rendering(
        &mut self,
        frame: &mut Frame,
        input: &FrameInput<'_>,
        pyramid: Option<&LkPyramid>,
        observer: &mut dyn Observer,
    ) -> (usize, Option<FrameLabels>) {
        let context = &self.context;
        observer.begin(Stage::TrackRender);
        let images = (input.rgb, Some(input.depth), input.mask);
        let level = context.config.render_tracking.level;
        let target = Target::new(&context.camera, &self.straight, images, level, context.par);
        let pixels = self.tracker.track_by_rendering(context, frame, &target);
        observer.end(Stage::TrackRender);
        match self.tracker.state() {
            TrackingState::Tracking => (pixels, self.label(frame, input, pyramid, observer)),
            _ => (pixels, None),
        }
    }

    /// What moves in a frame, applied to it; nothing if a mask is given.
    fn label(
        &mut self,
        frame: &mut Frame,
        input: &FrameInput<'_>,
        pyramid: Option<&LkPyramid>,
        observer: &mut dyn Observer,
    ) -> Option<FrameLabels> {
        if !self.context.config.labels.enabled || input.mask.is_some() {
            return None;
        }
        observer.begin(Stage::Label);
        let view = FrameView {
            frame,
            depth: input.depth,
            pyramid,
        };
        let labels = self
            .dynamics
            .label_frame(&self.context, view, &self.map, &mut self.recorder);
        if let Some(labels) = &labels {
            frame.apply_labels(labels, &self.context.camera);
            self.dynamics.restore(&labels.restored);
        }
        observer.end(Stage::Label);
        labels
    }

    /// Adds a frame between keyframes to the free-space history, if its turn has come.
    fn add_view(&mut self, frame: &Frame, input: &FrameInput<'_>, image: Option<&Arc<LkPyramid>>) {
        let is_labelled = self.context.config.labels.enabled && input.mask.is_none();
        let usable = is_labelled && !self.localising && !self.tracker.is_weak();
        if usable && self.dynamics.wants_view(&self.context, frame.id) {
            let view = NewView {
                frame,
                reference: self.tracker.reference(),
                depth: input.depth,
                image,
                cells: self.labelled.as_ref().map(|labelled| &labelled.cells),
            };
            (self.dynamics).add_view(&self.context, &self.map, view);
        }
    }

    pub(crate) fn becomes_keyframe(&mut self, frame: &Frame, inliers: usize) -> bool {
        let (map, most) = (&self.map, &mut self.keyframing.most_inliers);
        *most = inliers.max(*most);
        let becomes = !self.localising
            && !self.tracker.is_weak()
            && (map.keyframes().is_empty()
                || needs_keyframe(&self.context, map, frame, inliers, *most));
        if becomes {
            *most = 0;
        }
        self.recorder.record("keyframe", |record| {
            record.decision(inliers, frame, becomes);
        });
        becomes
    }

    /// Adds a keyframe: landmarks, labels, bundle adjustment and loops here, Gaussians in a mapping
    /// job.
    fn add_keyframe(
        &mut self,
        frame: Frame,
        input: &FrameInput<'_>,
        pyramid: Option<Arc<LkPyramid>>,
        labels: Option<FrameLabels>,
        observer: &mut dyn Observer,
    ) -> Result<KeyframeId, SlamError> {
        let Self {
            context,
            map,
            keyframing,
            recorder,
            ..
        } = self;
        let config = &context.config;
        let frame_id = frame.id;
        let since_last = (frame_id.0 - map.last_keyframe_frame().0) as usize;
        let cells = labels.map(|labels| labels.cells);
        let mask = match &cells {
            Some(cells) => Some(full_size(cells, input.rgb.size())),
            None => input.mask.cloned(),
        };

        observer.begin(Stage::Keyframe);
        let id = add_keyframe(context, map, &mut keyframing.recent, frame);
        self.tracker.set_reference(id);
        drop_old_depth_planes(map, id, config.depth_planes.keyframes);
        map.keyframe_mut(id).mask_depth_planes(mask.as_ref());
        observer.end(Stage::Keyframe);
        let (mut labels, mut cues) = (Vec::new(), Vec::new());
        if config.labels.enabled && input.mask.is_none() {
            observer.begin(Stage::LabelMap);
            let view = NewView {
                frame: map.keyframe(id),
                reference: id,
                depth: input.depth,
                image: pyramid.as_ref(),
                cells: cells.as_ref(),
            };
            (self.dynamics).add_view(context, map, view);
            match config.labels.source {
                LabelSource::Frames => {
                    labels = self.dynamics.label_keyframe(context, map, id, recorder);
                }
                LabelSource::Gaussians | LabelSource::Both => {
                    cues = self.dynamics.local_cues(context, map, id);
                }
                LabelSource::Flow => {}
            }
            observer.end(Stage::LabelMap);
        }
        if config.local_ba.enabled {
            observer.begin(Stage::LocalBa);
            local_ba(context, map, id, recorder);
            observer.end(Stage::LocalBa);
        }
        let mut moved = Vec::new();
        if config.loops.enabled {
            observer.begin(Stage::Loop);
            moved = (keyframing.loops).close_loop(context, map, &self.places, id, recorder);
            observer.end(Stage::Loop);
        }
        self.places.add(id, &static_descriptors(map.keyframe(id)));
        if config.culling.enabled {
            for culled in cull_keyframes(context, map, keyframing.loops.closed(), id, recorder) {
                self.places.remove(culled);
                self.images.remove(culled);
            }
        }
        self.images.insert(id, pyramid, config);
        if config.insertion.enabled {
            let job = MappingJob {
                keyframe: id,
                frame: frame_id,
                rgb: input.rgb.clone(),
                depth: input.depth.clone(),
                mask,
                cells,
                labels,
                cues,
                restored: self.dynamics.take_restored(),
                poses: map.keyframe_poses(),
                moved,
                new_landmarks: landmarks_first_measured_in(map, id, config.labels.tagged),
                living: map
                    .landmarks()
                    .map(|(l, landmark)| (l, landmark.label()))
                    .collect(),
                iterations: config.train.iterations_of_job(since_last),
            };
            self.mapping.submit(job)?;
        }
        Ok(id)
    }

    /// After every frame: restarts the run with the first one if the bootstrap buffer is full and
    /// something moves in it (decision 011).
    fn restart_if_dynamic(
        &mut self,
        report: FrameReport,
        observer: &mut dyn Observer,
    ) -> Result<FrameReport, SlamError> {
        let state = self.tracker.state();
        let restart =
            self.dynamics
                .check_bootstrap(&self.context, state, &self.map, &mut self.recorder);
        let Some((buffer, future)) = restart else {
            return Ok(report);
        };
        tracing::info!(
            frame = report.id.0,
            "something moves in the first frames: restart"
        );
        self.restart(future)?;
        let last = self.replay(&buffer, report, observer);
        self.dynamics.drop_future();
        last
    }

    /// As before the first frame, but with future views. Observer and recorded frames stay.
    fn restart(&mut self, future: Vec<FutureView>) -> Result<(), SlamError> {
        self.mapping.finish()?;
        let Context {
            camera,
            config,
            rng_seed,
            par,
            ..
        } = self.context.clone();
        let fresh = Self::new(camera, config, rng_seed, par)?;
        let before = std::mem::replace(self, fresh);
        self.dynamics = Dynamics::restarted(&self.context, future)?;
        self.mapping = before.mapping.restarted(&self.context)?;
        self.record_frames(before.recorder.frames());
        Ok(())
    }

    /// Processes buffered frames again. Returns the report of the last, whose first was `last`.
    fn replay(
        &mut self,
        buffer: &BootstrapBuffer,
        mut last: FrameReport,
        observer: &mut dyn Observer,
    ) -> Result<FrameReport, SlamError> {
        for buffered in &buffer.frames {
            self.next_frame = buffered.frame.id; // frames that could not be read left gaps
            last = self.process_once(&buffered.input(), observer)?;
            self.replayed.push(ReplayedFrame {
                report: last,
                labels: self.labelled.clone(),
            });
        }
        self.replayed.pop(); // the frame just given
        Ok(last)
    }

    pub(crate) fn record_frames(&mut self, frames: Option<RangeInclusive<u32>>) {
        if let Some(mapper) = self.mapping.mapper_mut() {
            mapper.record_frames(frames.clone());
        }
        self.recorder.set_frames(frames);
    }
}

/// The labels of a frame as they are written and judged, at its final keypoints.
fn labelled_frame(frame: &Frame, labels: &FrameLabels) -> LabelledFrame {
    let keypoints = frame.px.iter().map(|p| [p.x, p.y]);
    LabelledFrame {
        frame: frame.id,
        keypoints: keypoints.zip(frame.label.iter().copied()).collect(),
        cells: labels.cells.clone(),
    }
}

#[cfg(test)]
mod tests;
