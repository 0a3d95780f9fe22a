//! Bundle adjustment: the newest keyframes and the static landmarks they observe, optimised together.

use std::collections::BTreeMap;

use garad_core::{KeyframeId, LandmarkId};
use garad_optim::{BundleConfig, BundleObservation, optimise_bundle};

use super::two_view::update_covariance;
use crate::context::Context;
use crate::map::{Map, by_count};
use crate::trace::Recorder;
use crate::tracking::observation::observation;

/// Optimises a keyframe, its most covisible neighbours and every landmark they observe. Other
/// keyframes that observe those landmarks hold the gauge; the first keyframe never moves.
pub(crate) fn local_ba(
    context: &Context,
    map: &mut Map,
    newest: KeyframeId,
    recorder: &mut Recorder,
) {
    let config = &context.config.local_ba;
    let mut free: Vec<KeyframeId> = vec![newest];
    let neighbours = by_count(&map.covisible(newest));
    free.extend(
        neighbours
            .into_iter()
            .take(config.max_free.saturating_sub(1)),
    );
    free.retain(|k| k.0 != 0);
    let mut landmarks = map.observed_by(free.iter().copied());
    landmarks.retain(|l| map.static_landmark(*l).is_some());
    let mut others = map.observers(landmarks.iter().copied());
    for k in &free {
        others.remove(k);
    }
    let mut fixed = by_count(&others);
    fixed.truncate(config.max_fixed);
    let bundle = BundleConfig {
        iterations: config.iterations,
        ..BundleConfig::default()
    };
    adjust(context, map, &free, &fixed, &landmarks, &bundle, recorder);
}

/// Optimises free keyframes and landmarks over all observations by these and the fixed ones.
/// Observations that are outliers afterwards are removed. Nothing happens unless there is one of each.
pub(crate) fn adjust(
    context: &Context,
    map: &mut Map,
    free: &[KeyframeId],
    fixed: &[KeyframeId],
    landmarks: &[LandmarkId],
    bundle: &BundleConfig,
    recorder: &mut Recorder,
) {
    if free.is_empty() || fixed.is_empty() || landmarks.is_empty() {
        return;
    }
    let config = &context.config.tracking;
    let keyframes: Vec<KeyframeId> = free.iter().chain(fixed).copied().collect();
    let pose_of: BTreeMap<KeyframeId, usize> =
        keyframes.iter().enumerate().map(|(i, k)| (*k, i)).collect();
    let mut poses: Vec<_> = keyframes
        .iter()
        .map(|k| map.keyframe(*k).camera_from_world)
        .collect();
    let is_fixed: Vec<_> = (0..keyframes.len()).map(|i| i >= free.len()).collect();
    let mut points = Vec::new();
    let mut observations = Vec::new();
    let mut sources = Vec::new();
    for id in landmarks {
        let landmark = map
            .landmark(*id)
            .expect("adjusted landmarks are in the map");
        for (keyframe, i) in &landmark.observations {
            let Some(&pose) = pose_of.get(keyframe) else {
                continue;
            };
            let seen = observation(config, map.keyframe(*keyframe), *i, landmark.p_world);
            observations.push(BundleObservation {
                pose,
                point: points.len(),
                uv_px: seen.uv_px,
                sigma_px: seen.sigma_px,
                depth: seen.depth,
            });
            sources.push((*id, *keyframe));
        }
        points.push(landmark.p_world);
    }
    let before = (recorder.is_recording()).then(|| (poses.clone(), points.clone()));
    let report = optimise_bundle(
        &context.camera,
        config.bf,
        &mut poses,
        &is_fixed,
        &mut points,
        &observations,
        bundle,
    )
    .expect("poses, landmarks and observations of the map are finite");
    if let Some((poses_before, points_before)) = before {
        recorder.record("bundle", |record| {
            record.bundle_in(&poses_before, &is_fixed, &points_before, &observations);
            record.bundle_out(&poses, &points, &report);
        });
    }
    for (keyframe, pose) in free.iter().zip(&poses) {
        map.keyframe_mut(*keyframe).camera_from_world = *pose;
    }
    map.follow_anchors();
    for (id, p_world) in landmarks.iter().zip(&points) {
        map.landmark_mut(*id).expect("as above").p_world = *p_world;
    }
    for ((id, keyframe), inlier) in sources.into_iter().zip(report.inlier) {
        if !inlier {
            map.drop_observation(id, keyframe);
        }
    }
    for id in landmarks {
        map.refresh(*id, &context.scales);
        update_covariance(context, map, *id);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::World;

    /// The last of three keyframes sees one of 300 points 30 px off.
    #[test]
    fn outlier_observations_are_removed() {
        let (mut world, made) = World::three_views();
        let newest = KeyframeId(2);
        world.map.keyframe_mut(newest).uv_px[7].y += 30.0;
        let World { context, map, .. } = &mut world;
        local_ba(context, map, newest, &mut Recorder::default());
        for (i, id) in made.iter().enumerate() {
            let landmark = world.map.landmark(*id).expect("seen by two at least");
            let by: Vec<_> = landmark.observations.iter().map(|(k, _)| k.0).collect();
            let expected: &[u32] = if i == 7 { &[0, 1] } else { &[0, 1, 2] };
            assert_eq!(by, expected, "landmark {i}");
            let linked = world.map.keyframe(newest).landmark[i];
            assert_eq!(linked, (i != 7).then_some(*id), "keypoint {i}");
        }
    }
}
