//! The four cues of eq. 2 for one landmark, from the keyframes that observe it.

use garad_core::KeyframeId;
use garad_crf::Cues;
use garad_features::epipolar::{fundamental, symmetric_distance_px};

use super::evidence::FreeSpaceHistory;
use crate::config::DepthCue;
use crate::context::Context;
use crate::map::Map;
use crate::map::landmark::Landmark;

/// Baselines shorter than this share of the depth give no epipolar line worth measuring against.
const MIN_BASELINE: f64 = 0.02;

/// α: mean reprojection error; β: depth residual (`labels.depth_cue`); γ: number of observations; δ: mean epipolar
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
        depth_residual: match context.config.labels.depth_cue {
            DepthCue::FreeSpace => history.query(&p).residual,
            DepthCue::Spread => depth_spread(context, map, landmark),
        },
        observations: u32::try_from(landmark.observations.len()).ok(),
        epipolar_px: mean(epipolar),
    }
}

/// The printed β, "depth variation": the standard deviation of rₖ = (measured - predicted depth) / σ over the n
/// observations with depth,
///
/// β = √(Σ (rₖ - r̄)² / (n - 1));   `None` for n < 2
fn depth_spread(context: &Context, map: &Map, landmark: &Landmark) -> Option<f64> {
    let noise = &context.config.labels.noise;
    let residual = |(k, i): &(KeyframeId, usize)| {
        let frame = map.keyframe(*k);
        let measured_m = frame.depth_m[*i]?;
        let predicted_m = (frame.camera_from_world * landmark.p_world).z;
        Some((measured_m - predicted_m) / noise.sigma_m(measured_m))
    };
    let residuals: Vec<f64> = landmark.observations.iter().filter_map(residual).collect();
    let n = residuals.len() as f64;
    let mean = residuals.iter().sum::<f64>() / n;
    let squares = residuals.iter().map(|r| (r - mean) * (r - mean));
    (residuals.len() > 1).then(|| (squares.sum::<f64>() / (n - 1.0)).sqrt())
}
