//! Matches sharpened: where exactly a landmark is in the frame, by Lucas-Kanade against the picture
//! it was learnt from (decision 003).
//!
//! A keypoint sits on a whole pixel of its level, up to 3.6 px of the full picture; its partner in
//! another frame on another one. The patch around it says within a tenth of a pixel where it went.
//! Once a first pose is known, each linked landmark's patch is followed from its oldest keyframe
//! still at hand to the place the pose predicts: no chain of frames, so nothing drifts.

use std::collections::BTreeMap;

use garad_core::{DepthImage, KeyframeId};
use garad_features::{LkConfig, LkPyramid, lk};
use nalgebra::Vector2;

use crate::frame::Frame;
use crate::system::Slam;

/// One landmark to follow: keypoint in the frame, place in the keyframe, place predicted.
type Task = (usize, [f32; 2], [f32; 2]);

impl Slam {
    /// Moves the frame's linked keypoints to where the patches of their landmarks are found, and
    /// gives them the σ of such a find. Those that are not found where the pose expects them keep
    /// their place and σ. Returns how many moved.
    pub(crate) fn refine(
        &self,
        frame: &mut Frame,
        pyramid: &LkPyramid,
        depth: &DepthImage,
    ) -> usize {
        let config = &self.config.refine;
        let lk_config = LkConfig {
            max_residual: Some(config.max_residual),
            ..LkConfig::default()
        };
        let mut moved = 0;
        for (keyframe, tasks) in self.refine_tasks(frame) {
            let Some(from) = self.pyramids.get(&keyframe) else {
                continue;
            };
            let points: Vec<_> = tasks.iter().map(|t| t.1).collect();
            let starts: Vec<_> = tasks.iter().map(|t| t.2).collect();
            // Pictures of one camera have one size: the answer is never an error.
            let tracks = lk::track(from, pyramid, &points, Some(&starts), &lk_config, self.par)
                .unwrap_or_default();
            self.tape.put("refine", |page| {
                page.tracks([from, pyramid], [&points, &starts], &tracks);
            });
            for ((i, _, start), track) in tasks.iter().zip(&tracks) {
                let off = (track.xy[0] - start[0])
                    .abs()
                    .max((track.xy[1] - start[1]).abs());
                if track.is_tracked() && f64::from(off) < config.max_shift_px {
                    let px = Vector2::from(track.xy.map(f64::from));
                    frame.move_keypoint(*i, px, config.sigma_px, depth, &self.camera, &self.config);
                    moved += 1;
                }
            }
        }
        moved
    }

    /// What to follow from which keyframe, in order of keyframes and keypoints.
    fn refine_tasks(&self, frame: &Frame) -> BTreeMap<KeyframeId, Vec<Task>> {
        let mut tasks: BTreeMap<KeyframeId, Vec<Task>> = BTreeMap::new();
        let youngest = self.pyramids.keys().rev();
        let youngest: Vec<_> = youngest.take(self.config.refine.keyframes).collect();
        for i in 0..frame.len() {
            let Some(landmark) = frame.landmark[i].and_then(|l| self.map.landmark(l)) else {
                continue;
            };
            let oldest = landmark
                .observations
                .iter()
                .find(|(k, _)| youngest.contains(&k))
                .filter(|(k, j)| self.map.keyframe(*k).one_surface[*j]);
            let predicted = self
                .camera
                .project(&(frame.camera_from_world * landmark.p_world));
            if let (Some((keyframe, j)), Some(uv)) = (oldest, predicted) {
                let from = self.map.keyframe(*keyframe).px[*j];
                let start = self.camera.distort_pixel(&uv);
                let task = (i, to_f32(&from), to_f32(&start));
                tasks.entry(*keyframe).or_default().push(task);
            }
        }
        tasks
    }
}

#[allow(clippy::cast_possible_truncation, reason = "the tracker works in f32")]
pub(crate) fn to_f32(p: &Vector2<f64>) -> [f32; 2] {
    [p.x as f32, p.y as f32]
}
