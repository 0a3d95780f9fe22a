//! Errors of this crate.

use thiserror::Error;

/// Invalid input.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum FeatureError {
    /// A setting outside its range.
    #[error("{setting} is {value}; expected {expected}")]
    BadSetting {
        /// Its name.
        setting: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        expected: &'static str,
    },
    /// An image without pixels.
    #[error("the image is {width} x {height}; expected at least one pixel")]
    EmptyImage {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// Two images, pyramids or lists that belong together but differ in size.
    #[error("{what} differ: {left:?} and {right:?}")]
    SizeMismatch {
        /// What was compared.
        what: &'static str,
        /// One size.
        left: (usize, usize),
        /// The other.
        right: (usize, usize),
    },
    /// Fewer correspondences than the method needs.
    #[error("{got} correspondences; expected at least {needed}")]
    TooFewPoints {
        /// How many came.
        got: usize,
        /// How many are needed.
        needed: usize,
    },
    /// Points that do not determine the result (all equal, all on a line, no parallax, NaN).
    #[error("degenerate input: {reason}")]
    Degenerate {
        /// The reason.
        reason: &'static str,
    },
}

/// [`FeatureError::BadSetting`] unless `passes`.
pub(crate) fn setting(
    setting: &'static str,
    value: f64,
    expected: &'static str,
    passes: bool,
) -> Result<(), FeatureError> {
    passes.then_some(()).ok_or(FeatureError::BadSetting {
        setting,
        value,
        expected,
    })
}
