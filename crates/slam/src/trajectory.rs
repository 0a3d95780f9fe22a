//! [`Trajectory`]: the pose of every tracked frame, relative to a keyframe.

use garad_core::{KeyframeId, Se3, StampedPose};
use serde::{Deserialize, Serialize};

use crate::frame::Frame;
use crate::map::Map;

/// A frame's pose relative to a keyframe, so that it moves along when the keyframe is adjusted.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct RelativePose {
    t_s: f64,
    reference: KeyframeId,
    frame_from_reference: Se3,
}

/// The camera's path so far.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Trajectory(Vec<RelativePose>);

impl Trajectory {
    /// Adds a tracked frame.
    pub(crate) fn push(&mut self, frame: &Frame, reference: KeyframeId, map: &Map) {
        let reference_from_world = map.keyframe(reference).camera_from_world;
        self.0.push(RelativePose {
            t_s: frame.t_s,
            reference,
            frame_from_reference: frame.camera_from_world * reference_from_world.inverse(),
        });
    }

    /// Every tracked frame's pose, by the keyframes' poses as they are now.
    #[must_use]
    pub fn stamped(&self, map: &Map) -> Vec<StampedPose> {
        let pose = |r: &RelativePose| {
            let frame_from_world =
                r.frame_from_reference * map.keyframe(r.reference).camera_from_world;
            StampedPose {
                t_s: r.t_s,
                world_from_camera: frame_from_world.inverse(),
            }
        };
        self.0.iter().map(pose).collect()
    }
}
