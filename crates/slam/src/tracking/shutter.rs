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
}
