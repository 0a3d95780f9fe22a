//! [`Archive`]: a recording inside a .tgz, .tar.gz, .tar or .zip, read in place.
//!
//! Nothing is ever unpacked to disk. What kind of archive it is says its content, not its name.
//!
//! - **.zip**, **.tar**: an index is made; each file is read from the archive when asked for.
//! - **.tgz**: gzip has no random access, so the lists and the (still compressed) images are
//!   kept in memory, about the size of the archive itself.
//!
//! Names that climb out (`..`, absolute), links and devices are refused, and so is an archive
//! that unpacks to more than [`limits::ARCHIVE_BYTES`] or grows like a bomb. Entries that a
//! recording cannot refer to (no list, no image) are passed over.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::{Mutex, PoisonError};

use flate2::read::MultiGzDecoder;
use zip::ZipArchive;

use crate::errors::DatasetError;
use crate::limits;
use crate::source::{check_file_size, clean_name, read_at_most};

/// An archive, indexed.
#[derive(Debug)]
pub(crate) struct Archive {
    path: PathBuf,
    /// Folder of `rgb.txt` inside, with a slash at its end; empty at the top.
    root: String,
    files: BTreeMap<String, Stored>,
    zip: Option<Mutex<ZipArchive<BufReader<File>>>>,
}

/// Where the bytes of a file are.
#[derive(Debug)]
enum Stored {
    Memory(Vec<u8>),
    Tar { offset: u64, bytes: u64 },
    Zip { index: usize },
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
            let files = index_zip(path, &archive)?;
            zip = Some(Mutex::new(archive));
            files
        } else if magic.starts_with(b"\x1F\x8B") {
            load_tgz(path, file)?
        } else if magic.get(257..262) == Some(b"ustar") {
            index_tar(path, file)?
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

    /// How a file is called in messages.
    pub(crate) fn locate(&self, name: &str) -> PathBuf {
        self.path.join(format!("{}{name}", self.root))
    }

    /// The bytes of a file; `None` if there is none of that name.
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
                let Some(zip) = &self.zip else {
                    return Ok(None);
                };
                // A panic while reading leaves nothing half-written: the next read seeks anew.
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

fn broken(path: &Path, problem: impl ToString) -> DatasetError {
    DatasetError::Archive {
        path: path.to_path_buf(),
        problem: problem.to_string(),
    }
}

fn too_large(path: &Path, what: &'static str, value: u64, limit: u64) -> DatasetError {
    DatasetError::TooLarge {
        path: path.to_path_buf(),
        what,
        value,
        limit,
    }
}

fn check_ratio(path: &Path, unpacked: u64, packed: u64) -> Result<(), DatasetError> {
    let ratio = unpacked / packed.max(1);
    if unpacked > limits::ARCHIVE_RATIO_FROM_BYTES && ratio > limits::ARCHIVE_RATIO {
        let what = "unpacked bytes per packed byte";
        return Err(too_large(path, what, ratio, limits::ARCHIVE_RATIO));
    }
    Ok(())
}

/// A safe name for an entry, or the error.
fn entry_name(path: &Path, raw: &[u8]) -> Result<String, DatasetError> {
    std::str::from_utf8(raw)
        .ok()
        .and_then(clean_name)
        .ok_or_else(|| DatasetError::UnsafeName {
            path: path.to_path_buf(),
            name: String::from_utf8_lossy(raw).into_owned(),
        })
}

/// Could a recording refer to it?
fn is_wanted(name: &str) -> bool {
    let ending = name.rsplit('.').next().unwrap_or_default();
    ["txt", "toml", "png", "jpg", "jpeg"]
        .iter()
        .any(|wanted| ending.eq_ignore_ascii_case(wanted))
}

/// The folder with both lists; the one nearest the top counts.
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

fn index_zip(
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

fn special(path: &Path, name: &str, kind: &'static str) -> DatasetError {
    DatasetError::SpecialEntry {
        path: path.to_path_buf(),
        name: name.to_owned(),
        kind,
    }
}

fn check_entries(path: &Path, entries: usize) -> Result<(), DatasetError> {
    if entries > limits::ARCHIVE_ENTRIES {
        let limit = limits::ARCHIVE_ENTRIES as u64;
        return Err(too_large(path, "number of entries", entries as u64, limit));
    }
    Ok(())
}

fn index_tar(path: &Path, file: File) -> Result<BTreeMap<String, Stored>, DatasetError> {
    let length = file.metadata().map_err(DatasetError::io(path))?.len();
    let mut archive = tar::Archive::new(BufReader::new(file));
    let entries = archive.entries_with_seek().map_err(|e| broken(path, e))?;
    walk_tar(path, entries, |_, entry| {
        let (offset, bytes) = (entry.raw_file_position(), entry.size());
        // Seeking past the end is no error, so a cut archive has to be noticed here.
        if offset.checked_add(bytes).is_none_or(|end| end > length) {
            return Err(broken(path, "it ends inside a file"));
        }
        Ok(Stored::Tar { offset, bytes })
    })
}

fn load_tgz(path: &Path, file: File) -> Result<BTreeMap<String, Stored>, DatasetError> {
    let packed = Rc::new(Cell::new(0));
    let breach = Rc::new(Cell::new(None));
    let counted = Counted {
        inner: file,
        count: Rc::clone(&packed),
    };
    let capped = Capped {
        inner: MultiGzDecoder::new(BufReader::new(counted)),
        unpacked: 0,
        packed,
        breach: Rc::clone(&breach),
    };
    let mut archive = tar::Archive::new(capped);
    let walk = archive
        .entries()
        .map_err(|e| broken(path, e))
        .and_then(|entries| {
            walk_tar(path, entries, |name, entry| {
                let mut bytes = Vec::new();
                entry.read_to_end(&mut bytes).map_err(|e| broken(path, e))?;
                if bytes.len() as u64 == entry.size() {
                    Ok(Stored::Memory(bytes))
                } else {
                    Err(broken(path, format!("it ends inside {name}")))
                }
            })
        });
    match breach.get() {
        Some((what, value, limit)) => Err(too_large(path, what, value, limit)),
        None => walk,
    }
}

/// Goes through a tar stream entry by entry and stores what a recording can refer to.
///
/// The tar crate's own handling of long names would read them whole, however long they claim to
/// be, so entries are taken raw and the two kinds of long names are read here, with a cap.
fn walk_tar<R: Read>(
    path: &Path,
    entries: tar::Entries<'_, R>,
    mut store: impl FnMut(&str, &mut tar::Entry<'_, R>) -> Result<Stored, DatasetError>,
) -> Result<BTreeMap<String, Stored>, DatasetError> {
    let mut files = BTreeMap::new();
    let mut long_name: Option<Vec<u8>> = None;
    for (index, entry) in entries.raw(true).enumerate() {
        check_entries(path, index)?;
        let mut entry = entry.map_err(|e| broken(path, e))?;
        let kind = entry.header().entry_type();
        if kind.is_pax_global_extensions() || kind.is_gnu_longlink() {
            continue;
        }
        if kind.is_gnu_longname() {
            let mut name = read_long_name(path, &mut entry)?;
            name.truncate(name.iter().position(|&b| b == 0).unwrap_or(name.len()));
            long_name = Some(name);
            continue;
        }
        if kind.is_pax_local_extensions() {
            let record = read_long_name(path, &mut entry)?;
            long_name = pax_path(path, &record)?.or(long_name);
            continue;
        }
        let raw = long_name
            .take()
            .unwrap_or_else(|| entry.header().path_bytes().into_owned());
        if kind.is_dir() && raw.iter().all(|b| b"./".contains(b)) && !raw.starts_with(b"/") {
            continue; // `./`, the top itself
        }
        let name = entry_name(path, &raw)?;
        if kind.is_dir() {
            continue;
        }
        if !kind.is_file() {
            return Err(special(path, &name, tar_kind(kind)));
        }
        if is_wanted(&name) {
            check_file_size(entry.size(), &path.join(&name))?;
            let stored = store(&name, &mut entry)?;
            files.insert(name, stored);
        }
    }
    Ok(files)
}

fn tar_kind(kind: tar::EntryType) -> &'static str {
    if kind.is_symlink() || kind.is_hard_link() {
        "link"
    } else if kind.is_fifo() {
        "pipe"
    } else if kind.is_block_special() || kind.is_character_special() {
        "device"
    } else {
        "special file"
    }
}

fn read_long_name<R: Read>(
    path: &Path,
    entry: &mut tar::Entry<'_, R>,
) -> Result<Vec<u8>, DatasetError> {
    if entry.size() > limits::ARCHIVE_NAME_BYTES {
        let (size, limit) = (entry.size(), limits::ARCHIVE_NAME_BYTES);
        return Err(too_large(path, "bytes of a long name", size, limit));
    }
    let mut bytes = Vec::new();
    entry.read_to_end(&mut bytes).map_err(|e| broken(path, e))?;
    Ok(bytes)
}

/// The `path` of a pax record, if it has one.
fn pax_path(path: &Path, record: &[u8]) -> Result<Option<Vec<u8>>, DatasetError> {
    let mut name = None;
    for extension in tar::PaxExtensions::new(record) {
        let extension = extension.map_err(|e| broken(path, e))?;
        match extension.key_bytes() {
            b"path" => name = Some(extension.value_bytes().to_vec()),
            // A second opinion on the size: needed above 8 GiB alone, and a way to make two
            // readers see two different archives.
            b"size" => return Err(broken(path, "a pax record overrides a size")),
            key if key.starts_with(b"GNU.sparse") => {
                return Err(broken(path, "it holds a sparse file"));
            }
            _ => {}
        }
    }
    Ok(name)
}

/// Counts what is read through it.
struct Counted<R> {
    inner: R,
    count: Rc<Cell<u64>>,
}

impl<R: Read> Read for Counted<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = self.inner.read(buffer)?;
        self.count.set(self.count.get().saturating_add(n as u64));
        Ok(n)
    }
}

/// A measure, its value and its limit.
type Breach = (&'static str, u64, u64);

/// Stops a decoder (not its input: that would cap the wrong side) at the caps of an archive.
struct Capped<R> {
    inner: R,
    unpacked: u64,
    packed: Rc<Cell<u64>>,
    breach: Rc<Cell<Option<Breach>>>,
}

impl<R: Read> Read for Capped<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let n = self.inner.read(buffer)?;
        self.unpacked = self.unpacked.saturating_add(n as u64);
        let ratio = self.unpacked / self.packed.get().max(1);
        let breach = if self.unpacked > limits::ARCHIVE_BYTES {
            let limit = limits::ARCHIVE_BYTES;
            Some(("unpacked size in bytes", self.unpacked, limit))
        } else if self.unpacked > limits::ARCHIVE_RATIO_FROM_BYTES && ratio > limits::ARCHIVE_RATIO
        {
            let limit = limits::ARCHIVE_RATIO;
            Some(("unpacked bytes per packed byte", ratio, limit))
        } else {
            return Ok(n);
        };
        self.breach.set(breach);
        Err(io::Error::other("above the limits of an archive"))
    }
}
