//! The four cues of eq. 2 for one landmark, from the keyframes that observe it.

use garad_crf::Cues;
use garad_features::epipolar::{fundamental, symmetric_distance_px};

use super::evidence::FreeSpaceHistory;
use crate::context::Context;
use crate::map::Map;
use crate::map::landmark::Landmark;

/// Baselines shorter than this share of the depth give no epipolar line worth measuring against.
const MIN_BASELINE: f64 = 0.02;

/// α: mean reprojection error; β: depth residual; γ: number of observations; δ: mean epipolar
/// distance to the first observation (the cues of eq. 2).
pub(crate) fn landmark_cues(
    context: &Context,
    map: &Map,
    landmark: &Landmark,
    history: &FreeSpaceHistory<'_>,
) -> Cues {
    let camera = &context.camera;
    let p = landmark.p_world;
    let mut reproj = (0.0, 0usize);
    let mut epipolar = (0.0, 0usize);
    let first = landmark.observations.first();
    for (k, i) in &landmark.observations {
        let frame = map.keyframe(*k);
        if let Some(uv) = camera.project(&(frame.camera_from_world * p)) {
            reproj = (reproj.0 + (uv - frame.uv_px[*i]).norm(), reproj.1 + 1);
        }
        let Some((k0, i0)) = first.filter(|(k0, _)| k0 != k) else {
            continue;
        };
        let origin = map.keyframe(*k0);
        let baseline_m = (frame.center() - origin.center()).norm();
        if baseline_m > MIN_BASELINE * (p - origin.center()).norm() {
            let second_from_first = frame.camera_from_world * origin.camera_from_world.inverse();
            let f = fundamental(camera, camera, &second_from_first);
            let d = symmetric_distance_px(&f, &origin.uv_px[*i0], &frame.uv_px[*i]);
            if d.is_finite() {
                epipolar = (epipolar.0 + d, epipolar.1 + 1);
            }
        }
    }
    let mean = |(sum, n): (f64, usize)| (n > 0).then(|| sum / n as f64);
    Cues {
        reproj_px: mean(reproj),
        depth_residual: history.query(&p).residual,
        observations: u32::try_from(landmark.observations.len()).ok(),
        epipolar_px: mean(epipolar),
    }
}
