//! [`depth_l1`]: the expected depth against a depth camera's.

use garad_core::{DepthImage, Image, MaskImage, Real};

use super::{check_sizes, judged};
use crate::error::RasterError;

/// A number and its gradients by the two pictures an expected depth is made of.
#[derive(Debug, Clone, PartialEq)]
pub struct DepthLoss<T> {
    /// Mean absolute error, metres.
    pub value: T,
    /// By [`crate::Rendered::depth`].
    pub depth: Image<T>,
    /// By [`crate::Rendered::opacity`], metres.
    pub opacity: Image<T>,
    /// Pixels judged.
    pub pixels: usize,
}

/// Mean over judged pixels of |D/O - z| and its gradients (O4):
///
/// ∂/∂D = sign(D/O - z)/(n O),   ∂/∂O = -(D/O) ∂/∂D
///
/// with D = Σ w z and O = Σ w as rendered. Judged are pixels with a measured depth and
/// O ≥ `min_opacity`: where little was drawn, the quotient is about little.
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
    let pictures = [("opacity", opacity.size()), ("measured", measured.size())];
    check_sizes(depth.size(), &pictures, excluded)?;
    if !(min_opacity > 0.0 && min_opacity <= 1.0) {
        return Err(RasterError::MinOpacity { value: min_opacity });
    }
    let least = T::from_f64(min_opacity);
    let judged: Vec<usize> = (0..depth.data().len())
        .filter(|&i| {
            let z = measured.data()[i];
            judged(excluded, i) && z > 0.0 && z.is_finite() && opacity.data()[i] >= least
        })
        .collect();
    let n = judged.len().max(1) as f64;
    let (width, height) = depth.size();
    let mut by_depth = Image::new(width, height, T::ZERO);
    let mut by_opacity = Image::new(width, height, T::ZERO);
    let mut sum = 0.0;
    for &i in &judged {
        let o = opacity.data()[i];
        let expected = depth.data()[i] / o;
        let error = expected - T::from_f64(f64::from(measured.data()[i]));
        sum += error.abs().to_f64();
        let pull = T::from_f64(1.0 / n) / o;
        let pull = if error > T::ZERO {
            pull
        } else if error < T::ZERO {
            -pull
        } else {
            T::ZERO
        };
        by_depth.data_mut()[i] = pull;
        by_opacity.data_mut()[i] = -expected * pull;
    }
    Ok(DepthLoss {
        value: T::from_f64(sum / n),
        depth: by_depth,
        opacity: by_opacity,
        pixels: judged.len(),
    })
}
