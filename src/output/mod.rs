//! OUT: what a run leaves on disk, and the figures it is judged by.
//!
//! | file | what |
//! |---|---|
//! | `trajectory.txt`, `keyframes.txt` | poses, TUM format |
//! | `map.ply` | the static Gaussians, standard 3DGS layout |
//! | `metrics.json` | every figure, for machines |
//! | `report.html` | one page for people |
//! | `labels/` | what was found to move: `keypoints.csv`, `masks/*.png` (a value per 4 x 4 pixels), `gaussians.csv` (counts per keyframe), `gaussians.ply` (all, with a label) |
//! | `losses.csv` | loss of training: a row per mapping job (its last iteration) and per iteration of `--refine` |
//! | `frames.csv` | per frame: state (tracking, weak, lost), keypoints, share that moves, inliers, keyframe; milliseconds of tracking and of waiting for the map, memory in use, processor time of all threads since the start (these are different on every run) |
//! | `pictures/` | input, render, depth and keypoints of a few frames |
//! | `config.toml` | every number as used |

mod comparison;
mod files;
mod judged;
mod moments;
mod tables;

use std::path::Path;

use anyhow::Result;
use garad_core::Label;
use garad_dataset::{PlyOptions, write_bytes_atomically, write_ply, write_trajectory};
use garad_eval::report::{FrameState, ReportData};
use garad_slam::TrackingState;

pub use self::comparison::{Compared, write_comparison};
pub use self::files::make_folder;
use self::files::write_text;
pub use self::judged::{Judged, Truth};
use self::moments::Moment;
use crate::images;
use crate::run::RunResult;

/// Writes everything a run left. Each file is complete or absent; a map with a number that is not
/// finite is not written, and keeps no other file from being written.
///
/// # Errors
/// A folder or file that cannot be written.
pub fn write(out: &Path, result: &RunResult, judged: &Judged, warnings: &[String]) -> Result<()> {
    let images_dir = out.join("pictures");
    make_folder(&images_dir)?;
    write_trajectory(&out.join("trajectory.txt"), &result.trajectory)?;
    let keyframes = result.slam.keyframe_trajectory();
    write_trajectory(&out.join("keyframes.txt"), &keyframes)?;
    let mut map = result.gaussians().clone();
    let label = map.label.clone();
    map.retain(|i| label[i] == Label::Static);
    let map_written = write_ply(&out.join("map.ply"), &map, &PlyOptions::default());
    write_labels(&out.join("labels"), result)?;
    write_text(&out.join("losses.csv"), &tables::losses(result))?;
    write_text(&out.join("frames.csv"), &tables::frames(result))?;
    let config = crate::config_file::write(result.slam.config())?;
    write_text(&out.join("config.toml"), &config)?;
    write_text(&out.join("metrics.json"), &judged.metrics.to_json())?;

    let snapshots = result.log.snapshots.iter();
    let moments: Vec<Moment<'_>> = snapshots
        .map(|snapshot| Moment::draw(result, snapshot))
        .collect::<Result<_>>()?;
    for (file, image) in moments.iter().flat_map(Moment::images) {
        images::save_png(&images_dir.join(file), image)?;
    }
    let report = report(result, judged, warnings, &config, &moments);
    write_text(&out.join("report.html"), &report)?;
    map_written?;
    Ok(())
}

/// The labels of every labelled frame; no folder if there is none.
fn write_labels(out: &Path, result: &RunResult) -> Result<()> {
    let found = &result.log.labels.found;
    if found.is_empty() {
        return Ok(());
    }
    let masks = out.join("masks");
    make_folder(&masks)?;
    for frame in found {
        let png = images::png_gray(&frame.cells())?;
        write_bytes_atomically(&masks.join(format!("{:06}.png", frame.frame.0)), &png)?;
    }
    write_text(&out.join("keypoints.csv"), &tables::keypoints(result))?;
    write_text(&out.join("gaussians.csv"), &tables::gaussians(result))?;
    // An invalid map is reported once, where the static part is written.
    let options = PlyOptions { label: true };
    let _ = write_ply(&out.join("gaussians.ply"), result.gaussians(), &options);
    Ok(())
}

fn report(
    result: &RunResult,
    judged: &Judged,
    warnings: &[String],
    config: &str,
    moments: &[Moment<'_>],
) -> String {
    let log = &result.log;
    let track_ms = log.stopwatch.calls_ms("frame");
    let frames = log.frames.iter().enumerate().map(|(i, report)| FrameState {
        t_s: report.t_s,
        tracked: report.state == TrackingState::Tracking,
        keyframe: report.keyframe.is_some(),
        track_ms: track_ms.get(i).copied(),
    });
    let skipped = log.skipped.iter();
    let skipped = skipped.map(|why| format!("frame skipped: {why}"));
    garad_eval::report::html(&ReportData {
        metrics: &judged.metrics,
        protocol: &judged.protocol,
        ate: judged.ate.as_ref(),
        frames: &frames.collect::<Vec<_>>(),
        strips: &moments.iter().map(Moment::strip).collect::<Vec<_>>(),
        warnings: &warnings
            .iter()
            .chain(&judged.warnings)
            .cloned()
            .chain(skipped)
            .collect::<Vec<_>>(),
        config_toml: config,
    })
}
