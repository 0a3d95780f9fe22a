//! State, velocity and the steps of [`Tracker`].

use garad_core::{LandmarkId, Par};
use garad_features::PlaceConfig;
use nalgebra::Vector6;

use super::*;
use crate::config::Config;
use crate::frame::CentreEstimate;
use crate::testing::{Stages, World, cloud, small_motion, uneven_camera, wall};

/// Inliers of one frame after the other: (inliers, state, weak).
#[test]
fn tracking_weak_and_lost() {
    use TrackingState::{Lost, Tracking};
    let camera = garad_core::Camera::pinhole((64, 48), [50.0, 50.0, 31.5, 23.5]);
    let mut config = Config::default();
    let t = &mut config.tracking;
    (t.min_inliers, t.min_inliers_after_recovery) = (30, 50);
    let context = Context::new(camera.expect("valid"), config, 0, Par::Seq).expect("valid");
    let mut tracker = Tracker::default();
    let frames = [
        (400, Tracking, false),
        (200, Tracking, false), // half is not less than half
        (180, Tracking, true),  // of 380
        (181, Tracking, false), // of 360: 180
        (29, Lost, false),
        (49, Lost, false),
        (50, Tracking, false), // found again; what is usual begins anew
        (49, Lost, false),     // not yet trusted
    ];
    for (k, (inliers, state, weak)) in (0u32..).zip(frames) {
        tracker.update_state(&context, FrameId(k), inliers);
        assert_eq!(
            (tracker.state(), tracker.is_weak()),
            (state, weak),
            "frame {k}"
        );
    }
}
/// After a relocalisation at frame 100 the greater number is needed up to frame 129.
#[test]
fn care_after_a_relocalisation_ends() {
    use TrackingState::{Lost, Tracking};
    let mut config = Config::default();
    let t = &mut config.tracking;
    (t.min_inliers, t.min_inliers_after_recovery) = (30, 50);
    let context = World::new(config).context;
    for (frame, inliers, state) in [
        (101, 49, Lost),
        (129, 49, Lost),
        (129, 50, Tracking),
        (130, 30, Tracking),
        (130, 29, Lost),
        (200, 30, Tracking),
    ] {
        let mut tracker = Tracker {
            state: Lost,
            velocity: Some(small_motion()),
            ..Tracker::default()
        };
        tracker.update_state(&context, FrameId(100), 50);
        assert_eq!(tracker.state(), Tracking, "found");
        assert_eq!(tracker.relocalised_at, Some(FrameId(100)), "when");
        assert_eq!(tracker.velocity, Some(small_motion()), "not touched");
        tracker.update_state(&context, FrameId(frame), inliers);
        assert_eq!(tracker.state(), state, "{inliers} inliers in frame {frame}");
        assert_eq!(tracker.relocalised_at, Some(FrameId(100)), "stays");
        let kept = (state == Tracking).then(small_motion);
        assert_eq!(
            tracker.velocity, kept,
            "no motion is known of a lost camera"
        );
        assert_eq!(
            tracker.usual_inliers.is_some(),
            state == Tracking,
            "nor what is usual"
        );
    }
}

/// The last frame at 2 s, the next at 2.5 s.
#[test]
fn a_part_of_the_motion_so_far() {
    let world = World::new(Config::default());
    let mut last = world.frame(4, &wall());
    last.t_s = 2.0;
    let xi = Vector6::new(0.1, -0.2, 0.3, 0.04, 0.05, -0.06);
    let moving = |velocity, last: Option<&Frame>| Tracker {
        velocity,
        last: last.cloned(),
        ..Tracker::default()
    };
    let tracker = moving(Some(Se3::exp(&xi)), Some(&last));
    for (t_s, offset_s, share) in [
        (2.5, 0.125, Some(0.25)),
        (2.5, -0.125, Some(-0.25)),
        (2.5, -0.5, Some(-1.0)),
        (2.5, 0.5, Some(1.0)),
        (2.5, 0.51, None),
        (2.5, -0.51, None),
        (2.5, 0.0, None),
        (2.0, 0.125, None),
    ] {
        let found = tracker.expected_motion(t_s, offset_s);
        let off = |share: f64| (found.expect("moves").log() - share * xi).norm();
        assert_eq!(found.is_some(), share.is_some(), "{offset_s} s");
        assert!(
            share.is_none_or(|share| off(share) < 1e-12),
            "{offset_s} s: {found:?}"
        );
    }
    let unknown = moving(None, Some(&last)).expected_motion(2.5, 0.125);
    assert_eq!(unknown, None, "no motion known");
    let first = moving(Some(Se3::exp(&xi)), None).expected_motion(2.5, 0.125);
    assert_eq!(first, None, "no frame before");
}

#[test]
fn velocity_is_the_motion_from_the_last_frame() {
    let world = World::new(Config::default());
    let at = |id, pose: Se3| {
        let mut frame = world.frame_of(id, &[], &wall());
        frame.camera_from_world = pose;
        frame
    };
    let before = Se3::exp(&Vector6::new(0.3, 0.1, -0.2, 0.2, -0.1, 0.3));
    for (last, known) in [
        (Some(6), true),
        (Some(5), false),
        (Some(7), false),
        (None, false),
    ] {
        let mut tracker = Tracker {
            velocity: Some(before),
            last: last.map(|id| at(id, before)),
            ..Tracker::default()
        };
        tracker.update_velocity(&at(7, small_motion() * before));
        let off = |v: Se3| (v * small_motion().inverse()).log().norm();
        assert_eq!(tracker.velocity.is_some(), known, "after {last:?}");
        assert!(
            tracker.velocity.is_none_or(|v| off(v) < 1e-12),
            "{tracker:?}"
        );
    }
}

#[test]
fn a_reset_keeps_the_reference_alone() {
    let world = World::new(Config::default());
    let mut tracker = Tracker {
        state: TrackingState::Tracking,
        last: Some(world.frame(1, &wall())),
        velocity: Some(small_motion()),
        reference: KeyframeId(3),
        relocalised_at: Some(FrameId(1)),
        usual_inliers: Some(9.0),
        weak: true,
        shutter: ShutterModel::new(),
        gaussians: Some(Arc::new(GaussianMap::new(0))),
    };
    (tracker.shutter).update(None, &small_motion(), false);
    tracker.reset_to_lost();
    let expected = Tracker {
        state: TrackingState::Lost,
        reference: KeyframeId(3),
        ..Tracker::default()
    };
    assert_eq!(format!("{tracker:?}"), format!("{expected:?}"), "all of it");
}

/// 250 are needed; of 300 keypoints the first have no depth, the last are not in use.
#[test]
fn the_first_frame_needs_keypoints_with_depth() {
    for (without_depth, not_in_use, usable) in [(20, 30, 250), (21, 30, 0), (20, 31, 0)] {
        let mut config = Config::default();
        config.keyframes.first_min_keypoints = 250;
        let world = World::new(config);
        let mut frame = world.frame(0, &wall());
        frame.depth_m[..without_depth].fill(None);
        frame.in_use[300 - not_in_use..].fill(false);
        frame.camera_from_world = small_motion();
        let mut tracker = Tracker::default();
        let found = tracker.initialise(&world.context, &mut frame, &wall());
        assert_eq!(
            found, usable,
            "{without_depth} without depth, {not_in_use} not in use"
        );
        let is_world = frame.camera_from_world == Se3::identity();
        assert_eq!(is_world, usable > 0, "the first frame is the world");
        let tracks = tracker.state() == TrackingState::Tracking;
        assert_eq!(tracks, usable > 0, "{:?}", tracker.state());
    }
}

/// With no map handed over the pose is where constant velocity leads; a lost camera forgets its motion.
#[test]
fn by_rendering_before_the_first_map() {
    let mut config = Config::default();
    config.tracking.method = TrackingMethod::Render;
    let world = World::with_camera(uneven_camera(), config);
    let target = Target {
        camera: uneven_camera(),
        color: garad_core::Image::new(160, 120, [0.5; 3]),
        depth: Some(wall()),
        excluded: garad_core::MaskImage::new(160, 120, 0),
    };
    let before = Se3::exp(&Vector6::new(0.3, 0.1, -0.2, 0.2, -0.1, 0.3));
    let mut last = world.frame_of(0, &[], &wall());
    last.camera_from_world = before;
    for (what, last, velocity, map, expected) in [
        (
            "motion known",
            Some(&last),
            Some(small_motion()),
            None,
            Some(small_motion() * before),
        ),
        ("not known", Some(&last), None, None, Some(before)),
        ("no frame before", None, Some(small_motion()), None, None),
        (
            "an empty map",
            Some(&last),
            Some(small_motion()),
            Some(GaussianMap::new(0)),
            None,
        ),
    ] {
        let mut tracker = Tracker {
            last: last.cloned(),
            velocity,
            gaussians: map.map(Arc::new),
            ..Tracker::default()
        };
        let mut frame = world.frame_of(1, &[], &wall());
        let pixels = tracker.track_by_rendering(&world.context, &mut frame, &target);
        let pose = expected.unwrap_or_default();
        let off = (frame.camera_from_world * pose.inverse()).log().norm();
        assert!(pixels == 0 && off < 1e-12, "{what}: {off}, {pixels} pixels");
        let state = expected.map_or(TrackingState::Lost, |_| TrackingState::Tracking);
        assert_eq!(tracker.state(), state, "{what}");
        assert_eq!(
            tracker.velocity,
            velocity.filter(|_| expected.is_some()),
            "{what}"
        );
    }
}

/// Of a map of 70 landmarks, all of them seen by keyframe 0.
fn seventy() -> (World, Vec<LandmarkId>) {
    let mut world = World::with_camera(uneven_camera(), Config::default());
    let seen = world.see(0, &cloud(), &Se3::identity());
    let made = world.remember(seen, &cloud());
    (world, made)
}

/// The way of a frame: by motion or reference, else among the keyframes; stages, state, what is expected.
#[test]
fn the_first_pose_from_the_last_frame_or_from_anywhere() {
    use Stage::{Relocalise, TrackMotion};
    use TrackingState::{Lost, Tracking};
    for (what, state, has_last, known_place, found, stages, after) in [
        (
            "as before",
            Tracking,
            true,
            true,
            true,
            vec![TrackMotion],
            Tracking,
        ),
        (
            "given up, found",
            Tracking,
            false,
            true,
            true,
            vec![TrackMotion, Relocalise],
            Lost,
        ),
        (
            "given up",
            Tracking,
            false,
            false,
            false,
            vec![TrackMotion, Relocalise],
            Lost,
        ),
        (
            "lost, found",
            Lost,
            true,
            true,
            true,
            vec![Relocalise],
            Lost,
        ),
    ] {
        let (world, made) = seventy();
        let mut places = PlaceIndex::new(PlaceConfig::default(), 0).expect("valid");
        let keyframe = world.map.keyframe(KeyframeId(0));
        if known_place {
            places.add(KeyframeId(0), &keyframe.descriptors);
        }
        let mut tracker = Tracker {
            state,
            last: has_last.then(|| keyframe.clone()),
            ..Tracker::default()
        };
        let mut frame = world.see(1, &cloud(), &small_motion());
        let centre_m = small_motion().inverse().translation;
        let information = nalgebra::Matrix3::identity();
        frame.expected = Some(CentreEstimate {
            centre_m,
            information,
        });
        let (observer, recorder) = (&mut Stages::default(), &mut Recorder::default());
        let (context, map) = (&world.context, &world.map);
        let succeeds = tracker.first_pose(context, map, &places, &mut frame, observer, recorder);
        assert_eq!((succeeds, &observer.begun), (found, &stages), "{what}");
        assert_eq!(tracker.state(), after, "{what}");
        let given_up = stages == [TrackMotion, Relocalise];
        assert_eq!(frame.expected.is_none(), given_up, "{what}: expectation");
        let links: Vec<_> = made.iter().map(|id| found.then_some(*id)).collect();
        assert_eq!(frame.landmark, links, "{what}: links");
    }
}

#[test]
fn the_local_map_links_the_rest_and_counts() {
    for finished in [false, true] {
        let (mut world, made) = seventy();
        let mut frame = world.see(1, &cloud(), &small_motion());
        frame.camera_from_world = small_motion();
        for i in 0..40 {
            frame.landmark[i] = Some(made[i]);
        }
        frame.descriptors[69] = garad_features::Descriptor(frame.descriptors[69].0.map(|w| !w));
        let mut tracker = Tracker {
            reference: KeyframeId(0),
            ..Tracker::default()
        };
        let World { context, map, .. } = &mut world;
        let images = ImageStore::default();
        let (depth, recorder) = (wall(), &mut Recorder::default());
        let inliers = tracker.track_local_map(
            context,
            map,
            &images,
            &mut frame,
            (None, &depth),
            finished,
            recorder,
        );
        assert_eq!(inliers, 69, "all but the one that looks otherwise");
        let mut expected: Vec<_> = made.iter().copied().map(Some).collect();
        expected[69] = None;
        assert_eq!(frame.landmark, expected, "links");
        let once = u32::from(!finished);
        for (i, id) in made.iter().enumerate() {
            let landmark = map.landmark(*id).expect("made");
            let found = if i == 69 { 0 } else { once };
            let counted = (landmark.visible, landmark.found);
            assert_eq!(
                counted,
                (1 + once, 1 + found),
                "landmark {i}, finished: {finished}"
            );
        }
    }
}
