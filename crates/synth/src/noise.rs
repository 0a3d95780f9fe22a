//! The noise of a Kinect, applied to an exact frame.
//!
//! Depth: Gaussian noise along the axis, rounding of the disparity, holes at grazing angles, along
//! depth edges and beyond the range. Colour: sensor noise. Each pixel has its own random stream,
//! keyed by (seed, frame, pixel): any number of threads gives the same bits, and a scene and its twin
//! share the noise where they show the same surface.

use garad_core::{DepthImage, Image, Par, RgbImage, Rng};

/// Standard deviation of the colour noise, grey levels of 255.
pub const COLOUR_SIGMA: f64 = 1.5;
/// Depth is measured in this range, metres.
pub const RANGE_M: [f64; 2] = [0.4, 8.0];
/// Largest depth measured in [`crate::SceneName::Hall`], exact or with noise, metres.
pub const HALL_RANGE_M: f64 = 5.0;
/// Baseline times focal length of a Kinect at 640 columns: 0.075 m x 525 px, rounded.
pub const BASELINE_FOCAL_M_PX: f64 = 40.0;
/// Quantisation step of the disparity, pixels.
pub const DISPARITY_STEP_PX: f64 = 0.125;
/// Neighbours form an edge if their depths differ by more than this share of the smaller one.
const EDGE_RELATIVE: f32 = 0.04;

/// Standard deviation of depth at distance z, metres (Nguyen, Izadi, Lovell 2012, axial noise):
///
/// σ(z) = 0.0012 + 0.0019 (z - 0.4)²
#[must_use]
pub fn depth_sigma_m(z_m: f64) -> f64 {
    let from_near = z_m - 0.4;
    0.0012 + 0.0019 * from_near * from_near
}

/// Step between neighbouring depths at distance z, metres: z² / (8 · 40).
#[must_use]
pub fn depth_step_m(z_m: f64) -> f64 {
    z_m * z_m * DISPARITY_STEP_PX / BASELINE_FOCAL_M_PX
}

/// The nearest quantised depth; 0 out of range.
fn quantised(z_m: f64) -> f64 {
    let steps = (BASELINE_FOCAL_M_PX / (z_m * DISPARITY_STEP_PX)).round();
    let z = BASELINE_FOCAL_M_PX / (steps * DISPARITY_STEP_PX);
    if (RANGE_M[0]..=RANGE_M[1]).contains(&z) {
        z
    } else {
        0.0
    }
}

/// Probability of a hole for a cosine of incidence: 0 above 0.25, 1 below 0.05.
fn grazing_dropout(incidence: f32) -> f64 {
    f64::from(((0.25 - incidence) / 0.20).clamp(0.0, 1.0))
}

/// Depth with noise and holes.
pub(crate) fn measured_depth(
    depth: &DepthImage,
    incidence: &Image<f32>,
    key: (u64, u64),
    par: Par,
) -> DepthImage {
    let (width, height) = depth.size();
    let pixel = |i: usize| {
        let z = f64::from(depth.data()[i]);
        let mut rng = Rng::keyed(key.0, &[0xDE, key.1, i as u64]);
        let (noise, drop) = (rng.normal(), rng.uniform());
        let holes =
            grazing_dropout(incidence.data()[i]).max(edge_dropout(depth, i % width, i / width));
        if z <= 0.0 || drop < holes {
            return 0.0;
        }
        #[allow(clippy::cast_possible_truncation, reason = "depth images are f32")]
        let z = quantised(z + depth_sigma_m(z) * noise) as f32;
        z
    };
    let data = par.map_chunks(width * height, 4096, |r| r.map(pixel).collect::<Vec<f32>>());
    Image::from_vec(width, height, data.concat()).unwrap_or_default()
}

/// Probability of a hole near a depth edge: 0.6 beside it, 0.25 one pixel further.
fn edge_dropout(depth: &DepthImage, x: usize, y: usize) -> f64 {
    let z = depth[(x, y)];
    let is_edge = |dx: isize, dy: isize| {
        let at = |a: usize, d: isize| a.checked_add_signed(d);
        let Some(&other) = at(x, dx).zip(at(y, dy)).and_then(|(x, y)| depth.get(x, y)) else {
            return false;
        };
        (other - z).abs() > EDGE_RELATIVE * other.min(z)
    };
    let around = |r: isize| is_edge(-r, 0) || is_edge(r, 0) || is_edge(0, -r) || is_edge(0, r);
    if around(1) {
        0.6
    } else if around(2) {
        0.25
    } else {
        0.0
    }
}

/// Colour with Gaussian noise of [`COLOUR_SIGMA`] in each channel.
pub(crate) fn measured_rgb(rgb: &RgbImage, key: (u64, u64), par: Par) -> RgbImage {
    let (width, height) = rgb.size();
    let pixel = |i: usize| {
        let mut rng = Rng::keyed(key.0, &[0xC0, key.1, i as u64]);
        rgb.data()[i].map(|c| {
            let value = f64::from(c) + COLOUR_SIGMA * bell(rng.next_u64());
            #[allow(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "0 to 255 after the clamp"
            )]
            let value = (value + 0.5).clamp(0.0, 255.0) as u8;
            value
        })
    };
    let data = par.map_chunks(width * height, 4096, |r| r.map(pixel).collect::<Vec<_>>());
    Image::from_vec(width, height, data.concat()).unwrap_or_default()
}

/// Sum of the four 16-bit parts of a number, centred and scaled to variance 1: approximately normal,
/// limited to ±3.46, without a transcendental function.
fn bell(bits: u64) -> f64 {
    let sum: u64 = (0..4).map(|k| bits >> (16 * k) & 0xFFFF).sum();
    // four uniform numbers of variance 65536²/12 each, mean 65535/2
    (sum as f64 - 131_070.0) * (3.0f64.sqrt() / 65_536.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Axial noise and rounding are independent: their variances add, step²/12 for the rounding.
    #[test]
    fn depth_noise_has_the_stated_spread() {
        for (z_m, sigma) in [(1.0f32, 0.001_884), (2.0, 0.006_064), (3.0, 0.014_044)] {
            let z = f64::from(z_m);
            assert!((depth_sigma_m(z) - sigma).abs() < 1e-12, "formula at {z}");
            let (w, h) = (200, 150);
            let depth = Image::new(w, h, z_m);
            let seen = measured_depth(&depth, &Image::new(w, h, 1.0), (5, 0), Par::Seq);
            let n = (w * h) as f64;
            assert!(seen.data().iter().all(|&d| d > 0.0), "no holes on a wall");
            let mean = seen.data().iter().map(|&d| f64::from(d)).sum::<f64>() / n;
            let spread = |d: &f32| (f64::from(*d) - mean) * (f64::from(*d) - mean);
            let var = seen.data().iter().map(spread).sum::<f64>() / n;
            let step = depth_step_m(z);
            let expected = (sigma * sigma + step * step / 12.0).sqrt();
            assert!((mean - z).abs() < 0.05 * expected, "mean {mean} at {z}");
            assert!(
                (var.sqrt() / expected - 1.0).abs() < 0.03,
                "sigma {} at {z}",
                var.sqrt()
            );
        }
    }

    #[test]
    fn depths_are_quantised_within_the_range() {
        for z in [0.5, 1.234, 4.0, 7.9] {
            let disparity = BASELINE_FOCAL_M_PX / quantised(z);
            let steps = disparity / DISPARITY_STEP_PX;
            assert!((steps - steps.round()).abs() < 1e-9, "{z}");
            assert!((quantised(z) - z).abs() <= 0.51 * depth_step_m(z), "{z}");
        }
        for z in [0.2, 8.5, f64::NAN] {
            assert!(quantised(z).to_bits() == 0, "out of range: {z}");
        }
    }

    #[test]
    fn holes_are_at_edges_and_at_grazing_angles() {
        let (w, h) = (101, 400);
        let depth = Image::from_fn(w, h, |x, _| if x < 50 { 1.0 } else { 2.0 });
        let seen = measured_depth(&depth, &Image::new(w, h, 0.9), (1, 2), Par::Seq);
        let holes = |x: usize| (0..h).filter(|&y| seen[(x, y)] <= 0.0).count() as f64 / h as f64;
        for (x, expected) in [
            (47, 0.0),
            (48, 0.25),
            (49, 0.6),
            (50, 0.6),
            (51, 0.25),
            (52, 0.0),
        ] {
            assert!(
                (holes(x) - expected).abs() < 0.08,
                "column {x}: {}",
                holes(x)
            );
        }
        for (incidence, expected) in [(0.26, 0.0), (0.15, 0.5), (0.04, 1.0)] {
            let flat = Image::new(w, h, 1.0f32);
            let seen = measured_depth(&flat, &Image::new(w, h, incidence), (1, 3), Par::Seq);
            let holes = seen.data().iter().filter(|&&d| d <= 0.0).count() as f64 / (w * h) as f64;
            assert!(
                (holes - expected).abs() < 0.02,
                "cosine {incidence}: {holes}"
            );
        }
    }

    #[test]
    fn colour_noise_has_the_stated_spread_and_differs_between_frames() {
        let grey = Image::new(200, 200, [128u8; 3]);
        let seen = measured_rgb(&grey, (9, 0), Par::Seq);
        let deviation = |c: u8| f64::from(c) - 128.0;
        let n = 3.0 * 40_000.0;
        let values = || seen.data().iter().flatten().map(|&c| deviation(c));
        let (mean, var) = (
            values().sum::<f64>() / n,
            values().map(|d| d * d).sum::<f64>() / n,
        );
        // rounding to whole levels adds 1/12
        let expected = COLOUR_SIGMA * COLOUR_SIGMA + 1.0 / 12.0;
        assert!(
            mean.abs() < 0.02 && (var / expected - 1.0).abs() < 0.03,
            "{mean}, {var}"
        );
        assert_ne!(seen, measured_rgb(&grey, (9, 1), Par::Seq), "frames differ");
        assert_eq!(
            seen,
            measured_rgb(&grey, (9, 0), Par::Threads(3)),
            "threads do not"
        );
    }
}
