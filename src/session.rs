//! A session on disk: a folder that holds the state of a run and a page about it (decision 008).
//!
//! | file | what |
//! |---|---|
//! | `session.json` | which program, which recording, how far, what is in the map, and which file holds the state |
//! | `state-a.bin` or `state-b.bin` | the state: of the system, then of the run |
//!
//! A new state is written beside the old one; then `session.json` is replaced, in one step, and names the
//! new; then the old one goes. At every moment there is a whole session in the folder, once there has
//! been one.

use std::fs::{self, File};
use std::io::{self, BufReader, ErrorKind};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use garad_core::{Camera, DepthImage, MaskImage, RgbImage};
use garad_dataset::{write_atomically, write_bytes_atomically};
use garad_slam::session::{FORMAT, PROGRAM};
use serde::{Deserialize, Serialize};

use crate::runner::Run;

/// The page.
const HEADER: &str = "session.json";
/// The two names of a state; `session.json` says which is meant.
const STATES: [&str; 2] = ["state-a.bin", "state-b.bin"];

/// What `session.json` says. Only `state` is read again; what counts is in the state, under its
/// checksums.
#[derive(Debug, Serialize, Deserialize)]
pub struct Header {
    /// Number of the format.
    pub format: u32,
    /// Version of garad.
    pub program: String,
    /// Name of the recording.
    pub recording: String,
    /// Frames of it that are done, those left out included.
    pub frames_done: usize,
    /// Of these with a pose.
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

/// What a recording is known by: the times of the frames that are done, and what the first and the last
/// of them show. Its name may change.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Recording {
    /// Name, for messages.
    pub name: String,
    /// Masks were given (`--oracle-labels`).
    pub given_masks: bool,
    /// Times of the frames that are done, seconds.
    pub times_s: Vec<f64>,
    /// [`fingerprint`] of the first and the last of them; `None` if it cannot be read.
    pub pictures: [Option<u32>; 2],
}

/// CRC-32 of a frame's pictures.
#[must_use]
pub fn fingerprint(rgb: &RgbImage, depth: &DepthImage, mask: Option<&MaskImage>) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(rgb.data().as_flattened());
    for row in 0..depth.height() {
        let bytes: Vec<u8> = depth
            .row(row)
            .iter()
            .flat_map(|z| z.to_le_bytes())
            .collect();
        hasher.update(&bytes);
    }
    if let Some(mask) = mask {
        hasher.update(mask.data());
    }
    hasher.finalize()
}

impl Recording {
    /// Checks that this is the recording `given` now. `given` has the times of all its frames.
    ///
    /// # Errors
    /// The first thing in which they differ.
    pub fn check(&self, given: &Self) -> Result<()> {
        let done = self.times_s.len();
        if self.given_masks != given.given_masks {
            let [saved, now] = [self.given_masks, given.given_masks]
                .map(|masks| if masks { "with" } else { "without" });
            bail!("--oracle-labels: the session was made {saved}, this run is {now}");
        }
        if given.times_s.len() < done {
            bail!(
                "recording `{}`: {} frames are to be run, but {done} are already done; expected the \
                 --first-frame of then, and no smaller --max-frames",
                given.name,
                given.times_s.len()
            );
        }
        for (i, (then, now)) in self.times_s.iter().zip(&given.times_s).enumerate() {
            if then.to_bits() != now.to_bits() {
                bail!(
                    "recording `{}`: frame {i} is at {now:.6} s; expected {then:.6} s as in `{}`, \
                     which the session was made from",
                    given.name,
                    self.name
                );
            }
        }
        let ends = [0, done.saturating_sub(1)];
        for ((then, now), i) in self.pictures.iter().zip(given.pictures).zip(ends) {
            if *then != now {
                bail!(
                    "recording `{}`: frame {i} shows something else than that of `{}`, which the \
                     session was made from; expected the same pictures",
                    given.name,
                    self.name
                );
            }
        }
        Ok(())
    }
}

/// Checks, before the work whose state it is to hold, that a session may be written here: in a new or empty
/// folder, or over an older session.
///
/// # Errors
/// A folder that holds something else, or cannot be made.
pub fn prepare(folder: &Path) -> Result<()> {
    fs::create_dir_all(folder)
        .with_context(|| format!("{}: cannot make the folder", folder.display()))?;
    let mut entries = fs::read_dir(folder)
        .with_context(|| format!("{}: cannot read the folder", folder.display()))?;
    if entries.next().is_some() && header(folder).is_err() {
        bail!(
            "{}: holds files but no session; expected a new folder, an empty one or an older session",
            folder.display()
        );
    }
    Ok(())
}

/// Writes the state of a run, in place of an older one.
///
/// # Errors
/// What cannot be written; the older session, if there is one, is then as it was.
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
        gaussians: slam.gaussians().map_or(0, garad_core::GaussianMap::len),
        seed: slam.seed(),
        camera: *slam.camera(),
        state: state.to_owned(),
    };
    let text = serde_json::to_string_pretty(&header)? + "\n";
    write_bytes_atomically(&folder.join(HEADER), text.as_bytes())?;
    for name in STATES.into_iter().filter(|name| *name != state) {
        match fs::remove_file(folder.join(name)) {
            Err(error) if error.kind() != ErrorKind::NotFound => {
                // It takes room and does no harm: the next save writes over it.
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

/// Opens the state of a session. The path names it in messages.
///
/// # Errors
/// No session here, one of another version, or a file that cannot be read.
pub fn open(folder: &Path) -> Result<(BufReader<File>, PathBuf)> {
    let header = header(folder)?;
    if (header.format, header.program.as_str()) != (FORMAT, PROGRAM) {
        bail!(
            "{}: saved by garad {} in format {}; expected garad {PROGRAM} and format {FORMAT}, which \
             are running",
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

/// The page about a session.
///
/// # Errors
/// None here, or one that cannot be read.
pub fn header(folder: &Path) -> Result<Header> {
    let path = folder.join(HEADER);
    let text = fs::read_to_string(&path).with_context(|| {
        format!(
            "{}: cannot be read; expected a folder made by `garad run --save-session`",
            path.display()
        )
    })?;
    serde_json::from_str(&text)
        .with_context(|| format!("{}: expected the page about a session", path.display()))
}
