//! Tar archives, plain and gzipped, entry by entry and within the limits.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;
use std::rc::Rc;

use flate2::read::MultiGzDecoder;

use super::entry::{Stored, broken, check_entries, entry_name, is_wanted, special, too_large};
use crate::errors::DatasetError;
use crate::files::check_file_size;
use crate::limits;

/// Finds the files of a plain tar; they are read from it on demand.
pub(super) fn index_tar(path: &Path, file: File) -> Result<BTreeMap<String, Stored>, DatasetError> {
    let length = file.metadata().map_err(DatasetError::io(path))?.len();
    let mut archive = tar::Archive::new(BufReader::new(file));
    let entries = archive.entries_with_seek().map_err(|e| broken(path, e))?;
    walk_tar(path, entries, length, |_, entry| {
        let (offset, bytes) = (entry.raw_file_position(), entry.size());
        Ok(Stored::Tar { offset, bytes })
    })
}

/// Unpacks the files of a gzipped tar that a recording can refer to into memory.
pub(super) fn load_tgz(path: &Path, file: File) -> Result<BTreeMap<String, Stored>, DatasetError> {
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
            // Where this stream ends is not known; reading and skipping notice it.
            walk_tar(path, entries, u64::MAX, |name, entry| {
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

/// Stores the entries of a tar stream of at most `length` bytes that a recording can refer to.
///
/// The tar crate reads long names of any claimed length, so entries are taken raw and the two kinds of
/// long names are read here, with a limit.
fn walk_tar<R: Read>(
    path: &Path,
    entries: tar::Entries<'_, R>,
    length: u64,
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
        let wanted = is_wanted(&name);
        if wanted {
            check_file_size(entry.size(), &path.join(&name))?;
        }
        // Seeking past the end is not an error, so a truncated archive must be found here.
        let end = entry.raw_file_position().checked_add(entry.size());
        if end.is_none_or(|end| end > length) {
            return Err(broken(path, "it ends inside a file"));
        }
        if wanted {
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
            // Needed only above 8 GiB, and a way to make two readers see different archives.
            b"size" => return Err(broken(path, "a pax record overrides a size")),
            key if key.starts_with(b"GNU.sparse") => {
                return Err(broken(path, "it holds a sparse file"));
            }
            _ => {}
        }
    }
    Ok(name)
}

/// Counts the bytes read through it.
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

/// Stops a decoder at the limits of an archive, by its output.
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
