//! [`View`]: camera and pose, rounded to the type the image is computed in.

use garad_core::{Camera, Real, Se3};

/// How far outside the image the projection is still linearised faithfully, as a multiple of
/// half the field of view. Beyond it x/z is clamped inside the Jacobian (R3): a Gaussian far to
/// the side would otherwise be smeared across the image. Source: 3D Gaussian Splatting.
pub const JACOBIAN_CLAMP: f64 = 1.3;

/// Everything about the camera that a Gaussian's projection reads.
#[derive(Debug, Clone, Copy)]
pub(crate) struct View<T> {
    /// R of `camera_from_world`, row by row.
    pub(crate) rotation: [[T; 3]; 3],
    /// t of `camera_from_world`, metres.
    pub(crate) translation: [T; 3],
    /// The camera's centre in the world, -Rᵀ t, metres.
    pub(crate) center: [T; 3],
    /// (fx, fy), pixels.
    pub(crate) focal_px: [T; 2],
    /// (cx, cy), pixels.
    pub(crate) principal_px: [T; 2],
    /// Largest |x/z| and |y/z| that the Jacobian sees: 1.3 W/(2 fx), 1.3 H/(2 fy). The interval
    /// is symmetric about the optical axis even when the principal point is off the middle, as
    /// in the CUDA rasterizer.
    pub(crate) slope_limit: [T; 2],
    /// Columns and rows of the image.
    pub(crate) size: [usize; 2],
}

impl<T: Real> View<T> {
    /// Rounds every number of camera and pose once.
    pub(crate) fn new(camera: &Camera, camera_from_world: &Se3) -> Self {
        let c = T::from_f64;
        let r = camera_from_world.rotation.matrix();
        let t = camera_from_world.translation;
        let center = camera_from_world.inverse().translation;
        let half_fov = |pixels: usize, focal: f64| pixels as f64 / (2.0 * focal);
        Self {
            rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|j| c(r[(i, j)]))),
            translation: [c(t.x), c(t.y), c(t.z)],
            center: [c(center.x), c(center.y), c(center.z)],
            focal_px: [c(camera.fx), c(camera.fy)],
            principal_px: [c(camera.cx), c(camera.cy)],
            slope_limit: [
                c(JACOBIAN_CLAMP * half_fov(camera.width, camera.fx)),
                c(JACOBIAN_CLAMP * half_fov(camera.height, camera.fy)),
            ],
            size: [camera.width, camera.height],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::So3;
    use nalgebra::Vector3;

    #[test]
    fn centre_and_limits() {
        let camera = Camera::pinhole((8, 4), [4.0, 4.0, 1.0, 1.5]).expect("valid");
        let quarter = So3::exp(&(Vector3::z() * std::f64::consts::FRAC_PI_2));
        let pose = Se3::new(quarter, Vector3::new(1.0, 2.0, 3.0));
        let view = View::<f64>::new(&camera, &pose);
        // R c + t = 0: R takes (x, y) to (-y, x), so c = (-2, 1, -3).
        for (got, want) in view.center.iter().zip([-2.0, 1.0, -3.0]) {
            assert!((got - want).abs() < 1e-15, "centre {:?}", view.center);
        }
        // 1.3 * 8 / (2 * 4) and 1.3 * 4 / (2 * 4), whatever cx is.
        assert!((view.slope_limit[0] - 1.3).abs() < 1e-15, "x");
        assert!((view.slope_limit[1] - 0.65).abs() < 1e-15, "y");
    }
}
