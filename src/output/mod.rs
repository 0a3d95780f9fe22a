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
//! | `garad_files.txt` | the files of this list, so that the next run can replace them |
//!
//! A run that was interrupted, resumed, only localised or never tracked writes the same files.

mod comparison;
mod folder;
mod judged;
mod moments;
mod tables;

use anyhow::Result;
use garad_core::Label;
use garad_dataset::{PlyOptions, write_bytes_atomically, write_ply, write_trajectory};
use garad_eval::report::{FrameState, ReportData};
use garad_slam::TrackingState;

pub use self::comparison::{Compared, write_comparison};
pub use self::folder::{LIST, ResultFolder, make_folder, try_folder};
pub use self::judged::{Judged, Truth};
use self::moments::Moment;
use crate::images;
use crate::run::RunResult;

/// Writes everything a run left, and removes what an earlier run left there. Each file is complete or
/// absent; one that cannot be written keeps no other from being written, and the most important come first.
/// A map with a number that is not
/// finite is not written.
///
/// # Errors
/// Every file that cannot be written.
pub fn write(
    mut out: ResultFolder,
    result: &RunResult,
    judged: &Judged,
    warnings: &[String],
) -> Result<()> {
    let config = crate::config_file::write(result.slam.config())?;
    out.write("trajectory.txt", |path| {
        Ok(write_trajectory(path, &result.trajectory)?)
    });
    let keyframes = result.slam.keyframe_trajectory();
    out.write("keyframes.txt", |path| {
        Ok(write_trajectory(path, &keyframes)?)
    });
    out.bytes("frames.csv", tables::frames(result).as_bytes());
    out.bytes("losses.csv", tables::losses(result).as_bytes());
    out.bytes("metrics.json", judged.metrics.to_json().as_bytes());
    out.bytes("config.toml", config.as_bytes());
    let mut map = result.gaussians().clone();
    let label = map.label.clone();
    map.retain(|i| label[i] == Label::Static);
    out.write("map.ply", |path| {
        Ok(write_ply(path, &map, &PlyOptions::default())?)
    });
    let mut moments = Vec::new();
    for snapshot in &result.log.snapshots {
        match Moment::draw(result, snapshot) {
            Ok(moment) => moments.push(moment),
            Err(error) => out.fail(&format!("pictures/{:06}", snapshot.frame), error),
        }
    }
    let report = report(result, judged, warnings, &config, &moments);
    out.bytes("report.html", report.as_bytes());
    write_labels(&mut out, result);
    for (file, image) in moments.iter().flat_map(Moment::images) {
        let name = format!("pictures/{file}");
        out.write(&name, |path| images::save_png(path, image));
    }
    out.finish()
}

/// The labels of every labelled frame; no folder if there is none.
fn write_labels(out: &mut ResultFolder, result: &RunResult) {
    let found = &result.log.labels.found;
    if found.is_empty() {
        return;
    }
    for frame in found {
        let name = format!("labels/masks/{:06}.png", frame.frame.0);
        out.write(&name, |path| {
            let png = images::png_gray(&frame.cells())?;
            Ok(write_bytes_atomically(path, &png)?)
        });
    }
    out.bytes("labels/keypoints.csv", tables::keypoints(result).as_bytes());
    out.bytes("labels/gaussians.csv", tables::gaussians(result).as_bytes());
    out.write("labels/gaussians.ply", |path| {
        let options = PlyOptions { label: true };
        Ok(write_ply(path, result.gaussians(), &options)?)
    });
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
