//! [`SessionError`].

use std::io;

use thiserror::Error;

use crate::io::SlamError;

/// Number of the format; to be raised with every change of what is written or in which order.
pub const FORMAT: u32 = 10;

/// The version of this program.
pub const PROGRAM: &str = env!("CARGO_PKG_VERSION");

/// Why a session cannot be written or read.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum SessionError {
    /// From reading or writing.
    #[error(transparent)]
    Io(#[from] io::Error),
    /// Not the beginning of a session.
    #[error("not a session of garad; expected it to begin with `garad session`")]
    Foreign,
    /// An older or newer format.
    #[error("a session of format {saved}; expected format {FORMAT}, which garad {PROGRAM} writes")]
    Format {
        /// Its number.
        saved: u32,
    },
    /// Written by another version: the rest of the run would not have the bits of the first part.
    #[error("saved by garad {saved}; expected garad {PROGRAM}, which is running")]
    Program {
        /// The version that wrote it.
        saved: String,
    },
    /// The data end too early.
    #[error("the session ends in section `{section}`; expected more, the file was cut off")]
    Truncated {
        /// Where.
        section: &'static str,
    },
    /// A checksum or a name that is not the one expected.
    #[error("section `{section}` is damaged; expected other bytes by its checksum or its name")]
    Damaged {
        /// Which.
        section: &'static str,
    },
    /// A value that cannot be encoded or decoded.
    #[error("section `{section}`: {source}")]
    Value {
        /// Which.
        section: &'static str,
        /// What is wrong.
        source: postcard::Error,
    },
    /// The run to be resumed has other settings.
    #[error("{what}: the session has {saved}, this run {given}; expected the same")]
    Differs {
        /// The field.
        what: String,
        /// Its value in the session.
        saved: String,
        /// Its value now.
        given: String,
    },
    /// An invalid state.
    #[error(transparent)]
    Slam(#[from] SlamError),
}
