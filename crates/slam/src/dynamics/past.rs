//! [`PastView`]: what an earlier frame saw, and [`ReferenceImage`]: an image of another time in which a sample
//! is searched for.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use garad_core::{Camera, FrameId, KeyframeId, RollingShutter, Se3};
use garad_features::LkPyramid;
use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::bootstrap::FutureView;
use super::free_space::FreeSpace;
use crate::context::Context;
use crate::map::Map;

/// Least distance to a future view, frames.
const MIN_FUTURE_FRAMES: u32 = 3;

/// The free space of an earlier frame, its image while that is young enough, and its pose relative to a
/// keyframe.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct PastView {
    pub(crate) frame: FrameId,
    pub(super) reference: KeyframeId,
    pub(super) frame_from_reference: Se3,
    pub(super) shutter: RollingShutter,
    pub(super) free_space: FreeSpace,
    pub(super) image: Option<Arc<LkPyramid>>,
}

impl PastView {
    pub(super) fn camera_from_world(&self, map: &Map) -> Se3 {
        self.frame_from_reference * map.keyframe(self.reference).camera_from_world
    }
}

/// An image of another time, and the pose it was taken from.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ReferenceImage<'a> {
    pub(super) pyramid: &'a LkPyramid,
    camera_from_world: Se3,
    shutter: RollingShutter,
    free_space: &'a FreeSpace,
    /// Frames between then and now.
    pub(super) age_frames: u32,
}

#[cfg(test)]
impl<'a> ReferenceImage<'a> {
    /// An image of ten frames ago.
    pub(super) fn new(
        pyramid: &'a LkPyramid,
        free_space: &'a FreeSpace,
        camera_from_world: Se3,
    ) -> Self {
        Self {
            pyramid,
            camera_from_world,
            shutter: RollingShutter::global(),
            free_space,
            age_frames: 10,
        }
    }
}

impl ReferenceImage<'_> {
    /// Where a point is seen in it if it has been static, px; `None` outside.
    pub(super) fn predicted_pixel(
        &self,
        camera: &Camera,
        p_world: &Vector3<f64>,
    ) -> Option<Vector2<f64>> {
        let uv = camera.project(&(self.camera_from_world * *p_world))?;
        let inside = camera.contains(&uv);
        inside.then(|| self.shutter.recorded_pixel(camera, &uv))
    }

    pub(super) fn center(&self) -> Vector3<f64> {
        self.camera_from_world.inverse().translation
    }

    /// Whether it has depth around a point, and no surface there that is nearer by `edge_m`: nothing hid it.
    pub(super) fn sees(&self, camera: &Camera, p_world: &Vector3<f64>, edge_m: f64) -> bool {
        let p_cam = self.camera_from_world * *p_world;
        let nearest_m = self.free_space.nearest_m(&p_cam, camera);
        nearest_m.is_some_and(|nearest_m| nearest_m > p_cam.z - edge_m)
    }
}

/// The image whose age is nearest to `rest_frames`: by it the flow check judges. Of two that are as near the first.
pub(super) fn nearest_to_rest<'a, 'b>(
    references: &'b [ReferenceImage<'a>],
    rest_frames: u32,
) -> Option<&'b ReferenceImage<'a>> {
    let off = |r: &&ReferenceImage<'_>| r.age_frames.abs_diff(rest_frames);
    references.iter().min_by_key(off)
}

/// The past views whose ages are nearest to those configured, and the future views.
pub(crate) fn reference_images<'a>(
    context: &Context,
    map: &Map,
    past: &'a VecDeque<PastView>,
    future: &'a [FutureView],
    now: FrameId,
) -> Vec<ReferenceImage<'a>> {
    let config = &context.config.labels.patch_motion;
    // A replayed frame has past views that are younger.
    let age = |view: &PastView| now.0.checked_sub(view.frame.0);
    let kept = past.iter().filter(|view| view.image.is_some());
    let aged: Vec<(&PastView, u32)> = kept.filter_map(|v| Some((v, age(v)?))).collect();
    let chosen: BTreeMap<FrameId, &PastView> = config
        .ages_frames
        .iter()
        .filter_map(|wanted| {
            let off = |(_, age): &&(&PastView, u32)| age.abs_diff(*wanted);
            let nearest = aged.iter().min_by_key(off);
            nearest.filter(|k| off(k) <= config.slack_frames())
        })
        .map(|(view, _)| (view.frame, *view))
        .collect();
    let past = chosen.into_values().filter_map(|view| {
        Some(ReferenceImage {
            pyramid: view.image.as_deref()?,
            camera_from_world: view.camera_from_world(map),
            shutter: view.shutter,
            free_space: &view.free_space,
            age_frames: now.0 - view.frame.0,
        })
    });
    let future = future.iter().filter_map(|view| {
        let far = now.0.abs_diff(view.frame.0) >= MIN_FUTURE_FRAMES;
        Some(ReferenceImage {
            pyramid: view.pyramid.as_ref().filter(|_| far)?,
            camera_from_world: view.camera_from_world,
            shutter: RollingShutter::global(),
            free_space: &view.free_space,
            age_frames: now.0.abs_diff(view.frame.0),
        })
    });
    past.chain(future).collect()
}

#[cfg(test)]
mod tests {
    use garad_core::{DepthImage, GrayImage};
    use nalgebra::Vector6;

    use super::*;
    use crate::config::Config;
    use crate::testing::{World, wall};

    fn image() -> LkPyramid {
        LkPyramid::new(&GrayImage::new(160, 120, 90), 1).expect("an image")
    }

    fn camera() -> Camera {
        Camera::pinhole((160, 120), [120.0, 110.0, 82.0, 57.0]).expect("valid")
    }

    const NOW: FrameId = FrameId(100);

    /// Ages wanted: 16, 40 and 7 frames, each of which may be 3 off.
    fn world() -> World {
        let mut config = Config::default();
        config.labels.patch_motion.ages_frames = [16, 40, 7];
        let mut world = World::with_camera(camera(), config);
        let mut keyframe = world.frame(0, &wall());
        keyframe.camera_from_world = Se3::exp(&Vector6::new(0.3, -0.1, 0.2, 0.1, -0.2, 0.05));
        world.map.add_keyframe(keyframe);
        world
    }

    fn past_view(frame: u32, has_image: bool) -> PastView {
        PastView {
            frame: FrameId(frame),
            reference: KeyframeId(0),
            frame_from_reference: Se3::exp(&Vector6::new(0.2, 0.4, -0.3, -0.1, 0.05, 0.2)),
            shutter: RollingShutter::global(),
            free_space: FreeSpace::new(&wall(), 8.0),
            image: has_image.then(|| Arc::new(image())),
        }
    }

    fn future_view(frame: u32, has_image: bool) -> FutureView {
        FutureView {
            frame: FrameId(frame),
            free_space: FreeSpace::new(&wall(), 8.0),
            pyramid: has_image.then(image),
            camera_from_world: Se3::exp(&Vector6::new(-0.5, 0.1, 0.0, 0.0, 0.0, 0.3)),
        }
    }

    fn ages(world: &World, past: &[(u32, bool)], future: &[(u32, bool)]) -> Vec<u32> {
        let past = past.iter().map(|(frame, image)| past_view(*frame, *image));
        let past: VecDeque<PastView> = past.collect();
        let future = future
            .iter()
            .map(|(frame, image)| future_view(*frame, *image));
        let future: Vec<FutureView> = future.collect();
        let references = reference_images(&world.context, &world.map, &past, &future, NOW);
        references.iter().map(|r| r.age_frames).collect()
    }

    #[test]
    fn past_images_are_those_nearest_to_the_ages_wanted_oldest_first() {
        let world = world();
        let cases: [(&[u32], &[u32]); 9] = [
            (&[], &[]),
            (&[57, 60, 63, 84, 93, 98], &[40, 16, 7]),
            (&[57, 81, 96], &[43, 19, 4]),  // 3 off
            (&[63, 87, 90], &[37, 13, 10]), // 3 off
            (&[56, 64, 80, 97], &[]),       // 4 off
            (&[82, 86], &[18]),             // both 2 off: the older one
            (&[89], &[]),                   // 4 off 7, 5 off 16
            (&[93, 60, 84], &[40, 16, 7]),  // in any order
            (&[107, 116, 140], &[]),        // younger
        ];
        for (frames, expected) in cases {
            let past: Vec<_> = frames.iter().map(|frame| (*frame, true)).collect();
            assert_eq!(ages(&world, &past, &[]), expected, "{frames:?}");
        }
        let without_image = [(84, false), (83, true), (93, false)];
        assert_eq!(ages(&world, &without_image, &[]), [17], "images alone");
    }

    /// One view may be the nearest to two ages.
    #[test]
    fn no_image_is_compared_with_twice() {
        let mut world = world();
        world.context.config.labels.patch_motion.ages_frames = [8, 10, 40];
        assert_eq!(ages(&world, &[(91, true)], &[]), [9]);
    }

    #[test]
    fn the_flow_check_takes_the_image_nearest_to_rest_frames() {
        let (pyramid, free_space) = (image(), FreeSpace::new(&wall(), 8.0));
        for (ages, rest_frames, expected) in [
            (&[][..], 12, None),
            (&[40], 12, Some(0)),
            (&[40, 16, 7], 12, Some(1)),
            (&[40, 17, 7], 12, Some(1)), // both 5 off: the first
            (&[40, 18, 7], 12, Some(2)),
            (&[7, 17, 40], 12, Some(0)),
            (&[40, 16, 7], 29, Some(0)),
            (&[40, 16, 7], 27, Some(1)),
            (&[16, 40, 16], 16, Some(0)),
            (&[40, 16, 7], 1, Some(2)),
        ] {
            let reference = |age_frames| ReferenceImage {
                age_frames,
                ..ReferenceImage::new(&pyramid, &free_space, Se3::identity())
            };
            let references: Vec<_> = ages.iter().copied().map(reference).collect();
            let found = nearest_to_rest(&references, rest_frames);
            let expected = expected.map(|i: usize| &references[i]);
            let same = match (found, expected) {
                (Some(found), Some(expected)) => std::ptr::eq(found, expected),
                (found, expected) => found.is_none() && expected.is_none(),
            };
            assert!(
                same,
                "{ages:?}, {rest_frames}: {:?}",
                found.map(|r| r.age_frames)
            );
        }
    }

    #[test]
    fn future_images_follow_from_three_frames_on() {
        let future = [
            (110, false),
            (104, true),
            (102, true),
            (103, true),
            (98, true),
            (97, true),
        ];
        let found = ages(&world(), &[(84, true), (60, true)], &future);
        assert_eq!(found, [40, 16, 4, 3, 3]);
    }

    /// A past view moves with its keyframe.
    #[test]
    fn images_have_the_poses_of_their_views() {
        let mut world = world();
        let (past, future) = (past_view(84, true), future_view(104, true));
        let relative = past.frame_from_reference;
        let (past, future) = (VecDeque::from([past]), [future]);
        for moved in [
            Se3::identity(),
            Se3::exp(&Vector6::new(0.1, 0.2, 0.3, 0.3, 0.2, 0.1)),
        ] {
            let keyframe = world.map.keyframe_mut(KeyframeId(0));
            keyframe.camera_from_world = moved * keyframe.camera_from_world;
            let expected = relative * keyframe.camera_from_world;
            let centre = -(expected.rotation.matrix().transpose() * expected.translation);
            let found = reference_images(&world.context, &world.map, &past, &future, NOW);
            assert_eq!(found.len(), 2, "one of each");
            let off = (found[0].camera_from_world * expected.inverse())
                .log()
                .norm();
            assert!(off < 1e-12, "{off}");
            assert!((found[0].center() - centre).norm() < 1e-12, "{centre}");
            assert_eq!(found[1].camera_from_world, future[0].camera_from_world);
        }
    }

    /// The camera 0.3 m to the left of the world's origin and 0.1 m below it: with f = (120, 110) px a point at 3 m is
    /// 12 px further right and 3.67 px higher.
    #[test]
    fn a_static_point_is_predicted_where_the_image_was_recorded() {
        let (pyramid, free_space) = (image(), FreeSpace::new(&wall(), 8.0));
        let pose = Se3::exp(&Vector6::new(0.3, -0.1, 0.0, 0.0, 0.0, 0.0));
        let mut reference = ReferenceImage::new(&pyramid, &free_space, pose);
        let at = |reference: &ReferenceImage<'_>, x, y, z| {
            reference.predicted_pixel(&camera(), &Vector3::new(x, y, z))
        };
        let found = at(&reference, 0.0, 0.0, 3.0).expect("inside");
        let expected = Vector2::new(82.0 + 12.0, 57.0 - 11.0 / 3.0);
        assert!((found - expected).norm() < 1e-12, "{found}");
        for outside in [
            [1.7, 0.0, 3.0],
            [-2.4, 0.0, 3.0],
            [0.0, 1.9, 3.0],
            [0.0, 0.0, -3.0],
        ] {
            let [x, y, z] = outside;
            assert_eq!(at(&reference, x, y, z), None, "{outside:?}");
        }
        reference.shutter.turn_rad = Vector3::new(0.02, -0.05, 0.03);
        let recorded = at(&reference, 0.9, -0.6, 3.0).expect("inside");
        let ideal = (reference.shutter.ideal_pixel(&camera(), &recorded)).expect("no distortion");
        let expected = Vector2::new(82.0 + 48.0, 57.0 - 110.0 * 0.7 / 3.0);
        assert!((ideal - expected).norm() < 1e-5, "{ideal}");
        assert!((recorded - expected).norm() > 0.5, "it turned: {recorded}");
    }

    /// The camera is a metre behind the world's origin, and the wall 3 m before it.
    #[test]
    fn a_point_is_seen_unless_something_nearer_by_the_edge_is_around() {
        let (pyramid, free_space) = (image(), FreeSpace::new(&wall(), 8.0));
        let pose = Se3::exp(&Vector6::new(0.0, 0.0, 1.0, 0.0, 0.0, 0.0));
        let nothing = FreeSpace::new(&DepthImage::new(160, 120, 0.0), 8.0);
        for (x, z, edge_m, expected) in [
            (0.0, 1.0, 0.25, true),
            (0.0, 2.0, 0.25, true),
            (0.0, 2.24, 0.25, true),
            (0.0, 2.25, 0.25, false),
            (0.0, 2.26, 0.25, false),
            (0.0, 2.26, 0.5, true),
            (9.0, 2.0, 0.25, false),
        ] {
            let p_world = Vector3::new(x, 0.0, z);
            let sees = |free_space| {
                let reference = ReferenceImage::new(&pyramid, free_space, pose);
                reference.sees(&camera(), &p_world, edge_m)
            };
            assert_eq!(sees(&free_space), expected, "x = {x}, z = {z}, {edge_m}");
            assert!(!sees(&nothing), "without depth");
        }
    }
}
