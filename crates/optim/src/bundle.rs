//! [`optimise_bundle`]: poses and points together.
//!
//! The cost is that of eq. 11, summed over every camera that sees a point, with the points unknown
//! as well. Poses are moved on the left, exp(ξ) * camera_from_world, points by addition.

use garad_core::chi_square::{CHI2_2DOF_95, CHI2_3DOF_95};
use garad_core::{Camera, Se3};
use nalgebra::{Matrix3, SMatrix, SVector, Vector2, Vector3};

use crate::blocks::LinearSolver;
use crate::error::{OptimError, positive};
use crate::lm::{LmConfig, Model, Report, minimise};
use crate::reprojection::{DepthObservation, Intrinsics, MIN_DEPTH_M, Reprojection};
use crate::robust::RobustKernel;
use crate::schur::{BundleStep, InCamera, SchurSystem, Structure};

/// A point seen by a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BundleObservation {
    /// Index of the pose.
    pub pose: usize,
    /// Index of the point.
    pub point: usize,
    /// Where it was seen, in ideal (undistorted) pixels.
    pub uv_px: Vector2<f64>,
    /// Standard deviation of each coordinate, pixels.
    pub sigma_px: f64,
    /// Its depth reading, if there is one.
    pub depth: Option<DepthObservation>,
}

/// How a bundle is adjusted.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BundleConfig {
    /// Trials of Levenberg-Marquardt.
    pub iterations: usize,
    /// δ² of the Huber kernel of an observation without depth, and its gate at the
    /// end: 95 % of χ² with 2 degrees of freedom.
    pub chi2_2d: f64,
    /// The same with depth: 3 degrees of freedom.
    pub chi2_3d: f64,
    /// Huber, or plain least squares.
    pub robust: bool,
    /// Converged when the model expects a decrease of at most this part of the cost. With a kernel each
    /// step covers only a part of the distance: the remainder is a few times as much (measured: 1e-6 stops
    /// 2e-6 above the optimum, 1e-7 stops 4e-7 above it).
    pub cost_tolerance: f64,
    /// Of the reduced system of the poses.
    pub linear_solver: LinearSolver,
}

impl Default for BundleConfig {
    fn default() -> Self {
        Self {
            iterations: 10,
            chi2_2d: CHI2_2DOF_95,
            chi2_3d: CHI2_3DOF_95,
            robust: true,
            cost_tolerance: 1e-6,
            linear_solver: LinearSolver::Portable,
        }
    }
}

/// The report of the minimisation, and the inliers.
#[derive(Debug, Clone, PartialEq)]
pub struct BundleReport {
    /// Of the minimisation.
    pub report: Report,
    /// Per observation: within the gate and in front of its camera, at the end.
    pub inlier: Vec<bool>,
}

/// Adjusts poses and points to what was seen.
///
/// F = ½ Σ ρ(‖r(Rₖ pᵢ + tₖ)‖²) over all observations (k, i), ρ Huber's kernel, r as in
/// [`crate::reprojection`] (E12), by Levenberg-Marquardt with the points eliminated (E13).
///
/// # Shapes and units
/// `poses` and `fixed` \[K\], `camera_from_world`, m · `points` \[N, 3\] m · `bf` fx times baseline, px·m
/// # Numerics
/// f64, sums in the order of points, then of the elimination of poses: the same bits on every
/// machine by [`LinearSolver::Portable`]. The reduced system has a 6x6 block per pair of poses that see a point together, and is
/// factored as a sparse one: a long trajectory costs little more than its windows do.
///
/// Fixed poses do not move, nor do points without observations. Observations that start behind their
/// camera take no part; steps that would bring another one there are rejected. With no
/// fixed pose the bundle as a whole is held only by the damping.
///
/// # Errors
/// [`OptimError`] for indices out of range, numbers that are not finite, a σ that is not
/// positive; poses and points are then untouched.
pub fn optimise_bundle(
    camera: &Camera,
    bf: f64,
    poses: &mut [Se3],
    fixed: &[bool],
    points: &mut [Vector3<f64>],
    observations: &[BundleObservation],
    config: &BundleConfig,
) -> Result<BundleReport, OptimError> {
    validate(bf, poses, fixed, points, observations, config)?;
    let state = Bundle {
        poses: poses.to_vec(),
        points: points.to_vec(),
    };
    let model = BundleModel::new(
        Intrinsics::new(camera, bf),
        &state,
        fixed,
        observations,
        config,
    );
    let lm = LmConfig {
        iterations: config.iterations,
        cost_tolerance: config.cost_tolerance,
        ..LmConfig::default()
    };
    let (state, report) = minimise(&&model, state, &lm);
    poses.copy_from_slice(&state.poses);
    points.copy_from_slice(&state.points);
    let inlier = observations
        .iter()
        .map(|o| {
            let gate = match o.depth {
                None => config.chi2_2d,
                Some(_) => config.chi2_3d,
            };
            let p_cam = poses[o.pose] * points[o.point];
            o.reprojection().chi2(&model.intrinsics, &p_cam) <= gate
        })
        .collect();
    Ok(BundleReport { report, inlier })
}

/// The unknowns, with the fixed poses.
#[derive(Debug, Clone, PartialEq)]
struct Bundle {
    poses: Vec<Se3>,
    points: Vec<Vector3<f64>>,
}

impl BundleObservation {
    fn reprojection(&self) -> Reprojection {
        Reprojection {
            uv_px: self.uv_px,
            sigma_px: self.sigma_px,
            depth: self.depth,
        }
    }
}

struct BundleModel {
    intrinsics: Intrinsics,
    kernel2: RobustKernel,
    kernel3: RobustKernel,
    /// Index of each free pose.
    free: Vec<usize>,
    /// Those that start in front of their camera, grouped by point.
    observations: Vec<BundleObservation>,
    structure: Structure,
}

impl BundleModel {
    fn new(
        intrinsics: Intrinsics,
        start: &Bundle,
        fixed: &[bool],
        observations: &[BundleObservation],
        config: &BundleConfig,
    ) -> Self {
        let free: Vec<usize> = (0..fixed.len()).filter(|&k| !fixed[k]).collect();
        let mut active: Vec<_> = (0..observations.len())
            .filter(|&i| {
                let o = &observations[i];
                let p_cam = start.poses[o.pose] * start.points[o.point];
                o.reprojection().chi2(&intrinsics, &p_cam).is_finite()
            })
            .map(|i| {
                let o = &observations[i];
                (o.point, free.binary_search(&o.pose).ok(), i)
            })
            .collect();
        let points = start.points.len();
        let structure = Structure::new(free.len(), points, &mut active, config.linear_solver);
        let kernel = |chi2: f64| {
            if config.robust {
                RobustKernel::Huber { delta: chi2.sqrt() }
            } else {
                RobustKernel::None
            }
        };
        Self {
            intrinsics,
            kernel2: kernel(config.chi2_2d),
            kernel3: kernel(config.chi2_3d),
            free,
            observations: active.iter().map(|a| observations[a.2]).collect(),
            structure,
        }
    }

    fn rotations(state: &Bundle) -> Vec<Matrix3<f64>> {
        state.poses.iter().map(|p| p.rotation.matrix()).collect()
    }
}

impl<'a> Model for &'a BundleModel {
    type State = Bundle;
    type System = SchurSystem<'a>;

    fn cost(&self, state: &Bundle) -> f64 {
        let (k, rotations) = (&self.intrinsics, BundleModel::rotations(state));
        let mut cost = 0.0;
        for o in &self.observations {
            let p_cam = rotations[o.pose] * state.points[o.point] + state.poses[o.pose].translation;
            if p_cam.z < MIN_DEPTH_M {
                return f64::INFINITY;
            }
            let kernel = if o.depth.is_none() {
                self.kernel2
            } else {
                self.kernel3
            };
            cost += 0.5 * kernel.rho(o.reprojection().chi2(k, &p_cam));
        }
        cost
    }

    fn linearise(&self, state: &Bundle) -> SchurSystem<'a> {
        let (k, rotations) = (&self.intrinsics, BundleModel::rotations(state));
        let mut system = SchurSystem::zeros(&self.structure);
        for o in &self.observations {
            let rotation = &rotations[o.pose];
            let p_cam = rotation * state.points[o.point] + state.poses[o.pose].translation;
            let seen = o.reprojection();
            let (rho, parts) = match &o.depth {
                None => in_camera(
                    self.kernel2,
                    &p_cam,
                    &seen.residual2(k, &p_cam),
                    &seen.point_jacobian2(k, &p_cam),
                ),
                Some(depth) => in_camera(
                    self.kernel3,
                    &p_cam,
                    &seen.residual3(k, depth, &p_cam),
                    &seen.point_jacobian3(k, depth, &p_cam),
                ),
            };
            system.cost += 0.5 * rho;
            system.push(o.point, rotation, &parts);
        }
        system.finish();
        system
    }

    fn step(&self, state: &Bundle, step: &BundleStep) -> Bundle {
        let mut moved = state.clone();
        for (free, &k) in self.free.iter().enumerate() {
            let xi = &step.poses[self.structure.pattern.step(free)];
            moved.poses[k] = Se3::exp(xi) * state.poses[k];
        }
        for (point, h) in moved.points.iter_mut().zip(&step.points) {
            *point += h;
        }
        moved
    }
}

/// ρ of a residual, and what it adds to the normal equations (see [`crate::schur`]).
#[inline]
fn in_camera<const M: usize>(
    kernel: RobustKernel,
    p_cam: &Vector3<f64>,
    residual: &SVector<f64, M>,
    jacobian: &SMatrix<f64, M, 3>,
) -> (f64, InCamera) {
    let chi2 = residual.norm_squared();
    let weighted = jacobian.transpose() * kernel.weight(chi2);
    let parts = InCamera {
        point: *p_cam,
        hessian: weighted * jacobian,
        gradient: weighted * residual,
    };
    (kernel.rho(chi2), parts)
}

fn validate(
    bf: f64,
    poses: &[Se3],
    fixed: &[bool],
    points: &[Vector3<f64>],
    observations: &[BundleObservation],
    config: &BundleConfig,
) -> Result<(), OptimError> {
    if fixed.len() != poses.len() {
        return Err(OptimError::SizeMismatch {
            what: "fixed",
            got: fixed.len(),
            expected: poses.len(),
        });
    }
    for (what, value) in [
        ("bf", bf),
        ("chi2_2d", config.chi2_2d),
        ("chi2_3d", config.chi2_3d),
    ] {
        positive(what, 0, value)?;
    }
    if let Some(index) = poses.iter().position(|p| !p.is_finite()) {
        return Err(OptimError::NotFinite {
            what: "pose",
            index,
        });
    }
    if let Some(index) = points.iter().position(|p| !p.iter().all(|v| v.is_finite())) {
        return Err(OptimError::NotFinite {
            what: "point",
            index,
        });
    }
    for (index, o) in observations.iter().enumerate() {
        for (what, target, count) in [
            ("pose", o.pose, poses.len()),
            ("point", o.point, points.len()),
        ] {
            if target >= count {
                return Err(OptimError::OutOfRange {
                    what,
                    index,
                    target,
                    count,
                });
            }
        }
        o.reprojection().validate(index)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests;
