//! [`most_likely_path`]: measured poses and a motion prior, white noise on the acceleration (decision 015).
//!
//! Links, landmarks and the shutter's model leave each pose an error of some millimetres, another one
//! in every frame. A hand cannot follow that: within the 33 ms between two frames its velocity changes
//! by a few centimetres a second. With cₖ the centre of frame k, measured as ĉₖ with covariance Σₖ,
//!
//! F = ½ Σₖ ρ(‖cₖ - ĉₖ‖²_Σₖ) + ½ Σₖ ‖(cₖ₊₁ - cₖ)/Δ₊ - (cₖ - cₖ₋₁)/Δ₋‖² / (σ_a Δ)²,       (E24)
//! Δ = (Δ₊ + Δ₋)/2
//!
//! is quadratic but for Huber's kernel ρ, which is re-weighted. Only the centres have such a prior: a
//! hand that trembles turns a camera from frame to frame. The rotation follows the centre so that the
//! links stay explained: φ = -H_φφ⁻¹ H_φρ ρ, with H the information of the frame's pose.

use garad_core::Se3;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn, Matrix3, Vector3, Vector6};

use crate::config::MotionConfig;
use crate::frame::{CentreEstimate, PoseInformation};

/// Solutions with the weights of the one before.
const ROUNDS: usize = 3;
/// δ of Huber's kernel, standard deviations.
const OUTLIER_SIGMAS: f64 = 3.0;
/// Frames solved together at most: so many that count, and so many on each side. What lies farther
/// away changes nothing.
const WINDOW: usize = 20;
pub(super) const MARGIN: usize = 15;

/// The pose of a frame by its links alone.
#[derive(Debug, Clone, Copy)]
pub(super) struct MeasuredPose {
    t_s: f64,
    camera_from_world: Se3,
    /// Inverse covariance of the centre, in world coordinates, 1/m².
    information: Matrix3<f64>,
    /// φ per ρ.
    turn_by_step: Matrix3<f64>,
}

impl MeasuredPose {
    /// Errors that all n links share do not average out: the covariance is (1 + κ² n) times the
    /// inverse of the information. A pose that its links do not determine has no information.
    pub(super) fn new(
        t_s: f64,
        camera_from_world: Se3,
        by_links: &PoseInformation,
        config: &MotionConfig,
    ) -> Self {
        let shared = config.shared_error * config.shared_error * by_links.links as f64;
        let rotation = camera_from_world.rotation.matrix();
        let of_centre = || {
            let covariance = by_links.matrix.cholesky()?.inverse();
            let of_step = covariance.fixed_view::<3, 3>(0, 0) * (1.0 + shared);
            Some(rotation.transpose() * of_step.cholesky()?.inverse() * rotation)
        };
        let turn_by_step = || {
            let of_turn = by_links.matrix.fixed_view::<3, 3>(3, 3).into_owned();
            Some(-of_turn.cholesky()?.inverse() * by_links.matrix.fixed_view::<3, 3>(3, 0))
        };
        Self {
            t_s,
            camera_from_world,
            information: of_centre().unwrap_or_default(),
            turn_by_step: turn_by_step().unwrap_or_default(),
        }
    }

    fn centre(&self) -> Vector3<f64> {
        self.camera_from_world.inverse().translation
    }

    /// The pose with its centre moved.
    fn moved(&self, step: &Vector3<f64>) -> Se3 {
        let rho = -(self.camera_from_world.rotation.matrix() * step);
        let phi = self.turn_by_step * rho;
        let xi = Vector6::new(rho.x, rho.y, rho.z, phi.x, phi.y, phi.z);
        let moved = Se3::exp(&xi) * self.camera_from_world;
        match moved.is_finite() {
            true => moved,
            false => self.camera_from_world, // an absurd camera: numbers overflow
        }
    }
}

/// The poses that minimise F.
pub(super) fn most_likely_path(measured: &[MeasuredPose], config: &MotionConfig) -> Vec<Se3> {
    let mut path = Vec::with_capacity(measured.len());
    for first in (0..measured.len()).step_by(WINDOW) {
        let end = (first + WINDOW).min(measured.len());
        let from = first.saturating_sub(MARGIN);
        let together = &measured[from..(end + MARGIN).min(measured.len())];
        let solution = solve(together, config);
        for k in first - from..end - from {
            path.push(match &solution {
                Some(solution) => together[k].moved(&solution.steps[k]),
                None => together[k].camera_from_world,
            });
        }
    }
    path
}

/// Where the camera is expected at a time after the last of some frames: the minimum of F with one
/// frame more, of which nothing is measured. `None` from fewer than three.
pub(super) fn expected_centre(
    measured: &[MeasuredPose],
    t_s: f64,
    config: &MotionConfig,
) -> Option<CentreEstimate> {
    let recent = &measured[measured.len().saturating_sub(MARGIN)..];
    let last = recent.last()?;
    let next = MeasuredPose {
        t_s,
        information: Matrix3::zeros(),
        ..*last
    };
    let frames: Vec<_> = recent.iter().chain([&next]).copied().collect();
    if frames.len() < 4 {
        return None;
    }
    let Solution { steps, factors } = solve(&frames, config)?;
    let n = frames.len();
    let mut columns = DMatrix::<f64>::zeros(3 * n, 3);
    columns
        .fixed_view_mut::<3, 3>(3 * (n - 1), 0)
        .fill_with_identity();
    let covariance = factors.solve(&columns);
    let covariance = covariance.fixed_view::<3, 3>(3 * (n - 1), 0).into_owned();
    Some(CentreEstimate {
        centre_m: next.centre() + steps[n - 1],
        information: covariance.cholesky()?.inverse(),
    })
}

/// The minimum of F: how far each centre moves, and the factors of the matrix of F.
struct Solution {
    steps: Vec<Vector3<f64>>,
    factors: Cholesky<f64, Dyn>,
}

/// The minimum of F over some frames. `None` if they do not determine it, or numbers overflow.
fn solve(frames: &[MeasuredPose], config: &MotionConfig) -> Option<Solution> {
    let n = frames.len();
    let centres: Vec<_> = frames.iter().map(MeasuredPose::centre).collect();
    let mut by_motion = DMatrix::<f64>::zeros(n, n);
    let mut gradient = DVector::<f64>::zeros(3 * n);
    for k in 1..n.saturating_sub(1) {
        let before = frames[k].t_s - frames[k - 1].t_s;
        let after = frames[k + 1].t_s - frames[k].t_s;
        if before * after <= 0.0 {
            continue; // stamps that say nothing of the time between
        }
        let sigma = config.acceleration_m_s2 * 0.5 * (before + after);
        let by = [1.0 / before, -1.0 / before - 1.0 / after, 1.0 / after].map(|c| c / sigma);
        let residual = centres[k - 1] * by[0] + centres[k] * by[1] + centres[k + 1] * by[2];
        for (a, by_a) in by.iter().enumerate() {
            let mut of_frame = gradient.fixed_rows_mut::<3>(3 * (k - 1 + a));
            of_frame += *by_a * residual;
            for (b, by_b) in by.iter().enumerate() {
                by_motion[(k - 1 + a, k - 1 + b)] += by_a * by_b;
            }
        }
    }
    let by_motion = by_motion.kronecker(&Matrix3::identity());
    let mut solution = None;
    for _ in 0..ROUNDS {
        let mut hessian = by_motion.clone();
        for (k, frame) in frames.iter().enumerate() {
            let step = (solution.as_ref()).map_or(Vector3::zeros(), |s: &Solution| s.steps[k]);
            let sigmas = step.dot(&(frame.information * step)).sqrt();
            let weight = OUTLIER_SIGMAS / sigmas.max(OUTLIER_SIGMAS);
            let mut of_frame = hessian.fixed_view_mut::<3, 3>(3 * k, 3 * k);
            of_frame += weight * frame.information;
        }
        let factors = hessian.cholesky()?;
        let steps = factors.solve(&-&gradient);
        if !steps.iter().all(|s| s.is_finite()) {
            return None;
        }
        let steps = (0..n).map(|k| steps.fixed_rows::<3>(3 * k).into_owned());
        solution = Some(Solution {
            steps: steps.collect(),
            factors,
        });
    }
    solution
}

#[cfg(test)]
mod tests {
    use super::*;

    const DT_S: f64 = 0.1;

    fn config() -> MotionConfig {
        MotionConfig {
            acceleration_m_s2: 2.0,
            shared_error: 0.0,
        }
    }

    /// Cameras that look along z, at these places of x, each measured to `sigma_m`.
    fn path(x_m: impl IntoIterator<Item = f64>, sigma_m: f64) -> Vec<MeasuredPose> {
        let pose = |(k, x): (usize, f64)| {
            let camera_from_world = Se3::exp(&Vector6::new(-x, 0.0, 0.0, 0.0, 0.0, 0.0));
            let links = PoseInformation {
                matrix: nalgebra::Matrix6::identity() / (sigma_m * sigma_m),
                links: 100,
            };
            MeasuredPose::new(DT_S * k as f64, camera_from_world, &links, &config())
        };
        x_m.into_iter().enumerate().map(pose).collect()
    }

    fn solved_x(measured: &[MeasuredPose]) -> Vec<f64> {
        let path = most_likely_path(measured, &config());
        path.iter().map(|p| p.inverse().translation.x).collect()
    }

    #[test]
    fn a_uniform_motion_stays() {
        let x: Vec<f64> = (0..50).map(|k| 0.03 * f64::from(k)).collect();
        for (solved, x) in solved_x(&path(x.clone(), 0.004)).iter().zip(&x) {
            assert!((solved - x).abs() < 1e-12, "{solved}, measured {x}");
        }
    }

    /// Three places 0, d, 0: with w = 1/σ², q = 1/(σ_a Δ²) and a = (1, -2, 1), F = ½ w ‖s‖² +
    /// ½ q² (-2d + aᵀs)², which is least at s = λ a, λ = 2 q² d / (w + 6 q²).
    #[test]
    fn three_frames_have_a_closed_form() {
        let (d, sigma_m) = (0.005, 0.004);
        let (w, q) = (1.0 / (sigma_m * sigma_m), 1.0 / (2.0 * DT_S * DT_S));
        let lambda = 2.0 * q * q * d / (w + 6.0 * q * q);
        let expected = [lambda, d - 2.0 * lambda, lambda];
        for (solved, expected) in solved_x(&path([0.0, d, 0.0], sigma_m)).iter().zip(expected) {
            assert!((solved - expected).abs() < 1e-12, "{solved} {expected}");
        }
    }

    /// Three frames at unequal times: with a = (1/Δ₋, -1/Δ₋ - 1/Δ₊, 1/Δ₊)/(σ_a Δ), F = ½ w ‖s‖² + ½ (aᵀ(x + s))² is
    /// least at s = -a aᵀx / (w + aᵀa).
    #[test]
    fn unequal_intervals_have_a_closed_form() {
        let (t, x, sigma_m) = ([0.3, 0.5, 0.55], [0.1, 0.104, 0.107], 0.004);
        let mut measured = path(x, sigma_m);
        for (frame, t_s) in measured.iter_mut().zip(t) {
            frame.t_s = t_s;
        }
        let scale = 1.0 / (2.0 * 0.125); // σ_a = 2 m/s², Δ = (0.2 s + 0.05 s)/2
        let a = [scale / 0.2, -scale * 25.0, scale / 0.05];
        let dot = |b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
        let share = dot(x) / (1.0 / (sigma_m * sigma_m) + dot(a));
        for (k, solved) in solved_x(&measured).into_iter().enumerate() {
            let expected = x[k] - a[k] * share;
            assert!((expected - x[k]).abs() > 1e-5, "something moves");
            assert!(
                (solved - expected).abs() < 1e-10,
                "{k}: {solved} {expected}"
            );
        }
        measured[1].t_s = measured[0].t_s; // says nothing of a speed
        for (solved, x) in solved_x(&measured).iter().zip(x) {
            assert!((solved - x).abs() < 1e-12, "{solved}, measured {x}");
        }
    }

    /// Windows of a long path against all of it at once.
    #[test]
    fn windows_change_nothing() {
        let wobble = |k: u32| 0.02 * f64::from(k) + 0.004 * f64::from(k * k % 7);
        let measured = path((0..67).map(wobble), 0.004);
        let all = solve(&measured, &config()).expect("determined");
        let solved = solved_x(&measured);
        assert_eq!(solved.len(), 67);
        for (k, solved) in solved.iter().enumerate() {
            let expected = measured[k].centre().x + all.steps[k].x;
            assert!(
                (solved - expected).abs() < 1e-7,
                "{k}: {solved}, {expected} at once"
            );
        }
    }

    /// Information of the centre in the world, Rᵀ A⁻¹ R with A the upper left of H⁻¹ (1 + κ² n), and the turn that
    /// goes with a step.
    #[test]
    fn a_measured_pose_is_turned_into_the_world() {
        let pose = crate::testing::turned(3);
        let mut matrix =
            nalgebra::Matrix6::from_diagonal(&(Vector6::new(9.0, 4.0, 25.0, 7.0, 5.0, 8.0) * 1e4));
        for (i, j, h) in [
            (0, 3, 2e4),
            (1, 5, -1e4),
            (2, 4, 3e4),
            (0, 4, 0.5e4),
            (0, 1, 1.5e4),
        ] {
            (matrix[(i, j)], matrix[(j, i)]) = (h, h);
        }
        let links = PoseInformation { matrix, links: 50 };
        let config = MotionConfig {
            shared_error: 0.2,
            ..config()
        };
        let measured = MeasuredPose::new(1.5, pose, &links, &config);
        let inverse = matrix.try_inverse().expect("regular");
        let of_step = inverse.fixed_view::<3, 3>(0, 0) * 3.0; // 1 + 0.04 · 50
        let r = pose.rotation.matrix();
        let expected = r.transpose() * of_step.try_inverse().expect("regular") * r;
        let off = (measured.information - expected).norm() / expected.norm();
        assert!(off < 1e-12, "{off}");
        let of_turn = matrix
            .fixed_view::<3, 3>(3, 3)
            .try_inverse()
            .expect("regular");
        let turn_by_step = -of_turn * matrix.fixed_view::<3, 3>(3, 0);
        let step = Vector3::new(2e-6, -1e-6, 3e-6);
        let moved = measured.moved(&step);
        let centre = moved.inverse().translation - pose.inverse().translation;
        assert!(
            (centre - step).norm() < 1e-10,
            "the centre goes by the step: {centre}"
        );
        let turned = (moved.rotation * pose.rotation.inverse()).log();
        let expected = turn_by_step * -(r * step);
        assert!((turned - expected).norm() < 1e-10, "{turned} {expected}");
    }

    /// The next centre is c₊ = c + v Δ₊, and with places that are certain its σ is σ_a Δ Δ₊, Δ = (Δ₋ + Δ₊)/2.
    #[test]
    fn the_next_centre_is_as_certain_as_the_prior() {
        let measured = path([0.0, 0.02, 0.04], 1e-6);
        let next = expected_centre(&measured, 0.2 + 0.2, &config()).expect("three frames");
        assert!((next.centre_m.x - 0.08).abs() < 1e-6, "{}", next.centre_m);
        let sigma_m = (1.0 / next.information[(1, 1)]).sqrt();
        assert!((sigma_m - 2.0 * 0.15 * 0.2).abs() < 1e-6, "{sigma_m}");
        assert!(
            expected_centre(&measured[..2], 0.3, &config()).is_none(),
            "two frames"
        );
    }

    /// One frame of thirty is measured 5 cm beside a path of uniform speed, by a hand that cannot do
    /// that: 0.1 m/s² is 1 mm from frame to frame.
    #[test]
    fn the_gross_error_of_one_frame_is_repaired_by_the_others() {
        let uniform = |k: u32| 0.01 * f64::from(k);
        let measured = path(
            (0..30).map(|k| uniform(k) + if k == 14 { 0.05 } else { 0.0 }),
            0.005,
        );
        let slow = MotionConfig {
            acceleration_m_s2: 0.1,
            ..config()
        };
        let solved = most_likely_path(&measured, &slow);
        let error = |(k, pose): (u32, &Se3)| (pose.inverse().translation.x - uniform(k)).abs();
        let worst = (0u32..).zip(&solved).map(error).fold(0.0, f64::max);
        assert!(worst < 0.005, "{worst} m");
    }

    /// A pose without information lies where its neighbours say; one alone stays.
    #[test]
    fn a_pose_without_information_is_bridged() {
        let mut measured = path([0.0, 0.01, 0.5, 0.03, 0.04], 0.001);
        let unknown = PoseInformation::default();
        let at = measured[2];
        measured[2] = MeasuredPose::new(at.t_s, at.camera_from_world, &unknown, &config());
        let solved = solved_x(&measured);
        assert!((solved[2] - 0.02).abs() < 1e-9, "{solved:?}");
        let alone = solved_x(&measured[2..3]);
        assert!((alone[0] - 0.5).abs() < 1e-12, "{alone:?}");
    }

    /// Far outside of where its time and the others' speed lead; certain to half an acceleration's way
    /// and what is not known of place and speed.
    #[test]
    fn the_next_centre_is_extrapolated() {
        let measured = path((0..12).map(|k| 0.03 * f64::from(k)), 0.001);
        let next = expected_centre(&measured, 12.0 * DT_S, &config()).expect("twelve frames");
        assert!((next.centre_m.x - 0.36).abs() < 1e-9, "{}", next.centre_m);
        let sigma_m = (1.0 / next.information[(0, 0)]).sqrt();
        assert!(
            sigma_m > 2.0 * DT_S * DT_S * 0.5 && sigma_m < 0.06,
            "{sigma_m} m"
        );
        assert!(
            expected_centre(&measured[..2], 0.2, &config()).is_none(),
            "no speed yet"
        );
    }

    /// Errors that all links share: with κ = 0.3 and 100 links, σ grows by √10.
    #[test]
    fn shared_errors_do_not_average_out() {
        let links = PoseInformation {
            matrix: nalgebra::Matrix6::identity() * 1e6,
            links: 100,
        };
        let config = MotionConfig {
            shared_error: 0.3,
            ..config()
        };
        let measured = MeasuredPose::new(0.0, Se3::identity(), &links, &config);
        let sigma_m = (1.0 / measured.information[(0, 0)]).sqrt();
        assert!((sigma_m - 1e-3 * 10f64.sqrt()).abs() < 1e-9, "{sigma_m}");
    }
}
