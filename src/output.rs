//! OUT: what a run leaves on disk, and the figures it is judged by.
//!
//! | file | what |
//! |---|---|
//! | `trajectory.txt`, `keyframes.txt` | poses, TUM format |
//! | `map.ply` | the Gaussians at rest, standard 3DGS layout |
//! | `metrics.json` | every figure, for machines |
//! | `report.html` | one page for people |
//! | `labels/` | what was found to move: `keypoints.csv`, `masks/*.png` (a value per 4 x 4 pixels), `gaussians.csv` (counts per keyframe), `gaussians.ply` (all, with a label) |
//! | `losses.csv` | loss of training: a row per mapping job (its last iteration) and per iteration of `--refine` |
//! | `costs.csv` | per frame: milliseconds of tracking and of waiting for the map, memory in use, processor time of all threads since the start (other on every run) |
//! | `pictures/` | input, render, depth and keypoints of a few frames |
//! | `config.toml` | every number as used |

use std::path::Path;

use anyhow::{Context, Result};
use garad_core::{Label, Par, RgbImage, StampedPose};

use garad_dataset::{PlyOptions, write_bytes_atomically, write_ply};
use garad_eval::report::{FrameState, ReportData, Strip};
use garad_eval::{
    Ate, AteOptions, Metrics, PictureQuality, RpeOptions, ate, compare_pictures, rpe,
};
use garad_raster::{Include, RenderOptions, fast};
use garad_slam::TrackingState;

use crate::pictures;
use crate::runner::{RunResult, Snapshot};
use crate::stopwatch::{FrameCost, memory_mb};

/// The figures of a run.
#[derive(Debug)]
pub struct Judged {
    /// Everything for `metrics.json`.
    pub metrics: Metrics,
    /// The absolute trajectory error with its pairs, if there is ground truth.
    pub ate: Option<Ate>,
    /// How it was measured, or why it could not be.
    pub protocol: String,
}

impl Judged {
    /// Judges the path of a run. No ground truth is not an error: the protocol says so.
    #[must_use]
    pub fn new(
        dataset: &str,
        result: &RunResult,
        ground_truth: Option<&[StampedPose]>,
        which_truth: &str,
    ) -> Self {
        let mut metrics = Metrics::new(env!("CARGO_PKG_VERSION"), dataset);
        metrics.frames = result.frames.len() + result.skipped.len();
        metrics.tracked = result.tracked();
        metrics.threads = result.threads;
        metrics.timing = result.stopwatch.summary();
        metrics.wall_s = Some(result.wall_s);
        metrics.peak_rss_mb = memory_mb("VmHWM:");
        if let Some(gaussians) = result.slam.gaussians() {
            metrics.map.gaussians = Some(gaussians.len());
            let dynamic = gaussians.label.iter().filter(|l| **l == Label::Dynamic);
            metrics.map.dynamic = Some(dynamic.count());
        }

        if let Some(labels) = &result.labels {
            metrics.labels = labels.metrics();
        }
        let options = AteOptions::default();
        let (ate, protocol) = match ground_truth {
            None => (None, "cannot be judged: no ground truth".to_owned()),
            Some(_) if result.trajectory.is_empty() => {
                (None, "cannot be judged: no frame has a pose".to_owned())
            }
            Some(truth) => match ate(truth, &result.trajectory, &options) {
                Ok(ate) => (Some(ate), format!("{}, {which_truth}", options.describe())),
                Err(error) => (None, format!("cannot be judged: {error}")),
            },
        };
        if let Some(ate) = &ate {
            metrics.ate = ate.into();
        }
        if let Some(Ok(rpe)) =
            ground_truth.map(|truth| rpe(truth, &result.trajectory, &RpeOptions::default()))
        {
            metrics.rpe = (&rpe).into();
        }
        Self {
            metrics,
            ate,
            protocol,
        }
    }

    /// The result in a few lines.
    #[must_use]
    pub fn summary(&self) -> Vec<String> {
        let m = &self.metrics;
        let mut lines = vec![format!(
            "tracked    {} of {} frames, {} Gaussians",
            m.tracked,
            m.frames,
            m.map.gaussians.unwrap_or(0)
        )];
        if let Some(frame) = m.timing.get("frame") {
            lines.push(format!(
                "time       {:.1} s in all; a frame {:.1} ms median, {:.1} ms at 95 %, {} thread(s)",
                m.wall_s.unwrap_or(0.0),
                frame.median_ms,
                frame.p95_ms,
                m.threads
            ));
        }
        if let (Some(psnr), Some(ssim)) = (m.render.psnr_db, m.render.ssim) {
            lines.push(format!(
                "render     PSNR {psnr:.2} dB, SSIM {ssim:.4} over all frames, whole picture"
            ));
        }
        if let (Some(psnr), Some(ssim)) = (m.render_static.psnr_db, m.render_static.ssim) {
            lines.push(format!(
                "           PSNR {psnr:.2} dB, SSIM {ssim:.4} outside the masks"
            ));
        }
        if let (Some(l1_m), Some(coverage)) = (m.render_depth.l1_m, m.render_depth.coverage) {
            lines.push(format!(
                "           depth L1 {l1_m:.4} m over {:.1} % of the measured pixels",
                100.0 * coverage
            ));
        }
        if let Some(ghosts) = m.render_depth.ghosts {
            lines.push(format!(
                "           ghosts {:.2} % of the static pixels (more than 10 cm in front)",
                100.0 * ghosts
            ));
        }
        if let (Some(f1), Some(iou)) = (m.labels.keypoints.f1, m.labels.pixels.iou) {
            let of = |v: Option<f64>| v.map_or("-".to_owned(), |v| format!("{v:.3}"));
            lines.push(format!(
                "labels     keypoints F1 {f1:.3} (precision {}, recall {}, wrongly dynamic {}); mask IoU {iou:.3}",
                of(m.labels.keypoints.precision),
                of(m.labels.keypoints.recall),
                of(m.labels.keypoints.wrongly_dynamic)
            ));
        }
        match &self.ate {
            Some(ate) => {
                let s = &ate.stats;
                lines.push(format!(
                    "ATE [m]    rmse {:.4}  mean {:.4}  median {:.4}  std {:.4}  max {:.4}  ({} pairs)",
                    s.rmse, s.mean, s.median, s.std, s.max, s.pairs
                ));
                if let (Some(t), Some(r)) = (m.rpe.trans_rmse_m_per_s, m.rpe.rot_rmse_deg_per_s) {
                    lines.push(format!("RPE        {t:.4} m/s, {r:.3} deg/s (rmse)"));
                }
                lines.push(format!("protocol   {}", self.protocol));
            }
            None => lines.push(format!("ATE        {}", self.protocol)),
        }
        lines
    }
}

/// Writes everything a run left. Each file is complete or absent; a map with a number that is not
/// finite is not written, and keeps no other file from being written.
///
/// # Errors
/// A folder or file that cannot be written.
pub fn write(out: &Path, result: &RunResult, judged: &Judged, warnings: &[String]) -> Result<()> {
    let pictures_dir = out.join("pictures");
    std::fs::create_dir_all(&pictures_dir)
        .with_context(|| format!("{}: cannot make the folder", pictures_dir.display()))?;
    garad_dataset::write_trajectory(&out.join("trajectory.txt"), &result.trajectory)?;
    garad_dataset::write_trajectory(
        &out.join("keyframes.txt"),
        &result.slam.keyframe_trajectory(),
    )?;
    let mut at_rest = result.gaussians()?.clone();
    let label = at_rest.label.clone();
    at_rest.retain(|i| label[i] == Label::Static);
    let map = write_ply(&out.join("map.ply"), &at_rest, &PlyOptions::default());
    write_labels(&out.join("labels"), result)?;
    write_bytes_atomically(&out.join("losses.csv"), losses(result).as_bytes())?;
    write_bytes_atomically(&out.join("costs.csv"), costs(&result.costs).as_bytes())?;
    let config = crate::config_file::write(result.slam.config())?;
    write_bytes_atomically(&out.join("config.toml"), config.as_bytes())?;
    write_bytes_atomically(
        &out.join("metrics.json"),
        judged.metrics.to_json().as_bytes(),
    )?;

    let drawn = result
        .snapshots
        .iter()
        .map(|snapshot| draw(result, snapshot))
        .collect::<Result<Vec<_>>>()?;
    for moment in &drawn {
        for (name, picture) in moment.pictures() {
            let file = format!("{:06}_{name}.png", moment.frame);
            pictures::save_png(&pictures_dir.join(file), picture)?;
        }
    }
    let report = report(result, judged, warnings, &config, &drawn);
    write_bytes_atomically(&out.join("report.html"), report.as_bytes())?;
    map?;
    Ok(())
}

/// The labels of every frame that has any; nothing if nothing was labelled.
fn write_labels(out: &Path, result: &RunResult) -> Result<()> {
    if result.found.is_empty() {
        return Ok(());
    }
    let masks = out.join("masks");
    std::fs::create_dir_all(&masks)
        .with_context(|| format!("{}: cannot make the folder", masks.display()))?;
    let mut rows = String::from("frame,x_px,y_px,moves\n");
    for found in &result.found {
        for ([x, y], label) in found.keypoints() {
            let moves = u8::from(label == Label::Dynamic);
            rows.push_str(&format!("{},{x:.1},{y:.1},{moves}\n", found.frame.0));
        }
        let png = pictures::png_gray(&found.cells())?;
        write_bytes_atomically(&masks.join(format!("{:06}.png", found.frame.0)), &png)?;
    }
    write_bytes_atomically(&out.join("keypoints.csv"), rows.as_bytes())?;
    let mut rows = String::from("frame,keyframe,gaussians,dynamic,to_dynamic,to_static,removed\n");
    for done in result.slam.mapped() {
        let counts = done.relabelled;
        rows.push_str(&format!(
            "{},{},{},{},{},{},{}\n",
            done.frame.0,
            done.keyframe.0,
            done.gaussians,
            done.dynamic,
            counts.to_dynamic,
            counts.to_static,
            counts.removed
        ));
    }
    write_bytes_atomically(&out.join("gaussians.csv"), rows.as_bytes())?;
    // A map that cannot be written is named once, where the static part is written.
    let options = PlyOptions { label: true };
    let _ = write_ply(&out.join("gaussians.ply"), result.gaussians()?, &options);
    Ok(())
}

/// Frame by frame, time and memory.
fn costs(costs: &[FrameCost]) -> String {
    let mut rows = String::from("frame,tracking_ms,waiting_ms,resident_mib,processor_ms\n");
    for cost in costs {
        let memory = cost.resident_mb.map(|m| format!("{m:.1}"));
        let processor = cost.processor_ms.map(|p| format!("{p:.0}"));
        let (tracking_ms, waiting_ms) = (cost.tracking_ms, cost.waiting_ms);
        rows.push_str(&format!(
            "{},{tracking_ms:.2},{waiting_ms:.2},{},{}\n",
            cost.frame,
            memory.unwrap_or_default(),
            processor.unwrap_or_default()
        ));
    }
    rows
}

/// The losses of training. A number is the shortest decimal that reads back as the same f32, so equal
/// files mean equal bits. A job that did not train has no row.
fn losses(result: &RunResult) -> String {
    let mut rows = String::from("when,iteration,keyframe,level,gaussians,loss\n");
    let jobs = result.slam.mapped().iter();
    for (i, (done, loss)) in jobs.filter_map(|done| Some((done, done.loss?))).enumerate() {
        let (keyframe, gaussians) = (done.keyframe.0, done.gaussians);
        rows.push_str(&format!("job,{i},{keyframe},,{gaussians},{loss}\n"));
    }
    for (i, step) in result.refined.iter().enumerate() {
        let (keyframe, level, gaussians, loss) =
            (step.keyframe.0, step.level, step.gaussians, step.loss);
        rows.push_str(&format!(
            "refine,{i},{keyframe},{level},{gaussians},{loss}\n"
        ));
    }
    rows
}

/// Pictures of one moment.
struct Drawn {
    frame: usize,
    t_s: f64,
    input: RgbImage,
    labels: RgbImage,
    rendered: Option<(RgbImage, RgbImage, PictureQuality)>,
}

impl Drawn {
    fn pictures(&self) -> Vec<(&'static str, &RgbImage)> {
        let mut pictures = vec![("input", &self.input), ("labels", &self.labels)];
        if let Some((color, depth, _)) = &self.rendered {
            pictures.extend([("render", color), ("depth", depth)]);
        }
        pictures
    }

    fn strip(&self) -> Strip<'_> {
        Strip {
            frame: self.frame,
            t_s: self.t_s,
            input: &self.input,
            render: self.rendered.as_ref().map(|(color, ..)| color),
            labels: Some(&self.labels),
            quality: self.rendered.as_ref().map(|(.., quality)| *quality),
        }
    }
}

/// Input and labels beside what the static part of the map shows from the same place, if that place
/// is known.
fn draw(result: &RunResult, snapshot: &Snapshot) -> Result<Drawn> {
    let pose = result
        .trajectory
        .iter()
        .find(|p| p.t_s.to_bits() == snapshot.t_s.to_bits());
    let rendered = match pose {
        None => None,
        Some(pose) => {
            let rendered = fast::render(
                result.gaussians()?,
                result.slam.camera(),
                &pose.world_from_camera.inverse(),
                &RenderOptions {
                    include: Include::StaticOnly,
                    ..RenderOptions::default()
                },
                Par::new(result.threads),
            )?;
            let depth = rendered.normalized_depth();
            let color = pictures::color_picture(&rendered);
            let quality = compare_pictures(&color, &snapshot.rgb, None, Par::new(result.threads))?;
            let depth = pictures::depth_picture(&depth, pictures::depth_range(&depth));
            Some((color, depth, quality))
        }
    };
    Ok(Drawn {
        frame: snapshot.frame,
        t_s: snapshot.t_s,
        input: snapshot.rgb.clone(),
        labels: pictures::keypoint_picture(snapshot),
        rendered,
    })
}

fn report(
    result: &RunResult,
    judged: &Judged,
    warnings: &[String],
    config: &str,
    drawn: &[Drawn],
) -> String {
    let track_ms = result.stopwatch.calls_ms("frame");
    let frames: Vec<_> = result
        .frames
        .iter()
        .enumerate()
        .map(|(i, report)| FrameState {
            t_s: report.t_s,
            tracked: report.state == TrackingState::Tracking,
            keyframe: report.keyframe.is_some(),
            track_ms: track_ms.get(i).copied(),
        })
        .collect();
    let strips: Vec<_> = drawn.iter().map(Drawn::strip).collect();
    let mut notes = warnings.to_vec();
    notes.extend(
        result
            .skipped
            .iter()
            .map(|why| format!("frame skipped: {why}")),
    );
    garad_eval::report::html(&ReportData {
        metrics: &judged.metrics,
        protocol: &judged.protocol,
        ate: judged.ate.as_ref(),
        not_judged: &judged.protocol,
        frames: &frames,
        strips: &strips,
        warnings: &notes,
        config_toml: config,
    })
}
