//! 7-Scenes: `frame-000000.color.png`, `frame-000000.depth.png` (millimetres, 65535 missing), `frame-000000.pose.txt` (a
//! 4x4 matrix, camera to world).
//!
//! The camera is the one its page names for both images: 640x480 pixels, focal length 585, centre (320, 240).

use std::path::Path;

use garad_core::Camera;
use garad_core::camera::Distortion;

use super::series::Series;
use super::{Context, Layout, NumberedPose, Pair, Remarks, intrinsics, scannet, series};
use crate::calibration::Calibration;
use crate::errors::DatasetError;
use crate::source::Source;

const COLOUR_ENDING: &str = ".color.png";
const COLOUR: Series = Series {
    folder: "",
    prefix: "frame-",
    endings: &[COLOUR_ENDING],
};
const DEPTH: Series = Series {
    folder: "",
    prefix: "frame-",
    endings: &[".depth.png"],
};

#[derive(Debug)]
pub(super) struct SevenScenes;

impl Layout for SevenScenes {
    fn name(&self) -> &'static str {
        "7-Scenes"
    }

    fn lists(&self) -> [&'static str; 2] {
        ["frame-*.color.png", "frame-*.depth.png"]
    }

    fn matches(&self, source: &Source) -> bool {
        !COLOUR.files(source).is_empty()
    }

    fn calibration(&self, _source: &Source) -> Result<Option<Calibration>, DatasetError> {
        let camera = Camera {
            width: 640,
            height: 480,
            fx: 585.0,
            fy: 585.0,
            cx: 320.0,
            cy: 240.0,
            distortion: Distortion::default(),
        };
        let mut known = intrinsics::calibration(Path::new(""), camera, intrinsics::MILLIMETRES)?;
        "the 7-Scenes page".clone_into(&mut known.source);
        Ok(Some(known))
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
        scannet::pose_files(context, pairs, |pair| {
            pair.colour.file.replace(COLOUR_ENDING, ".pose.txt")
        })
    }
}
