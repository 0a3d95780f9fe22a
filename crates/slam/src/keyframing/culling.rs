//! Culling of redundant keyframes, so that the cost of a room does not grow with the time spent in it
//! (decision 010).
//!
//! A keyframe is redundant if nearly all of its near landmarks are observed by other keyframes as well as
//! by itself. It keeps its id, because the path, landmarks and Gaussians refer to it, and its pose, which
//! from then on is tied to the keyframe it shared most landmarks with. Everything else is freed:
//! features, observations, images, its entry in the place index.
//!
//! | never culled | why |
//! |---|---|
//! | the first keyframe | it defines the world |
//! | the youngest ones | their landmarks are still to be confirmed |
//! | the ends of closed loops | they constrain the path |
//!
//! Source: Mur-Artal, Montiel, Tardós 2015, section VI-E.

use std::collections::BTreeSet;

use garad_core::{KeyframeId, LandmarkId};

use super::loop_closing::LoopClosure;
use crate::config::CullingConfig;
use crate::context::Context;
use crate::map::{Map, by_count};
use crate::trace::Recorder;

/// An observation that many levels coarser than one's own still counts as equally good (ORB-SLAM):
/// corners jump between neighbouring levels.
const LEVEL_TOLERANCE: u8 = 1;

/// Culls the redundant ones among the keyframes that share landmarks with the newest, those that
/// share most first. Each is judged by what those before it have left. Returns them.
pub(crate) fn cull_keyframes(
    context: &Context,
    map: &mut Map,
    closed: &[LoopClosure],
    newest: KeyframeId,
    recorder: &mut Recorder,
) -> Vec<KeyframeId> {
    let config = &context.config.culling;
    let before = recorder.is_recording().then(|| observed(map));
    let ends: BTreeSet<_> = closed.iter().flat_map(|l| [l.keyframe, l.older]).collect();
    let close_m = context.config.keyframes.close_m;
    let mut culled = Vec::new();
    for id in by_count(&map.covisible(newest)) {
        let young = id.0.saturating_add(config.keep_youngest) > newest.0;
        if id.0 == 0 || young || ends.contains(&id) {
            continue;
        }
        if is_redundant(map, id, close_m, config) && map.cull(id, &context.scales) {
            culled.push(id);
        }
    }
    if let Some(before) = before {
        recorder.record("cull", |record| {
            record.cull(newest, ends.iter().copied(), &before, &culled);
        });
    }
    culled
}

/// One observation, as the trace has it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Observed {
    pub(crate) keyframe: KeyframeId,
    pub(crate) landmark: LandmarkId,
    pub(crate) level: u8,
    /// NaN without depth.
    pub(crate) depth_m: f64,
    pub(crate) is_static: bool,
}

/// All observations of the map, keyframe by keyframe.
fn observed(map: &Map) -> Vec<Observed> {
    let of_keyframe = |keyframe: KeyframeId| {
        let frame = map.keyframe(keyframe);
        let landmarks = frame.landmark.iter().enumerate();
        landmarks.filter_map(move |(i, landmark)| {
            let landmark = (*landmark)?;
            Some(Observed {
                keyframe,
                landmark,
                level: frame.keypoints[i].level,
                depth_m: frame.depth_m[i].unwrap_or(f64::NAN),
                is_static: map.static_landmark(landmark).is_some(),
            })
        })
    };
    map.kept_ids().flat_map(of_keyframe).collect()
}

/// Whether a keyframe observes at least one near static landmark, and nearly all of them are observed by
/// enough other keyframes at the same level or a finer one.
fn is_redundant(map: &Map, id: KeyframeId, close_m: f64, config: &CullingConfig) -> bool {
    let keyframe = map.keyframe(id);
    let (mut near, mut shared) = (0u32, 0u32);
    for (i, landmark) in keyframe.landmark.iter().enumerate() {
        let Some(landmark) = landmark.and_then(|l| map.static_landmark(l)) else {
            continue;
        };
        if keyframe.depth_m[i].is_none_or(|d| d >= close_m) {
            continue;
        }
        near += 1;
        let coarsest = keyframe.keypoints[i].level + LEVEL_TOLERANCE;
        let others = (landmark.observations.iter())
            .filter(|(k, j)| *k != id && map.keyframe(*k).keypoints[*j].level <= coarsest);
        shared += u32::from(others.count() >= config.observers);
    }
    near > 0 && f64::from(shared) >= config.redundant_share * f64::from(near)
}

#[cfg(test)]
mod tests {
    use garad_core::{Camera, DepthImage, LandmarkId, Se3};
    use nalgebra::{Vector3, Vector6};

    use super::*;
    use crate::config::Config;
    use crate::testing::{World, apart, keypoints, turned};

    const SIZE: (usize, usize) = (128, 96);
    const POINTS: u8 = 10;

    /// Keyframes at the poses of [`turned`]; the first makes ten landmarks 2 m ahead, and keyframe k observes
    /// those that `sees(k, i)` gives a level.
    fn world(keyframes: u32, sees: impl Fn(u32, u8) -> Option<u8>) -> World {
        let camera = Camera::pinhole(SIZE, [100.0, 100.0, 63.5, 47.5]).expect("valid camera");
        let mut world = World::with_camera(camera, Config::default());
        let depth = DepthImage::new(SIZE.0, SIZE.1, 2.0);
        for k in 0..keyframes {
            let mut points = keypoints((0..POINTS).map(|i| [20 + 8 * usize::from(i), 40]));
            for (i, point) in (0..POINTS).zip(&mut points) {
                point.level = sees(k, i).unwrap_or(0);
            }
            let mut frame = world.frame_of(k, &points, &depth);
            frame.camera_from_world = turned(k);
            let World { map, context, .. } = &mut world;
            let id = map.add_keyframe(frame);
            for i in 0..POINTS {
                let (point, landmark) = (usize::from(i), LandmarkId(u32::from(i)));
                if k == 0 {
                    let p_world = Vector3::new(0.1 * f64::from(i), 0.0, 2.0);
                    map.add_landmark(p_world, id, point, &context.scales);
                } else if sees(k, i).is_some() {
                    map.add_observation(landmark, id, point);
                }
            }
        }
        world
    }

    fn redundant(world: &World, id: u32) -> bool {
        let config = CullingConfig::default();
        is_redundant(&world.map, KeyframeId(id), 6.0, &config)
    }

    #[test]
    fn nine_of_ten_landmarks_seen_by_three_others() {
        assert!(redundant(&world(4, |_, _| Some(0)), 1), "all ten");
        assert!(
            !redundant(&world(3, |_, _| Some(0)), 1),
            "two others are too few"
        );
        // Keyframe 3 misses the last n points, which then have two others.
        let missing = |n: u8| world(4, move |k, i| (k != 3 || i < POINTS - n).then_some(0));
        assert!(redundant(&missing(1), 1), "nine of ten");
        assert!(!redundant(&missing(2), 1), "eight of ten");
    }

    #[test]
    fn coarser_looks_and_far_points_do_not_count() {
        let third = |level: u8| world(4, move |k, _| Some(if k == 3 { level } else { 0 }));
        assert!(redundant(&third(1), 1), "a level coarser");
        assert!(!redundant(&third(2), 1), "two levels coarser");
        let world = world(4, |_, _| Some(0));
        let config = CullingConfig::default();
        assert!(
            !is_redundant(&world.map, KeyframeId(1), 2.0, &config),
            "all are 2 m away: none is nearer"
        );
    }

    /// Every keyframe sees all ten, but for keyframe 3, which misses the last three, and one that is dynamic.
    #[test]
    fn how_many_must_be_seen_by_how_many_is_a_setting() {
        let mut world = world(5, |k, i| (k != 3 || i < POINTS - 3).then_some(0));
        for (dynamic, share, observers, expected) in [
            (None, 0.9, 3, true), // 10 of 10 are seen by three of the four others
            (None, 0.7, 4, true), // 7 of 10 by all four
            (None, 0.71, 4, false),
            (None, 0.1, 5, false),
            (Some(9), 0.77, 4, true), // 7 of 9
            (Some(9), 0.78, 4, false),
            (Some(0), 0.75, 4, true), // 6 of 8
            (Some(0), 0.76, 4, false),
        ] {
            if let Some(landmark) = dynamic {
                world.set_dynamic(landmark);
            }
            let config = CullingConfig {
                redundant_share: share,
                observers,
                ..CullingConfig::default()
            };
            let found = is_redundant(&world.map, KeyframeId(1), 6.0, &config);
            assert_eq!(
                found, expected,
                "{share} by {observers}, without {dynamic:?}"
            );
        }
    }

    /// Near is nearer than the limit, by the keyframe's own depth; one that sees nothing near stays.
    #[test]
    fn what_is_near_is_decided_by_the_keyframes_own_depth() {
        let mut world = world(4, |k, i| (k != 3 || i < POINTS / 2).then_some(0));
        let keyframe = world.map.keyframe_mut(KeyframeId(1));
        keyframe.depth_m[5..].fill(Some(3.5));
        keyframe.depth_m[6] = None;
        for (close_m, expected) in [
            (1.5, false),
            (2.0, false),
            (2.1, true),
            (3.5, true),
            (3.6, false),
        ] {
            let found = is_redundant(
                &world.map,
                KeyframeId(1),
                close_m,
                &CullingConfig::default(),
            );
            assert_eq!(found, expected, "near is {close_m} m");
        }
    }

    /// Of six with the same view all may go that still have three others. The first stays, and the newest.
    #[test]
    fn each_is_judged_by_what_those_before_it_have_left() {
        for (keep_youngest, close_m, expected) in [
            (1, 6.0, &[4, 3, 2][..]),
            (2, 6.0, &[3, 2, 1]),
            (3, 6.0, &[2, 1]),
            (1, 1.9, &[]),
        ] {
            let mut world = world(6, |_, _| Some(0));
            let config = &mut world.context.config;
            config.culling.keep_youngest = keep_youngest;
            config.keyframes.close_m = close_m;
            let World { context, map, .. } = &mut world;
            let culled = cull_keyframes(context, map, &[], KeyframeId(5), &mut Recorder::default());
            let culled: Vec<_> = culled.iter().map(|k| k.0).collect();
            assert_eq!(culled, expected, "{keep_youngest} youngest");
        }
    }

    #[test]
    fn a_culled_keyframe_follows_the_one_it_is_tied_to() {
        let mut world = world(5, |_, _| Some(0));
        let scales = world.context.scales.clone();
        let id = KeyframeId;
        assert!(world.map.cull(id(1), &scales), "there is one to tie it to");
        assert!(world.map.is_culled(id(1)), "and it is culled");
        assert!(world.map.keyframe(id(1)).is_empty(), "with its features");
        let left: Vec<_> = world.map.kept_ids().collect();
        assert_eq!(left, [0, 2, 3, 4].map(KeyframeId), "the others");
        let landmark = world.map.landmark(LandmarkId(0)).expect("seen by others");
        assert!(
            landmark.observations.iter().all(|(k, _)| *k != id(1)),
            "no observation of it"
        );
        // It is tied to keyframe 4, the youngest of equals; then 4 is culled, and both are tied to 3.
        assert!(world.map.cull(id(4), &scales), "as well");
        let motion = Se3::exp(&Vector6::new(0.3, 0.0, 0.1, 0.0, 0.2, 0.0));
        let before = [1, 3, 4].map(|k| world.map.keyframe(id(k)).camera_from_world);
        world.map.keyframe_mut(id(3)).camera_from_world = before[1] * motion;
        world.map.follow_anchors();
        for (k, before) in [1, 3, 4].into_iter().zip(before) {
            let now = world.map.keyframe(id(k)).camera_from_world;
            let off = apart(&now, &(before * motion));
            assert!(off < 1e-12, "keyframe {k}: the world has moved: {off}");
        }
    }

    #[test]
    fn a_landmark_of_a_culled_keyframe_alone_is_dropped() {
        let mut world = world(2, |k, i| (k == 0 || i > 0).then_some(0));
        let scales = world.context.scales.clone();
        assert!(world.map.cull(KeyframeId(0), &scales), "tied to the second");
        let count = world.map.landmarks().count();
        assert_eq!(count, usize::from(POINTS) - 1, "the first one had no other");
        let mut alone = self::world(1, |_, _| Some(0));
        assert!(
            !alone.map.cull(KeyframeId(0), &scales),
            "nothing to tie it to"
        );
        assert!(!alone.map.is_culled(KeyframeId(0)), "so it stays");
    }

    #[test]
    fn the_first_the_youngest_and_ends_of_loops_stay() {
        let mut world = world(20, |_, _| Some(0));
        let closed = [LoopClosure {
            keyframe: KeyframeId(5),
            older: KeyframeId(2),
            inliers: 50,
            drift_m: 0.1,
        }];
        let culled = {
            let World { context, map, .. } = &mut world;
            cull_keyframes(
                context,
                map,
                &closed,
                KeyframeId(19),
                &mut Recorder::default(),
            )
        };
        let order = [9, 8, 7, 6, 4, 3, 1].map(KeyframeId);
        assert_eq!(culled, order, "of equals the youngest first");
        let left: Vec<_> = world.map.kept_ids().map(|k| k.0).collect();
        assert_eq!(
            left,
            [0, 2, 5, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19],
            "the first, a loop, ten young ones"
        );
    }
}
