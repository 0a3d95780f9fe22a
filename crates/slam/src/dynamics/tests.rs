//! What the labels keep from frame to frame, against a camera before a wall at 3 m, or a box at half the way to it.

use Label::{Dynamic, Static};
use garad_core::{GrayImage, Label, NewGaussian, Real, RgbImage, Se3};
use garad_features::Descriptor;
use nalgebra::{Vector2, Vector6};

use super::*;
use crate::config::Config;
use crate::testing::{World, places, wall, wall_behind};

/// 16 x 16 cells of 1200.
const BOX_PX: [[usize; 2]; 2] = [[48, 112], [32, 96]];

/// Five frames of bootstrap, a memory of 30 frames, images of up to 6 + 2 frames.
fn config() -> Config {
    let mut config = Config::default();
    let labels = &mut config.labels;
    labels.bootstrap_frames = 5;
    labels.memory_frames = 30;
    labels.history_gap = 4;
    labels.patch_motion.ages_frames = [5, 6, 4];
    config
}

fn future_view(frame: u32) -> FutureView {
    FutureView {
        frame: FrameId(frame),
        free_space: FreeSpace::new(&wall(), 8.0),
        pyramid: None,
        camera_from_world: Se3::exp(&Vector6::new(0.1, 0.2, 0.3, 0.0, 0.1, 0.0)),
    }
}

/// Adds the view of a frame that is no keyframe, and returns its pose; keyframe 0 must be there.
fn see(world: &mut World, id: u32) -> Se3 {
    let mut frame = world.frame_of(id, &[], &wall());
    let t = f64::from(id);
    frame.camera_from_world = Se3::exp(&Vector6::new(0.01 * t, 0.1, 0.0, 0.02, 0.0, 0.003 * t));
    let image = LkPyramid::new(&GrayImage::new(160, 120, 90), 1).expect("an image");
    let view = NewView {
        frame: &frame,
        reference: KeyframeId(0),
        depth: &wall(),
        image: Some(&Arc::new(image)),
        cells: None,
    };
    (world.dynamics).add_view(&world.context, &world.map, view);
    frame.camera_from_world
}

/// A keyframe beside the origin, and no view.
fn world() -> World {
    let mut world = World::new(config());
    let mut keyframe = world.frame(0, &wall());
    keyframe.camera_from_world = Se3::exp(&Vector6::new(0.3, -0.1, 0.2, 0.1, -0.2, 0.05));
    world.map.add_keyframe(keyframe);
    world
}

#[test]
fn a_run_may_restart_where_the_field_labels_its_first_frames() {
    use LabelSource::{Both, Flow, Frames, Gaussians};
    for (enabled, restart, source, expected) in [
        (true, true, Frames, true),
        (true, true, Gaussians, true),
        (true, true, Both, true),
        (true, true, Flow, false),
        (true, false, Frames, false),
        (false, true, Frames, false),
    ] {
        let mut config = config();
        config.labels.enabled = enabled;
        config.labels.bootstrap_restart = restart;
        config.labels.source = source;
        let mut world = World::new(config);
        let what = format!("{enabled}, {restart}, {source:?}");
        assert_eq!(world.dynamics.may_restart(), expected, "{what}");
        let again = Dynamics::restarted(&world.context, vec![future_view(4)]).expect("valid");
        assert!(!again.may_restart(), "once: {what}");
        assert_eq!(again.future.len(), 1, "{what}");
        world.dynamics.end_bootstrap();
        assert!(!world.dynamics.may_restart(), "{what}");
    }
}

#[test]
fn views_are_added_with_a_gap() {
    let mut world = world();
    let wants = |world: &World, frame| (world.dynamics).wants_view(&world.context, FrameId(frame));
    assert!(!wants(&world, 20), "none before the first keyframe's");
    for (last, young, old) in [(10, 13, 14), (21, 24, 25)] {
        see(&mut world, last);
        assert!(!wants(&world, young), "{young} after {last}");
        assert!(wants(&world, old), "{old} after {last}");
    }
}

/// Free space is kept for 30 frames, images for 8.
#[test]
fn old_views_and_old_images_are_dropped() {
    let mut world = world();
    let steps: [(u32, &[u32], &[u32]); 6] = [
        (10, &[10], &[10]),
        (18, &[10, 18], &[10, 18]),
        (19, &[10, 18, 19], &[18, 19]),
        (40, &[10, 18, 19, 40], &[40]),
        (41, &[18, 19, 40, 41], &[40, 41]),
        (90, &[90], &[90]),
    ];
    for (id, kept, with_image) in steps {
        see(&mut world, id);
        let past = &world.dynamics.past;
        let frames: Vec<u32> = past.iter().map(|view| view.frame.0).collect();
        assert_eq!(frames, kept, "views after frame {id}");
        let images = past.iter().filter(|view| view.image.is_some());
        let images: Vec<u32> = images.map(|view| view.frame.0).collect();
        assert_eq!(images, with_image, "images after frame {id}");
    }
}

/// A view keeps where its frame stood beside its keyframe, and goes with it.
#[test]
fn the_history_is_that_of_the_last_frames_and_of_future_views() {
    let mut world = world();
    let seen = [18, 19, 40].map(|id| see(&mut world, id));
    world.dynamics.future = vec![future_view(50), future_view(41)];
    for (now, ages) in [
        (40, vec![22, 21, 0, 10, 1]),
        (48, vec![30, 29, 8, 2, 7]),
        (49, vec![30, 9, 1, 8]),
        (71, vec![21, 30]),
    ] {
        let history = (world.dynamics).history(&world.context, &world.map, FrameId(now));
        let found: Vec<u32> = history.views.iter().map(|view| view.age_frames).collect();
        assert_eq!(found, ages, "frame {now}");
    }
    let keyframe = world.map.keyframe_mut(KeyframeId(0));
    let before = keyframe.camera_from_world;
    let moved = Se3::exp(&Vector6::new(0.2, 0.1, -0.4, 0.3, 0.2, -0.1));
    for world_from_old_world in [Se3::identity(), moved] {
        let keyframe = world.map.keyframe_mut(KeyframeId(0));
        keyframe.camera_from_world = before * world_from_old_world.inverse();
        let history = (world.dynamics).history(&world.context, &world.map, FrameId(45));
        let poses = history.views.iter().map(|view| view.camera_from_world);
        let past = seen.map(|pose| pose * world_from_old_world.inverse());
        let future = [future_view(0).camera_from_world; 2];
        let expected: Vec<Se3> = past.into_iter().chain(future).collect();
        assert_eq!(history.views.len(), 5, "views");
        for (k, (found, expected)) in poses.zip(expected).enumerate() {
            let off = (found * expected.inverse()).log().norm();
            assert!(off < 1e-12, "view {k}: {off}");
        }
    }
    world.dynamics.drop_future();
    assert_eq!(world.dynamics.past.len(), 3, "the past stays");
    world.dynamics.clear();
    let history = (world.dynamics).history(&world.context, &world.map, FrameId(45));
    assert!(history.views.is_empty(), "nothing is left");
    assert!(!world.dynamics.may_restart(), "and no restart");
}

/// What moves in a view hides what is behind it, and depth counts up to its limit.
#[test]
fn a_view_has_its_mask_and_the_range_of_the_sensor() {
    for (max_depth_m, cells, residual) in [
        (8.0, None, Some(0.0)),
        (8.0, Some(MaskImage::new(40, 30, MOVING)), None),
        (2.5, None, None),
    ] {
        let mut world = world();
        world.context.config.features.max_depth_m = max_depth_m;
        let frame = world.frame_of(7, &[], &wall());
        let view = NewView {
            frame: &frame,
            reference: KeyframeId(0),
            depth: &wall(),
            image: None,
            cells: cells.as_ref(),
        };
        (world.dynamics).add_view(&world.context, &world.map, view);
        let history = (world.dynamics).history(&world.context, &world.map, FrameId(9));
        let found = history.query(&nalgebra::Vector3::new(0.0, 0.0, 3.0));
        assert_eq!(found.residual, residual, "up to {max_depth_m} m");
    }
}

/// Nothing is labelled in the first five frames, unless the frames after them are known.
#[test]
fn labels_begin_after_the_bootstrap() {
    for (frame, has_future, labelled) in [(4, false, false), (5, false, true), (4, true, true)] {
        let mut world = World::new(config());
        let first = world.frame(0, &wall());
        let first = world.keep(first, &wall());
        let scales = world.context.scales.clone();
        let p_world = world
            .map
            .keyframe(first)
            .world_point(30, &world.context.camera);
        let id = (world.map).add_landmark(p_world.expect("on the wall"), first, 30, &scales);
        let mut second = world.frame(frame, &wall());
        second.landmark[30] = Some(id);
        let second = world.keep(second, &wall());
        if has_future {
            world.dynamics.future.push(future_view(9));
        }
        let mut now = world.frame(frame, &wall());
        let what = format!("frame {frame}, future: {has_future}");
        let cells = world.label(&mut now, &wall(), None);
        assert_eq!(cells.is_some(), labelled, "frame: {what}");
        let World {
            context,
            map,
            dynamics,
        } = &mut world;
        let cues = dynamics.local_cues(context, map, second);
        assert_eq!(cues.len(), usize::from(labelled), "cues: {what}");
        let labels = dynamics.label_keyframe(context, map, second, &mut Recorder::default());
        assert_eq!(labels.len(), usize::from(labelled), "landmarks: {what}");
    }
}

#[test]
fn restored_landmarks_are_handed_over_once() {
    let mut dynamics = World::new(config()).dynamics;
    dynamics.restore(&[LandmarkId(3), LandmarkId(1)]);
    dynamics.restore(&[]);
    dynamics.restore(&[LandmarkId(1), LandmarkId(7)]);
    let restored: Vec<u32> = dynamics.take_restored().iter().map(|id| id.0).collect();
    assert_eq!(restored, [1, 3, 7]);
    assert!(dynamics.take_restored().is_empty(), "taken");
}

/// A Gaussian at a pixel, on the wall.
fn spot(world: &World, x: f64, y: f64) -> GaussianMap {
    let mean = world.context.camera.unproject(&Vector2::new(x, y), 3.0);
    let mut map = GaussianMap::new(0);
    map.push(&NewGaussian {
        mean: mean.map(Real::to_f32).into(),
        sigma_m: 0.2,
        opacity: 0.95,
        color: [0.5; 3],
        landmark: None,
        born: KeyframeId(0),
    });
    map
}

/// A wall was seen, and now a box is before it; a dynamic Gaussian covers the left edge of the image beside the box.
#[test]
fn the_source_says_who_labels_a_frame() {
    use LabelSource::{Both, Flow, Frames, Gaussians};
    let [of_box, of_spot] = [(80.0, 60.0), (12.0, 60.0)].map(|(x, y)| Vector2::new(x, y));
    for (source, has_future, expected) in [
        (Frames, false, Some([Dynamic, Static])),
        (Gaussians, false, Some([Static, Dynamic])),
        (Gaussians, true, Some([Dynamic, Dynamic])),
        (Both, false, Some([Dynamic, Dynamic])),
        (Flow, false, None),
    ] {
        let mut config = config();
        config.labels.source = source;
        let mut world = World::new(config);
        let depth = wall_behind(BOX_PX);
        let spot = spot(&world, 12.0, 60.0);
        let World {
            context,
            map,
            dynamics,
        } = &mut world;
        dynamics.take_feedback(context, map, &[], Some(spot));
        let mut now = world.frame(20, &depth);
        let what = format!("{source:?}, future: {has_future}");
        assert_eq!(world.label(&mut now, &depth, None), None, "no view: {what}");
        let seen = world.frame(10, &wall());
        world.keep(seen, &wall());
        if has_future {
            world.dynamics.future.push(FutureView {
                camera_from_world: Se3::identity(),
                ..future_view(30)
            });
        }
        let cells = world.label(&mut now, &depth, None);
        let at = [of_box, of_spot].map(|at| cells.as_ref().map(|cells| mask::label_at(cells, &at)));
        assert_eq!(at, [0, 1].map(|k| expected.map(|e| e[k])), "cells: {what}");
        for (k, [x, y]) in [[76, 60], [12, 60]].into_iter().enumerate() {
            let i = places()
                .iter()
                .position(|at| *at == [x, y])
                .expect("a keypoint");
            let label = expected.map_or(Static, |e| e[k]);
            assert_eq!(now.label[i], label, "({x}, {y}): {what}");
            assert_eq!(now.in_use[i], label == Static, "({x}, {y}): {what}");
        }

        let World {
            context,
            map,
            dynamics,
        } = &mut world;
        dynamics.take_feedback(context, map, &[], None);
        let cells = world.label(&mut now, &depth, None);
        let at_spot = cells.map(|cells| mask::label_at(&cells, &of_spot));
        assert_eq!(
            at_spot,
            expected.map(|_| Static),
            "none handed over: {what}"
        );
    }
}

#[test]
fn landmarks_take_the_labels_that_are_handed_over() {
    let mut world = world();
    let scales = world.context.scales.clone();
    let at = nalgebra::Vector3::new(0.0, 0.0, 3.0);
    let ids = [0, 1].map(|i| world.map.add_landmark(at, KeyframeId(0), i, &scales));
    let labels = [TaggedLabel {
        id: ids[1],
        label: Dynamic,
        removed: false,
    }];
    let World {
        context,
        map,
        dynamics,
    } = &mut world;
    dynamics.take_feedback(context, map, &labels, None);
    let found = ids.map(|id| map.landmark(id).expect("alive").label());
    assert_eq!(found, [Static, Dynamic]);
}

/// Buffers frames with plain images, each with a state after it; the numbers of buffered frames, `None` once there is no
/// buffer.
fn buffered(states: &[TrackingState]) -> Vec<Option<usize>> {
    let mut config = config();
    config.labels.bootstrap_frames = 3;
    let mut world = World::new(config);
    let (rgb, depth) = (RgbImage::new(160, 120, [90; 3]), wall());
    let World {
        context,
        map,
        dynamics,
    } = &mut world;
    let mut counts = Vec::new();
    for (id, state) in (0u32..).zip(states) {
        let frame = World::new(Config::default()).frame_of(id, &[], &depth);
        let input = FrameInput {
            t_s: f64::from(id),
            depth_t_s: f64::from(id),
            rgb: &rgb,
            depth: &depth,
            mask: None,
        };
        dynamics.buffer_frame(&input, &frame);
        let restart = dynamics.check_bootstrap(context, *state, map, &mut Recorder::default());
        assert!(restart.is_none(), "nothing moves");
        counts.push(
            dynamics
                .bootstrap
                .as_ref()
                .map(|buffer| buffer.frames.len()),
        );
    }
    counts
}

/// The buffer is checked with three frames. A run that has not begun begins again, and one that is lost is not restarted.
#[test]
fn the_buffer_is_checked_when_it_is_full() {
    use TrackingState::{Lost, NotInitialised, Tracking};
    let none: Option<usize> = None;
    for (states, expected) in [
        (vec![Tracking; 4], vec![Some(1), Some(2), none, none]),
        (
            vec![Tracking, NotInitialised, Tracking, Tracking, Tracking],
            vec![Some(1), Some(0), Some(1), Some(2), none],
        ),
        (
            vec![
                NotInitialised,
                NotInitialised,
                NotInitialised,
                NotInitialised,
            ],
            vec![Some(0); 4],
        ),
        (vec![Tracking, Lost, Tracking], vec![Some(1), none, none]),
    ] {
        assert_eq!(buffered(&states), expected, "{states:?}");
    }
}

/// A box stands before the wall in the first of four frames alone, or not at all; 1 and 6 blocks of 16 cells are 1.3 and
/// 8 of 100.
#[test]
fn a_run_restarts_if_two_in_a_hundred_cells_of_the_first_frame_move() {
    for (box_px, expected) in [
        ([[0, 0], [0, 0]], None),
        ([[64, 80], [48, 64]], None),
        ([[64, 112], [48, 80]], Some(vec![13, 16])),
    ] {
        let mut config = config();
        config.labels.bootstrap_frames = 4;
        config.labels.patch_motion.enabled = false;
        let mut world = World::new(config);
        let rgb = RgbImage::new(160, 120, [90; 3]);
        let mut rng = garad_core::Rng::new(5);
        let descriptors: Vec<Descriptor> = (0..300)
            .map(|_| Descriptor([0; 4].map(|_| rng.next_u64())))
            .collect();
        let mut restart = None;
        for (k, id) in [10, 11, 13, 16].into_iter().enumerate() {
            let depth = if k == 0 { wall_behind(box_px) } else { wall() };
            let mut frame = world.frame(id, &depth);
            frame.descriptors.clone_from(&descriptors);
            let input = FrameInput {
                t_s: f64::from(id),
                depth_t_s: f64::from(id),
                rgb: &rgb,
                depth: &depth,
                mask: None,
            };
            let World {
                context,
                map,
                dynamics,
            } = &mut world;
            dynamics.buffer_frame(&input, &frame);
            let recorder = &mut Recorder::default();
            restart = dynamics.check_bootstrap(context, TrackingState::Tracking, map, recorder);
            assert_eq!(dynamics.may_restart(), k < 3, "after frame {id}");
            assert!(k == 3 || restart.is_none(), "after frame {id}");
        }
        let found = restart.map(|(buffer, future)| {
            let buffered: Vec<u32> = buffer.frames.iter().map(|b| b.frame.id.0).collect();
            assert_eq!(buffered, [10, 11, 13, 16], "in order");
            let at = buffer.frames[2].input();
            assert_eq!((at.t_s, at.depth_t_s), (13.0, 13.0), "at its time");
            assert!(at.mask.is_none() && *at.depth == wall(), "as it came");
            future.iter().map(|view| view.frame.0).collect::<Vec<_>>()
        });
        assert_eq!(found, expected, "{box_px:?}");
    }
}

/// Two masks of four keypoints and four cells.
#[test]
fn in_a_union_what_moves_in_either_moves() {
    let labels =
        |label: [Label; 4], in_use: [bool; 4], cells: [u8; 4], restored: u32| FrameLabels {
            label: label.to_vec(),
            in_use: in_use.to_vec(),
            cells: MaskImage::from_vec(4, 1, cells.to_vec()).expect("four cells"),
            restored: vec![LandmarkId(restored)],
        };
    let by_field = labels(
        [Static, Dynamic, Static, Dynamic],
        [true, false, true, false],
        [0, MOVING, 0, MOVING],
        1,
    );
    let by_mask = labels(
        [Static, Static, Dynamic, Dynamic],
        [true, true, false, false],
        [0, 0, MOVING, MOVING],
        2,
    );
    let both = labels(
        [Static, Dynamic, Dynamic, Dynamic],
        [true, false, false, false],
        [0, MOVING, MOVING, MOVING],
        2,
    );
    assert_eq!(by_field.union(by_mask), both, "the mask's landmarks");
}
