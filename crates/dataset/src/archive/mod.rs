//! [`Archive`]: a recording inside a .tgz, .tar.gz, .tar or .zip, read in place.
//!
//! Nothing is unpacked to disk. The kind of archive is recognised by its content, not its name.
//!
//! - **.zip**, **.tar**: an index is made; each file is read from the archive on demand.
//! - **.tgz**: gzip has no random access, so the lists and the (still compressed) images are
//!   kept in memory, about the size of the archive itself.
//!
//! Names that lead outside (`..`, absolute), links and devices are refused, and so is an archive that
//! unpacks to more than [`ARCHIVE_BYTES`](crate::limits::ARCHIVE_BYTES) or by more than
//! [`ARCHIVE_RATIO`](crate::limits::ARCHIVE_RATIO). Entries that a recording cannot refer to (neither list
//! nor image) are skipped.

mod entry;
mod tar_stream;
mod zip_index;

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use zip::ZipArchive;

use self::entry::{Stored, broken, check_ratio};
use crate::errors::DatasetError;
use crate::files::read_at_most;

/// An archive, indexed.
#[derive(Debug)]
pub(crate) struct Archive {
    path: PathBuf,
    /// Folder of the recording inside, with a slash at its end; empty at the top.
    root: String,
    files: BTreeMap<String, Stored>,
    zip: Option<Mutex<ZipArchive<BufReader<File>>>>,
}

impl Archive {
    /// # Errors
    /// [`DatasetError::Archive`], [`DatasetError::UnsafeName`], [`DatasetError::SpecialEntry`],
    /// [`DatasetError::TooLarge`], and [`DatasetError::NotARecording`] for another kind of file.
    /// [`Archive::enter`] then chooses the folder.
    pub(crate) fn open(path: &Path) -> Result<Self, DatasetError> {
        if !path.is_file() {
            return Err(DatasetError::NotARecording {
                path: path.to_path_buf(),
                found: "neither a folder nor a file".to_owned(),
            });
        }
        let mut file = File::open(path).map_err(DatasetError::io(path))?;
        let mut magic = Vec::new();
        file.by_ref()
            .take(262)
            .read_to_end(&mut magic)
            .and_then(|_| file.seek(SeekFrom::Start(0)))
            .map_err(DatasetError::io(path))?;
        let mut zip = None;
        let files = if magic.starts_with(b"PK\x03\x04") || magic.starts_with(b"PK\x05\x06") {
            let archive = ZipArchive::new(BufReader::new(file)).map_err(|e| broken(path, e))?;
            let files = zip_index::index_zip(path, &archive)?;
            zip = Some(Mutex::new(archive));
            files
        } else if magic.starts_with(b"\x1F\x8B") {
            tar_stream::load_tgz(path, file)?
        } else if magic.get(257..262) == Some(b"ustar") {
            tar_stream::index_tar(path, file)?
        } else {
            return Err(DatasetError::NotARecording {
                path: path.to_path_buf(),
                found: "a file that is neither gzip, zip nor tar".to_owned(),
            });
        };
        Ok(Self {
            root: String::new(),
            path: path.to_path_buf(),
            files,
            zip,
        })
    }

    /// Name of the folder inside, or of the archive without its endings.
    pub(crate) fn name(&self) -> String {
        let folder = self.root.trim_end_matches('/');
        if let Some(last) = folder.rsplit('/').next().filter(|last| !last.is_empty()) {
            return last.to_owned();
        }
        let file = self.path.file_name().unwrap_or_default().to_string_lossy();
        let stem = [".tar.gz", ".tgz", ".tar", ".zip"]
            .iter()
            .find_map(|ending| file.strip_suffix(ending));
        stem.unwrap_or(&file).to_owned()
    }

    /// The path of a file, for messages.
    pub(crate) fn locate(&self, name: &str) -> PathBuf {
        self.path.join(format!("{}{name}", self.root))
    }

    /// All folders inside, as [`Archive::enter`] takes them: those nearest to the top first.
    pub(crate) fn folders(&self) -> Vec<String> {
        let mut folders = BTreeSet::from([String::new()]);
        for name in self.files.keys() {
            let mut rest = name.as_str();
            while let Some((folder, _)) = rest.rsplit_once('/') {
                if !folders.insert(format!("{folder}/")) {
                    break;
                }
                rest = folder;
            }
        }
        let mut folders: Vec<String> = folders.into_iter().collect();
        folders.sort_by_key(|folder| depth_of(folder));
        folders
    }

    /// Takes the files of this folder for the recording.
    pub(crate) fn enter(&mut self, folder: &str) {
        folder.clone_into(&mut self.root);
    }

    /// Whether there is such a file.
    pub(crate) fn has_file(&self, name: &str) -> bool {
        self.files.contains_key(&format!("{}{name}", self.root))
    }

    /// Names of the files in a folder, without those below it; of the recording's own for an empty name.
    pub(crate) fn files_in(&self, folder: &str) -> Vec<String> {
        let start = match folder {
            "" => self.root.clone(),
            folder => format!("{}{folder}/", self.root),
        };
        let mut names = Vec::new();
        let mut from = start.clone();
        while let Some((file, _)) = self.files.range(from..).next() {
            let Some(name) = file.strip_prefix(&start) else {
                break;
            };
            from = match name.split_once('/') {
                // Past everything below: `0` comes after `/`.
                Some((below, _)) => format!("{start}{below}0"),
                None => {
                    names.push(name.to_owned());
                    format!("{file}\0")
                }
            };
        }
        names
    }

    /// A file in the folder above the recording's.
    pub(crate) fn read_above(
        &self,
        name: &str,
    ) -> Result<Option<(PathBuf, Vec<u8>)>, DatasetError> {
        let Some(folder) = self.root.strip_suffix('/') else {
            return Ok(None);
        };
        let above = folder.rsplit_once('/').map_or("", |(above, _)| above);
        let file = match above {
            "" => name.to_owned(),
            above => format!("{above}/{name}"),
        };
        let bytes = self.read_entry(&file)?;
        Ok(bytes.map(|bytes| (self.path.join(file), bytes)))
    }

    /// Whether there is a file in a folder of this name, or below it.
    pub(crate) fn has_folder(&self, name: &str) -> bool {
        let start = format!("{}{name}/", self.root);
        let mut from_there = self.files.range(start.clone()..);
        from_there
            .next()
            .is_some_and(|(file, _)| file.starts_with(&start))
    }

    /// The bytes of a file; `None` if it does not exist.
    pub(crate) fn read(&self, name: &str) -> Result<Option<Vec<u8>>, DatasetError> {
        self.read_entry(&format!("{}{name}", self.root))
    }

    /// The bytes of the entry of this whole name.
    fn read_entry(&self, name: &str) -> Result<Option<Vec<u8>>, DatasetError> {
        let path = self.path.join(name);
        match self.files.get(name) {
            None => Ok(None),
            Some(Stored::Memory(bytes)) => Ok(Some(bytes.clone())),
            Some(&Stored::Tar { offset, bytes }) => {
                let mut file = File::open(&self.path).map_err(DatasetError::io(&self.path))?;
                file.seek(SeekFrom::Start(offset))
                    .map_err(DatasetError::io(&self.path))?;
                read_at_most(file.take(bytes), &path).map(Some)
            }
            Some(&Stored::Zip { index }) => {
                let zip = self
                    .zip
                    .as_ref()
                    .expect("zip entries come from a zip archive");
                // A panic while reading leaves a valid archive: the next read seeks anew.
                let mut zip = zip.lock().unwrap_or_else(PoisonError::into_inner);
                let entry = zip.by_index(index).map_err(|e| broken(&self.path, e))?;
                let packed = entry.compressed_size();
                let bytes = read_at_most(entry, &path)?;
                check_ratio(&self.path, bytes.len() as u64, packed)?;
                Ok(Some(bytes))
            }
        }
    }
}

/// Folders between this one, with a slash at its end, and the top.
pub(crate) fn depth_of(folder: &str) -> usize {
    folder.matches('/').count()
}
