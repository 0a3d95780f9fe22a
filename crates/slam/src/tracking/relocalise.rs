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
use nalgebra::Vector3;

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
    let mut inliers_of = Vec::new();
    for candidate in candidates {
        let mut tried = frame.clone();
        let inliers = locate(context, map, &mut tried, candidate.id, recorder);
        inliers_of.push((candidate.id, inliers));
        if inliers >= config.reference_min_matches
            && best.as_ref().is_none_or(|(most, _)| inliers > *most)
        {
            best = Some((inliers, tried));
        }
        if inliers >= config.min_inliers_after_recovery {
            break;
        }
    }
    let found = best.is_some();
    match best {
        Some((_, found)) => *frame = found,
        None => frame.landmark.fill(None),
    }
    recorder.record("relocalise", |record| {
        record.relocalise(&inliers_of, found, frame)
    });
    found
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

/// Whether a pair is an inlier of camera_from_world.
fn fits(pose: &Se3, p_cam: &Vector3<f64>, p_world: &Vector3<f64>) -> bool {
    (*pose * *p_world - p_cam).norm() < INLIER_FLOOR_M + INLIER_RATIO * p_cam.z
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
            .filter(|(p_cam, p_world)| fits(pose, p_cam, p_world))
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

#[cfg(test)]
mod tests {
    use garad_features::PlaceConfig;

    use super::*;
    use crate::config::Config;
    use crate::testing::{World, cloud, small_motion, uneven_camera};

    /// The frame sees 70 points from [`small_motion`]. Keyframe 0 looks like it in 40 keypoints, 20 of
    /// which made landmarks; keyframe 1 in 30, all of which made landmarks. They share none.
    fn scene(after_recovery: usize, reference_min: usize) -> (World, PlaceIndex, Frame) {
        let mut config = Config::default();
        let t = &mut config.tracking;
        (t.min_inliers_after_recovery, t.reference_min_matches) = (after_recovery, reference_min);
        let mut world = World::with_camera(uneven_camera(), config);
        let mut places = PlaceIndex::new(PlaceConfig::default(), 0).expect("valid");
        let points = cloud();
        for (keyframe, seen, made) in [(0, &points[..40], 20), (1, &points[..30], 30)] {
            let frame = world.see(keyframe, seen, &Se3::identity());
            places.add(KeyframeId(keyframe), &static_descriptors(&frame));
            world.remember(frame, &seen[..made]);
        }
        let now = world.see(7, &points, &small_motion());
        (world, places, now)
    }

    fn linked(frame: &Frame) -> Vec<u32> {
        frame.landmark.iter().flatten().map(|l| l.0).collect()
    }

    fn off(frame: &Frame) -> f64 {
        (frame.camera_from_world * small_motion().inverse())
            .log()
            .norm()
    }

    #[test]
    fn the_first_keyframe_that_is_good_enough_or_the_best() {
        for (after_recovery, reference_min, expected) in [
            (20, 15, Some(0..20)), // the first has enough
            (21, 15, Some(20..50)),
            (50, 15, Some(20..50)), // none has: the most
            (50, 21, Some(20..50)),
            (50, 30, Some(20..50)),
            (50, 31, None),
        ] {
            let (world, places, mut now) = scene(after_recovery, reference_min);
            let recorder = &mut Recorder::default();
            let found = relocalise(&world.context, &world.map, &places, &mut now, recorder);
            let what = format!("{after_recovery} wanted, {reference_min} needed");
            assert_eq!(found, expected.is_some(), "{what}");
            let links: Vec<_> = expected.into_iter().flatten().collect();
            assert_eq!(linked(&now), links, "{what}");
            assert!(!found || off(&now) < 1e-4, "{what}: {}", off(&now));
        }
    }

    #[test]
    fn the_first_of_equals_stays() {
        let (mut world, places, mut now) = scene(50, 15);
        let surplus: Vec<_> = (40..50).map(LandmarkId).collect();
        world.set_moving(&surplus);
        let recorder = &mut Recorder::default();
        assert!(
            relocalise(&world.context, &world.map, &places, &mut now, recorder),
            "found"
        );
        assert_eq!(linked(&now), (0..20).collect::<Vec<_>>(), "20 each");
    }

    /// With depth by a rigid motion, without by directions; neighbours' landmarks are found, too.
    #[test]
    fn a_pose_from_one_keyframe_and_its_neighbours() {
        for with_depth in [true, false] {
            let (mut world, _, mut now) = scene(50, 15);
            // Keyframe 2 observes landmarks 45 to 49 of keyframe 1 and made those of points 50 to 59.
            let points = cloud();
            let mut third = world.see(2, &points[..60], &Se3::identity());
            for (i, id) in (25..30).zip(45..50) {
                third.landmark[i] = Some(LandmarkId(id));
            }
            let id = world.map.add_keyframe(third);
            for (i, p) in points.iter().enumerate().take(60).skip(50) {
                world.map.add_landmark(*p, id, i, &world.context.scales);
            }
            if with_depth {
                let depth = points.iter().map(|p| Some((small_motion() * *p).z));
                now.depth_m = depth.collect();
            }
            now.landmark.fill(Some(LandmarkId(3))); // of another try
            let recorder = &mut Recorder::default();
            let (context, map) = (&world.context, &world.map);
            let inliers = locate(context, map, &mut now, KeyframeId(1), recorder);
            assert_eq!(inliers, 40, "30 of the keyframe, 10 of its neighbour");
            assert_eq!(linked(&now), (20..60).collect::<Vec<_>>(), "links");
            assert!(off(&now) < 1e-4, "{}", off(&now));
            assert_eq!(landmarks_around(map, KeyframeId(1)).len(), 40, "around");
            assert_eq!(
                locate(context, map, &mut now, KeyframeId(2), recorder),
                40,
                "as well"
            );
            world.context.config.tracking.reference_min_matches = 21;
            let inliers = locate(
                &world.context,
                &world.map,
                &mut now,
                KeyframeId(0),
                recorder,
            );
            assert_eq!(inliers, 0, "20 matches");
        }
    }

    /// 0.02 m and 3 % of the measured depth.
    #[test]
    fn inliers_of_a_rigid_motion() {
        let pose = small_motion();
        let along = Vector3::new(0.36, -0.48, 0.8);
        for (z, distance_m, expected) in [
            (2.0, 0.079, true),
            (2.0, 0.081, false),
            (4.0, 0.139, true),
            (4.0, 0.141, false),
        ] {
            let p_cam = Vector3::new(0.5, -0.25, z);
            let p_world = pose.inverse() * (p_cam + distance_m * along);
            assert_eq!(
                fits(&pose, &p_cam, &p_world),
                expected,
                "{distance_m} m at {z} m"
            );
        }
    }

    /// 30 pairs with depth, six of which have a wrong one.
    #[test]
    fn a_rigid_motion_needs_enough_pairs_and_inliers() {
        let (world, _, mut now) = scene(50, 15);
        for (i, (id, p)) in (0..20).chain(40..50).zip(cloud()).enumerate() {
            let z = (small_motion() * p).z;
            now.landmark[i] = Some(LandmarkId(id));
            now.depth_m[i] = Some(if i % 5 == 4 { 1.5 * z } else { z });
        }
        let pose = |needed| rigid_ransac(&world.context, &world.map, &now, needed);
        for needed in [3, 24] {
            let found = pose(needed).expect("24 of 30 fit");
            let off = (found * small_motion().inverse()).log().norm();
            assert!(off < 1e-6, "{off}");
        }
        assert_eq!(pose(25), None, "24 inliers");
        assert_eq!(pose(31), None, "30 pairs");
    }

    #[test]
    fn a_place_is_recognised_by_what_does_not_move() {
        let (_, _, mut now) = scene(50, 15);
        now.in_use[1..69].fill(false);
        let expected = [now.descriptors[0], now.descriptors[69]];
        assert_eq!(static_descriptors(&now), expected, "in order");
    }
}
