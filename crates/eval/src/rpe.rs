//! Relative pose error: drift over a fixed step.

use garad_core::{Se3, StampedPose};
use serde::{Deserialize, Serialize};

use crate::associate::{MAX_DT_S, associate, check, nearest_in_time, no_pairs, positive};
use crate::{EvalError, Stats};

/// The step over which motions are compared.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RpeDelta {
    /// This many associated poses ahead; every start, as evo with `all_pairs`. Unit: m and degrees
    /// per step.
    Frames(usize),
    /// This many seconds ahead, as the TUM benchmark's script with a fixed delta; with 1 s the
    /// unit is m/s and degrees/s, the figure in papers on dynamic scenes.
    Seconds(f64),
}

/// The protocol.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RpeOptions {
    /// Step.
    pub delta: RpeDelta,
    /// Largest time difference between an estimate and its ground truth, seconds.
    pub max_dt_s: f64,
}

impl Default for RpeOptions {
    fn default() -> Self {
        Self {
            delta: RpeDelta::Seconds(1.0),
            max_dt_s: MAX_DT_S,
        }
    }
}

/// The result of [`rpe`].
#[derive(Debug, Clone, PartialEq)]
pub struct Rpe {
    /// Translation, metres per step.
    pub trans_m: Stats,
    /// Rotation angle, degrees per step.
    pub rot_deg: Stats,
    /// Difference of the angles of the true and the estimated rotation, degrees per step. It is at most `rot_deg`, and
    /// does not depend on which body of a rig the poses are of.
    pub angle_deg: Stats,
    /// Start time of each step, its translation (m) and rotation error (degrees).
    pub steps: Vec<(f64, f64, f64)>,
}

/// Rotation errors below this are not asked for their axis, degrees.
const AXES_FROM_DEG: f64 = 1.0;
/// Two bodies of one rig turn by the same angle about other axes: beside the error of the rotations, that of their
/// angles is below this.
const SAME_ANGLE: f64 = 0.2;

impl Rpe {
    /// Whether the ground truth is of another body than the estimate: a marker on the sensor, say, with axes of its own.
    /// With X the fixed motion between the two, a true relative motion M is X⁻¹ M X of the other: the angle of its
    /// rotation is the same, its axis is not. Then the relative error says nothing of the estimate.
    #[must_use]
    pub fn is_of_another_body(&self) -> bool {
        let rotation_deg = self.rot_deg.rmse;
        rotation_deg > AXES_FROM_DEG && self.angle_deg.rmse < SAME_ANGLE * rotation_deg
    }
}

/// Relative pose error. With Q the true and P the estimated `world_from_camera`,
///
/// E = (Q_a⁻¹ Q_b)⁻¹ (P_a⁻¹ P_b),   translation |t_E|,   rotation |log R_E| in degrees.
///
/// No alignment is needed: E does not depend on either world.
///
/// - [`RpeDelta::Frames`]: a the i-th associated pair, b the (i + delta)-th (evo, all pairs).
/// - [`RpeDelta::Seconds`]: the partner of an estimate is the one nearest to `delta` seconds later,
///   except the last one. As in the TUM script, a is the *later* of the two, so that the backward motion
///   is compared, which changes |t_E| in the second order. Two rules exclude gaps in a trajectory: both
///   ends need ground truth within `max_dt_s` (the script allows two sampling intervals, the same 0.02 s
///   at 100 Hz), and a step must last between 1/2 and 3/2 of `delta` (the script would pair a pose with
///   itself across a gap: error 0).
///
/// The error of a step is not divided by its true length.
///
/// Source: Sturm et al. 2012, eq. 1. Golden: `trajectory/*`.
///
/// # Errors
/// As [`associate`]; [`EvalError::TooFew`] when no step fits into the trajectory,
/// [`EvalError::Option`] for a step of 0.
pub fn rpe(
    ground_truth: &[StampedPose],
    estimate: &[StampedPose],
    options: &RpeOptions,
) -> Result<Rpe, EvalError> {
    check(ground_truth, estimate, options.max_dt_s)?;
    let pairs: Vec<Step> = match options.delta {
        RpeDelta::Frames(delta) => {
            positive("delta", delta as f64)?;
            let pairs = associate(ground_truth, estimate, options.max_dt_s)?;
            let ends = pairs.iter().skip(delta);
            pairs.iter().zip(ends).map(|(&a, &b)| (a, b)).collect()
        }
        RpeDelta::Seconds(delta_s) => {
            positive("delta", delta_s)?;
            steps_by_time(ground_truth, estimate, delta_s, options.max_dt_s)?
        }
    };
    let error = |&((gt_a, est_a), (gt_b, est_b)): &Step| {
        let motion = |a: &StampedPose, b: &StampedPose| -> Se3 {
            a.world_from_camera.inverse() * b.world_from_camera
        };
        let truth = motion(&ground_truth[gt_a], &ground_truth[gt_b]);
        let found = motion(&estimate[est_a], &estimate[est_b]);
        let e = truth.inverse() * found;
        let start_s = estimate[est_a.min(est_b)].t_s;
        let angle = |motion: &Se3| motion.rotation.log().norm().to_degrees();
        let step = (start_s, e.translation.norm(), angle(&e));
        (step, (angle(&truth) - angle(&found)).abs())
    };
    if pairs.is_empty() {
        return Err(EvalError::TooFew {
            what: "steps",
            got: 0,
            needed: 1,
        });
    }
    let (steps, angles): (Vec<_>, Vec<f64>) = pairs.iter().map(error).unzip();
    let column = |f: fn(&(f64, f64, f64)) -> f64| steps.iter().map(f).collect::<Vec<_>>();
    Ok(Rpe {
        trans_m: Stats::of(&column(|step| step.1))?,
        rot_deg: Stats::of(&column(|step| step.2))?,
        angle_deg: Stats::of(&angles)?,
        steps,
    })
}

/// Two pairs (ground truth, estimate): from a to b.
type Step = ((usize, usize), (usize, usize));

fn steps_by_time(
    ground_truth: &[StampedPose],
    estimate: &[StampedPose],
    delta_s: f64,
    max_dt_s: f64,
) -> Result<Vec<Step>, EvalError> {
    let truth_of = |e: usize| nearest_in_time(ground_truth, estimate[e].t_s, max_dt_s);
    let mut matched = false;
    let mut steps = Vec::new();
    for start in 0..estimate.len() {
        let Some(gt_start) = truth_of(start) else {
            continue;
        };
        matched = true;
        // Nearest to the end of the step, less than half a step off.
        let end_s = estimate[start].t_s + delta_s;
        let Some(end) = nearest_in_time(estimate, end_s, 0.5 * delta_s) else {
            continue;
        };
        if end + 1 == estimate.len() {
            continue;
        }
        if let Some(gt_end) = truth_of(end) {
            steps.push(((gt_end, end), (gt_start, start)));
        }
    }
    if matched {
        Ok(steps)
    } else {
        Err(no_pairs(ground_truth, estimate, max_dt_s))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::{Real, So3};
    use nalgebra::Vector3;

    /// Straight along x at 1 m/s, 10 poses per second.
    fn straight(n: u32, speed: f64, turn_deg_per_s: f64) -> Vec<StampedPose> {
        let pose = |i: u32| {
            let t_s = f64::from(i) * 0.1;
            let turn = Vector3::z() * (turn_deg_per_s * t_s).to_radians();
            StampedPose {
                t_s,
                world_from_camera: Se3::new(So3::exp(&turn), Vector3::x() * (speed * t_s)),
            }
        };
        (0..n).map(pose).collect()
    }

    #[test]
    fn drift_per_second_by_hand() {
        let (truth, estimate) = (straight(50, 1.0, 0.0), straight(50, 1.1, 3.0));
        let result = rpe(&truth, &straight(50, 1.1, 0.0), &RpeOptions::default());
        let result = result.expect("39 steps");
        assert!((result.trans_m.rmse - 0.1).abs() < 1e-14, "0.1 m in 1 s");
        assert!((result.trans_m.std).abs() < 1e-14, "the same everywhere");
        assert_eq!(result.trans_m.pairs, 39, "the last pose ends no step");
        let turned = rpe(&truth, &estimate, &RpeOptions::default()).expect("39 steps");
        assert!(
            (turned.rot_deg.rmse - 3.0).abs() < 1e-12,
            "3 degrees in 1 s"
        );
    }

    #[test]
    fn drift_per_frame_by_hand() {
        let (truth, estimate) = (straight(50, 1.0, 0.0), straight(50, 1.1, 3.0));
        let options = RpeOptions {
            delta: RpeDelta::Frames(5),
            ..RpeOptions::default()
        };
        let result = rpe(&truth, &estimate, &options).expect("45 steps");
        assert_eq!(result.trans_m.pairs, 45, "every start with an end");
        assert!(
            (result.rot_deg.max - 1.5).abs() < 1e-12,
            "3 degrees/s, 0.5 s"
        );
    }

    /// Tracking lost for 3 s: no step spans the gap, none has length 0.
    #[test]
    fn gaps_have_no_steps() {
        let truth = straight(90, 1.0, 0.0);
        let mut estimate = straight(90, 1.1, 0.0);
        estimate.drain(30..60);
        let result = rpe(&truth, &estimate, &RpeOptions::default()).expect("steps");
        assert!(
            (result.trans_m.min - 0.05).abs() < 0.011,
            "{:?}",
            result.trans_m
        );
        assert!(result.trans_m.max < 0.151, "{:?}", result.trans_m);
    }

    #[test]
    fn too_short_a_trajectory_is_an_error() {
        let short = straight(5, 1.0, 0.0);
        let error = rpe(&short, &short, &RpeOptions::default()).expect_err("0.4 s");
        assert_eq!(
            error,
            EvalError::TooFew {
                what: "steps",
                got: 0,
                needed: 1
            },
            "time"
        );
        for delta in [RpeDelta::Frames(0), RpeDelta::Seconds(f64::NAN)] {
            let options = RpeOptions {
                delta,
                ..RpeOptions::default()
            };
            let error = rpe(&short, &short, &options).expect_err("no step");
            assert!(matches!(error, EvalError::Option { .. }), "{error}");
        }
    }

    /// Half a second at a drift of 0.2 m/s; steps by the partner nearest to their end.
    #[test]
    fn step_and_time_limit_are_those_of_the_options() {
        let (truth, mut estimate) = (straight(30, 1.0, 0.0), straight(30, 1.2, 0.0));
        let run = |estimate: &[StampedPose], delta_s: f64, max_dt_s: f64| {
            let options = RpeOptions {
                delta: RpeDelta::Seconds(delta_s),
                max_dt_s,
            };
            rpe(&truth, estimate, &options)
        };
        let half = run(&estimate, 0.5, 0.02).expect("steps");
        assert!((half.trans_m.max - 0.1).abs() < 1e-14, "{:?}", half.trans_m);
        assert_eq!(
            half.trans_m.pairs, 24,
            "30 less 5, and none ends at the last"
        );
        let start = half.steps[0].0;
        assert!(
            start.abs() < 1e-15 && (half.steps[1].0 - 0.1).abs() < 1e-15,
            "{:?}",
            half.steps
        );
        // The partner of 0.28 s is the third.
        let uneven = run(&estimate, 0.28, 0.02).expect("steps");
        assert!(
            (uneven.trans_m.max - 0.06).abs() < 1e-14,
            "{:?}",
            uneven.trans_m
        );
        for pose in &mut estimate {
            pose.t_s += 0.03;
        }
        assert!(
            matches!(run(&estimate, 0.5, 0.02), Err(EvalError::NoPairs { .. })),
            "20 ms"
        );
        assert_eq!(
            run(&estimate, 0.5, 0.04).expect("steps").trans_m.pairs,
            24,
            "40 ms"
        );
    }

    /// A hand-held camera and a marker on it with other axes, 10 cm away; drift and noise of a camera are no other body.
    #[test]
    fn a_marker_on_the_sensor_is_another_body() {
        let camera: Vec<StampedPose> = (0..60u32)
            .map(|i| {
                let t_s = f64::from(i) * 0.1;
                let swing = |f: f64, a: f64| a * Real::sin_cos(f * t_s).0;
                let turn = Vector3::new(swing(2.0, 0.3), swing(1.3, 0.2), swing(0.7, 0.4));
                let at = Vector3::new(swing(0.9, 0.5), 0.2 * t_s, swing(1.1, 0.1));
                StampedPose {
                    t_s,
                    world_from_camera: Se3::new(So3::exp(&turn), at),
                }
            })
            .collect();
        let moved = |motion: &dyn Fn(usize) -> Se3| -> Vec<StampedPose> {
            let poses = camera.iter().enumerate();
            poses
                .map(|(i, pose)| StampedPose {
                    t_s: pose.t_s,
                    world_from_camera: pose.world_from_camera * motion(i),
                })
                .collect()
        };
        let judged =
            |truth: &[StampedPose]| rpe(truth, &camera, &RpeOptions::default()).expect("steps");
        let axes = Vector3::new(1.2, -0.4, 0.9);
        let marker = judged(&moved(&|_| {
            Se3::new(So3::exp(&axes), Vector3::new(0.1, 0.0, 0.05))
        }));
        assert!(
            marker.rot_deg.rmse > 5.0 && marker.angle_deg.rmse < 1e-6,
            "{marker:?}"
        );
        assert!(marker.is_of_another_body(), "a marker");
        let same = judged(&camera);
        assert!(!same.is_of_another_body(), "the camera itself");
        let drift = judged(&moved(&|i| {
            let turn = Vector3::new(0.02, -0.03, 0.01) * i as f64;
            Se3::new(So3::exp(&turn), Vector3::zeros())
        }));
        assert!(drift.rot_deg.rmse > 5.0, "{drift:?}");
        assert!(
            !drift.is_of_another_body(),
            "a camera that drifts: {drift:?}"
        );
    }
}
