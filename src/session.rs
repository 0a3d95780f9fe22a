//! A session on disk: a folder with the state of a run and a header (decision 008).
//!
//! | file | what |
//! |---|---|
//! | `session.json` | header: program, recording, progress, size of the map, name of the file with the state |
//! | `state-a.bin` or `state-b.bin` | the state: of the system, then of the run |
//!
//! A new state is written beside the old one; then `session.json` is replaced atomically and names the new
//! one; then the old one is removed. After the first save the folder holds a complete session at any time.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{self, BufReader, ErrorKind};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use garad_core::{Camera, GaussianMap};
use garad_dataset::{temporary_of, write_atomically, write_bytes_atomically};
use garad_slam::session::{FORMAT, PROGRAM};
use serde::{Deserialize, Serialize};

use crate::output::{make_folder, try_folder};
use crate::recording::Recording;
use crate::run::Run;

/// File name of the header.
const HEADER: &str = "session.json";
/// The two names of a state; `session.json` says which is valid.
const STATES: [&str; 2] = ["state-a.bin", "state-b.bin"];

/// Content of `session.json`. Only `format`, `program` and `state` are read again; all else is in the
/// state, under its checksums.
#[derive(Debug, Serialize, Deserialize)]
pub struct Header {
    /// Number of the format.
    pub format: u32,
    /// Version of garad.
    pub program: String,
    /// Name of the recording.
    pub recording: String,
    /// Frames of it that are done, skipped ones included.
    pub frames_done: usize,
    /// Frames with a pose.
    pub tracked: usize,
    /// Keyframes of the map.
    pub keyframes: usize,
    /// Landmarks of the map.
    pub landmarks: usize,
    /// Gaussians of the map.
    pub gaussians: usize,
    /// Seed of the run.
    pub seed: u64,
    /// The camera.
    pub camera: Camera,
    /// The file beside this one that holds the state.
    pub state: String,
}

/// Checks, before the run, that a session may be written here: in a new or empty folder, or over an older
/// session.
///
/// # Errors
/// A folder that holds other files, or cannot be made or written.
pub fn prepare(folder: &Path) -> Result<()> {
    make_folder(folder)?;
    let mut entries = fs::read_dir(folder)
        .with_context(|| format!("{}: cannot read the folder", folder.display()))?;
    let other =
        |entry: io::Result<fs::DirEntry>| !entry.is_ok_and(|e| is_unfinished(&e.file_name()));
    if entries.any(other) && header(folder).is_err() {
        bail!(
            "{}: holds files but no session; expected a new folder, an empty one or an older session",
            folder.display()
        );
    }
    try_folder(folder)
}

/// A file that a first save left behind which was cut off before it wrote the header.
fn is_unfinished(name: &OsStr) -> bool {
    let Some(name) = name.to_str() else {
        return false;
    };
    let (file, temporary) = temporary_of(name).map_or((name, false), |(file, _)| (file, true));
    STATES.contains(&file) || (temporary && file == HEADER)
}

/// Writes the state of a run, in place of an older one.
///
/// # Errors
/// A failed write; an older session is then unchanged.
pub fn save(folder: &Path, run: &mut Run, recording: &Recording) -> Result<()> {
    prepare(folder)?;
    let older = header(folder).ok().map(|header| header.state);
    let state = STATES
        .into_iter()
        .find(|name| older.as_deref() != Some(name))
        .unwrap_or(STATES[0]);
    write_atomically(&folder.join(state), |out| {
        run.save(out, recording).map_err(io::Error::other)
    })?;
    let slam = run.slam();
    let header = Header {
        format: FORMAT,
        program: PROGRAM.to_owned(),
        recording: recording.name.clone(),
        frames_done: run.done(),
        tracked: slam.trajectory().len(),
        keyframes: slam.map().keyframes().len(),
        landmarks: slam.map().landmarks().count(),
        gaussians: slam.gaussians().map_or(0, GaussianMap::len),
        seed: slam.seed(),
        camera: *slam.camera(),
        state: state.to_owned(),
    };
    let text = serde_json::to_string_pretty(&header)? + "\n";
    write_bytes_atomically(&folder.join(HEADER), text.as_bytes())?;
    for name in STATES.into_iter().filter(|name| *name != state) {
        match fs::remove_file(folder.join(name)) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                // It only takes space: the next save overwrites it.
                tracing::warn!(
                    "{}: cannot be removed: {error}",
                    folder.join(name).display()
                );
            }
            _ => {}
        }
    }
    Ok(())
}

/// Opens the state of a session. The path is for messages.
///
/// # Errors
/// No session in the folder, one of another version, or a file that cannot be read.
pub fn open(folder: &Path) -> Result<(BufReader<File>, PathBuf)> {
    let header = header(folder)?;
    if (header.format, header.program.as_str()) != (FORMAT, PROGRAM) {
        bail!(
            "{}: saved by garad {} in format {}; expected garad {PROGRAM} and format {FORMAT}",
            folder.join(HEADER).display(),
            header.program,
            header.format
        );
    }
    if !STATES.contains(&header.state.as_str()) {
        bail!(
            "{}: the state is in `{}`; expected {} or {}",
            folder.join(HEADER).display(),
            header.state,
            STATES[0],
            STATES[1]
        );
    }
    let path = folder.join(&header.state);
    let file = File::open(&path).with_context(|| format!("{}: cannot be read", path.display()))?;
    Ok((BufReader::with_capacity(1 << 20, file), path))
}

/// Reads the header of a session.
///
/// # Errors
/// No session in the folder, or a header that cannot be read.
pub fn header(folder: &Path) -> Result<Header> {
    let path = folder.join(HEADER);
    let text = fs::read_to_string(&path).with_context(|| {
        format!(
            "{}: cannot be read; expected a folder made by `garad run --save-session`",
            path.display()
        )
    })?;
    serde_json::from_str(&text)
        .with_context(|| format!("{}: expected the header of a session", path.display()))
}
