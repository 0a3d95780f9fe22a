//! Errors of this crate.

use thiserror::Error;

/// Invalid input.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum CrfError {
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
    /// A number of a node that is NaN, infinite or outside its range.
    #[error("node {node}: {what} is {value}; expected {expected}")]
    BadNode {
        /// Index of the node.
        node: usize,
        /// Name of the number.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        expected: &'static str,
    },
    /// Two lists that belong together but differ in length.
    #[error("{what}: {got} entries; expected {expected}")]
    SizeMismatch {
        /// The list.
        what: &'static str,
        /// Its length.
        got: usize,
        /// What it should be.
        expected: usize,
    },
    /// Too many nodes to visit all labellings.
    #[error("{got} nodes; at most {limit} can be enumerated")]
    TooManyNodes {
        /// How many came.
        got: usize,
        /// How many would do.
        limit: usize,
    },
}

/// `value` if it passes, or an error with the name of the setting.
pub(crate) fn setting(
    setting: &'static str,
    value: f64,
    expected: &'static str,
    passes: bool,
) -> Result<(), CrfError> {
    if passes {
        Ok(())
    } else {
        Err(CrfError::BadSetting {
            setting,
            value,
            expected,
        })
    }
}
