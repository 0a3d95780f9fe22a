//! [`optimise_pose_and_turn`]: the pose of a camera with a rolling shutter, from static matches.
//!
//! Eq. 11 with three more unknowns, the turn ω of the camera while it read the image out
//! ([`RollingShutter`], E22): point i, seen in row yᵢ, has the camera coordinates
//! exp(s(yᵢ) ω) (R Pᵢ + t). The residuals are those of [`crate::reprojection`].

use garad_core::so3::hat;
use garad_core::{Camera, RollingShutter, Se3, So3};
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use crate::dense::{Dense, Problem, Visitor};
use crate::lm::{LmConfig, minimise};
use crate::pose::PoseObservation;
use crate::reprojection::{Intrinsics, MIN_DEPTH_M, pose_jacobian};
use crate::robust::RobustKernel;

/// How a pose and a turn are optimised.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TurnConfig {
    /// fx times the baseline of the virtual stereo pair, px·m.
    pub bf: f64,
    /// Trials of Levenberg-Marquardt.
    pub iterations: usize,
    /// δ of the Huber kernels of observations without and with depth.
    pub huber: [f64; 2],
    /// The turn expected before anything is seen, radians, ...
    pub expected_rad: Vector3<f64>,
    /// ... and its standard deviation per axis.
    pub sigma_rad: f64,
}

/// The unknowns of [`TurnProblem`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseAndTurn {
    /// The pose at the middle row.
    pub camera_from_world: Se3,
    /// The turn over all rows.
    pub shutter: RollingShutter,
}

/// Eq. 11 and the turn's prior: F = ½ Σᵢ ρ(‖rᵢ‖²) + ½ ‖ω - ω₀‖² / σ².
#[derive(Debug)]
pub struct TurnProblem<'a> {
    intrinsics: Intrinsics,
    config: &'a TurnConfig,
    /// Each with the time of its row, s(y).
    observations: &'a [(PoseObservation, f64)],
}

impl<'a> TurnProblem<'a> {
    /// The problem of these observations: at ideal pixels as recorded, that is, undistorted but not
    /// yet brought to the middle row, each with the [`RollingShutter::row_time`] of its row.
    #[must_use]
    pub fn new(
        camera: &Camera,
        observations: &'a [(PoseObservation, f64)],
        config: &'a TurnConfig,
    ) -> Self {
        Self {
            intrinsics: Intrinsics::new(camera, config.bf),
            config,
            observations,
        }
    }
}

/// (∂r/∂ξ, ∂r/∂ω) of one point from ∂r/∂p at p = A q, A = exp(s ω), q = R P + t:
/// ∂p/∂ξ = A (I, -q^), ∂p/∂ω = -p^ s J(s ω), J the left Jacobian of SO(3).
fn jacobian<const M: usize>(
    by_point: &SMatrix<f64, M, 3>,
    middle: &Vector3<f64>,
    turned: &Vector3<f64>,
    turn: &Matrix3<f64>,
    (row_time, turn_rad): (f64, &Vector3<f64>),
) -> SMatrix<f64, M, 9> {
    let mut all = SMatrix::<f64, M, 9>::zeros();
    all.fixed_view_mut::<M, 6>(0, 0)
        .copy_from(&pose_jacobian(&(by_point * turn), middle));
    let by_turn = -hat(turned) * So3::left_jacobian(&(row_time * turn_rad)) * row_time;
    all.fixed_view_mut::<M, 3>(0, 6)
        .copy_from(&(by_point * by_turn));
    all
}

impl Problem<9> for TurnProblem<'_> {
    type State = PoseAndTurn;

    fn blocks(&self, state: &PoseAndTurn, visitor: &mut impl Visitor<9>) {
        let k = &self.intrinsics;
        let [kernel2, kernel3] = self.config.huber.map(|delta| RobustKernel::Huber { delta });
        let rotation = state.camera_from_world.rotation.matrix();
        let turn_rad = &state.shutter.turn_rad;
        for (observation, row_time) in self.observations {
            let middle = rotation * observation.p_world + state.camera_from_world.translation;
            let turn = state.shutter.row_from_middle(*row_time).matrix();
            let p = turn * middle;
            if p.z < MIN_DEPTH_M {
                visitor.forbid();
                return;
            }
            let seen = observation.reprojection();
            let row = (*row_time, turn_rad);
            match &seen.depth {
                None => visitor.block(kernel2, &seen.residual2(k, &p), || {
                    jacobian(&seen.point_jacobian2(k, &p), &middle, &p, &turn, row)
                }),
                Some(depth) => visitor.block(kernel3, &seen.residual3(k, depth, &p), || {
                    jacobian(&seen.point_jacobian3(k, depth, &p), &middle, &p, &turn, row)
                }),
            }
        }
        let inv_sigma = 1.0 / self.config.sigma_rad;
        visitor.block(
            RobustKernel::None,
            &((turn_rad - self.config.expected_rad) * inv_sigma),
            || {
                let mut by_turn = SMatrix::<f64, 3, 9>::zeros();
                by_turn
                    .fixed_view_mut::<3, 3>(0, 6)
                    .fill_diagonal(inv_sigma);
                by_turn
            },
        );
    }

    fn step(&self, state: &PoseAndTurn, step: &SVector<f64, 9>) -> PoseAndTurn {
        PoseAndTurn {
            camera_from_world: Se3::exp(&step.fixed_rows::<6>(0).into()) * state.camera_from_world,
            shutter: RollingShutter {
                turn_rad: state.shutter.turn_rad + step.fixed_rows::<3>(6),
            },
        }
    }
}

/// The minimum of [`TurnProblem`] next to a state. A point behind the camera, or a number that is not
/// finite, leaves the state as it was.
///
/// # Numerics
/// f64, normal equations summed in the order of the observations: the same bits on every machine.
#[must_use]
pub fn optimise_pose_and_turn(
    camera: &Camera,
    observations: &[(PoseObservation, f64)],
    initial: &PoseAndTurn,
    config: &TurnConfig,
) -> PoseAndTurn {
    let problem = TurnProblem::new(camera, observations, config);
    let lm = LmConfig {
        iterations: config.iterations,
        cost_tolerance: 1e-6,
        ..LmConfig::default()
    };
    minimise(&Dense(&problem), *initial, &lm).0
}
