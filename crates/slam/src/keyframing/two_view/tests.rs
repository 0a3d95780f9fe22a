use garad_core::{Camera, DepthImage, Label, Se3, So3};
use garad_features::Descriptor;

use super::*;
use crate::config::Config;
use crate::testing::{World, keypoints, turned};
use crate::tracking::observation::link_observation;

/// Pixels of the first camera, whole ones, whose rays meet far points in the second, a whole number of pixels beside.
const PLACES: [[usize; 2]; 3] = [[40, 30], [80, 60], [120, 90]];

/// Two keyframes with a common landmark that makes them neighbours; the second is `baseline_m` to the right. Each
/// of [`PLACES`] shows a point `shift_px` to the left in the second, and nothing there has depth.
fn two_keyframes(baseline_m: f64, shift_px: usize, rows_off: usize) -> (World, KeyframeId) {
    let mut world = World::new(Config::default());
    let mut ids = Vec::new();
    for (k, shift) in [(0, 0), (1, shift_px)] {
        let off = if k == 0 { 0 } else { rows_off };
        let shifted = PLACES.map(|[x, y]| [x - shift, y + off]);
        let mut places = shifted.to_vec();
        places.push([20, 100]); // the common landmark, with depth
        let mut depth = DepthImage::new(160, 120, 0.0);
        for y in 96..105 {
            depth.row_mut(y)[10..30].fill(2.0);
        }
        let mut frame = world.frame_of(k, &keypoints(places), &depth);
        for (i, descriptor) in (0u32..).zip(&mut frame.descriptors) {
            *descriptor = Descriptor([u64::MAX << (12 * i), u64::MAX >> (9 * i), 0, 0]);
        }
        let x = f64::from(k) * baseline_m;
        frame.camera_from_world = Se3::new(So3::identity(), Vector3::new(-x, 0.0, 0.0));
        ids.push(world.map.add_keyframe(frame));
    }
    let scales = world.context.scales.clone();
    let common = Vector3::new(-1.0, 0.7, 2.0);
    let common = world.map.add_landmark(common, ids[0], 3, &scales);
    world.map.add_observation(common, ids[1], 3);
    (world, ids[1])
}

fn made(world: &mut World, id: KeyframeId) -> Vec<LandmarkId> {
    let World { context, map, .. } = world;
    two_view_landmarks(context, map, id)
}

/// A frame without depth and its keypoints at these positions, of level 0 and with these descriptors.
fn frame_at(world: &World, id: u32, at: &[[f64; 2]], descriptors: &[Descriptor]) -> Frame {
    let (width, height) = (world.context.camera.width, world.context.camera.height);
    let depth = DepthImage::new(width, height, 0.0);
    let anywhere = keypoints(at.iter().map(|_| [80, 60]));
    let mut frame = world.frame_of(id, &anywhere, &depth);
    frame.descriptors = descriptors.to_vec();
    frame.px = at.iter().map(|[x, y]| Vector2::new(*x, *y)).collect();
    frame.set_shutter(garad_core::RollingShutter::global(), &world.context.camera);
    frame
}

fn bits(count: u32) -> Descriptor {
    Descriptor([(1 << count) - 1, 0, 0, 0])
}

/// Points in front of a camera that turns and moves by 0.9 m; in the older view they come in another order.
#[test]
fn points_are_where_turned_cameras_see_them() {
    let camera = Camera::pinhole((160, 120), [120.0, 110.0, 78.5, 60.5]).expect("valid");
    let mut world = World::with_camera(camera, Config::default());
    let by = Se3::new(
        So3::exp(&Vector3::new(0.02, -0.06, 0.1)),
        Vector3::new(0.9, 0.1, 0.05),
    );
    let poses = [turned(2), by * turned(2)];
    let points = [[-1.0, 0.9, 9.0], [0.5, -1.2, 8.0], [1.5, 0.4, 11.0]]
        .map(|p| turned(2).inverse() * Vector3::from(p));
    let look = |k: usize, order: [usize; 3]| -> (Vec<[f64; 2]>, Vec<Descriptor>) {
        let at = order
            .map(|i| <[f64; 2]>::from(camera.project(&(poses[k] * points[i])).expect("in front")));
        let descriptors = order.map(|i| Descriptor([u64::MAX << (20 * i), i as u64, 0, 0]));
        (at.to_vec(), descriptors.to_vec())
    };
    for (k, order) in [(0, [2, 0, 1]), (1, [0, 1, 2])] {
        let (at, descriptors) = look(k, order);
        let mut frame = frame_at(&world, 0, &at, &descriptors);
        frame.camera_from_world = poses[k];
        world.map.add_keyframe(frame);
    }
    let World { context, map, .. } = &world;
    let pairs = pairs(
        context,
        map.keyframe(KeyframeId(1)),
        map.keyframe(KeyframeId(0)),
    );
    let found: Vec<_> = pairs.iter().map(|(i, j, _)| (*i, *j)).collect();
    assert_eq!(found, [(0, 1), (1, 2), (2, 0)], "newest, older");
    for (i, _, point) in pairs {
        let off = (point.p_world - points[i]).norm();
        assert!(off < 1e-6, "point {i}: {off} m");
    }
}

#[test]
fn both_views_observe_the_landmark_with_their_own_keypoints() {
    let (mut world, _) = two_keyframes(1.0, 10, 0);
    let places = [[70, 60], [30, 30], [20, 100]];
    let mut third = world.frame_of(2, &keypoints(places), &DepthImage::new(160, 120, 0.0));
    third.camera_from_world = world.map.keyframe(KeyframeId(1)).camera_from_world;
    for (i, like) in [1, 0, 3].into_iter().enumerate() {
        third.descriptors[i] = world.map.keyframe(KeyframeId(0)).descriptors[like];
    }
    third.landmark[2] = Some(LandmarkId(0));
    let third = world.map.add_keyframe(third);
    // Keyframe 1 sees the same from the same place: no inverse depth, no landmark.
    let ids = made(&mut world, third);
    assert_eq!(ids, [1, 2].map(LandmarkId));
    assert_eq!(world.observers(1), [(0, 1), (2, 0)]);
    assert_eq!(world.observers(2), [(0, 0), (2, 1)]);
    let landmark = world.map.landmark(LandmarkId(1)).expect("made");
    let cameras = [0, 2].map(|k| world.map.keyframe(KeyframeId(k)).center());
    let views = cameras.map(|c| (landmark.p_world - c).normalize());
    let mean = (views[0] + views[1]).normalize();
    assert!(
        (landmark.view_direction - mean).norm() < 1e-12,
        "of both views"
    );
}

/// The image of the ray of (150, 60) leads from there, infinity, to (30, 60), 1 m. At level 1 and with
/// `radius_px` 2.5 what lies 3 px beside is searched. Every keypoint of the second view: where, its level,
/// and bits that differ.
#[test]
fn a_match_is_searched_along_the_ray() {
    type Seen = [([f64; 2], u8, u32)];
    type Change = dyn Fn(&mut Frame, &mut Vec<bool>);
    let far = [140.0, 60.0];
    let cases: [(&str, &Seen, Option<usize>); 20] = [
        ("nothing there", &[], None),
        ("on the ray", &[(far, 1, 0)], Some(0)),
        ("2.9 px above", &[([80.0, 57.1], 1, 0)], Some(0)),
        ("3.1 px below", &[([80.0, 63.1], 1, 0)], None),
        ("2.9 px beyond infinity", &[([152.9, 60.0], 1, 0)], Some(0)),
        ("3.1 px beyond infinity", &[([153.1, 60.0], 1, 0)], None),
        ("2.9 px nearer than 1 m", &[([27.1, 60.0], 1, 0)], Some(0)),
        ("3.1 px nearer than 1 m", &[([26.9, 60.0], 1, 0)], None),
        ("beyond the corner", &[([152.5, 62.5], 1, 0)], None),
        ("a level finer", &[(far, 0, 0)], Some(0)),
        ("a level coarser", &[(far, 2, 0)], Some(0)),
        ("two levels coarser", &[(far, 3, 0)], None),
        ("30 bits differ", &[(far, 1, 30)], Some(0)),
        ("31 bits differ", &[(far, 1, 31)], None),
        ("the better one", &[(far, 1, 24), (far, 1, 9)], Some(1)),
        ("just clear", &[(far, 1, 15), (far, 1, 20)], Some(0)),
        ("not clear", &[(far, 1, 15), (far, 1, 19)], None),
        (
            "a worse one elsewhere",
            &[(far, 1, 15), ([80.0, 70.0], 1, 15)],
            Some(0),
        ),
        (
            "the second best is listed last",
            &[(far, 1, 8), (far, 1, 30), (far, 1, 9)],
            None,
        ),
        ("equals are not clear", &[(far, 1, 9), (far, 1, 9)], None),
    ];
    let setting = |k: f64| {
        let mut config = Config::default();
        (config.two_view.radius_px, config.two_view.match_distance) = (2.5, 30);
        config.tracking.local_ratio = 0.75;
        let world = World::new(config);
        let mut first = frame_at(&world, 1, &[[150.0, 60.0]], &[bits(0)]);
        first.keypoints[0].level = 1;
        let pose = Se3::new(So3::identity(), Vector3::new(-k, 0.0, 0.0));
        (world, first, pose)
    };
    let search = |baseline_m: f64, seen: &Seen, change: &Change| {
        let (world, first, pose) = setting(baseline_m);
        let at: Vec<_> = seen.iter().map(|s| s.0).collect();
        let descriptors: Vec<_> = seen.iter().map(|s| bits(s.2)).collect();
        let mut second = frame_at(&world, 0, &at, &descriptors);
        second.camera_from_world = pose;
        for (keypoint, seen) in second.keypoints.iter_mut().zip(seen) {
            keypoint.level = seen.1;
        }
        let mut taken = vec![false; seen.len()];
        change(&mut second, &mut taken);
        search_along_ray(&world.context, &first, 0, &second, &taken)
    };
    for (what, seen, expected) in cases {
        assert_eq!(search(1.0, seen, &|_, _| ()), expected, "{what}");
    }
    let one: &Seen = &[(far, 1, 0)];
    assert_eq!(search(1.06, one, &|_, _| ()), Some(0), "127.2 px of ray");
    assert_eq!(search(1.08, one, &|_, _| ()), None, "129.6 px of ray");
    let changes: [(&str, &Change); 4] = [
        ("in another pair", &|_, taken| taken[0] = true),
        ("not in use", &|frame, _| frame.in_use[0] = false),
        ("has a landmark", &|frame, _| {
            frame.landmark[0] = Some(LandmarkId(0))
        }),
        ("has depth", &|frame, _| frame.depth_m[0] = Some(3.0)),
    ];
    for (what, change) in changes {
        assert_eq!(search(1.0, one, change), None, "{what}");
    }
}

/// Two keypoints, `rows` above one another, look like the one of the older view, which is 10 px to the left and so far
/// below the first: with Δ rows between the views the gate of 5.991 is at (Δ/2)².
#[test]
fn a_keypoint_is_in_one_pair_at_most() {
    for (below, rows, expected) in [
        (2.0, 1.0, &[(0, 0)][..]), // both would do: the first has it
        (6.0, 4.0, &[(1, 0)]),     // 9 for the first: it is still free
        (6.0, 1.0, &[]),           // 9 and 6.25
        (6.0, 1.25, &[(1, 0)]),    // 5.64
    ] {
        let mut config = Config::default();
        (config.two_view.radius_px, config.two_view.match_distance) = (7.0, 30);
        let world = World::new(config);
        let at = [[150.0, 60.0], [150.0, 60.0 + rows]];
        let first = frame_at(&world, 1, &at, &[bits(3), bits(3)]);
        let mut second = frame_at(&world, 0, &[[140.0, 60.0 + below]], &[bits(5)]);
        second.camera_from_world = Se3::new(So3::identity(), Vector3::new(-1.0, 0.0, 0.0));
        let pairs = pairs(&world.context, &first, &second);
        let found: Vec<_> = pairs.iter().map(|(i, j, _)| (*i, *j)).collect();
        assert_eq!(found, expected, "{below} rows below, {rows} apart");
    }
}

/// (0.5, 0.2, 12) m seen from the origin and from (1, 0, 3) m: z/σ_z is 9.3 in the one camera and 7.0 in the other.
#[test]
fn inverse_depth_is_that_of_the_newest_camera() {
    let mut world = World::new(Config::default());
    let point = Vector3::new(0.5, 0.2, 12.0);
    let views = [Vector3::zeros(), Vector3::new(1.0, 0.0, 3.0)].map(|centre| {
        let at = world
            .context
            .camera
            .project(&(point - centre))
            .expect("in front");
        let mut frame = frame_at(&world, 0, &[at.into()], &[bits(0)]);
        frame.camera_from_world = Se3::new(So3::identity(), -centre);
        frame
    });
    world.context.config.two_view.min_inverse_depth_sigmas = 8.0;
    let found = [(0, 1), (1, 0)].map(|(newest, older)| {
        point_of_pair(&world.context, (&views[newest], 0), (&views[older], 0)).is_some()
    });
    assert_eq!(found, [true, false], "12 m and 9 m away");
}

/// Settings: so many neighbours; σ of inverse depth (n σ_ρ are n √2 px of shift); the gate of 5.991 at
/// (Δ/2)² for Δ rows between the views once the search reaches as far.
#[test]
fn gates_of_a_pair_are_settings() {
    for (sigmas, radius_px, neighbours, shift, rows, expected) in [
        (2.0, 2.0, 10, 2, 0, 0),
        (2.0, 2.0, 10, 3, 0, 3),
        (7.0, 2.0, 10, 9, 0, 0),
        (7.0, 2.0, 10, 10, 0, 3),
        (2.0, 6.0, 1, 10, 4, 3),
        (2.0, 6.0, 1, 10, 5, 0),
        (2.0, 2.0, 0, 10, 0, 0),
    ] {
        let (mut world, second) = two_keyframes(1.0, shift, rows);
        let config = &mut world.context.config.two_view;
        config.min_inverse_depth_sigmas = sigmas;
        (config.radius_px, config.neighbours) = (radius_px, neighbours);
        let made = made(&mut world, second).len();
        assert_eq!(
            made, expected,
            "{sigmas} sigmas, {radius_px} px, {shift} px, {rows} rows"
        );
    }
}

/// f b / shift = 120 px * 1 m / 10 px = 12 m.
#[test]
fn far_points_become_landmarks_without_depth() {
    let (mut world, second) = two_keyframes(1.0, 10, 0);
    let ids = made(&mut world, second);
    assert_eq!(ids.len(), PLACES.len());
    for (id, [x, y]) in ids.iter().zip(PLACES) {
        let landmark = world.map.landmark(*id).expect("made");
        let px = Vector2::new(x as f64, y as f64);
        let expected = world.context.camera.unproject(&px, 12.0);
        let off = (landmark.p_world - expected).norm();
        assert!(off < 1e-6, "{off} m from where the rays meet");
        assert_eq!(landmark.observations.len(), 2, "both views");
        assert_eq!(landmark.label(), Label::Static);
        let triangulated = matches!(landmark.depth, LandmarkDepth::Triangulated { .. });
        assert!(triangulated, "{:?}", landmark.depth);
    }
    assert!(made(&mut world, second).is_empty(), "none is left");
}

/// σ_ρ = √2 / (f b): 4 σ_ρ are 5.7 px of shift, whatever the baseline.
#[test]
fn what_is_hardly_nearer_than_infinity_is_left_out() {
    for (shift, expected) in [(5, 0), (6, PLACES.len())] {
        let (mut world, second) = two_keyframes(1.0, shift, 0);
        assert_eq!(made(&mut world, second).len(), expected, "{shift} px");
    }
}

/// With σ = 1 px, the gate of 5.99 allows each view (Δ/2)² with Δ rows between them, and the search 2 px.
#[test]
fn what_is_beside_the_ray_is_no_match() {
    for (rows, expected) in [(1, PLACES.len()), (3, 0)] {
        let (mut world, second) = two_keyframes(1.0, 10, rows);
        assert_eq!(
            made(&mut world, second).len(),
            expected,
            "{rows} rows beside"
        );
    }
}

#[test]
fn a_keyframe_with_depth_measures_it() {
    let (mut world, second) = two_keyframes(1.0, 10, 0);
    let ids = made(&mut world, second);
    let mut third = world.frame_of(2, &keypoints(PLACES), &DepthImage::new(160, 120, 7.5));
    third.landmark[0] = Some(ids[0]);
    let third = world.map.add_keyframe(third);
    let depth = |id: LandmarkId| world.map.landmark(id).expect("made").depth;
    assert_eq!(depth(ids[0]), LandmarkDepth::Measured { since: third });
    assert_ne!(depth(ids[1]), LandmarkDepth::Measured { since: third });
}

/// Seen from between the two views its depth does not matter; from the side it does.
#[test]
fn what_is_not_known_widens_sigma() {
    let (mut world, second) = two_keyframes(1.0, 10, 0);
    let id = made(&mut world, second)[1];
    let landmark = world.map.landmark(id).expect("made");
    let sigma_at = |x: f64| {
        let depth = DepthImage::new(160, 120, 0.0);
        let mut frame = world.frame_of(2, &keypoints(PLACES), &depth);
        frame.camera_from_world = Se3::new(So3::identity(), Vector3::new(-x, 0.0, 0.0));
        link_observation(&world.context, &frame, 1, landmark).sigma_px
    };
    // Between two views, each with σ = 1 px, their mean has √½ px; beyond, the line through both is
    // extended: at the position x = s b, of variance (1 - s)² + s².
    for (x, variance) in [(0.5, 0.5), (0.0, 1.0), (1.0, 1.0), (3.0, 13.0)] {
        let sigma = sigma_at(x);
        let expected = (1.0 + f64::max(variance, 0.5)).sqrt();
        assert!(
            (sigma - expected).abs() < 0.01,
            "{x} m: {sigma} px, {expected} expected"
        );
    }
}

/// After an adjustment that moved a camera to where both views are the same, nothing is known of depth.
#[test]
fn a_landmark_that_is_no_longer_determined_is_dropped() {
    let (mut world, second) = two_keyframes(1.0, 10, 0);
    let id = made(&mut world, second)[0];
    let World { context, map, .. } = &mut world;
    update_covariance(context, map, id);
    assert!(map.landmark(id).is_some(), "still determined");
    map.drop_observation(id, second);
    update_covariance(context, map, id);
    assert!(map.landmark(id).is_none(), "one view");
}
