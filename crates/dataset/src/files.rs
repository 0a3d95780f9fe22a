//! Names and sizes of files, checked before they are used.

use std::fs::{self, File};
use std::io::{ErrorKind, Read};
use std::path::Path;

use crate::errors::DatasetError;
use crate::limits;

/// The bytes of a regular file of at most [`limits::FILE_BYTES`]; `None` if it does not exist.
///
/// Links are followed: a folder on disk is trusted, and recordings are often linked from another disk.
/// Devices and pipes are not opened.
pub(crate) fn read_file(path: &Path) -> Result<Option<Vec<u8>>, DatasetError> {
    match fs::metadata(path) {
        Ok(meta) if meta.is_file() => check_file_size(meta.len(), path)?,
        Ok(_) => return Ok(None),
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(DatasetError::io(path)(error)),
    }
    let file = File::open(path).map_err(DatasetError::io(path))?;
    read_at_most(file, path).map(Some)
}

/// Reads to the end, but not past [`limits::FILE_BYTES`].
pub(crate) fn read_at_most(reader: impl Read, path: &Path) -> Result<Vec<u8>, DatasetError> {
    let mut bytes = Vec::new();
    reader
        .take(limits::FILE_BYTES + 1)
        .read_to_end(&mut bytes)
        .map_err(DatasetError::io(path))?;
    check_file_size(bytes.len() as u64, path)?;
    Ok(bytes)
}

/// [`DatasetError::TooLarge`] above [`limits::FILE_BYTES`].
pub(crate) fn check_file_size(bytes: u64, path: &Path) -> Result<(), DatasetError> {
    if bytes > limits::FILE_BYTES {
        return Err(DatasetError::TooLarge {
            path: path.to_path_buf(),
            what: "size in bytes",
            value: bytes,
            limit: limits::FILE_BYTES,
        });
    }
    Ok(())
}

/// What [`clean_name`] takes, for messages.
pub(crate) const CLEAN_NAME: &str = "a relative path without `..` and `:`";

/// The relative path `name`, separated by `/`, without empty and `.` parts; `\`, as Windows writes it, separates,
/// too. `None` if it contains `..`, is absolute, empty, or contains characters that are special on another system
/// (`:`, controls).
pub(crate) fn clean_name(name: &str) -> Option<String> {
    let odd = |c: char| c == ':' || c.is_control();
    let separators = ['/', '\\'];
    if name.starts_with(separators) || name.contains(odd) {
        return None;
    }
    let parts: Vec<&str> = name
        .split(separators)
        .filter(|part| !part.is_empty() && *part != ".")
        .collect();
    (!parts.is_empty() && !parts.contains(&"..")).then(|| parts.join("/"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unsafe_names_are_refused() {
        assert_eq!(clean_name("./rgb//1.png").as_deref(), Some("rgb/1.png"));
        assert_eq!(
            clean_name("a..b/...").as_deref(),
            Some("a..b/..."),
            "just dots"
        );
        assert_eq!(
            clean_name("rgb\\.\\1.png").as_deref(),
            Some("rgb/1.png"),
            "from Windows"
        );
        for bad in [
            "",
            ".",
            "/",
            "/a",
            "..",
            "a/..",
            "../a",
            "a/../../b",
            "\\a",
            "\\\\server\\a",
            "a\\..\\..\\b",
            "C:a",
            "C:\\a",
            "a\0",
        ] {
            assert_eq!(clean_name(bad), None, "{bad:?}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn devices_are_not_opened() {
        // Reading /dev/zero would not end.
        assert!(
            read_file(Path::new("/dev/zero"))
                .expect("no fault")
                .is_none(),
            "a device"
        );
    }
}
