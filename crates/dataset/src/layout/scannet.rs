//! ScanNet, as its exporters write it: `color/0.jpg`, `depth/0.png` (millimetres), `pose/0.txt` (a 4x4 matrix, camera
//! to world, of infinities where tracking was lost), `intrinsic/intrinsic_depth.txt` or `intrinsic_color.txt`.
//!
//! Colour has 1296x968 pixels and depth 640x480: colour is scaled down.

use garad_core::Camera;
use garad_core::camera::Distortion;

use super::series::{COLOUR_ENDINGS, DEPTH_ENDINGS, Series};
use super::{Context, Layout, NumberedPose, Pair, Remarks, intrinsics, pose, series};
use crate::calibration::Calibration;
use crate::errors::DatasetError;
use crate::source::Source;
use crate::text::{Place, for_each_line};

const COLOUR: Series = Series {
    folder: "color",
    prefix: "",
    endings: COLOUR_ENDINGS,
};
const DEPTH: Series = Series {
    folder: "depth",
    prefix: "",
    endings: DEPTH_ENDINGS,
};

#[derive(Debug)]
pub(super) struct ScanNet;

impl Layout for ScanNet {
    fn name(&self) -> &'static str {
        "ScanNet export"
    }

    fn lists(&self) -> [&'static str; 2] {
        ["color", "depth"]
    }

    fn camera_file(&self) -> &'static str {
        "an intrinsic/intrinsic_depth.txt or intrinsic_color.txt in it"
    }

    fn matches(&self, source: &Source) -> bool {
        let has = |folder| source.has_folder(folder);
        has("color") && has("depth") && (has("pose") || has("intrinsic"))
    }

    fn calibration(&self, source: &Source) -> Result<Option<Calibration>, DatasetError> {
        const EXPECTED: &str =
            "a 4x4 or 3x3 matrix, fx 0 cx in its first row, 0 fy cy in its second";
        for (file, images) in [("depth", DEPTH), ("color", COLOUR)] {
            let name = format!("intrinsic/intrinsic_{file}.txt");
            let Some(bytes) = source.read(&name)? else {
                continue;
            };
            let path = source.locate(&name);
            let (mut rows, mut last) = (Vec::new(), 1);
            for_each_line(&path, &bytes, |place, text| {
                last = place.line;
                rows.push(pose::numbers(place, text)?);
                Ok(())
            })?;
            let place = Place {
                path: &path,
                line: last,
            };
            let ([x, y, ..], Some((width, height))) = (&rows[..], images.size(source)?) else {
                return Err(place.error(format!("{} rows", rows.len()), EXPECTED));
            };
            let (&[fx, _, cx, ..], &[_, fy, cy, ..]) = (&x[..], &y[..]) else {
                return Err(place.error("short rows", EXPECTED));
            };
            let camera = Camera {
                width,
                height,
                fx,
                fy,
                cx,
                cy,
                distortion: Distortion::default(),
            };
            return intrinsics::calibration(&path, camera, intrinsics::MILLIMETRES).map(Some);
        }
        Ok(None)
    }

    fn pairs(
        &self,
        context: &Context<'_>,
        remarks: &mut Remarks,
    ) -> Result<Vec<Pair>, DatasetError> {
        series::pairs(context, [COLOUR, DEPTH], remarks)
    }

    fn poses(
        &self,
        context: &Context<'_>,
        pairs: &[Pair],
    ) -> Result<Vec<NumberedPose>, DatasetError> {
        pose_files(context, pairs, |pair| {
            format!("pose/{}.txt", stem(&pair.colour.file))
        })
    }
}

/// The poses in files of their own; frames without one have none.
pub(super) fn pose_files(
    context: &Context<'_>,
    pairs: &[Pair],
    name: impl Fn(&Pair) -> String,
) -> Result<Vec<NumberedPose>, DatasetError> {
    let mut poses = Vec::new();
    for pair in pairs {
        let name = name(pair);
        if let Some(bytes) = context.source.read(&name)? {
            let read = pose::pose_file(&context.source.locate(&name), &bytes);
            poses.push((pair.number, read));
        }
    }
    Ok(poses)
}

/// Name of a file without folders and ending.
fn stem(file: &str) -> &str {
    let name = file.rsplit('/').next().unwrap_or(file);
    name.rsplit_once('.').map_or(name, |(stem, _)| stem)
}
