use garad_features::Descriptor;
use nalgebra::Matrix3;

use super::*;
use crate::config::Config;
use crate::testing::{World, apart, keypoints, places, turned, wall};

fn ids(ids: &[u32]) -> Vec<KeyframeId> {
    ids.iter().map(|k| KeyframeId(*k)).collect()
}

/// Keyframe 3 shares two landmarks with 1, two with 0, one with 2, none with 4.
fn five() -> World {
    let observers: [&[u32]; 5] = [&[0, 1, 3], &[1, 3], &[0, 2], &[3, 0, 2], &[4]];
    World::observing(Config::default(), 5, &observers)
}

#[test]
fn counts_are_ordered_as_stated() {
    let counts = [(0, 5), (1, 9), (2, 5)].map(|(k, n)| (KeyframeId(k), n));
    let order = by_count(&BTreeMap::from(counts));
    assert_eq!(order, ids(&[1, 2, 0]), "most first, then youngest");
}

#[test]
fn common_landmarks_are_counted() {
    let mut world = five();
    let counts = |counts: BTreeMap<KeyframeId, usize>| -> Vec<_> {
        counts.into_iter().map(|(k, n)| (k.0, n)).collect()
    };
    let map = &world.map;
    assert_eq!(
        counts(map.covisible(KeyframeId(3))),
        [(0, 2), (1, 2), (2, 1)]
    );
    assert!(map.covisible(KeyframeId(4)).is_empty(), "alone");
    assert_eq!(by_count(&map.covisible(KeyframeId(3))), ids(&[1, 0, 2]));
    let seen = [2, 3, 7].map(LandmarkId).into_iter();
    assert_eq!(counts(map.observers(seen)), [(0, 2), (2, 2), (3, 1)]);
    let both = map.observed_by([KeyframeId(3), KeyframeId(0)]);
    assert_eq!(both, [0, 1, 2, 3].map(LandmarkId), "each once, ascending");
    world.map.drop_landmark(LandmarkId(0));
    assert_eq!(
        counts(world.map.covisible(KeyframeId(3))),
        [(0, 1), (1, 1), (2, 1)]
    );
    assert_eq!(world.map.landmark_ids(), [1, 2, 3, 4].map(LandmarkId));
    world.set_dynamic(3);
    assert!(
        world.map.static_landmark(LandmarkId(3)).is_none(),
        "dynamic"
    );
    assert!(
        world.map.static_landmark(LandmarkId(0)).is_none(),
        "dropped"
    );
    assert!(world.map.static_landmark(LandmarkId(1)).is_some(), "static");
    assert!(
        world.map.landmark(LandmarkId(3)).is_some(),
        "in the map all the same"
    );
}

#[test]
fn an_empty_map_has_no_last_keyframe() {
    let empty = Map::default();
    assert_eq!(
        (empty.last_keyframe_id(), empty.last_keyframe_frame()),
        (None, FrameId(0))
    );
    let world = five();
    assert_eq!(world.map.last_keyframe_id(), Some(KeyframeId(4)));
    assert_eq!(world.map.last_keyframe_frame(), FrameId(40));
}

/// The links of a keyframe become observations; one with depth measures a landmark that was triangulated, and
/// changes nothing for one that is measured.
#[test]
fn a_keyframes_links_are_observations() {
    for has_depth in [true, false] {
        let mut world = five();
        let covariance = Matrix3::identity();
        let triangulated = LandmarkDepth::Triangulated { covariance };
        for id in [1, 2] {
            world.map.landmark_mut(LandmarkId(id)).expect("made").depth = triangulated;
        }
        world.map.drop_landmark(LandmarkId(4));
        let mut frame = world.frame_of(50, &keypoints(places().into_iter().take(4)), &wall());
        frame.landmark = [Some(1), Some(4), None, Some(0)]
            .map(|l| l.map(LandmarkId))
            .to_vec();
        if !has_depth {
            frame.depth_m[0] = None;
        }
        let id = world.map.add_keyframe(frame);
        assert_eq!(id, KeyframeId(5));
        assert_eq!(world.observers(1), [(1, 1), (3, 1), (5, 0)]);
        assert_eq!(world.observers(0), [(0, 0), (1, 0), (3, 0), (5, 3)]);
        assert!(world.observers(4).is_empty(), "it was dropped");
        let depth = |id: u32| world.map.landmark(LandmarkId(id)).expect("made").depth;
        let first = LandmarkDepth::Measured {
            since: KeyframeId(0),
        };
        assert_eq!(depth(0), first, "measured before");
        let expected = if has_depth {
            LandmarkDepth::Measured { since: id }
        } else {
            triangulated
        };
        assert_eq!(depth(1), expected, "{has_depth}");
        // An observation added later does the same.
        world.map.add_observation(LandmarkId(2), id, 2);
        assert_eq!(world.observers(2), [(0, 2), (2, 2), (5, 2)]);
        assert_eq!(world.map.keyframe(id).landmark[2], Some(LandmarkId(2)));
        let depth = world.map.landmark(LandmarkId(2)).expect("made").depth;
        assert_eq!(depth, LandmarkDepth::Measured { since: id });
    }
}

#[test]
fn what_is_dropped_is_dropped_on_both_sides() {
    let mut world = five();
    let links = |world: &World, k: u32| world.map.keyframe(KeyframeId(k)).landmark.clone();
    let linked = |ids: [Option<u32>; 5]| ids.map(|l| l.map(LandmarkId)).to_vec();
    world.map.drop_observation(LandmarkId(3), KeyframeId(0));
    assert_eq!(world.observers(3), [(2, 3), (3, 3)]);
    assert_eq!(
        links(&world, 0),
        linked([Some(0), None, Some(2), None, None])
    );
    assert_eq!(
        links(&world, 3),
        linked([Some(0), Some(1), None, Some(3), None])
    );
    world.map.drop_observation(LandmarkId(3), KeyframeId(4)); // which does not see it
    assert_eq!(world.observers(3), [(2, 3), (3, 3)]);
    world.map.drop_observation(LandmarkId(3), KeyframeId(2));
    world.map.drop_observation(LandmarkId(3), KeyframeId(3));
    assert!(
        world.map.landmark(LandmarkId(3)).is_none(),
        "it was the last"
    );
    world.map.drop_landmark(LandmarkId(0));
    for (k, left) in [
        (0, [None, None, Some(2), None, None]),
        (1, [None, Some(1), None, None, None]),
    ] {
        assert_eq!(links(&world, k), linked(left), "keyframe {k}");
    }
    let World { context, map, .. } = &mut world;
    let id = map.add_landmark(
        Vector3::new(0.0, 0.0, 3.0),
        KeyframeId(4),
        0,
        &context.scales,
    );
    assert_eq!(id, LandmarkId(5), "no id is used twice");
}

/// Keyframes 0 and 1 see landmark 0, keyframes 1 and 2 landmark 1: what is new to landmark 0 is keyframe 2.
#[test]
fn of_two_landmarks_one_is_left() {
    let observers: [&[u32]; 3] = [&[0, 1], &[1, 2], &[0]];
    let mut world = World::observing(Config::default(), 3, &observers);
    for (id, visible, found) in [(0, 100, 60), (1, 7, 5)] {
        let landmark = world.map.landmark_mut(LandmarkId(id)).expect("made");
        (landmark.visible, landmark.found) = (visible, found);
    }
    let covariance = Matrix3::identity();
    let triangulated = LandmarkDepth::Triangulated { covariance };
    world.map.landmark_mut(LandmarkId(0)).expect("made").depth = triangulated;
    let World { context, map, .. } = &mut world;
    map.fuse(LandmarkId(0), LandmarkId(0), &context.scales); // nothing happens
    map.fuse(LandmarkId(9), LandmarkId(0), &context.scales);
    assert_eq!(map.landmarks().count(), 3, "both are there");
    map.fuse(LandmarkId(0), LandmarkId(1), &context.scales);
    let kept = map.landmark(LandmarkId(0)).expect("kept");
    assert_eq!((kept.visible, kept.found), (107, 65), "together");
    assert_eq!(
        kept.depth,
        LandmarkDepth::Measured {
            since: KeyframeId(1)
        },
        "by the other"
    );
    let views =
        [0, 1, 2].map(|k| (kept.p_world - map.keyframe(KeyframeId(k)).center()).normalize());
    let mean = (views[0] + views[1] + views[2]).normalize();
    assert!(
        (kept.view_direction - mean).norm() < 1e-14,
        "as three keyframes see it"
    );
    assert!(map.landmark(LandmarkId(1)).is_none(), "gone");
    assert_eq!(world.observers(0), [(0, 0), (1, 0), (2, 1)]);
    let links = |k: u32| world.map.keyframe(KeyframeId(k)).landmark.clone();
    assert_eq!(
        links(1),
        [Some(LandmarkId(0)), None, None],
        "one keypoint of two"
    );
    assert_eq!(links(2), [None, Some(LandmarkId(0)), None], "taken over");
    let World { context, map, .. } = &mut world;
    map.fuse(LandmarkId(2), LandmarkId(1), &context.scales);
    let other = map.landmark(LandmarkId(2)).expect("there");
    assert_eq!(
        (other.visible, other.found, other.observations.len()),
        (1, 1, 1),
        "1 is gone"
    );
}

#[test]
fn sightings_are_counted() {
    let mut world = five();
    let expected = [0, 1, 3].map(LandmarkId);
    for _ in 0..2 {
        world
            .map
            .count_sightings(&expected, [LandmarkId(1), LandmarkId(2)].into_iter());
    }
    let counts: Vec<_> = world
        .map
        .landmarks()
        .map(|(_, l)| (l.visible, l.found))
        .collect();
    assert_eq!(counts, [(3, 1), (3, 3), (1, 3), (3, 1), (1, 1)]);
}

/// From its observers: mean direction, distance at the level of the oldest, and the descriptor in the middle.
#[test]
fn what_follows_from_observations_is_recomputed() {
    let mut world = five();
    let bits = |n: u32| Descriptor([(1 << n) - 1, 0, 0, 0]);
    for (k, level, n) in [(0, 2, 9), (1, 1, 4), (3, 5, 0)] {
        let keyframe = world.map.keyframe_mut(KeyframeId(k));
        keyframe.keypoints[0].level = level;
        keyframe.descriptors[0] = bits(n);
    }
    let before = world
        .map
        .landmark(LandmarkId(1))
        .expect("made")
        .view_direction;
    let World { context, map, .. } = &mut world;
    let p_world = Vector3::new(0.3, -0.2, 4.0);
    map.set_position(LandmarkId(0), p_world, &context.scales);
    let landmark = map.landmark(LandmarkId(0)).expect("made");
    assert_eq!(landmark.p_world, p_world);
    assert_eq!(
        landmark.descriptor,
        bits(4),
        "4 and 5 bits from the others, the first of equals"
    );
    let centres = [0, 1, 3].map(|k| turned(k).inverse().translation);
    let views = centres.map(|c| (p_world - c).normalize());
    let sum = views[0] + views[1] + views[2];
    assert!((landmark.view_direction - sum.normalize()).norm() < 1e-14);
    let farthest = p_world.norm() * 1.44; // keyframe 0 stands at the origin and saw it at level 2
    let nearest = farthest / context.scales[7];
    let (low, high) = landmark.distance_m;
    assert!(
        (high - farthest).abs() < 1e-12 && (low - nearest).abs() < 1e-12,
        "{low} to {high}"
    );
    map.landmark_mut(LandmarkId(1)).expect("made").p_world = p_world;
    let now = |map: &Map| map.landmark(LandmarkId(1)).expect("made").view_direction;
    assert_eq!(now(map), before, "not yet");
    map.refresh_all(&context.scales);
    assert_ne!(now(map), before, "all of them");
}

/// Keyframe 3 is tied to 1, the youngest of those that share most; then 1 is, to 0, and with it 3.
#[test]
fn a_culled_keyframe_is_tied_to_the_one_it_shares_most_with() {
    let mut world = five();
    let scales = world.context.scales.clone();
    assert!(world.map.cull(KeyframeId(3), &scales));
    assert!(!world.map.cull(KeyframeId(4), &scales), "it shares nothing");
    assert_eq!(world.observers(0), [(0, 0), (1, 0)]);
    assert_eq!(world.observers(3), [(0, 3), (2, 3)]);
    let landmark = world.map.landmark(LandmarkId(1)).expect("made");
    let view = landmark.p_world - turned(1).inverse().translation;
    assert!(
        (landmark.view_direction - view.normalize()).norm() < 1e-14,
        "by keyframe 1 alone"
    );
    let anchor = |world: &World, k: u32| world.map.culled[&KeyframeId(k)];
    assert_eq!(anchor(&world, 3).keyframe, KeyframeId(1));
    assert!(world.map.cull(KeyframeId(1), &scales));
    assert_eq!(world.map.kept_ids().collect::<Vec<_>>(), ids(&[0, 2, 4]));
    for k in [1, 3] {
        let Anchor {
            keyframe,
            culled_from_anchor,
        } = anchor(&world, k);
        assert_eq!(keyframe, KeyframeId(0), "keyframe {k}");
        let off = apart(&culled_from_anchor, &(turned(k) * turned(0).inverse()));
        assert!(off < 1e-13, "keyframe {k}: {off}");
    }
    world.map.keyframe_mut(KeyframeId(0)).camera_from_world = turned(6);
    world.map.follow_anchors();
    for k in [1, 3] {
        let pose = world.map.keyframe_poses()[k as usize];
        let off = apart(&pose, &(turned(k) * turned(6)));
        assert!(off < 1e-12, "keyframe {k}: {off}");
    }
    for k in [2, 4] {
        assert_eq!(
            world.map.keyframe(KeyframeId(k)).camera_from_world,
            turned(k),
            "keyframe {k} stays"
        );
    }
}
