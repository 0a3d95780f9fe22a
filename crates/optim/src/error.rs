//! [`OptimError`]: what makes an optimisation impossible. Not converging is no error, see
//! [`crate::lm::StopReason`].

use thiserror::Error;

/// Invalid input.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum OptimError {
    /// Fewer observations than determine the unknowns.
    #[error("{got} observations; at least {needed} are needed")]
    TooFewObservations {
        /// Given.
        got: usize,
        /// Needed.
        needed: usize,
    },
    /// NaN or infinite.
    #[error("{what} {index} is not finite")]
    NotFinite {
        /// Kind of input.
        what: &'static str,
        /// Which of them.
        index: usize,
    },
    /// A standard deviation or baseline that is not positive.
    #[error("{what} {index} is {value}; expected a positive number")]
    NotPositive {
        /// Kind of input.
        what: &'static str,
        /// Which of them.
        index: usize,
        /// Its value.
        value: f64,
    },
    /// An observation of a pose or point that does not exist.
    #[error("observation {index} refers to {what} {target}; there are {count}")]
    OutOfRange {
        /// Pose or point.
        what: &'static str,
        /// The observation.
        index: usize,
        /// What it refers to.
        target: usize,
        /// How many there are.
        count: usize,
    },
    /// Two lists that must be of one length.
    #[error("{what}: {got} entries; expected {expected}")]
    SizeMismatch {
        /// The list.
        what: &'static str,
        /// Its length.
        got: usize,
        /// The length it must have.
        expected: usize,
    },
}

/// Finite and above 0, or an error with its name.
pub(crate) fn positive(what: &'static str, index: usize, value: f64) -> Result<(), OptimError> {
    if !value.is_finite() {
        Err(OptimError::NotFinite { what, index })
    } else if value <= 0.0 {
        Err(OptimError::NotPositive { what, index, value })
    } else {
        Ok(())
    }
}
