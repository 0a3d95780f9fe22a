//! nerfstudio and what `ns-process-data` makes of Polycam and Record3D scans: `transforms.json` with `fl_x fl_y cx cy w h`, and
//! of each frame `file_path`, `depth_file_path` (millimetres) and `transform_matrix` (camera to world).
//!
//! Cameras there have the axes of OpenGL, y up and z back, and pixel centres at halves:
//! R = R' diag(1, -1, -1), c = c' - 1/2.

use std::mem::take;
use std::path::PathBuf;

use garad_core::camera::Distortion;
use garad_core::{Camera, Se3, So3};
use nalgebra::{Matrix3, Vector3};
use serde::Deserialize;

use super::series::{pair, time_s};
use super::{Context, Layout, NumberedPose, Pair, Remarks, Unpaired, intrinsics, pose};
use crate::calibration::Calibration;
use crate::errors::{DatasetError, excerpt};
use crate::files::{CLEAN_NAME, clean_name};
use crate::source::{Source, image_size};
use crate::text::Place;

const FILE: &str = "transforms.json";
const EXPECTED: &str = "a nerfstudio transforms.json: fl_x fl_y cx cy w h, and frames with file_path, depth_file_path, transform_matrix";
/// Focal lengths of frames that differ by more than this part are warned of.
const SAME_FOCAL: f64 = 0.01;

#[derive(Debug)]
pub(super) struct Nerfstudio;

#[derive(Deserialize)]
struct Transforms {
    camera_model: Option<String>,
    #[serde(flatten)]
    camera: Intrinsics,
    frames: Vec<Frame>,
}

#[derive(Deserialize)]
struct Frame {
    file_path: String,
    depth_file_path: Option<String>,
    transform_matrix: Vec<Vec<f64>>,
    #[serde(flatten)]
    camera: Intrinsics,
}

/// Of all frames, or of one.
#[derive(Deserialize)]
struct Intrinsics {
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    #[serde(default)]
    k1: f64,
    #[serde(default)]
    k2: f64,
    #[serde(default)]
    k3: f64,
    #[serde(default)]
    p1: f64,
    #[serde(default)]
    p2: f64,
}

/// The file with the line of each frame's `file_path`, frames in the order of the last number in their names.
struct Parsed {
    path: PathBuf,
    transforms: Transforms,
    lines: Vec<usize>,
}

fn parse(source: &Source) -> Result<Parsed, DatasetError> {
    let path = source.locate(FILE);
    let bytes = source
        .read(FILE)?
        .ok_or_else(|| DatasetError::not_found(&path, EXPECTED))?;
    let mut transforms: Transforms = intrinsics::json(&path, &bytes, EXPECTED)?;
    let text = String::from_utf8_lossy(&bytes);
    let (mut rest, mut line) = (text.as_ref(), 1);
    let mut line_of = |frame: &Frame| {
        if let Some((before, after)) = rest.split_once(frame.file_path.as_str()) {
            line += before.matches('\n').count();
            rest = after;
        }
        line
    };
    let mut frames: Vec<(usize, Frame)> = take(&mut transforms.frames)
        .into_iter()
        .map(|frame| (line_of(&frame), frame))
        .collect();
    frames
        .sort_by_cached_key(|(_, frame)| (last_number(&frame.file_path), frame.file_path.clone()));
    let lines;
    (lines, transforms.frames) = frames.into_iter().unzip();
    Ok(Parsed {
        path,
        transforms,
        lines,
    })
}

impl Parsed {
    /// Frames with depth, by their index.
    fn with_depth(&self) -> impl Iterator<Item = (usize, &Frame, &String)> {
        let frames = self.transforms.frames.iter().enumerate();
        frames.filter_map(|(i, frame)| Some((i, frame, frame.depth_file_path.as_ref()?)))
    }

    fn place(&self, frame: usize) -> Place<'_> {
        let line = self.lines.get(frame).copied().unwrap_or(1);
        Place {
            path: &self.path,
            line,
        }
    }

    fn clean(&self, frame: usize, file: &str) -> Result<String, DatasetError> {
        let refused = || {
            let found = format!("name {}", excerpt(file));
            self.place(frame).error(found, CLEAN_NAME)
        };
        clean_name(file).ok_or_else(refused)
    }
}

/// The last digits in the name of a file; the largest number without any.
fn last_number(file: &str) -> u64 {
    let name = file.rsplit('/').next().unwrap_or(file);
    let stem = name.rsplit_once('.').map_or(name, |(stem, _)| stem);
    let digits = stem.rsplit(|c: char| !c.is_ascii_digit());
    let mut numbers = digits.filter(|digits| !digits.is_empty());
    let last = numbers.next().and_then(|digits| digits.parse().ok());
    last.unwrap_or(u64::MAX)
}

impl Layout for Nerfstudio {
    fn name(&self) -> &'static str {
        "nerfstudio or Polycam"
    }

    fn lists(&self) -> [&'static str; 2] {
        [FILE; 2]
    }

    fn camera_file(&self) -> &'static str {
        "fl_x in its transforms.json"
    }

    fn matches(&self, source: &Source) -> bool {
        source.has_file(FILE)
    }

    fn calibration(&self, source: &Source) -> Result<Option<Calibration>, DatasetError> {
        let parsed = parse(source)?;
        let place = parsed.place(usize::MAX);
        let Transforms {
            camera_model,
            camera,
            frames,
        } = &parsed.transforms;
        if let Some(model) = camera_model
            .as_ref()
            .filter(|model| model.contains("FISHEYE"))
        {
            let expected = "a pinhole camera (PINHOLE, OPENCV)";
            return Err(place.error(format!("camera_model {}", excerpt(model)), expected));
        }
        let Some(first) = frames.first() else {
            return Err(place.error("no frame", EXPECTED));
        };
        let all = match camera.fl_x {
            Some(_) => camera,
            None => &first.camera,
        };
        let Some(fx) = all.fl_x else {
            return Ok(None);
        };
        // Sizes may stand at the top and focal lengths at the frames.
        let size = match (all.w.or(camera.w), all.h.or(camera.h)) {
            (Some(w), Some(h)) => Some((whole(w), whole(h))),
            _ => image_size(source, &parsed.clean(0, &first.file_path)?)?,
        };
        let Some((width, height)) = size else {
            return Err(place.error("neither w h nor the first image", EXPECTED));
        };
        let known = Camera {
            width,
            height,
            fx,
            fy: all.fl_y.unwrap_or(fx),
            cx: all.cx.unwrap_or(0.5 * width as f64) - 0.5,
            cy: all.cy.unwrap_or(0.5 * height as f64) - 0.5,
            distortion: Distortion {
                k1: all.k1,
                k2: all.k2,
                p1: all.p1,
                p2: all.p2,
                k3: all.k3,
            },
        };
        intrinsics::calibration(&parsed.path, known, intrinsics::MILLIMETRES).map(Some)
    }

    fn pairs(
        &self,
        context: &Context<'_>,
        remarks: &mut Remarks,
    ) -> Result<Vec<Pair>, DatasetError> {
        let parsed = parse(context.source)?;
        let mut pairs = Vec::new();
        for (i, frame, depth) in parsed.with_depth() {
            let files = [&frame.file_path, depth].map(|file| parsed.clean(i, file));
            let [colour, depth] = files;
            let mut pair = pair(context, i, i, [&colour?, &depth?]);
            pair.colour.line = parsed.place(i).line;
            pair.depth.line = pair.colour.line;
            pairs.push(pair);
        }
        let frames = &parsed.transforms.frames;
        let without = frames.len() - pairs.len();
        if pairs.is_empty() {
            let found = match frames.len() {
                0 => "no frame".to_owned(),
                n => format!("none of {n} frames with a depth_file_path"),
            };
            let expected = "RGB-D: a depth_file_path for every frame (ns-process-data polycam has --use-depth)";
            return Err(parsed.place(0).error(found, expected));
        }
        if without > 0 {
            remarks.warnings.push(format!(
                "{without} of {} frames have no depth_file_path; left out",
                frames.len()
            ));
        }
        let alone = frames.iter().enumerate();
        let alone = alone.filter(|(_, frame)| frame.depth_file_path.is_none());
        remarks.unpaired = Unpaired {
            why: "without a depth_file_path".to_owned(),
            times_s: alone.map(|(i, _)| time_s(context, i)).collect(),
        };
        let focal = || frames.iter().filter_map(|frame| frame.camera.fl_x);
        let low = focal().fold(f64::INFINITY, f64::min);
        let high = focal().fold(0.0, f64::max);
        if high > (1.0 + SAME_FOCAL) * low {
            remarks.warnings.push(format!(
                "focal lengths of the frames go from {low} to {high} px; that of the first is used for all"
            ));
        }
        remarks.notes.push(format!(
            "no time stamps: frames are at their index / {} s, the fps of the calibration",
            context.fps
        ));
        Ok(pairs)
    }

    fn poses(
        &self,
        context: &Context<'_>,
        pairs: &[Pair],
    ) -> Result<Vec<NumberedPose>, DatasetError> {
        let parsed = parse(context.source)?;
        let pose_of = |pair: &Pair| {
            let frame = &parsed.transforms.frames[pair.number];
            let read = pose::pose(parsed.place(pair.number), &frame.transform_matrix.concat());
            (pair.number, read.map(|pose| pose.map(opencv_from_opengl)))
        };
        Ok(pairs.iter().map(pose_of).collect())
    }
}

/// The same pose of a camera that looks along z with y down, of one that looks along -z with y up.
fn opencv_from_opengl(world_from_camera: Se3) -> Se3 {
    let axes = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    let rotation = So3::from_matrix(&(world_from_camera.rotation.matrix() * axes));
    Se3::new(rotation, world_from_camera.translation)
}

/// A size in pixels, which some write with a point; 0, which no camera has, for what is none.
fn whole(value: f64) -> usize {
    let largest = f64::from(crate::limits::IMAGE_SIDE_PX);
    if !(0.0..=largest).contains(&value) {
        return 0;
    }
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "in range"
    )]
    {
        value as usize
    }
}
