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
#[must_use]
pub fn landmark_cues(
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

#[cfg(test)]
mod tests {
    use garad_core::{FrameId, Label, LandmarkId};
    use garad_crf::DepthNoise;

    use super::*;
    use crate::config::Config;
    use crate::testing::{World, wall};

    /// A landmark at 3 m that so many keyframes observe, and measure this far behind it.
    fn measured(behind_m: &[Option<f64>], depth_cue: DepthCue) -> (World, LandmarkId) {
        let mut config = Config::default();
        config.labels.depth_cue = depth_cue;
        config.labels.noise = DepthNoise {
            per_m: 0.0,
            floor_m: 0.02,
        };
        let mut world = World::new(config);
        let mut made = None;
        for (k, behind_m) in (0u32..).zip(behind_m) {
            let mut frame = world.frame(10 * k, &wall());
            frame.landmark[0] = made;
            frame.depth_m[0] = behind_m.map(|behind| 3.0 + behind);
            let id = world.keep(frame, &wall());
            if made.is_none() {
                let keyframe = world.map.keyframe_mut(id);
                keyframe.depth_m[0] = Some(3.0);
                let p_world = keyframe.world_point(0, &world.context.camera);
                let scales = world.context.scales.clone();
                let p_world = p_world.expect("on the wall");
                made = Some(world.map.add_landmark(p_world, id, 0, &scales));
                world.map.keyframe_mut(id).depth_m[0] = behind_m.map(|behind| 3.0 + behind);
            }
        }
        (world, made.expect("one at least"))
    }

    fn residual((world, id): &(World, LandmarkId)) -> Option<f64> {
        let landmark = world.map.landmark(*id).expect("alive");
        let (context, map) = (&world.context, &world.map);
        let history = world.dynamics.history(context, map, FrameId(50));
        landmark_cues(context, map, landmark, &history).depth_residual
    }

    /// One standard deviation of the sensor is 0.02 m.
    #[test]
    fn the_spread_of_depth_is_the_standard_deviation_of_its_residuals() {
        let spread = |behind_m: &[Option<f64>]| residual(&measured(behind_m, DepthCue::Spread));
        let two = spread(&[Some(0.02), Some(-0.02)]).expect("two");
        assert!((two - 2f64.sqrt()).abs() < 1e-9, "+1 and -1: {two}");
        let two = spread(&[Some(0.1), Some(0.06)]).expect("two");
        assert!((two - 2f64.sqrt()).abs() < 1e-9, "5 and 3: {two}");
        let three = spread(&[Some(0.02), None, Some(0.0), Some(-0.02)]).expect("three");
        assert!((three - 1.0).abs() < 1e-9, "1, 0, -1: {three}");
        assert_eq!(spread(&[Some(0.02)]), None, "one observation");
        assert_eq!(spread(&[Some(0.02), None]), None, "one with depth");
    }

    /// Free space ends at the wall, where the landmark is; its own depths are 1 sigma behind and in front.
    #[test]
    fn the_setting_says_which_depth_cue_is_read() {
        let behind_m = [Some(0.02), Some(-0.02)];
        let [free_space, spread] = [DepthCue::FreeSpace, DepthCue::Spread]
            .map(|cue| residual(&measured(&behind_m, cue)).expect("seen"));
        assert!(free_space.abs() < 1e-6, "on the surface: {free_space}");
        assert!(spread > 1.4, "{spread}");
        let (world, id) = measured(&behind_m, DepthCue::Spread);
        let landmark = world.map.landmark(id).expect("alive");
        assert_eq!(landmark.label(), Label::Static, "reading changes nothing");
    }
}
