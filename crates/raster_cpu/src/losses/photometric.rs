//! [`photometric()`]: the picture's part of the training loss.

use garad_core::{Image, MaskImage, Par, Real};

use super::sweep::sweep;
use super::{PictureLoss, check_lambda, check_sizes};
use crate::error::RasterError;

/// (1 - λ) L1 + λ (1 - SSIM) and its gradient (O3).
///
/// Source: paper eq. 13, with λ = 0.2 as in 3D Gaussian Splatting.
/// Plain form: [`super::reference::photometric`]. Golden: `losses/photometric_*`.
///
/// # Shapes and units
/// Colours in [0, 1]; `lambda` in [0, 1]; the gradient is by `rendered`.
/// # Numerics
/// As [`super::l1()`] and [`super::ssim()`], in one sweep; the same bits for every `par`, with and
/// without AVX. In f32, on smooth shading with noise of 0.02, the value is off by 1e-6 and the
/// gradient by 2e-4 of its largest element (the plain form: 4e-7 and 1e-4).
/// # Errors
/// [`RasterError::SizeMismatch`]; [`RasterError::Lambda`].
pub fn photometric<T: Real>(
    rendered: &Image<[T; 3]>,
    target: &Image<[T; 3]>,
    lambda: f64,
    excluded: Option<&MaskImage>,
    par: Par,
) -> Result<PictureLoss<T>, RasterError> {
    check_lambda(lambda)?;
    check_sizes(rendered.size(), &[("target", target.size())], excluded)?;
    let swept = sweep(rendered, target, excluded, [1.0 - lambda, -lambda], par);
    // Where nothing is judged SSIM is 0 for want of pixels, not of likeness.
    let unlike = if swept.pixels == 0 {
        0.0
    } else {
        1.0 - swept.structure
    };
    Ok(PictureLoss {
        value: T::from_f64((1.0 - lambda) * swept.absolute + lambda * unlike),
        gradient: swept.gradient,
        pixels: swept.pixels,
    })
}
