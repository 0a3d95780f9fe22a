//! Files that are written whole or not at all.

use std::ffi::OsString;
use std::fs::{self, File};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};

use crate::errors::DatasetError;

/// Writes a file under a temporary name in the same folder, then renames it: a reader sees the old
/// content or the new, never a part of it, also when the disk fills up or the run is stopped. A device or a
/// pipe, such as `/dev/stdout`, is not replaced but written to.
///
/// # Errors
/// [`DatasetError::Io`] from the file system or from `write`; nothing is left behind then.
pub fn write_atomically(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<(), DatasetError> {
    let attempt = || {
        if fs::metadata(path).is_ok_and(|there| !there.is_file() && !there.is_dir()) {
            let mut out = BufWriter::new(File::options().write(true).open(path)?);
            return write(&mut out).and_then(|()| out.flush());
        }
        let temporary = temporary_name(path)?;
        let mut out = BufWriter::new(File::create(&temporary)?);
        let written = write(&mut out)
            .and_then(|()| out.into_inner().map_err(io::IntoInnerError::into_error))
            .and_then(|file| file.sync_all())
            .and_then(|()| fs::rename(&temporary, path));
        if written.is_err() {
            // The first error is the one to report.
            let _ = fs::remove_file(&temporary);
        }
        written
    };
    attempt().map_err(DatasetError::io(path))
}

/// `.NAME.partPID` in the folder of the file: renaming works within one file system only, and no other
/// running process writes to that name.
fn temporary_name(path: &Path) -> io::Result<PathBuf> {
    let no_name = || io::Error::new(ErrorKind::InvalidInput, "no file name");
    let name = path.file_name().ok_or_else(no_name)?;
    let mut hidden = OsString::from(".");
    hidden.push(name);
    hidden.push(format!(".part{}", std::process::id()));
    Ok(path.with_file_name(hidden))
}

/// Of the name of a temporary file of [`write_atomically`]: the name of the file it was to become, and the
/// process that wrote it.
#[must_use]
pub fn temporary_of(name: &str) -> Option<(&str, u32)> {
    let (file, process) = name.strip_prefix('.')?.rsplit_once(".part")?;
    Some((file, process.parse().ok()?))
}

/// All bytes to one file; see [`write_atomically`].
///
/// # Errors
/// [`DatasetError::Io`].
pub fn write_bytes_atomically(path: &Path, bytes: &[u8]) -> Result<(), DatasetError> {
    write_atomically(path, |out| out.write_all(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_old_content_stays_until_the_new_is_whole() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("trajectory.txt");
        write_bytes_atomically(&path, b"old").expect("written");
        let failed = write_atomically(&path, |out| {
            out.write_all(b"half")?;
            Err(io::Error::other("disk full"))
        });
        let message = failed.expect_err("refused").to_string();
        assert!(
            message.contains("trajectory.txt") && message.contains("disk full"),
            "{message}"
        );
        assert_eq!(fs::read(&path).expect("there"), b"old", "untouched");
        write_bytes_atomically(&path, b"new").expect("written");
        assert_eq!(fs::read(&path).expect("there"), b"new", "replaced");
        let left = fs::read_dir(folder.path()).expect("listed").count();
        assert_eq!(left, 1, "nothing else is left behind");
    }

    #[test]
    fn names_of_temporary_files() {
        let temporary = temporary_name(Path::new("out/map.ply")).expect("a name");
        let name = temporary.file_name().and_then(|name| name.to_str());
        let expected = Some(("map.ply", std::process::id()));
        assert_eq!(temporary_of(name.expect("UTF-8")), expected, "read back");
        for other in ["map.ply", "map.ply.part7", ".map.ply", ".map.ply.partial"] {
            assert_eq!(temporary_of(other), None, "{other}");
        }
    }

    #[test]
    fn a_folder_that_does_not_exist_is_an_error() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("nowhere/file");
        assert!(
            matches!(
                write_bytes_atomically(&path, b""),
                Err(DatasetError::Io { .. })
            ),
            "no folder"
        );
    }
}
