use garad_core::{Camera, DepthImage, Rng, So3};
use garad_features::{Descriptor, PlaceConfig};

use super::*;
use crate::config::{Config, LinearSolver};
use crate::testing::{World, apart, keypoints, turned, wall};

const SIZE: (usize, usize) = (64, 48);
const STEPS: u32 = 24;

/// A step along a circle of 24 steps, 4.8 m around: a turn of 15° and 0.2 m.
fn step() -> Se3 {
    let turn = std::f64::consts::TAU / f64::from(STEPS);
    Se3::exp(&Vector6::new(0.0, 0.0, 0.2, 0.0, turn, 0.0))
}

/// Keyframes around the circle, each with a landmark of its own 2 m ahead, and each step wrong
/// by the same motion.
fn drifted(error: Se3) -> World {
    let camera = Camera::pinhole(SIZE, [50.0, 50.0, 31.5, 23.5]).expect("valid camera");
    let mut world = World::with_camera(camera, Config::default());
    let depth = DepthImage::new(SIZE.0, SIZE.1, 2.0);
    let mut pose = Se3::identity();
    for i in 0..=STEPS {
        let mut frame = world.frame_of(i, &keypoints([[20, 30]]), &depth);
        frame.camera_from_world = pose;
        let p_world = frame.world_point(0, &camera).expect("has depth");
        let k = world.map.add_keyframe(frame);
        world.map.add_landmark(p_world, k, 0, &world.context.scales);
        pose = error * step() * pose;
    }
    world
}

fn error_m(world: &World) -> f64 {
    let mut truth = Se3::identity();
    let mut worst = 0.0f64;
    for keyframe in world.map.keyframes() {
        worst = worst.max((keyframe.center() - truth.inverse().translation).norm());
        truth = step() * truth;
    }
    worst
}

/// The path rises by 5 mm and rotates 0.2° too far at every step. The loop's ends meet, the error is spread, and every landmark stays where its own keyframe
/// saw it.
#[test]
fn the_path_of_a_drifted_circle_is_corrected() {
    let mut world = drifted(Se3::exp(&Vector6::new(0.0, 0.005, 0.0, 0.0, 0.004, 0.0)));
    let in_camera = |world: &World| -> Vec<Vector3<f64>> {
        let landmarks = world.map.landmarks().map(|(_, l)| l);
        landmarks
            .map(|l| world.map.keyframe(l.born).camera_from_world * l.p_world)
            .collect()
    };
    let (before, seen_before) = (error_m(&world), in_camera(&world));
    let closure = LoopClosure {
        keyframe: KeyframeId(STEPS),
        older: KeyframeId(0),
        inliers: 1000,
        drift_m: 0.0,
    };
    // A whole lap: the camera is back at the first keyframe.
    let solved = correct_path(
        &world.context,
        &mut world.map,
        &[],
        &closure,
        Se3::identity(),
    );
    assert!(solved, "solved");
    let after = error_m(&world);
    assert!(
        before > 0.05 && after < before / 3.0,
        "{before} to {after} m"
    );
    let last = world.map.keyframe(KeyframeId(STEPS)).camera_from_world;
    assert!(last.log().norm() < 2e-3, "the ends meet: {last:?}");
    for (now, then) in in_camera(&world).iter().zip(&seen_before) {
        assert!((now - then).norm() < 1e-9, "a landmark left its keyframe");
    }
}

/// The setting reaches the pose graph and the global bundle: other last bits, the same poses.
#[test]
fn the_linear_solver_is_a_setting() {
    let graph = |solver| {
        let mut world = drifted(Se3::exp(&Vector6::new(0.0, 0.005, 0.0, 0.0, 0.004, 0.0)));
        world.context.config.loops.linear_solver = solver;
        let World { context, map, .. } = &mut world;
        let (keyframe, older) = (KeyframeId(STEPS), KeyframeId(0));
        let closure = LoopClosure {
            keyframe,
            older,
            inliers: 1000,
            drift_m: 0.0,
        };
        let solved = correct_path(context, map, &[], &closure, Se3::identity());
        assert!(solved, "{solver:?}");
        map.keyframe_poses()
    };
    let bundle = |solver| {
        let (mut world, _) = World::three_views();
        world.context.config.loops.linear_solver = solver;
        let World { context, map, .. } = &mut world;
        let off = Vector6::new(0.02, -0.01, 0.01, 0.003, 0.002, -0.004);
        map.keyframe_mut(KeyframeId(1)).camera_from_world = Se3::exp(&off);
        global_ba(context, map, &mut Recorder::default());
        map.keyframe_poses()
    };
    let both = [LinearSolver::Portable, LinearSolver::Faer];
    for [portable, faer] in [both.map(graph), both.map(bundle)] {
        assert!(portable != faer, "the setting counts");
        for (a, b) in portable.iter().zip(&faer) {
            assert!((*a * b.inverse()).log().norm() < 1e-9, "{a:?} {b:?}");
        }
    }
}

#[test]
fn drift_beyond_a_share_of_the_path_is_not_plausible() {
    let world = drifted(Se3::identity());
    let limit_m = 0.2 + 0.05 * 4.8;
    let seen_at = |x: f64, turn: f64| {
        let mut seen = world.map.keyframe(KeyframeId(STEPS)).clone();
        let error = Se3::new(
            So3::exp(&Vector3::new(0.0, turn, 0.0)),
            Vector3::new(x, 0.0, 0.0),
        );
        seen.camera_from_world = error * seen.camera_from_world;
        is_plausible(
            &world.context,
            &world.map,
            KeyframeId(STEPS),
            KeyframeId(0),
            &seen,
        )
    };
    assert!(seen_at(0.97 * limit_m, 0.0), "just within");
    assert!(!seen_at(1.03 * limit_m, 0.0), "just beyond");
    assert!(!seen_at(0.0, 0.5), "rotated: 1.2 m off straight ahead");
}

#[test]
fn a_streak_needs_a_keyframe_in_common() {
    let place = |ids: &[u32]| -> BTreeSet<_> { ids.iter().map(|k| KeyframeId(*k)).collect() };
    let mut closer = LoopCloser::default();
    assert_eq!(closer.continue_streaks(vec![place(&[1, 2])]), [1], "first");
    let both = vec![place(&[2, 3]), place(&[7, 8])];
    assert_eq!(closer.continue_streaks(both), [2, 1], "one continues");
    let third = vec![place(&[3, 8])];
    assert_eq!(closer.continue_streaks(third), [3], "the longer one counts");
    assert!(closer.continue_streaks(Vec::new()).is_empty(), "nothing");
    assert_eq!(closer.continue_streaks(vec![place(&[3])]), [1], "broken");
}

fn closure(keyframe: u32, older: u32, inliers: usize) -> LoopClosure {
    LoopClosure {
        keyframe: KeyframeId(keyframe),
        older: KeyframeId(older),
        inliers,
        drift_m: 0.1,
    }
}

/// Six keyframes, of which 2 is culled, so that 1 and 3 follow each other; loops were closed at 4 and at 5.
/// Every edge holds what it should: which keyframes, the motion between them, and the landmarks behind it.
#[test]
fn the_graph_has_an_edge_for_neighbours_and_for_every_loop() {
    let both = |a: u32, b: u32, n: usize| vec![vec![a, b]; n];
    let shared = [
        both(0, 1, 7),
        both(0, 3, 50),
        both(1, 4, 49),
        both(1, 5, 51),
        both(2, 3, 60),
        both(3, 4, 3),
    ];
    let observers: Vec<Vec<u32>> = shared.into_iter().flatten().collect();
    let observers: Vec<&[u32]> = observers.iter().map(Vec::as_slice).collect();
    let mut world = World::observing(Config::default(), 6, &observers);
    assert!(world.map.cull(KeyframeId(2), &world.context.scales));
    let located = turned(7);
    let closed = [closure(4, 1, 45), closure(3, 0, 62)];
    let graph = path_graph(&world.map, &closed, &closure(5, 0, 80), located);
    assert_eq!(graph.poses, world.map.keyframe_poses());
    assert_eq!(
        graph.fixed,
        [true, false, true, false, false, false],
        "the first, and the culled one"
    );
    let relative = |a: u32, b: u32| turned(a) * turned(b).inverse();
    let expected = [
        (1, 0, relative(1, 0), 7.0), // consecutive
        (3, 0, relative(3, 0), 50.0),
        (5, 1, relative(5, 1), 51.0), // 4 and 1 share one too few
        (3, 1, relative(3, 1), 1.0),  // consecutive without a common landmark
        (4, 3, relative(4, 3), 3.0),
        (5, 4, relative(5, 4), 1.0),
        (4, 1, relative(4, 1), 45.0), // the loops closed before
        (3, 0, relative(3, 0), 62.0),
        (5, 0, located * turned(0).inverse(), 80.0), // this one
    ];
    let edges: Vec<_> = graph.edges.iter().map(|e| (e.a, e.b)).collect();
    let pairs: Vec<_> = expected.iter().map(|e| (e.0, e.1)).collect();
    assert_eq!(edges, pairs);
    for (edge, (a, b, a_from_b, n)) in graph.edges.iter().zip(&expected) {
        let off = apart(&edge.a_from_b, a_from_b);
        assert!(off < 1e-12, "{a} from {b}: {off}");
        let n_d2 = n * 6.25; // d = 2.5 m
        let diagonal = Vector6::new(*n, *n, *n, n_d2, n_d2, n_d2);
        assert_eq!(
            edge.information,
            Matrix6::from_diagonal(&diagonal),
            "{a} from {b}"
        );
    }
}

/// Loops closed before hold their ends together as they are now, and a culled keyframe follows its own.
#[test]
fn culled_keyframes_follow_the_corrected_path() {
    let observers = vec![&[0, 1, 2][..]; 30];
    let mut world = World::observing(Config::default(), 4, &observers);
    let World { context, map, .. } = &mut world;
    assert!(map.cull(KeyframeId(1), &context.scales));
    let before = map.keyframe_poses();
    let located = Se3::exp(&Vector6::new(0.05, -0.02, 0.03, 0.01, 0.03, -0.02)) * turned(3);
    assert!(correct_path(context, map, &[], &closure(3, 0, 40), located));
    let after = map.keyframe_poses();
    assert_eq!(after[0], before[0], "the first defines the world");
    let tied = |poses: &[Se3]| poses[1] * poses[2].inverse();
    let off = apart(&tied(&after), &tied(&before));
    assert!(off < 1e-12, "tied to keyframe 2: {off}");
    assert!(apart(&after[2], &before[2]) > 1e-4, "which has moved");
}

/// From keyframe 4 to 16 the circle is 12 steps of 0.2 m; 0.1 + 0.1 of that are 0.34 m. A turn of φ takes the point
/// 2.5 m ahead 5 sin(φ/2) m away: at 7.8° the same.
#[test]
fn plausible_drift_is_a_setting_and_counts_from_the_older_end() {
    let mut world = drifted(Se3::identity());
    let loops = &mut world.context.config.loops;
    (loops.max_drift, loops.max_drift_floor_m) = (0.1, 0.1);
    let (limit_m, limit_rad) = (0.339_315, 0.135_830);
    for (x, turn_rad, expected) in [
        (0.99 * limit_m, 0.0, true),
        (1.01 * limit_m, 0.0, false),
        (0.0, 0.99 * limit_rad, true),
        (0.0, 1.01 * limit_rad, false),
    ] {
        let mut seen = world.map.keyframe(KeyframeId(16)).clone();
        let turn = So3::exp(&Vector3::new(0.0, turn_rad, 0.0));
        seen.camera_from_world = Se3::new(turn, Vector3::new(x, 0.0, 0.0)) * seen.camera_from_world;
        let plausible = is_plausible(
            &world.context,
            &world.map,
            KeyframeId(16),
            KeyframeId(4),
            &seen,
        );
        assert_eq!(plausible, expected, "{x} m, {turn_rad} rad");
    }
}

#[test]
fn neighbours_share_so_many_landmarks() {
    let observers: [&[u32]; 5] = [&[0, 1, 3], &[0, 2, 3], &[0, 3], &[1, 3], &[2]];
    let world = World::observing(Config::default(), 4, &observers);
    for (landmarks, expected) in [(1, &[0, 1, 2][..]), (2, &[0, 1]), (3, &[0]), (4, &[])] {
        let found = neighbours(&world.map, KeyframeId(3), landmarks);
        let found: Vec<_> = found.iter().map(|k| k.0).collect();
        assert_eq!(found, expected, "{landmarks} landmarks");
    }
}

fn image(seed: u64) -> Vec<Descriptor> {
    let mut rng = Rng::new(seed);
    let descriptor = |_| Descriptor([0; 4].map(|_| rng.next_u64()));
    (0..40).map(descriptor).collect()
}

/// Keyframe 9 looks like keyframes 2 (exactly), 4 (three quarters), 1 (half), and like its neighbour 7, with which it
/// shares 12 landmarks, by five eighths; 8 shares no landmark, and neither does 1.
fn alike(config: Config) -> (World, PlaceIndex) {
    let mut observers = vec![&[7, 9][..]; 12];
    observers.extend([&[4, 5][..]; 12]);
    observers.push(&[3, 9]);
    let mut world = World::observing(config, 10, &observers);
    let mut places = PlaceIndex::new(PlaceConfig::default(), 0).expect("valid");
    let newest = image(9);
    for (k, common) in [
        (0, 0),
        (1, 20),
        (2, 40),
        (3, 0),
        (4, 30),
        (5, 0),
        (6, 0),
        (7, 25),
        (8, 36),
    ] {
        let mut descriptors = image(100 + k);
        descriptors[..common].copy_from_slice(&newest[..common]);
        places.add(KeyframeId(u32::try_from(k).expect("small")), &descriptors);
    }
    let frame = world.map.keyframe_mut(KeyframeId(9));
    frame.descriptors[..25].copy_from_slice(&newest[..25]);
    // The fixture's keypoints are 25: the other descriptors go with them.
    frame.descriptors.extend_from_slice(&newest[25..]);
    frame.in_use.resize(40, true);
    (world, places)
}

fn loops(min_gap: u32, neighbour_landmarks: usize, in_a_row: usize, candidates: usize) -> Config {
    let mut config = Config::default();
    let loops = &mut config.loops;
    (loops.min_gap, loops.neighbour_landmarks) = (min_gap, neighbour_landmarks);
    (loops.in_a_row, loops.candidates) = (in_a_row, candidates);
    config
}

/// Candidates of keyframe 9, most similar first: at least as similar as the least similar neighbour, not
/// neighbours themselves, and older than `min_gap` keyframes.
#[test]
fn candidates_are_old_and_as_similar_as_a_neighbour() {
    for (config, expected) in [
        (loops(2, 12, 1, 9), &[2, 4][..]), // 8 is a keyframe old, 7 a neighbour, 1 less similar than 7
        (loops(1, 12, 1, 9), &[2, 8, 4]),
        (loops(2, 12, 1, 1), &[2]),
        (loops(6, 12, 1, 9), &[2]),
        (loops(5, 12, 1, 9), &[2, 4]),
        (loops(7, 12, 1, 9), &[2]),
        (loops(8, 12, 1, 9), &[]),
        (loops(2, 13, 1, 9), &[2, 4, 7, 1]), // no neighbour: any score will do
        (loops(2, 1, 1, 9), &[2, 4, 1]),     // keyframe 3 is one, and not similar at all
        (loops(2, 12, 2, 9), &[]),
    ] {
        let settings = config.loops.clone();
        let (world, places) = alike(config);
        let mut closer = LoopCloser::default();
        let found = closer.candidates(&world.context, &world.map, &places, KeyframeId(9));
        let found: Vec<_> = found.iter().map(|k| k.0).collect();
        let similar: Vec<_> = (found.iter().copied())
            .filter(|k| expected.contains(k))
            .collect();
        assert_eq!(similar, expected, "{settings:?}");
        let score = |k: u32| {
            places.score(
                KeyframeId(k),
                &static_descriptors(world.map.keyframe(KeyframeId(9))),
            )
        };
        let mut others = found.iter().filter(|k| !expected.contains(k));
        assert!(
            others.all(|k| score(*k) < Some(0.1)),
            "by chance: {found:?}"
        );
    }
}

/// A place counts from the second keyframe in a row on, by way of the neighbours of what looked alike; after a loop
/// there is none for `min_gap` keyframes, and rows begin anew.
#[test]
fn candidates_need_several_keyframes_in_a_row() {
    let (world, places) = alike(loops(2, 12, 2, 2));
    let mut closer = LoopCloser::default();
    let next = |closer: &mut LoopCloser| -> Vec<u32> {
        let found = closer.candidates(&world.context, &world.map, &places, KeyframeId(9));
        found.iter().map(|k| k.0).collect()
    };
    // The keyframe before looked like keyframe 5, a neighbour of 4.
    closer.continue_streaks(vec![BTreeSet::from([KeyframeId(5)])]);
    assert_eq!(next(&mut closer), [4], "the second in a row");
    assert_eq!(next(&mut closer), [2, 4], "and now both");
    for at in [8, 7] {
        closer.push(closure(at, 1, 50));
        assert!(closer.streaks.is_empty(), "rows begin anew");
        assert!(
            next(&mut closer).is_empty(),
            "after a loop at keyframe {at}"
        );
        let again = next(&mut closer);
        let expected: &[u32] = if at == 8 { &[] } else { &[2, 4] };
        assert_eq!(again, expected, "after a loop at keyframe {at}, once more");
    }
}

/// Keyframe 12 sees what keyframe 0 saw from where that was, but believes to be 13 cm and 2° away, where its own
/// landmarks lie.
fn lap(config: Config) -> (World, PlaceIndex) {
    let mut world = World::new(config);
    let mut places = PlaceIndex::new(PlaceConfig::default(), 0).expect("valid");
    let drift = Se3::exp(&Vector6::new(0.1, -0.05, 0.06, 0.01, 0.03, -0.02));
    for k in 0..=12 {
        let mut frame = world.frame(10 * k, &wall());
        let mut rng = Rng::new(u64::from(k % 12)); // 12 looks like 0
        for descriptor in &mut frame.descriptors {
            *descriptor = Descriptor([0; 4].map(|_| rng.next_u64()));
        }
        let side = f64::from(k) * std::f64::consts::TAU / 12.0;
        let out = So3::exp(&Vector3::new(0.0, side, 0.0)) * Vector3::z() - Vector3::z();
        frame.camera_from_world = match k {
            12 => drift,
            _ => Se3::new(So3::identity(), out),
        };
        let id = world.map.add_keyframe(frame);
        let World { context, map, .. } = &mut world;
        if k % 12 == 0 {
            for i in 0..300 {
                let p_world = map.keyframe(id).world_point(i, &context.camera);
                map.add_landmark(p_world.expect("on the wall"), id, i, &context.scales);
            }
        }
        if k < 12 {
            places.add(id, &static_descriptors(map.keyframe(id)));
        }
    }
    (world, places)
}

#[test]
fn a_loop_is_closed_where_a_place_is_seen_again() {
    let settings = |min_inliers: usize, max_drift_floor_m: f64, bundle_iterations: usize| {
        let mut config = loops(10, 15, 1, 3);
        let loops = &mut config.loops;
        (loops.min_inliers, loops.max_drift_floor_m, loops.max_drift) =
            (min_inliers, max_drift_floor_m, 1e-9);
        loops.bundle_iterations = bundle_iterations;
        config
    };
    for (min_inliers, floor_m, bundle_iterations, closes) in [
        (300, 0.5, 0, true),
        (300, 0.5, 3, true),
        (301, 0.5, 3, false),
        (300, 0.05, 3, false),
    ] {
        let (mut world, places) = lap(settings(min_inliers, floor_m, bundle_iterations));
        let World { context, map, .. } = &mut world;
        let newest = map.keyframe_mut(KeyframeId(12));
        for (i, uv_px) in newest.uv_px.iter_mut().enumerate() {
            uv_px.y += if i % 2 == 0 { 0.3 } else { -0.3 };
        }
        if bundle_iterations == 0 {
            newest.sigma_px.fill(0.05); // of subpixel matches, which do not count here
        }
        let before = map.keyframe_poses();
        let mut closer = LoopCloser::default();
        let recorder = &mut Recorder::default();
        let moved = closer.close_loop(context, map, &places, KeyframeId(12), recorder);
        let what = format!("{min_inliers} inliers, {floor_m} m, {bundle_iterations} iterations");
        if !closes {
            assert!(moved.is_empty() && closer.closed().is_empty(), "{what}");
            assert_eq!(map.keyframe_poses(), before, "{what}");
            assert_eq!(map.landmarks().count(), 600, "{what}");
            continue;
        }
        let [loop_closure] = closer.closed() else {
            panic!("{what}: {:?}", closer.closed())
        };
        let ends = (
            loop_closure.keyframe.0,
            loop_closure.older.0,
            loop_closure.inliers,
        );
        assert_eq!(ends, (12, 0, 300), "{what}");
        let drift_m = before[12].inverse().translation.norm();
        assert!(
            (loop_closure.drift_m - drift_m).abs() < 1e-3,
            "{what}: {drift_m}"
        );
        let after = map.keyframe_poses();
        let off = apart(&after[12], &Se3::identity());
        assert!(off < 5e-3, "{what}: the ends are {off} m apart");
        assert_eq!(moved.len(), 13, "{what}");
        for k in 0..13 {
            let off = apart(&(after[k] * moved[k]), &before[k]);
            assert!(off < 1e-12, "{what}, keyframe {k}: {off}");
        }
        let left: Vec<_> = map.landmarks().map(|(id, _)| id.0).collect();
        assert_eq!(
            left,
            (0..300).collect::<Vec<_>>(),
            "{what}: the old ones stay"
        );
        for i in 0..300 {
            let both = [(0, i as usize), (12, i as usize)];
            assert_eq!(world.observers(i), both, "{what}: landmark {i}");
        }
    }
}

/// The keyframe's link is fused with the landmark it was located by, the old one staying; a keypoint without a link
/// observes it; what the keyframe observes elsewhere stays.
#[test]
fn landmarks_of_a_place_are_joined_by_the_links() {
    let observers: [&[u32]; 6] = [&[0], &[0, 2], &[0], &[2, 1], &[1], &[0]];
    let mut world = World::observing(Config::default(), 3, &observers);
    let mut seen = world.map.keyframe(KeyframeId(2)).clone();
    let links = [None, Some(0), None, Some(2), Some(5), Some(1)];
    seen.landmark = links.map(|l| l.map(LandmarkId)).to_vec();
    let landmark = |world: &mut World, id: u32, visible: u32, found: u32| {
        let landmark = world.map.landmark_mut(LandmarkId(id)).expect("made");
        (landmark.visible, landmark.found) = (visible, found);
    };
    landmark(&mut world, 2, 50, 40);
    landmark(&mut world, 3, 7, 3);
    let World { context, map, .. } = &mut world;
    join_landmarks(context, map, &closure(2, 0, 50), &seen);
    // Keypoint 1 had landmark 1, which becomes landmark 0, so that keypoint 5 is linked to none.
    assert_eq!(world.observers(0), [(0, 0), (2, 1)]);
    assert_eq!(
        world.observers(2),
        [(0, 2), (1, 3), (2, 3)],
        "3 has become 2"
    );
    assert_eq!(world.observers(5), [(0, 5), (2, 4)], "a new observation");
    assert!(
        world.observers(1).is_empty() && world.observers(3).is_empty(),
        "fused"
    );
    let kept = world.map.landmark(LandmarkId(2)).expect("kept");
    assert_eq!((kept.visible, kept.found), (57, 43), "counted together");
}

/// All keyframes that are left, but the first, and all static landmarks.
#[test]
fn the_global_bundle_moves_all_but_the_first() {
    let displaced = |iterations: usize| {
        let (mut world, _) = World::three_views();
        world.set_dynamic(4);
        world.context.config.loops.bundle_iterations = iterations;
        let World { context, map, .. } = &mut world;
        for (k, x) in [(1, 0.02), (2, -0.01)] {
            let off = Vector6::new(x, 0.01, 0.0, 0.002, 0.0, 0.0);
            map.keyframe_mut(KeyframeId(k)).camera_from_world = Se3::exp(&off);
        }
        for id in [3, 4] {
            map.landmark_mut(LandmarkId(id)).expect("made").p_world.z += 0.05;
        }
        let before = map.keyframe_poses();
        global_ba(context, map, &mut Recorder::default());
        let z = [3, 4].map(|id| map.landmark(LandmarkId(id)).expect("kept").p_world.z);
        (before, map.keyframe_poses(), z)
    };
    let (before, after, _) = displaced(0);
    assert_eq!(before, after, "without iterations");
    let (_, after, z) = displaced(10);
    for (k, pose) in after.iter().enumerate() {
        let off = apart(pose, &Se3::identity());
        assert!(off < 1e-4, "keyframe {k}: {off} m");
    }
    assert!((z[0] - 3.0).abs() < 1e-3, "adjusted: {}", z[0]);
    assert!(
        (z[1] - 3.05).abs() < 1e-12,
        "dynamic, and left alone: {}",
        z[1]
    );
}
