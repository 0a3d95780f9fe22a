//! The residual of one point seen by one camera, with the closed-form derivatives of eq. 11.
//!
//! r = (û - u, v̂ - v) / σ, and with a depth reading also (û_R - u_R) / σ_R, where
//!
//! û = fx x/z + cx,   v̂ = fy y/z + cy,   û_R = û - bf/z,   (x, y, z) = R p + t           (E12)
//!
//! u_R is where a virtual second camera, a baseline b to the right, would see the point: a depth
//! reading d becomes u - bf/d, which is as uncertain in pixels as triangulation would be. Giving
//! it its own σ lets the caller say how good the depth sensor really is.

use garad_core::Camera;
use nalgebra::{SMatrix, SVector, Vector2, Vector3};

use crate::error::{OptimError, positive};

/// The virtual right coordinate of an observation with depth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RightObservation {
    /// u - bf/d, pixels.
    pub u_px: f64,
    /// Its standard deviation, pixels.
    pub sigma_px: f64,
}

impl RightObservation {
    /// From a depth reading: u_R = u - bf/d. A depth error σ_d moves u_R by bf σ_d/d² on top of
    /// the error of u itself.
    #[must_use]
    pub fn from_depth(u_px: f64, sigma_px: f64, depth_m: f64, depth_sigma_m: f64, bf: f64) -> Self {
        let from_depth = bf * depth_sigma_m / (depth_m * depth_m);
        Self {
            u_px: u_px - bf / depth_m,
            sigma_px: libm::hypot(sigma_px, from_depth),
        }
    }
}

/// What was measured of one point; shared by pose-only optimisation and bundle adjustment.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reprojection {
    pub(crate) uv_px: Vector2<f64>,
    pub(crate) sigma_px: f64,
    pub(crate) right: Option<RightObservation>,
}

/// The pinhole part of a camera, and bf = fx times baseline, px·m.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Intrinsics {
    pub(crate) fx: f64,
    pub(crate) fy: f64,
    pub(crate) cx: f64,
    pub(crate) cy: f64,
    pub(crate) bf: f64,
}

/// Nearer points count as behind the camera, metres. No depth camera sees anything there, and a
/// point in the lens would fit any pixel by moving the camera a hair's breadth.
pub(crate) const MIN_DEPTH_M: f64 = 0.05;

impl Intrinsics {
    pub(crate) fn new(camera: &Camera, bf: f64) -> Self {
        let Camera { fx, fy, cx, cy, .. } = *camera;
        Self { fx, fy, cx, cy, bf }
    }
}

impl Reprojection {
    /// Finite coordinates, positive standard deviations.
    pub(crate) fn validate(&self, index: usize) -> Result<(), OptimError> {
        let right = self.right.map_or(0.0, |r| r.u_px);
        if !(self.uv_px.x.is_finite() && self.uv_px.y.is_finite() && right.is_finite()) {
            return Err(OptimError::NotFinite {
                what: "observation",
                index,
            });
        }
        positive("sigma_px of observation", index, self.sigma_px)?;
        self.right.map_or(Ok(()), |right| {
            positive("right sigma_px of observation", index, right.sigma_px)
        })
    }

    /// (û - u, v̂ - v) / σ of a point in front of the camera.
    #[inline]
    pub(crate) fn residual2(&self, k: &Intrinsics, p_cam: &Vector3<f64>) -> SVector<f64, 2> {
        let (inv_z, inv_sigma) = (1.0 / p_cam.z, 1.0 / self.sigma_px);
        SVector::from([
            (k.fx * p_cam.x * inv_z + k.cx - self.uv_px.x) * inv_sigma,
            (k.fy * p_cam.y * inv_z + k.cy - self.uv_px.y) * inv_sigma,
        ])
    }

    /// The same with (û_R - u_R) / σ_R below it.
    #[inline]
    pub(crate) fn residual3(
        &self,
        k: &Intrinsics,
        right: &RightObservation,
        p_cam: &Vector3<f64>,
    ) -> SVector<f64, 3> {
        let two = self.residual2(k, p_cam);
        let u_right = (k.fx * p_cam.x - k.bf) / p_cam.z + k.cx;
        SVector::from([two[0], two[1], (u_right - right.u_px) / right.sigma_px])
    }

    /// ‖r‖², infinite behind the camera and where numbers overflow.
    #[inline]
    pub(crate) fn chi2(&self, k: &Intrinsics, p_cam: &Vector3<f64>) -> f64 {
        if p_cam.z < MIN_DEPTH_M {
            return f64::INFINITY;
        }
        let chi2 = match &self.right {
            None => self.residual2(k, p_cam).norm_squared(),
            Some(right) => self.residual3(k, right, p_cam).norm_squared(),
        };
        if chi2.is_finite() {
            chi2
        } else {
            f64::INFINITY
        }
    }

    /// ∂(residual)/∂(x, y, z), the first two rows.
    #[inline]
    #[rustfmt::skip]
    pub(crate) fn point_jacobian2(&self, k: &Intrinsics, p_cam: &Vector3<f64>) -> SMatrix<f64, 2, 3> {
        let inv_z = 1.0 / p_cam.z;
        let (x, y) = (p_cam.x * inv_z, p_cam.y * inv_z);
        let fx = k.fx * inv_z / self.sigma_px;
        let fy = k.fy * inv_z / self.sigma_px;
        SMatrix::from_row_slice(&[
            fx,  0.0, -fx * x,
            0.0, fy,  -fy * y,
        ])
    }

    /// All three rows; the third is that of û with -bf/z added: ∂(-bf/z)/∂z = bf/z².
    #[inline]
    #[rustfmt::skip]
    pub(crate) fn point_jacobian3(
        &self,
        k: &Intrinsics,
        right: &RightObservation,
        p_cam: &Vector3<f64>,
    ) -> SMatrix<f64, 3, 3> {
        let two = self.point_jacobian2(k, p_cam);
        let inv_z = 1.0 / p_cam.z;
        let fx = k.fx * inv_z / right.sigma_px;
        let bf = k.bf * inv_z * inv_z / right.sigma_px;
        SMatrix::from_row_slice(&[
            two[(0, 0)], 0.0,         two[(0, 2)],
            0.0,         two[(1, 1)], two[(1, 2)],
            fx,          0.0,         bf - fx * p_cam.x * inv_z,
        ])
    }
}

/// ∂(p_cam)/∂ξ = [I, -p_cam^] for exp(ξ) * camera_from_world, applied to a point Jacobian: each
/// row g becomes (g, p_cam × g).
#[inline]
pub(crate) fn pose_jacobian<const M: usize>(
    point_jacobian: &SMatrix<f64, M, 3>,
    p_cam: &Vector3<f64>,
) -> SMatrix<f64, M, 6> {
    let mut j = SMatrix::zeros();
    for m in 0..M {
        let (gx, gy, gz) = (
            point_jacobian[(m, 0)],
            point_jacobian[(m, 1)],
            point_jacobian[(m, 2)],
        );
        j[(m, 0)] = gx;
        j[(m, 1)] = gy;
        j[(m, 2)] = gz;
        j[(m, 3)] = p_cam.y * gz - p_cam.z * gy;
        j[(m, 4)] = p_cam.z * gx - p_cam.x * gz;
        j[(m, 5)] = p_cam.x * gy - p_cam.y * gx;
    }
    j
}
