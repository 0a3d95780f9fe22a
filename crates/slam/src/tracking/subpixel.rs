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
