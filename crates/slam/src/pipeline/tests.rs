//! The order of stages, hand-overs, and what counts from frame to frame.

use garad_core::{GrayImage, LandmarkId, MaskImage, RgbImage, Se3};
use nalgebra::Vector3;

use super::*;
use crate::testing::{Stages, World, texture, uneven_camera, wall};

/// A keyframe in four frames, handed over two frames later; no training.
fn config() -> Config {
    let mut config = Config::default();
    (config.features.count, config.features.levels) = (200, 3);
    let k = &mut config.keyframes;
    (k.first_min_keypoints, k.min_gap, k.max_gap) = (50, 1, 4);
    (k.tracked_share, k.close_tracked_min) = (0.5, 0);
    let t = &mut config.tracking;
    (t.min_inliers, t.min_inliers_after_recovery) = (20, 25);
    config.schedule.handover_frames = 2;
    (config.train.per_keyframe, config.train.per_frame) = (0, 0);
    config.labels.bootstrap_restart = false;
    config
}

fn slam(config: Config) -> Slam {
    Slam::new(uneven_camera(), config, 0, Par::Seq).expect("valid")
}

fn rgb(gray: &GrayImage) -> RgbImage {
    RgbImage::from_fn(160, 120, |x, y| [gray[(x, y)]; 3])
}

/// Frame k at k / 10 s.
fn process(
    slam: &mut Slam,
    k: u32,
    rgb: &RgbImage,
    mask: Option<&MaskImage>,
) -> (FrameReport, Vec<Stage>) {
    let (depth, mut stages) = (wall(), Stages::default());
    let t_s = f64::from(k) / 10.0;
    let input = FrameInput {
        t_s,
        depth_t_s: t_s,
        rgb,
        depth: &depth,
        mask,
    };
    let report = slam.process(&input, &mut stages).expect("sizes fit");
    assert_eq!(
        (report.id, Some(report.t_s)),
        (FrameId(k), Some(t_s)),
        "frame"
    );
    (report, stages.begun)
}

/// Frames 5 and 6 show nothing. The jobs of keyframes 0 and 4 are due at frames 2 and 6.
#[test]
fn stages_of_each_frame() {
    use Stage::{
        Handover, Keyframe, Label, LabelMap, LocalBa, Loop, Orb, Relocalise, TrackLocalMap,
        TrackMotion,
    };
    let tracked = [Orb, TrackMotion, Label, TrackLocalMap];
    let keyframe = [Keyframe, LabelMap, LocalBa, Loop];
    let expected = [
        [&[Orb, Label][..], &keyframe].concat(),
        tracked.to_vec(),
        [&[Handover][..], &tracked].concat(),
        tracked.to_vec(),
        [&tracked[..], &keyframe].concat(),
        vec![Orb, TrackMotion, Relocalise],
        vec![Handover, Orb, Relocalise],
        vec![Orb, Relocalise, Label, TrackLocalMap],
        [&tracked[..], &keyframe].concat(),
    ];
    let (textured, blank) = (rgb(&texture()), rgb(&GrayImage::new(160, 120, 90)));
    let mut config = config();
    (config.subpixel.keyframes, config.depth_planes.keyframes) = (2, 1);
    let mut slam = slam(config);
    let (mut tracked, mut keyframes) = (0, 0);
    for (k, stages) in (0..).zip(expected) {
        let is_blank = k == 5 || k == 6;
        let image = if is_blank { &blank } else { &textured };
        let (report, begun) = process(&mut slam, k, image, None);
        assert_eq!(begun, stages, "frame {k}");
        let state = if is_blank {
            TrackingState::Lost
        } else {
            TrackingState::Tracking
        };
        assert_eq!((report.state, report.weak), (state, false), "frame {k}");
        assert_eq!(
            report.camera_from_world.is_some(),
            !is_blank,
            "frame {k}: pose"
        );
        assert_eq!(
            report.inliers > 100,
            !is_blank,
            "frame {k}: {} inliers",
            report.inliers
        );
        assert_eq!(
            report.keypoints > 100,
            !is_blank,
            "frame {k}: {} keypoints",
            report.keypoints
        );
        let becomes = k % 4 == 0;
        (tracked, keyframes) = (
            tracked + usize::from(!is_blank),
            keyframes + u32::from(becomes),
        );
        let id = becomes.then(|| KeyframeId(keyframes - 1));
        assert_eq!(report.keyframe, id, "frame {k}: keyframe");
        let most = slam.keyframing.most_inliers;
        assert_eq!(
            most == 0,
            becomes || is_blank,
            "frame {k}: {most} is the most since the last keyframe"
        );
        assert_eq!(
            slam.trajectory.as_tracked(&slam.map).len(),
            tracked,
            "frame {k}: path"
        );
        let handed_over = usize::from(k >= 2) + usize::from(k >= 6);
        assert_eq!(
            slam.mapping.done().len(),
            handed_over,
            "frame {k}: jobs handed over"
        );
        let places = u32::try_from(slam.places.len()).expect("few");
        assert_eq!(places, keyframes, "frame {k}: places");
        let last = slam.tracker.last().expect("tracked").id;
        assert_eq!(
            last.0,
            if is_blank { 4 } else { k },
            "frame {k}: the last tracked one"
        );
        assert_eq!(
            slam.tracker.reference(),
            KeyframeId(keyframes - 1),
            "frame {k}: reference"
        );
        let expected = slam.tracker.last().expect("tracked").expected.is_some();
        // Three frames before this one, none of them lost.
        assert!(
            becomes || is_blank || expected == (k == 3),
            "frame {k}: expected: {expected}"
        );
    }
    let images: Vec<_> = slam.images.keyframes().map(|k| k.0).collect();
    assert_eq!(images, [1, 2], "of the two youngest");
    let planes = slam
        .map
        .keyframes()
        .iter()
        .map(|k| k.depth_planes.is_some());
    assert_eq!(
        planes.collect::<Vec<_>>(),
        [false, false, true],
        "of the youngest"
    );
}

/// Free space of every keyframe, and of a frame three frames after the last one kept.
#[test]
fn frames_between_keyframes_enter_the_history() {
    let mask = MaskImage::new(160, 120, 0);
    let textured = rgb(&texture());
    let cases: [(&str, bool, _, bool, &[u32]); 4] = [
        ("as it is", true, None, false, &[0, 3, 6]),
        ("a finished map", true, None, true, &[0]),
        ("a mask is given", true, Some(&mask), false, &[0]),
        ("no labels", false, None, false, &[]),
    ];
    for (what, enabled, mask, localising, expected) in cases {
        let mut config = config();
        config.keyframes.max_gap = 50;
        (config.labels.history_gap, config.labels.enabled) = (3, enabled);
        let mut slam = slam(config);
        process(&mut slam, 0, &textured, None);
        slam.localising = localising;
        for k in 1..8 {
            let (report, _) = process(&mut slam, k, &textured, mask);
            assert_eq!(report.state, TrackingState::Tracking, "{what}: frame {k}");
        }
        let kept: Vec<_> = slam.dynamics.past.iter().map(|view| view.frame.0).collect();
        assert_eq!(kept, expected, "{what}");
    }
}

/// With a mask, or without labels, nothing is labelled.
#[test]
fn a_given_mask_is_the_label() {
    let mask = MaskImage::from_fn(160, 120, |x, _| if x < 60 { 255 } else { 0 });
    let textured = rgb(&texture());
    let mut unlabelled = config();
    unlabelled.labels.enabled = false;
    for (what, config, mask) in [("mask", config(), Some(&mask)), ("off", unlabelled, None)] {
        let mut slam = slam(config);
        for k in 0..2 {
            let (report, begun) = process(&mut slam, k, &textured, mask);
            let labels = [Stage::Label, Stage::LabelMap];
            assert!(
                !begun.iter().any(|s| labels.contains(s)),
                "{what}: {begun:?}"
            );
            let last = slam.tracker.last().expect("tracked");
            let inside = last
                .px
                .iter()
                .filter(|p| mask.is_some() && p.x < 59.5)
                .count();
            assert_eq!(report.dynamic_keypoints, inside, "{what}: inside the mask");
            assert_eq!(inside > 20, mask.is_some(), "{what}: {inside}");
            assert!(slam.labelled.is_none(), "{what}: no labels of our own");
        }
    }
}

#[test]
fn a_frame_of_another_size_counts_and_changes_nothing() {
    let mut slam = slam(config());
    let (small, depth) = (RgbImage::new(80, 60, [9; 3]), wall());
    let input = FrameInput {
        t_s: 0.0,
        depth_t_s: 0.0,
        rgb: &small,
        depth: &depth,
        mask: None,
    };
    let mut stages = Stages::default();
    slam.process(&input, &mut stages).expect_err("too small");
    assert!(stages.begun.is_empty(), "{stages:?}");
    assert_eq!(slam.tracker.state(), TrackingState::NotInitialised, "state");
    let (report, _) = process(&mut slam, 1, &rgb(&texture()), None);
    assert_eq!(report.state, TrackingState::Tracking, "the next frame");
}

/// Less than half of the most inliers since the last keyframe: (frame, inliers, becomes one, most after it).
#[test]
fn most_inliers_since_the_last_keyframe() {
    let world = World::with_camera(uneven_camera(), config());
    let frame = |id| world.frame(id, &wall());
    let mut slam = slam(config());
    assert!(slam.becomes_keyframe(&frame(0), 40), "the first one");
    assert_eq!(slam.keyframing.most_inliers, 0, "begins anew");
    slam.map.add_keyframe(frame(0));
    for (id, inliers, becomes, most) in [
        (1, 80, false, 80),
        (2, 100, false, 100),
        (3, 50, false, 100),
        (3, 49, true, 0),
        (3, 49, false, 49),
        (4, 49, true, 0),
    ] {
        let found = slam.becomes_keyframe(&frame(id), inliers);
        assert_eq!(found, becomes, "frame {id}, {inliers} inliers");
        assert_eq!(slam.keyframing.most_inliers, most, "frame {id}");
    }
    slam.localising = true;
    assert!(!slam.becomes_keyframe(&frame(9), 70), "the map is finished");
    slam.localising = false;
    for inliers in [400, 190] {
        slam.tracker
            .update_state(&world.context, FrameId(9), inliers);
    }
    assert!(!slam.becomes_keyframe(&frame(9), 70), "a weak frame");
    assert_eq!(slam.keyframing.most_inliers, 70, "counted all the same");
}

/// In 0.1 s the camera went 0.2 m towards a wall that is 3 m away when depth is taken.
#[test]
fn depth_is_brought_to_the_time_of_colour() {
    for (sync, depth_t_s, expected) in [
        (true, 0.25, 3.1),
        (true, 0.175, 2.95),
        (true, 0.2, 3.0),
        (false, 0.25, 3.0),
    ] {
        let mut config = config();
        config.features.sync_depth = sync;
        let world = World::with_camera(uneven_camera(), config.clone());
        let mut slam = slam(config);
        for (id, t_s, step_m) in [(0, 0.0, 0.0), (1, 0.1, -0.2)] {
            let mut frame = world.frame_of(id, &[], &wall());
            frame.t_s = t_s;
            frame.camera_from_world =
                Se3::new(garad_core::So3::identity(), Vector3::new(0.0, 0.0, step_m));
            slam.tracker.update_velocity(&frame);
            slam.tracker.set_last(frame);
        }
        let (rgb, depth) = (RgbImage::new(160, 120, [9; 3]), wall());
        let input = FrameInput {
            t_s: 0.2,
            depth_t_s,
            rgb: &rgb,
            depth: &depth,
            mask: None,
        };
        let found = slam.depth_at_colour_time(&input)[(70, 50)];
        assert!(
            (f64::from(found) - expected).abs() < 1e-5,
            "{depth_t_s} s: {found} m"
        );
    }
}

#[test]
fn feedback_moves_landmarks() {
    let mut world = World::with_camera(uneven_camera(), config());
    let points = crate::testing::cloud();
    let seen = world.see(0, &points, &Se3::identity());
    world.remember(seen, &points);
    let mut slam = slam(config());
    slam.map = world.map;
    let p_world = Vector3::new(0.25, -0.5, 2.5);
    let feedback = MapFeedback {
        positions: vec![(LandmarkId(3), p_world), (LandmarkId(99), p_world)],
        ..MapFeedback::default()
    };
    slam.take_feedback(feedback);
    let moved = slam.map.landmark(LandmarkId(3)).expect("there");
    assert_eq!(moved.p_world, p_world, "position");
    let off = (moved.view_direction - p_world.normalize()).norm();
    assert!(off < 1e-12, "what follows from it: {off}");
    let other = slam.map.landmark(LandmarkId(4)).expect("there");
    assert_eq!(other.p_world, points[4], "no other");
}
