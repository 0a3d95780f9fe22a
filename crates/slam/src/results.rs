//! What a run gives: its path, maps and labels, its trace, and the training after the last frame.

use std::ops::{ControlFlow, RangeInclusive};

use garad_core::{Camera, GaussianMap, StampedPose};

use crate::config::{Config, TrackingMethod};
use crate::frame::Frame;
use crate::io::{LabelledFrame, ReplayedFrame, SlamError};
use crate::keyframing::loop_closing::LoopClosure;
use crate::map::Map;
use crate::mapping::job::MappingDone;
use crate::mapping::mapper::Mapper;
use crate::mapping::train::TrainStep;
use crate::mapping::worker::MappingObserver;
use crate::pipeline::Slam;
use crate::trace::TraceRecord;

impl Slam {
    /// Observes the mapper's stages, from whatever thread it runs in. To be called before the first
    /// frame.
    #[must_use]
    pub fn with_mapping_observer(mut self, observer: MappingObserver) -> Self {
        self.mapping.observe(observer);
        self
    }

    /// Records the inputs and outputs of every stage of these frames. To be called before
    /// the first frame. Nothing of the result changes.
    #[must_use]
    pub fn with_trace(mut self, frames: RangeInclusive<u32>) -> Self {
        self.record_frames(Some(frames));
        self
    }

    /// The trace so far, tracking and mapping of each frame together, in the order of the data. What
    /// the mapper recorded is missing while it is under way: call [`Slam::finish`] before.
    pub fn take_trace(&mut self) -> Vec<TraceRecord> {
        let mut records = self.recorder.take();
        let of_mapper = self.mapping.mapper_mut().map(Mapper::take_trace);
        records.extend(of_mapper.unwrap_or_default());
        records.sort_by_key(|record| record.frame); // stable
        records
    }

    /// Whether the run may still restart.
    #[must_use]
    pub fn may_restart(&self) -> bool {
        self.dynamics.may_restart()
    }

    /// The outcome of the first frames when they were processed again; empty but for once, after the
    /// last of them. The frame just given is not among them: its report is the answer to it.
    pub fn take_replayed(&mut self) -> Vec<ReplayedFrame> {
        std::mem::take(&mut self.replayed)
    }

    /// Takes over every mapping job under way. From here until the next keyframe
    /// [`Slam::gaussians`] has an answer.
    ///
    /// # Errors
    /// [`SlamError::MappingLost`].
    pub fn finish(&mut self) -> Result<(), SlamError> {
        for feedback in self.mapping.finish()? {
            self.take_feedback(feedback);
        }
        Ok(())
    }

    /// Trains the map on the keyframes' images for `config.train.final_iterations` iterations, after
    /// the last frame; `on_step` is told of each and may end them. Gaussians that have faded are pruned.
    ///
    /// # Errors
    /// [`SlamError::Train`]; the map is then as it was after the last good iteration.
    /// [`SlamError::MappingLost`].
    pub fn train_final(
        &mut self,
        on_step: &mut dyn FnMut(&TrainStep) -> ControlFlow<()>,
    ) -> Result<(), SlamError> {
        self.finish()?;
        let poses = self.map.keyframe_poses();
        let iterations = self.context.config.train.final_iterations;
        let mapper = self.mapping.mapper_mut().ok_or(SlamError::MappingLost)?;
        Ok(mapper.train_final(iterations, poses, on_step)?)
    }

    /// The path so far: every tracked frame, moved along with its adjusted keyframe. Poses found by
    /// rendering have no covariance, so the motion prior leaves them as they are.
    #[must_use]
    pub fn trajectory(&self) -> Vec<StampedPose> {
        let config = &self.context.config;
        match config.tracking.method {
            TrackingMethod::Features => self.trajectory.stamped(&self.map, &config.motion),
            TrackingMethod::Render => self.trajectory.as_tracked(&self.map),
        }
    }

    /// The keyframes' poses.
    #[must_use]
    pub fn keyframe_trajectory(&self) -> Vec<StampedPose> {
        let pose = |k: &Frame| StampedPose {
            t_s: k.t_s,
            world_from_camera: k.camera_from_world.inverse(),
        };
        self.map.keyframes().iter().map(pose).collect()
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
        self.mapping.mapper().map(Mapper::gaussians)
    }

    /// The mapping jobs handed over so far.
    #[must_use]
    pub fn mapped(&self) -> &[MappingDone] {
        self.mapping.done()
    }

    /// The loops that were closed, oldest first.
    #[must_use]
    pub fn loops(&self) -> &[LoopClosure] {
        self.keyframing.loops.closed()
    }

    /// The last tracked frame, with the landmarks its keypoints were linked to.
    #[must_use]
    pub fn last_frame(&self) -> Option<&Frame> {
        self.tracker.last()
    }

    /// What moves in the last frame; `None` if it was not labelled: lost, bootstrap, or a mask given.
    #[must_use]
    pub fn labelled_frame(&self) -> Option<&LabelledFrame> {
        self.labelled.as_ref()
    }

    /// The camera.
    #[must_use]
    pub fn camera(&self) -> &Camera {
        &self.context.camera
    }

    /// The configuration.
    #[must_use]
    pub fn config(&self) -> &Config {
        &self.context.config
    }

    /// The seed of every random draw.
    #[must_use]
    pub fn seed(&self) -> u64 {
        self.context.rng_seed
    }
}

#[cfg(test)]
mod tests {
    use garad_core::{FrameId, Par};
    use nalgebra::Matrix6;

    use super::*;
    use crate::frame::PoseInformation;
    use crate::keyframing::loop_closing::LoopClosure;
    use crate::testing::{World, apart, turned};

    /// A run of three frames, each a keyframe, at the poses of [`turned`].
    fn run(method: TrackingMethod) -> Slam {
        let mut config = Config::default();
        config.tracking.method = method;
        let world = World::observing(Config::default(), 3, &[&[0, 1, 2]]);
        let mut slam = Slam::new(world.context.camera, config, 77, Par::Seq).expect("valid");
        for k in 0..3 {
            let mut frame = world.map.keyframe(garad_core::KeyframeId(k)).clone();
            frame.information = PoseInformation {
                matrix: Matrix6::identity(),
                links: 9,
            };
            let id = slam.map.add_keyframe(frame.clone());
            slam.trajectory.push(&frame, id, &slam.map);
        }
        slam
    }

    /// Features: the most likely path; poses found by rendering stay as they are.
    #[test]
    fn a_path_is_the_inverse_of_the_poses() {
        for (method, as_tracked) in [
            (TrackingMethod::Features, false),
            (TrackingMethod::Render, true),
        ] {
            let slam = run(method);
            let (path, keyframes) = (slam.trajectory(), slam.keyframe_trajectory());
            assert_eq!((path.len(), keyframes.len()), (3, 3));
            for (k, (pose, keyframe)) in (0..3).zip(path.iter().zip(&keyframes)) {
                let t_s = f64::from(10 * k) / 30.0;
                assert!(
                    (pose.t_s - t_s).abs() < 1e-12 && (keyframe.t_s - t_s).abs() < 1e-12,
                    "{k}"
                );
                assert_eq!(
                    keyframe.world_from_camera,
                    turned(k).inverse(),
                    "keyframe {k}"
                );
                let off = apart(&pose.world_from_camera, &turned(k).inverse());
                assert_eq!(off < 1e-12, as_tracked, "{method:?}, frame {k}: {off}");
            }
        }
    }

    /// What was tracked and mapped comes together, by frame; each record once.
    #[test]
    fn a_trace_is_in_the_order_of_the_frames() {
        let mut slam = run(TrackingMethod::Features).with_trace(2..=9);
        let record = |recorder: &mut crate::trace::Recorder, frame: u32, stage: &'static str| {
            recorder.begin_frame(FrameId(frame));
            recorder.record(stage, |record| record.output("x", "m", &[1], vec![1.0]));
        };
        for (frame, stage) in [
            (1, "before"),
            (3, "a"),
            (2, "b"),
            (3, "c"),
            (9, "d"),
            (10, "after"),
        ] {
            record(&mut slam.recorder, frame, stage);
        }
        let stages: Vec<_> = slam
            .take_trace()
            .iter()
            .map(|r| (r.frame.0, r.stage))
            .collect();
        assert_eq!(stages, [(2, "b"), (3, "a"), (3, "c"), (9, "d")]);
        assert!(slam.take_trace().is_empty(), "taken");
    }

    #[test]
    fn a_run_tells_what_it_was_given_and_what_it_found() {
        let mut slam = run(TrackingMethod::Features);
        assert_eq!(slam.seed(), 77);
        assert_eq!((slam.camera().width, slam.camera().height), (160, 120));
        assert_eq!(slam.config(), &Config::default());
        assert_eq!(slam.map().keyframes().len(), 3);
        let gaussians = slam.gaussians().expect("at rest");
        assert!(slam.mapped().is_empty() && slam.last_frame().is_none() && gaussians.is_empty());
        let closure = LoopClosure {
            keyframe: garad_core::KeyframeId(2),
            older: garad_core::KeyframeId(0),
            inliers: 41,
            drift_m: 0.3,
        };
        slam.keyframing.loops.push(closure);
        assert_eq!(slam.loops(), [closure]);
    }
}
