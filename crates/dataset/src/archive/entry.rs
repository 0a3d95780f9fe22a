//! Entries of an archive: where their bytes are, which are wanted, which are refused.

use std::path::Path;

use crate::errors::DatasetError;
use crate::files::clean_name;
use crate::limits;

/// Where the bytes of a file are.
#[derive(Debug)]
pub(super) enum Stored {
    Memory(Vec<u8>),
    Tar { offset: u64, bytes: u64 },
    Zip { index: usize },
}

/// Messages of the readers may quote names with control characters.
pub(super) fn broken(path: &Path, problem: impl ToString) -> DatasetError {
    DatasetError::Archive {
        path: path.to_path_buf(),
        problem: problem.to_string().replace(char::is_control, " "),
    }
}

pub(super) fn too_large(path: &Path, what: &'static str, value: u64, limit: u64) -> DatasetError {
    DatasetError::TooLarge {
        path: path.to_path_buf(),
        what,
        value,
        limit,
    }
}

pub(super) fn check_ratio(path: &Path, unpacked: u64, packed: u64) -> Result<(), DatasetError> {
    let ratio = unpacked / packed.max(1);
    if unpacked > limits::ARCHIVE_RATIO_FROM_BYTES && ratio > limits::ARCHIVE_RATIO {
        let what = "unpacked bytes per packed byte";
        return Err(too_large(path, what, ratio, limits::ARCHIVE_RATIO));
    }
    Ok(())
}

/// A safe name for an entry, or the error.
pub(super) fn entry_name(path: &Path, raw: &[u8]) -> Result<String, DatasetError> {
    std::str::from_utf8(raw)
        .ok()
        .and_then(clean_name)
        .ok_or_else(|| DatasetError::UnsafeName {
            path: path.to_path_buf(),
            name: String::from_utf8_lossy(raw).into_owned(),
        })
}

/// Endings of lists, cameras, poses and images.
const WANTED: [&str; 8] = [
    "txt", "toml", "json", "log", "freiburg", "png", "jpg", "jpeg",
];

/// Whether a recording can refer to a file of this name.
pub(super) fn is_wanted(name: &str) -> bool {
    let ending = name.rsplit('.').next().unwrap_or_default();
    WANTED
        .iter()
        .any(|wanted| ending.eq_ignore_ascii_case(wanted))
}

pub(super) fn special(path: &Path, name: &str, kind: &'static str) -> DatasetError {
    DatasetError::SpecialEntry {
        path: path.to_path_buf(),
        name: name.to_owned(),
        kind,
    }
}

pub(super) fn check_entries(path: &Path, entries: usize) -> Result<(), DatasetError> {
    if entries > limits::ARCHIVE_ENTRIES {
        let limit = limits::ARCHIVE_ENTRIES as u64;
        return Err(too_large(path, "number of entries", entries as u64, limit));
    }
    Ok(())
}
