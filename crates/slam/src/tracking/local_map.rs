//! The local map of a frame: the landmarks that its neighbourhood's keyframes observe.

use garad_core::{KeyframeId, LandmarkId};

use crate::context::Context;
use crate::frame::Frame;
use crate::map::landmark::Appearance;
use crate::map::{Map, by_count};

/// What is searched for in a frame beyond its first links.
#[derive(Debug)]
pub(crate) struct LocalMap {
    /// The keyframe that shares most landmarks with the frame.
    pub(crate) reference: Option<KeyframeId>,
    /// Landmarks that should be visible, not linked yet, by id.
    pub(crate) visible: Vec<(LandmarkId, Appearance)>,
    /// All that should be visible, those already linked included.
    pub(crate) expected: Vec<LandmarkId>,
}

/// The local map is what these keyframes observe: those that observe the frame's landmarks, and
/// for each of them its most covisible neighbour not yet among them (of ten), up to
/// `max_local_keyframes`.
pub(crate) fn local_map(context: &Context, map: &Map, frame: &Frame) -> LocalMap {
    let max_keyframes = context.config.tracking.max_local_keyframes;
    let mut linked: Vec<_> = frame.landmark.iter().flatten().copied().collect();
    linked.sort_unstable();
    let votes = map.observers(linked.iter().copied());
    let mut keyframes = by_count(&votes);
    let reference = keyframes.first().copied();
    keyframes.truncate(max_keyframes);
    for keyframe in keyframes.clone() {
        if keyframes.len() >= max_keyframes {
            break;
        }
        let neighbours = by_count(&map.covisible(keyframe));
        let new = neighbours.iter().take(10).find(|k| !keyframes.contains(k));
        keyframes.extend(new);
    }
    let (mut visible, mut expected) = (Vec::new(), Vec::new());
    for id in map.observed_by(keyframes) {
        let already_linked = linked.binary_search(&id).is_ok();
        let landmark = map.landmark(id).expect("keyframes link living landmarks");
        let appearance = landmark.appearance(frame, &context.camera, &context.scales);
        if already_linked || appearance.is_some() {
            expected.push(id);
        }
        if let Some(appearance) = appearance.filter(|_| !already_linked) {
            visible.push((id, appearance));
        }
    }
    LocalMap {
        reference,
        visible,
        expected,
    }
}

#[cfg(test)]
mod tests {
    use garad_core::Se3;

    use super::*;
    use crate::config::Config;
    use crate::testing::{World, cloud, uneven_camera};

    /// Landmarks 0 to 2 are the frame's. Keyframes and what they observe:
    ///
    /// | keyframe | landmarks | shares with the frame | neighbours |
    /// |---|---|---|---|
    /// | 0 | 0 1 2 3 | 3 | 1, 2 |
    /// | 1 | 0 1 4 | 2 | 0, 5, 3 |
    /// | 2 | 2 5 | 1 | 0 |
    /// | 3 | 4 6 | 0 | 5, 1, 4 |
    /// | 4 | 6 7 | 0 | 3 |
    /// | 5 | 4 8 | 0 | 3, 1 |
    fn world(max_local_keyframes: usize) -> (World, Frame) {
        let mut config = Config::default();
        config.tracking.max_local_keyframes = max_local_keyframes;
        let mut world = World::with_camera(uneven_camera(), config);
        let points = &cloud()[..9];
        let here = Se3::identity();
        for (id, observed) in (0..).zip([
            vec![0, 1, 2, 3],
            vec![0, 1, 4],
            vec![2, 5],
            vec![4, 6],
            vec![6, 7],
            vec![4, 8],
        ]) {
            let mut seen = world.see(id, points, &here);
            for &i in &observed {
                let id = LandmarkId(u32::try_from(i).expect("small"));
                seen.landmark[i] = world.map.landmark(id).map(|_| id);
            }
            let linked = seen.landmark.clone();
            let keyframe = world.map.add_keyframe(seen);
            for i in observed.into_iter().filter(|&i| linked[i].is_none()) {
                let scales = &world.context.scales;
                let made = world.map.add_landmark(points[i], keyframe, i, scales);
                assert_eq!(made.index(), i, "made in order");
            }
        }
        let mut now = world.see(9, points, &here);
        for i in 0..3 {
            now.landmark[i] = Some(LandmarkId(u32::try_from(i).expect("small")));
        }
        (world, now)
    }

    fn ids(of: &[u32]) -> Vec<LandmarkId> {
        of.iter().copied().map(LandmarkId).collect()
    }

    fn visible(local: &LocalMap) -> Vec<LandmarkId> {
        local.visible.iter().map(|(id, _)| *id).collect()
    }

    #[test]
    fn keyframes_of_the_local_map() {
        let cases: [(usize, &[u32]); 5] = [
            (1, &[3]),
            (2, &[3, 4]),
            (3, &[3, 4, 5]),
            (4, &[3, 4, 5, 8]), // of two neighbours with one landmark in common the younger: 5
            (9, &[3, 4, 5, 8]), // one neighbour each, and none of theirs
        ];
        for (most, expected) in cases {
            let (world, now) = world(most);
            let local = local_map(&world.context, &world.map, &now);
            assert_eq!(local.reference, Some(KeyframeId(0)), "{most} keyframes");
            assert_eq!(visible(&local), ids(expected), "{most} keyframes");
            let all = [&[0, 1, 2], expected].concat();
            assert_eq!(local.expected, ids(&all), "{most}: those linked, too");
        }
    }

    #[test]
    fn the_youngest_of_equals_is_the_reference() {
        let (world, mut now) = world(2);
        now.landmark[..2].fill(None);
        let local = local_map(&world.context, &world.map, &now);
        assert_eq!(
            local.reference,
            Some(KeyframeId(2)),
            "0 and 2 have one each"
        );
        now.landmark.fill(None);
        let local = local_map(&world.context, &world.map, &now);
        assert_eq!(local.reference, None, "nothing in common");
        assert!(local.expected.is_empty(), "{local:?}");
    }

    #[test]
    fn what_moves_or_lies_outside_is_not_searched_for() {
        let (mut world, now) = world(3);
        world.set_moving(&ids(&[1, 4]));
        world
            .map
            .landmark_mut(LandmarkId(5))
            .expect("made")
            .p_world
            .x = 9.0;
        let local = local_map(&world.context, &world.map, &now);
        assert_eq!(visible(&local), ids(&[3]), "4 moves, 5 is outside");
        assert_eq!(local.expected, ids(&[0, 1, 2, 3]), "1 moves, but is linked");
    }
}
