//! How far a picture is from the recorded one, and the gradient of that by the picture (O1 to O5).
//!
//! Reading order: [`l1()`] → [`ssim()`] → [`photometric()`], their mix (eq. 13) → [`depth_l1`] →
//! [`opacity_penalty`]. The gradients are what [`crate::Upstream`] is filled with. SSIM is computed
//! in two ways: plainly in [`mod@reference`], and in one sweep over the rows, which is what runs.
//!
//! Pixels that are not 0 in `excluded` (moving or unknown) are not judged. If none is left, value
//! and gradient are 0: nothing is asked of the picture. Values are summed in f64 in an order that
//! is fixed, whatever `T` is.

mod depth;
mod l1;
mod opacity;
mod photometric;
pub mod reference;
mod ssim;
mod sweep;

pub use depth::{DepthLoss, depth_l1};
pub use l1::l1;
pub use opacity::{OpacityPenalty, opacity_penalty};
pub use photometric::photometric;
pub use ssim::ssim;

use garad_core::{Image, MaskImage};

use crate::error::RasterError;

/// A number and its gradient by a rendered colour picture.
#[derive(Debug, Clone, PartialEq)]
pub struct PictureLoss<T> {
    /// What the function is named after.
    pub value: T,
    /// ∂value/∂(rendered colour).
    pub gradient: Image<[T; 3]>,
    /// Pixels judged.
    pub pixels: usize,
}

/// Is the pixel of this index judged?
fn judged(excluded: Option<&MaskImage>, i: usize) -> bool {
    excluded.is_none_or(|mask| mask.data()[i] == 0)
}

/// Number of judged pixels, after all pictures are known to be of one size.
fn count(excluded: Option<&MaskImage>, pixels: usize) -> usize {
    match excluded {
        Some(mask) => mask.data().iter().filter(|&&value| value == 0).count(),
        None => pixels,
    }
}

/// The weight of SSIM is a share.
fn check_lambda(lambda: f64) -> Result<(), RasterError> {
    if (0.0..=1.0).contains(&lambda) {
        Ok(())
    } else {
        Err(RasterError::Lambda { value: lambda })
    }
}

/// Every picture has the size of the first.
fn check_sizes(
    expected: (usize, usize),
    pictures: &[(&'static str, (usize, usize))],
    excluded: Option<&MaskImage>,
) -> Result<(), RasterError> {
    let mask = excluded.map(|mask| ("excluded", mask.size()));
    for &(picture, got) in pictures.iter().chain(&mask) {
        if got != expected {
            return Err(RasterError::SizeMismatch {
                picture,
                expected,
                got,
            });
        }
    }
    Ok(())
}
