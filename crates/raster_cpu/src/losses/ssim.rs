//! [`ssim()`]: structural similarity with its gradient.

use garad_core::{Image, MaskImage, Par, Real};

use super::image_loss::{ImageLoss, check_sizes};
use super::sweep::sweep;
use crate::error::RasterError;

/// Mean structural similarity over included pixels and channels, 1 for equal
/// images, and its gradient by x (O2):
///
/// S = A₁ A₂/(B₁ B₂),  A₁ = 2 μₓ μᵧ + C₁,  A₂ = 2 σₓᵧ + C₂,  B₁ = μₓ² + μᵧ² + C₁,  B₂ = σₓ² + σᵧ² + C₂
///
/// with μ = g∗x, σₓ² = g∗x² - μₓ², σₓᵧ = g∗(xy) - μₓ μᵧ; g an 11x11 Gaussian of sigma 1.5 px and
/// sum 1, zeros outside the image. With m = 1/3n for included pixels and 0 for others,
///
/// ∂/∂x = g∗(m ∂S/∂μₓ) + 2 x g∗(m ∂S/∂(g∗x²)) + y g∗(m ∂S/∂(g∗xy))
///
/// Windows reach over the edge of the mask, so inside it the render is first replaced by the
/// recorded image: excluded pixels have no influence.
///
/// Source: Wang et al. 2004, with the padding of the 3DGS training code; paper eq. 13.
/// Plain form: [`super::reference::ssim`]. Golden: `losses/ssim_*`.
///
/// # Numerics
/// Separable, in `T`; g is symmetric, so its own adjoint. The variances are differences: in f32 S
/// is off by up to 5e-5 where images are flat. Same bits for every `par`.
/// A NaN in an image is one in the value, and in the gradient up to ten pixels away.
/// # Errors
/// [`RasterError::SizeMismatch`].
pub fn ssim<T: Real>(
    rendered: &Image<[T; 3]>,
    target: &Image<[T; 3]>,
    excluded: Option<&MaskImage>,
    par: Par,
) -> Result<ImageLoss<T>, RasterError> {
    check_sizes(rendered.size(), &[("target", target.size())], excluded)?;
    let swept = sweep(rendered, target, excluded, [0.0, 1.0], par);
    Ok(ImageLoss {
        value: T::from_f64(swept.structure),
        gradient: swept.gradient,
        pixels: swept.pixels,
    })
}
