//! Loop closing: a revisited place is recognised and the drift of the path corrected (decision 007).
//!
//! Tracking measures every keyframe against its neighbours, and small errors accumulate. When the
//! camera returns to an earlier place, the same objects are mapped twice at slightly different positions.
//!
//! | step | question | answer |
//! |---|---|---|
//! | `candidates` | which older keyframes look like this one? | place index, no neighbours, several keyframes in a row |
//! | `locate` | what is the camera's pose, seen from there? | matches, rigid motion, local map |
//! | `is_plausible` | can the path have drifted so far? | share of the path length |
//! | `correct_path` | how does the error spread over the path? | pose graph |
//! | `join_landmarks` | which landmarks are the same? | links of `locate`, search around them |
//! | `global_ba` | what fits all observations best? | every keyframe and landmark |
//!
//! Culled keyframes follow those their poses are tied to. Landmarks move with the keyframe that made
//! them, and so do Gaussians, at the mapper's next job.
//!
//! Source: the order of steps is ORB-SLAM's (Mur-Artal, Montiel, Tardós 2015); with depth the scale
//! is known, so motions are rigid.

use std::collections::BTreeSet;

use garad_core::{KeyframeId, LandmarkId, Se3};
use garad_features::PlaceIndex;
use garad_optim::{BundleConfig, PoseEdge, PoseGraph, PoseGraphConfig};
use nalgebra::{Matrix6, Vector3, Vector6};
use serde::{Deserialize, Serialize};

use super::landmarks::fuse_into;
use super::local_ba::adjust;
use crate::context::Context;
use crate::frame::Frame;
use crate::map::{Map, by_count};
use crate::trace::Recorder;
use crate::tracking::relocalise::{landmarks_around, locate, static_descriptors};

/// A loop that was closed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LoopClosure {
    /// The keyframe at which.
    pub keyframe: KeyframeId,
    /// The older keyframe that shows the same place.
    pub older: KeyframeId,
    /// Landmarks around the older one that agree with one pose of the keyframe.
    pub inliers: usize,
    /// How far the keyframe was from there, metres.
    pub drift_m: f64,
}

/// The state of loop closing from keyframe to keyframe.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(crate) struct LoopCloser {
    /// Places the last keyframe looked like, and for how many keyframes in a row.
    streaks: Vec<(BTreeSet<KeyframeId>, usize)>,
    closed: Vec<LoopClosure>,
}

/// Distance at which a landmark is typically seen: an error of 1 rad moves it by this many metres.
const TYPICAL_DEPTH_M: f64 = 2.5;
/// Landmarks two keyframes share from which they get an edge of their own in the pose graph.
const EDGE_LANDMARKS: usize = 50;
/// Neighbours of the keyframe into which the landmarks of the place are projected.
const JOIN_NEIGHBOURS: usize = 10;

impl LoopCloser {
    /// The loops closed so far.
    pub(crate) fn closed(&self) -> &[LoopClosure] {
        &self.closed
    }

    /// Adds a closed loop.
    pub(crate) fn push(&mut self, closure: LoopClosure) {
        self.closed.push(closure);
        self.streaks.clear();
    }

    /// Closes a loop at a new keyframe, if there is one. Returns after_from_before, in the world, of
    /// every keyframe; nothing if there was no loop.
    pub(crate) fn close_loop(
        &mut self,
        context: &Context,
        map: &mut Map,
        places: &PlaceIndex,
        id: KeyframeId,
        recorder: &mut Recorder,
    ) -> Vec<Se3> {
        for older in self.candidates(context, map, places, id) {
            let mut seen = map.keyframe(id).clone();
            // As detected: the σ of a subpixel match holds for the images of its own time.
            for (sigma, keypoint) in seen.sigma_px.iter_mut().zip(&seen.keypoints) {
                *sigma = context.scales[usize::from(keypoint.level)];
            }
            let inliers = locate(context, map, &mut seen, older, recorder);
            if inliers < context.config.loops.min_inliers
                || !is_plausible(context, map, id, older, &seen)
            {
                continue;
            }
            let closure = LoopClosure {
                keyframe: id,
                older,
                inliers,
                drift_m: (seen.center() - map.keyframe(id).center()).norm(),
            };
            let before = map.keyframe_poses();
            let located = seen.camera_from_world;
            let graph =
                (recorder.is_recording()).then(|| path_graph(map, &self.closed, &closure, located));
            if !correct_path(context, map, &self.closed, &closure, located) {
                continue;
            }
            if let Some(graph) = graph {
                recorder.record("loop", |record| {
                    let after = map.keyframe_poses();
                    let keyframes = (0u32..).map(KeyframeId).take(after.len());
                    let fixed: Vec<bool> =
                        keyframes.map(|k| k.0 == 0 || map.is_culled(k)).collect();
                    record.closed_loop(&closure, &graph, &fixed, &located, &after);
                });
            }
            join_landmarks(context, map, &closure, &seen);
            global_ba(context, map, recorder);
            tracing::info!(
                keyframe = id.0,
                older = older.0,
                inliers,
                drift_m = closure.drift_m,
                "loop closed"
            );
            self.push(closure);
            return moved(&map.keyframe_poses(), &before);
        }
        Vec::new()
    }

    /// Older keyframes at least as similar to this one as its least similar neighbour is, for several
    /// keyframes in a row; most similar first.
    fn candidates(
        &mut self,
        context: &Context,
        map: &Map,
        places: &PlaceIndex,
        id: KeyframeId,
    ) -> Vec<KeyframeId> {
        let config = &context.config.loops;
        let recently = self.closed.last();
        if recently.is_some_and(|l| id.0 - l.keyframe.0 < config.min_gap) {
            return Vec::new();
        }
        let descriptors = static_descriptors(map.keyframe(id));
        let near = neighbours(map, id, config.neighbour_landmarks);
        let scores = near.iter().filter_map(|k| places.score(*k, &descriptors));
        let least = scores.fold(f64::INFINITY, f64::min);
        let is_near = |k: KeyframeId| near.contains(&k) || k.0 + config.min_gap > id.0;
        let found: Vec<_> = places
            .query(&descriptors, config.candidates, is_near)
            .into_iter()
            .filter(|c| least.is_infinite() || c.score >= least)
            .collect();
        let found_places = found.iter().map(|candidate| {
            let mut place = neighbours(map, candidate.id, config.neighbour_landmarks);
            place.insert(candidate.id);
            place
        });
        let lengths = self.continue_streaks(found_places.collect());
        let long = lengths.iter().map(|l| *l >= config.in_a_row);
        let candidates = found.iter().zip(long).filter(|(_, long)| *long);
        candidates.map(|(c, _)| c.id).collect()
    }

    /// Continues the streaks with the places that a keyframe looks like, each a set of neighbours.
    /// Returns the length of each: 1 for a place that shares no keyframe with an earlier one.
    fn continue_streaks(&mut self, places: Vec<BTreeSet<KeyframeId>>) -> Vec<usize> {
        let before = std::mem::take(&mut self.streaks);
        for place in places {
            let same = before.iter().filter(|(b, _)| !b.is_disjoint(&place));
            let length = 1 + same.map(|(_, length)| *length).max().unwrap_or(0);
            self.streaks.push((place, length));
        }
        self.streaks.iter().map(|(_, length)| *length).collect()
    }
}

/// Whether the path can have drifted from the tracked pose of the keyframe to the one it was located
/// at: the camera and the point straight ahead of it must be off by no more than a share of the path
/// length.
fn is_plausible(
    context: &Context,
    map: &Map,
    id: KeyframeId,
    older: KeyframeId,
    seen: &Frame,
) -> bool {
    let keyframes = &map.keyframes()[older.index()..=id.index()];
    let steps = keyframes.windows(2);
    let length_m = steps
        .map(|pair| (pair[1].center() - pair[0].center()).norm())
        .fold(0.0, |sum, step| sum + step);
    let config = &context.config.loops;
    let limit_m = config.max_drift_floor_m + config.max_drift * length_m;
    let tracked = map.keyframe(id).camera_from_world.inverse();
    let located = seen.camera_from_world.inverse();
    let ahead = Vector3::new(0.0, 0.0, TYPICAL_DEPTH_M);
    [Vector3::zeros(), ahead]
        .iter()
        .all(|p| (tracked * *p - located * *p).norm() <= limit_m)
}

/// The keyframes' poses, of which the loop moves all but the first, and what is known of their motions:
///
/// | between | relative pose | weight |
/// |---|---|---|
/// | consecutive keyframes, and any that share many landmarks | as now | landmarks shared |
/// | the two ends of loops closed before | as now | inliers of then |
/// | the two ends of this loop | as located | inliers |
///
/// n landmarks seen at depth d constrain a relative pose with Ω ∝ n diag(1, 1, 1, d², d², d²).
fn path_graph(map: &Map, closed: &[LoopClosure], closure: &LoopClosure, located: Se3) -> PoseGraph {
    let mut graph = PoseGraph::default();
    for (k, pose) in (0u32..).map(KeyframeId).zip(map.keyframe_poses()) {
        // Culled keyframes are in no edge, and follow afterwards.
        graph.add_pose(pose, k.0 == 0 || map.is_culled(k));
    }
    let poses = map.keyframe_poses();
    let relative = |a: Se3, b: KeyframeId| a * poses[b.index()].inverse();
    let kept: Vec<_> = map.kept_ids().collect();
    for (i, &b) in kept.iter().enumerate() {
        let next = kept.get(i + 1).copied();
        let shared = map.covisible(b);
        let mut pairs: Vec<_> = shared.into_iter().filter(|(a, _)| *a > b).collect();
        if let Some(next) = next.filter(|next| pairs.iter().all(|(a, _)| a != next)) {
            pairs.push((next, 1));
        }
        pairs.retain(|(a, n)| Some(*a) == next || *n >= EDGE_LANDMARKS);
        let as_now = |(a, n): &(KeyframeId, usize)| edge(*a, b, relative(poses[a.index()], b), *n);
        graph.edges.extend(pairs.iter().map(as_now));
    }
    for l in closed {
        let as_now = relative(poses[l.keyframe.index()], l.older);
        graph
            .edges
            .push(edge(l.keyframe, l.older, as_now, l.inliers));
    }
    let (a, b) = (closure.keyframe, closure.older);
    graph
        .edges
        .push(edge(a, b, relative(located, b), closure.inliers));
    graph
}

/// Spreads the error of the loop over all keyframes ([`path_graph`]), and moves every landmark with the
/// keyframe that made it. `false`, and nothing has moved, if the graph has no solution.
fn correct_path(
    context: &Context,
    map: &mut Map,
    closed: &[LoopClosure],
    closure: &LoopClosure,
    located: Se3,
) -> bool {
    let mut graph = path_graph(map, closed, closure, located);
    let before = map.keyframe_poses();
    let config = PoseGraphConfig {
        linear_solver: context.config.loops.linear_solver,
        ..PoseGraphConfig::default()
    };
    match graph.optimise(&config) {
        Ok(_) if graph.poses.iter().all(Se3::is_finite) => {}
        _ => return false,
    }
    for k in map.kept_ids().collect::<Vec<_>>() {
        map.keyframe_mut(k).camera_from_world = graph.poses[k.index()];
    }
    map.follow_anchors();
    let after_from_before = moved(&map.keyframe_poses(), &before);
    for id in map.landmark_ids() {
        let landmark = map.landmark_mut(id).expect("listed");
        landmark.p_world = after_from_before[landmark.born.index()] * landmark.p_world;
    }
    map.refresh_all(&context.scales);
    true
}

/// Fuses the landmarks of the older place with those of the keyframe and its neighbours.
fn join_landmarks(context: &Context, map: &mut Map, closure: &LoopClosure, seen: &Frame) {
    let id = closure.keyframe;
    for (i, old) in seen.landmark.iter().enumerate() {
        let Some(old) = *old else { continue };
        if map.landmark(old).is_none_or(|l| l.is_observed_by(id)) {
            continue;
        }
        match map.keyframe(id).landmark[i] {
            Some(new) => map.fuse(old, new, &context.scales),
            None => map.add_observation(old, id, i),
        }
    }
    let old = landmarks_around(map, closure.older);
    let near = by_count(&map.covisible(id));
    for k in [id]
        .into_iter()
        .chain(near.into_iter().take(JOIN_NEIGHBOURS))
    {
        fuse_into(context, map, &old, k);
    }
    map.refresh_all(&context.scales);
}

/// Bundle adjustment of all keyframes but the first and all static landmarks.
fn global_ba(context: &Context, map: &mut Map, recorder: &mut Recorder) {
    let config = &context.config.loops;
    if config.bundle_iterations == 0 {
        return;
    }
    let bundle = BundleConfig {
        iterations: config.bundle_iterations,
        linear_solver: config.linear_solver,
        ..BundleConfig::default()
    };
    let free: Vec<_> = map.kept_ids().filter(|k| k.0 != 0).collect();
    let mut landmarks: Vec<LandmarkId> = map.landmark_ids();
    landmarks.retain(|l| map.static_landmark(*l).is_some());
    let fixed = [KeyframeId(0)];
    adjust(context, map, &free, &fixed, &landmarks, &bundle, recorder);
}

/// after_from_before, in the world, of every keyframe.
fn moved(after: &[Se3], before: &[Se3]) -> Vec<Se3> {
    let pairs = after.iter().zip(before);
    pairs.map(|(a, b)| a.inverse() * *b).collect()
}

/// Keyframes that share so many landmarks with one.
fn neighbours(map: &Map, id: KeyframeId, landmarks: usize) -> BTreeSet<KeyframeId> {
    let shared = map.covisible(id).into_iter();
    shared
        .filter(|(_, n)| *n >= landmarks)
        .map(|(k, _)| k)
        .collect()
}

fn edge(a: KeyframeId, b: KeyframeId, a_from_b: Se3, landmarks: usize) -> PoseEdge {
    let (n, d2) = (landmarks.max(1) as f64, TYPICAL_DEPTH_M * TYPICAL_DEPTH_M);
    PoseEdge {
        a: a.index(),
        b: b.index(),
        a_from_b,
        information: Matrix6::from_diagonal(&Vector6::new(n, n, n, n * d2, n * d2, n * d2)),
    }
}

#[cfg(test)]
mod tests;
