//! Pairs of estimated and true poses: nearest in time.

use garad_core::StampedPose;

use crate::EvalError;

/// Largest time difference of a pair, seconds: the default of the TUM tools. Motion capture runs at 100 Hz
/// and more, so a larger difference means a gap in the ground truth.
pub const MAX_DT_S: f64 = 0.02;

/// Index of the pose whose time is nearest to `t_s`, if at most `max_dt_s` away; of two equally
/// near ones the earlier.
///
/// `trajectory` must be sorted by time.
#[must_use]
pub fn nearest_in_time(trajectory: &[StampedPose], t_s: f64, max_dt_s: f64) -> Option<usize> {
    let after = trajectory.partition_point(|pose| pose.t_s <= t_s);
    let distance = |i: usize| (trajectory[i].t_s - t_s).abs();
    let best = match (after.checked_sub(1), after < trajectory.len()) {
        (Some(before), true) if distance(after) < distance(before) => after,
        (Some(before), _) => before,
        (None, true) => after,
        (None, false) => return None,
    };
    (distance(best) <= max_dt_s).then_some(best)
}

/// Pairs (ground truth, estimate) of poses that are nearest in time and at most `max_dt_s` apart.
///
/// Each pose of the shorter trajectory (of equal ones, the estimate) is paired with its nearest partner in
/// the other one, which several may share, as in evo's `associate_trajectories(reference, estimate)`. The
/// older TUM script pairs greedily and never shares a partner; at 30 Hz against 100 Hz both give the same
/// pairs.
///
/// # Errors
/// [`EvalError::Times`] when times are not ascending, [`EvalError::NonFinite`] for a bad pose,
/// [`EvalError::Option`] for a bad `max_dt_s`, [`EvalError::NoPairs`] when nothing matches.
pub fn associate(
    ground_truth: &[StampedPose],
    estimate: &[StampedPose],
    max_dt_s: f64,
) -> Result<Vec<(usize, usize)>, EvalError> {
    check(ground_truth, estimate, max_dt_s)?;
    let partner_of =
        |others: &[StampedPose], pose: &StampedPose| nearest_in_time(others, pose.t_s, max_dt_s);
    let pairs: Vec<(usize, usize)> = if ground_truth.len() < estimate.len() {
        let leader = ground_truth.iter().enumerate();
        leader
            .filter_map(|(g, pose)| Some((g, partner_of(estimate, pose)?)))
            .collect()
    } else {
        let leader = estimate.iter().enumerate();
        leader
            .filter_map(|(e, pose)| Some((partner_of(ground_truth, pose)?, e)))
            .collect()
    };
    if pairs.is_empty() {
        return Err(no_pairs(ground_truth, estimate, max_dt_s));
    }
    Ok(pairs)
}

/// Checks both trajectories and the time limit.
pub(crate) fn check(
    ground_truth: &[StampedPose],
    estimate: &[StampedPose],
    max_dt_s: f64,
) -> Result<(), EvalError> {
    positive("max_dt_s", max_dt_s)?;
    check_trajectory("ground truth", ground_truth)?;
    check_trajectory("estimate", estimate)
}

pub(crate) fn positive(name: &'static str, value: f64) -> Result<(), EvalError> {
    if value > 0.0 && value.is_finite() {
        Ok(())
    } else {
        Err(EvalError::Option { name, value })
    }
}

pub(crate) fn no_pairs(
    ground_truth: &[StampedPose],
    estimate: &[StampedPose],
    max_dt_s: f64,
) -> EvalError {
    let span = |poses: &[StampedPose]| {
        let time = |pose: Option<&StampedPose>| pose.map_or(f64::NAN, |pose| pose.t_s);
        (time(poses.first()), time(poses.last()))
    };
    EvalError::NoPairs {
        max_dt_s,
        ground_truth_s: span(ground_truth),
        estimate_s: span(estimate),
    }
}

fn check_trajectory(trajectory: &'static str, poses: &[StampedPose]) -> Result<(), EvalError> {
    let mut previous = f64::NEG_INFINITY;
    for (index, pose) in poses.iter().enumerate() {
        if !pose.t_s.is_finite() || pose.t_s < previous {
            return Err(EvalError::Times {
                trajectory,
                index,
                t_s: pose.t_s,
            });
        }
        if !pose.world_from_camera.is_finite() {
            return Err(EvalError::NonFinite {
                what: trajectory,
                index,
            });
        }
        previous = pose.t_s;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::Se3;
    use proptest::prelude::*;

    fn at(times: &[f64]) -> Vec<StampedPose> {
        let pose = |&t_s: &f64| StampedPose {
            t_s,
            world_from_camera: Se3::identity(),
        };
        times.iter().map(pose).collect()
    }

    #[test]
    fn nearest_wins_and_ties_go_to_the_earlier() {
        let times = at(&[0.0, 1.0, 2.0]);
        let nearest = |t| nearest_in_time(&times, t, 0.5);
        assert_eq!(nearest(0.4), Some(0), "before the middle");
        assert_eq!(nearest(0.5), Some(0), "in the middle");
        assert_eq!(nearest(0.6), Some(1), "after the middle");
        assert_eq!(nearest(-0.5), Some(0), "before the first, on the limit");
        assert_eq!(nearest(-0.51), None, "before the first, off the limit");
        assert_eq!(nearest(2.5), Some(2), "after the last, on the limit");
        assert_eq!(nearest(2.51), None, "after the last, off the limit");
        assert_eq!(nearest_in_time(&[], 0.0, 1.0), None, "no poses");
    }

    #[test]
    fn the_shorter_trajectory_chooses() {
        let dense = at(&[0.0, 0.1, 0.2, 0.3]);
        let sparse = at(&[0.09, 0.31]);
        let pairs = associate(&dense, &sparse, 0.02).expect("two pairs");
        assert_eq!(pairs, [(1, 0), (3, 1)], "the estimate chooses");
        let pairs = associate(&sparse, &dense, 0.02).expect("two pairs");
        assert_eq!(pairs, [(0, 1), (1, 3)], "the ground truth chooses");
        let pairs = associate(&at(&[0.0, 9.0]), &at(&[0.0, 0.01]), 0.02).expect("two pairs");
        assert_eq!(
            pairs,
            [(0, 0), (0, 1)],
            "equal counts: the estimate chooses"
        );
    }

    #[test]
    fn bad_input_is_reported() {
        let (good, back) = (at(&[0.0, 1.0]), at(&[1.0, 0.0]));
        let error = associate(&good, &back, 0.02).expect_err("time goes back");
        assert!(
            matches!(error, EvalError::Times { index: 1, .. }),
            "{error}"
        );
        let error = associate(&at(&[f64::NAN]), &good, 0.02).expect_err("NaN");
        assert!(
            matches!(error, EvalError::Times { index: 0, .. }),
            "{error}"
        );
        let error = associate(&at(&[5.0]), &good, 0.02).expect_err("apart");
        let text = "no pair of poses within 0.02 s: ground truth covers [5, 5] s, \
                    the estimate [0, 1] s";
        assert_eq!(error.to_string(), text, "message");
        assert!(associate(&good, &good, f64::NAN).is_err(), "limit");
        assert!(associate(&[], &good, 0.02).is_err(), "no ground truth");
    }

    proptest! {
        #[test]
        fn binary_search_agrees_with_linear_search(
            mut times in proptest::collection::vec(-5.0f64..5.0, 0..20),
            t in -6.0f64..6.0,
        ) {
            times.sort_by(f64::total_cmp);
            let naive = (0..times.len())
                .filter(|&i| (times[i] - t).abs() <= 0.5)
                .min_by(|&a, &b| (times[a] - t).abs().total_cmp(&(times[b] - t).abs()));
            prop_assert_eq!(nearest_in_time(&at(&times), t, 0.5), naive);
        }
    }
}
