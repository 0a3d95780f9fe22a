//! What a new keyframe does to the landmarks: it observes, makes, drops and fuses them.

use garad_core::chi_square::{CHI2_2DOF_95, CHI2_3DOF_95};
use garad_core::{KeyframeId, Label, LandmarkId};

use super::two_view::two_view_landmarks;
use crate::config::TaggedLabels;
use crate::context::Context;
use crate::frame::Frame;
use crate::map::landmark::LandmarkDepth;
use crate::map::{Map, by_count};
use crate::mapping::job::NewLandmark;

/// Adds a keyframe: its links become observations, its depth becomes landmarks, duplicates in
/// neighbouring keyframes are fused, and unconfirmed landmarks among the `recent` ones are dropped.
pub(crate) fn add_keyframe(
    context: &Context,
    map: &mut Map,
    recent: &mut Vec<LandmarkId>,
    frame: Frame,
) -> KeyframeId {
    let id = map.add_keyframe(frame);
    let linked = map.keyframe(id).landmark.iter().flatten();
    for landmark in linked.copied().collect::<Vec<_>>() {
        map.refresh(landmark, &context.scales);
    }
    drop_weak_landmarks(context, map, recent, id);
    recent.extend(new_landmarks(context, map, id));
    if context.config.two_view.enabled {
        recent.extend(two_view_landmarks(context, map, id));
    }
    fuse_with_neighbours(context, map, id);
    id
}

/// Landmarks from the depth of keypoints that have none: all that are close, and at least those of
/// the `min_new_landmarks` nearest keypoints.
fn new_landmarks(context: &Context, map: &mut Map, id: KeyframeId) -> Vec<LandmarkId> {
    let config = &context.config.keyframes;
    let keyframe = map.keyframe(id);
    let mut by_depth: Vec<(f64, usize)> = (0..keyframe.len())
        .filter(|&i| keyframe.in_use[i])
        .filter_map(|i| Some((keyframe.depth_m[i]?, i)))
        .collect();
    by_depth.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let wanted: Vec<_> = by_depth
        .iter()
        .enumerate()
        .take_while(|(rank, (depth, _))| {
            *depth < config.close_m || *rank < config.min_new_landmarks
        })
        .filter(|(_, (_, i))| keyframe.landmark[*i].is_none())
        .filter_map(|(_, (_, i))| Some((*i, keyframe.world_point(*i, &context.camera)?)))
        .collect();
    wanted
        .into_iter()
        .map(|(i, p_world)| map.add_landmark(p_world, id, i, &context.scales))
        .collect()
}

/// Drops recent landmarks that are rarely found where they should be, or that no second
/// keyframe observes two keyframes after their creation. Those three keyframes old are no longer
/// recent.
fn drop_weak_landmarks(
    context: &Context,
    map: &mut Map,
    recent: &mut Vec<LandmarkId>,
    now: KeyframeId,
) {
    let config = &context.config.keyframes;
    recent.retain(|id| {
        let Some(landmark) = map.landmark(*id) else {
            return false;
        };
        let age = now.0 - landmark.born.0;
        let rarely_found =
            f64::from(landmark.found) < config.found_ratio * f64::from(landmark.visible);
        let unconfirmed = age >= 2 && landmark.observations.len() < config.min_observations;
        if rarely_found || unconfirmed {
            map.drop_landmark(*id);
            return false;
        }
        age < 3
    });
}

/// What the mapper needs to know of the landmarks that a keyframe is the first to observe with depth. Where a Gaussian always has its
/// landmark's label ([`TaggedLabels::Landmark`]), one that is dynamic already gets no Gaussian.
pub(crate) fn landmarks_first_measured_in(
    map: &Map,
    id: KeyframeId,
    tagged: TaggedLabels,
) -> Vec<NewLandmark> {
    let keyframe = map.keyframe(id);
    let linked = (0..keyframe.len()).filter_map(|i| Some((i, keyframe.landmark[i]?)));
    linked
        .filter_map(|(i, landmark)| {
            let first_depth = LandmarkDepth::Measured { since: id };
            let found = map.landmark(landmark).filter(|l| l.depth == first_depth)?;
            let inserted = tagged == TaggedLabels::Evidence || found.label() == Label::Static;
            inserted.then(|| NewLandmark {
                id: landmark,
                p_world: found.p_world,
                px: [pixel(keyframe.px[i].x), pixel(keyframe.px[i].y)],
            })
        })
        .collect()
}

/// Index of the pixel that a position lies in.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "float to integer saturates; keypoints lie inside the image"
)]
fn pixel(c: f64) -> usize {
    (c + 0.5) as usize
}

/// Neighbours searched for duplicates of a keyframe's landmarks.
const FUSE_NEIGHBOURS: usize = 10;
/// Search radius, px at level 0.
const FUSE_RADIUS_PX: f64 = 3.0;
/// Hamming distance of duplicates.
const FUSE_DISTANCE: u32 = 50;

/// Projects the landmarks of a keyframe into its neighbours and theirs into it. Where the keypoint
/// found there has another landmark the two become one; where it has none it becomes an
/// observation.
fn fuse_with_neighbours(context: &Context, map: &mut Map, id: KeyframeId) {
    let mut neighbours = by_count(&map.covisible(id));
    neighbours.truncate(FUSE_NEIGHBOURS);
    let own = map.keyframe(id).landmark.iter().flatten();
    let own: Vec<_> = own.copied().collect();
    for neighbour in &neighbours {
        fuse_into(context, map, &own, *neighbour);
    }
    let theirs = map.observed_by(neighbours);
    fuse_into(context, map, &theirs, id);
}

/// Fuses landmarks with those a keyframe observes at their projections, or links them there.
pub(crate) fn fuse_into(
    context: &Context,
    map: &mut Map,
    landmarks: &[LandmarkId],
    keyframe: KeyframeId,
) {
    let (scales, bf) = (&context.scales, context.config.tracking.bf);
    for id in landmarks {
        let frame = map.keyframe(keyframe);
        let Some(landmark) = map.landmark(*id) else {
            continue;
        };
        if landmark.is_observed_by(keyframe) {
            continue;
        }
        let Some(seen) = landmark.appearance(frame, &context.camera, scales) else {
            continue;
        };
        let level = i32::try_from(seen.level).unwrap_or(i32::MAX);
        let radius = FUSE_RADIUS_PX * scales[seen.level];
        let best = frame
            .near(&seen.uv_px, radius, level - 1, level)
            .filter(|&k| {
                let sigma = scales[usize::from(frame.keypoints[k].level)];
                let error = (frame.uv_px[k] - seen.uv_px).norm_squared();
                match frame.depth_m[k] {
                    Some(depth) => {
                        let disparity = bf / depth - bf / seen.depth_m;
                        error + disparity * disparity <= CHI2_3DOF_95 * sigma * sigma
                    }
                    None => error <= CHI2_2DOF_95 * sigma * sigma,
                }
            })
            .map(|k| (frame.descriptors[k].distance(&landmark.descriptor), k))
            .min();
        let Some((distance, k)) = best else { continue };
        if distance > FUSE_DISTANCE {
            continue;
        }
        match frame.landmark[k] {
            Some(other) => {
                let count = |l: LandmarkId| map.landmark(l).map_or(0, |l| l.observations.len());
                if count(other) > count(*id) {
                    map.fuse(other, *id, scales);
                } else {
                    map.fuse(*id, other, scales);
                }
            }
            None => map.add_observation(*id, keyframe, k),
        }
    }
}

#[cfg(test)]
mod tests;
