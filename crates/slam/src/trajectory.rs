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

#[cfg(test)]
mod tests {
    use nalgebra::Matrix6;

    use super::*;
    use crate::config::Config;
    use crate::testing::{World, apart, turned};

    const CONFIG: MotionConfig = MotionConfig {
        acceleration_m_s2: 2.0,
        shared_error: 0.0,
    };

    /// Frames at the poses 5, 6, 7 and 8 of [`turned`], tracked against keyframes 1, 2, 1 and 2.
    fn tracked(information: f64) -> (World, Trajectory) {
        let world = World::observing(Config::default(), 3, &[&[0, 1, 2]]);
        let mut trajectory = Trajectory::default();
        for (k, reference) in [(5, 1), (6, 2), (7, 1), (8, 2)] {
            let mut frame = world.map.keyframe(KeyframeId(0)).clone();
            frame.t_s = 0.1 * f64::from(k);
            frame.camera_from_world = turned(k);
            frame.information = PoseInformation {
                matrix: Matrix6::identity() * information,
                links: 20,
            };
            trajectory.push(&frame, KeyframeId(reference), &world.map);
        }
        (world, trajectory)
    }

    /// Every frame moves with its own keyframe, on the side of the world.
    #[test]
    fn frames_move_along_with_their_keyframes() {
        let (mut world, trajectory) = tracked(0.0);
        let check = |world: &World, expected: [Se3; 4]| {
            let path = trajectory.as_tracked(&world.map);
            assert_eq!(path.len(), 4);
            for ((pose, expected), k) in path.iter().zip(expected).zip(5..) {
                assert!((pose.t_s - 0.1 * f64::from(k)).abs() < 1e-12, "frame {k}");
                let off = apart(&pose.world_from_camera, &expected.inverse());
                assert!(off < 1e-11, "frame {k}: {off}");
            }
        };
        check(&world, [5, 6, 7, 8].map(turned));
        let moved = turned(3);
        let keyframe = world.map.keyframe_mut(KeyframeId(1));
        keyframe.camera_from_world = keyframe.camera_from_world * moved;
        check(
            &world,
            [turned(5) * moved, turned(6), turned(7) * moved, turned(8)],
        );
    }

    /// The motion prior moves what is measured badly, and nothing that has no covariance.
    #[test]
    fn the_stamped_path_is_the_most_likely_one() {
        for (information, smoothed) in [(0.0, false), (25.0, true)] {
            let (world, trajectory) = tracked(information);
            let (path, tracked) = (
                trajectory.stamped(&world.map, &CONFIG),
                trajectory.as_tracked(&world.map),
            );
            let measured = trajectory.measured(0, &world.map, &CONFIG);
            let expected = most_likely_path(&measured, &CONFIG);
            for ((pose, tracked), expected) in path.iter().zip(&tracked).zip(expected) {
                assert_eq!(pose.t_s.to_bits(), tracked.t_s.to_bits());
                assert_eq!(pose.world_from_camera, expected.inverse());
                let off = apart(&pose.world_from_camera, &tracked.world_from_camera);
                assert_eq!(off > 1e-3, smoothed, "{information}: {off}");
            }
        }
    }

    /// Only the last frames count: one long ago that was elsewhere changes no bit.
    #[test]
    fn the_expected_centre_follows_from_the_last_frames() {
        let world = World::observing(Config::default(), 1, &[&[0]]);
        let expected = |first_x: f64, frames: u32| {
            let mut trajectory = Trajectory::default();
            for k in 0..frames {
                let mut frame = world.map.keyframe(KeyframeId(0)).clone();
                frame.t_s = 0.1 * f64::from(k);
                let x = if k == 0 { first_x } else { 0.02 * f64::from(k) };
                frame.camera_from_world.translation.x = -x;
                frame.information.matrix = Matrix6::identity() * 100.0;
                trajectory.push(&frame, KeyframeId(0), &world.map);
            }
            let t_s = 0.1 * f64::from(frames);
            trajectory.expected_centre(t_s, &world.map, &CONFIG)
        };
        let centre =
            |first_x: f64, frames: u32| expected(first_x, frames).expect("enough").centre_m;
        let margin = u32::try_from(motion::MARGIN).expect("few");
        assert!((centre(0.0, 18).x - 0.36).abs() < 1e-6, "uniform motion");
        assert_eq!(
            centre(0.5, margin + 1),
            centre(0.0, margin + 1),
            "too long ago"
        );
        assert_ne!(
            centre(0.5, margin),
            centre(0.0, margin),
            "the first that counts"
        );
        assert!(expected(0.0, 2).is_none(), "two frames");
        assert!(expected(0.0, 3).is_some(), "three");
    }
}
