//! [`solve_pnp_ransac`]: the pose of a camera from matches with many outliers and no initial pose.
//!
//! [`crate::pose`] needs an initial pose and matches that are mostly right; after tracking was lost there
//! is neither. Three matches leave at most four poses ([`p3p()`]); triples are drawn until one without a
//! wrong match has very probably been among them; the pose with most inliers is refined
//! on those by Levenberg-Marquardt.
//!
//! Reading order: [`p3p`](mod@p3p) (three points) → this file (many, with outliers).

use garad_core::{Camera, Par, Rng, Se3};
use nalgebra::Vector3;

use crate::error::{OptimError, positive};
use crate::pose::{PoseConfig, PoseObservation, optimise_pose};
use crate::reprojection::{Intrinsics, Reprojection};

pub mod p3p;

pub use p3p::p3p;

/// Settings of [`solve_pnp_ransac`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PnpConfig {
    /// Wanted probability of having drawn a triple without a wrong match.
    pub confidence: f64,
    /// Most triples drawn.
    pub max_samples: usize,
    /// Inliers that a pose needs.
    pub min_inliers: usize,
    /// Seed of the draws.
    pub seed: u64,
    /// Gates, kernel and iterations of the refinement; `chi2_2d` is also the gate of a triple's pose.
    pub pose: PoseConfig,
}

impl Default for PnpConfig {
    fn default() -> Self {
        Self {
            confidence: 0.99,
            max_samples: 300,
            min_inliers: 10,
            seed: 0,
            pose: PoseConfig::default(),
        }
    }
}

/// Result of [`solve_pnp_ransac`].
#[derive(Debug, Clone, PartialEq)]
pub struct PnpResult {
    /// The pose.
    pub camera_from_world: Se3,
    /// Per observation: within the gate, with its depth reading if it has one.
    pub inlier: Vec<bool>,
    /// How many are.
    pub n_inliers: usize,
    /// Triples drawn.
    pub samples: usize,
}

/// Triples drawn between two tests of the stopping rule.
const BATCH: usize = 32;
/// Most rounds of refining on the inliers.
const REFITS: usize = 5;

/// Finds the pose of a camera from matches of which many may be wrong.
///
/// Random sample consensus over [`p3p()`] with the cost Σ min(χ², `chi2_2d`) of pixels (MSAC: Torr and
/// Zisserman 2000). Drawing stops when a triple without a wrong match has been seen with probability
/// `confidence`: 1 - (1 - w³)ᵏ, w the share of inliers. The best pose is refined on its inliers by
/// [`optimise_pose`], depth readings included, as long as their number grows.
///
/// `Ok(None)`: no pose has `min_inliers`; also for fewer than three observations and for points
/// that are all on a line, in one place, or behind the camera.
///
/// # Numerics
/// f64. Sample i comes from its own stream of the seed and ties go to the lowest i: the same bits
/// for every `par`.
///
/// # Errors
/// [`OptimError`] for numbers that are not finite, a σ or gate that is not positive, a confidence
/// outside (0, 1).
pub fn solve_pnp_ransac(
    camera: &Camera,
    observations: &[PoseObservation],
    config: &PnpConfig,
    par: Par,
) -> Result<Option<PnpResult>, OptimError> {
    validate(observations, config)?;
    let problem = Pnp {
        intrinsics: Intrinsics::new(camera, config.pose.bf),
        bearings: observations
            .iter()
            .map(|o| camera.unproject(&o.uv_px, 1.0))
            .collect(),
        observations,
        config,
    };
    let Some((start, samples)) = problem.consensus(par) else {
        return Ok(None);
    };
    let (camera_from_world, inlier) = problem.refine(camera, &start)?;
    let n_inliers = count(&inlier);
    Ok((n_inliers >= config.min_inliers).then_some(PnpResult {
        camera_from_world,
        inlier,
        n_inliers,
        samples,
    }))
}

struct Pnp<'a> {
    intrinsics: Intrinsics,
    /// Directions of the pixels, z = 1.
    bearings: Vec<Vector3<f64>>,
    observations: &'a [PoseObservation],
    config: &'a PnpConfig,
}

/// A pose and Σ min(χ², gate) over all observations.
#[derive(Debug, Clone, Copy)]
struct Hypothesis {
    pose: Se3,
    cost: f64,
    n_inliers: usize,
}

impl Pnp<'_> {
    /// The best pose of all triples drawn, and their number.
    fn consensus(&self, par: Par) -> Option<(Se3, usize)> {
        if self.observations.len() < 3 {
            return None;
        }
        let mut best: Option<Hypothesis> = None;
        let (mut drawn, mut enough) = (0, self.config.max_samples);
        while drawn < enough {
            let batch = BATCH.min(enough - drawn);
            for found in par
                .map(batch, |i| self.sample(drawn + i))
                .into_iter()
                .flatten()
            {
                if best.is_none_or(|b| found.cost < b.cost) {
                    best = Some(found);
                }
            }
            drawn += batch;
            if let Some(best) = best {
                let share = best.n_inliers as f64 / self.observations.len() as f64;
                enough = enough.min(samples_needed(share, self.config.confidence));
            }
        }
        best.map(|b| (b.pose, drawn))
    }

    /// The best of the poses that triple number i allows.
    fn sample(&self, i: usize) -> Option<Hypothesis> {
        let mut rng = Rng::keyed(self.config.seed, &[i as u64]);
        let triple = three_of(self.observations.len(), &mut rng);
        let poses = p3p(
            &triple.map(|k| self.bearings[k]),
            &triple.map(|k| self.observations[k].p_world),
        );
        let judged = poses.into_iter().map(|pose| self.judge(pose));
        judged.reduce(|best, next| if next.cost < best.cost { next } else { best })
    }

    fn judge(&self, pose: Se3) -> Hypothesis {
        let (rotation, gate) = (pose.rotation.matrix(), self.config.pose.chi2_2d);
        let (mut cost, mut n_inliers) = (0.0, 0);
        for o in self.observations {
            let p_cam = rotation * o.p_world + pose.translation;
            let pixel = Reprojection {
                uv_px: o.uv_px,
                sigma_px: o.sigma_px,
                depth: None,
            };
            let chi2 = pixel.chi2(&self.intrinsics, &p_cam);
            cost += chi2.min(gate);
            n_inliers += usize::from(chi2 <= gate);
        }
        Hypothesis {
            pose,
            cost,
            n_inliers,
        }
    }

    /// Levenberg-Marquardt on the inliers, then new inliers, while their number grows.
    fn refine(&self, camera: &Camera, start: &Se3) -> Result<(Se3, Vec<bool>), OptimError> {
        let config = PoseConfig {
            rounds: 1,
            ..self.config.pose
        };
        // The gate of the triple's pose uses pixels, that of later ones also depth.
        let mut pose = *start;
        let mut inlier = self.inliers(start, false);
        let mut most = 0;
        for _ in 0..REFITS {
            let agreeing: Vec<_> = (self.observations.iter().zip(&inlier))
                .filter(|&(_, &inlier)| inlier)
                .map(|(o, _)| *o)
                .collect();
            if agreeing.len() < 3 {
                break;
            }
            let refined = optimise_pose(camera, &agreeing, &pose, &config)?.camera_from_world;
            let now = self.inliers(&refined, true);
            if count(&now) < most {
                break;
            }
            let settled = now == inlier;
            (pose, inlier, most) = (refined, now, count(&inlier));
            if settled {
                break;
            }
        }
        Ok((pose, inlier))
    }

    fn inliers(&self, pose: &Se3, with_depth: bool) -> Vec<bool> {
        let config = &self.config.pose;
        self.observations
            .iter()
            .map(|o| {
                let depth = o.depth.filter(|_| with_depth);
                let gate = match depth {
                    None => config.chi2_2d,
                    Some(_) => config.chi2_3d,
                };
                let seen = Reprojection {
                    uv_px: o.uv_px,
                    sigma_px: o.sigma_px,
                    depth,
                };
                seen.chi2(&self.intrinsics, &(*pose * o.p_world)) <= gate
            })
            .collect()
    }
}

fn count(inlier: &[bool]) -> usize {
    inlier.iter().filter(|&&i| i).count()
}

/// Three different numbers below n ≥ 3.
fn three_of(n: usize, rng: &mut Rng) -> [usize; 3] {
    let a = rng.below(n);
    let b = (a + 1 + rng.below(n - 1)) % n;
    loop {
        let c = rng.below(n);
        if c != a && c != b {
            return [a, b, c];
        }
    }
}

/// k with 1 - (1 - w³)ᵏ ≥ confidence, at least 1.
fn samples_needed(share: f64, confidence: f64) -> usize {
    let clean = share * share * share;
    if clean >= 1.0 {
        return 1;
    }
    let k = libm::ceil(libm::log(1.0 - confidence) / libm::log1p(-clean));
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "at least 1, and `as` saturates: infinitely many are usize::MAX"
    )]
    let k = k.max(1.0) as usize;
    k
}

fn validate(observations: &[PoseObservation], config: &PnpConfig) -> Result<(), OptimError> {
    for (what, value) in [
        ("confidence", config.confidence),
        ("1 - confidence", 1.0 - config.confidence),
        ("bf", config.pose.bf),
        ("chi2_2d", config.pose.chi2_2d),
        ("chi2_3d", config.pose.chi2_3d),
    ] {
        positive(what, 0, value)?;
    }
    for (index, o) in observations.iter().enumerate() {
        if !o.p_world.iter().all(|v| v.is_finite()) {
            return Err(OptimError::NotFinite {
                what: "p_world of observation",
                index,
            });
        }
        let seen = Reprojection {
            uv_px: o.uv_px,
            sigma_px: o.sigma_px,
            depth: o.depth,
        };
        seen.validate(index)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests;
