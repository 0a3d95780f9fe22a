//! Frames and masks of a recording, as the commands that run on one take them.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use garad::output::Truth;
use garad::reason::reason;
use garad::recording::{Recording, fingerprint};
use garad::source::SourceFrame;
use garad_core::MaskImage;
use garad_dataset::{Dataset, Frame, MASK_FOLDER, OpenOptions, Preset, bonn_camera_from_marker};

/// Which frames of a recording, seen by which camera.
#[derive(Debug, clap::Args)]
pub(crate) struct InputArgs {
    /// Calibration by name: freiburg1, freiburg2, freiburg3, bonn.
    #[arg(long)]
    preset: Option<Preset>,
    /// Calibration file: `width height fx fy cx cy depth_factor fps [k1 k2 p1 p2 k3]`.
    #[arg(long, value_name = "FILE")]
    calibration: Option<PathBuf>,
    /// Raw depth per metre, instead of the calibration's: 1000 for millimetres.
    #[arg(long, value_name = "N")]
    depth_factor: Option<f64>,
    /// Largest difference in time of a colour image and its depth image, seconds.
    #[arg(long, value_name = "SECONDS", default_value_t = OpenOptions::default().max_dt_s)]
    max_dt: f64,
    /// Added to the times of depth images before they are paired, seconds.
    #[arg(
        long,
        value_name = "SECONDS",
        default_value_t = 0.0,
        allow_negative_numbers = true
    )]
    depth_offset: f64,
    /// Stop after this many frames.
    #[arg(long, value_name = "N")]
    max_frames: Option<usize>,
    /// Skip this many frames first.
    #[arg(long, value_name = "N", default_value_t = 0)]
    first_frame: usize,
    /// Stop at the first bad frame or disordered time instead of skipping it.
    #[arg(long)]
    pub(crate) strict: bool,
}

impl InputArgs {
    pub(crate) fn open(&self, path: &Path) -> Result<Dataset> {
        let options = OpenOptions {
            preset: self.preset,
            calibration: self.calibration.clone(),
            max_frames: self.max_frames,
            first_frame: self.first_frame,
            strict: self.strict,
            depth_factor: self.depth_factor,
            max_dt_s: self.max_dt,
            depth_offset_s: self.depth_offset,
        };
        Ok(Dataset::open(path, &options)?)
    }

    /// The part of the recording that is run, in words.
    pub(crate) fn part(&self, dataset: &Dataset) -> String {
        let first = self.first_frame;
        let last = first + dataset.len().saturating_sub(1);
        format!("frames {first} to {last} of {}", dataset.name())
    }
}

/// Frames decoded ahead of tracking.
const PREFETCH: usize = 4;

/// A recording's frames, decoded ahead, with their oracle masks and true masks.
pub(crate) fn frames<'a>(
    dataset: &'a Dataset,
    oracle: Option<&'a Masks>,
    truth: Option<&'a Masks>,
) -> impl Iterator<Item = Result<SourceFrame>> + 'a {
    frames_from(0, dataset, oracle, truth)
}

/// [`frames`] without the first ones.
pub(crate) fn frames_from<'a>(
    first: usize,
    dataset: &'a Dataset,
    oracle: Option<&'a Masks>,
    truth: Option<&'a Masks>,
) -> impl Iterator<Item = Result<SourceFrame>> + 'a {
    dataset.frames_from(first, PREFETCH).map(move |frame| {
        let Frame {
            id,
            t_s,
            depth_t_s,
            rgb,
            depth,
        } = frame?;
        let i = id.index();
        let mask =
            match oracle {
                None => None,
                Some(masks) => Some(masks.read(dataset, i)?.with_context(|| {
                    format!("frame {i}: no mask; expected one for every frame")
                })?),
            };
        // True masks may be missing: such a frame is run, but its labels are not judged.
        let truth = truth.and_then(|masks| match masks.read(dataset, i) {
            Ok(mask) => mask,
            Err(error) => {
                tracing::warn!("labels of frame {i} are not judged: {}", reason(&error));
                None
            }
        });
        Ok(SourceFrame {
            t_s,
            depth_t_s,
            rgb,
            depth,
            mask,
            truth,
        })
    })
}

/// The identity of a recording after `done` frames.
pub(crate) fn recording(dataset: &Dataset, oracle: Option<&Masks>, done: usize) -> Recording {
    let of_frame = |i: usize| {
        let frame = dataset.read(i).ok().filter(|_| i < done)?;
        let mask = oracle.and_then(|masks| masks.read(dataset, i).ok()?);
        Some(fingerprint(&frame.rgb, &frame.depth, mask.as_ref()))
    };
    Recording {
        name: dataset.name().to_owned(),
        given_masks: oracle.is_some(),
        times_s: times(dataset, done),
        fingerprints: [0, done.saturating_sub(1)].map(of_frame),
    }
}

/// Times of the first n frames.
pub(crate) fn times(dataset: &Dataset, n: usize) -> Vec<f64> {
    (0..n).filter_map(|i| dataset.timestamp(i)).collect()
}

/// Which ground truth positions are compared with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum GroundTruth {
    /// As recorded.
    Raw,
    /// BONN only: transformed from the marker to the camera.
    Camera,
}

/// The ground truth of a recording, if it has one.
pub(crate) fn truth(dataset: &Dataset, which: GroundTruth) -> Option<Truth> {
    let raw = dataset.ground_truth()?;
    let bonn = dataset.preset() == Some(Preset::Bonn);
    let of_camera = bonn.then(|| bonn_camera_from_marker(raw));
    Some(match (which, of_camera) {
        (GroundTruth::Camera, Some(poses)) => Truth {
            poses,
            of_camera: None,
            protocol: "ground truth moved from marker to camera",
        },
        (_, of_camera) => Truth {
            poses: raw.to_vec(),
            protocol: match of_camera {
                Some(_) => "raw ground truth (marker)",
                None => "raw ground truth",
            },
            of_camera,
        },
    })
}

/// A folder of masks.
#[derive(Debug)]
pub(crate) enum Masks {
    /// On disk.
    Folder(PathBuf),
    /// Inside the recording, archives included.
    Inside(String),
}

impl Masks {
    /// A folder named by the user: on disk, or inside the recording at `path`.
    pub(crate) fn find(dataset: &Dataset, path: &Path, dir: &Path) -> Result<Self> {
        let name = dir.to_string_lossy();
        let name = name.trim_end_matches('/');
        if dir.is_dir() {
            Ok(Self::Folder(dir.to_path_buf()))
        } else if path.join(dir).is_dir() {
            Ok(Self::Folder(path.join(dir)))
        } else if dataset.has_folder(name) {
            Ok(Self::Inside(name.to_owned()))
        } else {
            bail!(
                "{}: no such folder; expected one of masks, here or inside {}",
                dir.display(),
                path.display()
            )
        }
    }

    /// The recording's own, if it has any.
    pub(crate) fn of_recording(dataset: &Dataset) -> Option<Self> {
        dataset
            .has_folder(MASK_FOLDER)
            .then(|| Self::Inside(MASK_FOLDER.to_owned()))
    }

    fn read(&self, dataset: &Dataset, i: usize) -> Result<Option<MaskImage>> {
        Ok(match self {
            Self::Folder(dir) => Some(dataset.read_mask(dir, i)?),
            Self::Inside(folder) => dataset.read_own_mask(folder, i)?,
        })
    }
}
