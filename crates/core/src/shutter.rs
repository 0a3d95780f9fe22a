//! [`RollingShutter`]: the turn of a camera while it reads one image out.
//!
//! Most colour cameras of RGB-D sensors read their rows one after the other, over nearly the whole
//! time between two images. A hand that trembles turns such a camera by several milliradians from the
//! first row to the last, two or three pixels. To a model with one pose per image that is a step to
//! the side of many millimetres, another one in every image.
//!
//! The turn is taken as uniform. Row y of an image of h rows is seen from the pose
//!
//! T(y) = exp(s(y) ω) T,   s(y) = (y - (h-1)/2) / h ∈ (-½, ½)                             (E22)
//!
//! where T is the pose at the middle row and ω the turn over all rows. How long that takes is not
//! needed. The camera's step in that time is not modelled: a hand moves much less than it turns.

use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::camera::Camera;
use crate::so3::So3;

/// The turn of a camera while it reads one image out.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RollingShutter {
    /// ω: from the first row to the last, radians, in camera coordinates.
    pub turn_rad: Vector3<f64>,
}

impl RollingShutter {
    /// All rows at once.
    #[must_use]
    pub fn global() -> Self {
        Self {
            turn_rad: Vector3::zeros(),
        }
    }

    /// s(y): when a row is read, from the middle of the image, in read-out times.
    #[must_use]
    pub fn row_time(row_px: f64, height: usize) -> f64 {
        let h = height as f64;
        (row_px - 0.5 * (h - 1.0)) / h
    }

    /// exp(s ω): from the pose at the middle row to that of a row.
    #[must_use]
    pub fn row_from_middle(&self, row_time: f64) -> So3 {
        So3::exp(&(row_time * self.turn_rad))
    }

    /// The ideal pixel at which the direction seen at a recorded (distorted) pixel would lie if all
    /// rows were read with the middle one. `None` where the distortion has no inverse.
    #[must_use]
    pub fn ideal_pixel(&self, camera: &Camera, recorded_px: &Vector2<f64>) -> Option<Vector2<f64>> {
        let uv_px = camera.undistort_pixel(recorded_px)?;
        if self.turn_rad == Vector3::zeros() {
            return Some(uv_px);
        }
        let row_time = Self::row_time(recorded_px.y, camera.height);
        let turn = self.row_from_middle(row_time).inverse();
        camera.project(&(turn.matrix() * camera.unproject(&uv_px, 1.0)))
    }

    /// The recorded (distorted) pixel of an ideal one: the inverse of [`RollingShutter::ideal_pixel`].
    /// The row decides when the point is seen, and that where: five rounds leave nothing of it.
    #[must_use]
    pub fn recorded_pixel(&self, camera: &Camera, uv_px: &Vector2<f64>) -> Vector2<f64> {
        let mut recorded = camera.distort_pixel(uv_px);
        if self.turn_rad == Vector3::zeros() {
            return recorded;
        }
        let ray = camera.unproject(uv_px, 1.0);
        for _ in 0..5 {
            let row_time = Self::row_time(recorded.y, camera.height);
            let turned = self.row_from_middle(row_time).matrix() * ray;
            let Some(uv_px) = camera.project(&turned) else {
                return recorded;
            };
            recorded = camera.distort_pixel(&uv_px);
        }
        recorded
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera::pinhole((640, 480), [500.0, 500.0, 319.5, 239.5]).expect("valid")
    }

    /// 4 mrad about x over 480 rows: the last row is seen 2 mrad later, 1 px further up or down.
    #[test]
    fn a_nod_moves_the_last_row_by_half_of_it() {
        let nod = RollingShutter {
            turn_rad: Vector3::new(0.004, 0.0, 0.0),
        };
        let bottom = nod.ideal_pixel(&camera(), &Vector2::new(319.5, 479.0));
        let bottom = bottom.expect("no distortion");
        // s = 239.5/480; the ray at tan a = 239.5/500 turned back by s ω.
        let angle = libm::atan(239.5 / 500.0) + 0.004 * 239.5 / 480.0;
        let expected = 239.5 + 500.0 * libm::tan(angle);
        assert!((bottom.y - expected).abs() < 1e-9, "{bottom} {expected}");
        let middle = nod.ideal_pixel(&camera(), &Vector2::new(100.0, 239.5));
        let moved = (middle.expect("no distortion") - Vector2::new(100.0, 239.5)).norm();
        assert!(moved < 1e-9, "the middle row stays");
    }

    #[test]
    fn recorded_pixels_come_back() {
        let turn = RollingShutter {
            turn_rad: Vector3::new(0.01, -0.02, 0.015),
        };
        for px in [[3.0, 2.0], [600.0, 470.0], [320.0, 100.0]] {
            let px = Vector2::from(px);
            let ideal = turn.ideal_pixel(&camera(), &px).expect("no distortion");
            let back = turn.recorded_pixel(&camera(), &ideal);
            assert!((back - px).norm() < 1e-5, "{px} became {back}");
            assert!((ideal - px).norm() > 0.1, "it moved");
        }
    }

    /// The row that counts is the recorded one, not where it lies without distortion: 470 of 480 rows, with a lens that
    /// moves it by several pixels.
    #[test]
    fn the_recorded_row_tells_the_time() {
        let mut camera = Camera::pinhole((640, 480), [520.0, 470.0, 310.0, 250.0]).expect("valid");
        camera.distortion.k1 = 0.2;
        let turn = RollingShutter {
            turn_rad: Vector3::new(0.03, -0.05, 0.02),
        };
        let px = Vector2::new(600.0, 470.0);
        let straight = camera.undistort_pixel(&px).expect("invertible");
        assert!((straight.y - px.y).abs() > 5.0, "{straight}");
        let row_time = (470.0 - 239.5) / 480.0;
        assert!(
            (RollingShutter::row_time(470.0, 480) - row_time).abs() < 1e-15,
            "s"
        );
        let back = So3::exp(&(turn.turn_rad * -row_time)).matrix();
        let ray = Vector3::new(
            (straight.x - 310.0) / 520.0,
            (straight.y - 250.0) / 470.0,
            1.0,
        );
        let p = back * ray;
        let expected = Vector2::new(520.0 * p.x / p.z + 310.0, 470.0 * p.y / p.z + 250.0);
        let found = turn.ideal_pixel(&camera, &px).expect("in front");
        assert!((found - expected).norm() < 1e-9, "{found} {expected}");
        let again = turn.recorded_pixel(&camera, &found);
        assert!((again - px).norm() < 1e-4, "{again}");
    }
}
