//! Absolute trajectory error: how far the aligned estimate is from the truth.

use garad_core::StampedPose;
use nalgebra::Vector3;

use crate::align::{Alignment, Sim3, align_points};
use crate::associate::{MAX_DT_S, associate};
use crate::{EvalError, Stats};

/// The protocol. Its default is the one of the TUM tools and of the papers on dynamic scenes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AteOptions {
    /// Alignment of the estimate.
    pub alignment: Alignment,
    /// Largest time difference of a pair, seconds.
    pub max_dt_s: f64,
}

impl Default for AteOptions {
    fn default() -> Self {
        Self {
            alignment: Alignment::Rigid,
            max_dt_s: MAX_DT_S,
        }
    }
}

impl AteOptions {
    /// The protocol in words, to be shown beside its figures.
    #[must_use]
    pub fn describe(&self) -> String {
        let alignment = match self.alignment {
            Alignment::None => "no alignment",
            Alignment::Rigid => "rigid alignment",
            Alignment::Similarity => "similarity alignment (with scale)",
        };
        format!("{alignment}, nearest time within {} s", self.max_dt_s)
    }
}

/// One pair of positions in the world of the ground truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AtePoint {
    /// Time of the estimate, seconds.
    pub t_s: f64,
    /// True position of the camera, metres.
    pub ground_truth: Vector3<f64>,
    /// Aligned estimate, metres.
    pub estimate: Vector3<f64>,
    /// Distance of the two, metres.
    pub error_m: f64,
}

/// The result of [`ate`].
#[derive(Debug, Clone, PartialEq)]
pub struct Ate {
    /// Summary of the errors, metres.
    pub stats: Stats,
    /// Aligns the world of the estimate with that of the ground truth.
    pub truth_from_estimate: Sim3,
    /// All pairs, in order of time.
    pub points: Vec<AtePoint>,
}

/// Absolute trajectory error of positions,
///
/// eᵢ = |p_gt,i - (s R p_est,i + t)|,   (s, R, t) = argmin Σ eᵢ²
///
/// over pairs nearest in time. Positions only: orientations do not enter.
///
/// Source: Sturm et al. 2012; figures equal evo's `evo_ape ... --align` (a test says how
/// closely). Golden: `trajectory/*`.
///
/// # Example
/// ```
/// use garad_core::{Se3, StampedPose};
/// use garad_eval::{AteOptions, ate};
/// let pose = |t_s: f64, x: f64, y: f64| StampedPose {
///     t_s,
///     world_from_camera: Se3::exp(&[x, y, 0.0, 0.0, 0.0, 0.0].into()),
/// };
/// // The same triangle, moved: no error.
/// let truth = [pose(0.0, 0.0, 0.0), pose(0.1, 3.0, 0.0), pose(0.2, 3.0, 4.0)];
/// let estimate = [pose(0.0, 7.0, 1.0), pose(0.1, 7.0, 4.0), pose(0.2, 3.0, 4.0)];
/// let judged = ate(&truth, &estimate, &AteOptions::default())?;
/// assert!(judged.stats.rmse < 1e-14 && judged.stats.pairs == 3);
/// # Ok::<(), garad_eval::EvalError>(())
/// ```
/// # Errors
/// As [`associate`] and [`align_points`]; in particular [`EvalError::TooFew`] below 3 pairs,
/// which a rigid motion would fit exactly (1 pair is enough without alignment).
pub fn ate(
    ground_truth: &[StampedPose],
    estimate: &[StampedPose],
    options: &AteOptions,
) -> Result<Ate, EvalError> {
    let pairs = associate(ground_truth, estimate, options.max_dt_s)?;
    let truth: Vec<_> = pairs
        .iter()
        .map(|&(g, _)| position(&ground_truth[g]))
        .collect();
    let found: Vec<_> = pairs.iter().map(|&(_, e)| position(&estimate[e])).collect();
    let truth_from_estimate = align_points(&found, &truth, options.alignment)?;
    let points: Vec<AtePoint> = (0..pairs.len())
        .map(|i| {
            let aligned = truth_from_estimate * found[i];
            AtePoint {
                t_s: estimate[pairs[i].1].t_s,
                ground_truth: truth[i],
                estimate: aligned,
                error_m: (truth[i] - aligned).norm(),
            }
        })
        .collect();
    let errors: Vec<f64> = points.iter().map(|point| point.error_m).collect();
    Ok(Ate {
        stats: Stats::of(&errors)?,
        truth_from_estimate,
        points,
    })
}

fn position(pose: &StampedPose) -> Vector3<f64> {
    pose.world_from_camera.translation
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::{Real, Rng, Se3, So3};
    use proptest::prelude::*;

    fn walk(n: u32, noise: f64) -> Vec<StampedPose> {
        let mut rng = Rng::keyed(11, &[u64::from(n)]);
        let mut pose = |i: u32| {
            let s = f64::from(i) * 0.1;
            let (sin, cos) = Real::sin_cos(s);
            let at = Vector3::new(cos, sin, 0.1 * s);
            let off = Vector3::from_fn(|_, _| noise * rng.normal());
            StampedPose {
                t_s: f64::from(i) / 30.0,
                world_from_camera: Se3::new(So3::exp(&(Vector3::y() * s)), at + off),
            }
        };
        (0..n).map(&mut pose).collect()
    }

    fn moved(trajectory: &[StampedPose], sim3: &Sim3) -> Vec<StampedPose> {
        crate::align_trajectory(sim3, trajectory)
    }

    /// Three poses, one 3-4-5 triangle off without alignment.
    #[test]
    fn hand_numbers_without_alignment() {
        let truth = walk(3, 0.0);
        let mut estimate = truth.clone();
        estimate[1].world_from_camera.translation += Vector3::new(0.3, 0.0, 0.4);
        let options = AteOptions {
            alignment: Alignment::None,
            ..AteOptions::default()
        };
        let ate = ate(&truth, &estimate, &options).expect("three pairs");
        assert!((ate.stats.max - 0.5).abs() < 1e-15, "max {}", ate.stats.max);
        assert!(
            (ate.stats.sse - 0.25).abs() < 1e-15,
            "sse {}",
            ate.stats.sse
        );
        assert_eq!(ate.stats.pairs, 3, "pairs");
        assert_eq!(ate.truth_from_estimate, Sim3::identity(), "nothing moved");
    }

    /// The error of an estimate that never moves is the spread of the truth.
    #[test]
    fn a_frozen_estimate_has_the_spread_of_the_truth() {
        let truth = walk(50, 0.0);
        let frozen: Vec<_> = truth
            .iter()
            .map(|pose| StampedPose {
                world_from_camera: Se3::identity(),
                ..*pose
            })
            .collect();
        let ate = ate(&truth, &frozen, &AteOptions::default()).expect("50 pairs");
        let mean = truth.iter().fold(Vector3::zeros(), |s, p| s + position(p)) / 50.0;
        let spread = truth
            .iter()
            .fold(0.0, |s, p| s + (position(p) - mean).norm_squared());
        let expected = (spread / 50.0).sqrt();
        assert!(
            (ate.stats.rmse - expected).abs() < 1e-14,
            "{}",
            ate.stats.rmse
        );
    }

    #[test]
    fn two_pairs_are_too_few() {
        let truth = walk(2, 0.0);
        let error = ate(&truth, &truth, &AteOptions::default()).expect_err("two pairs");
        assert_eq!(
            error,
            EvalError::TooFew {
                what: "points",
                got: 2,
                needed: 3
            },
            "few"
        );
    }

    #[test]
    fn the_protocol_has_a_description() {
        let text = AteOptions::default().describe();
        assert_eq!(text, "rigid alignment, nearest time within 0.02 s", "words");
    }

    proptest! {
        /// The worlds of estimate and truth may be turned and shifted at will.
        #[test]
        fn a_rigid_motion_changes_nothing(xi in proptest::array::uniform6(-5.0f64..5.0)) {
            let (truth, estimate) = (walk(80, 0.0), walk(80, 0.01));
            let motion = Se3::exp(&xi.into());
            let motion = Sim3 { scale: 1.0, rotation: motion.rotation, translation: motion.translation };
            let options = AteOptions::default();
            let before = ate(&truth, &estimate, &options).expect("80 pairs").stats;
            for (truth, estimate) in [
                (truth.clone(), moved(&estimate, &motion)),
                (moved(&truth, &motion), estimate.clone()),
            ] {
                let after = ate(&truth, &estimate, &options).expect("80 pairs").stats;
                prop_assert!((after.rmse - before.rmse).abs() < 1e-14, "{after:?} {before:?}");
                prop_assert!((after.max - before.max).abs() < 1e-13, "{after:?} {before:?}");
            }
        }

        /// With scale free, a scaled estimate is as good as before; without, it is not.
        #[test]
        fn scale_matters_unless_it_is_aligned(scale in 1.1f64..4.0) {
            let (truth, estimate) = (walk(80, 0.0), walk(80, 0.01));
            let scaled = moved(&estimate, &Sim3 { scale, ..Sim3::identity() });
            let judge = |estimate: &[StampedPose], alignment| {
                let options = AteOptions { alignment, ..AteOptions::default() };
                ate(&truth, estimate, &options).expect("80 pairs").stats.rmse
            };
            let before = judge(&estimate, Alignment::Similarity);
            prop_assert!((judge(&scaled, Alignment::Similarity) - before).abs() < 1e-14);
            prop_assert!(judge(&scaled, Alignment::Rigid) > 0.05, "the scale shows");
        }
    }

    /// Stamps 30 ms late: all are pairs within 31 ms, none within 29 ms.
    #[test]
    fn the_time_limit_is_that_of_the_options() {
        let truth: Vec<_> = walk(6, 0.0).iter().step_by(2).copied().collect();
        let late = truth.iter().map(|pose| StampedPose {
            t_s: pose.t_s + 0.03,
            ..*pose
        });
        let late: Vec<_> = late.collect();
        let judge = |max_dt_s| {
            let options = AteOptions {
                max_dt_s,
                ..AteOptions::default()
            };
            ate(&truth, &late, &options).map(|a| a.stats.pairs)
        };
        assert_eq!(judge(0.031), Ok(3), "within 31 ms");
        assert!(
            matches!(judge(0.029), Err(EvalError::NoPairs { .. })),
            "within 29 ms"
        );
        for (alignment, words) in [
            (Alignment::None, "no alignment, nearest time within 0.5 s"),
            (
                Alignment::Similarity,
                "similarity alignment (with scale), nearest time within 0.5 s",
            ),
        ] {
            let options = AteOptions {
                alignment,
                max_dt_s: 0.5,
            };
            assert_eq!(options.describe(), words, "words");
        }
    }
}
