//! Depth error: distance between rendered and measured surfaces.

use garad_core::{DepthImage, MaskImage};

use crate::EvalError;
use crate::image_metrics::{check_sizes, judged, no_pixels};

/// Depth error of one image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthL1 {
    /// Mean of |z_render - z_truth| over the pixels with both depths, metres.
    pub mean_m: f64,
    /// Pixels with both depths.
    pub pixels: usize,
    /// Share of the pixels with true depth where the render has depth too, in [0, 1].
    pub coverage: f64,
}

/// Mean absolute difference of two depth images where both have depth (finite and above 0) and the mask,
/// if any, is 0. To be read together with `coverage`: pixels without rendered depth do not count.
///
/// # Errors
/// [`EvalError::SizeMismatch`]; [`EvalError::TooFew`] when no pixel has both depths.
pub fn depth_l1(
    render: &DepthImage,
    truth: &DepthImage,
    excluded: Option<&MaskImage>,
) -> Result<DepthL1, EvalError> {
    check_sizes(render, truth, excluded)?;
    let known = |z: f32| z.is_finite() && z > 0.0;
    let (mut sum, mut pixels, mut with_truth) = (0.0, 0usize, 0usize);
    for i in judged(truth.data().len(), excluded) {
        let (z, z_true) = (render.data()[i], truth.data()[i]);
        if known(z_true) {
            with_truth += 1;
            if known(z) {
                pixels += 1;
                sum += (f64::from(z) - f64::from(z_true)).abs();
            }
        }
    }
    if pixels == 0 {
        return Err(no_pixels());
    }
    Ok(DepthL1 {
        mean_m: sum / pixels as f64,
        pixels,
        coverage: pixels as f64 / with_truth as f64,
    })
}

#[cfg(test)]
mod tests {
    use garad_core::Image;

    use super::*;

    #[test]
    fn depth_by_hand() {
        let truth = Image::from_vec(5, 1, vec![1.0f32, 2.0, 0.0, 4.0, 5.0]).expect("5 pixels");
        let render = Image::from_vec(5, 1, vec![1.5f32, 2.25, 3.0, f32::NAN, 9.0]).expect("5");
        let mask = Image::from_vec(5, 1, vec![0, 0, 0, 0, 255]).expect("5 pixels");
        let judged = depth_l1(&render, &truth, Some(&mask)).expect("two pixels");
        assert_eq!(judged.pixels, 2, "known in both, outside the mask");
        assert!((judged.mean_m - 0.375).abs() < 1e-15, "{judged:?}");
        assert!((judged.coverage - 2.0 / 3.0).abs() < 1e-15, "{judged:?}");
        let empty = Image::new(5, 1, 0.0);
        assert_eq!(
            depth_l1(&render, &empty, None),
            Err(no_pixels()),
            "no truth"
        );
    }
}
