//! [`MappingJob`], [`MappingDone`] and [`MapFeedback`]: what tracking hands to the mapper, and what comes back.

use std::collections::BTreeSet;
use std::sync::Arc;

use garad_core::{
    DepthImage, FrameId, GaussianMap, KeyframeId, Label, LandmarkId, MaskImage, RgbImage, Se3,
};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::relabel::Relabelled;
use crate::dynamics::landmarks::{LandmarkCues, LandmarkLabel, TaggedLabel};

/// Everything the mapper needs to know of a keyframe.
#[derive(Debug, Clone)]
pub struct MappingJob {
    /// The keyframe.
    pub keyframe: KeyframeId,
    /// The frame it was.
    pub frame: FrameId,
    /// Colour.
    pub rgb: RgbImage,
    /// Metres; 0 and NaN are missing.
    pub depth: DepthImage,
    /// 255 where something moves.
    pub mask: Option<MaskImage>,
    /// The same in cells, if the keyframe was labelled: Gaussians are then labelled, too.
    pub cells: Option<MaskImage>,
    /// The landmarks labelled at the keyframe (`labels.source = "frames"`), ...
    pub labels: Vec<LandmarkLabel>,
    /// ... or what their Gaussians are to be labelled by (the other sources).
    pub cues: Vec<LandmarkCues>,
    /// Landmarks that the flow check found at rest since the job before: they and their Gaussians are static again.
    pub restored: BTreeSet<LandmarkId>,
    /// camera_from_world of every keyframe so far, as adjusted.
    pub poses: Vec<Se3>,
    /// If a loop was closed at this keyframe: the correction of every keyframe so far,
    /// after_from_before in the world.
    pub moved: Vec<Se3>,
    /// Landmarks that the keyframe made.
    pub new_landmarks: Vec<NewLandmark>,
    /// All landmarks of the map with their labels, ascending: the tags of others are removed.
    pub living: Vec<(LandmarkId, Label)>,
    /// Training iterations.
    pub iterations: usize,
}

/// A new landmark.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NewLandmark {
    /// Its id: the tag of its Gaussian.
    pub id: LandmarkId,
    /// Position, metres.
    pub p_world: Vector3<f64>,
    /// Its keypoint's pixel in the recorded image.
    pub px: [usize; 2],
}

/// What the map gives back to tracking at the hand-over.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct MapFeedback {
    /// Labels of tagged Gaussians, for their landmarks.
    pub labels: Vec<TaggedLabel>,
    /// Positions of tagged Gaussians (`tracking.points = "gaussians"`), metres.
    pub positions: Vec<(LandmarkId, Vector3<f64>)>,
    /// The dynamic Gaussians alone, for the Gaussian mask.
    pub dynamic: Option<GaussianMap>,
    /// The map as the job left it, if frames are tracked by rendering.
    pub map: Option<Arc<GaussianMap>>,
}

/// The outcome of a job.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct MappingDone {
    /// The keyframe.
    pub keyframe: KeyframeId,
    /// The frame it was.
    pub frame: FrameId,
    /// Labels changed, and Gaussians dropped for theirs.
    pub relabelled: Relabelled,
    /// Gaussians that move.
    pub dynamic: usize,
    /// Gaussians inserted.
    pub inserted: usize,
    /// Gaussians there are now.
    pub gaussians: usize,
    /// Training iterations done.
    pub iterations: usize,
    /// Loss of the last iteration, if there was one.
    pub loss: Option<f32>,
    /// Why training stopped early. The map is as it was after the last good iteration.
    pub error: Option<String>,
    /// Taken out at the hand-over.
    pub feedback: MapFeedback,
}
