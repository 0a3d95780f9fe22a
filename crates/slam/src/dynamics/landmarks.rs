//! The random field over the landmarks of a keyframe's local map, with all four cues (eq. 1 to 6), and
//! their retention (eq. 7).

use garad_core::{KeyframeId, Label, LandmarkId};
use garad_crf::{Crf, Node};

use super::cues::landmark_cues;
use super::evidence::FreeSpaceHistory;
use crate::context::Context;
use crate::map::Map;
use crate::trace::Recorder;

/// Labels the landmarks that a keyframe and its neighbours observe, and is the only writer of
/// landmark labels. Returns the landmarks whose label changed. A landmark that was dynamic in every
/// run of the window is dropped (eq. 7).
pub(crate) fn label_landmarks(
    context: &Context,
    map: &mut Map,
    keyframe: KeyframeId,
    crf: &Crf,
    history: &FreeSpaceHistory<'_>,
    recorder: &mut Recorder,
) -> Vec<(LandmarkId, Label)> {
    let neighbours = map.covisible(keyframe).into_keys();
    let ids = map.observed_by(neighbours.chain([keyframe]));
    let frame = map.keyframe(keyframe);
    let (ids, nodes): (Vec<LandmarkId>, Vec<Node>) = ids
        .into_iter()
        .filter_map(|id| {
            let landmark = map.landmark(id)?;
            let uv = context
                .camera
                .project(&(frame.camera_from_world * landmark.p_world))
                .filter(|uv| context.camera.contains(uv))?;
            let node = Node {
                p_world: landmark.p_world,
                uv_px: Some(uv),
                cues: landmark_cues(context, map, landmark, history),
                previous: Some(match landmark.label() {
                    Label::Static => 0.0,
                    Label::Dynamic => 1.0,
                }),
            };
            Some((id, node))
        })
        .unzip();
    let beliefs = crf
        .infer(&nodes, context.par)
        .expect("positions and cues of landmarks are finite");
    recorder.record("label_map", |record| {
        record.landmark_field(ids.iter().copied(), &nodes, &beliefs);
    });
    let mut changed = Vec::new();
    for (id, label) in ids.into_iter().zip(beliefs.labels) {
        let landmark = map.landmark_mut(id).expect("nodes are landmarks of the map");
        let retention = landmark.push_label(label, &context.config.labels.window);
        if retention.changed {
            changed.push((id, label));
        }
        if retention.expired {
            map.drop_landmark(id);
        }
    }
    changed
}

#[cfg(test)]
mod tests {
    use garad_core::Se3;
    use nalgebra::Vector6;

    use super::*;
    use crate::config::Config;
    use crate::labels::frame::tests::{frame, is_in, keep, places, slam, wall, wall_behind};

    const BOX_PX: [[usize; 2]; 2] = [[48, 112], [32, 96]];

    /// Two keyframes see a box in front of a wall, each keypoint a landmark; a third sees the wall
    /// alone. Returns the third and the landmarks of the box and of the wall.
    fn a_box_has_gone(config: Config) -> (Slam, KeyframeId, [Vec<LandmarkId>; 2]) {
        let mut slam = slam(config);
        let before = wall_behind(BOX_PX);
        let seen = frame(&slam, 0, &before);
        let first = keep(&mut slam, seen, &before);
        let mut second = frame(&slam, 10, &before);
        let mut third = frame(&slam, 20, &wall());
        let mut of = [Vec::new(), Vec::new()];
        let scales = slam.scales.clone();
        for (i, [x, y]) in places().into_iter().enumerate() {
            let p_world = slam.map.keyframe(first).world_point(i, &slam.camera);
            let p_world = p_world.expect("no keypoint is on an edge");
            let id = slam.map.add_landmark(p_world, first, i, &scales);
            let on_wall = !is_in(BOX_PX, x, y);
            second.landmark[i] = Some(id);
            third.landmark[i] = on_wall.then_some(id);
            of[usize::from(on_wall)].push(id);
        }
        keep(&mut slam, second, &before);
        let third = keep(&mut slam, third, &wall());
        (slam, third, of)
    }

    fn alive(slam: &Slam, ids: &[LandmarkId]) -> usize {
        let found = ids.iter().filter(|id| slam.map.landmark(**id).is_some());
        found.count()
    }

    #[test]
    fn what_a_keyframe_sees_through_moves_and_is_not_looked_for() {
        let (mut slam, third, [of_box, of_wall]) = a_box_has_gone(Config::default());
        assert_eq!((of_box.len(), of_wall.len()), (64, 236), "both are there");
        let looked_for = |slam: &Slam, id: LandmarkId| {
            let landmark = slam.map.landmark(id).expect("alive");
            let frame = slam.map.keyframe(third);
            let seen = slam
                .map
                .appearance(landmark, frame, &slam.camera, &slam.scales);
            [seen.is_some(), slam.map.static_landmark(id).is_some()]
        };
        let all = of_box.iter().chain(&of_wall);
        assert!(
            all.clone().all(|id| looked_for(&slam, *id) == [true; 2]),
            "before"
        );
        let changed = slam.label_landmarks(third);
        let expected: Vec<_> = of_box.iter().map(|id| (*id, Label::Dynamic)).collect();
        assert_eq!(changed, expected, "the whole box and nothing else");
        for id in all {
            let expected = [of_wall.contains(id); 2];
            assert_eq!(looked_for(&slam, *id), expected, "{id:?}");
        }
        assert_eq!(slam.label_landmarks(third), [], "no change the second time");
    }

    #[test]
    fn it_is_dropped_after_a_whole_window_of_dynamic_runs() {
        let mut config = Config::default();
        config.labels.window.runs = 4;
        let (mut slam, third, [of_box, of_wall]) = a_box_has_gone(config);
        for run in 1..=4 {
            slam.label_landmarks(third);
            let left = if run < 4 { of_box.len() } else { 0 };
            assert_eq!(alive(&slam, &of_box), left, "run {run} of 4");
        }
        assert_eq!(alive(&slam, &of_wall), of_wall.len(), "the wall stays");
        for keyframe in slam.map.keyframes() {
            let linked = keyframe.landmark.iter().flatten().count();
            assert_eq!(linked, of_wall.len(), "no link to what is gone");
        }
    }

    /// It is back before its window is over: static again, and kept.
    #[test]
    fn what_is_found_at_rest_again_is_static_again() {
        let mut config = Config::default();
        config.labels.window.runs = 4;
        config.labels.memory_frames = 30;
        let (mut slam, third, [of_box, _]) = a_box_has_gone(config);
        for _ in 0..3 {
            slam.label_landmarks(third);
        }
        let depth = wall_behind(BOX_PX);
        let mut back = frame(&slam, 60, &depth);
        let first = slam.map.keyframe(KeyframeId(0));
        back.landmark.clone_from(&first.landmark);
        let back = keep(&mut slam, back, &depth);
        slam.forget_witnesses(FrameId(60));
        let left: Vec<_> = slam.witnesses.keys().copied().collect();
        assert_eq!(left, [back], "30 frames of memory");
        let changed = slam.label_landmarks(back);
        let expected: Vec<_> = of_box.iter().map(|id| (*id, Label::Static)).collect();
        assert_eq!(changed, expected, "the box is back");
        assert_eq!(alive(&slam, &of_box), of_box.len(), "and kept");
    }

    /// A landmark that one keyframe alone has seen keeps its label (`crf.unary.min_observations`).
    #[test]
    fn one_observation_has_no_say() {
        let (mut slam, third, [of_box, _]) = a_box_has_gone(Config::default());
        for id in &of_box {
            slam.map.drop_observation(*id, KeyframeId(1));
        }
        assert_eq!(slam.label_landmarks(third), [], "seen by one");
    }

    #[test]
    fn cues_are_means_over_the_keyframes() {
        let (mut slam, third, [of_box, of_wall]) = a_box_has_gone(Config::default());
        let cues = |slam: &Slam, id| {
            let landmark = slam.map.landmark(id).expect("alive");
            slam.cues(landmark, &slam.court(FrameId(20)))
        };
        let [on_box, on_wall] = [of_box[0], of_wall[0]].map(|id| cues(&slam, id));
        assert_eq!(
            [on_box.observations, on_wall.observations],
            [Some(2), Some(3)],
            "who sees it"
        );
        assert_eq!(on_wall.epipolar_px, None, "no baseline, no line");
        assert_eq!(on_wall.depth_residual, Some(0.0), "all agree");
        // 1.5 m in front of 3 m, where σ is 3e-3 z² = 0.027 m.
        let sigmas = on_box.depth_residual.expect("seen through");
        assert!((sigmas - 1.5 / 0.027).abs() < 1e-9, "{sigmas} σ");
        let observations = &slam.map.landmark(of_wall[0]).expect("alive").observations;
        let (_, i) = *observations.last().expect("three");
        slam.map.keyframe_mut(third).uv_px[i].x += 3.0;
        let off = cues(&slam, of_wall[0]).reproj_px.expect("seen");
        assert!((off - 1.0).abs() < 1e-9, "3 px in one of three: {off}");
        // The third camera a metre to the right: epipolar lines are rows.
        slam.map.keyframe_mut(third).uv_px[i].y += 2.0;
        let keyframe = slam.map.keyframe_mut(third);
        keyframe.camera_from_world.translation.x = -1.0;
        let off = cues(&slam, of_wall[0]).epipolar_px.expect("a baseline");
        assert!((off - 2.0).abs() < 1e-9, "two rows off: {off}");
        // Aside, ahead and turned, and the keypoint where the landmark is: its line passes through it.
        let p_world = slam.map.landmark(of_wall[0]).expect("alive").p_world;
        let pose = Se3::exp(&Vector6::new(-0.5, 0.1, -0.5, 0.02, -0.1, 0.05));
        let uv = slam.camera.project(&(pose * p_world)).expect("in front");
        let keyframe = slam.map.keyframe_mut(third);
        keyframe.camera_from_world = pose;
        keyframe.uv_px[i] = uv;
        let on = cues(&slam, of_wall[0]).epipolar_px.expect("a baseline");
        assert!(on < 1e-9, "{on} px from its line");
    }
}
