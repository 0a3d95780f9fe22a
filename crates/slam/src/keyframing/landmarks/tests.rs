use garad_core::Camera;
use garad_features::Descriptor;
use nalgebra::{Vector2, Vector3};

use super::*;
use crate::config::Config;
use crate::testing::{World, keypoints, places, turned, wall};

/// Depths 5, 3 (linked), none, 4, 2, 9, 3.5 (not in use), 5 m: by depth 4, 1, 3, 0, 7, 5.
#[test]
fn landmarks_are_made_of_the_near_and_at_least_of_the_nearest() {
    for (close_m, at_least, expected) in [
        (4.0, 3, &[4, 3][..]), // two are near; the third nearest is 4 m away
        (4.0, 2, &[4]),
        (4.0, 0, &[4]),
        (5.0, 1, &[4, 3]),
        (5.5, 0, &[4, 3, 0, 7]),
        (1.0, 4, &[4, 3, 0]), // the first of equals
        (1.0, 5, &[4, 3, 0, 7]),
        (1.0, 99, &[4, 3, 0, 7, 5]),
        (1.0, 0, &[]),
    ] {
        let mut config = Config::default();
        config.keyframes.close_m = close_m;
        config.keyframes.min_new_landmarks = at_least;
        let mut world = World::observing(config, 2, &[&[0]]);
        let mut frame = world.frame_of(30, &keypoints(places().into_iter().take(8)), &wall());
        frame.camera_from_world = turned(3);
        frame.depth_m = [5.0, 3.0, 0.0, 4.0, 2.0, 9.0, 3.5, 5.0].map(Some).to_vec();
        frame.depth_m[2] = None;
        frame.in_use[6] = false;
        frame.landmark[1] = Some(LandmarkId(0));
        let World { context, map, .. } = &mut world;
        let id = map.add_keyframe(frame);
        let made = new_landmarks(context, map, id);
        let ids: Vec<_> = (1..=expected.len())
            .map(|i| LandmarkId(u32::try_from(i).expect("few")))
            .collect();
        assert_eq!(
            made, ids,
            "nearest first, near is {close_m} m, at least {at_least}"
        );
        for (landmark, &i) in made.iter().zip(expected) {
            let keyframe = world.map.keyframe(id);
            assert_eq!(keyframe.landmark[i], Some(*landmark), "keypoint {i}");
            let landmark = world.map.landmark(*landmark).expect("made");
            assert_eq!(
                (landmark.visible, landmark.found, landmark.born),
                (1, 1, id)
            );
            assert_eq!(landmark.observations, [(id, i)]);
            assert_eq!(landmark.depth, LandmarkDepth::Measured { since: id });
            let p_cam = turned(3) * landmark.p_world;
            let z = keyframe.depth_m[i].expect("has depth");
            let [x, y] = places()[i].map(|c| c as f64);
            let expected = Vector3::new((x - 78.5) / 120.0 * z, (y - 60.5) / 110.0 * z, z);
            assert!((p_cam - expected).norm() < 1e-12, "keypoint {i}: {p_cam}");
        }
    }
}

type Recent<'a> = (u32, u32, u32, &'a [u32], bool, bool);

/// (born, visible, found, observers, kept, still recent) at keyframe 6, where half of the sightings and
/// three observers are needed.
#[test]
fn landmarks_that_are_not_confirmed_are_dropped() {
    let cases: [Recent; 9] = [
        (5, 8, 4, &[5], true, true),
        (5, 9, 4, &[5], false, false), // rarely found
        (5, 1, 1, &[5], true, true),   // a keyframe old: not to be confirmed yet
        (4, 1, 1, &[4, 5], false, false),
        (4, 1, 1, &[4, 5, 6], true, true),
        (3, 2, 1, &[3, 4, 6], true, false), // confirmed, and three keyframes old
        (3, 2, 1, &[3, 4], false, false),
        (2, 9, 4, &[2, 3, 4, 5], false, false),
        (6, 1, 1, &[6], true, true),
    ];
    let mut config = Config::default();
    config.keyframes.found_ratio = 0.5;
    config.keyframes.min_observations = 3;
    let observers: Vec<_> = cases.iter().map(|case| case.3).collect();
    let mut world = World::observing(config, 7, &observers);
    let World { context, map, .. } = &mut world;
    for (id, (born, visible, found, ..)) in (0..).map(LandmarkId).zip(&cases) {
        let landmark = map.landmark_mut(id).expect("made");
        assert_eq!(landmark.born.0, *born);
        (landmark.visible, landmark.found) = (*visible, *found);
    }
    map.drop_landmark(LandmarkId(8)); // meanwhile
    let mut recent: Vec<_> = (0..9).map(LandmarkId).collect();
    drop_weak_landmarks(context, map, &mut recent, KeyframeId(6));
    let left: Vec<_> = map.landmarks().map(|(id, _)| id.0).collect();
    let expect = |what: fn(&Recent) -> bool| -> Vec<u32> {
        let all = (0..8).filter(|i| what(&cases[*i as usize]));
        all.collect()
    };
    assert_eq!(left, expect(|case| case.4), "in the map");
    let recent: Vec<_> = recent.iter().map(|id| id.0).collect();
    assert_eq!(recent, expect(|case| case.5), "recent");
}

/// Landmarks that keyframe 1 is the first to measure, with the pixel of its keypoint.
#[test]
fn the_mapper_is_told_of_what_is_measured_first() {
    let observers: [&[u32]; 6] = [&[0, 1], &[1, 2], &[1], &[1], &[2], &[1]];
    let mut world = World::observing(Config::default(), 3, &observers);
    world.set_dynamic(2);
    let covariance = nalgebra::Matrix3::identity();
    let landmark = world.map.landmark_mut(LandmarkId(3)).expect("made");
    landmark.depth = LandmarkDepth::Triangulated { covariance };
    let id = KeyframeId(1);
    let px = [
        (0.0, 0.0),
        (30.49, 20.5),
        (31.5, 7.2),
        (1.0, 1.0),
        (2.0, 2.0),
        (17.0, 90.0),
    ];
    let frame = world.map.keyframe_mut(id);
    frame.px = px.map(|(x, y)| Vector2::new(x, y)).to_vec();
    for (tagged, expected) in [
        (TaggedLabels::Landmark, &[(1, [30, 21]), (5, [17, 90])][..]),
        (
            TaggedLabels::Evidence,
            &[(1, [30, 21]), (2, [32, 7]), (5, [17, 90])],
        ),
    ] {
        let found = landmarks_first_measured_in(&world.map, id, tagged);
        let told: Vec<_> = found.iter().map(|l| (l.id.0, l.px)).collect();
        assert_eq!(told, expected, "{tagged:?}");
        let at = |l: &NewLandmark| world.map.landmark(l.id).map(|l| l.p_world);
        assert!(found.iter().all(|l| at(l) == Some(l.p_world)), "{found:?}");
    }
}

/// Where the landmark is expected in keyframe 1: 3 m away, at level 2 (1.44).
const SEEN: [f64; 3] = [84.5, 66.0, 3.0];

/// Landmark 0 of keyframe 0, which should appear in keyframe 1 as [`SEEN`] says, and keypoints there: right and
/// below of it by so many pixels, at this level and depth, with so many bits of the descriptor wrong.
fn duplicates(keypoints: &[([f64; 2], u8, Option<f64>, u32)]) -> World {
    let mut config = Config::default();
    config.tracking.bf = 30.0; // a disparity of 10 px
    let camera = Camera::pinhole((160, 120), [120.0, 110.0, 78.5, 60.5]).expect("valid");
    let mut world = World::with_camera(camera, config);
    let first = world.frame_of(0, &crate::testing::keypoints([[20, 30]]), &wall());
    let at = [84, 66];
    let points = crate::testing::keypoints(keypoints.iter().map(|_| at));
    let mut second = world.frame_of(10, &points, &wall());
    second.camera_from_world = turned(2);
    for (i, (offset, level, depth_m, wrong)) in keypoints.iter().enumerate() {
        second.uv_px[i] = Vector2::new(SEEN[0] + offset[0], SEEN[1] + offset[1]);
        second.keypoints[i].level = *level;
        second.depth_m[i] = *depth_m;
        second.descriptors[i] = Descriptor([(1u64 << *wrong) - 1, 0, 0, 0]);
    }
    let World { context, map, .. } = &mut world;
    let (first, second) = (map.add_keyframe(first), map.add_keyframe(second));
    let p_cam = context
        .camera
        .unproject(&Vector2::new(SEEN[0], SEEN[1]), SEEN[2]);
    let p_world = turned(2).inverse() * p_cam;
    let id = map.add_landmark(p_world, first, 0, &context.scales);
    let offset = p_world - map.keyframe(second).center();
    let landmark = map.landmark_mut(id).expect("made");
    let distance = offset.norm();
    landmark.view_direction = offset / distance;
    landmark.distance_m = (0.5 * distance, 1.43 * distance);
    world
}

fn fuse(world: &mut World) {
    let World { context, map, .. } = world;
    fuse_into(context, map, &[LandmarkId(0)], KeyframeId(1));
}

/// σ is that of the keypoint's level: 1.2 px at level 1, 1.44 px at level 2. √5.991 σ = 2.937 and 3.525 px
/// without depth; √7.815 σ = 3.355 and 4.026 px, disparity included, with it. Depth 30/(10 + δ) m is a disparity of
/// δ px too many.
#[test]
fn a_duplicate_is_at_the_projection_and_looks_alike() {
    let far = |delta: f64| Some(30.0 / (10.0 + delta));
    for (what, keypoint, linked) in [
        ("exactly there", ([0.0, 0.0], 2, None, 0), true),
        ("3.5 px beside, level 2", ([3.5, 0.0], 2, None, 0), true),
        ("3.55 px", ([0.0, 3.55], 2, None, 0), false),
        ("3.6 px in both together", ([-2.7, 2.4], 2, None, 0), false),
        ("2.9 px, level 1", ([0.0, -2.9], 1, None, 0), true),
        ("2.97 px, level 1", ([0.0, 2.97], 1, None, 0), false),
        (
            "with depth 4 px are allowed",
            ([4.0, 0.0], 2, far(0.0), 0),
            true,
        ),
        ("4.05 px are not", ([4.05, 0.0], 2, far(0.0), 0), false),
        ("4 px of disparity", ([0.0, 0.0], 2, far(4.0), 0), true),
        ("4.05 px of it", ([0.0, 0.0], 2, far(4.05), 0), false),
        ("the other way", ([0.0, 0.0], 2, far(-4.05), 0), false),
        ("2 px and 3.4 px", ([2.0, 0.0], 2, far(-3.4), 0), true),
        ("2 px and 3.6 px", ([0.0, 2.0], 2, far(-3.6), 0), false),
        ("3.3 px of it, level 1", ([0.0, 0.0], 1, far(3.3), 0), true),
        ("3.4 px of it, level 1", ([0.0, 0.0], 1, far(3.4), 0), false),
        ("level 0", ([0.0, 0.0], 0, None, 0), false),
        ("level 3", ([0.0, 0.0], 3, None, 0), false),
        ("50 bits differ", ([0.0, 0.0], 2, None, 50), true),
        ("51 bits differ", ([0.0, 0.0], 2, None, 51), false),
    ] {
        let mut world = duplicates(&[keypoint]);
        fuse(&mut world);
        let expected: &[(u32, usize)] = if linked { &[(0, 0), (1, 0)] } else { &[(0, 0)] };
        assert_eq!(world.observers(0), expected, "{what}");
        let link = world.map.keyframe(KeyframeId(1)).landmark[0];
        assert_eq!(link, linked.then_some(LandmarkId(0)), "{what}");
    }
}

#[test]
fn the_duplicate_that_looks_most_alike_is_taken() {
    let near = |wrong: u32| ([0.5, -0.5], 2, None, wrong);
    for (wrong, best) in [([9, 7, 8], 1), ([7, 9, 7], 0), ([9, 8, 3], 2)] {
        let mut world = duplicates(&wrong.map(near));
        fuse(&mut world);
        assert_eq!(world.observers(0), [(0, 0), (1, best)], "{wrong:?}");
    }
    let mut world = duplicates(&[near(0), near(1)]);
    world.map.add_observation(LandmarkId(0), KeyframeId(1), 1);
    fuse(&mut world);
    assert_eq!(
        world.observers(0),
        [(0, 0), (1, 1)],
        "it is seen there already"
    );
    let mut world = duplicates(&[near(0)]);
    world.set_dynamic(0);
    fuse(&mut world);
    assert_eq!(
        world.observers(0),
        [(0, 0)],
        "what moves is not searched for"
    );
}

/// Of two landmarks the one with more observers stays, of equals the one that was projected; counts add up.
#[test]
fn the_landmark_with_more_observers_stays() {
    for (others, kept) in [(0, 0), (1, 1)] {
        let mut world = duplicates(&[([0.5, 0.0], 2, Some(3.0), 0)]);
        let frames: Vec<_> = (0..others)
            .map(|k| world.frame_of(20 + k, &keypoints([[40, 50]]), &wall()))
            .collect();
        let World { context, map, .. } = &mut world;
        let duplicate = map.add_landmark(
            Vector3::new(0.1, 0.2, 3.0),
            KeyframeId(1),
            0,
            &context.scales,
        );
        for frame in frames {
            let k = map.add_keyframe(frame);
            map.add_observation(duplicate, k, 0);
        }
        for (id, visible, found) in [(LandmarkId(0), 10, 4), (duplicate, 200, 30)] {
            let landmark = map.landmark_mut(id).expect("made");
            (landmark.visible, landmark.found) = (visible, found);
        }
        fuse(&mut world);
        let left: Vec<_> = world.map.landmarks().map(|(id, _)| id.0).collect();
        assert_eq!(left, [kept], "{others} other observers");
        let landmark = world.map.landmark(LandmarkId(kept)).expect("kept");
        assert_eq!((landmark.visible, landmark.found), (210, 34), "added up");
        let expected: Vec<_> = (0..2 + others).map(|k| (k, 0)).collect();
        assert_eq!(world.observers(kept), expected, "by both");
    }
}

/// The keyframe shares 3 landmarks with keyframe 0, 1 with keyframe 1, and 2 with 2 to 11: keyframes 2 and 1
/// are the eleventh and the twelfth.
#[test]
fn duplicates_are_searched_for_in_the_ten_nearest_keyframes() {
    let all: Vec<u32> = (0..13).collect();
    let without_one: Vec<u32> = all.iter().copied().filter(|k| *k != 1).collect();
    let observers: [&[u32]; 4] = [&all, &without_one, &[0, 12], &[12]];
    let mut world = World::observing(Config::default(), 13, &observers);
    // All look from where the first one does, and landmark 3 is at its own keypoint everywhere.
    for k in 0..13 {
        world.map.keyframe_mut(KeyframeId(k)).camera_from_world = turned(0);
    }
    let World { context, map, .. } = &mut world;
    let p_world = map.keyframe(KeyframeId(12)).world_point(3, &context.camera);
    map.set_position(
        LandmarkId(3),
        p_world.expect("on the wall"),
        &context.scales,
    );
    fuse_with_neighbours(context, map, KeyframeId(12));
    let by: Vec<_> = world.observers(3).iter().map(|(k, _)| *k).collect();
    assert_eq!(
        by,
        [0, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12],
        "youngest of equals first"
    );
}

/// The other way round: what only a neighbour observes is searched for in the new keyframe.
#[test]
fn landmarks_of_neighbours_are_searched_for_in_the_keyframe() {
    let mut world = World::observing(Config::default(), 2, &[&[0, 1], &[0]]);
    world.map.keyframe_mut(KeyframeId(1)).camera_from_world = turned(0);
    let World { context, map, .. } = &mut world;
    fuse_with_neighbours(context, map, KeyframeId(1));
    assert_eq!(world.observers(1), [(0, 1), (1, 1)]);
}

/// Keyframe 2 observes landmark 0, whose mean view follows; landmark 1 has still one observer and is dropped;
/// new ones become recent.
#[test]
fn a_new_keyframe_observes_makes_and_drops_landmarks() {
    let mut config = Config::default();
    config.keyframes.min_new_landmarks = 3;
    config.keyframes.close_m = 1.0;
    let mut world = World::observing(config, 2, &[&[0, 1], &[0]]);
    let mut frame = world.frame_of(
        20,
        &keypoints(places().into_iter().skip(40).take(5)),
        &wall(),
    );
    frame.camera_from_world = turned(2);
    frame.landmark[0] = Some(LandmarkId(0));
    let World { context, map, .. } = &mut world;
    let mut recent = vec![LandmarkId(0), LandmarkId(1)];
    let id = add_keyframe(context, map, &mut recent, frame);
    assert_eq!(id, KeyframeId(2));
    assert_eq!(recent, [0, 2, 3].map(LandmarkId), "confirmed, and made");
    assert_eq!(world.observers(0), [(0, 0), (1, 0), (2, 0)]);
    assert!(world.observers(1).is_empty(), "dropped");
    assert_eq!(world.observers(2), [(2, 1)]);
    let landmark = world.map.landmark(LandmarkId(0)).expect("kept");
    let direction = |k: u32| (landmark.p_world - turned(k).inverse().translation).normalize();
    let mean = (direction(0) + direction(1) + direction(2)).normalize();
    assert!(
        (landmark.view_direction - mean).norm() < 1e-14,
        "of three views"
    );
}

/// Keypoints without depth become landmarks if that is enabled.
#[test]
fn landmarks_from_two_views_are_a_setting() {
    for (enabled, expected) in [(true, 2), (false, 1)] {
        let mut config = Config::default();
        config.two_view.enabled = enabled;
        let mut world = World::observing(config, 1, &[&[0], &[0]]);
        world.map.drop_landmark(LandmarkId(1));
        let camera = world.context.camera;
        let first = world.map.keyframe_mut(KeyframeId(0));
        first.depth_m[1] = None;
        first.descriptors[1] = Descriptor([7; 4]);
        // The point at 12 m behind keypoint 1, (4, 12), seen 1 m to the right: 120 px / 12 less.
        first.uv_px[1] = Vector2::new(14.0, 12.0);
        first.px[1] = first.uv_px[1];
        first.set_shutter(garad_core::RollingShutter::global(), &camera);
        let mut frame = world.frame_of(10, &keypoints([[4, 4], [4, 12]]), &wall());
        frame.camera_from_world =
            garad_core::Se3::new(garad_core::So3::identity(), Vector3::new(-1.0, 0.0, 0.0));
        frame.landmark[0] = Some(LandmarkId(0));
        frame.depth_m[1] = None;
        frame.descriptors[1] = Descriptor([7; 4]);
        let World { context, map, .. } = &mut world;
        let mut recent = Vec::new();
        add_keyframe(context, map, &mut recent, frame);
        assert_eq!(world.map.landmarks().count(), expected, "{enabled}");
        assert_eq!(recent.len(), expected - 1, "{enabled}");
    }
}
