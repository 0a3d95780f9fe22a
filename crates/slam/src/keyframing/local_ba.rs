//! Bundle adjustment: the newest keyframes and the static landmarks they observe, optimised together.

use std::collections::BTreeMap;

use garad_core::{KeyframeId, LandmarkId};
use garad_optim::{BundleConfig, BundleObservation, optimise_bundle};

use super::two_view::update_covariance;
use crate::config::LocalBaConfig;
use crate::context::Context;
use crate::map::{Map, by_count};
use crate::trace::Recorder;
use crate::tracking::observation::observation;

/// What a local bundle adjustment is about.
#[derive(Debug, PartialEq)]
struct Window {
    /// Keyframes whose poses are found, the newest first.
    free: Vec<KeyframeId>,
    /// Keyframes that hold the gauge.
    fixed: Vec<KeyframeId>,
    landmarks: Vec<LandmarkId>,
}

impl Window {
    /// A keyframe, its most covisible neighbours, but never the first keyframe, and every static landmark
    /// they observe; fixed are the other keyframes that observe most of these landmarks.
    fn new(map: &Map, newest: KeyframeId, config: &LocalBaConfig) -> Self {
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
        Self {
            free,
            fixed,
            landmarks,
        }
    }
}

/// Optimises a keyframe, its most covisible neighbours and every landmark they observe ([`Window`]).
pub(crate) fn local_ba(
    context: &Context,
    map: &mut Map,
    newest: KeyframeId,
    recorder: &mut Recorder,
) {
    let config = &context.config.local_ba;
    let Window {
        free,
        fixed,
        landmarks,
    } = Window::new(map, newest, config);
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
    use crate::config::Config;
    use crate::testing::{World, apart, turned};

    /// Keyframe 6 shares 3 landmarks with 0, 2 with 4 and with 3, 1 with 2 and with 1.
    const OBSERVERS: [&[u32]; 9] = [
        &[0, 3, 4, 6],
        &[0, 4, 6],
        &[0, 2, 3, 6],
        &[1, 6], // dynamic
        &[1, 2, 3],
        &[1, 5],
        &[2, 4],
        &[1, 4, 5],
        &[3, 5],
    ];

    #[test]
    fn the_newest_and_its_neighbours_are_free_and_other_observers_hold_them() {
        let mut world = World::observing(Config::default(), 7, &OBSERVERS);
        world.set_dynamic(3);
        for (max_free, max_fixed, free, fixed, landmarks) in [
            (1, 9, &[6][..], &[0, 4, 3, 2][..], &[0, 1, 2][..]),
            (2, 9, &[6], &[0, 4, 3, 2], &[0, 1, 2]), // the first keyframe takes a place and is fixed
            (3, 9, &[6, 4], &[0, 3, 2, 5, 1], &[0, 1, 2, 6, 7]),
            (3, 4, &[6, 4], &[0, 3, 2, 5], &[0, 1, 2, 6, 7]),
            (4, 2, &[6, 4, 3], &[2, 0], &[0, 1, 2, 4, 6, 7, 8]),
            (4, 9, &[6, 4, 3], &[2, 0, 5, 1], &[0, 1, 2, 4, 6, 7, 8]),
            (0, 1, &[6], &[0], &[0, 1, 2]),
        ] {
            let config = LocalBaConfig {
                max_free,
                max_fixed,
                ..LocalBaConfig::default()
            };
            let expected = Window {
                free: free.iter().map(|k| KeyframeId(*k)).collect(),
                fixed: fixed.iter().map(|k| KeyframeId(*k)).collect(),
                landmarks: landmarks.iter().map(|l| LandmarkId(*l)).collect(),
            };
            let window = Window::new(&world.map, KeyframeId(6), &config);
            assert_eq!(window, expected, "{max_free} free, {max_fixed} fixed");
        }
    }

    /// Three keyframes, each observing 40 points, and one culled, tied to the newest, which is 2 cm off.
    fn displaced() -> World {
        let mut config = Config::default();
        config.local_ba.max_free = 1;
        let all = vec![&[0, 1, 2, 3][..]; 40];
        let mut world = World::observing(config, 4, &all);
        let World { context, map, .. } = &mut world;
        for k in [1, 2, 3] {
            for i in 0..40 {
                let frame = map.keyframe(KeyframeId(k));
                let p_cam =
                    frame.camera_from_world * map.landmark(LandmarkId(i)).expect("made").p_world;
                let frame = map.keyframe_mut(KeyframeId(k));
                frame.uv_px[i as usize] = context.camera.project(&p_cam).expect("in front");
                frame.depth_m[i as usize] = Some(p_cam.z);
            }
        }
        // Tied to the youngest of those that share as much.
        assert!(map.cull(KeyframeId(1), &context.scales));
        let newest = map.keyframe_mut(KeyframeId(3));
        newest.camera_from_world.translation.x += 0.02;
        map.follow_anchors();
        world
    }

    #[test]
    fn free_keyframes_and_landmarks_move_and_culled_ones_follow() {
        let mut world = displaced();
        let World { context, map, .. } = &mut world;
        local_ba(context, map, KeyframeId(3), &mut Recorder::default());
        let poses = map.keyframe_poses();
        for k in [0, 2] {
            assert_eq!(poses[k as usize], turned(k), "keyframe {k} is fixed");
        }
        for k in [1, 3] {
            let off = apart(&poses[k as usize], &turned(k));
            assert!(off < 1e-4, "keyframe {k} is {off} m off");
        }
        let before = map.landmark(LandmarkId(7)).expect("kept").p_world;
        let mut again = displaced();
        let World { context, map, .. } = &mut again;
        context.config.local_ba.iterations = 0;
        local_ba(context, map, KeyframeId(3), &mut Recorder::default());
        let newest = map.keyframe_poses()[3];
        assert!(apart(&newest, &turned(3)) > 0.019, "no iteration, no step");
        let unmoved = map.landmark(LandmarkId(7)).expect("kept").p_world;
        assert!(before != unmoved, "landmarks are adjusted, too");
    }

    #[test]
    fn without_anything_free_or_fixed_nothing_moves() {
        let (first, newest) = ([KeyframeId(0)], [KeyframeId(3)]);
        let made = [LandmarkId(0)];
        for (free, fixed, landmarks) in [
            (&[][..], &first[..], &made[..]),
            (&newest, &[], &made),
            (&newest, &first, &[]),
        ] {
            let mut world = displaced();
            let World { context, map, .. } = &mut world;
            let before = map.keyframe_poses();
            let bundle = BundleConfig::default();
            let recorder = &mut Recorder::default();
            adjust(context, map, free, fixed, landmarks, &bundle, recorder);
            assert_eq!(map.keyframe_poses(), before);
        }
    }

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
