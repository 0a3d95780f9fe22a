//! [`Trajectory`]: the pose of every tracked frame, relative to a keyframe.

mod motion;

use garad_core::{KeyframeId, Se3, StampedPose};
use serde::{Deserialize, Serialize};

use self::motion::{MeasuredPose, expected_centre, most_likely_path};
use crate::config::MotionConfig;
use crate::frame::{CentreEstimate, Frame, PoseInformation};
use crate::map::Map;

/// A frame's pose relative to a keyframe, so that it moves along when the keyframe is adjusted.
#[derive(Debug, Clone, Serialize, Deserialize)]
struct TrackedFrame {
    t_s: f64,
    reference: KeyframeId,
    frame_from_reference: Se3,
    /// What its links say about its pose.
    information: PoseInformation,
}

impl TrackedFrame {
    fn camera_from_world(&self, map: &Map) -> Se3 {
        self.frame_from_reference * map.keyframe(self.reference).camera_from_world
    }
}

/// The camera's path so far.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Trajectory(Vec<TrackedFrame>);

impl Trajectory {
    /// Adds a tracked frame.
    pub(crate) fn push(&mut self, frame: &Frame, reference: KeyframeId, map: &Map) {
        let reference_from_world = map.keyframe(reference).camera_from_world;
        self.0.push(TrackedFrame {
            t_s: frame.t_s,
            reference,
            frame_from_reference: frame.camera_from_world * reference_from_world.inverse(),
            information: frame.information,
        });
    }

    /// Where the camera is expected at a time, by its last frames.
    pub(crate) fn expected_centre(
        &self,
        t_s: f64,
        map: &Map,
        config: &MotionConfig,
    ) -> Option<CentreEstimate> {
        let recent = self.0.len().saturating_sub(motion::MARGIN);
        expected_centre(&self.measured(recent, map, config), t_s, config)
    }

    fn measured(&self, from: usize, map: &Map, config: &MotionConfig) -> Vec<MeasuredPose> {
        let measured = self.0[from..].iter().map(|frame| {
            let camera_from_world = frame.camera_from_world(map);
            MeasuredPose::new(frame.t_s, camera_from_world, &frame.information, config)
        });
        measured.collect()
    }

    /// Every tracked frame's pose by the keyframes' poses as they are now.
    #[must_use]
    pub fn as_tracked(&self, map: &Map) -> Vec<StampedPose> {
        let stamped = |frame: &TrackedFrame| StampedPose {
            t_s: frame.t_s,
            world_from_camera: frame.camera_from_world(map).inverse(),
        };
        self.0.iter().map(stamped).collect()
    }

    /// The most likely path: every tracked frame's pose by the keyframes' poses as they are now, and
    /// by a motion prior (E24).
    #[must_use]
    pub fn stamped(&self, map: &Map, config: &MotionConfig) -> Vec<StampedPose> {
        let path = most_likely_path(&self.measured(0, map, config), config);
        let stamped = |(frame, pose): (&TrackedFrame, Se3)| StampedPose {
            t_s: frame.t_s,
            world_from_camera: pose.inverse(),
        };
        self.0.iter().zip(path).map(stamped).collect()
    }
}
