//! F from pairs with outliers (RANSAC).

use garad_core::{Par, Rng};
use nalgebra::{Matrix3, Vector2};

use super::eight_point::{MIN_PAIRS, check_pairs, eight_point_of};
use super::sampson_px2;
use crate::error::{FeatureError, setting};

/// Settings of [`fundamental_ransac`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RansacConfig {
    /// Largest Sampson distance of an inlier, pixels.
    pub threshold_px: f64,
    /// Wanted probability of having drawn a sample without a wrong pair.
    pub confidence: f64,
    /// Most samples drawn.
    pub max_samples: usize,
    /// Seed of the draws.
    pub seed: u64,
}

impl Default for RansacConfig {
    fn default() -> Self {
        Self {
            threshold_px: 1.0,
            confidence: 0.999,
            max_samples: 2000,
            seed: 0,
        }
    }
}

/// Result of [`fundamental_ransac`].
#[derive(Debug, Clone, PartialEq)]
pub struct FundamentalEstimate {
    /// ‖F‖ = 1, entry of largest magnitude positive.
    pub fundamental: Matrix3<f64>,
    /// Per pair: within the threshold.
    pub inliers: Vec<bool>,
    /// Samples drawn.
    pub samples: usize,
}

/// Samples drawn between two tests of the stopping rule.
const BATCH: usize = 64;
/// Most rounds of refitting to all inliers.
const REFITS: usize = 10;

/// A hypothesis and its cost, Σ min(d², threshold²); lower is better.
#[derive(Debug, Clone)]
struct Hypothesis {
    fundamental: Matrix3<f64>,
    cost: f64,
    inliers: Vec<usize>,
}

/// Random sample consensus with the eight-point algorithm, truncated squared Sampson distance as
/// cost (MSAC, Torr & Zisserman 2000), and refits of the winner to its inliers while they help.
///
/// Sample i comes from its own stream of the seed and ties go to the lowest i, so the answer has
/// the same bits for every `par`. Drawing stops when a sample without a wrong pair has been seen
/// with probability `confidence`: 1 - (1 - wⁿ)ᵏ with w the share of inliers, n = 8.
///
/// # Errors
/// As [`super::eight_point()`]; [`FeatureError::Degenerate`] also if no sample gave an F;
/// [`FeatureError::BadSetting`] for a threshold that is not positive, a confidence outside (0, 1)
/// or no samples.
pub fn fundamental_ransac(
    uv1: &[Vector2<f64>],
    uv2: &[Vector2<f64>],
    config: &RansacConfig,
    par: Par,
) -> Result<FundamentalEstimate, FeatureError> {
    check_pairs(uv1, uv2)?;
    config.validate()?;
    let evaluate = |fundamental| Hypothesis::new(fundamental, uv1, uv2, config.threshold_px);
    let mut best: Option<Hypothesis> = None;
    let (mut drawn, mut enough) = (0, config.max_samples);
    while drawn < enough {
        let count = BATCH.min(config.max_samples - drawn);
        let batch = par.map(count, |i| {
            let sample = draw(config.seed, drawn + i, uv1.len());
            eight_point_of(uv1, uv2, &sample).ok().map(evaluate)
        });
        drawn += count;
        for hypothesis in batch.into_iter().flatten() {
            if best.as_ref().is_none_or(|b| hypothesis.cost < b.cost) {
                best = Some(hypothesis);
            }
        }
        if let Some(best) = &best {
            let share = best.inliers.len() as f64 / uv1.len() as f64;
            enough = samples_needed(share, config).min(config.max_samples);
        }
    }
    let mut best = best.ok_or(FeatureError::Degenerate {
        reason: "no sample of eight pairs determines F",
    })?;
    for _ in 0..REFITS {
        if best.inliers.len() < MIN_PAIRS {
            break;
        }
        match eight_point_of(uv1, uv2, &best.inliers).map(evaluate) {
            Ok(refit) if refit.cost < best.cost => best = refit,
            _ => break,
        }
    }
    let mut inliers = vec![false; uv1.len()];
    for &i in &best.inliers {
        inliers[i] = true;
    }
    Ok(FundamentalEstimate {
        fundamental: best.fundamental,
        inliers,
        samples: drawn,
    })
}

impl RansacConfig {
    fn validate(&self) -> Result<(), FeatureError> {
        let (px, p) = (self.threshold_px, self.confidence);
        let valid = px > 0.0 && px.is_finite();
        setting("threshold_px", px, "a positive number", valid)?;
        setting("confidence", p, "between 0 and 1", p > 0.0 && p < 1.0)?;
        setting("max_samples", 0.0, "at least 1", self.max_samples > 0)
    }
}

impl Hypothesis {
    fn new(
        fundamental: Matrix3<f64>,
        uv1: &[Vector2<f64>],
        uv2: &[Vector2<f64>],
        threshold_px: f64,
    ) -> Self {
        let limit = threshold_px * threshold_px;
        let (mut cost, mut inliers) = (0.0, Vec::new());
        for (i, (a, b)) in uv1.iter().zip(uv2).enumerate() {
            let d2 = sampson_px2(&fundamental, a, b);
            // NaN is an outlier.
            if d2 <= limit {
                cost += d2;
                inliers.push(i);
            } else {
                cost += limit;
            }
        }
        Self {
            fundamental,
            cost,
            inliers,
        }
    }
}

/// Eight different indices below `n`, from the stream of this sample.
fn draw(seed: u64, sample: usize, n: usize) -> [usize; MIN_PAIRS] {
    let mut rng = Rng::keyed(seed, &[sample as u64]);
    let mut chosen = [0; MIN_PAIRS];
    let mut count = 0;
    while count < MIN_PAIRS {
        let candidate = rng.below(n);
        if !chosen[..count].contains(&candidate) {
            chosen[count] = candidate;
            count += 1;
        }
    }
    chosen
}

/// k with 1 - (1 - wⁿ)ᵏ ≥ confidence.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "saturates: a count of samples, capped by the caller"
)]
fn samples_needed(share: f64, config: &RansacConfig) -> usize {
    let w2 = share * share;
    let good_sample = w2 * w2 * w2 * w2;
    let needed = libm::log(1.0 - config.confidence) / libm::log1p(-good_sample);
    needed.ceil() as usize
}

#[cfg(test)]
mod tests {
    use super::super::tests::{motion, two_views};
    use super::*;

    /// Exact pairs, the first `wrong` of them replaced by random ones, all with pixel noise.
    fn pairs(n: usize, wrong: usize, noise_px: f64, seed: u64) -> [Vec<Vector2<f64>>; 2] {
        let [uv1, mut uv2] = two_views(n, &motion(), seed);
        let mut rng = Rng::new(seed ^ 77);
        for (i, uv) in uv2.iter_mut().enumerate() {
            if i < wrong {
                *uv = Vector2::new(rng.range(0.0, 640.0), rng.range(0.0, 480.0));
            } else {
                *uv += Vector2::new(rng.normal(), rng.normal()) * noise_px;
            }
        }
        [uv1, uv2]
    }

    #[test]
    fn outliers_are_found() {
        for seed in 0..5 {
            let (n, wrong) = (200, 60);
            let [uv1, uv2] = pairs(n, wrong, 0.3, seed);
            let config = RansacConfig {
                seed,
                ..RansacConfig::default()
            };
            let found = fundamental_ransac(&uv1, &uv2, &config, Par::Seq).expect("solvable");
            let kept = found.inliers.iter().filter(|&&i| i).count();
            let right = found.inliers[wrong..].iter().filter(|&&i| i).count();
            let recall = right as f64 / (n - wrong) as f64;
            // A random pair lies within 1 px of its line once in some hundred times.
            let precision = right as f64 / kept as f64;
            assert!(
                recall >= 0.97 && precision >= 0.97,
                "{recall} {precision}, seed {seed}"
            );
            for threads in [2, 3] {
                let again = fundamental_ransac(&uv1, &uv2, &config, Par::new(threads));
                assert_eq!(again.as_ref(), Ok(&found), "{threads} threads");
            }
        }
    }

    #[test]
    fn clean_pairs_need_one_batch() {
        let [uv1, uv2] = pairs(50, 0, 0.0, 3);
        let found = fundamental_ransac(&uv1, &uv2, &RansacConfig::default(), Par::Seq);
        let found = found.expect("solvable");
        assert_eq!(
            (found.samples, found.inliers),
            (BATCH, vec![true; 50]),
            "all agree"
        );
    }

    #[test]
    fn number_of_samples_follows_the_share() {
        let config = RansacConfig {
            confidence: 0.99,
            ..RansacConfig::default()
        };
        // ln 0.01 / ln(1 - 0.5^8) = 1176.6
        assert_eq!(
            samples_needed(0.5, &config),
            1177,
            "half of the pairs wrong"
        );
        assert_eq!(samples_needed(1.0, &config), 0, "none wrong");
        assert_eq!(samples_needed(0.0, &config), usize::MAX, "all wrong");
    }

    #[test]
    fn bad_settings_and_degenerate_points_are_errors() {
        let [uv1, uv2] = pairs(20, 0, 0.0, 3);
        let good = RansacConfig::default();
        type Break = fn(&mut RansacConfig);
        let breaks: [(&str, Break); 4] = [
            ("threshold_px", |c| c.threshold_px = 0.0),
            ("threshold_px", |c| c.threshold_px = f64::NAN),
            ("confidence", |c| c.confidence = 1.0),
            ("max_samples", |c| c.max_samples = 0),
        ];
        for (name, spoil) in breaks {
            let mut bad = good;
            spoil(&mut bad);
            match fundamental_ransac(&uv1, &uv2, &bad, Par::Seq) {
                Err(FeatureError::BadSetting { setting, .. }) => assert_eq!(setting, name),
                other => panic!("{name}: {other:?}"),
            }
        }
        let still = fundamental_ransac(&uv1, &uv1, &good, Par::Seq);
        assert!(
            matches!(still, Err(FeatureError::Degenerate { .. })),
            "no parallax: {still:?}"
        );
        let few = fundamental_ransac(&uv1[..5], &uv2[..5], &good, Par::Seq);
        assert_eq!(few, Err(FeatureError::TooFewPoints { got: 5, needed: 8 }));
    }

    /// Two pairs beside their lines: by a threshold below both, between them, and above both.
    #[test]
    fn the_threshold_decides_who_is_in() {
        let [uv1, mut uv2] = pairs(80, 0, 0.0, 5);
        let truth = fundamental_ransac(&uv1, &uv2, &RansacConfig::default(), Par::Seq);
        let f = truth.expect("solvable").fundamental;
        for (i, off_px) in [(3, 2.0), (50, 3.5)] {
            uv2[i].y += off_px;
        }
        let off = [3, 50].map(|i| sampson_px2(&f, &uv1[i], &uv2[i]).sqrt());
        assert!(off[0] < 0.9 * off[1] && off[0] > 0.1, "{off:?}");
        for (threshold_px, expected) in [
            (0.9 * off[0], [false, false]),
            (0.5 * (off[0] + off[1]), [true, false]),
            (1.3 * off[1], [true, true]),
        ] {
            let config = RansacConfig {
                threshold_px,
                ..RansacConfig::default()
            };
            let found = fundamental_ransac(&uv1, &uv2, &config, Par::Seq).expect("solvable");
            assert_eq!(
                [3, 50].map(|i| found.inliers[i]),
                expected,
                "{threshold_px} px"
            );
            let right = (0..80)
                .filter(|i| ![3, 50].contains(i) && found.inliers[*i])
                .count();
            assert_eq!(right, 78, "all exact ones, {threshold_px} px");
        }
    }

    /// 40 of 100 wrong: 0.6⁸ = 0.0168 of the samples are clean. ln(1 - c) / ln(1 - 0.0168) is 136, 272 and 544, in
    /// batches of 64.
    #[test]
    fn draws_end_by_confidence_and_by_their_limit() {
        let [uv1, mut uv2] = pairs(100, 0, 0.0, 6);
        for (i, uv) in uv2[..40].iter_mut().enumerate() {
            uv.y += 4000.0 + 370.0 * (i * i % 17) as f64; // nowhere near
        }
        for (confidence, max_samples, expected) in [
            (0.9, 2000, 192),
            (0.99, 2000, 320),
            (0.9999, 2000, 576),
            (0.9999, 500, 500),
            (0.9999, 330, 330),
        ] {
            let config = RansacConfig {
                confidence,
                max_samples,
                ..RansacConfig::default()
            };
            let found = fundamental_ransac(&uv1, &uv2, &config, Par::Seq).expect("solvable");
            assert_eq!(found.samples, expected, "{confidence}, {max_samples}");
            let inliers = found.inliers.iter().filter(|&&i| i).count();
            assert_eq!(inliers, 60, "{confidence}: the right ones");
        }
    }

    /// A single draw of eight among 24 pairs of which four are wrong is clean in one case of six, by its seed.
    #[test]
    fn the_seed_decides_the_draws() {
        let [uv1, mut uv2] = pairs(24, 0, 0.0, 6);
        for (i, uv) in uv2[..4].iter_mut().enumerate() {
            uv.y += 900.0 + 370.0 * i as f64;
        }
        let mut clean_seeds = 0;
        for seed in 0..60 {
            let config = RansacConfig {
                seed,
                max_samples: 1,
                ..RansacConfig::default()
            };
            let clean = draw(seed, 0, 24).iter().all(|&k| k >= 4);
            let found = fundamental_ransac(&uv1, &uv2, &config, Par::Seq).expect("solvable");
            let inliers = found.inliers.iter().filter(|&&i| i).count();
            assert_eq!(inliers == 20, clean, "seed {seed}: {inliers}");
            clean_seeds += usize::from(clean);
        }
        assert!((2..30).contains(&clean_seeds), "{clean_seeds} of 60");
    }
}
