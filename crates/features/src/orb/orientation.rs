//! Orientation of a keypoint by the intensity centroid of a disc.

use garad_core::GrayImage;

/// Radius of the disc, pixels.
pub const RADIUS: usize = 15;

/// Half width of the disc at each distance from its middle row: round(√(15² - v²)), made
/// symmetric about the diagonal.
pub(crate) const HALF_WIDTH: [usize; RADIUS + 1] =
    [15, 15, 15, 15, 14, 14, 14, 13, 13, 12, 11, 10, 9, 8, 6, 3];

/// First moments of the disc around (x, y): m10 = Σ u I, m01 = Σ v I.
///
/// Integers, so the sum has no order. The disc lies inside the image: 15 ≤ x < w - 15, same
/// for y.
///
/// # Panics
/// If it does not.
#[must_use]
#[allow(clippy::cast_possible_truncation, reason = "-15 to 15")]
pub fn moments(image: &GrayImage, x: usize, y: usize) -> (i32, i32) {
    let (mut m10, mut m01) = (0i32, 0i32);
    for (v, &half) in (0i32..).zip(&HALF_WIDTH) {
        let (dv, first_u) = (v.unsigned_abs() as usize, -half.cast_signed());
        let below = &image.row(y + dv)[x - half..=x + half];
        let above = &image.row(y - dv)[x - half..=x + half];
        // The middle row is its own mirror image and counts once.
        let once = i32::from(v > 0);
        for (u, (&b, &a)) in (first_u as i32..).zip(below.iter().zip(above)) {
            let (b, a) = (i32::from(b), i32::from(a) * once);
            m10 += u * (b + a);
            m01 += v * (b - a);
        }
    }
    (m10, m01)
}

/// Angle of the point (x, y) in degrees, [0, 360], by the odd polynomial of degree 7 that OpenCV
/// calls `fastAtan2`; the largest error is 0.0096°. 0 for (0, 0).
///
/// In f32 with every operation rounded (no fused multiply-add): bit-equal to OpenCV's scalar
/// code. Descriptors depend on these bits, so a more accurate arctangent cannot replace it.
#[must_use]
#[allow(
    clippy::cast_possible_truncation,
    reason = "the constants are meant to be rounded to f32"
)]
pub fn fast_atan2_deg(y: f32, x: f32) -> f32 {
    const DEGREES: f32 = (180.0 / std::f64::consts::PI) as f32;
    const P1: f32 = 0.999_787_841_279_480_7_f64 as f32 * DEGREES;
    const P3: f32 = -0.325_808_397_464_097_5_f64 as f32 * DEGREES;
    const P5: f32 = 0.155_578_651_846_328_1_f64 as f32 * DEGREES;
    const P7: f32 = -0.044_326_555_547_921_28_f64 as f32 * DEGREES;
    const NOT_ZERO: f32 = f64::EPSILON as f32;
    let polynomial = |c: f32| {
        let c2 = c * c;
        (((P7 * c2 + P5) * c2 + P3) * c2 + P1) * c
    };
    let (ax, ay) = (x.abs(), y.abs());
    let mut angle = if ax >= ay {
        polynomial(ay / (ax + NOT_ZERO))
    } else {
        90.0 - polynomial(ax / (ay + NOT_ZERO))
    };
    if x < 0.0 {
        angle = 180.0 - angle;
    }
    if y < 0.0 {
        angle = 360.0 - angle;
    }
    angle
}

/// Direction from the keypoint to the centroid of its disc, degrees: x right, y down.
#[must_use]
pub fn angle_deg(image: &GrayImage, x: usize, y: usize) -> f32 {
    let (m10, m01) = moments(image, x, y);
    fast_atan2_deg(m01 as f32, m10 as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::{Real, Rng};

    #[test]
    fn disc_is_the_quarter_circle_and_symmetric() {
        // Up to the diagonal by rounding, beyond it by symmetry.
        for (v, &half) in HALF_WIDTH.iter().enumerate().take(11) {
            let exact = f64::sqrt(225.0 - (v * v) as f64);
            assert!(
                (half as f64 - exact).abs() <= 0.5,
                "row {v}: {half} against {exact}"
            );
        }
        // (u, v) inside if and only if (v, u) inside
        for v in 0..=RADIUS {
            for u in 0..=RADIUS {
                assert_eq!(u <= HALF_WIDTH[v], v <= HALF_WIDTH[u], "({u}, {v})");
            }
        }
    }

    #[test]
    fn moments_are_their_sums() {
        let mut rng = Rng::new(5);
        let image = GrayImage::from_fn(31, 31, |_, _| u8::try_from(rng.below(256)).expect("byte"));
        let (mut m10, mut m01) = (0, 0);
        for v in -15i32..=15 {
            for u in -15i32..=15 {
                if u.unsigned_abs() as usize <= HALF_WIDTH[v.unsigned_abs() as usize] {
                    let (x, y) = ((15 + u).unsigned_abs(), (15 + v).unsigned_abs());
                    let value = i32::from(image[(x as usize, y as usize)]);
                    m10 += u * value;
                    m01 += v * value;
                }
            }
        }
        assert_eq!(moments(&image, 15, 15), (m10, m01), "disc sums");
    }

    #[test]
    fn angles_turn_with_the_image() {
        // Bright to the right: 0°; below (y grows downwards): 90°.
        let right = GrayImage::from_fn(31, 31, |x, _| if x > 15 { 200 } else { 10 });
        let below = GrayImage::from_fn(31, 31, |_, y| if y > 15 { 200 } else { 10 });
        let left = right.map(|v| 210 - v);
        assert!(angle_deg(&right, 15, 15).abs() < 1e-6, "right");
        assert!((angle_deg(&below, 15, 15) - 90.0).abs() < 1e-4, "below");
        assert!((angle_deg(&left, 15, 15) - 180.0).abs() < 1e-4, "left");
        assert!(
            angle_deg(&GrayImage::new(31, 31, 9), 15, 15).abs() < 1e-6,
            "flat"
        );
    }

    #[test]
    fn polynomial_stays_within_its_error() {
        let mut worst = 0.0f64;
        for i in 0..3600 {
            let exact = f64::from(i) * 0.1;
            let (sin, cos) = libm::sincos(exact.to_radians());
            let angle = fast_atan2_deg(sin.to_f32(), cos.to_f32());
            let error = (f64::from(angle) - exact).abs();
            worst = worst.max(error.min(360.0 - error));
        }
        assert!(worst <= 0.0096, "worst error {worst}°");
        assert!(worst > 0.009, "the documented error is reached: {worst}°");
    }
}
