//! The random field over the landmarks of a keyframe's local map, with all four cues (eq. 1 to 6), and
//! their retention (eq. 7). The only writer of landmark labels, wherever the field runs (`labels.source`).

use garad_core::{KeyframeId, Label, LandmarkId};
use garad_crf::{Crf, Cues, Node};
use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::cues::landmark_cues;
use super::evidence::FreeSpaceHistory;
use super::retention::Retention;
use crate::context::Context;
use crate::map::Map;
use crate::trace::Recorder;

/// The label that a landmark got at a keyframe.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LandmarkLabel {
    /// The landmark.
    pub id: LandmarkId,
    /// Its label.
    pub label: Label,
    /// Whether it was another before.
    pub changed: bool,
}

/// What the field reads of a landmark.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LandmarkCues {
    /// The landmark.
    pub id: LandmarkId,
    /// Where the keyframe sees it, px.
    pub uv_px: Vector2<f64>,
    /// The cues of eq. 2.
    pub cues: Cues,
}

impl LandmarkCues {
    /// Its node of the field, metres, with its label so far.
    pub(crate) fn node(&self, p_world: Vector3<f64>, label: Label) -> Node {
        Node {
            p_world,
            uv_px: Some(self.uv_px),
            cues: self.cues,
            previous: Some(match label {
                Label::Static => 0.0,
                Label::Dynamic => 1.0,
            }),
        }
    }
}

/// The landmarks that a keyframe and its neighbours observe and that project into the keyframe, ascending.
pub(crate) fn local_cues(
    context: &Context,
    map: &Map,
    keyframe: KeyframeId,
    history: &FreeSpaceHistory<'_>,
) -> Vec<LandmarkCues> {
    let neighbours = map.covisible(keyframe).into_keys();
    let ids = map.observed_by(neighbours.chain([keyframe]));
    let frame = map.keyframe(keyframe);
    let seen = ids.into_iter().filter_map(|id| {
        let landmark = map.landmark(id)?;
        let uv_px = context
            .camera
            .project(&(frame.camera_from_world * landmark.p_world))
            .filter(|uv| context.camera.contains(uv))?;
        let cues = landmark_cues(context, map, landmark, history);
        Some(LandmarkCues { id, uv_px, cues })
    });
    seen.collect()
}

/// Labels the landmarks that a keyframe and its neighbours observe. A landmark that was dynamic in every run of the
/// window is dropped (eq. 7).
pub(crate) fn label_landmarks(
    context: &Context,
    map: &mut Map,
    keyframe: KeyframeId,
    crf: &Crf,
    history: &FreeSpaceHistory<'_>,
    recorder: &mut Recorder,
) -> Vec<LandmarkLabel> {
    let local = local_cues(context, map, keyframe, history);
    let node = |seen: &LandmarkCues| {
        let landmark = map.landmark(seen.id).expect("cues of landmarks of the map");
        seen.node(landmark.p_world, landmark.label())
    };
    let nodes: Vec<Node> = local.iter().map(node).collect();
    let beliefs = crf
        .infer(&nodes, context.par)
        .expect("positions and cues of landmarks are finite");
    recorder.record("label_map", |record| {
        record.landmark_field(local.iter().map(|seen| seen.id), &nodes, &beliefs);
    });
    let mut labelled = Vec::with_capacity(local.len());
    for (LandmarkCues { id, .. }, label) in local.into_iter().zip(beliefs.labels) {
        let landmark = map
            .landmark_mut(id)
            .expect("nodes are landmarks of the map");
        let Retention { changed, expired } =
            landmark.push_label(label, &context.config.labels.window);
        labelled.push(LandmarkLabel { id, label, changed });
        if expired {
            map.drop_landmark(id);
        }
    }
    labelled
}

/// The label that a tagged Gaussian got in a mapping job.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct TaggedLabel {
    /// Its landmark.
    pub id: LandmarkId,
    /// Its label.
    pub label: Label,
    /// It was dynamic in every run of the window, and is gone.
    pub removed: bool,
}

/// Gives landmarks the labels of their Gaussians, and drops those whose Gaussians are gone.
pub(crate) fn take_labels_of_gaussians(context: &Context, map: &mut Map, labels: &[TaggedLabel]) {
    for TaggedLabel { id, label, removed } in labels.iter().copied() {
        if removed {
            map.drop_landmark(id);
        } else if let Some(landmark) = map.landmark_mut(id) {
            landmark.push_label(label, &context.config.labels.window);
        }
    }
}

#[cfg(test)]
mod tests;
