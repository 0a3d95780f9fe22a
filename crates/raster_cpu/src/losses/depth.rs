//! [`depth_l1`]: the expected depth against a depth camera's.

use garad_core::{DepthImage, Image, MaskImage, Real};

use super::image_loss::{check_sizes, included};
use crate::error::RasterError;

/// A number and its gradients by the two images an expected depth is made of.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthLoss<T> {
    /// Mean absolute error, metres.
    pub value: T,
    /// By [`crate::Rendered::depth`].
    pub depth: Image<T>,
    /// By [`crate::Rendered::opacity`], metres.
    pub opacity: Image<T>,
    /// Included pixels.
    pub pixels: usize,
}

/// Mean over included pixels of |D/O - z| and its gradients (O4):
///
/// ∂/∂D = sign(D/O - z)/(n O),   ∂/∂O = -(D/O) ∂/∂D
///
/// with D = Σ w z and O = Σ w as rendered. Included are pixels with a measured depth and
/// O ≥ `min_opacity`: for small O the quotient is ill-conditioned.
///
/// Golden: `losses/depth_*`.
///
/// # Shapes and units
/// Metres; `measured` 0 or NaN is missing; `min_opacity` above 0.
/// # Errors
/// [`RasterError::SizeMismatch`]; [`RasterError::MinOpacity`].
pub fn depth_l1<T: Real>(
    depth: &Image<T>,
    opacity: &Image<T>,
    measured: &DepthImage,
    min_opacity: f64,
    excluded: Option<&MaskImage>,
) -> Result<DepthLoss<T>, RasterError> {
    let images = [("opacity", opacity.size()), ("measured", measured.size())];
    check_sizes(depth.size(), &images, excluded)?;
    if !(min_opacity > 0.0 && min_opacity <= 1.0) {
        return Err(RasterError::MinOpacity { value: min_opacity });
    }
    let least = T::from_f64(min_opacity);
    let pixels: Vec<usize> = (0..depth.data().len())
        .filter(|&i| {
            let z = measured.data()[i];
            included(excluded, i) && z > 0.0 && z.is_finite() && opacity.data()[i] >= least
        })
        .collect();
    let n = pixels.len().max(1) as f64;
    let (width, height) = depth.size();
    let mut by_depth = Image::new(width, height, T::ZERO);
    let mut by_opacity = Image::new(width, height, T::ZERO);
    let mut sum = 0.0;
    for &i in &pixels {
        let o = opacity.data()[i];
        let expected = depth.data()[i] / o;
        let error = expected - T::from_f64(f64::from(measured.data()[i]));
        sum += error.abs().to_f64();
        let slope = T::from_f64(1.0 / n) / o;
        let slope = if error > T::ZERO {
            slope
        } else if error < T::ZERO {
            -slope
        } else {
            T::ZERO
        };
        by_depth.data_mut()[i] = slope;
        by_opacity.data_mut()[i] = -expected * slope;
    }
    Ok(DepthLoss {
        value: T::from_f64(sum / n),
        depth: by_depth,
        opacity: by_opacity,
        pixels: pixels.len(),
    })
}
