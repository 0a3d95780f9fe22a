//! Landmarks, keyframes and who sees whom.
//!
//! Both live in vectors indexed by their ids; a dropped landmark leaves a hole and its id is never
//! used again, so every loop over the map runs in the order of birth. A culled keyframe stays as an
//! empty one, whose pose follows another's ([`culling`](crate::culling)).

use std::collections::BTreeMap;

use garad_core::{Camera, KeyframeId, Label, LandmarkId, Se3};
use garad_crf::LabelWindow;
use garad_features::Descriptor;
use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::frame::Frame;

/// A 3-D point that features of several keyframes see.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Landmark {
    /// Where it is, metres.
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
    /// What moves is neither looked for nor adjusted.
    pub label: Label,
    /// The labels of the last runs (eq. 7).
    pub window: LabelWindow,
    /// Frames in which it should have been seen, and in which it was matched.
    pub visible: u32,
    /// See `visible`.
    pub found: u32,
}

/// All landmarks and keyframes of a run.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Map {
    /// In boxes, so that the hole of a dropped one is a word.
    landmarks: Vec<Option<Box<Landmark>>>,
    keyframes: Vec<Frame>,
    /// Keyframes that were given up, and what holds their poses.
    culled: BTreeMap<KeyframeId, Anchor>,
}

/// Where a culled keyframe is: as seen from one that is not.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct Anchor {
    keyframe: KeyframeId,
    culled_from_anchor: Se3,
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

impl Map {
    /// The landmark, unless it was dropped.
    #[must_use]
    pub fn landmark(&self, id: LandmarkId) -> Option<&Landmark> {
        self.landmarks.get(id.index())?.as_deref()
    }

    /// The landmark, unless it was dropped.
    pub fn landmark_mut(&mut self, id: LandmarkId) -> Option<&mut Landmark> {
        self.landmarks.get_mut(id.index())?.as_deref_mut()
    }

    /// The landmark, unless it was dropped or moves.
    #[must_use]
    pub fn static_landmark(&self, id: LandmarkId) -> Option<&Landmark> {
        self.landmark(id).filter(|l| l.label == Label::Static)
    }

    /// Landmarks that live, with their ids, oldest first.
    pub fn landmarks(&self) -> impl Iterator<Item = (LandmarkId, &Landmark)> {
        self.landmarks
            .iter()
            .zip(0u32..)
            .filter_map(|(l, i)| Some((LandmarkId(i), l.as_deref()?)))
    }

    /// All keyframes, oldest first; those that were culled have a pose and nothing else.
    #[must_use]
    pub fn keyframes(&self) -> &[Frame] {
        &self.keyframes
    }

    /// The keyframe.
    ///
    /// # Panics
    /// If the id was not handed out by this map.
    #[must_use]
    pub fn keyframe(&self, id: KeyframeId) -> &Frame {
        &self.keyframes[id.index()]
    }

    /// The keyframe.
    ///
    /// # Panics
    /// If the id was not handed out by this map.
    pub fn keyframe_mut(&mut self, id: KeyframeId) -> &mut Frame {
        &mut self.keyframes[id.index()]
    }

    /// Was it given up? Its pose stays, its features are gone.
    #[must_use]
    pub fn is_culled(&self, id: KeyframeId) -> bool {
        self.culled.contains_key(&id)
    }

    /// Keyframes that were not culled, oldest first.
    pub fn kept_ids(&self) -> impl Iterator<Item = KeyframeId> {
        let ids = (0u32..).map(KeyframeId).take(self.keyframes.len());
        ids.filter(|id| !self.is_culled(*id))
    }

    /// The youngest keyframe.
    #[must_use]
    pub fn last_keyframe_id(&self) -> Option<KeyframeId> {
        let count = u32::try_from(self.keyframes.len()).ok()?;
        count.checked_sub(1).map(KeyframeId)
    }

    /// Keeps a frame; its keypoints become observations of the landmarks they are linked to.
    pub fn add_keyframe(&mut self, frame: Frame) -> KeyframeId {
        let id = KeyframeId(u32::try_from(self.keyframes.len()).unwrap_or(u32::MAX));
        for (i, landmark) in frame.landmark.iter().enumerate() {
            if let Some(landmark) = landmark.and_then(|l| self.landmark_mut(l)) {
                landmark.observations.push((id, i));
            }
        }
        self.keyframes.push(frame);
        id
    }

    /// A new landmark seen by keypoint `i` of a keyframe.
    pub fn add_landmark(
        &mut self,
        p_world: Vector3<f64>,
        keyframe: KeyframeId,
        i: usize,
        scales: &[f64],
    ) -> LandmarkId {
        let id = LandmarkId(u32::try_from(self.landmarks.len()).unwrap_or(u32::MAX));
        let descriptor = self.keyframe(keyframe).descriptors[i];
        self.landmarks.push(Some(Box::new(Landmark {
            p_world,
            descriptor,
            view_direction: Vector3::zeros(),
            distance_m: (0.0, 0.0),
            observations: vec![(keyframe, i)],
            born: keyframe,
            label: Label::Static,
            window: LabelWindow::default(),
            visible: 1,
            found: 1,
        })));
        self.keyframe_mut(keyframe).landmark[i] = Some(id);
        self.refresh(id, scales);
        id
    }

    /// Takes a landmark out of the map and out of every keyframe that sees it.
    pub fn drop_landmark(&mut self, id: LandmarkId) {
        let Some(landmark) = self.landmarks.get_mut(id.index()).and_then(Option::take) else {
            return;
        };
        for (keyframe, i) in landmark.observations {
            self.keyframes[keyframe.index()].landmark[i] = None;
        }
    }

    /// Takes one observation back; a landmark that nobody sees any more goes with it.
    pub fn drop_observation(&mut self, id: LandmarkId, keyframe: KeyframeId) {
        let Some(landmark) = self.landmark_mut(id) else {
            return;
        };
        let Some(at) = landmark
            .observations
            .iter()
            .position(|(k, _)| *k == keyframe)
        else {
            return;
        };
        let (_, i) = landmark.observations.remove(at);
        let orphan = landmark.observations.is_empty();
        self.keyframe_mut(keyframe).landmark[i] = None;
        if orphan {
            self.drop_landmark(id);
        }
    }

    /// Gives a keyframe up: its observations are taken back, and its pose follows the keyframe that
    /// shares most landmarks with it. `false`, and nothing happens, if there is none.
    pub(crate) fn cull(&mut self, id: KeyframeId, scales: &[f64]) -> bool {
        let Some(anchor) = by_count(&self.covisible(id)).first().copied() else {
            return false;
        };
        let pose = self.keyframe(id).camera_from_world;
        let id_from_anchor = pose * self.keyframe(anchor).camera_from_world.inverse();
        for held in self.culled.values_mut().filter(|a| a.keyframe == id) {
            held.keyframe = anchor;
            held.culled_from_anchor = held.culled_from_anchor * id_from_anchor;
        }
        let anchor = Anchor {
            keyframe: anchor,
            culled_from_anchor: id_from_anchor,
        };
        self.culled.insert(id, anchor);
        let seen: Vec<_> = self
            .keyframe(id)
            .landmark
            .iter()
            .flatten()
            .copied()
            .collect();
        for landmark in seen {
            self.drop_observation(landmark, id);
            self.refresh(landmark, scales);
        }
        self.keyframe_mut(id).give_up_features();
        true
    }

    /// Culled keyframes follow those that hold them, after these have been adjusted.
    pub(crate) fn follow_anchors(&mut self) {
        for (id, anchor) in &self.culled {
            let held_by = self.keyframes[anchor.keyframe.index()].camera_from_world;
            self.keyframes[id.index()].camera_from_world = anchor.culled_from_anchor * held_by;
        }
    }

    /// One landmark instead of two: `keep` takes over the observations of `other` in keyframes it
    /// is not yet seen by.
    pub fn fuse(&mut self, keep: LandmarkId, other: LandmarkId, scales: &[f64]) {
        if keep == other || self.landmark(keep).is_none() {
            return;
        }
        let Some(gone) = self.landmarks.get_mut(other.index()).and_then(Option::take) else {
            return;
        };
        for (keyframe, i) in gone.observations {
            let seen = self
                .landmark(keep)
                .is_some_and(|l| l.observations.iter().any(|(k, _)| *k == keyframe));
            self.keyframe_mut(keyframe).landmark[i] = (!seen).then_some(keep);
            if !seen && let Some(landmark) = self.landmark_mut(keep) {
                landmark.observations.push((keyframe, i));
                landmark.observations.sort_unstable();
            }
        }
        if let Some(landmark) = self.landmark_mut(keep) {
            landmark.visible += gone.visible;
            landmark.found += gone.found;
        }
        self.refresh(keep, scales);
    }

    /// Makes keypoint `i` of a keyframe an observation of a landmark.
    pub fn add_observation(&mut self, id: LandmarkId, keyframe: KeyframeId, i: usize) {
        if let Some(landmark) = self.landmark_mut(id) {
            landmark.observations.push((keyframe, i));
            landmark.observations.sort_unstable();
            self.keyframe_mut(keyframe).landmark[i] = Some(id);
        }
    }

    /// Recomputes what follows from the observations: representative descriptor, mean view, and
    /// the distances at which the pyramid can find the point,
    /// d · sˡ / sᴸ⁻¹ ≤ distance ≤ d · sˡ for distance d and level l of the first observation.
    pub fn refresh(&mut self, id: LandmarkId, scales: &[f64]) {
        let Some(landmark) = self.landmark(id) else {
            return;
        };
        let p_world = landmark.p_world;
        let views: Vec<_> = landmark
            .observations
            .iter()
            .map(|&(k, i)| (self.keyframe(k), i))
            .collect();
        let Some(&(first, first_i)) = views.first() else {
            return;
        };
        let view_direction = views
            .iter()
            .map(|(frame, _)| unit(p_world - frame.center()))
            .fold(Vector3::zeros(), |sum, d| sum + d);
        let descriptors: Vec<_> = views
            .iter()
            .map(|(frame, i)| frame.descriptors[*i])
            .collect();
        let distance = (p_world - first.center()).norm();
        let farthest = distance * scales[usize::from(first.keypoints[first_i].level)];
        let nearest = farthest / scales[scales.len() - 1];
        let descriptor = medoid(&descriptors);
        if let Some(landmark) = self.landmark_mut(id) {
            landmark.view_direction = unit(view_direction);
            landmark.distance_m = (nearest, farthest);
            landmark.descriptor = descriptor;
        }
    }

    /// How a landmark should look from a frame; `None` if it should not be seen there: behind,
    /// outside, too near, too far, from more than 60° beside its mean view, or if it moves.
    #[must_use]
    pub fn appearance(
        &self,
        landmark: &Landmark,
        frame: &Frame,
        camera: &Camera,
        scales: &[f64],
    ) -> Option<Appearance> {
        if landmark.label == Label::Dynamic {
            return None;
        }
        let p_cam = frame.camera_from_world * landmark.p_world;
        let uv_px = camera.project(&p_cam)?;
        if !camera.contains(&uv_px) {
            return None;
        }
        let offset = landmark.p_world - frame.center();
        let distance = offset.norm();
        let (nearest, farthest) = landmark.distance_m;
        let view_cosine = offset.dot(&landmark.view_direction) / distance;
        let in_range = distance >= 0.8 * nearest && distance <= 1.2 * farthest;
        (in_range && view_cosine >= MIN_VIEW_COSINE).then(|| Appearance {
            uv_px,
            depth_m: p_cam.z,
            level: predicted_level(farthest / distance, scales),
            view_cosine,
        })
    }

    /// Keyframes that see landmarks of a keyframe, with the number they share, by id.
    #[must_use]
    pub fn covisible(&self, id: KeyframeId) -> BTreeMap<KeyframeId, usize> {
        let mut shared = self.observers(self.keyframe(id).landmark.iter().flatten().copied());
        shared.remove(&id);
        shared
    }

    /// Keyframes that see any of the landmarks, with the number they see, by id.
    pub fn observers(
        &self,
        landmarks: impl Iterator<Item = LandmarkId>,
    ) -> BTreeMap<KeyframeId, usize> {
        let mut seen = BTreeMap::new();
        for landmark in landmarks.filter_map(|l| self.landmark(l)) {
            for (keyframe, _) in &landmark.observations {
                *seen.entry(*keyframe).or_insert(0) += 1;
            }
        }
        seen
    }
}

/// Ids of the largest counts first; equal counts: youngest first.
#[must_use]
pub fn by_count(counts: &BTreeMap<KeyframeId, usize>) -> Vec<KeyframeId> {
    let mut ids: Vec<_> = counts.iter().map(|(id, n)| (*n, *id)).collect();
    ids.sort_unstable_by(|a, b| b.cmp(a));
    ids.into_iter().map(|(_, id)| id).collect()
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
fn medoid(descriptors: &[Descriptor]) -> Descriptor {
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

fn unit(v: Vector3<f64>) -> Vector3<f64> {
    let norm = v.norm();
    if norm > 0.0 { v / norm } else { v }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn levels_and_counts_are_ordered_as_stated() {
        let scales = [1.0, 1.2, 1.44];
        assert_eq!(predicted_level(1.0, &scales), 0, "own level");
        assert_eq!(predicted_level(1.2, &scales), 1, "own level");
        assert_eq!(predicted_level(1.21, &scales), 2, "next one up");
        assert_eq!(predicted_level(9.0, &scales), 2, "the last at most");
        let counts = [(0, 5), (1, 9), (2, 5)].map(|(k, n)| (KeyframeId(k), n));
        let order = by_count(&BTreeMap::from(counts));
        assert_eq!(
            order,
            [1, 2, 0].map(KeyframeId),
            "most first, then youngest"
        );
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
    }
}
