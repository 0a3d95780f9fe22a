//! The local map of a frame: the landmarks that its neighbourhood's keyframes observe.

use garad_core::{KeyframeId, LandmarkId};

use crate::context::Context;
use crate::frame::Frame;
use crate::map::landmark::Appearance;
use crate::map::{Map, by_count};

/// What is searched for in a frame beyond its first links.
#[derive(Debug)]
pub(crate) struct LocalMap {
    /// The keyframe that shares most landmarks with the frame.
    pub(crate) reference: Option<KeyframeId>,
    /// Landmarks that should be visible, not linked yet, by id.
    pub(crate) visible: Vec<(LandmarkId, Appearance)>,
    /// All that should be visible, those already linked included.
    pub(crate) expected: Vec<LandmarkId>,
}

/// The local map is what these keyframes observe: those that observe the frame's landmarks, and
/// for each of them its most covisible neighbour not yet among them (of ten), up to
/// `max_local_keyframes`.
pub(crate) fn local_map(context: &Context, map: &Map, frame: &Frame) -> LocalMap {
    let max_keyframes = context.config.tracking.max_local_keyframes;
    let mut linked: Vec<_> = frame.landmark.iter().flatten().copied().collect();
    linked.sort_unstable();
    let votes = map.observers(linked.iter().copied());
    let mut keyframes = by_count(&votes);
    let reference = keyframes.first().copied();
    keyframes.truncate(max_keyframes);
    for keyframe in keyframes.clone() {
        if keyframes.len() >= max_keyframes {
            break;
        }
        let neighbours = by_count(&map.covisible(keyframe));
        let new = neighbours.iter().take(10).find(|k| !keyframes.contains(k));
        keyframes.extend(new);
    }
    let (mut visible, mut expected) = (Vec::new(), Vec::new());
    for id in map.observed_by(keyframes) {
        let already_linked = linked.binary_search(&id).is_ok();
        let landmark = map.landmark(id).expect("keyframes link living landmarks");
        let appearance = landmark.appearance(frame, &context.camera, &context.scales);
        if already_linked || appearance.is_some() {
            expected.push(id);
        }
        if let Some(appearance) = appearance.filter(|_| !already_linked) {
            visible.push((id, appearance));
        }
    }
    LocalMap {
        reference,
        visible,
        expected,
    }
}
