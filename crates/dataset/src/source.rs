//! [`Source`]: the files of a recording, in a folder or in an archive.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::archive::Archive;
use crate::errors::DatasetError;
use crate::files::read_file;

/// Where the files come from. Names are relative to the folder of `rgb.txt`.
#[derive(Debug)]
pub(crate) enum Source {
    Folder(PathBuf),
    Archive(Archive),
}

impl Source {
    /// # Errors
    /// [`DatasetError::NotFound`], [`DatasetError::NotARecording`] without `rgb.txt` and
    /// `depth.txt`, and the errors of [`Archive::open`].
    pub(crate) fn open(path: &Path) -> Result<Self, DatasetError> {
        let meta = fs::metadata(path).map_err(|source| match source.kind() {
            ErrorKind::NotFound => DatasetError::NotFound {
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

    /// The path of a file, for messages.
    pub(crate) fn locate(&self, name: &str) -> PathBuf {
        match self {
            Self::Folder(path) => path.join(name),
            Self::Archive(archive) => archive.locate(name),
        }
    }

    /// The bytes of a file; `None` if it does not exist.
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

#[cfg(test)]
mod tests {
    use super::*;

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
}
