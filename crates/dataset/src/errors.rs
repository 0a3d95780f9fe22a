//! [`DatasetError`]: invalid recordings, each with file, line or frame and what was expected.

use std::io;
use std::path::{Path, PathBuf};

use garad_core::CameraError;
use thiserror::Error;

/// What a recording is recognised by, and the layout's name.
pub(crate) const LAYOUTS: &str = "rgb.txt and depth.txt (TUM or BONN); associations.txt or associate.txt (ICL-NUIM or ORB-SLAM); \
results/frame000000.jpg and results/depth000000.png (Replica, as NICE-SLAM ships it); color/, depth/ and pose/ or intrinsic/ (ScanNet export); \
frame-000000.color.png and frame-000000.depth.png (7-Scenes); transforms.json (nerfstudio or Polycam); \
color/ or image/, and depth/ (Open3D or RealSense recorder)";

/// Invalid input. Every message is one line with the place and what was expected.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum DatasetError {
    /// An error of the operating system.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The error.
        source: io::Error,
    },
    /// No such file.
    #[error("{}: not found; expected {expected}", path.display())]
    NotFound {
        /// The file.
        path: PathBuf,
        /// What was expected.
        expected: &'static str,
    },
    /// A folder where a file was expected.
    #[error("{}: is a folder; expected {expected}", path.display())]
    Folder {
        /// The folder.
        path: PathBuf,
        /// What was expected.
        expected: &'static str,
    },
    /// A folder or archive that is not a recording.
    #[error("{}: {found}; expected a recording, that is a folder with {}; or a .tgz, .tar.gz, .tar or .zip of one", path.display(), LAYOUTS)]
    NotARecording {
        /// The folder or archive.
        path: PathBuf,
        /// What is missing or wrong.
        found: String,
    },
    /// An invalid line of a text file.
    #[error("{}:{line}: found {found}; expected {expected}", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// What was found.
        found: String,
        /// What was expected.
        expected: &'static str,
    },
    /// An invalid number of a calibration.
    #[error("{}:{line}: {source}", path.display())]
    Camera {
        /// The file.
        path: PathBuf,
        /// The line, from 1.
        line: usize,
        /// Which number.
        source: CameraError,
    },
    /// A calibration whose numbers no camera has.
    #[error("camera from {source_name}: {problem}")]
    Implausible {
        /// Where the calibration came from.
        source_name: String,
        /// Which number, and what was expected.
        problem: String,
    },
    /// A list without entries.
    #[error("{}: lists no image; expected lines `timestamp filename`", path.display())]
    EmptyList {
        /// The file.
        path: PathBuf,
    },
    /// No colour image has a depth image close enough in time.
    #[error("{}: none of {colour} colour images has one of {depth} depth images within {max_dt_s} s (the closest are {closest_s:.6} s apart); expected lists by one clock, or --max-dt SECONDS, --depth-offset SECONDS", path.display())]
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
    /// The options leave no frame, or the frame is past the end.
    #[error("{}: frame {frame} requested; there are {len} frames, counted from 0", path.display())]
    NoSuchFrame {
        /// The recording.
        path: PathBuf,
        /// The frame.
        frame: usize,
        /// Number of frames.
        len: usize,
    },
    /// An invalid option.
    #[error("{option} is {value}; expected {expected}")]
    Option {
        /// Which.
        option: &'static str,
        /// Its value.
        value: String,
        /// Its valid values.
        expected: &'static str,
    },
    /// No calibration was found.
    #[error("{}: camera unknown; expected --calibration FILE, --preset NAME ({presets}), a camera.txt in the recording, {}or one of those names in the recording's", path.display(), also(file))]
    NoCalibration {
        /// The recording.
        path: PathBuf,
        /// The file that its layout has a camera in; may be empty.
        file: &'static str,
        /// Names of the presets.
        presets: &'static str,
    },
    /// A preset that does not exist.
    #[error("preset {name:?} is unknown; expected one of {presets}")]
    UnknownPreset {
        /// The name.
        name: String,
        /// What exists.
        presets: &'static str,
    },
    /// Larger than the limit.
    #[error("{}: {what} is {value}; expected at most {limit}", path.display())]
    TooLarge {
        /// The file.
        path: PathBuf,
        /// Which measure.
        what: &'static str,
        /// Its value.
        value: u64,
        /// The limit, see [`crate::limits`].
        limit: u64,
    },
    /// A name that leads outside the recording.
    #[error("{}: name {} refused; expected a relative path without `..`", path.display(), excerpt(name))]
    UnsafeName {
        /// The archive or list with the name.
        path: PathBuf,
        /// The name.
        name: String,
    },
    /// A link, device or other special entry of an archive.
    #[error("{}: {} is a {kind}; expected only files and folders", path.display(), excerpt(name))]
    SpecialEntry {
        /// The archive.
        path: PathBuf,
        /// The entry.
        name: String,
        /// Its kind.
        kind: &'static str,
    },
    /// A broken archive.
    #[error("{}: broken archive: {problem}; expected a whole .tgz, .tar.gz, .tar or .zip", path.display())]
    Archive {
        /// The archive.
        path: PathBuf,
        /// Message of its reader.
        problem: String,
    },
    /// A listed file that does not exist.
    #[error("frame {frame}: {} is absent; it is listed in {}:{line}", path.display(), list.display())]
    Absent {
        /// The frame.
        frame: usize,
        /// The image.
        path: PathBuf,
        /// The list.
        list: PathBuf,
        /// The line, from 1.
        line: usize,
    },
    /// An image that cannot be decoded.
    #[error("{}{}: {problem}; expected {expected}", frame_prefix(*frame), path.display())]
    Image {
        /// The frame, if the image belongs to one.
        frame: Option<usize>,
        /// The image.
        path: PathBuf,
        /// What is wrong.
        problem: String,
        /// What was expected.
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
        /// What was expected.
        expected: (usize, usize),
        /// Where the expected size comes from.
        reference: String,
    },
    /// A pose that is not finite.
    #[error("{}: pose {index} has a number that is not finite; expected finite poses", path.display())]
    PoseNotFinite {
        /// The file to be written.
        path: PathBuf,
        /// Which pose, from 0.
        index: usize,
    },
    /// A PLY file that is not a map.
    #[error("{}: {found}; expected {expected}", path.display())]
    Ply {
        /// The file.
        path: PathBuf,
        /// What was found.
        found: String,
        /// What was expected.
        expected: &'static str,
    },
    /// A map with inconsistent arrays or numbers that are not finite.
    #[error("{}: not written: {problem}; expected a consistent map of finite numbers", path.display())]
    Map {
        /// The file to be written.
        path: PathBuf,
        /// The first problem.
        problem: String,
    },
}

fn also(file: &str) -> String {
    match file {
        "" => String::new(),
        file => format!("{file}, "),
    }
}

fn frame_prefix(frame: Option<usize>) -> String {
    frame.map_or_else(String::new, |frame| format!("frame {frame}: "))
}

impl DatasetError {
    /// Nothing at `path` that could be opened as a file.
    pub(crate) fn not_found(path: &Path, expected: &'static str) -> Self {
        let path = path.to_path_buf();
        match path.is_dir() {
            true => Self::Folder { path, expected },
            false => Self::NotFound { path, expected },
        }
    }

    /// `map_err(DatasetError::io(path))`.
    pub(crate) fn io(path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self::Io { path, source }
    }
}

/// Text of a file for a message: quoted, escaped, at most 60 characters.
pub(crate) fn excerpt(text: &str) -> String {
    const LONGEST: usize = 60;
    let mut short: String = text.chars().take(LONGEST).collect();
    if short.len() < text.len() {
        short.push('…');
    }
    format!("{short:?}")
}
