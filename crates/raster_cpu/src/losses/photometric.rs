//! [`photometric()`]: the training loss of an image.

use garad_core::{Image, MaskImage, Par, Real};

use super::image_loss::{ImageLoss, check_lambda, check_sizes};
use super::sweep::sweep;
use crate::error::RasterError;

/// The photometric loss of a rendered image and its gradient.
///
/// L_p-ssim = (1 - λ) |I_r - I_gt| + λ (1 - SSIM(I_r, I_gt))                            (Eq. 13, O3)
///
/// Source: the paper, with λ = 0.2 as in 3D Gaussian Splatting; |·| is the mean of [`super::l1()`].
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
) -> Result<ImageLoss<T>, RasterError> {
    check_lambda(lambda)?;
    check_sizes(rendered.size(), &[("target", target.size())], excluded)?;
    let swept = sweep(rendered, target, excluded, [1.0 - lambda, -lambda], par);
    let absolute = swept.absolute;
    // Without pixels the loss is 0.
    let ssim = if swept.pixels == 0 {
        1.0
    } else {
        swept.structure
    };
    Ok(ImageLoss {
        value: T::from_f64((1.0 - lambda) * absolute + lambda * (1.0 - ssim)),
        gradient: swept.gradient,
        pixels: swept.pixels,
    })
}
