//! Open3D and its RealSense recorder: `color/000000.jpg` (or `image/`), `depth/000000.png` (millimetres),
//! `camera_intrinsic.json`, perhaps `trajectory.log`.

use garad_core::Camera;
use garad_core::camera::Distortion;
use serde::Deserialize;

use super::pose::{MATRIX, numbers, pose};
use super::series::{COLOUR_ENDINGS, DEPTH_ENDINGS, Series};
use super::{Context, Layout, NumberedPose, Pair, Remarks, intrinsics, series};
use crate::calibration::Calibration;
use crate::errors::DatasetError;
use crate::source::Source;
use crate::text::{Place, for_each_line};

const CAMERA: &str = "camera_intrinsic.json";
const POSES: [&str; 2] = ["trajectory.log", "scene/trajectory.log"];
/// Lines of a pose: three whole numbers, the first of them that of the frame, and the rows of a matrix.
const LINES: usize = 5;
const DEPTH: Series = Series {
    folder: "depth",
    prefix: "",
    endings: DEPTH_ENDINGS,
};

#[derive(Debug)]
pub(super) struct Open3d;

#[derive(Deserialize)]
struct Intrinsic {
    width: usize,
    height: usize,
    intrinsic_matrix: [f64; 9],
}

fn colour(source: &Source) -> Option<Series> {
    let folder = ["color", "image"]
        .into_iter()
        .find(|folder| source.has_folder(folder))?;
    Some(Series {
        folder,
        prefix: "",
        endings: COLOUR_ENDINGS,
    })
}

impl Layout for Open3d {
    fn name(&self) -> &'static str {
        "Open3D or RealSense recorder"
    }

    fn lists(&self) -> [&'static str; 2] {
        ["color", "depth"]
    }

    fn camera_file(&self) -> &'static str {
        "a camera_intrinsic.json in it"
    }

    fn matches(&self, source: &Source) -> bool {
        colour(source).is_some() && source.has_folder(DEPTH.folder)
    }

    fn calibration(&self, source: &Source) -> Result<Option<Calibration>, DatasetError> {
        const EXPECTED: &str = "{width, height, intrinsic_matrix: [fx, 0, 0, 0, fy, 0, cx, cy, 1]}";
        let Some(bytes) = source.read(CAMERA)? else {
            return Ok(None);
        };
        let path = source.locate(CAMERA);
        let Intrinsic {
            width,
            height,
            intrinsic_matrix: [fx, _, _, _, fy, _, cx, cy, _],
        } = intrinsics::json(&path, &bytes, EXPECTED)?;
        let camera = Camera {
            width,
            height,
            fx,
            fy,
            cx,
            cy,
            distortion: Distortion::default(),
        };
        intrinsics::calibration(&path, camera, intrinsics::MILLIMETRES).map(Some)
    }

    fn pairs(
        &self,
        context: &Context<'_>,
        remarks: &mut Remarks,
    ) -> Result<Vec<Pair>, DatasetError> {
        let Some(colour) = colour(context.source) else {
            return Err(DatasetError::NotARecording {
                path: context.path.to_path_buf(),
                found: "no colour images".to_owned(),
            });
        };
        series::pairs(context, [colour, DEPTH], remarks)
    }

    fn poses(
        &self,
        context: &Context<'_>,
        _pairs: &[Pair],
    ) -> Result<Vec<NumberedPose>, DatasetError> {
        for file in POSES {
            if let Some(bytes) = context.source.read(file)? {
                let mut poses = parse_log(context, file, &bytes)?;
                poses.sort_by_key(|(number, _)| *number);
                return Ok(poses);
            }
        }
        Ok(Vec::new())
    }
}

fn parse_log(
    context: &Context<'_>,
    file: &str,
    bytes: &[u8],
) -> Result<Vec<NumberedPose>, DatasetError> {
    let path = context.source.locate(file);
    let mut rows: Vec<(usize, Vec<f64>)> = Vec::new();
    for_each_line(&path, bytes, |place, text| {
        rows.push((place.line, numbers(place, text)?));
        Ok(())
    })?;
    let mut poses = Vec::new();
    for block in rows.chunks(LINES) {
        let place = Place {
            path: &path,
            line: block[0].0,
        };
        let first = block[0].1.first().copied().unwrap_or(-1.0);
        let whole = (0.0..=f64::from(u32::MAX)).contains(&first) && first.fract().abs() < 1e-9;
        if block.len() < LINES || block[0].1.len() != 3 || !whole {
            let expected = "blocks of a line of three whole numbers and a 4x4 matrix";
            return Err(place.error(format!("{} lines", block.len()), expected));
        }
        let matrix: Vec<f64> = block[1..].iter().flat_map(|(_, row)| row.clone()).collect();
        let bad_row = block[1..].iter().find(|(_, row)| row.len() != 4);
        let read = match bad_row {
            Some((line, row)) => {
                let place = Place {
                    line: *line,
                    ..place
                };
                Err(place.error(format!("{} numbers in a row", row.len()), MATRIX))
            }
            None => pose(place, &matrix),
        };
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "checked to be whole and in range"
        )]
        poses.push((first as usize, read));
    }
    Ok(poses)
}
