//! What the fuzz targets share: a limit on the heap, folders for readers of files, and what every error
//! message must be.

use std::alloc::System;
use std::fs;
use std::path::Path;

use cap::Cap;
use garad_dataset::{Dataset, DatasetError, OpenOptions};
use tempfile::TempDir;

#[global_allocator]
static HEAP: Cap<System> = Cap::new(System, usize::MAX);

/// A camera of 8 x 6 pixels, the size of the images in `seeds/`.
pub const CAMERA: &str = "8 6 10 11 3.5 2.5 5000 30\n";

/// Runs a reader with at most this much heap on top of what is in use. An allocation beyond it aborts.
pub fn within_mib<T>(mib: usize, read: impl FnOnce() -> T) -> T {
    let limit = HEAP.allocated() + (mib << 20);
    HEAP.set_limit(limit).expect("more than is in use");
    let answer = read();
    HEAP.set_limit(usize::MAX).expect("no limit");
    answer
}

/// A new folder, in memory where the system has `/dev/shm`.
pub fn folder() -> TempDir {
    let memory = Path::new("/dev/shm");
    let made = match memory.is_dir() {
        true => tempfile::tempdir_in(memory),
        false => tempfile::tempdir(),
    };
    made.expect("a temporary folder")
}

/// A folder with these files.
pub fn folder_of(files: &[(&str, &[u8])]) -> TempDir {
    let folder = folder();
    for (name, bytes) in files {
        write(folder.path(), name, bytes);
    }
    folder
}

/// Writes a file, and the folder it is in.
pub fn write(folder: &Path, name: &str, bytes: &[u8]) {
    let path = folder.join(name);
    fs::create_dir_all(path.parent().expect("inside a folder")).expect("made");
    fs::write(path, bytes).expect("written");
}

/// An error is one line that says where.
///
/// # Panics
/// Otherwise.
pub fn check_line(message: &str, place: &str) {
    assert!(!message.contains('\n'), "several lines: {message:?}");
    assert!(message.contains(place), "not in {place}: {message}");
}

/// [`check_line`] of an error about this recording or file.
///
/// # Panics
/// As [`check_line`].
pub fn check_error(error: &DatasetError, path: &Path) {
    check_line(&error.to_string(), &path.display().to_string());
}

/// Opens a recording as the program does, and checks the error if there is one.
pub fn open(path: &Path, strict: bool) -> Option<Dataset> {
    let options = OpenOptions {
        strict,
        ..OpenOptions::default()
    };
    let opened = Dataset::open(path, &options);
    opened.inspect_err(|error| check_error(error, path)).ok()
}
