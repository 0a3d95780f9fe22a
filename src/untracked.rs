//! Why no frame of a recording could be tracked, with the numbers that say so.

use garad_dataset::{Calibration, DepthRange};

use crate::run::RunResult;

/// The commonest reason. `depth`: of the first frames.
#[must_use]
pub fn why_untracked(result: &RunResult, depth: &DepthRange, calibration: &Calibration) -> String {
    let (log, config) = (&result.log, result.slam.config());
    let Some(median) = median(log.frames.iter().map(|frame| frame.keypoints).collect()) else {
        let first = log.skipped.first().map_or("", String::as_str);
        return format!("all {} frames were skipped; {first}", log.skipped.len());
    };
    let limit_m = config.features.max_depth_m;
    if let Some(useless) = depth.useless(calibration, limit_m) {
        return useless;
    }
    let least = config.keyframes.first_min_keypoints;
    if median < least {
        return format!(
            "half of the frames have {median} corners or fewer, the first needs {least}: are the images dark, blurred or without texture?"
        );
    }
    let usable = (depth.readings - depth.beyond) as f64 / depth.pixels.max(1) as f64;
    format!(
        "the first frame needs {least} corners with depth; half of the frames have {median} corners or more, but {:.1} % of the first frames' pixels have depth up to {limit_m} m",
        1e2 * usable
    )
}

fn median(mut counts: Vec<usize>) -> Option<usize> {
    counts.sort_unstable();
    counts.get(counts.len().checked_sub(1)? / 2).copied()
}
