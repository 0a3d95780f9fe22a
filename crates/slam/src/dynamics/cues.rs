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
    use garad_core::{Camera, FrameId, Label, LandmarkId, Se3};
    use garad_crf::DepthNoise;
    use nalgebra::{Vector2, Vector3, Vector6};

    use super::*;
    use crate::config::Config;
    use crate::testing::{World, keypoints, wall};

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

    /// A keyframe's pose, how far its keypoint is beside the projected landmark, and the depth measured there.
    type Seen = (Se3, [f64; 2], Option<f64>);

    fn cues_of(p_world: [f64; 3], seen: &[Seen], depth_cue: DepthCue) -> Cues {
        let camera = Camera::pinhole((160, 120), [120.0, 110.0, 82.0, 57.0]).expect("valid");
        let mut config = Config::default();
        config.labels.depth_cue = depth_cue;
        config.labels.noise = DepthNoise {
            per_m: 0.01,
            floor_m: 0.001,
        };
        let mut world = World::with_camera(camera, config);
        let p_world = Vector3::from(p_world);
        let mut landmark = None;
        for (id, (pose, off_px, depth_m)) in (0u32..).zip(seen) {
            let mut frame = world.frame_of(id, &keypoints([[80, 60]]), &wall());
            frame.camera_from_world = *pose;
            frame.depth_m[0] = *depth_m;
            frame.sigma_px[0] = 2.0;
            let p_cam = *pose * p_world;
            let at = [120.0, 110.0].map(|f| f / p_cam.z);
            let uv = Vector2::new(82.0 + at[0] * p_cam.x, 57.0 + at[1] * p_cam.y);
            frame.uv_px[0] = uv + Vector2::from(*off_px);
            frame.landmark[0] = landmark;
            let keyframe = world.map.add_keyframe(frame);
            let scales = &world.context.scales;
            landmark =
                landmark.or_else(|| Some(world.map.add_landmark(p_world, keyframe, 0, scales)));
        }
        let id = landmark.expect("one observation at least");
        let landmark = world.map.landmark(id).expect("alive");
        let (context, map) = (&world.context, &world.map);
        let history = world.dynamics.history(context, map, FrameId(50));
        landmark_cues(context, map, landmark, &history)
    }

    fn pose(xi: [f64; 6]) -> Se3 {
        Se3::exp(&Vector6::from(xi))
    }

    /// A camera this far to the right of the origin.
    fn right_by(x: f64) -> Se3 {
        pose([-x, 0.0, 0.0, 0.0, 0.0, 0.0])
    }

    /// Keypoints 5, 2 and 13 px beside the landmark, and one of a camera that has it behind: α is the mean of three, γ
    /// counts all.
    #[test]
    fn alpha_is_the_mean_distance_in_pixels_and_gamma_the_number_of_observations() {
        let seen = [
            (Se3::identity(), [3.0, -4.0], None),
            (pose([0.1, -0.2, 0.3, 0.02, -0.03, 0.05]), [0.0, 2.0], None),
            (
                pose([-0.3, 0.1, -0.2, -0.04, 0.01, -0.02]),
                [-5.0, 12.0],
                None,
            ),
            (pose([0.0, 0.0, -9.0, 0.0, 0.0, 0.0]), [1.0, 1.0], None),
        ];
        let cues = |n: usize| cues_of([0.2, -0.1, 3.0], &seen[..n], DepthCue::FreeSpace);
        for (n, mean) in [(1, 5.0), (2, 3.5), (3, 20.0 / 3.0), (4, 20.0 / 3.0)] {
            let cues = cues(n);
            let found = cues.reproj_px.expect("in front of the first");
            assert!((found - mean).abs() < 1e-9, "{n} observations: {found}");
            assert_eq!(cues.observations, u32::try_from(n).ok(), "{n}");
            assert_eq!(cues.depth_residual, None, "no view in the history");
        }
    }

    /// Cameras beside each other, whose epipolar lines are rows. The third is nearer to the second than a line needs, but not to
    /// the first, which lines are drawn from.
    #[test]
    fn delta_is_the_mean_distance_to_the_line_of_the_first_observation() {
        let seen = [
            (right_by(5.0), [0.0, 0.0], None),
            (right_by(6.0), [3.0, 2.0], None),
            (right_by(6.03), [1.0, -4.0], None),
        ];
        let cues = |n: usize| cues_of([5.2, -0.1, 3.0], &seen[..n], DepthCue::FreeSpace);
        assert_eq!(cues(1).epipolar_px, None, "one alone");
        for (n, mean) in [(2, 2.0), (3, 3.0)] {
            let found = cues(n).epipolar_px.expect("a baseline");
            assert!((found - mean).abs() < 1e-9, "{n} observations: {found}");
        }
        // 2 in 100 of the distance of 3 m from the first camera; the world's origin is 5.8 m away.
        for (baseline_m, found) in [(0.059, false), (0.061, true)] {
            let seen = [
                (right_by(5.0), [0.0, 0.0], None),
                (right_by(5.0 + baseline_m), [0.0, 2.0], None),
            ];
            let cues = cues_of([5.0, 0.0, 3.0], &seen, DepthCue::FreeSpace);
            assert_eq!(cues.epipolar_px.is_some(), found, "{baseline_m} m");
        }
    }

    /// Predicted 3 m and measured as much; predicted 2 m by a camera a metre ahead, measured 2.1 m, where σ is
    /// 0.01 · 2.1² = 0.0441 m: residuals of 0 and 2.2676, √2 apart.
    #[test]
    fn the_spread_is_in_sigmas_at_the_depth_measured() {
        let ahead = pose([0.0, 0.0, -1.0, 0.0, 0.0, 0.0]);
        let seen = [
            (Se3::identity(), [0.0; 2], Some(3.0)),
            (ahead, [0.0; 2], Some(2.1)),
        ];
        let cues = cues_of([0.2, -0.1, 3.0], &seen, DepthCue::Spread);
        let found = cues.depth_residual.expect("two depths");
        assert!((found - 0.1 / 0.0441 / 2f64.sqrt()).abs() < 1e-9, "{found}");
    }
}
