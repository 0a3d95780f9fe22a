//! A recording found: its files, and which layout they have.

use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use super::{ALL, Layout, detect};
use crate::archive::{Archive, depth_of};
use crate::errors::DatasetError;
use crate::source::Source;

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
        match detect(&source) {
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
        for layout in ALL {
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
            let layout = detect(&Self::Folder(path.clone()))?;
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
