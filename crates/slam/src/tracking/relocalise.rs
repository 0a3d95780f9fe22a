//! Relocalisation: the pose of a lost camera, from the keyframes that look most like its frame.
//!
//! ```text
//! descriptors ─→ place index ─→ candidates ─→ matches ─→ rigid motion, or PnP ─→ pose (eq. 11)
//!                                                                                 │
//!                         enough inliers? ←─ pose (eq. 11) ←─ landmarks around the candidate
//! ```
//!
//! Matches are pairs of a landmark in the world and a keypoint in the camera. Where keypoints have
//! depth, three pairs give a rigid motion in closed form; a seeded RANSAC keeps the motion with the
//! most inliers. Without enough depth the same is done with directions alone ([`solve_pnp_ransac`]).

use garad_core::{KeyframeId, LandmarkId, Rng, Se3};
use garad_features::{Descriptor, PlaceIndex};
use garad_optim::{PnpConfig, solve_pnp_ransac};

use super::matching;
use super::observation::link_observation;
use super::pose::{pose_config, pose_from_links};
use super::rigid::rigid_from_pairs;
use crate::context::Context;
use crate::frame::Frame;
use crate::map::{Map, by_count};
use crate::trace::Recorder;

/// Keyframes tried for each frame, so that a large map costs no more than a small one.
const CANDIDATES: usize = 10;
/// Neighbours of a candidate whose landmarks are searched for, too.
const NEIGHBOURS: usize = 10;

/// Draws of three pairs: with half the pairs wrong, 100 draws miss all good triples once in 6e5.
const DRAWS: usize = 100;
/// Pairs within this distance are inliers of a motion, as a share of the depth plus a floor, metres.
const INLIER_RATIO: f64 = 0.03;
const INLIER_FLOOR_M: f64 = 0.02;

/// Descriptors of a frame's static keypoints: those a place is recognised by.
pub(crate) fn static_descriptors(frame: &Frame) -> Vec<Descriptor> {
    let descriptors = frame.descriptors.iter().zip(&frame.in_use);
    descriptors
        .filter(|(_, in_use)| **in_use)
        .map(|(d, _)| *d)
        .collect()
}

/// Searches for the frame among the keyframes; true when enough landmarks of one agree with a pose.
///
/// The first candidate with enough inliers for tracking is taken, else the one with most inliers;
/// tracking the local map decides.
pub(crate) fn relocalise(
    context: &Context,
    map: &Map,
    places: &PlaceIndex,
    frame: &mut Frame,
    recorder: &mut Recorder,
) -> bool {
    let config = &context.config.tracking;
    let candidates = places.query(&static_descriptors(frame), CANDIDATES, |_| false);
    let mut best: Option<(usize, Frame)> = None;
    for candidate in candidates {
        let mut tried = frame.clone();
        let inliers = locate(context, map, &mut tried, candidate.id, recorder);
        if inliers >= config.reference_min_matches
            && best.as_ref().is_none_or(|(most, _)| inliers > *most)
        {
            best = Some((inliers, tried));
        }
        if inliers >= config.min_inliers_after_recovery {
            break;
        }
    }
    match best {
        Some((_, found)) => {
            *frame = found;
            true
        }
        None => {
            frame.landmark.fill(None);
            false
        }
    }
}

/// A frame's pose from nothing but the landmarks of a keyframe and its neighbours, with the links
/// behind it. Returns the number of inliers; 0 if it is not there.
pub(crate) fn locate(
    context: &Context,
    map: &Map,
    frame: &mut Frame,
    candidate: KeyframeId,
    recorder: &mut Recorder,
) -> usize {
    let needed = context.config.tracking.reference_min_matches;
    frame.landmark.fill(None);
    let keyframe = map.keyframe(candidate);
    if matching::from_keyframe(context, map, keyframe, frame) < needed {
        return 0;
    }
    let rigid = rigid_ransac(context, map, frame, needed);
    let Some(pose) = rigid.or_else(|| pnp(context, map, frame, candidate, needed)) else {
        return 0;
    };
    frame.camera_from_world = pose;
    if pose_from_links(context, map, frame, recorder) < needed {
        return 0;
    }
    let linked: Vec<_> = frame.landmark.iter().flatten().copied().collect();
    let visible: Vec<_> = landmarks_around(map, candidate)
        .into_iter()
        .filter(|id| !linked.contains(id))
        .filter_map(|id| {
            let landmark = map.static_landmark(id)?;
            Some((
                id,
                landmark.appearance(frame, &context.camera, &context.scales)?,
            ))
        })
        .collect();
    matching::from_local_map(context, map, &visible, frame);
    pose_from_links(context, map, frame, recorder)
}

/// The landmarks that a keyframe and its nearest neighbours observe, by id.
pub(crate) fn landmarks_around(map: &Map, keyframe: KeyframeId) -> Vec<LandmarkId> {
    let neighbours = by_count(&map.covisible(keyframe));
    map.observed_by(neighbours.into_iter().take(NEIGHBOURS).chain([keyframe]))
}

/// camera_from_world from all linked keypoints, with or without depth.
fn pnp(
    context: &Context,
    map: &Map,
    frame: &Frame,
    candidate: KeyframeId,
    needed: usize,
) -> Option<Se3> {
    let observations: Vec<_> = (0..frame.len())
        .filter_map(|i| {
            let landmark = map.static_landmark(frame.landmark[i]?)?;
            Some(link_observation(context, frame, i, landmark))
        })
        .collect();
    let key = [u64::from(frame.id.0), u64::from(candidate.0)];
    let config = PnpConfig {
        min_inliers: needed,
        seed: Rng::keyed(context.rng_seed, &key).next_u64(),
        pose: pose_config(context),
        ..PnpConfig::default()
    };
    let found = solve_pnp_ransac(&context.camera, &observations, &config, context.par)
        .expect("the observations of a frame are finite");
    Some(found?.camera_from_world)
}

/// camera_from_world with the most inliers among the linked keypoints with depth, if there are at
/// least `needed`.
fn rigid_ransac(context: &Context, map: &Map, frame: &Frame, needed: usize) -> Option<Se3> {
    let pairs: Vec<_> = (0..frame.len())
        .filter_map(|i| {
            let p_world = map.landmark(frame.landmark[i]?)?.p_world;
            let p_cam = context.camera.unproject(&frame.uv_px[i], frame.depth_m[i]?);
            Some((p_cam, p_world))
        })
        .collect();
    if pairs.len() < needed {
        return None;
    }
    let inliers_of = |pose: &Se3| -> Vec<_> {
        pairs
            .iter()
            .filter(|(p_cam, p_world)| {
                (*pose * *p_world - p_cam).norm() < INLIER_FLOOR_M + INLIER_RATIO * p_cam.z
            })
            .copied()
            .collect()
    };
    let mut rng = Rng::keyed(context.rng_seed, &[u64::from(frame.id.0)]);
    let mut best: Vec<_> = Vec::new();
    for _ in 0..DRAWS {
        let draw = [0; 3].map(|_| pairs[rng.below(pairs.len())]);
        let Some(pose) = rigid_from_pairs(&draw) else {
            continue;
        };
        let inliers = inliers_of(&pose);
        if inliers.len() > best.len() {
            best = inliers;
        }
    }
    if best.len() < needed {
        return None;
    }
    rigid_from_pairs(&best)
}
