//! Local bundle adjustment: the newest keyframes and what they see at rest, optimised together.

use std::collections::BTreeMap;

use garad_core::{KeyframeId, LandmarkId};
use garad_optim::{BundleConfig, BundleObservation, optimise_bundle};

use crate::map::by_count;
use crate::system::Slam;

impl Slam {
    /// Optimises a keyframe, its most covisible neighbours and every landmark they see. Other
    /// keyframes that see those landmarks hold the gauge; the first keyframe of all never moves.
    /// Observations that disagree afterwards are erased.
    pub(crate) fn local_ba(&mut self, newest: KeyframeId) {
        let config = &self.config.local_ba;
        let mut free: Vec<KeyframeId> = vec![newest];
        let neighbours = by_count(&self.map.covisible(newest));
        free.extend(
            neighbours
                .into_iter()
                .take(config.max_free.saturating_sub(1)),
        );
        free.retain(|k| k.0 != 0);
        let mut landmarks: Vec<LandmarkId> = free
            .iter()
            .flat_map(|k| self.map.keyframe(*k).landmark.iter().flatten().copied())
            .filter(|l| self.map.static_landmark(*l).is_some())
            .collect();
        landmarks.sort_unstable();
        landmarks.dedup();
        let mut others = self.map.observers(landmarks.iter().copied());
        for k in &free {
            others.remove(k);
        }
        let fixed: Vec<_> = by_count(&others)
            .into_iter()
            .take(config.max_fixed)
            .collect();
        let iterations = config.iterations;
        self.adjust(&free, &fixed, &landmarks, iterations);
    }

    /// Optimises free keyframes and landmarks over all observations by these and the fixed ones.
    /// Observations that disagree afterwards are erased. Nothing happens unless there is one of each.
    pub(crate) fn adjust(
        &mut self,
        free: &[KeyframeId],
        fixed: &[KeyframeId],
        landmarks: &[LandmarkId],
        iterations: usize,
    ) {
        if free.is_empty() || fixed.is_empty() || landmarks.is_empty() {
            return;
        }
        let keyframes: Vec<KeyframeId> = free.iter().chain(fixed).copied().collect();
        let pose_of: BTreeMap<KeyframeId, usize> =
            keyframes.iter().enumerate().map(|(i, k)| (*k, i)).collect();
        let mut poses: Vec<_> = keyframes
            .iter()
            .map(|k| self.map.keyframe(*k).camera_from_world)
            .collect();
        let is_fixed: Vec<_> = (0..keyframes.len()).map(|i| i >= free.len()).collect();
        let mut points = Vec::new();
        let mut observations = Vec::new();
        let mut sources = Vec::new();
        for id in landmarks {
            let Some(landmark) = self.map.landmark(*id) else {
                continue;
            };
            for (keyframe, i) in &landmark.observations {
                let Some(&pose) = pose_of.get(keyframe) else {
                    continue;
                };
                let seen = self.observation(self.map.keyframe(*keyframe), *i, landmark.p_world);
                observations.push(BundleObservation {
                    pose,
                    point: points.len(),
                    uv_px: seen.uv_px,
                    sigma_px: seen.sigma_px,
                    depth: seen.depth,
                });
                sources.push((*id, *keyframe));
            }
            points.push(landmark.p_world);
        }
        let before = self.tape.is_on().then(|| (poses.clone(), points.clone()));
        let bundle = BundleConfig {
            iterations,
            ..BundleConfig::default()
        };
        let result = optimise_bundle(
            &self.camera,
            self.config.tracking.bf,
            &mut poses,
            &is_fixed,
            &mut points,
            &observations,
            &bundle,
        );
        let Ok(report) = result else {
            return; // the poses and landmarks of before stay
        };
        if let Some((poses_before, points_before)) = before {
            self.tape.put("bundle", |page| {
                page.bundle_in(&poses_before, &is_fixed, &points_before, &observations);
                page.bundle_out(&poses, &points, &report);
            });
        }
        for (keyframe, pose) in free.iter().zip(&poses) {
            self.map.keyframe_mut(*keyframe).camera_from_world = *pose;
        }
        self.map.follow_anchors();
        for (id, p_world) in landmarks.iter().zip(&points) {
            if let Some(landmark) = self.map.landmark_mut(*id) {
                landmark.p_world = *p_world;
            }
        }
        for ((id, keyframe), inlier) in sources.into_iter().zip(report.inlier) {
            if !inlier {
                self.map.drop_observation(id, keyframe);
            }
        }
        for id in landmarks {
            self.map.refresh(*id, &self.scales);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::labels::frame::tests::{frame, slam, wall};

    /// Three keyframes at the same place see 300 points of a wall; the last of them puts one 30 px beside where it is.
    #[test]
    fn what_disagrees_is_no_longer_seen() {
        let mut slam = slam(Config::default());
        let depth = wall();
        let first = slam.map.add_keyframe(frame(&slam, 0, &depth));
        let made: Vec<_> = (0..300)
            .map(|i| {
                let p_world = slam.map.keyframe(first).world_point(i, &slam.camera);
                let p_world = p_world.expect("on the wall");
                slam.map.add_landmark(p_world, first, i, &slam.scales)
            })
            .collect();
        for id in [20, 40] {
            let mut seen = frame(&slam, id, &depth);
            seen.landmark = made.iter().copied().map(Some).collect();
            slam.map.add_keyframe(seen);
        }
        let newest = KeyframeId(2);
        slam.map.keyframe_mut(newest).uv_px[7].y += 30.0;
        slam.local_ba(newest);
        for (i, id) in made.iter().enumerate() {
            let landmark = slam.map.landmark(*id).expect("seen by two at least");
            let by: Vec<_> = landmark.observations.iter().map(|(k, _)| k.0).collect();
            let expected: &[u32] = if i == 7 { &[0, 1] } else { &[0, 1, 2] };
            assert_eq!(by, expected, "landmark {i}");
            let linked = slam.map.keyframe(newest).landmark[i];
            assert_eq!(linked, (i != 7).then_some(*id), "keypoint {i}");
        }
    }
}
