//! Least squares for SLAM: robust kernels, Levenberg-Marquardt, the pose of a camera, bundles.
//!
//! Reading order: [`robust`] (kernels) → [`lm`] (the loop) → [`dense`] (problems
//! of few unknowns, as visitors of residual blocks) and [`solve`] (their linear systems) →
//! [`reprojection`] (the residual of eq. 11) → [`pose`] (eq. 11: one camera), [`pnp`] (without an initial
//! pose) → [`bundle`] (cameras and points, through a Schur complement) → [`pose_graph`] (poses alone, around a
//! loop). [`adam`] is gradient descent. [`check`] compares any Jacobian with finite differences.
//!
//! # Example
//! A camera 10 cm beside its initial pose, and four points:
//! ```
//! use garad_core::{Camera, Se3, So3};
//! use garad_optim::{PoseConfig, PoseObservation, optimise_pose};
//! use nalgebra::Vector3;
//!
//! let camera = Camera::pinhole((640, 480), [500.0, 500.0, 320.0, 240.0]).unwrap();
//! let truth = Se3::new(So3::identity(), Vector3::new(0.1, 0.0, 0.0));
//! let points = [(-1.0, -1.0, 4.0), (1.0, -1.0, 5.0), (1.0, 1.0, 6.0), (-1.0, 0.5, 3.0)];
//! let observations = points.map(|(x, y, z)| {
//!     let p_world = Vector3::new(x, y, z);
//!     let uv_px = camera.project(&(truth * p_world)).unwrap();
//!     PoseObservation { p_world, uv_px, sigma_px: 1.0, depth: None }
//! });
//! let solution =
//!     optimise_pose(&camera, &observations, &Se3::identity(), &PoseConfig::default()).unwrap();
//! let error = solution.camera_from_world * truth.inverse();
//! assert!(error.log().norm() < 1e-6 && solution.n_inliers == 4);
//! ```

pub mod adam;
pub mod blocks;
pub mod bundle;
pub mod check;
pub mod dense;
pub mod error;
pub mod lm;
pub mod pnp;
pub mod pose;
pub mod pose_graph;
pub mod reprojection;
pub mod robust;
mod schur;
pub mod shutter;
pub mod solve;
#[cfg(test)]
mod testing;
pub mod triangulation;

pub use adam::{Adam, AdamConfig, sgd};
pub use blocks::LinearSolver;
pub use bundle::{BundleConfig, BundleObservation, BundleReport, optimise_bundle};
pub use check::check_jacobian;
pub use error::OptimError;
pub use lm::{LmConfig, Report, StopReason};
pub use pnp::{PnpConfig, PnpResult, p3p, solve_pnp_ransac};
pub use pose::{
    CentrePrior, DepthObservation, PoseConfig, PoseObservation, PoseSolution, optimise_pose,
};
pub use pose_graph::{PoseEdge, PoseGraph, PoseGraphConfig, PoseGraphReport};
pub use robust::RobustKernel;
pub use shutter::{PoseAndTurn, TurnConfig, optimise_pose_and_turn};
pub use solve::{NotPositiveDefinite, ldlt_inverse, ldlt_solve};
pub use triangulation::{PointView, TriangulatedPoint, triangulate};
