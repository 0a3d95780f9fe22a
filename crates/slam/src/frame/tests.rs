//! What a frame holds and how it changes.

use super::*;
use garad_core::Real;

fn keypoint(x: f32, y: f32, level: u8) -> Keypoint {
    Keypoint {
        x,
        y,
        level,
        angle_deg: 0.0,
        response: 1.0,
    }
}

fn frame(points: &[(f32, f32, u8)], depth: &DepthImage, mask: Option<&MaskImage>) -> Frame {
    let camera = Camera::pinhole(depth.size(), [50.0, 50.0, 31.5, 23.5]).expect("valid camera");
    let keypoints: Vec<_> = points.iter().map(|&(x, y, l)| keypoint(x, y, l)).collect();
    let descriptors = vec![Descriptor::default(); keypoints.len()];
    let mut config = Config::default();
    config.labels.dilate_px = 2;
    Frame::new(
        FrameId(0),
        0.0,
        keypoints,
        descriptors,
        depth,
        mask,
        &camera,
        &Levels::new(depth.size(), 1.2, 8, true),
        &config,
    )
}

#[test]
fn near_finds_what_a_full_search_finds() {
    let depth = DepthImage::new(64, 48, 1.0);
    let mut rng = garad_core::Rng::new(1);
    let points: Vec<_> = (0..300)
        .map(|_| {
            (
                rng.range(0.0, 63.0).to_f32(),
                rng.range(0.0, 47.0).to_f32(),
                u8::try_from(rng.below(4)).expect("below 4"),
            )
        })
        .collect();
    let frame = frame(&points, &depth, None);
    for _ in 0..200 {
        let uv = Vector2::new(rng.range(-10.0, 74.0), rng.range(-10.0, 58.0));
        let mut found: Vec<_> = frame.near(&uv, 7.0, 1, 2).collect();
        found.sort_unstable();
        let expected: Vec<_> = (0..points.len())
            .filter(|&i| {
                let d = frame.uv_px[i] - uv;
                (1..=2).contains(&points[i].2) && d.x.abs() < 7.0 && d.y.abs() < 7.0
            })
            .collect();
        assert_eq!(found, expected, "around {uv}");
    }
}

#[test]
fn depth_on_an_edge_or_missing_is_no_depth() {
    let depth = DepthImage::from_fn(64, 48, |x, _| match x {
        0..=19 => 1.0,
        20..=39 => 2.0,
        _ => 0.0,
    });
    let frame = frame(
        &[(10.2, 5.0, 0), (19.6, 5.0, 0), (50.0, 5.0, 0)],
        &depth,
        None,
    );
    assert_eq!(
        frame.depth_m,
        [Some(1.0), None, None],
        "flat, edge, missing"
    );
}

#[test]
fn moving_keypoints_are_labelled_and_never_matched() {
    let depth = DepthImage::new(64, 48, 1.0);
    let mask = MaskImage::from_fn(64, 48, |x, _| if x >= 32 { 255 } else { 0 });
    let frame = frame(
        &[(10.0, 9.0, 0), (30.0, 9.0, 0), (40.0, 9.0, 0)],
        &depth,
        Some(&mask),
    );
    let expected = [Label::Static, Label::Static, Label::Dynamic];
    assert_eq!(frame.label, expected, "left, near the edge, inside");
    assert_eq!(
        frame.in_use,
        [true, false, false],
        "near the edge is not to be trusted"
    );
    let all: Vec<_> = frame.near(&Vector2::new(32.0, 24.0), 100.0, 0, 7).collect();
    assert_eq!(all, [0], "only the static one can be matched");
}

#[test]
fn a_window_is_open_and_its_levels_are_closed() {
    let depth = DepthImage::new(64, 48, 1.0);
    let frame = frame(&[(20.0, 20.0, 2)], &depth, None);
    let at = frame.uv_px[0];
    for (offset, radius_px, (low, high), expected) in [
        ([6.0, 0.0], 6.0, (0, 7), 0),
        ([-6.0, 0.0], 6.0, (0, 7), 0),
        ([0.0, 6.0], 6.0, (0, 7), 0),
        ([5.9, -5.9], 6.0, (0, 7), 1),
        ([0.0, 0.0], 6.0, (2, 2), 1),
        ([0.0, 0.0], 6.0, (3, 7), 0),
        ([0.0, 0.0], 6.0, (0, 1), 0),
    ] {
        let near = frame.near(&(at + Vector2::from(offset)), radius_px, low, high);
        assert_eq!(near.count(), expected, "{offset:?}, levels {low} to {high}");
    }
}

/// `dilate_px` is 2: the mask begins at column 32, keypoints lie at columns 29 and 30.
#[test]
fn what_lies_within_reach_of_a_mask_is_not_used() {
    let depth = DepthImage::new(64, 48, 1.0);
    let mask = MaskImage::from_fn(64, 48, |x, _| if x >= 32 { 255 } else { 128 });
    let frame = frame(&[(29.0, 9.0, 0), (30.0, 9.0, 0)], &depth, Some(&mask));
    assert_eq!(frame.in_use, [true, false], "3 and 2 px away");
    assert_eq!(frame.label, [Label::Static; 2], "outside");
}

#[test]
fn a_moved_keypoint_takes_the_depth_of_its_new_place() {
    let camera = Camera::pinhole((64, 48), [50.0, 55.0, 30.0, 25.0]).expect("valid");
    let depth = DepthImage::from_fn(64, 48, |x, _| if x < 32 { 1.0 } else { 2.0 });
    let mut moved = frame(&[(10.0, 9.0, 0), (12.0, 40.0, 0)], &depth, None);
    let turn_rad = Vector3::new(0.01, -0.02, 0.03);
    moved.shutter = RollingShutter { turn_rad };
    let before = moved.clone();
    let (px, config) = (Vector2::new(50.25, 40.5), Config::default());
    moved.move_keypoint(1, px, 0.35, &depth, &camera, &config);
    assert_eq!(moved.px, [before.px[0], px], "recorded");
    let ideal = moved.shutter.ideal_pixel(&camera, &px).expect("no lens");
    assert!((ideal - px).norm() > 0.1, "the shutter moves it");
    assert_eq!(moved.uv_px, [before.uv_px[0], ideal], "at the middle row");
    assert_eq!(moved.sigma_px.as_slice(), [1.0, 0.35].as_slice(), "σ");
    assert_eq!(moved.depth_m, [Some(1.0), Some(2.0)], "depth");
}

#[test]
fn labels_unlink_what_may_not_be_used() {
    let depth = DepthImage::new(64, 48, 1.0);
    let camera = Camera::pinhole((64, 48), [50.0, 55.0, 30.0, 25.0]).expect("valid");
    let mut frame = frame(
        &[(10.0, 9.0, 0), (20.0, 9.0, 0), (30.0, 9.0, 0)],
        &depth,
        None,
    );
    frame.landmark = [4, 5, 6].map(|id| Some(LandmarkId(id))).to_vec();
    let labels = FrameLabels {
        label: vec![Label::Dynamic, Label::Static, Label::Static],
        in_use: vec![false, false, true],
        cells: MaskImage::new(16, 12, 0),
        restored: Vec::new(),
    };
    frame.apply_labels(&labels, &camera);
    assert_eq!(frame.landmark, [None, None, Some(LandmarkId(6))], "links");
    assert_eq!(
        (&frame.label, &frame.in_use),
        (&labels.label, &labels.in_use),
        "labels"
    );
    let found: Vec<_> = frame.near(&Vector2::new(20.0, 9.0), 30.0, 0, 7).collect();
    assert_eq!(found, [2], "what a search finds");
}

#[test]
fn labels_together_move_where_either_does() {
    use Label::{Dynamic, Static};
    let labels = |label: [Label; 4], in_use: [bool; 4], cells: [u8; 4], restored| FrameLabels {
        label: label.to_vec(),
        in_use: in_use.to_vec(),
        cells: MaskImage::from_vec(4, 1, cells.to_vec()).expect("four"),
        restored: vec![LandmarkId(restored)],
    };
    let a = labels(
        [Static, Static, Dynamic, Dynamic],
        [true, true, false, false],
        [0, 0, 255, 255],
        1,
    );
    let b = labels(
        [Static, Dynamic, Static, Dynamic],
        [true, false, true, false],
        [0, 255, 0, 255],
        2,
    );
    let expected = labels(
        [Static, Dynamic, Dynamic, Dynamic],
        [true, false, false, false],
        [0, 255, 255, 255],
        2,
    );
    assert_eq!(a.union(b), expected, "restored: those of the second");
}

#[test]
fn a_turn_brings_all_keypoints_and_the_search_to_the_middle_row() {
    let depth = DepthImage::new(64, 48, 1.0);
    let camera = Camera::pinhole((64, 48), [50.0, 55.0, 30.0, 25.0]).expect("valid");
    let mut frame = frame(&[(39.5, 2.0, 0), (10.0, 45.0, 0)], &depth, None);
    frame.in_use[1] = false;
    let before = frame.px.clone();
    let shutter = RollingShutter {
        turn_rad: Vector3::new(0.02, 0.3, -0.01),
    };
    frame.set_shutter(shutter, &camera);
    assert_eq!(
        (frame.shutter, &frame.px),
        (shutter, &before),
        "recorded pixels stay"
    );
    for (uv_px, px) in frame.uv_px.iter().zip(&frame.px) {
        assert_eq!(Some(*uv_px), shutter.ideal_pixel(&camera, px), "{px}");
    }
    // s = (2 - 23.5) / 48 of 0.3 rad at 50 px: about 7 px.
    assert!(frame.uv_px[0].x > 45.0, "{}", frame.uv_px[0]);
    let near = |x| {
        frame
            .near(&Vector2::new(x, 3.0), 4.0, 0, 7)
            .collect::<Vec<_>>()
    };
    assert_eq!(near(frame.uv_px[0].x), [0], "found where it is now");
    let all: Vec<_> = frame.near(&Vector2::new(32.0, 24.0), 99.0, 0, 7).collect();
    assert_eq!(all, [0], "the other one stays unused");
}

#[test]
fn a_culled_frame_keeps_its_pose_and_no_feature() {
    let depth = DepthImage::new(64, 48, 1.0);
    let mut frame = frame(&[(20.0, 20.0, 0)], &depth, None);
    (frame.id, frame.t_s) = (FrameId(3), 0.25);
    frame.camera_from_world.translation.x = 0.5;
    frame.shutter.turn_rad.y = 0.125;
    frame.information.links = 9;
    let (pose, shutter) = (frame.camera_from_world, frame.shutter);
    frame.drop_features();
    assert_eq!(
        (frame.id, Some(frame.t_s)),
        (FrameId(3), Some(0.25)),
        "frame"
    );
    assert_eq!(
        (frame.camera_from_world, frame.shutter),
        (pose, shutter),
        "pose"
    );
    assert_eq!(frame.information.links, 9, "information");
    assert!(frame.is_empty() && frame.depth_planes.is_none(), "features");
    for uv in [[20.0, 20.0], [0.0, 0.0], [-9.0, 70.0]] {
        let found = frame.near(&Vector2::from(uv), 30.0, 0, 7).count();
        assert_eq!(found, 0, "around {uv:?}");
    }
}
