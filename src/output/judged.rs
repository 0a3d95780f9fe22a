//! [`Judged`]: the figures of a run.

use garad_core::{Label, StampedPose};
use garad_dataset::Dataset;
use garad_eval::{
    Alignment, Ate, AteOptions, LeftOut, MAX_DT_S, Metrics, RpeOptions, ate, jitter, rpe,
};

use crate::render_quality::RenderQuality;
use crate::run::RunResult;
use crate::usage::peak_resident_mb;

/// The true path that a run is judged by.
#[derive(Debug, Clone)]
pub struct Truth {
    /// Poses whose positions the ATE compares.
    pub poses: Vec<StampedPose>,
    /// Poses of the camera itself, where `poses` are of another body on the sensor: RPE and jitter compare motions,
    /// and a lever arm changes those. `None`: `poses` are the camera's.
    pub of_camera: Option<Vec<StampedPose>>,
    /// What the truth is, in words.
    pub protocol: &'static str,
}

impl Truth {
    /// Exact poses of the camera.
    #[must_use]
    pub fn exact(poses: Vec<StampedPose>) -> Self {
        Self {
            poses,
            of_camera: None,
            protocol: "exact ground truth",
        }
    }

    fn camera_poses(&self) -> &[StampedPose] {
        self.of_camera.as_ref().unwrap_or(&self.poses)
    }
}

/// Why there is no RPE.
const ANOTHER_BODY: &str = "no RPE: the ground truth turns by the camera's angles about other axes, so it is of another body on the sensor, such as a marker";
/// Best scale of the path beyond which units are wrong, not the estimate.
const SCALE_IN_DOUBT: f64 = 1.2;
/// A scale explains an error if it leaves no more than this part of it.
const EXPLAINED: f64 = 0.3;

/// A word on the scale of a path: `Some` where a similarity fits the truth far better than a rigid motion, with a
/// scale beyond [`SCALE_IN_DOUBT`].
fn scale_in_doubt(rigid: &Ate, truth: &[StampedPose], path: &[StampedPose]) -> Option<String> {
    let options = AteOptions {
        alignment: Alignment::Similarity,
        ..AteOptions::default()
    };
    let scaled = ate(truth, path, &options).ok()?;
    let scale = scaled.truth_from_estimate.scale;
    let (factor, what) = match scale > 1.0 {
        true => (scale, "shorter"),
        false => (1.0 / scale, "longer"),
    };
    let explained = scaled.stats.rmse < EXPLAINED * rigid.stats.rmse;
    (explained && factor > SCALE_IN_DOUBT).then(|| {
        format!("the path is {factor:.1} times {what} than the truth: is depth_factor right (or the focal length)?")
    })
}

/// The figures of a run.
#[derive(Debug)]
pub struct Judged {
    /// Everything for `metrics.json`.
    pub metrics: Metrics,
    /// The absolute trajectory error with its pairs, if there is ground truth.
    pub ate: Option<Ate>,
    /// How it was measured, or why it was not.
    pub protocol: String,
    /// What the figures say of the recording rather than of the run.
    pub warnings: Vec<String>,
}

impl Judged {
    /// Judges the path of a run: ATE against the poses of the truth, RPE and jitter against those of the camera.
    /// Without ground truth the protocol says so; it is not an error.
    #[must_use]
    pub fn new(dataset: &str, result: &RunResult, truth: Option<&Truth>) -> Self {
        let mut metrics = Metrics::new(env!("CARGO_PKG_VERSION"), dataset);
        (metrics.frames, metrics.tracked) = (result.done, result.trajectory.len());
        let read = result.log.frames.len();
        for (frames, why) in [
            (result.done.saturating_sub(read), "skipped"),
            (read.saturating_sub(metrics.tracked), "without a pose"),
        ] {
            add_left_out(&mut metrics, frames, why);
        }
        metrics.listed = metrics.frames;
        metrics.threads = result.threads;
        metrics.timing = result.log.stopwatch.summary();
        metrics.wall_s = Some(result.wall_s);
        metrics.peak_rss_mb = peak_resident_mb();
        let gaussians = result.gaussians();
        let dynamic = gaussians.label.iter().filter(|l| **l == Label::Dynamic);
        metrics.map.gaussians = Some(gaussians.len());
        metrics.map.dynamic = Some(dynamic.count());
        metrics.map.iterations = result.slam.mapped().iter().map(|job| job.iterations).sum();
        metrics.map.final_iterations = result.log.refined.len();
        metrics.labels = (&result.log.labels.judged).into();
        let options = AteOptions::default();
        let (path, mut warnings) = (&result.trajectory, Vec::new());
        let (ate, protocol) = match truth {
            None => (None, "cannot be judged: no ground truth".to_owned()),
            Some(_) if path.is_empty() => {
                (None, "cannot be judged: no frame has a pose".to_owned())
            }
            Some(truth) => match ate(&truth.poses, path, &options) {
                Ok(ate) => {
                    warnings.extend(scale_in_doubt(&ate, &truth.poses, path));
                    let other_body = match truth.of_camera {
                        Some(_) => "; RPE and jitter against poses of the camera",
                        None => "",
                    };
                    let how = format!("{}, {}{other_body}", options.describe(), truth.protocol);
                    (Some(ate), how)
                }
                Err(error) => (None, format!("cannot be judged: {error}")),
            },
        };
        if let Some(ate) = &ate {
            metrics.ate = ate.into();
        }
        if let Some(truth) = truth.map(Truth::camera_poses) {
            match rpe(truth, path, &RpeOptions::default()) {
                Ok(rpe) if rpe.is_of_another_body() => warnings.push(ANOTHER_BODY.to_owned()),
                Ok(rpe) => metrics.rpe = (&rpe).into(),
                Err(_) => {} // shorter than a second
            }
            if let Ok(jitter) = jitter(truth, path, MAX_DT_S) {
                metrics.jitter = (&jitter).into();
            }
        }
        Self {
            metrics,
            ate,
            protocol,
            warnings,
        }
    }

    /// Counts what the recording lists beyond the frames read: images that are no frame, and frames that an early end
    /// has left.
    #[must_use]
    pub fn of_recording(mut self, dataset: &Dataset) -> Self {
        let metrics = &mut self.metrics;
        let not_reached = dataset.len().saturating_sub(metrics.frames);
        add_left_out(metrics, not_reached, "not reached");
        if let Some(out) = dataset.left_out() {
            add_left_out(metrics, out.frames, &out.why);
        }
        metrics.listed = dataset.listed();
        self
    }

    /// Adds the figures of the map's renders.
    pub fn add_render(&mut self, quality: &RenderQuality) {
        self.metrics.render = quality.all;
        self.metrics.render_static = quality.outside_mask;
        self.metrics.render_depth = quality.depth;
    }

    /// The figures in a few lines, for the terminal.
    #[must_use]
    pub fn summary(&self) -> Vec<String> {
        let m = &self.metrics;
        let mut lines = vec![format!(
            "tracked    {} frames listed, {} Gaussians, {} training iterations",
            m.tracked_of_listed(),
            m.map.gaussians.unwrap_or(0),
            m.map.iterations + m.map.final_iterations
        )];
        if !m.left_out.is_empty() {
            lines.push(format!("left out   {}", m.why_left_out()));
        }
        if let Some(frame) = m.timing.get("frame") {
            lines.push(format!(
                "time       {:.1} s in all; tracking alone {:.1} frames/s ({:.1} ms median, {:.1} ms at 95 %), {} thread(s)",
                m.wall_s.unwrap_or(0.0),
                1e3 * frame.calls as f64 / frame.total_ms.max(1e-3),
                frame.median_ms,
                frame.p95_ms,
                m.threads
            ));
        }
        if let (Some(psnr), Some(ssim)) = (m.render.psnr_db, m.render.ssim) {
            lines.push(format!(
                "render     PSNR {psnr:.2} dB, SSIM {ssim:.4} over all frames, whole image"
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
                if let (Some(rms), Some(truth)) = (m.jitter.rms_m, m.jitter.ground_truth_rms_m) {
                    lines.push(format!(
                        "jitter [mm]  rms {:.2}, of the ground truth {:.2}",
                        1e3 * rms,
                        1e3 * truth
                    ));
                }
                lines.push(format!("protocol   {}", self.protocol));
            }
            None => lines.push(format!("ATE        {}", self.protocol)),
        }
        lines
    }
}

fn add_left_out(metrics: &mut Metrics, frames: usize, why: &str) {
    if frames > 0 {
        let why = why.to_owned();
        metrics.left_out.push(LeftOut { frames, why });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use garad_core::Se3;
    use nalgebra::Vector3;

    /// A bent path, scaled; every second position moved aside by `noise_m`.
    fn path(scale: f64, noise_m: f64) -> Vec<StampedPose> {
        let pose = |i: u8| {
            let (x, side) = (f64::from(i), noise_m * f64::from(i % 2));
            let at = Vector3::new(0.1 * x, 0.02 * x * x + side, 0.05 * x) * scale;
            StampedPose {
                t_s: x,
                world_from_camera: Se3::new(Default::default(), at),
            }
        };
        (0..20).map(pose).collect()
    }

    #[test]
    fn a_path_of_wrong_units_is_called_so() {
        let truth = path(1.0, 0.0);
        let said = |scale: f64, noise_m: f64| {
            let estimate = path(scale, noise_m);
            let rigid = ate(&truth, &estimate, &AteOptions::default()).expect("judged");
            scale_in_doubt(&rigid, &truth, &estimate)
        };
        let cases = [
            (0.2, 0.01, Some("5.0 times shorter")),
            (1.3, 0.01, Some("1.3 times longer")),
            (1.15, 0.01, None),
            (0.87, 0.01, None),
            (0.7, 3.0, None), // the noise is the larger error
        ];
        for (scale, noise_m, expected) in cases {
            let warning = said(scale, noise_m);
            let right = match expected {
                Some(words) => warning.as_ref().is_some_and(|w| w.contains(words)),
                None => warning.is_none(),
            };
            assert!(right, "scale {scale}, noise {noise_m} m: {warning:?}");
        }
    }
}
