//! Replica as NICE-SLAM ships it: `results/frame000000.jpg`, `results/depth000000.png`, `traj.txt` with one matrix a
//! line (16 numbers in rows, camera to world), `cam_params.json` in the recording or in the folder above.

use garad_core::Camera;
use garad_core::camera::Distortion;
use serde::Deserialize;

use super::series::{COLOUR_ENDINGS, DEPTH_ENDINGS, Series};
use super::{Context, Layout, NumberedPose, Pair, Remarks, intrinsics, pose, series};
use crate::calibration::Calibration;
use crate::errors::DatasetError;
use crate::source::Source;
use crate::text::for_each_line;

const POSES: &str = "traj.txt";
const CAMERA: &str = "cam_params.json";
const COLOUR: Series = Series {
    folder: "results",
    prefix: "frame",
    endings: COLOUR_ENDINGS,
};
const DEPTH: Series = Series {
    folder: "results",
    prefix: "depth",
    endings: DEPTH_ENDINGS,
};

#[derive(Debug)]
pub(super) struct Replica;

#[derive(Deserialize)]
struct Parameters {
    camera: Numbers,
}

#[derive(Deserialize)]
struct Numbers {
    w: usize,
    h: usize,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    scale: f64,
}

impl Layout for Replica {
    fn name(&self) -> &'static str {
        "Replica, as NICE-SLAM ships it"
    }

    fn lists(&self) -> [&'static str; 2] {
        ["results"; 2]
    }

    fn camera_file(&self) -> &'static str {
        "a cam_params.json in or above it"
    }

    fn matches(&self, source: &Source) -> bool {
        [COLOUR, DEPTH]
            .iter()
            .all(|series| !series.files(source).is_empty())
    }

    fn calibration(&self, source: &Source) -> Result<Option<Calibration>, DatasetError> {
        const EXPECTED: &str = "{\"camera\": {w, h, fx, fy, cx, cy, scale}}";
        let Some((path, bytes)) = source.read_here_or_above(CAMERA)? else {
            return Ok(None);
        };
        let Parameters { camera } = intrinsics::json(&path, &bytes, EXPECTED)?;
        let known = Camera {
            width: camera.w,
            height: camera.h,
            fx: camera.fx,
            fy: camera.fy,
            cx: camera.cx,
            cy: camera.cy,
            distortion: Distortion::default(),
        };
        intrinsics::calibration(&path, known, camera.scale).map(Some)
    }

    fn pairs(
        &self,
        context: &Context<'_>,
        remarks: &mut Remarks,
    ) -> Result<Vec<Pair>, DatasetError> {
        series::pairs(context, [COLOUR, DEPTH], remarks)
    }

    /// Line n, from 0, belongs to frame n.
    fn poses(
        &self,
        context: &Context<'_>,
        _pairs: &[Pair],
    ) -> Result<Vec<NumberedPose>, DatasetError> {
        let Some(bytes) = context.source.read(POSES)? else {
            return Ok(Vec::new());
        };
        let mut poses = Vec::new();
        for_each_line(&context.source.locate(POSES), &bytes, |place, text| {
            let read = pose::numbers(place, text).and_then(|v| pose::pose(place, &v));
            poses.push((poses.len(), read));
            Ok(())
        })?;
        Ok(poses)
    }
}
