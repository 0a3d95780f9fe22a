//! [`Camera`]: pinhole projection with Brown-Conrady distortion and its inverse.
//!
//! x right, y down, z forward; pixel centres at integer coordinates. Two kinds of pixel
//! coordinates exist: *distorted* ones are where the sensor sees a point, *ideal* ones where a
//! pinhole would. Keypoints are found in distorted pixels and brought to ideal ones once; from
//! there on everything is pinhole.

use nalgebra::{Matrix2, Matrix2x3, Vector2, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Brown-Conrady coefficients in OpenCV's order (k1, k2, p1, p2, k3).
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Distortion {
    /// Radial, r².
    pub k1: f64,
    /// Radial, r⁴.
    pub k2: f64,
    /// Tangential.
    pub p1: f64,
    /// Tangential.
    pub p2: f64,
    /// Radial, r⁶.
    pub k3: f64,
}

/// A calibrated camera.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Columns of the image.
    pub width: usize,
    /// Rows of the image.
    pub height: usize,
    /// Focal length, pixels.
    pub fx: f64,
    /// Focal length, pixels.
    pub fy: f64,
    /// Principal point, pixels; the centre of the first pixel is 0.
    pub cx: f64,
    /// Principal point, pixels.
    pub cy: f64,
    /// Lens distortion; all zero for none.
    pub distortion: Distortion,
}

/// What is wrong with a calibration.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum CameraError {
    /// NaN or infinite.
    #[error("camera {field} is {value}; expected a finite number")]
    NotFinite {
        /// Which number.
        field: &'static str,
        /// Its value.
        value: f64,
    },
    /// A focal length or size that is not positive.
    #[error("camera {field} is {value}; expected a positive number")]
    NotPositive {
        /// Which number.
        field: &'static str,
        /// Its value.
        value: f64,
    },
    /// A width or height beyond [`MAX_SIDE_PX`].
    #[error("camera {field} is {value}; expected at most {MAX_SIDE_PX} pixels")]
    TooLarge {
        /// Which number.
        field: &'static str,
        /// Its value.
        value: usize,
    },
}

/// Largest width and height of an image, pixels: cameras of phones have up to 8064 columns.
pub const MAX_SIDE_PX: u32 = 8192;

impl Camera {
    /// A pinhole camera without distortion.
    ///
    /// # Errors
    /// [`CameraError`] for a focal length that is not positive, a size of 0, or a number that is
    /// not finite.
    pub fn pinhole(
        (width, height): (usize, usize),
        [fx, fy, cx, cy]: [f64; 4],
    ) -> Result<Self, CameraError> {
        let camera = Self {
            width,
            height,
            fx,
            fy,
            cx,
            cy,
            distortion: Distortion::default(),
        };
        camera.validate()?;
        Ok(camera)
    }

    /// Checks every number once, where a calibration enters.
    ///
    /// # Errors
    /// [`CameraError`] with the first invalid number.
    pub fn validate(&self) -> Result<(), CameraError> {
        let d = &self.distortion;
        let fields = [
            ("fx", self.fx),
            ("fy", self.fy),
            ("cx", self.cx),
            ("cy", self.cy),
            ("k1", d.k1),
            ("k2", d.k2),
            ("p1", d.p1),
            ("p2", d.p2),
            ("k3", d.k3),
        ];
        for (field, value) in fields {
            if !value.is_finite() {
                return Err(CameraError::NotFinite { field, value });
            }
        }
        let positive = [
            ("fx", self.fx),
            ("fy", self.fy),
            ("width", self.width as f64),
            ("height", self.height as f64),
        ];
        for (field, value) in positive {
            if value <= 0.0 {
                return Err(CameraError::NotPositive { field, value });
            }
        }
        for (field, value) in [("width", self.width), ("height", self.height)] {
            if value > MAX_SIDE_PX as usize {
                return Err(CameraError::TooLarge { field, value });
            }
        }
        Ok(())
    }

    /// The same camera for an image `level` times halved by decimation at even pixels:
    /// f / 2ˡ, c / 2ˡ, sizes rounded up. Distortion coefficients act on normalised coordinates
    /// and stay.
    #[must_use]
    pub fn level(&self, level: usize) -> Self {
        let mut camera = *self;
        for _ in 0..level {
            camera.width = camera.width.div_ceil(2);
            camera.height = camera.height.div_ceil(2);
            camera.fx *= 0.5;
            camera.fy *= 0.5;
            camera.cx *= 0.5;
            camera.cy *= 0.5;
        }
        camera
    }

    /// Ideal pixel of a point: (fx x/z + cx, fy y/z + cy); `None` unless z > 0.
    #[inline]
    #[must_use]
    pub fn project(&self, p_cam: &Vector3<f64>) -> Option<Vector2<f64>> {
        (p_cam.z > 0.0).then(|| {
            let inv_z = 1.0 / p_cam.z;
            Vector2::new(
                self.fx * p_cam.x * inv_z + self.cx,
                self.fy * p_cam.y * inv_z + self.cy,
            )
        })
    }

    /// ∂(u, v)/∂(x, y, z) of [`Camera::project`], pixels per metre.
    #[must_use]
    #[rustfmt::skip]
    pub fn project_jacobian(&self, p_cam: &Vector3<f64>) -> Matrix2x3<f64> {
        let inv_z = 1.0 / p_cam.z;
        let inv_z2 = inv_z * inv_z;
        Matrix2x3::new(
            self.fx * inv_z, 0.0,             -self.fx * p_cam.x * inv_z2,
            0.0,             self.fy * inv_z, -self.fy * p_cam.y * inv_z2,
        )
    }

    /// The point at `depth_m` along z that an ideal pixel sees.
    #[inline]
    #[must_use]
    pub fn unproject(&self, uv_px: &Vector2<f64>, depth_m: f64) -> Vector3<f64> {
        Vector3::new(
            (uv_px.x - self.cx) / self.fx * depth_m,
            (uv_px.y - self.cy) / self.fy * depth_m,
            depth_m,
        )
    }

    /// Inside the image, [-0.5, W-0.5] x [-0.5, H-0.5].
    #[inline]
    #[must_use]
    pub fn contains(&self, uv_px: &Vector2<f64>) -> bool {
        uv_px.x >= -0.5
            && uv_px.y >= -0.5
            && uv_px.x < self.width as f64 - 0.5
            && uv_px.y < self.height as f64 - 0.5
    }

    /// The distorted pixel of an ideal one.
    #[must_use]
    pub fn distort_pixel(&self, ideal: &Vector2<f64>) -> Vector2<f64> {
        self.denormalise(&self.distortion.distort(&self.normalise(ideal)))
    }

    /// The ideal pixel of a distorted one; `None` where the model folds over and has no inverse.
    #[must_use]
    pub fn undistort_pixel(&self, distorted: &Vector2<f64>) -> Option<Vector2<f64>> {
        if self.distortion.is_none() {
            return Some(*distorted);
        }
        self.distortion
            .undistort(&self.normalise(distorted))
            .map(|xy| self.denormalise(&xy))
    }

    fn normalise(&self, uv: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new((uv.x - self.cx) / self.fx, (uv.y - self.cy) / self.fy)
    }

    fn denormalise(&self, xy: &Vector2<f64>) -> Vector2<f64> {
        Vector2::new(xy.x * self.fx + self.cx, xy.y * self.fy + self.cy)
    }
}

impl Distortion {
    /// No distortion at all.
    #[must_use]
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }

    /// Distorts normalised coordinates (x/z, y/z):
    ///
    /// x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2x²)
    /// y' = y (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2y²) + 2 p2 x y                      (E9)
    #[must_use]
    pub fn distort(&self, xy: &Vector2<f64>) -> Vector2<f64> {
        let (x, y) = (xy.x, xy.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        Vector2::new(
            x * radial + 2.0 * self.p1 * x * y + self.p2 * (r2 + 2.0 * x * x),
            y * radial + self.p1 * (r2 + 2.0 * y * y) + 2.0 * self.p2 * x * y,
        )
    }

    /// Derivative of [`Distortion::distort`].
    #[must_use]
    #[rustfmt::skip]
    pub fn distort_jacobian(&self, xy: &Vector2<f64>) -> Matrix2<f64> {
        let (x, y) = (xy.x, xy.y);
        let r2 = x * x + y * y;
        let radial = 1.0 + r2 * (self.k1 + r2 * (self.k2 + r2 * self.k3));
        let slope = 2.0 * (self.k1 + r2 * (2.0 * self.k2 + r2 * 3.0 * self.k3)); // d(radial)/dx = x·slope
        Matrix2::new(
            radial + x * x * slope + 2.0 * self.p1 * y + 6.0 * self.p2 * x,
            x * y * slope + 2.0 * self.p1 * x + 2.0 * self.p2 * y,
            x * y * slope + 2.0 * self.p1 * x + 2.0 * self.p2 * y,
            radial + y * y * slope + 6.0 * self.p1 * y + 2.0 * self.p2 * x,
        )
    }

    /// Inverse of [`Distortion::distort`] by Newton's method from the distorted point.
    ///
    /// `None` when 30 steps do not become shorter than 1e-9 or lead where the map has folded over
    /// (determinant of the Jacobian not positive).
    #[must_use]
    pub fn undistort(&self, distorted: &Vector2<f64>) -> Option<Vector2<f64>> {
        const STEPS: usize = 30;
        const LAST_STEP: f64 = 1e-9; // normalised
        let mut xy = *distorted;
        for _ in 0..STEPS {
            let error = self.distort(&xy) - distorted;
            let jacobian = self.distort_jacobian(&xy);
            let det = jacobian.m11 * jacobian.m22 - jacobian.m12 * jacobian.m21;
            // Beyond a fold one eigenvalue is negative; beyond the next both are, and the
            // determinant is positive again.
            let folded = det <= 0.0 || jacobian.trace() <= 0.0;
            if folded || !det.is_finite() {
                return None;
            }
            let step = Vector2::new(
                (jacobian.m22 * error.x - jacobian.m12 * error.y) / det,
                (jacobian.m11 * error.y - jacobian.m21 * error.x) / det,
            );
            xy -= step;
            // Steps converge quadratically: what this one leaves is rounding.
            if step.norm() < LAST_STEP {
                return Some(xy);
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn freiburg1() -> Camera {
        Camera {
            width: 640,
            height: 480,
            fx: 517.306_408,
            fy: 516.469_215,
            cx: 318.643_040,
            cy: 255.313_989,
            distortion: Distortion {
                k1: 0.262_383,
                k2: -0.953_104,
                p1: -0.005_358,
                p2: 0.002_628,
                k3: 1.163_314,
            },
        }
    }

    #[test]
    fn unprojects_by_hand() {
        let camera = Camera::pinhole((40, 30), [500.0, 250.0, 10.0, 20.0]).expect("valid");
        let p_cam = camera.unproject(&Vector2::new(20.0, 25.0), 2.0);
        let expected = Vector3::new(0.04, 0.04, 2.0); // 10 / 500 · 2, 5 / 250 · 2
        assert!((p_cam - expected).norm() < 1e-16, "{p_cam}");
    }

    #[test]
    fn first_pixel_centre_is_zero() {
        let camera = Camera::pinhole((4, 2), [2.0, 2.0, 1.5, 0.5]).expect("valid");
        // The optical axis meets the image half-way between the middle pixels.
        assert_eq!(
            camera.project(&Vector3::z()),
            Some(Vector2::new(1.5, 0.5)),
            "axis"
        );
        assert!(
            camera.contains(&Vector2::new(-0.5, -0.5)),
            "outer corner of pixel (0, 0)"
        );
        assert!(
            !camera.contains(&Vector2::new(3.5, 0.0)),
            "right of the last pixel"
        );
        assert_eq!(
            camera.project(&Vector3::new(0.0, 0.0, -1.0)),
            None,
            "behind"
        );
    }

    #[test]
    fn levels_follow_decimation_at_even_pixels() {
        let half = freiburg1().level(1);
        assert_eq!((half.width, half.height), (320, 240), "size");
        // What pixel 10 saw is seen by pixel 5: (10 - cx)/fx = (5 - cx/2)/(fx/2).
        let full = freiburg1();
        let (a, b) = ((10.0 - full.cx) / full.fx, (5.0 - half.cx) / half.fx);
        assert!((a - b).abs() < 1e-15, "{a} against {b}");
    }

    #[test]
    fn bad_numbers_are_named() {
        let nan = Camera::pinhole((4, 4), [1.0, f64::NAN, 0.0, 0.0]);
        assert!(
            matches!(nan, Err(CameraError::NotFinite { field: "fy", .. })),
            "{nan:?}"
        );
        let zero = Camera::pinhole((4, 4), [0.0, 1.0, 0.0, 0.0]);
        assert!(
            matches!(zero, Err(CameraError::NotPositive { field: "fx", .. })),
            "{zero:?}"
        );
        let empty = Camera::pinhole((0, 4), [1.0, 1.0, 0.0, 0.0]);
        assert!(
            matches!(empty, Err(CameraError::NotPositive { field: "width", .. })),
            "{empty:?}"
        );
        for (size, field) in [
            ((8192, 8192), None),
            ((8193, 4), Some("width")),
            ((4, 8193), Some("height")),
        ] {
            let expected = field.map(|field| CameraError::TooLarge { field, value: 8193 });
            let found = Camera::pinhole(size, [1.0, 1.0, 0.0, 0.0]).err();
            assert_eq!(found, expected, "{size:?}");
        }
    }

    #[test]
    fn folded_lens_has_no_inverse() {
        let fold = Distortion {
            k1: -1.0,
            ..Distortion::default()
        };
        // x (1 - x²) peaks at 0.385: nothing is seen at 0.6.
        assert_eq!(
            fold.undistort(&Vector2::new(0.6, 0.0)),
            None,
            "beyond the fold"
        );
        assert_eq!(
            fold.undistort(&Vector2::new(4.8, 0.0)),
            None,
            "far beyond it, where the image is mirrored"
        );
        assert!(
            fold.undistort(&Vector2::new(0.3, 0.0)).is_some(),
            "before the fold"
        );
    }

    proptest! {
        #[test]
        fn undistort_undoes_distort(u in 0.0f64..640.0, v in 0.0f64..480.0) {
            let camera = freiburg1();
            let ideal = camera.undistort_pixel(&Vector2::new(u, v)).expect("inside the image");
            let back = camera.distort_pixel(&ideal);
            prop_assert!((back - Vector2::new(u, v)).norm() < 1e-9, "{back}");
        }

        #[test]
        fn jacobians_are_the_derivatives(
            x in -0.6f64..0.6, y in -0.5f64..0.5, z in 0.3f64..5.0
        ) {
            let camera = freiburg1();
            let h = 1e-6;
            let p = Vector3::new(x * z, y * z, z);
            let j = camera.project_jacobian(&p);
            for i in 0..3 {
                let mut d = Vector3::zeros();
                d[i] = h;
                let plus = camera.project(&(p + d)).expect("in front");
                let minus = camera.project(&(p - d)).expect("in front");
                let column = (plus - minus) / (2.0 * h);
                prop_assert!((column - j.column(i)).norm() < 1e-5, "projection {i}");
            }
            let xy = Vector2::new(x, y);
            let j = camera.distortion.distort_jacobian(&xy);
            for i in 0..2 {
                let mut d = Vector2::zeros();
                d[i] = h;
                let column = (camera.distortion.distort(&(xy + d))
                    - camera.distortion.distort(&(xy - d))) / (2.0 * h);
                prop_assert!((column - j.column(i)).norm() < 1e-8, "distortion {i}");
            }
        }
    }
}
