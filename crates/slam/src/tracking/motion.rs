//! The first pose of a frame: constant velocity, then the reference keyframe.

use garad_core::Se3;

use super::depth_pose::{MIN_SHARE_UNLABELLED, refine_pose_with_depth};
use super::matching;
use super::shutter::ShutterModel;
use crate::context::Context;
use crate::frame::Frame;
use crate::map::Map;
use crate::trace::Recorder;

/// First pose from the last frame's landmarks, searched where constant velocity predicts them.
/// `false` if too few are found.
pub(crate) fn track_motion(
    context: &Context,
    map: &Map,
    last: &Frame,
    velocity: &Se3,
    frame: &mut Frame,
    shutter: &ShutterModel,
    recorder: &mut Recorder,
) -> bool {
    let config = &context.config.tracking;
    let predicted = *velocity * last.camera_from_world;
    recorder.record("predict", |record| {
        record.predict(&last.camera_from_world, velocity, &predicted);
    });
    for factor in [1.0, 2.0] {
        frame.camera_from_world = predicted;
        frame.landmark.fill(None);
        let radius_px = factor * config.motion_radius_px;
        let matches = matching::from_last_frame(context, map, last, frame, radius_px);
        recorder.record("match_motion", |record| record.links(frame));
        if matches >= config.motion_min_matches {
            return first_pose(context, map, frame, shutter, recorder);
        }
    }
    false
}

/// First pose from the reference keyframe's landmarks, found by descriptor, starting at the last
/// pose. `false` if too few are found.
pub(crate) fn track_reference(
    context: &Context,
    map: &Map,
    last: &Frame,
    reference: &Frame,
    frame: &mut Frame,
    shutter: &ShutterModel,
    recorder: &mut Recorder,
) -> bool {
    frame.camera_from_world = last.camera_from_world;
    frame.landmark.fill(None);
    let matches = matching::from_keyframe(context, map, reference, frame);
    recorder.record("match_reference", |record| record.links(frame));
    matches >= context.config.tracking.reference_min_matches
        && first_pose(context, map, frame, shutter, recorder)
}

fn first_pose(
    context: &Context,
    map: &Map,
    frame: &mut Frame,
    shutter: &ShutterModel,
    recorder: &mut Recorder,
) -> bool {
    let inliers =
        refine_pose_with_depth(context, map, frame, MIN_SHARE_UNLABELLED, shutter, recorder);
    inliers >= context.config.tracking.motion_min_inliers
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::config::Config;
    use crate::testing::{World, cloud, small_motion, uneven_camera};

    /// The last frame's pose, far from the origin.
    fn before() -> Se3 {
        Se3::exp(&[0.5, -0.8, 0.6, 0.4, -0.7, 0.9].into())
    }

    /// What it sees, in the world.
    fn points() -> Vec<Vector3<f64>> {
        let world_from_camera = before().inverse();
        cloud().iter().map(|p| world_from_camera * *p).collect()
    }

    /// The camera moved from [`before`] by [`small_motion`]; the last frame was linked to the first
    /// `linked` of 70 landmarks. Radius 3 px, 40 matches and 36 inliers, 25 matches with the reference.
    fn scene(linked: usize) -> (World, Frame, Frame) {
        let mut config = Config::default();
        let t = &mut config.tracking;
        (
            t.motion_radius_px,
            t.motion_min_matches,
            t.motion_min_inliers,
        ) = (3.0, 40, 36);
        t.reference_min_matches = 25;
        let mut world = World::with_camera(uneven_camera(), config);
        let mut last = world.see(0, &points(), &before());
        last.camera_from_world = before();
        world.remember(last.clone(), &points());
        last.landmark = world
            .map
            .keyframe(garad_core::KeyframeId(0))
            .landmark
            .clone();
        last.landmark[linked..].fill(None);
        let mut now = world.see(1, &points(), &(small_motion() * before()));
        now.landmark.fill(last.landmark[0]); // left over from another try
        (world, last, now)
    }

    fn by_motion((world, last, now): (World, Frame, &mut Frame), velocity: Se3) -> bool {
        let (shutter, recorder) = (&ShutterModel::new(), &mut Recorder::default());
        track_motion(
            &world.context,
            &world.map,
            &last,
            &velocity,
            now,
            shutter,
            recorder,
        )
    }

    fn off(frame: &Frame) -> f64 {
        let truth = small_motion() * before();
        (frame.camera_from_world * truth.inverse()).log().norm()
    }

    /// The two motions do not commute: with the other order, points are some pixels aside.
    #[test]
    fn the_motion_is_applied_to_the_last_pose() {
        let (mut world, last, mut now) = scene(70);
        world.context.config.tracking.motion_radius_px = 0.25;
        let tracked = by_motion((world, last.clone(), &mut now), small_motion());
        assert!(tracked && off(&now) < 1e-4, "{}", off(&now));
        assert_eq!(now.landmark, last.landmark, "links");
    }

    /// x at the depth of a cloud's point moves by 110 px·m / z per metre.
    #[test]
    fn the_motion_so_far_goes_on() {
        for (what, aside_m, linked, found) in [
            ("as predicted", 0.0, 70, true),
            ("forty matches", 0.0, 40, true),
            ("one too few", 0.0, 39, false),
            ("4 to 6 px aside: within twice the radius", 0.095, 70, true),
            ("more than 6 px aside", 0.2, 70, false),
        ] {
            let (world, last, mut now) = scene(linked);
            let aside = Se3::exp(&[aside_m, 0.0, 0.0, 0.0, 0.0, 0.0].into());
            let tracked = by_motion((world, last.clone(), &mut now), aside * small_motion());
            assert_eq!(tracked, found, "{what}");
            if found {
                assert!(off(&now) < 1e-4, "{what}: {}", off(&now));
                assert_eq!(now.landmark, last.landmark, "{what}: links");
            }
        }
    }

    /// 41 matches, some of them 2.9 px off: within the radius, beyond √5.99.
    #[test]
    fn too_few_inliers_are_no_pose() {
        for (wrong, found) in [(5, true), (6, false)] {
            let (world, last, mut now) = scene(41);
            for i in (0..wrong).map(|k| 7 * k) {
                now.uv_px[i].y += if i % 2 == 0 { 2.9 } else { -2.9 };
            }
            let tracked = by_motion((world, last, &mut now), small_motion());
            assert_eq!(tracked, found, "{wrong} of 41 are wrong");
            let links = now.landmark.iter().flatten().count();
            assert_eq!(links, 41 - wrong, "the wrong ones are unlinked");
        }
    }

    #[test]
    fn the_reference_is_searched_by_descriptor_from_the_last_pose() {
        for (linked, found) in [(36, true), (35, false), (25, false), (24, false)] {
            let (world, last, mut now) = scene(linked);
            let mut reference = last.clone();
            reference.camera_from_world = Se3::identity();
            let (shutter, recorder) = (&ShutterModel::new(), &mut Recorder::default());
            let tracked = track_reference(
                &world.context,
                &world.map,
                &last,
                &reference,
                &mut now,
                shutter,
                recorder,
            );
            assert_eq!(tracked, found, "{linked} landmarks, 36 inliers needed");
            assert_eq!(now.landmark, last.landmark, "{linked}: links");
            if linked >= 25 {
                assert!(
                    off(&now) < 1e-4,
                    "{linked} matches are enough: {}",
                    off(&now)
                );
            } else {
                assert_eq!(
                    now.camera_from_world,
                    before(),
                    "{linked}: no pose is tried"
                );
            }
        }
    }
}
