//! [`EvalError`]: inputs that cannot be evaluated.

use thiserror::Error;

/// Why a figure cannot be computed.
#[derive(Debug, Clone, PartialEq, Error)]
pub enum EvalError {
    /// Fewer elements than the figure needs.
    #[error("{got} {what}, at least {needed} are needed")]
    TooFew {
        /// What is counted.
        what: &'static str,
        /// Their number.
        got: usize,
        /// The smallest valid number.
        needed: usize,
    },
    /// No estimate has a ground-truth pose near it in time.
    #[error(
        "no pair of poses within {max_dt_s} s: ground truth covers [{}, {}] s, the estimate [{}, {}] s",
        ground_truth_s.0, ground_truth_s.1, estimate_s.0, estimate_s.1
    )]
    NoPairs {
        /// Largest time difference allowed.
        max_dt_s: f64,
        /// First and last time of the ground truth (NaN when empty).
        ground_truth_s: (f64, f64),
        /// First and last time of the estimate (NaN when empty).
        estimate_s: (f64, f64),
    },
    /// A time is NaN or infinite, or goes back.
    #[error("{trajectory}: time {t_s} s of pose {index} is not finite or before its predecessor")]
    Times {
        /// "ground truth" or "estimate".
        trajectory: &'static str,
        /// The first bad pose.
        index: usize,
        /// Its time.
        t_s: f64,
    },
    /// A pose or point holds NaN or an infinity.
    #[error("{what} {index} is not finite")]
    NonFinite {
        /// What the list contains.
        what: &'static str,
        /// The first bad element.
        index: usize,
    },
    /// Two lists or images that should have one size.
    #[error("{what}: expected {expected:?}, got {got:?}")]
    SizeMismatch {
        /// What is compared.
        what: &'static str,
        /// Size of the first (columns, rows; or count, 1).
        expected: (usize, usize),
        /// Size of the second.
        got: (usize, usize),
    },
    /// No motion in one trajectory follows the other: the scale is undetermined.
    #[error(
        "scale is undetermined: the estimate or the reference is at rest; expected motion in both, or no alignment of scale"
    )]
    ScaleUndetermined,
    /// The plotting library failed.
    #[error("drawing a plot: {0}")]
    Plot(String),
    /// An option that is not a positive finite number.
    #[error("{name} = {value}: expected a positive finite number")]
    Option {
        /// The option.
        name: &'static str,
        /// Its value.
        value: f64,
    },
}
