//! Folders and files of text.

use std::path::Path;

use anyhow::{Context, Result};
use garad_dataset::write_bytes_atomically;

/// Makes a folder for results, with those above it.
///
/// # Errors
/// The path, and why not.
pub fn make_folder(path: &Path) -> Result<()> {
    std::fs::create_dir_all(path)
        .with_context(|| format!("{}: cannot make the folder", path.display()))
}

pub(super) fn write_text(path: &Path, text: &str) -> Result<()> {
    Ok(write_bytes_atomically(path, text.as_bytes())?)
}
