//! The residual of one point seen by one camera, with the closed-form derivatives of eq. 11.
//!
//! r = (û - u, v̂ - v) / σ,   û = fx x/z + cx,   v̂ = fy y/z + cy,   (x, y, z) = R p + t
//!
//! A depth reading d adds a third residual, in one of two forms (decision 004):
//!
//! right      (û - bf/z - u_R) / σ_R,   u_R = u - bf/d
//! disparity  (bf/d - bf/z) / σ_δ                                                        (E12)
//!
//! The first is the column of the point in a virtual second camera, a baseline b to the right:
//! ORB-SLAM's. It contains the error of u, so σ_R is at least σ, and a good depth sensor has little
//! weight. The second is the first minus the residual of u: the sensor's measurement alone, with its own σ.

use garad_core::Camera;
use nalgebra::{SMatrix, SVector, Vector2, Vector3};

use crate::error::{OptimError, positive};

/// A depth reading as an observation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DepthObservation {
    /// ORB-SLAM's virtual right coordinate.
    Right {
        /// u - bf/d, pixels.
        u_px: f64,
        /// Its standard deviation, that of u included, pixels.
        sigma_px: f64,
    },
    /// The reading alone.
    Disparity {
        /// bf/d, pixels.
        disparity_px: f64,
        /// Its standard deviation, pixels.
        sigma_px: f64,
    },
}

impl DepthObservation {
    /// [`DepthObservation::Right`] from a depth reading. A depth error σ_d moves u_R by bf σ_d/d² on
    /// top of the error of u itself.
    #[must_use]
    pub fn right_from_depth(
        u_px: f64,
        sigma_px: f64,
        depth_m: f64,
        depth_sigma_m: f64,
        bf: f64,
    ) -> Self {
        let from_depth = bf * depth_sigma_m / (depth_m * depth_m);
        Self::Right {
            u_px: u_px - bf / depth_m,
            sigma_px: libm::hypot(sigma_px, from_depth),
        }
    }

    /// [`DepthObservation::Disparity`] from a depth reading: σ_δ = bf σ_d/d².
    #[must_use]
    pub fn disparity_from_depth(depth_m: f64, depth_sigma_m: f64, bf: f64) -> Self {
        Self::Disparity {
            disparity_px: bf / depth_m,
            sigma_px: bf * depth_sigma_m / (depth_m * depth_m),
        }
    }

    /// Both forms as (c û - bf/z - m) / σ: (c, m, σ).
    #[inline]
    fn parts(&self) -> (f64, f64, f64) {
        match *self {
            Self::Right { u_px, sigma_px } => (1.0, u_px, sigma_px),
            Self::Disparity {
                disparity_px,
                sigma_px,
            } => (0.0, -disparity_px, sigma_px),
        }
    }
}

/// The measurement of one point; shared by pose-only optimisation and bundle adjustment.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Reprojection {
    pub(crate) uv_px: Vector2<f64>,
    pub(crate) sigma_px: f64,
    pub(crate) depth: Option<DepthObservation>,
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

/// Nearer points count as behind the camera, metres. No depth camera measures there, and a
/// point at the lens would fit any pixel after a tiny motion of the camera.
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
        let depth = self.depth.map_or(0.0, |depth| depth.parts().1);
        if !(self.uv_px.x.is_finite() && self.uv_px.y.is_finite() && depth.is_finite()) {
            return Err(OptimError::NotFinite {
                what: "observation",
                index,
            });
        }
        positive("sigma_px of observation", index, self.sigma_px)?;
        self.depth.map_or(Ok(()), |depth| {
            positive("depth sigma_px of observation", index, depth.parts().2)
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

    /// The same with the residual of the depth reading below it.
    #[inline]
    pub(crate) fn residual3(
        &self,
        k: &Intrinsics,
        depth: &DepthObservation,
        p_cam: &Vector3<f64>,
    ) -> SVector<f64, 3> {
        let two = self.residual2(k, p_cam);
        let (c, m, sigma) = depth.parts();
        let u_right = (c * k.fx * p_cam.x - k.bf) / p_cam.z + c * k.cx;
        SVector::from([two[0], two[1], (u_right - m) / sigma])
    }

    /// ‖r‖², infinite behind the camera and where numbers overflow.
    #[inline]
    pub(crate) fn chi2(&self, k: &Intrinsics, p_cam: &Vector3<f64>) -> f64 {
        if p_cam.z < MIN_DEPTH_M {
            return f64::INFINITY;
        }
        let chi2 = match &self.depth {
            None => self.residual2(k, p_cam).norm_squared(),
            Some(depth) => self.residual3(k, depth, p_cam).norm_squared(),
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

    /// All three rows; the third is that of c û - bf/z: ∂(-bf/z)/∂z = bf/z².
    #[inline]
    #[rustfmt::skip]
    pub(crate) fn point_jacobian3(
        &self,
        k: &Intrinsics,
        depth: &DepthObservation,
        p_cam: &Vector3<f64>,
    ) -> SMatrix<f64, 3, 3> {
        let two = self.point_jacobian2(k, p_cam);
        let inv_z = 1.0 / p_cam.z;
        let (c, _, sigma) = depth.parts();
        let fx = c * k.fx * inv_z / sigma;
        let bf = k.bf * inv_z * inv_z / sigma;
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
