//! [`Source`]: the files of a recording, in a folder or in an archive.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use crate::archive::{Archive, depth_of};
use crate::decode::{Origin, probe_colour};
use crate::errors::DatasetError;
use crate::files::read_file;
use crate::layout::{self, Layout};

/// Where the files come from. Names are relative to the folder of the recording.
#[derive(Debug)]
pub(crate) enum Source {
    Folder(PathBuf),
    Archive(Archive),
}

/// Folders of a folder that are looked into, to say that one of them is the recording.
const NEAR: usize = 100;

impl Source {
    /// The files and their layout.
    ///
    /// # Errors
    /// [`DatasetError::NotFound`]; [`DatasetError::NotARecording`] for a folder without a layout, and for an
    /// archive unless one folder of it alone has one, nearer to the top than others; the errors of
    /// [`Archive::open`].
    pub(crate) fn open(path: &Path) -> Result<(Self, &'static dyn Layout), DatasetError> {
        let meta = fs::metadata(path).map_err(|source| match source.kind() {
            ErrorKind::NotFound => DatasetError::NotFound {
                path: path.to_path_buf(),
                expected: "a folder or archive of a recording",
            },
            _ => DatasetError::io(path)(source),
        })?;
        if !meta.is_dir() {
            return Self::open_archive(path);
        }
        let source = Self::Folder(path.to_path_buf());
        match layout::detect(&source) {
            Some(layout) => Ok((source, layout)),
            None => Err(DatasetError::NotARecording {
                path: path.to_path_buf(),
                found: source.what_is_missing(),
            }),
        }
    }

    fn open_archive(path: &Path) -> Result<(Self, &'static dyn Layout), DatasetError> {
        let not_a_recording = |found: String| DatasetError::NotARecording {
            path: path.to_path_buf(),
            found,
        };
        let archive = Archive::open(path)?;
        let folders = archive.folders();
        let mut source = Self::Archive(archive);
        for layout in layout::ALL {
            let mut found: Vec<&String> = Vec::new();
            for folder in &folders {
                if found
                    .first()
                    .is_some_and(|at| depth_of(at) < depth_of(folder))
                {
                    break;
                }
                source.enter(folder);
                if layout.matches(&source) {
                    found.push(folder);
                }
            }
            match found[..] {
                [] => {}
                [folder] => {
                    source.enter(folder);
                    return Ok((source, layout));
                }
                [a, b, ..] => {
                    let found = format!("an archive of several recordings, {a} and {b}");
                    return Err(not_a_recording(found));
                }
            }
        }
        Err(not_a_recording(
            "an archive without a folder that holds rgb.txt and depth.txt, or another layout"
                .to_owned(),
        ))
    }

    fn enter(&mut self, folder: &str) {
        if let Self::Archive(archive) = self {
            archive.enter(folder);
        }
    }

    /// Why a folder is no recording, and the folders inside that are.
    fn what_is_missing(&self) -> String {
        let list = match self.has_file("rgb.txt") {
            true => "depth.txt",
            false => "rgb.txt",
        };
        let Self::Folder(path) = self else {
            return format!("an archive without {list}");
        };
        let mut below: Vec<PathBuf> = fs::read_dir(path)
            .into_iter()
            .flatten()
            .filter_map(|entry| Some(entry.ok()?.path()))
            .filter(|path| path.is_dir())
            .take(NEAR)
            .collect();
        below.sort();
        let recording = below.into_iter().find_map(|path| {
            let layout = layout::detect(&Self::Folder(path.clone()))?;
            Some((path, layout))
        });
        match recording {
            Some((path, layout)) => format!(
                "a folder without {list}, but {} is a recording ({})",
                path.display(),
                layout.name()
            ),
            None => format!("a folder without {list}"),
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
        let (source, layout) = Source::open(folder.path()).expect("enough to open");
        assert_eq!(layout.name(), "TUM or BONN", "of its lists");
        assert!(
            source.read("rgb/1.png").expect("no fault").is_none(),
            "absent"
        );
        assert_eq!(source.read("rgb.txt").expect("there"), Some(Vec::new()));
    }
}
