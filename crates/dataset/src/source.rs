//! [`Source`]: the files of a recording, in a folder or in an archive.

use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};

use crate::archive::Archive;
use crate::errors::DatasetError;
use crate::limits;

/// Where the files come from. Names are relative to the place of `rgb.txt`.
#[derive(Debug)]
pub(crate) enum Source {
    Folder(PathBuf),
    Archive(Archive),
}

impl Source {
    /// # Errors
    /// [`DatasetError::NotFound`], [`DatasetError::NotARecording`] without `rgb.txt` and
    /// `depth.txt`, and what [`Archive::open`] finds.
    pub(crate) fn open(path: &Path) -> Result<Self, DatasetError> {
        let meta = fs::metadata(path).map_err(|source| match source.kind() {
            std::io::ErrorKind::NotFound => DatasetError::NotFound {
                path: path.to_path_buf(),
                expected: "a folder or archive of a TUM or BONN recording",
            },
            _ => DatasetError::io(path)(source),
        })?;
        if !meta.is_dir() {
            return Archive::open(path).map(Self::Archive);
        }
        for list in ["rgb.txt", "depth.txt"] {
            if !path.join(list).is_file() {
                return Err(DatasetError::NotARecording {
                    path: path.to_path_buf(),
                    found: format!("a folder without {list}"),
                });
            }
        }
        Ok(Self::Folder(path.to_path_buf()))
    }

    /// Name of the recording: of its folder, in an archive too.
    pub(crate) fn name(&self) -> String {
        let last = |path: &Path| {
            path.file_name()
                .map(|name| name.to_string_lossy().into_owned())
        };
        match self {
            // `.` and `..` have no name of their own.
            Self::Folder(path) => last(path)
                .or_else(|| last(&fs::canonicalize(path).ok()?))
                .unwrap_or_default(),
            Self::Archive(archive) => archive.name(),
        }
    }

    /// How a file is called in messages.
    pub(crate) fn locate(&self, name: &str) -> PathBuf {
        match self {
            Self::Folder(path) => path.join(name),
            Self::Archive(archive) => archive.locate(name),
        }
    }

    /// The bytes of a file; `None` if there is none of that name.
    ///
    /// # Errors
    /// [`DatasetError::TooLarge`], [`DatasetError::Io`], [`DatasetError::Archive`].
    pub(crate) fn read(&self, name: &str) -> Result<Option<Vec<u8>>, DatasetError> {
        match self {
            Self::Folder(path) => read_file(&path.join(name)),
            Self::Archive(archive) => archive.read(name),
        }
    }

    /// Whether there is a folder of this (clean) name; in an archive, one with files in it.
    pub(crate) fn has_folder(&self, name: &str) -> bool {
        match self {
            Self::Folder(path) => path.join(name).is_dir(),
            Self::Archive(archive) => archive.has_folder(name),
        }
    }
}

/// The bytes of a regular file of at most [`limits::FILE_BYTES`]; `None` if there is none.
///
/// Links are followed: a folder on disk is the user's own, and recordings are often linked from
/// another disk. Devices and pipes are not opened.
pub(crate) fn read_file(path: &Path) -> Result<Option<Vec<u8>>, DatasetError> {
    match fs::metadata(path) {
        Ok(meta) if meta.is_file() => check_file_size(meta.len(), path)?,
        Ok(_) => return Ok(None),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
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

/// [`limits::FILE_BYTES`] as an error.
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

/// The relative path `name` without empty and `.` parts; `None` if it climbs out, is absolute,
/// empty, or uses signs that mean something else on another system (`\`, `:`, controls).
pub(crate) fn clean_name(name: &str) -> Option<String> {
    let odd = |c: char| c == '\\' || c == ':' || c.is_control();
    if name.starts_with('/') || name.contains(odd) {
        return None;
    }
    let parts: Vec<&str> = name
        .split('/')
        .filter(|part| !part.is_empty() && *part != ".")
        .collect();
    (!parts.is_empty() && !parts.contains(&"..")).then(|| parts.join("/"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_stay_inside() {
        assert_eq!(clean_name("./rgb//1.png").as_deref(), Some("rgb/1.png"));
        assert_eq!(
            clean_name("a..b/...").as_deref(),
            Some("a..b/..."),
            "just dots"
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
            "a\\b",
            "C:a",
            "a\0",
        ] {
            assert_eq!(clean_name(bad), None, "{bad:?}");
        }
    }

    #[test]
    fn folders_need_both_lists() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let message = |path: &Path| Source::open(path).expect_err("no recording").to_string();
        assert!(
            message(folder.path()).contains("without rgb.txt"),
            "empty folder"
        );
        fs::write(folder.path().join("rgb.txt"), "").expect("written");
        assert!(
            message(folder.path()).contains("without depth.txt"),
            "half a recording"
        );
        assert!(
            message(&folder.path().join("nowhere")).contains("not found"),
            "missing folder"
        );
        fs::write(folder.path().join("depth.txt"), "").expect("written");
        let source = Source::open(folder.path()).expect("enough to open");
        assert!(
            source.read("rgb/1.png").expect("no fault").is_none(),
            "absent"
        );
        assert_eq!(source.read("rgb.txt").expect("there"), Some(Vec::new()));
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
