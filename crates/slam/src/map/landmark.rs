//! [`Landmark`]: a 3-D point of the map, and its [`Appearance`] in a frame.

use garad_core::{Camera, KeyframeId, Label};
use garad_crf::{LabelWindow, LabelWindowConfig};
use garad_features::Descriptor;
use nalgebra::{Matrix3, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::dynamics::retention::{Retention, push_label};
use crate::frame::Frame;

/// A 3-D point that features of several keyframes see.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Landmark {
    /// Position, metres.
    pub p_world: Vector3<f64>,
    /// The observed descriptor nearest to all others.
    pub descriptor: Descriptor,
    /// Mean direction from the cameras to it, unit length.
    pub view_direction: Vector3<f64>,
    /// Distances at which the ORB pyramid can still find it, metres.
    pub distance_m: (f64, f64),
    /// Observing keyframes and their keypoint, in order of the keyframes.
    pub observations: Vec<(KeyframeId, usize)>,
    /// The keyframe that made it.
    pub born: KeyframeId,
    /// Where its depth comes from.
    pub depth: LandmarkDepth,
    /// A dynamic landmark is neither searched for nor adjusted.
    label: Label,
    /// The labels of the last runs (eq. 7).
    window: LabelWindow,
    /// Frames in which it should have been seen, and in which it was matched.
    pub visible: u32,
    /// See `visible`.
    pub found: u32,
}

/// Where a landmark's depth comes from.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum LandmarkDepth {
    /// From the depth camera.
    Measured {
        /// The first keyframe that observes it with depth.
        since: KeyframeId,
    },
    /// From two views or more; no keyframe observes it with depth.
    Triangulated {
        /// Of its position, m².
        covariance: Matrix3<f64>,
    },
}

impl Landmark {
    /// A static landmark seen by one keypoint; what follows from its observations is computed by
    /// [`Map::refresh`](super::Map::refresh).
    pub(super) fn new(
        p_world: Vector3<f64>,
        descriptor: Descriptor,
        keyframe: KeyframeId,
        i: usize,
    ) -> Self {
        let depth = LandmarkDepth::Measured { since: keyframe };
        Self {
            p_world,
            descriptor,
            view_direction: Vector3::zeros(),
            distance_m: (0.0, 0.0),
            observations: vec![(keyframe, i)],
            born: keyframe,
            depth,
            label: Label::Static,
            window: LabelWindow::default(),
            visible: 1,
            found: 1,
        }
    }

    /// Whether it moves.
    #[must_use]
    pub fn label(&self) -> Label {
        self.label
    }

    /// Adds a label to the window of eq. 7. Called by [`dynamics::landmarks`](crate::dynamics)
    /// alone: the one writer of landmark labels.
    pub(crate) fn push_label(&mut self, label: Label, config: &LabelWindowConfig) -> Retention {
        push_label(&mut self.label, &mut self.window, label, config)
    }

    /// A keyframe that observes it with depth: it is measured from now on, if it was not before.
    pub(super) fn measured_by(&mut self, keyframe: KeyframeId) {
        if let LandmarkDepth::Triangulated { .. } = self.depth {
            self.depth = LandmarkDepth::Measured { since: keyframe };
        }
    }

    /// Whether a keyframe observes it.
    #[must_use]
    pub fn is_observed_by(&self, keyframe: KeyframeId) -> bool {
        self.observations.iter().any(|(k, _)| *k == keyframe)
    }

    /// The expected appearance in a frame; `None` if it should not be visible there: behind,
    /// outside, too near, too far, from more than 60° beside its mean view, or if it moves.
    #[must_use]
    pub fn appearance(&self, frame: &Frame, camera: &Camera, scales: &[f64]) -> Option<Appearance> {
        if self.label == Label::Dynamic {
            return None;
        }
        let p_cam = frame.camera_from_world * self.p_world;
        let uv_px = camera.project(&p_cam)?;
        if !camera.contains(&uv_px) {
            return None;
        }
        let offset = self.p_world - frame.center();
        let distance = offset.norm();
        let (nearest, farthest) = self.distance_m;
        let view_cosine = offset.dot(&self.view_direction) / distance;
        let in_range = distance >= 0.8 * nearest && distance <= 1.2 * farthest;
        (in_range && view_cosine >= MIN_VIEW_COSINE).then(|| Appearance {
            uv_px,
            depth_m: p_cam.z,
            level: predicted_level(farthest / distance, scales),
            view_cosine,
        })
    }
}

/// A view direction within 60° of the mean counts as the same side of a point.
const MIN_VIEW_COSINE: f64 = 0.5;

/// How a landmark should appear in a frame.
#[derive(Debug, Clone, Copy)]
pub struct Appearance {
    /// Ideal pixel.
    pub uv_px: Vector2<f64>,
    /// Metres along z.
    pub depth_m: f64,
    /// Level at which its detail has the size it was learnt at.
    pub level: usize,
    /// Cosine between this view and the mean view.
    pub view_cosine: f64,
}

/// Smallest level whose scale reaches `ratio`: where detail learnt at the farthest distance has
/// its size again.
fn predicted_level(ratio: f64, scales: &[f64]) -> usize {
    let tolerance = 1.0 - 1e-9; // the level a point was made at must give itself back
    scales
        .iter()
        .position(|s| *s >= ratio * tolerance)
        .unwrap_or(scales.len() - 1)
}

/// The descriptor with the smallest median distance to all; the first of equals.
pub(super) fn medoid(descriptors: &[Descriptor]) -> Descriptor {
    let median_distance = |a: &Descriptor| {
        let mut distances: Vec<_> = descriptors.iter().map(|b| a.distance(b)).collect();
        distances.sort_unstable();
        distances[(distances.len() - 1) / 2]
    };
    descriptors
        .iter()
        .min_by_key(|d| median_distance(d))
        .copied()
        .unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use garad_core::Se3;

    use super::*;
    use crate::config::Config;
    use crate::testing::{World, turned};

    /// Where a landmark should appear in a camera that has turned: the place in the camera, the distances at which
    /// it can be found and the cosine to its mean view.
    #[test]
    fn what_should_be_visible_and_how() {
        let p_cam = Vector3::new(0.6, -0.8, 3.0);
        let d = p_cam.norm();
        let pose = turned(4);
        let seen = |p_cam: Vector3<f64>, (nearest, farthest): (f64, f64), cosine: f64| {
            let mut world = World::observing(Config::default(), 1, &[&[0]]);
            let frame = world.map.keyframe_mut(KeyframeId(0));
            frame.camera_from_world = pose;
            let landmark = world
                .map
                .landmark_mut(garad_core::LandmarkId(0))
                .expect("made");
            landmark.p_world = pose.inverse() * p_cam;
            let ray = pose.rotation.inverse() * (p_cam / p_cam.norm());
            let beside = ray.cross(&Vector3::new(0.3, 0.5, -0.2)).normalize();
            landmark.view_direction = ray * cosine + beside * (1.0 - cosine * cosine).sqrt();
            landmark.distance_m = (nearest, farthest);
            let World { context, map, .. } = &world;
            let landmark = map.landmark(garad_core::LandmarkId(0)).expect("made");
            landmark.appearance(
                map.keyframe(KeyframeId(0)),
                &context.camera,
                &context.scales,
            )
        };
        let all = (0.1, 2.0 * d);
        let found = seen(p_cam, (0.1, 1.7 * d), 0.75).expect("visible");
        // 78.5 + 120 · 0.6/3, 60.5 - 110 · 0.8/3
        assert!((found.uv_px - Vector2::new(102.5, 60.5 - 88.0 / 3.0)).norm() < 1e-12);
        assert!(
            (found.depth_m - 3.0).abs() < 1e-12,
            "along z: {}",
            found.depth_m
        );
        assert!(
            (found.view_cosine - 0.75).abs() < 1e-12,
            "{}",
            found.view_cosine
        );
        assert_eq!(found.level, 3, "1.2³ = 1.728 is the first that reaches 1.7");
        for (what, p_cam, distances, cosine, expected) in [
            ("60° beside", p_cam, all, 0.501, true),
            ("more", p_cam, all, 0.499, false),
            ("from behind", p_cam, all, -0.9, false),
            ("just near enough", p_cam, (0.1, d / 1.19), 1.0, true),
            ("too far", p_cam, (0.1, d / 1.21), 1.0, false),
            ("just far enough", p_cam, (d / 0.81, 9.0 * d), 1.0, true),
            ("too near", p_cam, (d / 0.79, 9.0 * d), 1.0, false),
            ("behind the camera", -p_cam, all, 1.0, false),
            (
                "at the left edge",
                Vector3::new(-1.97, 0.5, 3.0),
                all,
                1.0,
                true,
            ),
            (
                "beyond the left edge",
                Vector3::new(-1.98, 0.5, 3.0),
                all,
                1.0,
                false,
            ),
            (
                "at the lower edge",
                Vector3::new(0.1, 1.6, 3.0),
                all,
                1.0,
                true,
            ),
            (
                "beyond the lower edge",
                Vector3::new(0.1, 1.61, 3.0),
                all,
                1.0,
                false,
            ),
        ] {
            assert_eq!(seen(p_cam, distances, cosine).is_some(), expected, "{what}");
        }
        let mut world = World::observing(Config::default(), 1, &[&[0]]);
        let visible = |world: &World| {
            let frame = world.map.keyframe(KeyframeId(0));
            let landmark = world.map.landmark(garad_core::LandmarkId(0)).expect("made");
            landmark
                .appearance(frame, &world.context.camera, &world.context.scales)
                .is_some()
        };
        assert_eq!(
            world.map.keyframe(KeyframeId(0)).camera_from_world,
            Se3::identity()
        );
        assert!(visible(&world), "static");
        world.set_dynamic(0);
        assert!(!visible(&world), "dynamic");
    }

    #[test]
    fn levels_are_ordered_as_stated() {
        let scales = [1.0, 1.2, 1.44];
        assert_eq!(predicted_level(1.0, &scales), 0, "own level");
        assert_eq!(predicted_level(1.2, &scales), 1, "own level");
        assert_eq!(predicted_level(1.21, &scales), 2, "next one up");
        assert_eq!(predicted_level(9.0, &scales), 2, "the last at most");
    }

    #[test]
    fn medoid_is_the_middle_one() {
        let d = |bits: u64| Descriptor([bits, 0, 0, 0]);
        assert_eq!(
            medoid(&[d(0b1111), d(0b0011), d(0b0001)]),
            d(0b0011),
            "between the others"
        );
        assert_eq!(medoid(&[d(7)]), d(7), "alone");
        assert_eq!(medoid(&[d(0b11), d(0b1)]), d(0b11), "the first of equals");
        // Distances 0 1 4 6, 0 1 3 5, 0 2 3 4 and 0 2 5 6: of four the second counts.
        let four = [0, 0b1, 0b1111, 0b11_1111];
        assert_eq!(medoid(&four.map(d)), d(0), "1 bit from another");
        assert_eq!(medoid(&[]), Descriptor::default(), "none");
    }
}
