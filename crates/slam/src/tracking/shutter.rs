//! The turn of the camera while an image was read out, from the frame's links (decision 014).

use garad_core::chi_square::{CHI2_2DOF_95, CHI2_3DOF_95};
use garad_core::{RollingShutter, Se3};
use garad_optim::{PoseAndTurn, PoseObservation, TurnConfig, optimise_pose_and_turn};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::observation::link_observation;
use crate::context::Context;
use crate::frame::Frame;
use crate::map::Map;

/// Links without which no turn is estimated: ten times as many as determine a pose.
const MIN_LINKS: usize = 30;
/// Trials of Levenberg-Marquardt.
const TRIALS: usize = 5;

/// Estimates pose and turn together over the links to static landmarks, and brings the keypoints to
/// the middle row. Nothing changes where the shutter is taken for a global one, or with few links.
pub(crate) fn estimate_shutter(
    context: &Context,
    map: &Map,
    frame: &mut Frame,
    model: &ShutterModel,
) -> Option<Vector3<f64>> {
    let config = &context.config.tracking;
    if config.shutter_sigma_rad <= 0.0 {
        return None;
    }
    let camera = &context.camera;
    let observations: Vec<(PoseObservation, f64)> = (0..frame.len())
        .filter_map(|i| {
            let landmark = map.static_landmark(frame.landmark[i]?)?;
            let recorded = PoseObservation {
                uv_px: camera.undistort_pixel(&frame.px[i])?,
                depth: None,
                ..link_observation(context, frame, i, landmark)
            };
            let row_time = RollingShutter::row_time(frame.px[i].y, camera.height);
            Some((recorded, row_time))
        })
        .collect();
    if observations.len() < MIN_LINKS {
        return None;
    }
    let initial = PoseAndTurn {
        camera_from_world: frame.camera_from_world,
        shutter: frame.shutter,
    };
    let (expected_rad, sigma_rad) = model.expected(frame, config.shutter_sigma_rad);
    let config = TurnConfig {
        bf: config.bf,
        iterations: TRIALS,
        huber: [CHI2_2DOF_95.sqrt(), CHI2_3DOF_95.sqrt()],
        expected_rad,
        sigma_rad,
    };
    let found = optimise_pose_and_turn(camera, &observations, &initial, &config);
    let turn_rad = found.shutter.turn_rad;
    if model.read_out_share() > 0.0 {
        frame.camera_from_world = found.camera_from_world;
        let turn_rad = model.corrected(turn_rad);
        frame.set_shutter(RollingShutter { turn_rad }, camera);
    }
    Some(turn_rad)
}

/// What is known of the camera's shutter, from the frames so far.
///
/// The turn ωₖ of a frame's read-out and the rotations Δ between frames come from the same motion:
/// ωₖ ≈ r (Δₖ + Δₖ₊₁) / 2, where reading out takes the share r of the time between two frames. r is
/// a regression of the one on the other, both taken from their running means (E23). A hand's tremble
/// separates rolling shutters (0.7 to 1) from global ones (0) within a second.
///
/// The mean of ω over many frames cannot be measured against a map that was itself made from such
/// frames: an error that all of them share is a bent image, and would drift. The mean is r Δ's instead:
/// what the measurements exceed r Δ by, on average over the last frames, is subtracted from them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct ShutterModel {
    /// Of ω and Δ from their means: Σ ω·ω, Σ ω·Δ, Σ Δ·Δ, and the number of frames.
    products_rad2: [f64; 3],
    frames: u32,
    /// ω of the last frame and the rotation that leads to it.
    last: Option<[Vector3<f64>; 2]>,
    /// Its pose.
    last_camera_from_world: Option<Se3>,
    /// Running means of ω and of Δ.
    means_rad: Option<[Vector3<f64>; 2]>,
}

/// Frames of the running means.
const MEAN_FRAMES: f64 = 8.0;
/// From this share on the shutter is a rolling one, ...
const ROLLING_SHARE: f64 = 0.3;
/// ... once that is certain: its standard deviations from 0.
const CERTAIN_SIGMAS: f64 = 3.0;

impl ShutterModel {
    /// Before the first frame: global.
    pub(crate) fn new() -> Self {
        Self {
            products_rad2: [0.0; 3],
            frames: 0,
            last: None,
            last_camera_from_world: None,
            means_rad: None,
        }
    }

    /// r: the share of the time between two frames that reading out takes; 0 for a global shutter, and
    /// until it is certain that there is another one: r ≥ 3 σᵣ, σᵣ² = Σ ‖ω - r Δ‖² / (3 n Σ Δ·Δ).
    pub(crate) fn read_out_share(&self) -> f64 {
        let [_, turn_rotation, rotation_rotation] = self.products_rad2;
        let r = turn_rotation / rotation_rotation;
        let sigma2 = self.residuals(r) / (3.0 * f64::from(self.frames) * rotation_rotation);
        let certain = r * r >= CERTAIN_SIGMAS * CERTAIN_SIGMAS * sigma2;
        // Before the first frames all of these are NaN, which is not certain.
        if certain && r >= ROLLING_SHARE {
            r.min(1.0)
        } else {
            0.0
        }
    }

    /// The turn expected of a frame and its standard deviation: the motion's, and how far the turns
    /// so far strayed from it; `any_rad` about 0 for a shutter not known to be a rolling one.
    fn expected(&self, frame: &Frame, any_rad: f64) -> (Vector3<f64>, f64) {
        let r = self.read_out_share();
        match (&self.means_rad, &self.last_camera_from_world) {
            (Some([turn, rotation]), Some(last)) if r > 0.0 => {
                let since_last = (frame.camera_from_world * last.inverse()).rotation.log();
                let sigma = (self.residuals(r) / (3.0 * f64::from(self.frames))).sqrt();
                (turn + r * (since_last - rotation), sigma.min(any_rad))
            }
            _ => (Vector3::zeros(), any_rad),
        }
    }

    /// Σ ‖ω - r Δ‖².
    fn residuals(&self, r: f64) -> f64 {
        let [turn_turn, turn_rotation, rotation_rotation] = self.products_rad2;
        turn_turn - 2.0 * r * turn_rotation + r * r * rotation_rotation
    }

    /// The turn to use for a measured one.
    fn corrected(&self, measured_rad: Vector3<f64>) -> Vector3<f64> {
        let r = self.read_out_share();
        match &self.means_rad {
            Some([turn, rotation]) if r > 0.0 => measured_rad - (turn - r * rotation),
            _ => Vector3::zeros(),
        }
    }

    /// The turn measured of a frame, if there was one, and its pose. `follows`: the frame is the next one
    /// after the last.
    pub(crate) fn update(
        &mut self,
        turn_rad: Option<Vector3<f64>>,
        camera_from_world: &Se3,
        follows: bool,
    ) {
        let before = self.last_camera_from_world.replace(*camera_from_world);
        let (Some(turn_rad), Some(before)) = (turn_rad, before.filter(|_| follows)) else {
            self.last = None;
            return;
        };
        let rotation_rad = (*camera_from_world * before.inverse()).rotation.log();
        let now = [turn_rad, rotation_rad];
        let means = self.means_rad.get_or_insert(now);
        if let Some([turn, rotation]) = self.last {
            let turn = turn - means[0];
            let rotation = 0.5 * (rotation + rotation_rad) - means[1];
            self.products_rad2[0] += turn.norm_squared();
            self.products_rad2[1] += turn.dot(&rotation);
            self.products_rad2[2] += rotation.norm_squared();
            self.frames += 1;
        }
        for (mean, now) in means.iter_mut().zip(now) {
            *mean += (now - *mean) / MEAN_FRAMES;
        }
        self.last = Some(now);
    }
}

#[cfg(test)]
mod tests {
    use garad_core::{Rng, So3};

    use super::*;
    use crate::config::Config;
    use crate::testing::{World, cloud, uneven_camera, wall};

    /// A hand that trembles at 5 Hz and pans, seen at 30 Hz by a camera whose rows take the share `r`
    /// of the time between frames; the turn is measured to `noise_rad`.
    fn tremble(r: f64, noise_rad: f64, frames: u32) -> ShutterModel {
        let sin = |phase: f64| So3::exp(&Vector3::new(0.0, 0.0, phase)).matrix()[(1, 0)];
        let angle = |t: f64| {
            let phase = std::f64::consts::TAU * 5.0 * t;
            Vector3::new(0.006 * sin(phase), 0.004 * sin(1.3 * phase + 1.5), 0.2 * t)
        };
        let mut rng = Rng::new(1);
        let mut model = ShutterModel::new();
        for k in 0..frames {
            let t = f64::from(k) / 30.0;
            let half = 0.5 * r / 30.0;
            let turn = angle(t + half) - angle(t - half);
            let noise = Vector3::from_fn(|_, _| noise_rad * rng.normal());
            let pose = Se3::new(So3::exp(&angle(t)), Vector3::zeros());
            model.update(Some(turn + noise), &pose, k > 0);
        }
        model
    }

    #[test]
    fn the_read_out_share_is_found() {
        for r in [0.5, 0.8, 1.0] {
            let found = tremble(r, 2e-4, 60).read_out_share();
            // Between two frames the tremble is not uniform: a tenth.
            assert!((found - r).abs() < 0.15 * r, "{found} for {r}");
        }
    }

    #[test]
    fn a_global_shutter_and_a_camera_at_rest_are_not_corrected() {
        for frames in [5, 30, 300] {
            let model = tremble(0.0, 5e-4, frames);
            assert!(model.read_out_share() == 0.0, "{model:?}");
            let measured = Vector3::new(1e-3, 0.0, 0.0);
            assert_eq!(
                model.corrected(measured),
                Vector3::zeros(),
                "{frames} frames"
            );
        }
        let mut still = ShutterModel::new();
        for k in 0..50 {
            still.update(Some(Vector3::zeros()), &Se3::identity(), k > 0);
        }
        assert!(still.read_out_share() == 0.0, "nothing is known: {still:?}");
    }

    /// Two frames are no evidence, however well they fit.
    #[test]
    fn a_rolling_shutter_must_be_certain() {
        assert!(tremble(0.8, 2e-4, 3).read_out_share() == 0.0);
    }

    /// An offset of all turns is not the camera's: it is a bent image.
    #[test]
    fn what_all_turns_share_is_subtracted() {
        let mut model = tremble(0.8, 0.0, 60);
        let offset = Vector3::new(3e-3, 0.0, 0.0);
        let pan = So3::exp(&Vector3::new(0.0, 0.0, 0.2 / 30.0));
        let mut pose = model.last_camera_from_world.expect("60 frames");
        for _ in 0..60 {
            pose = Se3::new(pan, Vector3::zeros()) * pose;
            let turn = model.read_out_share() * pan.log() + offset;
            model.update(Some(turn), &pose, true);
        }
        let turn = model.read_out_share() * pan.log();
        let left = (model.corrected(turn + offset) - turn).norm();
        assert!(left < 2e-4, "{left} rad of 3e-3 are left");
    }

    #[test]
    fn a_gap_is_no_rotation() {
        let before = tremble(0.8, 2e-4, 60);
        let mut after = before.clone();
        let elsewhere = Se3::new(So3::exp(&Vector3::new(0.0, 1.0, 0.0)), Vector3::zeros());
        after.update(Some(Vector3::zeros()), &elsewhere, false);
        assert_eq!(before.frames, after.frames, "no pair of frames");
    }

    fn model(products_rad2: [f64; 3], frames: u32) -> ShutterModel {
        ShutterModel {
            products_rad2,
            frames,
            ..ShutterModel::new()
        }
    }

    /// Σ Δ·Δ = 1e-4 of 12 frames: r = Σ ω·Δ / 1e-4, certain if Σ ω·ω - r Σ ω·Δ ≤ r² 12 · 3 · 1e-4 / 9.
    #[test]
    fn a_share_is_known_when_it_is_large_and_certain() {
        for (turn_turn, turn_rotation, expected) in [
            (1.24e-4, 5e-5, 0.5), // 2.5e-5 and 1e-4
            (1.26e-4, 5e-5, 0.0),
            (1e-5, 3.1e-5, 0.31),
            (1e-5, 2.9e-5, 0.0),
            (1e-5, -5e-5, 0.0),
            (1.5e-4, 1.2e-4, 1.0),
        ] {
            let r = model([turn_turn, turn_rotation, 1e-4], 12).read_out_share();
            assert!(
                (r - expected).abs() < 1e-12,
                "{turn_turn}, {turn_rotation}: {r}"
            );
        }
    }

    /// Angles about z. ω: 2, 10, 4 mrad; Δ: 10, 30, 20 mrad. Means after the first 2 and 10, after the second
    /// 2 + 8/8 and 10 + 20/8.
    #[test]
    fn products_are_of_deviations_from_running_means() {
        let about_z = |angle: f64| Vector3::new(0.0, 0.0, angle);
        let mut model = ShutterModel::new();
        let mut at = 0.1;
        model.update(
            Some(about_z(0.5)),
            &Se3::new(So3::exp(&about_z(at)), Vector3::x()),
            false,
        );
        let mut expected = [[0.0; 3], [0.0, 0.0, 1e-4], [4.9e-5, 8.75e-5, 2.5625e-4]].iter();
        for (frames, (turn, rotation)) in
            (0u32..).zip([(0.002, 0.010), (0.010, 0.030), (0.004, 0.020)])
        {
            at += rotation;
            let pose = Se3::new(So3::exp(&about_z(at)), Vector3::y());
            model.update(Some(about_z(turn)), &pose, true);
            assert_eq!(model.frames, frames, "pairs of frames");
            let expected = expected.next().expect("three");
            for (found, expected) in model.products_rad2.iter().zip(expected) {
                assert!(
                    (found - expected).abs() < 1e-12,
                    "{:?}",
                    model.products_rad2
                );
            }
        }
        let means = model.means_rad.expect("known").map(|m| m.z);
        assert!((means[0] - 0.003_125).abs() < 1e-12, "{means:?}");
        assert!((means[1] - 0.013_437_5).abs() < 1e-12, "{means:?}");
        let mut gap = model.clone();
        gap.update(None, &Se3::identity(), true);
        assert_eq!(gap.last, None, "no turn, no pair");
        assert_eq!(
            (gap.frames, gap.means_rad),
            (model.frames, model.means_rad),
            "nothing learnt"
        );
    }

    /// r = 0.5; mean ω (1, 2, 3) mrad, mean Δ (4, -2, 6) mrad: ω exceeds r Δ by (-1, 3, 0).
    #[test]
    fn the_expected_turn_and_the_corrected_one() {
        let world = World::new(Config::default());
        let mut frame = world.frame_of(1, &[], &wall());
        let last = Se3::exp(&[0.2, 0.1, 0.3, 0.1, -0.2, 0.3].into());
        let since = Vector3::new(0.010, 0.002, -0.004);
        frame.camera_from_world = Se3::new(So3::exp(&since), Vector3::y()) * last;
        let mut known = model([7.3e-5, 5e-5, 1e-4], 12);
        known.means_rad = Some([[0.001, 0.002, 0.003], [0.004, -0.002, 0.006]].map(Vector3::from));
        known.last_camera_from_world = Some(last);
        // ω̄ + r (Δ - Δ̄); σ² = (7.3e-5 - 2.5e-5) / 36 = (1/866)²
        let expected = Vector3::new(0.001 + 0.003, 0.002 + 0.002, 0.003 - 0.005);
        for (any_rad, sigma) in [(0.01, (4.8e-5f64 / 36.0).sqrt()), (0.0005, 0.0005)] {
            let (turn, found) = known.expected(&frame, any_rad);
            assert!((turn - expected).norm() < 1e-12, "{turn}");
            assert!((found - sigma).abs() < 1e-12, "{found}");
        }
        let corrected = known.corrected(Vector3::new(0.01, 0.02, 0.03));
        assert!(
            (corrected - Vector3::new(0.011, 0.017, 0.03)).norm() < 1e-12,
            "{corrected}"
        );
        let mut global = known.clone();
        global.products_rad2[1] = 2e-5;
        assert_eq!(
            global.expected(&frame, 0.01).0,
            Vector3::zeros(),
            "a global one"
        );
        assert_eq!(global.corrected(since), Vector3::zeros(), "a global one");
    }

    /// A frame whose keypoints were recorded during a turn.
    #[test]
    fn the_turn_is_estimated_from_thirty_links() {
        let turn_rad = Vector3::new(0.004, -0.006, 0.005);
        let rolling = RollingShutter { turn_rad };
        for (links, sigma_rad, estimated) in [(30, 0.02, true), (29, 0.02, false), (70, 0.0, false)]
        {
            let mut config = Config::default();
            config.tracking.shutter_sigma_rad = sigma_rad;
            let mut world = World::with_camera(uneven_camera(), config);
            let seen = world.see(0, &cloud(), &Se3::identity());
            let made = world.remember(seen, &cloud());
            let mut frame = world.see(1, &cloud(), &Se3::identity());
            frame.sigma_px.fill(0.01);
            for i in 0..70 {
                // Spread over the image.
                frame.landmark[13 * i % 70] = Some(made[13 * i % 70]).filter(|_| i < links);
                frame.px[i] = rolling.recorded_pixel(&uneven_camera(), &frame.uv_px[i]);
            }
            let before = frame.clone();
            let context = &world.context;
            let found = estimate_shutter(context, &world.map, &mut frame, &ShutterModel::new());
            assert_eq!(
                found.is_some(),
                estimated,
                "{links} links, σ = {sigma_rad} rad"
            );
            let off = found.map_or(0.0, |found| (found - turn_rad).norm());
            assert!(off < 1e-4, "{found:?}");
            assert_eq!(
                frame.camera_from_world, before.camera_from_world,
                "still a global one"
            );
            assert_eq!(
                (frame.uv_px.as_slice(), frame.shutter),
                (before.uv_px.as_slice(), before.shutter),
                "and keypoints"
            );

            let mut known = model([3e-5, 5e-5, 1e-4], 12);
            known.means_rad =
                Some([[0.001, 0.002, 0.003], [0.004, -0.002, 0.006]].map(Vector3::from));
            let found = estimate_shutter(context, &world.map, &mut frame, &known);
            let used = found.map_or(before.shutter.turn_rad, |found| known.corrected(found));
            assert_eq!(frame.shutter.turn_rad, used, "a rolling one");
            assert_eq!(
                frame.uv_px != before.uv_px,
                estimated,
                "keypoints move to the middle row"
            );
        }
    }
}
