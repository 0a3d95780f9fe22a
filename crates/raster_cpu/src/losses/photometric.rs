//! [`photometric()`]: the picture's part of the training loss.

use garad_core::{Image, MaskImage, Par, Real};

use super::{PictureLoss, l1, ssim};
use crate::error::RasterError;

/// (1 - λ) L1 + λ (1 - SSIM) and its gradient (O3).
///
/// Source: paper eq. 13, with λ = 0.2 as in 3D Gaussian Splatting. Golden: `losses/photometric_*`.
///
/// # Shapes and units
/// Colours in [0, 1]; `lambda` in [0, 1]; the gradient is by `rendered`.
/// # Numerics
/// As [`l1()`] and [`ssim()`]; the same bits for every `par`.
/// # Errors
/// [`RasterError::SizeMismatch`]; [`RasterError::Lambda`].
pub fn photometric<T: Real>(
    rendered: &Image<[T; 3]>,
    target: &Image<[T; 3]>,
    lambda: f64,
    excluded: Option<&MaskImage>,
    par: Par,
) -> Result<PictureLoss<T>, RasterError> {
    if !(0.0..=1.0).contains(&lambda) {
        return Err(RasterError::Lambda { value: lambda });
    }
    let absolute = l1(rendered, target, excluded)?;
    let structure = ssim(rendered, target, excluded, par)?;
    let pixels = absolute.pixels;
    let (keep, lambda) = (T::from_f64(1.0 - lambda), T::from_f64(lambda));
    // Where nothing is judged SSIM is 0 for want of pixels, not of likeness.
    let unlike = if pixels == 0 {
        T::ZERO
    } else {
        T::ONE - structure.value
    };
    let (width, height) = rendered.size();
    Ok(PictureLoss {
        value: keep * absolute.value + lambda * unlike,
        gradient: Image::from_fn(width, height, |x, y| {
            let (a, s) = (absolute.gradient[(x, y)], structure.gradient[(x, y)]);
            [0, 1, 2].map(|channel| keep * a[channel] - lambda * s[channel])
        }),
        pixels,
    })
}
