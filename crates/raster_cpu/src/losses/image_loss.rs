//! [`ImageLoss`], and what the losses check and skip.

use garad_core::{Image, MaskImage};

use crate::error::RasterError;
use crate::validate;

/// A number and its gradient by a rendered colour image.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageLoss<T> {
    /// What the function is named after.
    pub value: T,
    /// ∂value/∂(rendered colour).
    pub gradient: Image<[T; 3]>,
    /// Included pixels.
    pub pixels: usize,
}

/// Is the pixel of this index included?
pub(super) fn included(excluded: Option<&MaskImage>, i: usize) -> bool {
    excluded.is_none_or(|mask| mask.data()[i] == 0)
}

/// Number of included pixels, after all images are known to be of one size.
pub(super) fn count_included(excluded: Option<&MaskImage>, pixels: usize) -> usize {
    match excluded {
        Some(mask) => mask.data().iter().filter(|&&value| value == 0).count(),
        None => pixels,
    }
}

/// The weight of SSIM is between 0 and 1.
pub(super) fn check_lambda(lambda: f64) -> Result<(), RasterError> {
    if (0.0..=1.0).contains(&lambda) {
        Ok(())
    } else {
        Err(RasterError::Lambda { value: lambda })
    }
}

/// The named images and the mask have the expected size.
pub(super) fn check_sizes(
    expected: (usize, usize),
    images: &[(&'static str, (usize, usize))],
    excluded: Option<&MaskImage>,
) -> Result<(), RasterError> {
    validate::check_sizes(expected, images)?;
    excluded.map_or(Ok(()), |mask| {
        validate::check_sizes(expected, &[("excluded", mask.size())])
    })
}
