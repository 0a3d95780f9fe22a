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

use std::collections::BTreeMap;
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
    /// Folder of `rgb.txt` inside, with a slash at its end; empty at the top.
    root: String,
    files: BTreeMap<String, Stored>,
    zip: Option<Mutex<ZipArchive<BufReader<File>>>>,
}

impl Archive {
    /// # Errors
    /// [`DatasetError::Archive`], [`DatasetError::UnsafeName`], [`DatasetError::SpecialEntry`],
    /// [`DatasetError::TooLarge`], and [`DatasetError::NotARecording`] unless exactly one
    /// folder inside holds `rgb.txt` and `depth.txt`.
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
            root: find_root(path, &files)?,
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
        match self.files.get(&format!("{}{name}", self.root)) {
            None => Ok(None),
            Some(Stored::Memory(bytes)) => Ok(Some(bytes.clone())),
            Some(&Stored::Tar { offset, bytes }) => {
                let mut file = File::open(&self.path).map_err(DatasetError::io(&self.path))?;
                file.seek(SeekFrom::Start(offset))
                    .map_err(DatasetError::io(&self.path))?;
                read_at_most(file.take(bytes), &self.locate(name)).map(Some)
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
                let bytes = read_at_most(entry, &self.locate(name))?;
                check_ratio(&self.path, bytes.len() as u64, packed)?;
                Ok(Some(bytes))
            }
        }
    }
}

/// The folder with both lists, nearest to the top.
fn find_root(path: &Path, files: &BTreeMap<String, Stored>) -> Result<String, DatasetError> {
    let not_a_recording = |found: String| DatasetError::NotARecording {
        path: path.to_path_buf(),
        found,
    };
    let mut roots: Vec<&str> = files
        .keys()
        .filter_map(|name| name.strip_suffix("rgb.txt"))
        .filter(|root| root.is_empty() || root.ends_with('/'))
        .filter(|root| files.contains_key(&format!("{root}depth.txt")))
        .collect();
    roots.sort_by_key(|root| root.matches('/').count());
    match roots[..] {
        [] => Err(not_a_recording(
            "an archive without a folder that holds rgb.txt and depth.txt".to_owned(),
        )),
        [a, b, ..] if a.matches('/').count() == b.matches('/').count() => Err(not_a_recording(
            format!("an archive of several recordings, {a} and {b}"),
        )),
        [root, ..] => Ok(root.to_owned()),
    }
}
