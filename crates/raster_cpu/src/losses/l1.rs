//! [`l1()`]: mean absolute difference.

use garad_core::{Image, MaskImage, Real};

use super::image_loss::{ImageLoss, check_sizes, count_included, included};
use crate::error::RasterError;

/// Mean over included pixels and channels of |x - y| and its gradient by x (O1):
///
/// L1 = Σ |x - y| / 3n,   ∂L1/∂x = sign(x - y) / 3n,   0 where x = y
///
/// Source: paper eq. 13. Golden: `losses/l1_*`.
///
/// # Errors
/// [`RasterError::SizeMismatch`].
/// # Example
/// ```
/// use garad_core::Image;
/// use garad_raster::losses::l1;
/// let x = Image::new(2, 1, [0.5f64, 0.5, 0.5]);
/// let y = Image::from_vec(2, 1, vec![[0.5, 0.2, 0.8], [0.5, 0.5, 0.5]]).unwrap();
/// let loss = l1(&x, &y, None)?;
/// assert!((loss.value - 0.6 / 6.0).abs() < 1e-15);
/// assert_eq!(loss.gradient[(0, 0)], [0.0, 1.0 / 6.0, -1.0 / 6.0]);
/// # Ok::<(), garad_raster::RasterError>(())
/// ```
pub fn l1<T: Real>(
    rendered: &Image<[T; 3]>,
    target: &Image<[T; 3]>,
    excluded: Option<&MaskImage>,
) -> Result<ImageLoss<T>, RasterError> {
    check_sizes(rendered.size(), &[("target", target.size())], excluded)?;
    let pixels = count_included(excluded, rendered.data().len());
    // Where no pixel is included the sum is 0, whatever it is divided by.
    let terms = 3.0 * pixels.max(1) as f64;
    let slope = T::from_f64(1.0 / terms);
    let (width, height) = rendered.size();
    let mut gradient = Image::new(width, height, [T::ZERO; 3]);
    let mut sum = 0.0;
    for (i, out) in gradient.data_mut().iter_mut().enumerate() {
        if !included(excluded, i) {
            continue;
        }
        for channel in 0..3 {
            let difference = rendered.data()[i][channel] - target.data()[i][channel];
            sum += difference.abs().to_f64();
            if difference > T::ZERO {
                out[channel] = slope;
            } else if difference < T::ZERO {
                out[channel] = -slope;
            }
        }
    }
    Ok(ImageLoss {
        value: T::from_f64(sum / terms),
        gradient,
        pixels,
    })
}
