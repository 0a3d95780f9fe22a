//! One keyframe: the landmarks of the local map through the field, with all four cues.

use garad_core::{FrameId, KeyframeId, Label, LandmarkId};
use garad_crf::{Cues, Node};
use garad_features::epipolar::{fundamental, symmetric_distance_px};

use super::witness::Court;
use crate::map::Landmark;
use crate::system::Slam;

/// Baselines shorter than this share of the depth bend no epipolar line enough to tell.
const MIN_BASELINE: f64 = 0.02;

impl Slam {
    /// Labels the landmarks that a keyframe and its neighbours see. Returns those whose label
    /// changed. A landmark that was dynamic in every one of the last runs is dropped (eq. 7).
    pub(crate) fn label_landmarks(&mut self, keyframe: KeyframeId) -> Vec<(LandmarkId, Label)> {
        let mut ids: Vec<LandmarkId> = self
            .map
            .covisible(keyframe)
            .into_keys()
            .chain([keyframe])
            .flat_map(|k| self.map.keyframe(k).landmark.iter().flatten().copied())
            .collect();
        ids.sort_unstable();
        ids.dedup();
        let now = self.map.keyframe(keyframe).id;
        let court = self.court(now);
        let frame = self.map.keyframe(keyframe);
        let found: Vec<(LandmarkId, Node)> = ids
            .iter()
            .filter_map(|id| {
                let landmark = self.map.landmark(*id)?;
                let uv = self
                    .camera
                    .project(&(frame.camera_from_world * landmark.p_world))
                    .filter(|uv| self.camera.contains(uv))?;
                Some((
                    *id,
                    Node {
                        p_world: landmark.p_world,
                        uv_px: Some(uv),
                        cues: self.cues(landmark, &court),
                        previous: Some(match landmark.label {
                            Label::Static => 0.0,
                            Label::Dynamic => 1.0,
                        }),
                    },
                ))
            })
            .collect();
        let nodes: Vec<Node> = found.iter().map(|(_, node)| *node).collect();
        let Ok(beliefs) = self.crf.infer(&nodes, self.par) else {
            return Vec::new(); // numbers that are not finite: the labels of before stay
        };
        let mut changed = Vec::new();
        for ((id, _), label) in found.iter().zip(beliefs.labels) {
            let Some(landmark) = self.map.landmark_mut(*id) else {
                continue;
            };
            landmark.window.push(label);
            if landmark.label != label {
                landmark.label = label;
                changed.push((*id, label));
            }
            if landmark.window.is_removed(&self.config.labels.window) {
                self.map.drop_landmark(*id);
            }
        }
        changed
    }

    /// Witnesses that nobody will ask any more.
    pub(crate) fn forget_witnesses(&mut self, now: FrameId) {
        let oldest = now.0.saturating_sub(self.config.labels.memory_frames);
        let (map, witnesses) = (&self.map, &mut self.witnesses);
        witnesses.retain(|k, _| map.keyframe(*k).id.0 >= oldest);
    }

    /// The paper's four cues, from the keyframes that see the landmark.
    fn cues(&self, landmark: &Landmark, court: &Court<'_>) -> Cues {
        let p = landmark.p_world;
        let mut reproj = (0.0, 0usize);
        let mut epipolar = (0.0, 0usize);
        let first = landmark.observations.first();
        for (k, i) in &landmark.observations {
            let frame = self.map.keyframe(*k);
            if let Some(uv) = self.camera.project(&(frame.camera_from_world * p)) {
                reproj = (reproj.0 + (uv - frame.uv_px[*i]).norm(), reproj.1 + 1);
            }
            let Some((k0, i0)) = first.filter(|(k0, _)| k0 != k) else {
                continue;
            };
            let origin = self.map.keyframe(*k0);
            let baseline_m = (frame.center() - origin.center()).norm();
            if baseline_m > MIN_BASELINE * (p - origin.center()).norm() {
                let second_from_first =
                    frame.camera_from_world * origin.camera_from_world.inverse();
                let f = fundamental(&self.camera, &self.camera, &second_from_first);
                let d = symmetric_distance_px(&f, &origin.uv_px[*i0], &frame.uv_px[*i]);
                if d.is_finite() {
                    epipolar = (epipolar.0 + d, epipolar.1 + 1);
                }
            }
        }
        let mean = |(sum, n): (f64, usize)| (n > 0).then(|| sum / n as f64);
        Cues {
            reproj_px: mean(reproj),
            depth_residual: court.hear(&p).residual,
            observations: u32::try_from(landmark.observations.len()).ok(),
            epipolar_px: mean(epipolar),
        }
    }
}
