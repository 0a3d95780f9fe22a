//! Jitter of a trajectory: second differences of its positions.

use garad_core::StampedPose;
use nalgebra::Vector3;

use crate::associate::{check, nearest_in_time, no_pairs};
use crate::{EvalError, Stats};

/// Largest deviation of a time step from the median time step, as a share of the median.
pub const STEP_TOLERANCE: f64 = 0.4;

/// The result of [`jitter`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Jitter {
    /// Root mean square of the second differences of the estimate, metres.
    pub rms_m: f64,
    /// The same of the ground truth at the same stamps, metres.
    pub ground_truth_rms_m: f64,
    /// Triples of frames that count.
    pub triples: usize,
}

/// Root mean square of the second differences of the camera's positions,
///
/// √( Σ |p_{k+1} - 2 p_k + p_{k-1}|² / n ),   in metres,
///
/// over the n triples of consecutive associated frames: of the estimate, and of the ground truth at the
/// same stamps. It measures how much the estimate differs from frame to frame by more than the motion
/// does, which ATE and RPE hardly show. A smooth motion with acceleration a and time step Δ contributes
/// |a| Δ², so the figure is to be compared with the one of the ground truth, and only at one frame rate.
///
/// - A frame is associated if a ground-truth pose is within `max_dt_s`, as in [`crate::rpe()`], and its
///   stamp is not before the first or after the last one.
/// - The true position at its stamp is interpolated linearly between the ground-truth poses before and
///   after it, also where these are far apart. A pose with exactly this stamp is taken as it is.
/// - A triple counts if both of its time steps are positive and differ from the median time step of the
///   associated frames by at most 40 % ([`STEP_TOLERANCE`]): no triple spans a gap.
///
/// No alignment is needed: the norm of a second difference does not depend on the world. The scale of the
/// estimate is not aligned.
///
/// # Errors
/// [`EvalError::Times`] when times are not ascending, [`EvalError::NonFinite`] for a bad pose,
/// [`EvalError::Option`] for a bad `max_dt_s`, [`EvalError::NoPairs`] when no frame is associated,
/// [`EvalError::TooFew`] below 3 associated frames or when no triple counts.
pub fn jitter(
    ground_truth: &[StampedPose],
    estimate: &[StampedPose],
    max_dt_s: f64,
) -> Result<Jitter, EvalError> {
    check(ground_truth, estimate, max_dt_s)?;
    let associated = |pose: &StampedPose| {
        nearest_in_time(ground_truth, pose.t_s, max_dt_s)?;
        Some(Frame {
            t_s: pose.t_s,
            estimate: pose.world_from_camera.translation,
            ground_truth: position_at(ground_truth, pose.t_s)?,
        })
    };
    let frames: Vec<Frame> = estimate.iter().filter_map(associated).collect();
    if frames.is_empty() {
        return Err(no_pairs(ground_truth, estimate, max_dt_s));
    }
    let triples = triples_of_equal_steps(&frames)?;
    let rms = |position: fn(&Frame) -> Vector3<f64>| -> Result<f64, EvalError> {
        let second_difference = |[a, b, c]: &[&Frame; 3]| {
            let (before, after) = (position(b) - position(a), position(c) - position(b));
            (after - before).norm()
        };
        let norms: Vec<f64> = triples.iter().map(second_difference).collect();
        Ok(Stats::of(&norms)?.rmse)
    };
    Ok(Jitter {
        rms_m: rms(|frame| frame.estimate)?,
        ground_truth_rms_m: rms(|frame| frame.ground_truth)?,
        triples: triples.len(),
    })
}

/// An associated frame: its stamp and both positions.
struct Frame {
    t_s: f64,
    estimate: Vector3<f64>,
    ground_truth: Vector3<f64>,
}

/// The consecutive triples whose time steps are close to the median one; at least one.
fn triples_of_equal_steps(frames: &[Frame]) -> Result<Vec<[&Frame; 3]>, EvalError> {
    if frames.len() < 3 {
        return Err(EvalError::TooFew {
            what: "associated frames",
            got: frames.len(),
            needed: 3,
        });
    }
    let step_s = |pair: &[Frame]| pair[1].t_s - pair[0].t_s;
    let steps_s: Vec<f64> = frames.windows(2).map(step_s).collect();
    let median_s = Stats::of(&steps_s)?.median;
    let counts = |s: f64| s > 0.0 && (s - median_s).abs() <= STEP_TOLERANCE * median_s;
    let triples: Vec<[&Frame; 3]> = frames
        .windows(3)
        .filter(|triple| triple.windows(2).all(|pair| counts(step_s(pair))))
        .map(|triple| [&triple[0], &triple[1], &triple[2]])
        .collect();
    if triples.is_empty() {
        return Err(EvalError::TooFew {
            what: "triples of frames at equal time steps",
            got: 0,
            needed: 1,
        });
    }
    Ok(triples)
}

/// Position at a time, interpolated linearly; `None` before the first and after the last pose.
fn position_at(trajectory: &[StampedPose], t_s: f64) -> Option<Vector3<f64>> {
    let after = trajectory.partition_point(|pose| pose.t_s <= t_s);
    let a = trajectory.get(after.checked_sub(1)?)?;
    let from = a.world_from_camera.translation;
    if a.t_s >= t_s {
        return Some(from);
    }
    let b = trajectory.get(after)?;
    let share = (t_s - a.t_s) / (b.t_s - a.t_s);
    Some(from + (b.world_from_camera.translation - from) * share)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::MAX_DT_S;
    use garad_core::{Se3, So3};

    /// Poses at these times, at positions given by number and time.
    fn path(times_s: &[f64], position: impl Fn(usize, f64) -> Vector3<f64>) -> Vec<StampedPose> {
        let pose = |(i, &t_s): (usize, &f64)| StampedPose {
            t_s,
            world_from_camera: Se3::new(So3::identity(), position(i, t_s)),
        };
        times_s.iter().enumerate().map(pose).collect()
    }

    fn times(n: u32) -> Vec<f64> {
        (0..n).map(|i| f64::from(i) * 0.1).collect()
    }

    fn sign(i: usize) -> f64 {
        if i.is_multiple_of(2) { 1.0 } else { -1.0 }
    }

    /// Along x at 1 m/s.
    fn straight(_: usize, t_s: f64) -> Vector3<f64> {
        Vector3::x() * t_s
    }

    #[test]
    fn a_straight_line_at_constant_speed_has_none() {
        let line = path(&times(50), straight);
        let found = jitter(&line, &line, MAX_DT_S).expect("48 triples");
        assert!(found.rms_m < 1e-14, "{found:?}");
        assert!(found.ground_truth_rms_m < 1e-14, "{found:?}");
        assert_eq!(found.triples, 48, "all but the two ends");
    }

    /// ±a in turn: |-a - 2a - a| = 4a. A parabola: acceleration times Δ².
    #[test]
    fn zigzag_and_parabola_by_hand() {
        let zigzag = |i, t_s| Vector3::new(0.002 * sign(i), t_s, 0.0);
        let parabola = |_, t_s: f64| Vector3::z() * (0.5 * 3.0 * t_s * t_s);
        let truth = path(&times(50), parabola);
        let found = jitter(&truth, &path(&times(50), zigzag), MAX_DT_S).expect("48 triples");
        assert!((found.rms_m - 0.008).abs() < 1e-14, "4 a: {found:?}");
        assert!(
            (found.ground_truth_rms_m - 0.03).abs() < 1e-13,
            "3 m/s², 0.1 s: {found:?}"
        );
    }

    /// Tracking lost for 3 s: a triple across the gap would have 2.9 m.
    #[test]
    fn a_gap_is_left_out() {
        let mut times_s = times(90);
        let truth = path(&times_s, straight);
        times_s.drain(30..60);
        let found = jitter(&truth, &path(&times_s, straight), MAX_DT_S).expect("triples");
        assert_eq!(found.triples, 56, "28 on either side");
        assert!(found.rms_m < 1e-13, "{found:?}");
        assert!(found.ground_truth_rms_m < 1e-13, "{found:?}");
    }

    /// One frame without ground truth: the step across it is twice the median.
    #[test]
    fn frames_without_ground_truth_are_left_out() {
        let mut truth = path(&times(50), straight);
        truth.remove(20);
        let estimate = path(&times(50), straight);
        let found = jitter(&truth, &estimate, MAX_DT_S).expect("triples");
        assert_eq!(found.triples, 18 + 27, "20 frames and 29");
    }

    /// Stamps off by 10 ms to either side: the nearest pose would be 1 cm off in turn.
    #[test]
    fn the_ground_truth_is_interpolated() {
        let shifted: Vec<f64> = times(50)
            .iter()
            .enumerate()
            .map(|(i, t)| t + 0.01 * sign(i))
            .collect();
        let estimate = path(&times(50), straight);
        let found = jitter(&path(&shifted, straight), &estimate, MAX_DT_S).expect("triples");
        assert!(found.ground_truth_rms_m < 1e-14, "{found:?}");
        assert_eq!(
            found.triples, 46,
            "the first and the last are not between two"
        );
    }

    #[test]
    fn too_few_frames_are_an_error() {
        let truth = path(&times(50), straight);
        let too_few = |what, got, needed| EvalError::TooFew { what, got, needed };
        assert_eq!(
            jitter(&truth, &truth[..2], MAX_DT_S),
            Err(too_few("associated frames", 2, 3)),
            "two frames"
        );
        let uneven = [0, 1, 5, 6, 10].map(|i| truth[i]);
        let what = "triples of frames at equal time steps";
        assert_eq!(
            jitter(&truth, &uneven, MAX_DT_S),
            Err(too_few(what, 0, 1)),
            "no equal steps"
        );
        let still = [truth[3]; 4];
        assert_eq!(
            jitter(&truth, &still, MAX_DT_S),
            Err(too_few(what, 0, 1)),
            "one stamp"
        );
        let later = path(&[90.0, 90.1, 90.2], straight);
        let error = jitter(&truth, &later, MAX_DT_S).expect_err("apart");
        assert!(matches!(error, EvalError::NoPairs { .. }), "{error}");
        let error = jitter(&truth, &truth, f64::NAN).expect_err("limit");
        assert!(matches!(error, EvalError::Option { .. }), "{error}");
    }

    /// Steps of 0.1 s, and one of 0.139 or 0.141 s, of 0.061 or 0.059 s: 40 % of the median is the limit.
    #[test]
    fn a_step_within_forty_percent_of_the_median_counts() {
        let truth = path(
            &(0..400).map(|i| f64::from(i) * 0.01).collect::<Vec<_>>(),
            straight,
        );
        for (step_s, triples) in [(0.139, 18), (0.141, 16), (0.061, 18), (0.059, 16)] {
            let mut at_s = times(20);
            for t in &mut at_s[9..] {
                *t += step_s - 0.1;
            }
            let found = jitter(&truth, &path(&at_s, straight), 0.05).expect("triples");
            assert_eq!(found.triples, triples, "a step of {step_s} s");
        }
    }

    /// Ground truth every 0.1 s, frames 30 ms after it: associated within 40 ms and not within 20 ms.
    #[test]
    fn the_time_limit_is_that_of_the_caller() {
        let truth = path(&times(30), straight);
        let late: Vec<f64> = times(20).iter().map(|t| t + 0.03).collect();
        let late = path(&late, straight);
        assert_eq!(
            jitter(&truth, &late, 0.04).expect("triples").triples,
            18,
            "40 ms"
        );
        let none = jitter(&truth, &late, 0.02);
        assert!(matches!(none, Err(EvalError::NoPairs { .. })), "{none:?}");
    }
}
