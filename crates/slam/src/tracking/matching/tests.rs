//! Windows, gates and ties of the searches.

use garad_core::{Camera, DepthImage, FrameId, KeyframeId, Label, Par};
use garad_features::{Descriptor, Keypoint};
use nalgebra::Vector3;

use super::*;
use crate::config::Config;
use crate::frame::Levels;

/// Distance of everything, metres.
const DEPTH_M: f32 = 2.0;

struct Scene {
    context: Context,
}

impl Scene {
    /// A camera with fx = 100 px and a virtual baseline of 10 / 100 = 0.1 m.
    fn new() -> Self {
        Self::with(Config::default())
    }

    /// Radius 5 px in the last frame, 4 px head on and 6 px obliquely in the local map; 20 bits, 15
    /// without a position; ratios of a half.
    fn strict() -> Self {
        let mut config = Config::default();
        let t = &mut config.tracking;
        (t.match_distance, t.match_distance_strict) = (20, 15);
        (t.local_radius_px, t.local_radius_oblique_px) = (4.0, 6.0);
        (t.local_ratio, t.reference_ratio) = (0.5, 0.5);
        Self::with(config)
    }

    fn with(mut config: Config) -> Self {
        config.tracking.bf = 10.0;
        let camera = Camera::pinhole((160, 120), [100.0, 100.0, 80.0, 60.0]).expect("valid");
        Self {
            context: Context::new(camera, config, 0, Par::Seq).expect("valid"),
        }
    }

    /// A frame with keypoints at the centre of the image: level, and the lowest bits of the descriptor.
    fn frame(&self, keypoints: &[(u8, u64)]) -> Frame {
        let of = |&(level, _): &(u8, u64)| Keypoint {
            x: 80.0,
            y: 60.0,
            level,
            angle_deg: 0.0,
            response: 1.0,
        };
        let bits = keypoints
            .iter()
            .map(|(_, bits)| Descriptor([*bits, 0, 0, 0]));
        Frame::new(
            FrameId(0),
            0.0,
            keypoints.iter().map(of).collect(),
            bits.collect(),
            &DepthImage::new(160, 120, DEPTH_M),
            None,
            &self.context.camera,
            &Levels::new((160, 120), 1.2, 8, false),
            &self.context.config,
        )
    }

    /// A map of one keyframe that made a landmark of each of its keypoints.
    fn map(&self, keypoints: &[(u8, u64)]) -> (Map, Vec<LandmarkId>) {
        let mut map = Map::default();
        let id = map.add_keyframe(self.frame(keypoints));
        let p_world = Vector3::new(0.0, 0.0, f64::from(DEPTH_M));
        let landmark = |i| map.add_landmark(p_world, id, i, &self.context.scales);
        let landmarks = (0..keypoints.len()).map(landmark).collect();
        (map, landmarks)
    }
}

/// A landmark seen at level 3; now there are keypoints at levels 1 and 5.
#[test]
fn forwards_detail_grows_and_backwards_it_shrinks() {
    let scene = Scene::new();
    let (map, landmarks) = scene.map(&[(3, 0)]);
    let last = map.keyframe(KeyframeId(0));
    for (forward_m, at_1, at_5) in [
        (0.11, None, Some(landmarks[0])),
        (0.09, None, None),
        (-0.09, None, None),
        (-0.11, Some(landmarks[0]), None),
    ] {
        let mut now = scene.frame(&[(1, 0), (5, 0)]);
        now.camera_from_world.translation.z = -forward_m;
        let found = from_last_frame(&scene.context, &map, last, &mut now, 5.0);
        assert_eq!(now.landmark, [at_1, at_5], "{forward_m} m forwards");
        assert_eq!(
            found,
            usize::from(at_1.or(at_5).is_some()),
            "{forward_m} m forwards"
        );
    }
}

/// Two landmarks at the same place; the only keypoint there is the first one's.
#[test]
fn a_keypoint_that_is_taken_stays_taken() {
    let scene = Scene::new();
    let (map, landmarks) = scene.map(&[(2, 0b0001), (2, 0b0011)]);
    let visible: Vec<_> = (landmarks.iter())
        .map(|id| {
            let landmark = map.landmark(*id).expect("made");
            let frame = scene.frame(&[]);
            let seen = landmark.appearance(&frame, &scene.context.camera, &scene.context.scales);
            (*id, seen.expect("at the centre of the image"))
        })
        .collect();
    let from_map = |now: &mut Frame| from_local_map(&scene.context, &map, &visible, now);
    let last = map.keyframe(KeyframeId(0));
    let from_last = |now: &mut Frame| from_last_frame(&scene.context, &map, last, now, 5.0);
    let ways: [&dyn Fn(&mut Frame) -> usize; 2] = [&from_map, &from_last];
    for (way, search) in ["local map", "last frame"].into_iter().zip(ways) {
        // The second landmark's descriptor, bit by bit.
        let mut now = scene.frame(&[(2, 0b0011)]);
        assert_eq!(search(&mut now), 1, "{way}: one link for one keypoint");
        assert_eq!(now.landmark, [Some(landmarks[0])], "{way}: the first's");
        // What is left for the second is 61 bits away from it: within 100.
        let mut now = scene.frame(&[(2, 0b0011), (2, u64::MAX << 1)]);
        assert_eq!(search(&mut now), 2, "{way}: one each");
        assert_eq!(
            now.landmark,
            [Some(landmarks[0]), Some(landmarks[1])],
            "{way}: what is left"
        );
    }
}

/// The `n` lowest bits.
fn ones(n: u32) -> u64 {
    (1 << n) - 1
}

/// Whether a landmark of no bits, seen as stated, is linked to each of the keypoints.
fn linked(seen: &Appearance, now: &mut Frame, scene: &Scene) -> Vec<bool> {
    let (map, landmarks) = scene.map(&[(0, 0)]);
    let visible = [(landmarks[0], *seen)];
    let found = from_local_map(&scene.context, &map, &visible, now);
    let links: Vec<_> = now.landmark.iter().map(Option::is_some).collect();
    assert_eq!(found, links.iter().filter(|l| **l).count(), "counted");
    links
}

fn seen(offset_px: [f64; 2], depth_m: f64, level: usize, view_cosine: f64) -> Appearance {
    Appearance {
        uv_px: Vector2::new(80.0, 60.0) + Vector2::from(offset_px),
        depth_m,
        level,
        view_cosine,
    }
}

/// One keypoint at 2 m (5 px of disparity), seen from head on if the cosine is above 0.998.
#[test]
fn windows_of_the_local_map() {
    let (head_on, oblique) = (0.9981, 0.998);
    for (what, offset_px, depth_m, level, cosine, expected) in [
        ("inside", [3.9, -3.9], 2.0, 0, head_on, true),
        ("outside in x", [-4.1, 0.0], 2.0, 0, head_on, false),
        ("outside in y", [0.0, 4.1], 2.0, 0, head_on, false),
        ("inside, obliquely", [5.9, 5.9], 2.0, 0, oblique, true),
        ("outside, obliquely", [6.1, 0.0], 2.0, 0, oblique, false),
        ("inside 4 · 1.44", [5.7, 0.0], 2.0, 2, head_on, true),
        ("outside 4 · 1.44", [5.8, 0.0], 2.0, 2, head_on, false),
        (
            "3.9 px of disparity off",
            [0.0, 0.0],
            10.0 / 8.9,
            0,
            head_on,
            true,
        ),
        ("4.1 px", [0.0, 0.0], 10.0 / 9.1, 0, head_on, false),
        ("4.1 px behind", [0.0, 0.0], 10.0 / 0.9, 0, head_on, false),
        (
            "4.1 px, obliquely",
            [0.0, 0.0],
            10.0 / 9.1,
            0,
            oblique,
            true,
        ),
    ] {
        let scene = Scene::strict();
        let mut now = scene.frame(&[(u8::try_from(level).expect("small"), 0)]);
        let seen = seen(offset_px, depth_m, level, cosine);
        assert_eq!(linked(&seen, &mut now, &scene), [expected], "{what}");
        let mut direction = scene.frame(&[(u8::try_from(level).expect("small"), 0)]);
        direction.depth_m[0] = None;
        let expected = expected || offset_px == [0.0, 0.0];
        let found = linked(&seen, &mut direction, &scene);
        assert_eq!(found, [expected], "{what}; without depth");
    }
}

/// Keypoints as (level, bits that differ); the landmark is expected at level 3.
#[test]
fn best_and_second_best_of_the_local_map() {
    let cases: [(&str, &[_], Option<usize>); 17] = [
        ("its level", &[(3, 5)], Some(0)),
        ("the level below", &[(2, 5)], Some(0)),
        ("two below", &[(1, 5)], None),
        ("above", &[(4, 5)], None),
        ("twenty bits", &[(3, 20)], Some(0)),
        ("more", &[(3, 21)], None),
        ("half of the second", &[(3, 10), (3, 20)], Some(0)),
        ("more than half", &[(3, 10), (3, 19)], None),
        ("the better one comes last", &[(3, 20), (3, 10)], Some(1)),
        ("that, more than half", &[(3, 19), (3, 10)], None),
        ("the second has another level", &[(3, 10), (2, 12)], Some(0)),
        ("the second comes first", &[(3, 12), (3, 30), (3, 10)], None),
        (
            "the second comes second",
            &[(3, 10), (3, 12), (3, 30)],
            None,
        ),
        ("the second comes last", &[(3, 10), (3, 30), (3, 12)], None),
        ("both are far", &[(3, 10), (3, 30), (3, 21)], Some(0)),
        (
            "the first of equal seconds counts",
            &[(3, 10), (2, 12), (3, 12)],
            Some(0),
        ),
        ("the other order", &[(3, 10), (3, 12), (2, 12)], None),
    ];
    for (what, keypoints, expected) in cases {
        let scene = Scene::strict();
        let with_bits: Vec<_> = keypoints.iter().map(|&(l, n)| (l, ones(n))).collect();
        let mut now = scene.frame(&with_bits);
        let found = linked(&seen([0.0; 2], 2.0, 3, 1.0), &mut now, &scene);
        let expected: Vec<_> = (0..keypoints.len()).map(|k| Some(k) == expected).collect();
        assert_eq!(found, expected, "{what}");
    }
    let scene = Scene::strict();
    let mut now = scene.frame(&[(3, 7), (3, 7)]);
    let found = linked(&seen([0.0; 2], 2.0, 3, 1.0), &mut now, &scene);
    assert_eq!(found, [false; 2], "of equals none is better");
}

/// A landmark of level 2 in the last frame: 5 · 1.44 = 7.2 px.
#[test]
fn gates_of_the_last_frame() {
    for (what, aside_px, bits, moves, expected) in [
        ("inside", 7.1, 20, false, 1),
        ("outside", 7.3, 0, false, 0),
        ("inside, to the left", -7.1, 0, false, 1),
        ("one bit too many", 0.0, 21, false, 0),
        ("moves", 0.0, 0, true, 0),
        ("outside the image", 80.0, 0, false, 0),
    ] {
        let scene = Scene::strict();
        let (mut map, landmarks) = scene.map(&[(2, 0)]);
        let last = map.keyframe(KeyframeId(0)).clone();
        let landmark = map.landmark_mut(landmarks[0]).expect("made");
        landmark.p_world.x = aside_px * f64::from(DEPTH_M) / 100.0;
        if moves {
            landmark.push_label(Label::Dynamic, &scene.context.config.labels.window);
        }
        let mut now = scene.frame(&[(2, ones(bits))]);
        let found = from_last_frame(&scene.context, &map, &last, &mut now, 5.0);
        assert_eq!(found, expected, "{what}");
        assert_eq!(now.landmark.iter().flatten().count(), expected, "{what}");
    }
}

/// Twelve landmarks, none of which looks like another. Eleven turned by 3°, one by 100°: less than a
/// tenth of the fullest bin.
#[test]
fn what_turned_otherwise_is_unlinked() {
    let scene = Scene::strict();
    let keypoints: Vec<_> = (0..12).map(|i| (2, 0b1_1111 << (5 * i))).collect();
    let (map, landmarks) = scene.map(&keypoints);
    let mut last = map.keyframe(KeyframeId(0)).clone();
    let mut now = scene.frame(&keypoints);
    for i in 0..12u8 {
        let angle_deg = 20.0 * f32::from(i);
        last.keypoints[usize::from(i)].angle_deg = angle_deg;
        now.keypoints[usize::from(i)].angle_deg = angle_deg + if i == 4 { 100.0 } else { 3.0 };
    }
    let mut expected: Vec<_> = landmarks.iter().copied().map(Some).collect();
    expected[4] = None;
    let by_position = from_last_frame(&scene.context, &map, &last, &mut now.clone(), 5.0);
    let by_descriptor = from_keyframe(&scene.context, &map, &last, &mut now);
    assert_eq!((by_position, by_descriptor), (11, 11), "links");
    assert_eq!(now.landmark, expected, "the fifth is unlinked");
}

/// Bits of a keyframe's landmarks and of the frame's keypoints; at most 15 bits, below half the second.
#[test]
fn gates_of_a_keyframe() {
    let cases: [(&str, &[u32], &[u32], &[_]); 7] = [
        ("fifteen bits", &[0], &[15], &[Some(0)]),
        ("sixteen", &[0], &[16], &[None]),
        ("half of the second", &[0], &[10, 20], &[None, None]),
        ("less than half", &[0], &[10, 21], &[Some(0), None]),
        ("the keypoint prefers another", &[0, 4], &[3], &[Some(1)]),
        ("each its own", &[0, 40], &[41, 2], &[Some(1), Some(0)]),
        ("no keypoint", &[0], &[], &[]),
    ];
    for (what, known, keypoints, expected) in cases {
        let scene = Scene::strict();
        let of = |bits: &[u32]| bits.iter().map(|&n| (0, ones(n))).collect::<Vec<_>>();
        let (mut map, landmarks) = scene.map(&of(known));
        let keyframe = map.keyframe(KeyframeId(0)).clone();
        let mut now = scene.frame(&of(keypoints));
        let found = from_keyframe(&scene.context, &map, &keyframe, &mut now);
        let expected: Vec<_> = expected.iter().map(|l| l.map(LandmarkId)).collect();
        assert_eq!(now.landmark, expected, "{what}");
        assert_eq!(found, expected.iter().flatten().count(), "{what}");
        // Neither what moves nor what is not in use is matched.
        let mut unused = scene.frame(&of(keypoints));
        unused.in_use.fill(false);
        let found = from_keyframe(&scene.context, &map, &keyframe, &mut unused);
        assert_eq!(found, 0, "{what}; not in use");
        for id in landmarks {
            let landmark = map.landmark_mut(id).expect("made");
            landmark.push_label(Label::Dynamic, &scene.context.config.labels.window);
        }
        let mut now = scene.frame(&of(keypoints));
        let found = from_keyframe(&scene.context, &map, &keyframe, &mut now);
        assert_eq!(found, 0, "{what}; moving");
    }
}
