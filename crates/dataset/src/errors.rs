//! [`DatasetError`]: what can be wrong with a recording, each with file, line or frame and what
//! was expected instead.

use std::io;
use std::path::{Path, PathBuf};

use garad_core::CameraError;
use thiserror::Error;

/// The input's fault. Every message is one line and names where and what was expected.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum DatasetError {
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Its reason.
        source: io::Error,
    },
    /// Nothing lies there.
    #[error("{}: not found; expected {expected}", path.display())]
    NotFound {
        /// The place.
        path: PathBuf,
        /// What should be there.
        expected: &'static str,
    },
    /// A folder or archive that is no recording.
    #[error("{}: {found}; expected a TUM or BONN recording, that is a folder with rgb.txt and depth.txt, or a .tgz, .tar.gz, .tar or .zip of one", path.display())]
    NotARecording {
        /// The folder or archive.
        path: PathBuf,
        /// What is missing or odd.
        found: String,
    },
    /// A line of a text file that cannot be read.
    #[error("{}:{line}: found {found}; expected {expected}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What stands there.
        found: String,
        /// What should.
        expected: &'static str,
    },
    /// A number of a calibration that cannot be.
    #[error("{}:{line}: {source}", path.display())]
    Camera {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// Which number.
        source: CameraError,
    },
    /// A list without entries.
    #[error("{}: lists no image; expected lines `timestamp filename`", path.display())]
    EmptyList {
        /// The file.
        path: PathBuf,
    },
    /// No colour image has a depth image close enough in time.
    #[error("{}: none of {colour} colour images has one of {depth} depth images within {max_dt_s} s (the closest are {closest_s:.6} s apart)", path.display())]
    NoPairs {
        /// The recording.
        path: PathBuf,
        /// Colour images listed.
        colour: usize,
        /// Depth images listed.
        depth: usize,
        /// The window.
        max_dt_s: f64,
        /// The smallest difference found.
        closest_s: f64,
    },
    /// The options leave no frame, or one past the end was asked for.
    #[error("{}: frame {frame} asked for; there are {len} frames, counted from 0", path.display())]
    NoSuchFrame {
        /// The recording.
        path: PathBuf,
        /// The frame.
        frame: usize,
        /// How many there are.
        len: usize,
    },
    /// An option that makes no sense.
    #[error("{option} is {value}; expected {expected}")]
    Option {
        /// Which.
        option: &'static str,
        /// Its value.
        value: String,
        /// What it may be.
        expected: &'static str,
    },
    /// Nothing says what camera it was.
    #[error("{}: camera unknown; expected a calibration file, a preset ({presets}), a camera.txt in the recording, or one of those names in the recording's", path.display())]
    NoCalibration {
        /// The recording.
        path: PathBuf,
        /// Names of the presets.
        presets: &'static str,
    },
    /// A preset that does not exist.
    #[error("preset {name:?} is unknown; expected one of {presets}")]
    UnknownPreset {
        /// What was asked for.
        name: String,
        /// What exists.
        presets: &'static str,
    },
    /// Larger than what is read.
    #[error("{}: {what} is {value}; expected at most {limit}", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Which measure.
        what: &'static str,
        /// Its value.
        value: u64,
        /// The cap, see [`crate::limits`].
        limit: u64,
    },
    /// A name that leads out of the recording.
    #[error("{}: name {name:?} refused; expected a relative path without `..`", path.display())]
    UnsafeName {
        /// The archive or list that holds the name.
        path: PathBuf,
        /// The name.
        name: String,
    },
    /// A link, device or other special entry of an archive.
    #[error("{}: {name:?} is a {kind}; expected only files and folders", path.display())]
    SpecialEntry {
        /// The archive.
        path: PathBuf,
        /// The entry.
        name: String,
        /// What it is.
        kind: &'static str,
    },
    /// An archive that does not unpack.
    #[error("{}: broken archive: {problem}; expected a whole .tgz, .tar.gz, .tar or .zip", path.display())]
    Archive {
        /// The archive.
        path: PathBuf,
        /// What its reader says.
        problem: String,
    },
    /// A file that a list names and that is not there.
    #[error("frame {frame}: {} is absent; it is listed in {}:{line}", path.display(), list.display())]
    Absent {
        /// The frame.
        frame: usize,
        /// The image.
        path: PathBuf,
        /// The list that names it.
        list: PathBuf,
        /// The line, from 1.
        line: usize,
    },
    /// An image that does not decode.
    #[error("{}{}: {problem}; expected {expected}", frame_prefix(*frame), path.display())]
    Image {
        /// The frame, if the image belongs to one.
        frame: Option<usize>,
        /// The image.
        path: PathBuf,
        /// What is wrong.
        problem: String,
        /// What it should be.
        expected: &'static str,
    },
    /// An image of another size than its camera.
    #[error("{}{}: {}x{} pixels; expected {}x{} as in {}", frame_prefix(*frame), path.display(), found.0, found.1, expected.0, expected.1, reference)]
    ImageSize {
        /// The frame, if the image belongs to one.
        frame: Option<usize>,
        /// The image.
        path: PathBuf,
        /// Columns and rows.
        found: (usize, usize),
        /// What they should be.
        expected: (usize, usize),
        /// What says so.
        reference: String,
    },
    /// A pose that a trajectory file cannot hold.
    #[error("{}: pose {index} has a number that is not finite; expected finite poses", path.display())]
    PoseNotFinite {
        /// The file to be written.
        path: PathBuf,
        /// Which pose, from 0.
        index: usize,
    },
    /// A PLY file that is no map.
    #[error("{}: {found}; expected {expected}", path.display())]
    Ply {
        /// The file.
        path: PathBuf,
        /// What stands there.
        found: String,
        /// What should.
        expected: &'static str,
    },
    /// A map whose arrays contradict each other or hold numbers that are not finite.
    #[error("{}: not written: {problem}; expected a consistent map of finite numbers", path.display())]
    Map {
        /// The file to be written.
        path: PathBuf,
        /// The first offence.
        problem: String,
    },
}

fn frame_prefix(frame: Option<usize>) -> String {
    frame.map_or_else(String::new, |frame| format!("frame {frame}: "))
}

impl DatasetError {
    /// `map_err(DatasetError::io(path))`.
    pub(crate) fn io(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self::Io { path, source }
    }
}

/// Text from a file as it may stand in a message: quoted, escaped, at most 60 characters.
pub(crate) fn excerpt(text: &str) -> String {
    const LONGEST: usize = 60;
    let mut short: String = text.chars().take(LONGEST).collect();
    if short.len() < text.len() {
        short.push('…');
    }
    format!("{short:?}")
}
