//! [`optimise_pose`]: the pose of a camera from static matches (eq. 11).
//!
//! The unknown is moved on the left, exp(ξ) * camera_from_world. Some matches are outliers: rounds of
//! Levenberg-Marquardt alternate with a gate that removes matches that do not fit (and readmits them
//! when they do).

use garad_core::chi_square::{CHI2_2DOF_95, CHI2_3DOF_95};
use garad_core::{Camera, Se3};
use nalgebra::{Matrix3, Matrix6, SMatrix, Vector2, Vector3, Vector6};

use crate::dense::{Dense, NormalEquations, Problem, Visitor};
use crate::error::{OptimError, positive};
use crate::lm::{LmConfig, Report, minimise};
use crate::reprojection::{Intrinsics, MIN_DEPTH_M, Reprojection, pose_jacobian};
use crate::robust::RobustKernel;

pub use crate::reprojection::DepthObservation;

/// A point of the map and where it was seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseObservation {
    /// The point, metres.
    pub p_world: Vector3<f64>,
    /// Where it was seen, in ideal (undistorted) pixels.
    pub uv_px: Vector2<f64>,
    /// Standard deviation of each coordinate, pixels: 1.2^level for a keypoint of that level.
    pub sigma_px: f64,
    /// Its depth reading, if there is one.
    pub depth: Option<DepthObservation>,
}

/// What is known of the camera's centre before the image is seen: N(centre, information⁻¹), with a
/// Huber kernel, so that a motion nobody expected is believed when many matches show it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CentrePrior {
    /// In world coordinates, metres.
    pub centre_m: Vector3<f64>,
    /// L of the information L Lᵀ, 1/m.
    pub root_information: Matrix3<f64>,
}

impl CentrePrior {
    /// δ of the kernel, standard deviations.
    const HUBER: RobustKernel = RobustKernel::Huber { delta: 3.0 };

    /// r = Lᵀ (c - c₀), c = -Rᵀ t, and ∂c/∂ξ = (-Rᵀ, 0).
    fn show<const N: usize>(&self, camera_from_world: &Se3, visitor: &mut impl Visitor<N>) {
        let rotation = camera_from_world.rotation.matrix();
        let centre_m = -(rotation.transpose() * camera_from_world.translation);
        let root = self.root_information.transpose();
        visitor.block(Self::HUBER, &(root * (centre_m - self.centre_m)), || {
            let mut jacobian = SMatrix::<f64, 3, N>::zeros();
            jacobian
                .fixed_view_mut::<3, 3>(0, 0)
                .copy_from(&-(root * rotation.transpose()));
            jacobian
        });
    }
}

/// How a pose is optimised.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseConfig {
    /// fx times the baseline of the virtual stereo pair, px·m.
    pub bf: f64,
    /// Rounds of optimising and gating.
    pub rounds: usize,
    /// Trials of Levenberg-Marquardt per round.
    pub iterations: usize,
    /// Gate on ‖r‖² of an observation without depth, and δ² of its Huber kernel: 95 % of χ² with
    /// 2 degrees of freedom.
    pub chi2_2d: f64,
    /// The same with depth: 3 degrees of freedom.
    pub chi2_3d: f64,
    /// Each round starts from the initial pose (as ORB-SLAM does) and not from the last one's:
    /// the effect of outliers in an early round is lost.
    pub restart_from_initial: bool,
    /// Rounds counted from 0; those after this one run without a kernel, on inliers alone.
    pub kernel_off_after_round: usize,
    /// A round has converged when the model expects a decrease of at most this part of the cost.
    /// 1e-9 of N residuals is a step of about √(N·2e-9) standard deviations of the pose.
    pub cost_tolerance: f64,
    /// What is known of the centre before the image is seen: adds ½ ρ(‖Lᵀ (c - c₀)‖²) to F.
    pub prior: Option<CentrePrior>,
}

impl Default for PoseConfig {
    fn default() -> Self {
        Self {
            bf: 40.0,
            rounds: 4,
            iterations: 10,
            chi2_2d: CHI2_2DOF_95,
            chi2_3d: CHI2_3DOF_95,
            restart_from_initial: true,
            kernel_off_after_round: 2,
            cost_tolerance: 1e-9,
            prior: None,
        }
    }
}

/// A pose, its inliers and its information.
#[derive(Debug, Clone, PartialEq)]
pub struct PoseSolution {
    /// The pose.
    pub camera_from_world: Se3,
    /// Per observation: within the gate and in front of the camera.
    pub inlier: Vec<bool>,
    /// How many are.
    pub n_inliers: usize,
    /// ½ Σ ρ of the last round.
    pub cost: f64,
    /// One per round.
    pub reports: Vec<Report>,
    /// Σ JᵀJ over the inliers, in the order (ρ, φ) of ξ: the inverse of the covariance of ξ.
    pub information: Matrix6<f64>,
}

/// A rigid pose has 6 unknowns; an observation gives at least 2 equations.
const MIN_OBSERVATIONS: usize = 3;
/// With fewer observations the gate is not reliable: only one round is run.
const MIN_OBSERVATIONS_TO_GATE: usize = 10;

/// Eq. 11: {R, t} = argmin Σᵢ ρ(‖pᵢ - π(R Pᵢ + t)‖²_Σ), the pose of a camera from matches of
/// static points Pᵢ and keypoints pᵢ.
///
/// The whitened residual has 2 rows, or 3 with a depth reading ([`crate::reprojection`], E12); ρ is
/// Huber's kernel with δ² = `chi2_2d` or `chi2_3d`. Observations beyond the gate or behind the camera
/// are left out of the next round, and checked again after it.
///
/// Source: the paper; rounds and gates as in ORB-SLAM2 (Mur-Artal, Tardós 2017).
///
/// # Numerics
/// f64, normal equations summed in the order of the observations: the same bits on every machine.
///
/// # Errors
/// [`OptimError`] for fewer than 3 observations, a number that is not finite, a σ that is
/// not positive. Not converging is no error: see `reports`. With fewer than 3 observations in
/// front of the camera the initial pose comes back.
pub fn optimise_pose(
    camera: &Camera,
    observations: &[PoseObservation],
    initial: &Se3,
    config: &PoseConfig,
) -> Result<PoseSolution, OptimError> {
    validate(observations, initial, config)?;
    let intrinsics = Intrinsics::new(camera, config.bf);
    let gate = Gate {
        intrinsics,
        config,
        observations,
    };
    let rounds = if observations.len() < MIN_OBSERVATIONS_TO_GATE {
        config.rounds.min(1)
    } else {
        config.rounds
    };
    let mut pose = *initial;
    let mut inlier = vec![true; observations.len()];
    let mut reports = Vec::with_capacity(rounds);
    for round in 0..rounds {
        let start = if config.restart_from_initial {
            *initial
        } else {
            pose
        };
        let visible = gate.visible(&start);
        let problem = PoseProblem {
            intrinsics,
            kernels: huber_kernels(
                (round <= config.kernel_off_after_round)
                    .then(|| [config.chi2_2d.sqrt(), config.chi2_3d.sqrt()]),
            ),
            prior: config.prior,
            observations: (0..observations.len())
                .filter(|&i| inlier[i] && visible[i])
                .map(|i| observations[i])
                .collect(),
        };
        if problem.observations.len() < MIN_OBSERVATIONS {
            break;
        }
        let lm = LmConfig {
            iterations: config.iterations,
            cost_tolerance: config.cost_tolerance,
            ..LmConfig::default()
        };
        let (solved, report) = minimise(&Dense(&problem), start, &lm);
        pose = solved;
        reports.push(report);
        inlier = gate.inliers(&pose);
    }
    if reports.is_empty() {
        inlier = gate.inliers(&pose);
    }
    Ok(PoseSolution {
        camera_from_world: pose,
        n_inliers: inlier.iter().filter(|&&i| i).count(),
        cost: reports.last().map_or(0.0, |r| r.cost),
        information: gate.information(&pose, &inlier),
        inlier,
        reports,
    })
}

/// The cost of eq. 11 as a [`Problem`] of six unknowns: every residual block can be shown to any
/// [`Visitor`].
#[derive(Debug, Clone)]
pub struct PoseProblem {
    intrinsics: Intrinsics,
    /// With 2 and with 3 rows.
    kernels: [RobustKernel; 2],
    prior: Option<CentrePrior>,
    observations: Vec<PoseObservation>,
}

impl PoseProblem {
    /// The problem of one round. `huber`: δ of observations without and with depth; `None` for
    /// plain least squares.
    #[must_use]
    pub fn new(
        camera: &Camera,
        bf: f64,
        huber: Option<[f64; 2]>,
        observations: Vec<PoseObservation>,
    ) -> Self {
        Self {
            intrinsics: Intrinsics::new(camera, bf),
            kernels: huber_kernels(huber),
            prior: None,
            observations,
        }
    }

    /// Adds a prior of the centre.
    pub fn set_prior(&mut self, prior: Option<CentrePrior>) {
        self.prior = prior;
    }

    /// Sets the kernels of observations without and with depth.
    pub fn set_kernels(&mut self, kernels: [RobustKernel; 2]) {
        self.kernels = kernels;
    }
}

fn huber_kernels(deltas: Option<[f64; 2]>) -> [RobustKernel; 2] {
    deltas.map_or([RobustKernel::None; 2], |deltas| {
        deltas.map(|delta| RobustKernel::Huber { delta })
    })
}

impl PoseObservation {
    pub(crate) fn reprojection(&self) -> Reprojection {
        Reprojection {
            uv_px: self.uv_px,
            sigma_px: self.sigma_px,
            depth: self.depth,
        }
    }
}

impl Problem<6> for PoseProblem {
    type State = Se3;

    #[inline]
    fn blocks(&self, camera_from_world: &Se3, visitor: &mut impl Visitor<6>) {
        let k = &self.intrinsics;
        let [kernel2, kernel3] = self.kernels;
        let rotation = camera_from_world.rotation.matrix();
        for observation in &self.observations {
            let p_cam = rotation * observation.p_world + camera_from_world.translation;
            if p_cam.z < MIN_DEPTH_M {
                visitor.forbid();
                return;
            }
            let seen = observation.reprojection();
            match &seen.depth {
                None => visitor.block(kernel2, &seen.residual2(k, &p_cam), || {
                    pose_jacobian(&seen.point_jacobian2(k, &p_cam), &p_cam)
                }),
                Some(right) => visitor.block(kernel3, &seen.residual3(k, right, &p_cam), || {
                    pose_jacobian(&seen.point_jacobian3(k, right, &p_cam), &p_cam)
                }),
            }
        }
        if let Some(prior) = &self.prior {
            prior.show(camera_from_world, visitor);
        }
    }

    fn step(&self, camera_from_world: &Se3, xi: &Vector6<f64>) -> Se3 {
        Se3::exp(xi) * *camera_from_world
    }
}

/// The test of observations against a pose.
struct Gate<'a> {
    intrinsics: Intrinsics,
    config: &'a PoseConfig,
    observations: &'a [PoseObservation],
}

impl Gate<'_> {
    fn per_observation(
        &self,
        pose: &Se3,
        keep: impl Fn(&PoseObservation, f64) -> bool,
    ) -> Vec<bool> {
        let rotation = pose.rotation.matrix();
        self.observations
            .iter()
            .map(|o| {
                let p_cam = rotation * o.p_world + pose.translation;
                keep(o, o.reprojection().chi2(&self.intrinsics, &p_cam))
            })
            .collect()
    }

    /// In front of the camera.
    fn visible(&self, pose: &Se3) -> Vec<bool> {
        self.per_observation(pose, |_, chi2| chi2.is_finite())
    }

    fn inliers(&self, pose: &Se3) -> Vec<bool> {
        self.per_observation(pose, |o, chi2| {
            chi2 <= match o.depth {
                None => self.config.chi2_2d,
                Some(_) => self.config.chi2_3d,
            }
        })
    }

    fn information(&self, pose: &Se3, inlier: &[bool]) -> Matrix6<f64> {
        let problem = PoseProblem {
            intrinsics: self.intrinsics,
            kernels: huber_kernels(None),
            prior: None,
            observations: (self.observations.iter().zip(inlier))
                .filter(|&(_, &inlier)| inlier)
                .map(|(o, _)| *o)
                .collect(),
        };
        let mut equations = NormalEquations::<6>::default();
        problem.blocks(pose, &mut equations);
        equations.full_hessian()
    }
}

fn validate(
    observations: &[PoseObservation],
    initial: &Se3,
    config: &PoseConfig,
) -> Result<(), OptimError> {
    if observations.len() < MIN_OBSERVATIONS {
        return Err(OptimError::TooFewObservations {
            got: observations.len(),
            needed: MIN_OBSERVATIONS,
        });
    }
    if !initial.is_finite() {
        return Err(OptimError::NotFinite {
            what: "initial pose",
            index: 0,
        });
    }
    for (what, value) in [
        ("bf", config.bf),
        ("chi2_2d", config.chi2_2d),
        ("chi2_3d", config.chi2_3d),
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
        o.reprojection().validate(index)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests;
