//! [`Judged`]: the figures of a run.

use garad_core::{Label, StampedPose};
use garad_eval::{Ate, AteOptions, MAX_DT_S, Metrics, RpeOptions, ate, jitter, rpe};

use crate::render_quality::RenderQuality;
use crate::run::RunResult;
use crate::usage::peak_resident_mb;

/// The figures of a run.
#[derive(Debug)]
pub struct Judged {
    /// Everything for `metrics.json`.
    pub metrics: Metrics,
    /// The absolute trajectory error with its pairs, if there is ground truth.
    pub ate: Option<Ate>,
    /// How it was measured, or why it was not.
    pub protocol: String,
}

impl Judged {
    /// Judges the path of a run. Without ground truth the protocol says so; it is not an error.
    #[must_use]
    pub fn new(
        dataset: &str,
        result: &RunResult,
        ground_truth: Option<&[StampedPose]>,
        which_truth: &str,
    ) -> Self {
        let mut metrics = Metrics::new(env!("CARGO_PKG_VERSION"), dataset);
        metrics.frames = result.log.frames.len() + result.log.skipped.len();
        metrics.tracked = result.trajectory.len();
        metrics.threads = result.threads;
        metrics.timing = result.log.stopwatch.summary();
        metrics.wall_s = Some(result.wall_s);
        metrics.peak_rss_mb = peak_resident_mb();
        let gaussians = result.gaussians();
        let dynamic = gaussians.label.iter().filter(|l| **l == Label::Dynamic);
        metrics.map.gaussians = Some(gaussians.len());
        metrics.map.dynamic = Some(dynamic.count());
        metrics.labels = (&result.log.labels.judged).into();
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
        if let Some(Ok(jitter)) =
            ground_truth.map(|truth| jitter(truth, &result.trajectory, MAX_DT_S))
        {
            metrics.jitter = (&jitter).into();
        }
        Self {
            metrics,
            ate,
            protocol,
        }
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
