//! Matching: landmarks found in a frame, by predicted position or by descriptor alone.
//!
//! Every search visits its candidates in a fixed order (keypoints by cell and index, landmarks by
//! id), and a keypoint that is linked stays linked, so the same input gives the same matches.

use garad_core::LandmarkId;
use garad_features::matching::{RotationBins, consistent_rotation, match_descriptors};
use garad_features::{Match, MatchConfig};
use nalgebra::Vector2;

use crate::context::Context;
use crate::frame::Frame;
use crate::map::Map;
use crate::map::landmark::Appearance;

/// Best and second best candidate of one search.
#[derive(Debug, Clone, Copy)]
struct Best {
    keypoint: usize,
    distance: u32,
    second: Option<(u32, u8)>,
}

/// Links keypoints to the landmarks of `last`, searched near their projections into the predicted
/// pose of `frame`. Returns how many.
///
/// The radius grows with the level of the keypoint in `last`. When the camera moves forward, image
/// detail grows, so only the same or higher levels are searched; backward, the same or lower ones.
pub fn from_last_frame(
    context: &Context,
    map: &Map,
    last: &Frame,
    frame: &mut Frame,
    radius_px: f64,
) -> usize {
    let last_from_frame = last.camera_from_world * frame.camera_from_world.inverse();
    let forward_m = last_from_frame.translation.z;
    let baseline_m = context.config.tracking.bf / context.camera.fx;
    let top = i32::try_from(context.scales.len()).unwrap_or(i32::MAX) - 1;
    let mut pairs = Vec::new();
    for i in 0..last.len() {
        let Some((id, landmark)) =
            last.landmark[i].and_then(|id| Some((id, map.static_landmark(id)?)))
        else {
            continue;
        };
        let p_cam = frame.camera_from_world * landmark.p_world;
        let Some(uv_px) = context.camera.project(&p_cam) else {
            continue;
        };
        if !context.camera.contains(&uv_px) {
            continue;
        }
        let level = i32::from(last.keypoints[i].level);
        let (low, high) = if forward_m > baseline_m {
            (level, top)
        } else if forward_m < -baseline_m {
            (0, level)
        } else {
            (level - 1, level + 1)
        };
        let radius = radius_px * context.scales[usize::from(last.keypoints[i].level)];
        let best = best_candidate(context, frame, &uv_px, p_cam.z, radius, (low, high), |k| {
            frame.descriptors[k].distance(&landmark.descriptor)
        });
        if let Some(best) = best
            && best.distance <= context.config.tracking.match_distance
        {
            frame.landmark[best.keypoint] = Some(id);
            pairs.push(Match {
                query: i,
                train: best.keypoint,
                distance: best.distance,
            });
        }
    }
    keep_consistent_rotations(last, frame, &pairs)
}

/// Links keypoints to landmarks of the local map that are not linked yet. `visible` holds those
/// that should be seen, in order of their ids. Returns how many were found.
pub fn from_local_map(
    context: &Context,
    map: &Map,
    visible: &[(LandmarkId, Appearance)],
    frame: &mut Frame,
) -> usize {
    let mut found = 0;
    for (id, seen) in visible {
        let Some(landmark) = map.landmark(*id) else {
            continue;
        };
        let radius = context.scales[seen.level]
            * if seen.view_cosine > 0.998 {
                context.config.tracking.local_radius_px
            } else {
                context.config.tracking.local_radius_oblique_px
            };
        let level = i32::try_from(seen.level).unwrap_or(i32::MAX);
        let best = best_candidate(
            context,
            frame,
            &seen.uv_px,
            seen.depth_m,
            radius,
            (level - 1, level),
            |k| frame.descriptors[k].distance(&landmark.descriptor),
        );
        let Some(best) = best else { continue };
        let ambiguous = best.second.is_some_and(|(second, level)| {
            level == frame.keypoints[best.keypoint].level
                && f64::from(best.distance)
                    > context.config.tracking.local_ratio * f64::from(second)
        });
        if best.distance <= context.config.tracking.match_distance && !ambiguous {
            frame.landmark[best.keypoint] = Some(*id);
            found += 1;
        }
    }
    found
}

/// Links keypoints to the landmarks of a keyframe by descriptor alone: ratio, mutual and
/// rotation checks. Returns how many.
pub(crate) fn from_keyframe(
    context: &Context,
    map: &Map,
    keyframe: &Frame,
    frame: &mut Frame,
) -> usize {
    let known: Vec<_> = (0..keyframe.len())
        .filter(|&i| keyframe.landmark[i].is_some_and(|l| map.static_landmark(l).is_some()))
        .collect();
    let free: Vec<_> = (0..frame.len())
        .filter(|&i| frame.in_use[i] && frame.uv_px[i].x.is_finite())
        .collect();
    let config = MatchConfig {
        max_distance: context.config.tracking.match_distance_strict,
        ratio: Some(context.config.tracking.reference_ratio),
        mutual: true,
    };
    let descriptors =
        |of: &Frame, at: &[usize]| -> Vec<_> { at.iter().map(|&i| of.descriptors[i]).collect() };
    let mut pairs = match_descriptors(
        &descriptors(keyframe, &known),
        &descriptors(frame, &free),
        &config,
        context.par,
    );
    for pair in &mut pairs {
        pair.query = known[pair.query];
        pair.train = free[pair.train];
        frame.landmark[pair.train] = keyframe.landmark[pair.query];
    }
    keep_consistent_rotations(keyframe, frame, &pairs)
}

/// The free keypoint within a window whose descriptor is nearest, and the runner-up. One with
/// depth must also agree with the expected disparity within the radius.
fn best_candidate(
    context: &Context,
    frame: &Frame,
    uv_px: &Vector2<f64>,
    depth_m: f64,
    radius_px: f64,
    (low, high): (i32, i32),
    distance: impl Fn(usize) -> u32,
) -> Option<Best> {
    let expected_disparity = context.config.tracking.bf / depth_m;
    let mut best: Option<Best> = None;
    for k in frame.near(uv_px, radius_px, low, high) {
        if frame.landmark[k].is_some() {
            continue;
        }
        if let Some(depth) = frame.depth_m[k]
            && (context.config.tracking.bf / depth - expected_disparity).abs() > radius_px
        {
            continue;
        }
        let distance = distance(k);
        let level = frame.keypoints[k].level;
        best = match best {
            Some(b) if distance >= b.distance => Some(Best {
                second: match b.second {
                    Some((second, _)) if second <= distance => b.second,
                    _ => Some((distance, level)),
                },
                ..b
            }),
            _ => Some(Best {
                keypoint: k,
                distance,
                second: best.map(|b| (b.distance, frame.keypoints[b.keypoint].level)),
            }),
        };
    }
    best
}

/// Unlinks matches whose keypoints rotated differently from most, and counts the others.
fn keep_consistent_rotations(from: &Frame, to: &mut Frame, pairs: &[Match]) -> usize {
    let angles = |of: &Frame| -> Vec<_> { of.keypoints.iter().map(|k| k.angle_deg).collect() };
    let kept = consistent_rotation(pairs, &angles(from), &angles(to), RotationBins::FullCircle)
        .expect("the pairs index keypoints of these two frames");
    let links: Vec<_> = kept
        .iter()
        .map(|m| (m.train, to.landmark[m.train]))
        .collect();
    for pair in pairs {
        to.landmark[pair.train] = None;
    }
    for (k, landmark) in links {
        to.landmark[k] = landmark;
    }
    kept.len()
}

#[cfg(test)]
mod tests;
