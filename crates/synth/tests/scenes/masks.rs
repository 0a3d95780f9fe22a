//! Masks, twins and backgrounds.

use garad_core::Par;
use garad_synth::{Scene, SceneName, SynthFrame};
use nalgebra::Vector2;

use crate::support::{pixels, scene, world_point};

/// Depth differs from the twin on the pixels of moving objects only; colour also at their outlines, where
/// corners of pixels are shared.
#[test]
fn a_scene_and_its_twin_differ_where_a_mover_is() {
    let scene = scene(SceneName::Walking, 200);
    let (with, without) = (
        scene.frame(45, Par::Seq),
        scene.static_twin().frame(45, Par::Seq),
    );
    assert_eq!(
        with.world_from_camera, without.world_from_camera,
        "same path"
    );
    let covered = with.object.data().iter().filter(|&&id| id > 0).count();
    assert!(covered > 3000, "{covered} pixels of movers");
    let near_mover = |x: usize, y: usize| {
        let around = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy)));
        around.into_iter().any(|(dx, dy)| {
            let at = x.checked_add_signed(dx).zip(y.checked_add_signed(dy));
            at.and_then(|(x, y)| with.object.get(x, y))
                .is_some_and(|&id| id > 0)
        })
    };
    let mut recoloured = 0;
    for at in pixels(with.rgb.size(), 0) {
        let nearer = with.depth[at] < without.depth[at];
        assert_eq!(nearer, with.object[at] > 0, "depth at {at:?}");
        assert_eq!(
            with.mask[at] == 255,
            with.object[at] > 0,
            "both people walk, at {at:?}"
        );
        if with.rgb[at] != without.rgb[at] {
            assert!(near_mover(at.0, at.1), "colour at {at:?}");
            recoloured += 1;
        }
    }
    assert!(
        recoloured * 10 > covered * 9,
        "{recoloured} of {covered} look different"
    );
    assert!(
        without.mask.data().iter().all(|&m| m == 0),
        "nothing moves in the twin"
    );
}

/// The trolley stands until 1.2 s, rolls until 3.4 s, stands again; the mask remembers 10 frames.
#[test]
fn the_mask_follows_stop_and_go() {
    let scene = scene(SceneName::StopAndGo, 96);
    let trolley = |index: usize| state_of(&scene.frame(index, Par::Seq), 1);
    assert_eq!(trolley(0), 0, "has not started");
    assert_eq!(trolley(35), 0, "still has not");
    assert_eq!(trolley(45), 255, "rolls");
    assert_eq!(trolley(108), 255, "stopped at frame 102, remembered");
    assert_eq!(trolley(118), 0, "forgotten");
}

/// Value of the mask on one object; all its pixels are equal.
fn state_of(frame: &SynthFrame, object: u8) -> u8 {
    let pairs = frame.object.data().iter().zip(frame.mask.data());
    let of_mover = pairs.filter(|(id, _)| **id == object);
    let values: Vec<u8> = of_mover.map(|(_, m)| *m).collect();
    assert!(
        values.len() > 100,
        "mover {object}: {} pixels",
        values.len()
    );
    assert!(
        values.iter().all(|v| *v == values[0]),
        "one mover, one state"
    );
    values[0]
}

/// Checks that the flow of these objects follows from poses and depth; the number of pixels.
fn static_flow(scene: &Scene, [i, j]: [usize; 2], checked: impl Fn(u8) -> bool) -> usize {
    let (frame, flow) = (scene.frame(i, Par::Seq), scene.flow(i, j, Par::Seq));
    let (camera, to_j) = (scene.camera(), scene.world_from_camera(j).inverse());
    let mut count = 0;
    for at in pixels(frame.depth.size(), 0) {
        let [du, dv] = flow[at].map(f64::from);
        if checked(frame.object[at]) && !du.is_nan() {
            let p = to_j * world_point(&camera, &frame, at);
            let expected = camera.project(&p).expect("before the camera");
            let uv = Vector2::new(at.0 as f64 + du, at.1 as f64 + dv);
            assert!((uv - expected).norm() < 2e-4, "{at:?}: {uv} {expected}");
            count += 1;
        }
    }
    count
}

fn nothing_moves(frame: &SynthFrame) -> bool {
    frame.mask.data().iter().all(|&m| m == 0)
}

/// The trolley stops at 1.5 s (frame 45), the person at 2 s (60); ten frames later each counts as
/// static for good.
#[test]
fn objects_at_rest_become_static() {
    let scene = scene(SceneName::ComesToRest, 96);
    let states = |index: usize| {
        let frame = scene.frame(index, Par::Seq);
        [1, 2].map(|object| state_of(&frame, object))
    };
    for index in [0, 20, 45, 52] {
        assert_eq!(states(index), [255, 255], "both move, frame {index}");
    }
    assert_eq!(states(56), [0, 255], "the trolley is at rest");
    assert_eq!(states(67), [0, 255], "the person's last step is remembered");
    for index in [72, 100, 149, 400] {
        assert_eq!(states(index), [0, 0], "for good, frame {index}");
    }
    // Exactly at rest: their flow follows from poses and depth.
    let still = static_flow(&scene, [100, 149], |object| object > 0);
    assert!(still > 200, "{still} pixels of movers seen in both");
}

/// Nothing moves until 1.5 s (frame 45); then the chair does, and from 2.2 s (66) the person.
#[test]
fn objects_are_static_until_they_move() {
    let scene = scene(SceneName::SetsOff, 96);
    for index in [0, 10, 30, 45] {
        let frame = scene.frame(index, Par::Seq);
        assert!(nothing_moves(&frame), "frame {index}");
        assert_eq!([1, 2].map(|k| state_of(&frame, k)), [0, 0], "but is there");
    }
    let states = |index: usize| [1, 2].map(|k| state_of(&scene.frame(index, Par::Seq), k));
    assert_eq!(states(50), [255, 0], "the chair sets off");
    assert_eq!(states(66), [255, 0], "the person has not");
    for index in [71, 100, 149] {
        assert_eq!(states(index), [255, 255], "both, frame {index}");
    }
    // Before they start, the flow of the objects follows from poses and depth.
    static_flow(&scene, [0, 45], |_| true);
}

/// The background contains objects at rest and no moving ones, and equals the frame elsewhere.
#[test]
fn the_background_lacks_moving_objects() {
    let scene = scene(SceneName::ComesToRest, 96);
    for (index, movers) in [(20, 2), (60, 1), (100, 0)] {
        let frame = scene.frame(index, Par::Seq);
        let background = scene.background(index, Par::Seq);
        assert!(nothing_moves(&background), "frame {index}");
        let mut moving = [false; 3];
        for at in pixels(frame.depth.size(), 0) {
            if frame.mask[at] == 255 {
                moving[usize::from(frame.object[at])] = true;
                assert!(background.depth[at] > frame.depth[at], "{at:?} behind");
            } else {
                let same = background.depth[at].to_bits() == frame.depth[at].to_bits();
                assert!(same, "{at:?} of frame {index}");
                assert_eq!(background.object[at], frame.object[at], "{at:?}");
            }
        }
        let seen = moving.iter().filter(|m| **m).count();
        assert_eq!(seen, movers, "movers in frame {index}");
        if movers == 0 {
            assert_eq!(background, frame, "the whole frame");
        }
    }
}
