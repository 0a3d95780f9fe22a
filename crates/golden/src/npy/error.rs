//! [`NpyError`].

use thiserror::Error;

/// Why bytes are not a `.npy` file that golden cases use.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum NpyError {
    /// No `\x93NUMPY` at the start.
    #[error("not a .npy file: the first six bytes are not \\x93NUMPY")]
    Magic,
    /// A version other than 1.0.
    #[error(".npy version {major}.{minor}; expected 1.0")]
    Version {
        /// Found.
        major: u8,
        /// Found.
        minor: u8,
    },
    /// The file ends inside the header.
    #[error("header of {claimed} bytes, but {there} are there")]
    Truncated {
        /// Bytes the file says its header has.
        claimed: usize,
        /// Bytes left.
        there: usize,
    },
    /// The header is not the dict expected.
    #[error("header: expected {expected} at byte {at}")]
    Header {
        /// What should have stood there.
        expected: &'static str,
        /// Position in the header.
        at: usize,
    },
    /// An element type golden cases do not use, big-endian ones among them.
    #[error("element type '{descr}' is not one of <f4 <f8 |i1 |u1 <i2 <u2 <i4 <u4 <i8 |b1")]
    Dtype {
        /// numpy's descriptor.
        descr: String,
    },
    /// `fortran_order: True`.
    #[error("Fortran order; expected C order")]
    FortranOrder,
    /// The shape asks for another number of bytes than the file holds.
    #[error("shape {shape:?} of '{descr}' does not have the {there} bytes that are there")]
    Size {
        /// Claimed.
        shape: Vec<usize>,
        /// Claimed.
        descr: &'static str,
        /// Bytes after the header.
        there: usize,
    },
    /// A whole number that f64, in which all numbers are compared, does not hold exactly.
    #[error("{value} at position {at}; expected whole numbers of at most 2^53")]
    Inexact {
        /// Flat position.
        at: usize,
        /// The number.
        value: i64,
    },
    /// A bool that is neither 0 nor 1.
    #[error("bool at position {at} has the value {value}")]
    Bool {
        /// Flat position.
        at: usize,
        /// Its byte.
        value: u8,
    },
}
