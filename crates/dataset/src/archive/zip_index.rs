//! The index of a zip archive.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

use zip::ZipArchive;

use super::entry::{Stored, broken, check_entries, entry_name, is_wanted, special, too_large};
use crate::errors::DatasetError;
use crate::files::check_file_size;
use crate::limits;

/// Finds the files of a zip; they are read from it on demand.
pub(super) fn index_zip(
    path: &Path,
    archive: &ZipArchive<BufReader<File>>,
) -> Result<BTreeMap<String, Stored>, DatasetError> {
    check_entries(path, archive.len())?;
    let mut files = BTreeMap::new();
    let mut total = 0u64;
    for index in 0..archive.len() {
        let entry = archive.by_index_data(index).map_err(|e| broken(path, e))?;
        let name = entry_name(path, entry.name_raw())?;
        // The upper bits of a Unix mode say what kind of file it is; 0 where there is none.
        match entry.unix_mode().unwrap_or(0) & 0o170_000 {
            0 | 0o100_000 | 0o040_000 => {}
            kind => return Err(special(path, &name, unix_kind(kind))),
        }
        if entry.is_dir() || !is_wanted(&name) {
            continue;
        }
        if entry.encrypted() {
            return Err(special(path, &name, "encrypted file"));
        }
        check_file_size(entry.size(), &path.join(&name))?;
        total = total.saturating_add(entry.size());
        if total > limits::ARCHIVE_BYTES {
            return Err(too_large(
                path,
                "unpacked size in bytes",
                total,
                limits::ARCHIVE_BYTES,
            ));
        }
        files.insert(name, Stored::Zip { index });
    }
    Ok(files)
}

fn unix_kind(mode: u32) -> &'static str {
    match mode {
        0o120_000 => "link",
        0o010_000 => "pipe",
        0o020_000 | 0o060_000 => "device",
        _ => "special file",
    }
}
