//! [`GoldenError`]: what is wrong with a case, or with an answer to it.

use std::path::PathBuf;

use thiserror::Error;

use crate::compare::CountMismatch;
use crate::npy::NpyError;

/// What is wrong with a case, or with an answer to it.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum GoldenError {
    /// A file cannot be read.
    #[error("{}: {source}", path.display())]
    Io {
        /// File.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file larger than any case's.
    #[error("{}: {bytes} bytes; at most {limit} are read", path.display())]
    TooLarge {
        /// File.
        path: PathBuf,
        /// Its size.
        bytes: u64,
        /// What is allowed.
        limit: u64,
    },
    /// `case.json` is not what it should be.
    #[error("{}: {source}", path.display())]
    Json {
        /// File.
        path: PathBuf,
        /// Where and why.
        source: serde_json::Error,
    },
    /// A schema this version does not know.
    #[error("{}: schema {found}; expected 1", path.display())]
    Schema {
        /// File.
        path: PathBuf,
        /// Its schema.
        found: u32,
    },
    /// A `.npy` file that cannot be used.
    #[error("{}: {source}", path.display())]
    Npy {
        /// File.
        path: PathBuf,
        /// Why.
        source: NpyError,
    },
    /// A tensor whose description and content disagree.
    #[error("{}: tensor '{tensor}': {problem}", path.display())]
    Tensor {
        /// The case's `case.json`.
        path: PathBuf,
        /// Name.
        tensor: String,
        /// What disagrees.
        problem: String,
    },
    /// An answer for an output the case does not have, or in a tolerance the table does not have.
    #[error("{case}: no {kind} '{name}'; there is {known}")]
    Unknown {
        /// Name of the case.
        case: String,
        /// Input, output, parameter or tolerance.
        kind: &'static str,
        /// Asked for.
        name: String,
        /// The names there are.
        known: String,
    },
    /// An answer of the wrong size.
    #[error("{case}: output '{name}': {source}")]
    Count {
        /// Name of the case.
        case: String,
        /// Output.
        name: String,
        /// The two counts.
        source: CountMismatch,
    },
}
