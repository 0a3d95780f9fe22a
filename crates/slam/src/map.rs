//! [`Map`]: landmarks, keyframes and their covisibility.
//!
//! Both are stored in vectors indexed by their ids; a dropped landmark leaves a hole and its id is
//! never used again, so every loop over the map runs in the order of creation. A culled keyframe
//! stays as an empty one, whose pose follows another's (`culling`).

pub mod landmark;

use std::collections::BTreeMap;

use garad_core::{FrameId, KeyframeId, Label, LandmarkId, Se3};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use self::landmark::{Landmark, LandmarkDepth, medoid};
use crate::frame::Frame;

/// All landmarks and keyframes of a run.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub struct Map {
    /// Boxed, so that the hole of a dropped one is one word.
    landmarks: Vec<Option<Box<Landmark>>>,
    keyframes: Vec<Frame>,
    /// Culled keyframes, and the keyframes their poses are tied to.
    culled: BTreeMap<KeyframeId, Anchor>,
}

/// The pose of a culled keyframe relative to one that is not.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
struct Anchor {
    keyframe: KeyframeId,
    culled_from_anchor: Se3,
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
        self.landmark(id).filter(|l| l.label() == Label::Static)
    }

    /// Landmarks of the map with their ids, oldest first.
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

    /// Whether it was culled: its pose stays, its features are gone.
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

    /// The frame of the youngest keyframe; 0 without any.
    #[must_use]
    pub fn last_keyframe_frame(&self) -> FrameId {
        self.keyframes.last().map_or(FrameId(0), |k| k.id)
    }

    /// Adds a keyframe; its keypoints become observations of the landmarks they are linked to.
    pub fn add_keyframe(&mut self, frame: Frame) -> KeyframeId {
        let id = KeyframeId(u32::try_from(self.keyframes.len()).unwrap_or(u32::MAX));
        for (i, landmark) in frame.landmark.iter().enumerate() {
            if let Some(landmark) = landmark.and_then(|l| self.landmark_mut(l)) {
                landmark.observations.push((id, i));
                if frame.depth_m[i].is_some() {
                    landmark.measured_by(id);
                }
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
        let landmark = Landmark::new(p_world, descriptor, keyframe, i);
        self.landmarks.push(Some(Box::new(landmark)));
        self.keyframe_mut(keyframe).landmark[i] = Some(id);
        self.refresh(id, scales);
        id
    }

    /// Moves a landmark, unless it was dropped.
    pub(crate) fn set_position(&mut self, id: LandmarkId, p_world: Vector3<f64>, scales: &[f64]) {
        if let Some(landmark) = self.landmark_mut(id) {
            landmark.p_world = p_world;
            self.refresh(id, scales);
        }
    }

    /// Removes a landmark from the map and from every keyframe that observes it.
    pub fn drop_landmark(&mut self, id: LandmarkId) {
        let Some(landmark) = self.landmarks.get_mut(id.index()).and_then(Option::take) else {
            return;
        };
        for (keyframe, i) in landmark.observations {
            self.keyframes[keyframe.index()].landmark[i] = None;
        }
    }

    /// Removes an observation, and the landmark if it was the last one.
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

    /// Culls a keyframe: its observations are removed, and its pose follows the keyframe that
    /// shares most landmarks with it. `false`, and nothing happens, if there is none.
    pub(crate) fn cull(&mut self, id: KeyframeId, scales: &[f64]) -> bool {
        let Some(anchor) = by_count(&self.covisible(id)).first().copied() else {
            return false;
        };
        let pose = self.keyframe(id).camera_from_world;
        let id_from_anchor = pose * self.keyframe(anchor).camera_from_world.inverse();
        for tied in self.culled.values_mut().filter(|a| a.keyframe == id) {
            tied.keyframe = anchor;
            tied.culled_from_anchor = tied.culled_from_anchor * id_from_anchor;
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
        self.keyframe_mut(id).drop_features();
        true
    }

    /// Moves culled keyframes with those their poses are tied to, after these have been adjusted.
    pub(crate) fn follow_anchors(&mut self) {
        for (id, anchor) in &self.culled {
            let anchor_from_world = self.keyframes[anchor.keyframe.index()].camera_from_world;
            self.keyframes[id.index()].camera_from_world =
                anchor.culled_from_anchor * anchor_from_world;
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
                .is_some_and(|l| l.is_observed_by(keyframe));
            self.keyframe_mut(keyframe).landmark[i] = (!seen).then_some(keep);
            if !seen && let Some(landmark) = self.landmark_mut(keep) {
                landmark.observations.push((keyframe, i));
                landmark.observations.sort_unstable();
            }
        }
        if let Some(landmark) = self.landmark_mut(keep) {
            if let LandmarkDepth::Measured { since } = gone.depth {
                landmark.measured_by(since);
            }
            landmark.visible += gone.visible;
            landmark.found += gone.found;
        }
        self.refresh(keep, scales);
    }

    /// Makes keypoint `i` of a keyframe an observation of a landmark.
    pub fn add_observation(&mut self, id: LandmarkId, keyframe: KeyframeId, i: usize) {
        let has_depth = self.keyframe(keyframe).depth_m[i].is_some();
        if let Some(landmark) = self.landmark_mut(id) {
            landmark.observations.push((keyframe, i));
            landmark.observations.sort_unstable();
            if has_depth {
                landmark.measured_by(keyframe);
            }
            self.keyframe_mut(keyframe).landmark[i] = Some(id);
        }
    }

    /// Ids of all landmarks, ascending.
    #[must_use]
    pub fn landmark_ids(&self) -> Vec<LandmarkId> {
        self.landmarks().map(|(id, _)| id).collect()
    }

    /// camera_from_world of every keyframe.
    #[must_use]
    pub fn keyframe_poses(&self) -> Vec<Se3> {
        self.keyframes.iter().map(|k| k.camera_from_world).collect()
    }

    /// [`Map::refresh`] for every landmark.
    pub(crate) fn refresh_all(&mut self, scales: &[f64]) {
        for id in self.landmark_ids() {
            self.refresh(id, scales);
        }
    }

    /// Counts, for landmarks that should have been visible in a frame, and those that were found.
    pub(crate) fn count_sightings(
        &mut self,
        expected: &[LandmarkId],
        found: impl Iterator<Item = LandmarkId>,
    ) {
        for id in expected {
            self.landmark_mut(*id).expect("in the local map").visible += 1;
        }
        for id in found {
            self.landmark_mut(id).expect("linked").found += 1;
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

    /// Keyframes that observe landmarks of a keyframe, with the number they share, by id.
    #[must_use]
    pub fn covisible(&self, id: KeyframeId) -> BTreeMap<KeyframeId, usize> {
        let mut shared = self.observers(self.keyframe(id).landmark.iter().flatten().copied());
        shared.remove(&id);
        shared
    }

    /// Landmarks that any of the keyframes observes, ascending.
    #[must_use]
    pub fn observed_by(&self, keyframes: impl IntoIterator<Item = KeyframeId>) -> Vec<LandmarkId> {
        let keyframes = keyframes.into_iter();
        let landmarks = keyframes.flat_map(|k| self.keyframe(k).landmark.iter().flatten());
        let mut ids: Vec<LandmarkId> = landmarks.copied().collect();
        ids.sort_unstable();
        ids.dedup();
        ids
    }

    /// Keyframes that observe any of the landmarks, with the number they observe, by id.
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

fn unit(v: Vector3<f64>) -> Vector3<f64> {
    let norm = v.norm();
    if norm > 0.0 { v / norm } else { v }
}

#[cfg(test)]
mod tests;
