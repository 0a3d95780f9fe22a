//! A recording held against its calibration, before its first frame is tracked: numbers that cannot be are an error, numbers
//! that are unlikely a warning that names the value and the usual cause.

use garad_core::{Camera, DepthImage};
use nalgebra::Vector2;

use crate::calibration::Calibration;
use crate::dataset::Dataset;
use crate::errors::DatasetError;

/// Frames that are looked at.
const FRAMES: usize = 10;
/// Every so many pixels of a depth image, in x and y, one is looked at.
const STRIDE_PX: usize = 4;
/// Horizontal field of view, degrees, of cameras that a pinhole describes; beyond `POSSIBLE` none is.
const USUAL_FOV_DEG: [f64; 2] = [25.0, 130.0];
const POSSIBLE_FOV_DEG: [f64; 2] = [1.0, 170.0];
/// Pixels of this ratio of height to width are not made.
const PIXEL_RATIO: f64 = 1.25;
/// Part of the picture without an inverse distortion, beyond which the model is useless.
const FOLDED: f64 = 0.25;
/// No lens moves a pixel this far towards the principal point, in diagonals of the image.
const PULLED_IN: f64 = 0.1;
/// No RGB-D sensor has nearly all of its range below this, metres.
const NEAR_M: f64 = 1.1;
/// Nearly all, and nearly none.
const MOST: f64 = 0.95;
/// Relative difference of neighbours: surfaces have less than the first, numbers with exchanged bytes more than the second.
const SMOOTH: f64 = 0.02;
const ROUGH: f64 = 0.2;
/// The time between frames may differ from the calibration's by this factor: recordings are thinned out.
const TIME_RATIO: f64 = 4.0;

/// What the first frames of a recording hold.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FirstLook {
    /// Warnings, one sentence each.
    pub warnings: Vec<String>,
    /// Depth of the frames that were looked at.
    pub depth: DepthRange,
}

/// Depth readings of a few images.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DepthRange {
    /// Images that could be read.
    pub images: usize,
    /// Pixels looked at.
    pub pixels: usize,
    /// Those with a reading.
    pub readings: usize,
    /// Readings beyond the largest depth in use.
    pub beyond: usize,
    /// Smallest, median and 95 % quantile of the readings, metres; 0 without any.
    pub quantiles_m: [f64; 3],
}

impl DepthRange {
    /// Of every fourth pixel of some images; `limit_m`: the largest depth in use.
    #[must_use]
    pub fn of<'a>(images: impl IntoIterator<Item = &'a DepthImage>, limit_m: f64) -> Self {
        let (mut found, mut range) = (Vec::new(), Self::default());
        for image in images {
            let (width, height) = image.size();
            let rows = (0..height).step_by(STRIDE_PX);
            let at = rows.flat_map(|y| (0..width).step_by(STRIDE_PX).map(move |x| (x, y)));
            for pixel in at {
                range.pixels += 1;
                found.extend(Some(f64::from(image[pixel])).filter(|z| *z > 0.0));
            }
            range.images += 1;
        }
        found.sort_by(f64::total_cmp);
        range.readings = found.len();
        range.beyond = found.iter().filter(|z| **z > limit_m).count();
        if let Some(last) = found.len().checked_sub(1) {
            range.quantiles_m = [0, last / 2, last * 95 / 100].map(|i| found[i]);
        }
        range
    }

    /// Why nothing can be tracked by this depth, if that is so.
    #[must_use]
    pub fn useless(&self, calibration: &Calibration, limit_m: f64) -> Option<String> {
        let [_, median_m, _] = self.quantiles_m;
        let factor = calibration.depth_factor;
        if self.images > 0 && self.readings == 0 {
            return Some(format!(
                "no depth in any of the first {} depth images: all of their pixels are 0 or beyond the sensor's range",
                self.images
            ));
        }
        let share = self.beyond as f64 / self.readings.max(1) as f64;
        (share >= MOST).then(|| {
            format!(
                "{:.0} % of the depth lies beyond the {limit_m} m that are used (median {median_m:.1} m): is depth_factor {factor} right? Depth in millimetres has 1000, TUM and BONN have 5000",
                1e2 * share
            )
        })
    }
}

impl Dataset {
    /// Holds the first frames against the calibration. `limit_m`: the largest depth in use, metres.
    ///
    /// # Errors
    /// [`DatasetError::Implausible`]: a camera whose numbers cannot be.
    pub fn first_look(&self, limit_m: f64) -> Result<FirstLook, DatasetError> {
        let calibration = self.calibration();
        let mut warnings = camera_warnings(calibration)?;
        let frames = (0..self.len().min(FRAMES)).filter_map(|i| self.read(i).ok());
        let images: Vec<DepthImage> = frames.map(|frame| frame.depth).collect();
        let depth = DepthRange::of(&images, limit_m);
        warnings.extend(depth_warning(&images, &depth, calibration, limit_m));
        let times_s = (0..self.len()).filter_map(|i| self.timestamp(i));
        warnings.extend(time_warning(&times_s.collect::<Vec<_>>(), calibration.fps));
        Ok(FirstLook { warnings, depth })
    }
}

/// Focal lengths, principal point and distortion.
fn camera_warnings(calibration: &Calibration) -> Result<Vec<String>, DatasetError> {
    let camera = &calibration.camera;
    let Camera {
        width,
        height,
        fx,
        fy,
        cx,
        cy,
        ..
    } = *camera;
    let implausible = |problem: String| DatasetError::Implausible {
        source_name: calibration.source.clone(),
        problem,
    };
    let fov_deg = 2.0 * garad_core::Real::atan2(0.5 * width as f64, fx).to_degrees();
    let inside = |[low, high]: [f64; 2]| (low..=high).contains(&fov_deg);
    let view =
        format!("fx {fx} px at a width of {width} px is a field of view of {fov_deg:.1} degrees");
    if !inside(POSSIBLE_FOV_DEG) {
        return Err(implausible(format!(
            "{view}; expected focal lengths in pixels (those of normalised intrinsics times width and height)"
        )));
    }
    let mut warnings = Vec::new();
    if !inside(USUAL_FOV_DEG) {
        warnings.push(format!("{view}: are the focal lengths in pixels?"));
    }
    if !camera.contains(&Vector2::new(cx, cy)) {
        warnings.push(format!(
            "principal point ({cx}, {cy}) lies outside the image of {width}x{height} px: are fx fy and cx cy exchanged?"
        ));
    }
    let ratio = (fx / fy).max(fy / fx);
    if ratio > PIXEL_RATIO {
        warnings.push(format!(
            "fx {fx} and fy {fy} differ by a factor of {ratio:.2}: are numbers exchanged?"
        ));
    }
    let folded = folded_share(camera);
    let place = format!(
        "the distortion folds in {:.0} % of the image",
        (1e2 * folded).ceil()
    );
    if folded > FOLDED {
        return Err(implausible(format!(
            "{place}; expected k1 k2 p1 p2 k3 of OpenCV's model in this order"
        )));
    }
    if folded > 0.0 {
        warnings.push(format!(
            "{place}, and those pixels are not used: are k1 k2 p1 p2 k3 in this order?"
        ));
    }
    let pulled_in = largest_pull(camera);
    if pulled_in > PULLED_IN {
        warnings.push(format!(
            "the distortion moves pixels inwards by up to {:.0} % of the image's diagonal: are k1 k2 p1 p2 k3 in this order, and of this lens?",
            1e2 * pulled_in
        ));
    }
    Ok(warnings
        .into_iter()
        .map(|what| format!("camera from {}: {what}", calibration.source))
        .collect())
}

/// Pixels of a grid that reaches the corners.
fn grid(camera: &Camera) -> Vec<Vector2<f64>> {
    const STEPS: usize = 16;
    let at = |i: usize, size: usize| (i * (size - 1)) as f64 / STEPS as f64;
    let cells = (0..=STEPS).flat_map(|j| (0..=STEPS).map(move |i| (i, j)));
    cells
        .map(|(i, j)| Vector2::new(at(i, camera.width), at(j, camera.height)))
        .collect()
}

/// Part of the image where the distortion has no inverse.
fn folded_share(camera: &Camera) -> f64 {
    let grid = grid(camera);
    let folded = grid
        .iter()
        .filter(|uv| camera.undistort_pixel(uv).is_none());
    folded.count() as f64 / grid.len() as f64
}

/// How much nearer to the principal point a pixel comes when it is undistorted, at most; in diagonals of the image.
fn largest_pull(camera: &Camera) -> f64 {
    let centre = Vector2::new(camera.cx, camera.cy);
    let diagonal = Vector2::new(camera.width as f64, camera.height as f64).norm();
    let pull = |uv: Vector2<f64>| {
        let ideal = camera.undistort_pixel(&uv)?;
        Some(((uv - centre).norm() - (ideal - centre).norm()) / diagonal)
    };
    grid(camera)
        .into_iter()
        .filter_map(pull)
        .fold(0.0, f64::max)
}

/// Range and byte order of the depth.
fn depth_warning(
    images: &[DepthImage],
    depth: &DepthRange,
    calibration: &Calibration,
    limit_m: f64,
) -> Option<String> {
    let factor = calibration.depth_factor;
    let [rough, exchanged] = [false, true].map(|swap| roughness(images, factor, swap));
    if rough > ROUGH && exchanged < SMOOTH {
        return Some(format!(
            "depth jumps by {:.0} % from pixel to pixel, with the two bytes of each number exchanged by {:.1} %: are the depth images written with the wrong byte order?",
            1e2 * rough,
            1e2 * exchanged
        ));
    }
    if let Some(useless) = depth.useless(calibration, limit_m) {
        return Some(useless);
    }
    let [nearest_m, median_m, far_m] = depth.quantiles_m;
    (depth.readings > 0 && far_m < NEAR_M).then(|| {
        format!(
            "95 % of the depth lies between {nearest_m:.2} and {far_m:.2} m (median {median_m:.2} m): if the scene is not that near, depth_factor {factor} is wrong; depth in millimetres has 1000"
        )
    })
}

/// Median relative difference of neighbours in a row that both have a reading.
fn roughness(images: &[DepthImage], factor: f64, swap: bool) -> f64 {
    let value = |z: f32| {
        // A reading is raw / factor with raw below 65536.
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "rounded and in range"
        )]
        let raw = (f64::from(z) * factor).round() as u16;
        f64::from(if swap { raw.swap_bytes() } else { raw })
    };
    let mut jumps = Vec::new();
    for image in images {
        let (width, height) = image.size();
        for y in (0..height).step_by(STRIDE_PX) {
            for x in (1..width).step_by(STRIDE_PX) {
                let pair = [image[(x - 1, y)], image[(x, y)]];
                if pair.iter().all(|z| *z > 0.0) {
                    let [a, b] = pair.map(value);
                    jumps.push((a - b).abs() / a.max(b).max(1.0));
                }
            }
        }
    }
    jumps.sort_by(f64::total_cmp);
    jumps.get(jumps.len() / 2).copied().unwrap_or(0.0)
}

/// The median time between frames against the calibration's frames per second.
fn time_warning(times_s: &[f64], fps: f64) -> Option<String> {
    let mut steps: Vec<f64> = times_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_by(f64::total_cmp);
    let step_s = *steps.get(steps.len() / 2)?;
    let ratio = step_s * fps;
    (!(1.0 / TIME_RATIO..=TIME_RATIO).contains(&ratio)).then(|| {
        format!(
            "frames are {step_s} s apart, the camera takes {fps} a second: are the time stamps in seconds?"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::camera::Distortion;

    fn calibration([fx, fy, cx, cy]: [f64; 4], depth_factor: f64) -> Calibration {
        Calibration {
            camera: Camera::pinhole((320, 240), [fx, fy, cx, cy]).expect("valid"),
            depth_factor,
            fps: 30.0,
            depth_max_raw: None,
            depth_delay_s: 0.0,
            source: "cam.txt".to_owned(),
        }
    }

    #[test]
    fn cameras_that_cannot_be() {
        let said = |numbers| match camera_warnings(&calibration(numbers, 5000.0)) {
            Ok(warnings) => warnings.join("; "),
            Err(error) => format!("error: {error}"),
        };
        let cases = [
            ([262.5, 262.5, 161.0, 118.0], ""),
            ([262.5, 250.0, 161.0, 118.0], ""),
            ([262.5, 200.0, 161.0, 118.0], "differ by a factor of 1.31"),
            ([161.0, 118.0, 262.5, 262.5], "exchanged"),
            ([262.5, 262.5, 161.0, 240.0], "principal point (161, 240)"),
            ([0.825, 1.1, 0.5, 0.5], "error"),
            ([60.0, 60.0, 161.0, 118.0], "138.9 degrees"),
            ([2000.0, 2000.0, 161.0, 118.0], "9.1 degrees"),
        ];
        for (numbers, expected) in cases {
            let words = said(numbers);
            let right = words.contains(expected) && (expected.is_empty() == words.is_empty());
            assert!(right, "{numbers:?}: {words:?}, expected {expected:?}");
        }
    }

    #[test]
    fn distortion_that_folds() {
        let mut known = calibration([258.6, 258.2, 159.3, 127.6], 5000.0);
        let mut said = |[k1, k2, p1, p2, k3]: [f64; 5]| {
            known.camera.distortion = Distortion { k1, k2, p1, p2, k3 };
            match camera_warnings(&known) {
                Ok(warnings) => warnings.join("; "),
                Err(error) => format!("error: {error}"),
            }
        };
        // freiburg1 at half its size: strong, without a fold.
        assert_eq!(said([0.262, -0.953, -0.005, 0.003, 1.163]), "", "freiburg1");
        // r (1 - 0.9 r²) turns back at r = 0.609, where it is 0.406; the corners are at 0.76.
        let words = said([-0.9, 0.0, 0.0, 0.0, 0.0]);
        assert!(
            words.contains("error") && words.contains("folds"),
            "{words}"
        );
        // r (1 + 50 r² - ...) is steep: the corners at 0.79 come from 0.26, 139 px of 400 further in.
        let words = said([50.0, -95.0, 0.0, 0.0, 116.0]);
        assert!(words.contains("inwards by up to 3"), "{words}");
        // r (1 - 0.25 r²) turns back at 1.155, where it is 0.770; one corner is at 0.791.
        let words = said([-0.25, 0.0, 0.0, 0.0, 0.0]);
        assert!(
            words.contains("camera from cam.txt: the distortion folds in 1 %"),
            "{words}"
        );
    }

    /// A slope from `near_m` on, 1 cm a pixel.
    fn slope(near_m: f32) -> DepthImage {
        DepthImage::from_fn(64, 48, |x, _| near_m + 0.01 * x as f32)
    }

    #[test]
    fn depth_out_of_range() {
        let known = calibration([262.5, 262.5, 161.0, 118.0], 5000.0);
        let said = |image: &DepthImage| {
            let images = [image.clone()];
            let range = DepthRange::of(&images, 8.0);
            depth_warning(&images, &range, &known, 8.0)
        };
        assert_eq!(said(&slope(1.0)), None, "1.00 to 1.63 m");
        let near = said(&slope(0.3)).expect("0.30 to 0.90 m");
        assert!(
            near.contains("between 0.30 and 0.90 m (median 0.58"),
            "{near}"
        );
        assert!(near.contains("depth_factor 5000"), "{near}");
        assert_eq!(said(&slope(0.6)), None, "95 % below 1.16 m");
        let far = said(&slope(8.01)).expect("8.01 to 8.64 m");
        assert!(
            far.contains("beyond the 8 m") && far.contains("median 8.3 m"),
            "{far}"
        );
        assert_eq!(said(&slope(7.9)), None, "a seventh is used");
        let none = said(&DepthImage::new(64, 48, 0.0)).expect("no reading");
        assert!(none.contains("no depth in any of the first 1"), "{none}");
    }

    #[test]
    fn depth_with_exchanged_bytes() {
        let known = calibration([262.5, 262.5, 161.0, 118.0], 5000.0);
        let raw = |x: usize| u16::try_from(9000 + 37 * x).expect("in range");
        let image = DepthImage::from_fn(64, 48, |x, _| f32::from(raw(x).swap_bytes()) / 5000.0);
        let images = [image];
        let range = DepthRange::of(&images, 8.0);
        let words = depth_warning(&images, &range, &known, 8.0).expect("exchanged");
        assert!(words.contains("byte order"), "{words}");
    }

    #[test]
    fn stamps_of_another_unit() {
        let times = |step_s: f64| -> Vec<f64> { (0..9).map(|i| f64::from(i) * step_s).collect() };
        assert_eq!(time_warning(&times(1.0 / 30.0), 30.0), None, "as it says");
        assert_eq!(time_warning(&times(0.1), 30.0), None, "every third");
        let words = time_warning(&times(33.0), 30.0).expect("milliseconds");
        assert!(words.contains("33 s apart"), "{words}");
        assert!(time_warning(&times(3.3e-5), 30.0).is_some(), "too close");
        assert_eq!(time_warning(&[1.0], 30.0), None, "one frame");
    }
}
