//! Subpixel matches: the position of a landmark in the frame, by Lucas-Kanade against the image that
//! first saw it (decision 003).
//!
//! A keypoint sits on a whole pixel of its level, up to 3.6 px of the full image; so does its partner
//! in another frame. The patch around it gives its motion to a tenth of a pixel. Once a first pose
//! is known, each linked landmark's patch is tracked from its oldest keyframe still kept to the
//! position that the pose predicts: no chain of frames, so nothing drifts.

use std::collections::BTreeMap;

use garad_core::{DepthImage, KeyframeId};
use garad_features::{LkConfig, LkPyramid, lk};
use nalgebra::Vector2;

use crate::context::Context;
use crate::frame::Frame;
use crate::images::{ImageStore, lk_point};
use crate::map::Map;
use crate::trace::Recorder;

/// One landmark to track: keypoint in the frame, position in the keyframe, predicted position.
type Task = (usize, [f32; 2], [f32; 2]);

/// Moves the frame's linked keypoints to where the patches of their landmarks are found, and
/// gives them the σ of such a match. Those that are not found where the pose predicts them keep
/// their position and σ.
pub(crate) fn refine_matches(
    context: &Context,
    map: &Map,
    images: &ImageStore,
    frame: &mut Frame,
    pyramid: &LkPyramid,
    depth: &DepthImage,
    recorder: &mut Recorder,
) {
    let config = &context.config.subpixel;
    let lk_config = LkConfig {
        max_residual: Some(config.max_residual),
        ..LkConfig::default()
    };
    for (keyframe, tasks) in tasks(context, map, images, frame) {
        let from = images.get(keyframe).expect("tasks are of kept images");
        let points: Vec<_> = tasks.iter().map(|t| t.1).collect();
        let starts: Vec<_> = tasks.iter().map(|t| t.2).collect();
        let par = context.par;
        let tracks = lk::track(from, pyramid, &points, Some(&starts), &lk_config, par)
            .expect("images of one camera have one size, and there is a start per point");
        recorder.record("subpixel", |record| {
            record.tracks([from, pyramid], [&points, &starts], &tracks);
        });
        for ((i, _, start), track) in tasks.iter().zip(&tracks) {
            let off = (track.xy[0] - start[0])
                .abs()
                .max((track.xy[1] - start[1]).abs());
            if track.is_tracked() && f64::from(off) < config.max_shift_px {
                let px = Vector2::from(track.xy.map(f64::from));
                let (camera, config) = (&context.camera, &context.config);
                frame.move_keypoint(*i, px, config.subpixel.sigma_px, depth, camera, config);
            }
        }
    }
}

/// The landmarks to track from each keyframe, in order of keyframes and keypoints.
fn tasks(
    context: &Context,
    map: &Map,
    images: &ImageStore,
    frame: &Frame,
) -> BTreeMap<KeyframeId, Vec<Task>> {
    let camera = &context.camera;
    let mut tasks: BTreeMap<KeyframeId, Vec<Task>> = BTreeMap::new();
    let youngest = images.keyframes().rev();
    let youngest: Vec<_> = youngest.take(context.config.subpixel.keyframes).collect();
    for i in 0..frame.len() {
        let Some(landmark) = frame.landmark[i].and_then(|l| map.landmark(l)) else {
            continue;
        };
        let oldest = landmark
            .observations
            .iter()
            .find(|(k, _)| youngest.contains(k))
            .filter(|(k, j)| map.keyframe(*k).one_surface[*j]);
        let predicted = camera.project(&(frame.camera_from_world * landmark.p_world));
        if let (Some((keyframe, j)), Some(uv)) = (oldest, predicted) {
            let from = map.keyframe(*keyframe).px[*j];
            let start = frame.shutter.recorded_pixel(camera, &uv);
            let task = (i, lk_point(&from), lk_point(&start));
            tasks.entry(*keyframe).or_default().push(task);
        }
    }
    tasks
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use garad_core::{GrayImage, LandmarkId};
    use nalgebra::Vector3;

    use super::*;
    use crate::config::Config;
    use crate::images::lk_pyramid;
    use crate::testing::{World, keypoints, texture, uneven_camera, wall};

    const PLACES: [[usize; 2]; 3] = [[40, 30], [80, 50], [120, 70]];

    /// Three keyframes and their images. Landmark 0 is observed by all of them, by their keypoints 0, 1
    /// and 2; landmark 1 by keyframe 0 alone, landmark 2 by keyframe 2 alone.
    fn three_keyframes(config: Config) -> (World, ImageStore, Frame) {
        let mut world = World::with_camera(uneven_camera(), config);
        let (context, mut images) = (world.context.clone(), ImageStore::default());
        let pyramid = lk_pyramid(&texture(), &context.config).map(Arc::new);
        let many = Config::default();
        let frame = |world: &World, id| world.frame_of(id, &keypoints(PLACES), &wall());
        for id in 0..3 {
            let seen = frame(&world, id);
            let id = world.map.add_keyframe(seen);
            images.insert(id, pyramid.clone(), &many);
        }
        let now = frame(&world, 3);
        let point = |i: usize| now.world_point(i, &context.camera).expect("on the wall");
        let (map, scales) = (&mut world.map, &context.scales);
        let first = map.add_landmark(point(0), KeyframeId(0), 0, scales);
        map.add_landmark(point(1), KeyframeId(0), 1, scales);
        map.add_landmark(point(2), KeyframeId(2), 0, scales);
        map.add_observation(first, KeyframeId(1), 1);
        map.add_observation(first, KeyframeId(2), 2);
        (world, images, now)
    }

    /// Of the two youngest images the oldest that observes the landmark.
    #[test]
    fn patches_come_from_the_oldest_image_still_compared_with() {
        let mut config = Config::default();
        config.subpixel.keyframes = 2;
        let (mut world, images, mut now) = three_keyframes(config);
        now.landmark = [2, 0, 1].map(|id| Some(LandmarkId(id))).to_vec();
        let turn_rad = Vector3::new(0.01, -0.02, 0.03);
        now.shutter = garad_core::RollingShutter { turn_rad };
        let uv_px = |p: [usize; 2]| Vector2::from(p.map(|c| c as f64));
        let start = |p| lk_point(&now.shutter.recorded_pixel(&uneven_camera(), &uv_px(p)));
        let (of_2, of_0) = (start(PLACES[2]), start(PLACES[0]));
        let close = |a: [f32; 2], b: [f32; 2]| (a[0] - b[0]).abs().max((a[1] - b[1]).abs()) < 1e-4;
        let found = tasks(&world.context, &world.map, &images, &now);
        let of: Vec<_> = found.iter().map(|(k, tasks)| (k.0, tasks.len())).collect();
        assert_eq!(of, [(1, 1), (2, 1)], "the image of landmark 1 is too old");
        let (i, from, to) = found[&KeyframeId(1)][0];
        assert_eq!((i, from), (1, [80.0, 50.0]), "landmark 0, by keypoint 1");
        assert!(
            close(to, of_0) && !close(to, [40.0, 30.0]),
            "{to:?}, as recorded"
        );
        let (i, from, to) = found[&KeyframeId(2)][0];
        assert_eq!((i, from), (0, [40.0, 30.0]), "landmark 2, by keypoint 0");
        assert!(close(to, of_2), "{to:?}");

        world.map.keyframe_mut(KeyframeId(1)).one_surface[1] = false;
        let behind = world.map.landmark_mut(LandmarkId(2)).expect("made");
        behind.p_world.z = -1.0;
        let found = tasks(&world.context, &world.map, &images, &now);
        assert!(
            found.is_empty(),
            "a depth edge, behind the camera: {found:?}"
        );
    }

    /// Where the frame's first keypoint is found after its image moved by whole pixels and became
    /// brighter, and whether it is taken.
    #[test]
    fn gates_of_a_subpixel_match() {
        for (what, [dx, dy], brighter, max_shift_px, max_residual, taken) in [
            ("2 px right", [2, 0], 0, 2.2, 20.0, true),
            ("too far right", [2, 0], 0, 1.8, 20.0, false),
            ("2 px left", [-2, 0], 0, 2.2, 20.0, true),
            ("too far left", [-2, 0], 0, 1.8, 20.0, false),
            ("2 px down", [0, 2], 0, 2.2, 20.0, true),
            ("too far down", [0, 2], 0, 1.8, 20.0, false),
            ("too far up", [0, -2], 0, 1.8, 20.0, false),
            ("2 px each way", [2, -2], 0, 2.2, 20.0, true),
            ("brighter", [0, 0], 12, 3.0, 18.0, true),
            ("too bright", [0, 0], 12, 3.0, 8.0, false),
        ] {
            let mut config = Config::default();
            let s = &mut config.subpixel;
            (s.sigma_px, s.max_shift_px, s.max_residual) = (0.35, max_shift_px, max_residual);
            let (world, images, mut now) = three_keyframes(config);
            now.landmark[0] = Some(LandmarkId(0));
            let before = now.clone();
            let still = texture();
            let image = GrayImage::from_fn(160, 120, |x, y| {
                let at = [(x, dx, 160), (y, dy, 120)]
                    .map(|(c, d, n): (usize, isize, usize)| c.saturating_add_signed(-d).min(n - 1));
                still[(at[0], at[1])] + brighter
            });
            let pyramid = lk_pyramid(&image, &world.context.config).expect("wanted");
            let (context, map, recorder) = (&world.context, &world.map, &mut Recorder::default());
            refine_matches(context, map, &images, &mut now, &pyramid, &wall(), recorder);
            assert_eq!(now.px[1..], before.px[1..], "{what}: not linked");
            if taken {
                let expected = before.px[0] + Vector2::new(dx as f64, dy as f64);
                let off = (now.px[0] - expected).norm();
                assert!(
                    off < if brighter > 0 { 1.5 } else { 0.1 },
                    "{what}: {off} px"
                );
                assert_eq!(Some(now.sigma_px[0]), Some(0.35), "{what}: σ");
            } else {
                assert_eq!(now.px[0], before.px[0], "{what}");
                assert_eq!(Some(now.sigma_px[0]), Some(1.0), "{what}: σ");
            }
        }
    }
}
