//! [`Source`]: the files of a recording, in a folder or in an archive.

use std::fs;
use std::path::{Path, PathBuf};

use crate::archive::Archive;
use crate::decode::{Origin, probe_colour};
use crate::errors::DatasetError;
use crate::files::read_file;

/// Where the files come from. Names are relative to the folder of the recording.
#[derive(Debug)]
pub(crate) enum Source {
    Folder(PathBuf),
    Archive(Archive),
}

impl Source {
    /// Goes into a folder of an archive.
    pub(crate) fn enter(&mut self, folder: &str) {
        if let Self::Archive(archive) = self {
            archive.enter(folder);
        }
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

    /// A file of the recording or of the folder above it, with its path.
    ///
    /// # Errors
    /// Those of [`Source::read`].
    pub(crate) fn read_here_or_above(
        &self,
        name: &str,
    ) -> Result<Option<(PathBuf, Vec<u8>)>, DatasetError> {
        if let Some(bytes) = self.read(name)? {
            return Ok(Some((self.locate(name), bytes)));
        }
        match self {
            Self::Folder(path) => {
                // `.` has a folder above, too.
                let whole = fs::canonicalize(path).map_err(DatasetError::io(path))?;
                let Some(above) = whole.parent().map(|above| above.join(name)) else {
                    return Ok(None);
                };
                Ok(read_file(&above)?.map(|bytes| (above, bytes)))
            }
            Self::Archive(archive) => archive.read_above(name),
        }
    }

    /// Whether there is a file of this (clean) name.
    pub(crate) fn has_file(&self, name: &str) -> bool {
        match self {
            Self::Folder(path) => path.join(name).is_file(),
            Self::Archive(archive) => archive.has_file(name),
        }
    }

    /// Names of the files in a folder, ascending, without those below it; of the recording's own for an empty name.
    /// Empty without such a folder.
    pub(crate) fn files_in(&self, folder: &str) -> Vec<String> {
        match self {
            Self::Folder(path) => {
                let entries = fs::read_dir(path.join(folder)).into_iter().flatten();
                let mut names: Vec<String> = entries
                    .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
                    .collect();
                names.sort();
                names
            }
            Self::Archive(archive) => archive.files_in(folder),
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

/// Size of an image by its header; `None` if it does not exist.
pub(crate) fn image_size(
    source: &Source,
    file: &str,
) -> Result<Option<(usize, usize)>, DatasetError> {
    let path = source.locate(file);
    let origin = Origin {
        frame: None,
        path: &path,
    };
    let bytes = source.read(file)?;
    bytes
        .map(|bytes| probe_colour(&bytes, origin).map(|kind| kind.size))
        .transpose()
}
