//! The landmarks of a box that left, and of the wall behind it.

use garad_core::{FrameId, Se3};
use nalgebra::Vector6;

use super::*;
use crate::config::Config;
use crate::dynamics::NewView;
use crate::testing::{World, is_in, places, wall, wall_behind};

/// Labels a keyframe's landmarks; returns those that changed.
fn label(world: &mut World, keyframe: KeyframeId) -> Vec<(LandmarkId, Label)> {
    let World {
        context,
        map,
        dynamics,
        ..
    } = world;
    let now = map.keyframe(keyframe).id;
    let crf = Crf::new(context.config.crf.clone()).expect("valid");
    let history = dynamics.history(context, map, now);
    let recorder = &mut Recorder::default();
    changed(label_landmarks(
        context, map, keyframe, &crf, &history, recorder,
    ))
}

fn changed(labelled: Vec<LandmarkLabel>) -> Vec<(LandmarkId, Label)> {
    let changed = labelled.into_iter().filter(|l| l.changed);
    changed.map(|l| (l.id, l.label)).collect()
}

const BOX_PX: [[usize; 2]; 2] = [[48, 112], [32, 96]];

/// Two keyframes see a box in front of a wall, each keypoint a landmark; a third sees the wall
/// alone. Returns the third and the landmarks of the box and of the wall.
fn a_box_that_left(config: Config) -> (World, KeyframeId, [Vec<LandmarkId>; 2]) {
    let mut world = World::new(config);
    let before = wall_behind(BOX_PX);
    let seen = world.frame(0, &before);
    let first = world.keep(seen, &before);
    let mut second = world.frame(10, &before);
    let mut third = world.frame(20, &wall());
    let mut of = [Vec::new(), Vec::new()];
    let scales = world.context.scales.clone();
    for (i, [x, y]) in places().into_iter().enumerate() {
        let p_world = world
            .map
            .keyframe(first)
            .world_point(i, &world.context.camera);
        let p_world = p_world.expect("no keypoint is on an edge");
        let id = world.map.add_landmark(p_world, first, i, &scales);
        let on_wall = !is_in(BOX_PX, x, y);
        second.landmark[i] = Some(id);
        third.landmark[i] = on_wall.then_some(id);
        of[usize::from(on_wall)].push(id);
    }
    world.keep(second, &before);
    let third = world.keep(third, &wall());
    (world, third, of)
}

fn alive(world: &World, ids: &[LandmarkId]) -> usize {
    let found = ids.iter().filter(|id| world.map.landmark(**id).is_some());
    found.count()
}

#[test]
fn landmarks_in_free_space_are_dynamic_and_not_searched_for() {
    let (mut world, third, [of_box, of_wall]) = a_box_that_left(Config::default());
    assert_eq!((of_box.len(), of_wall.len()), (64, 236), "both are there");
    let searched_for = |world: &World, id: LandmarkId| {
        let landmark = world.map.landmark(id).expect("alive");
        let frame = world.map.keyframe(third);
        let seen = landmark.appearance(frame, &world.context.camera, &world.context.scales);
        [seen.is_some(), world.map.static_landmark(id).is_some()]
    };
    let all = of_box.iter().chain(&of_wall);
    assert!(
        all.clone().all(|id| searched_for(&world, *id) == [true; 2]),
        "before"
    );
    let changed = label(&mut world, third);
    let expected: Vec<_> = of_box.iter().map(|id| (*id, Label::Dynamic)).collect();
    assert_eq!(changed, expected, "the whole box and nothing else");
    for id in all {
        let expected = [of_wall.contains(id); 2];
        assert_eq!(searched_for(&world, *id), expected, "{id:?}");
    }
    assert_eq!(label(&mut world, third), [], "no change the second time");
}

#[test]
fn landmarks_are_dropped_after_a_whole_window_of_dynamic_runs() {
    let mut config = Config::default();
    config.labels.window.runs = 4;
    let (mut world, third, [of_box, of_wall]) = a_box_that_left(config);
    for run in 1..=4 {
        label(&mut world, third);
        let left = if run < 4 { of_box.len() } else { 0 };
        assert_eq!(alive(&world, &of_box), left, "run {run} of 4");
    }
    assert_eq!(alive(&world, &of_wall), of_wall.len(), "the wall stays");
    for keyframe in world.map.keyframes() {
        let linked = keyframe.landmark.iter().flatten().count();
        assert_eq!(linked, of_wall.len(), "no link to what is gone");
    }
}

/// The box is back before the window is over.
#[test]
fn landmarks_found_static_again_are_kept() {
    let mut config = Config::default();
    config.labels.window.runs = 4;
    config.labels.memory_frames = 30;
    let (mut world, third, [of_box, _]) = a_box_that_left(config);
    for _ in 0..3 {
        label(&mut world, third);
    }
    let depth = wall_behind(BOX_PX);
    let mut back = world.frame(60, &depth);
    let first = world.map.keyframe(KeyframeId(0));
    back.landmark.clone_from(&first.landmark);
    let back = world.map.add_keyframe(back);
    let World {
        context,
        map,
        dynamics,
        ..
    } = &mut world;
    let recorder = &mut Recorder::default();
    let view = NewView {
        frame: map.keyframe(back),
        reference: back,
        depth: &depth,
        image: None,
        cells: None,
    };
    dynamics.add_view(context, map, view);
    let changed = changed(dynamics.label_keyframe(context, map, back, recorder));
    assert_eq!(dynamics.past.len(), 1, "30 frames of memory");
    let expected: Vec<_> = of_box.iter().map(|id| (*id, Label::Static)).collect();
    assert_eq!(changed, expected, "the box is back");
    assert_eq!(alive(&world, &of_box), of_box.len(), "and kept");
}

/// A landmark that one keyframe alone has seen keeps its label (`crf.unary.min_observations`).
#[test]
fn one_observation_changes_no_label() {
    let (mut world, third, [of_box, _]) = a_box_that_left(Config::default());
    for id in &of_box {
        world.map.drop_observation(*id, KeyframeId(1));
    }
    assert_eq!(label(&mut world, third), [], "seen by one");
}

#[test]
fn landmarks_take_the_labels_of_their_gaussians_and_go_with_them() {
    let (mut world, _, [of_box, of_wall]) = a_box_that_left(Config::default());
    let given = |id: LandmarkId, label, removed| TaggedLabel { id, label, removed };
    let [moves, gone, back] = [of_box[0], of_box[1], of_box[2]];
    let label = |world: &World, id| world.map.landmark(id).map(|l| l.label());
    let labels = [
        given(moves, Label::Dynamic, false),
        given(gone, Label::Dynamic, true),
        given(back, Label::Dynamic, false),
    ];
    take_labels_of_gaussians(&world.context, &mut world.map, &labels);
    assert_eq!(label(&world, moves), Some(Label::Dynamic), "changed");
    assert_eq!(label(&world, back), Some(Label::Dynamic), "changed");
    assert_eq!(label(&world, gone), None, "dropped");
    let linked = world.map.keyframe(KeyframeId(0)).landmark.iter();
    assert_eq!(linked.flatten().filter(|l| **l == gone).count(), 0, "link");
    let labels = [
        given(back, Label::Static, false),
        given(gone, Label::Static, false),
    ];
    take_labels_of_gaussians(&world.context, &mut world.map, &labels);
    assert_eq!(label(&world, back), Some(Label::Static), "changed back");
    assert_eq!(label(&world, gone), None, "a dropped one stays dropped");
    assert_eq!(label(&world, moves), Some(Label::Dynamic), "not named");
    assert_eq!(alive(&world, &of_wall), of_wall.len(), "not named");
}

#[test]
fn cues_are_means_over_the_keyframes() {
    let (mut world, third, [of_box, of_wall]) = a_box_that_left(Config::default());
    let cues = |world: &World, id| {
        let landmark = world.map.landmark(id).expect("alive");
        let history = world
            .dynamics
            .history(&world.context, &world.map, FrameId(20));
        landmark_cues(&world.context, &world.map, landmark, &history)
    };
    let [on_box, on_wall] = [of_box[0], of_wall[0]].map(|id| cues(&world, id));
    assert_eq!(
        [on_box.observations, on_wall.observations],
        [Some(2), Some(3)],
        "observations"
    );
    assert_eq!(on_wall.epipolar_px, None, "no baseline, no line");
    assert_eq!(on_wall.depth_residual, Some(0.0), "all agree");
    // 1.5 m in front of 3 m, where σ is 3e-3 z² = 0.027 m.
    let sigmas = on_box.depth_residual.expect("seen through");
    assert!((sigmas - 1.5 / 0.027).abs() < 1e-9, "{sigmas} σ");
    let observations = &world.map.landmark(of_wall[0]).expect("alive").observations;
    let (_, i) = *observations.last().expect("three");
    world.map.keyframe_mut(third).uv_px[i].x += 3.0;
    let off = cues(&world, of_wall[0]).reproj_px.expect("seen");
    assert!((off - 1.0).abs() < 1e-9, "3 px in one of three: {off}");
    // The third camera a metre to the right: epipolar lines are rows.
    world.map.keyframe_mut(third).uv_px[i].y += 2.0;
    let keyframe = world.map.keyframe_mut(third);
    keyframe.camera_from_world.translation.x = -1.0;
    let off = cues(&world, of_wall[0]).epipolar_px.expect("a baseline");
    assert!((off - 2.0).abs() < 1e-9, "two rows off: {off}");
    // Aside, ahead and turned, and the keypoint where the landmark is: its line passes through it.
    let p_world = world.map.landmark(of_wall[0]).expect("alive").p_world;
    let pose = Se3::exp(&Vector6::new(-0.5, 0.1, -0.5, 0.02, -0.1, 0.05));
    let uv = world
        .context
        .camera
        .project(&(pose * p_world))
        .expect("in front");
    let keyframe = world.map.keyframe_mut(third);
    keyframe.camera_from_world = pose;
    keyframe.uv_px[i] = uv;
    let on = cues(&world, of_wall[0]).epipolar_px.expect("a baseline");
    assert!(on < 1e-9, "{on} px from its line");
}

/// Of three keyframes the first two see landmark 1 and the last two landmark 3; 0, 2 and 4 are seen by one each, and 2
/// is outside of the first image. The second camera is 0.3 m to the right of the first.
#[test]
fn local_landmarks_are_those_of_the_keyframe_and_of_its_neighbours_where_it_sees_them() {
    let mut world = World::new(Config::default());
    let World { context, map, .. } = &mut world;
    let links: [&[usize]; 3] = [&[1, 0], &[3, 2, 1], &[4, 3]];
    let points = [
        [0.0, 0.0, 3.0],
        [0.3, 0.2, 3.0],
        [2.2, 0.0, 3.0],
        [-0.6, 0.1, 2.0],
        [0.1, 0.1, 2.0],
    ];
    let mut ids: Vec<Option<LandmarkId>> = vec![None; 5];
    for (k, links) in links.iter().enumerate() {
        let mut frame = World::new(Config::default()).frame(10, &wall());
        let x = if k == 1 { -0.3 } else { 0.0 };
        frame.camera_from_world = Se3::exp(&Vector6::new(x, 0.0, 0.0, 0.0, 0.0, 0.0));
        for (i, link) in links.iter().enumerate() {
            frame.landmark[i] = ids[*link];
        }
        let keyframe = map.add_keyframe(frame);
        for (i, link) in links.iter().enumerate() {
            let p_world = points[*link].into();
            let new = || map.add_landmark(p_world, keyframe, i, &context.scales);
            ids[*link] = Some(ids[*link].unwrap_or_else(new));
        }
    }
    let history = world
        .dynamics
        .history(&world.context, &world.map, FrameId(10));
    let local = |keyframe| {
        let found = local_cues(&world.context, &world.map, KeyframeId(keyframe), &history);
        let points = found.iter().map(|cues| {
            let link = ids.iter().position(|id| *id == Some(cues.id));
            (link.expect("one of the five"), cues.uv_px)
        });
        points.collect::<Vec<_>>()
    };
    for (keyframe, links, shift_px) in [
        (0, vec![1, 0, 3], 0.0),
        (1, vec![1, 0, 3, 2, 4], 0.3 * 120.0),
        (2, vec![1, 3, 4], 0.0),
    ] {
        let found = local(keyframe);
        let found_links: Vec<usize> = found.iter().map(|(link, _)| *link).collect();
        assert_eq!(
            found_links, links,
            "keyframe {keyframe}: in order of their ids"
        );
        for (link, uv_px) in found {
            let [x, y, z] = points[link];
            let shift_px = shift_px / z;
            let expected = Vector2::new(79.5 + 120.0 * x / z - shift_px, 59.5 + 120.0 * y / z);
            assert!((uv_px - expected).norm() < 1e-9, "{link}: {uv_px}");
        }
    }
}

/// Seen by one keyframe, a landmark keeps the label it has.
#[test]
fn one_observation_keeps_a_dynamic_label() {
    let (mut world, third, [of_box, of_wall]) = a_box_that_left(Config::default());
    let given = |id: &LandmarkId| TaggedLabel {
        id: *id,
        label: Label::Dynamic,
        removed: false,
    };
    let alone = &of_wall[..20];
    let labels: Vec<_> = alone.iter().map(given).collect();
    take_labels_of_gaussians(&world.context, &mut world.map, &labels);
    for id in alone {
        world.map.drop_observation(*id, KeyframeId(0));
        world.map.drop_observation(*id, KeyframeId(1));
    }
    let changed = label(&mut world, third);
    assert!(
        changed.iter().all(|(id, _)| of_box.contains(id)),
        "{changed:?}"
    );
    let still = alone
        .iter()
        .map(|id| world.map.landmark(*id).expect("alive").label());
    assert!(still.into_iter().all(|l| l == Label::Dynamic), "as before");
}
