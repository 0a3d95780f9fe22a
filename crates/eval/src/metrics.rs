//! `metrics.json`: the figures of a run for machines. Its keys are stable.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::{Ate, Confusion, Jitter, Rpe, RunLabels};

/// Version of the layout; increased when the meaning of a key changes or a key is removed.
pub const SCHEMA: u32 = 1;

/// All figures of a run. Every key is always present; an unknown figure is `null`.
///
/// Keys are written in the order of the fields.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Metrics {
    /// [`SCHEMA`].
    pub schema: u32,
    /// Version of the program.
    pub version: String,
    /// Name of the recording.
    pub dataset: String,
    /// Colour images the recording lists in the chosen range; those tracked and those left out add up to it.
    #[serde(default)]
    pub listed: usize,
    /// Frames read.
    pub frames: usize,
    /// Frames with a pose.
    pub tracked: usize,
    /// Listed images without a pose.
    #[serde(default)]
    pub left_out: Vec<LeftOut>,
    /// Threads the run was allowed.
    pub threads: usize,
    /// Absolute trajectory error.
    pub ate: AteMetrics,
    /// Relative pose error over 1 s.
    pub rpe: RpeMetrics,
    /// Second differences of the positions.
    #[serde(default)]
    pub jitter: JitterMetrics,
    /// All frames, whole image.
    pub render: RenderMetrics,
    /// All frames, outside the moving mask.
    pub render_static: RenderMetrics,
    /// All frames, rendered depth against measured depth.
    #[serde(default)]
    pub render_depth: DepthMetrics,
    /// Labels, moving or static.
    pub labels: LabelMetrics,
    /// The map at the end.
    pub map: MapMetrics,
    /// Per stage, by name.
    pub timing: BTreeMap<String, StageTiming>,
    /// Duration of the run, seconds.
    pub wall_s: Option<f64>,
    /// Largest resident memory, MiB.
    pub peak_rss_mb: Option<f64>,
}

/// Listed images without a pose, for one reason.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct LeftOut {
    /// How many.
    pub frames: usize,
    /// Why, in words that follow the number.
    pub why: String,
}

/// See [`crate::ate()`].
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct AteMetrics {
    /// Root mean square, metres.
    pub rmse_m: Option<f64>,
    /// Mean, metres.
    pub mean_m: Option<f64>,
    /// Median, metres.
    pub median_m: Option<f64>,
    /// Population standard deviation, metres.
    pub std_m: Option<f64>,
    /// Largest, metres.
    pub max_m: Option<f64>,
    /// Pairs of poses.
    pub pairs: Option<usize>,
}

/// See [`crate::rpe()`].
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct RpeMetrics {
    /// Root mean square of the translation error, metres per second.
    pub trans_rmse_m_per_s: Option<f64>,
    /// Root mean square of the rotation error, degrees per second.
    pub rot_rmse_deg_per_s: Option<f64>,
}

/// See [`crate::jitter()`].
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct JitterMetrics {
    /// Root mean square, metres.
    pub rms_m: Option<f64>,
    /// The same of the ground truth at the same stamps, metres.
    pub ground_truth_rms_m: Option<f64>,
}

/// See [`crate::image_metrics`]; means over frames.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct RenderMetrics {
    /// Decibels.
    pub psnr_db: Option<f64>,
    /// At most 1.
    pub ssim: Option<f64>,
}

/// See [`crate::depth_l1()`]; means over frames, outside the moving mask if there is one.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct DepthMetrics {
    /// Mean absolute error, metres.
    pub l1_m: Option<f64>,
    /// Share of the measured pixels with rendered depth, in [0, 1].
    pub coverage: Option<f64>,
    /// Share of the pixels whose rendered depth is in front of the measured depth, see
    /// [`crate::ghosts()`].
    #[serde(default)]
    pub ghosts: Option<f64>,
}

/// See [`crate::labels`].
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct LabelMetrics {
    /// Labels of keypoints.
    pub keypoints: KeypointLabels,
    /// Masks.
    pub pixels: PixelLabels,
}

/// Labels of keypoints against the true mask.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct KeypointLabels {
    /// Share of moving among all labelled moving.
    pub precision: Option<f64>,
    /// Share of found among all moving.
    pub recall: Option<f64>,
    /// Harmonic mean of the two.
    pub f1: Option<f64>,
    /// Share of the static keypoints that were labelled moving.
    #[serde(default)]
    pub wrongly_dynamic: Option<f64>,
}

/// Masks against the true ones.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct PixelLabels {
    /// Share of moving among all labelled moving.
    pub precision: Option<f64>,
    /// Share of found among all moving.
    pub recall: Option<f64>,
    /// Harmonic mean of the two.
    pub f1: Option<f64>,
    /// Intersection over union.
    pub iou: Option<f64>,
}

/// Size of the map.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct MapMetrics {
    /// All Gaussians.
    pub gaussians: Option<usize>,
    /// Those labelled dynamic.
    pub dynamic: Option<usize>,
    /// Training iterations done beside tracking.
    #[serde(default)]
    pub iterations: usize,
    /// Training iterations done after the last frame.
    #[serde(default)]
    pub final_iterations: usize,
}

/// Durations of one stage.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct StageTiming {
    /// Half of the calls were faster, milliseconds.
    pub median_ms: f64,
    /// 95 of 100 calls were faster, milliseconds.
    pub p95_ms: f64,
    /// Number of calls.
    pub calls: usize,
    /// All calls together, milliseconds.
    #[serde(default)]
    pub total_ms: f64,
}

impl Metrics {
    /// Without figures.
    #[must_use]
    pub fn new(version: &str, dataset: &str) -> Self {
        Self {
            schema: SCHEMA,
            version: version.to_owned(),
            dataset: dataset.to_owned(),
            ..Self::default()
        }
    }

    /// How many of the listed images have a pose, as `7 of 9`.
    #[must_use]
    pub fn tracked_of_listed(&self) -> String {
        format!("{} of {}", self.tracked, self.listed)
    }

    /// Those without, as `1 without a depth image within 20 ms, 1 skipped`; empty if there are none.
    #[must_use]
    pub fn why_left_out(&self) -> String {
        let parts = self.left_out.iter();
        let parts: Vec<_> = parts.map(|o| format!("{} {}", o.frames, o.why)).collect();
        parts.join(", ")
    }

    /// The text of `metrics.json`, two spaces of indentation, ending in a newline.
    ///
    /// JSON has no NaN and no infinity: they become `null`, like unknown figures.
    ///
    /// # Panics
    /// Never: it contains only text keys and numbers.
    #[must_use]
    pub fn to_json(&self) -> String {
        let text = serde_json::to_string_pretty(self);
        text.expect("text keys and numbers have a JSON form") + "\n"
    }

    /// Reads what [`Metrics::to_json`] wrote.
    ///
    /// # Errors
    /// serde's, with line and column.
    pub fn from_json(text: &str) -> Result<Self, serde_json::Error> {
        serde_json::from_str(text)
    }
}

impl From<&Ate> for AteMetrics {
    fn from(ate: &Ate) -> Self {
        Self {
            rmse_m: Some(ate.stats.rmse),
            mean_m: Some(ate.stats.mean),
            median_m: Some(ate.stats.median),
            std_m: Some(ate.stats.std),
            max_m: Some(ate.stats.max),
            pairs: Some(ate.stats.pairs),
        }
    }
}

impl From<&Rpe> for RpeMetrics {
    /// For steps of 1 s, the default of [`crate::RpeOptions`].
    fn from(rpe: &Rpe) -> Self {
        Self {
            trans_rmse_m_per_s: Some(rpe.trans_m.rmse),
            rot_rmse_deg_per_s: Some(rpe.rot_deg.rmse),
        }
    }
}

impl From<&Jitter> for JitterMetrics {
    fn from(jitter: &Jitter) -> Self {
        Self {
            rms_m: Some(jitter.rms_m),
            ground_truth_rms_m: Some(jitter.ground_truth_rms_m),
        }
    }
}

impl From<&RunLabels> for LabelMetrics {
    /// `None` in figures that are undefined.
    fn from(run: &RunLabels) -> Self {
        Self {
            keypoints: (&run.keypoints()).into(),
            pixels: (&run.pixels()).into(),
        }
    }
}

impl From<&Confusion> for KeypointLabels {
    fn from(counts: &Confusion) -> Self {
        Self {
            precision: counts.precision(),
            recall: counts.recall(),
            f1: counts.f1(),
            wrongly_dynamic: {
                let at_rest = counts.false_positives + counts.true_negatives;
                (at_rest > 0).then(|| counts.false_positives as f64 / at_rest as f64)
            },
        }
    }
}

impl From<&Confusion> for PixelLabels {
    fn from(counts: &Confusion) -> Self {
        Self {
            precision: counts.precision(),
            recall: counts.recall(),
            f1: counts.f1(),
            iou: counts.iou(),
        }
    }
}

impl StageTiming {
    /// Summary of all durations of a stage, in milliseconds; `None` if it never ran.
    ///
    /// median: mean of the two middle values for an even count. p95: the smallest duration that
    /// at least 95 % of the calls do not exceed (nearest rank).
    #[must_use]
    pub fn of(durations_ms: &[f64]) -> Option<Self> {
        let calls = durations_ms.len();
        let mut sorted = durations_ms.to_vec();
        sorted.sort_by(f64::total_cmp);
        let rank = (calls * 95).div_ceil(100);
        Some(Self {
            median_ms: 0.5 * (sorted.get(calls.checked_sub(1)? / 2)? + sorted[calls / 2]),
            p95_ms: sorted[rank - 1],
            calls,
            total_ms: durations_ms.iter().sum(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::Value;

    /// Every path to a leaf, in the order of the text.
    fn leaves(prefix: &str, value: &Value, out: &mut Vec<String>) {
        match value {
            Value::Object(map) => {
                for (key, value) in map {
                    leaves(&format!("{prefix}.{key}"), value, out);
                }
            }
            _ => out.push(prefix.trim_start_matches('.').to_owned()),
        }
    }

    #[test]
    fn keys_are_stable() {
        let mut metrics = Metrics::new("0.1.0", "demo");
        let timing = StageTiming::of(&[3.0, 1.0]).expect("two calls");
        metrics.timing.insert("track".to_owned(), timing);
        let value: Value = serde_json::from_str(&metrics.to_json()).expect("valid JSON");
        let mut found = Vec::new();
        leaves("", &value, &mut found);
        found.sort();
        let mut expected: Vec<&str> = "schema version dataset listed frames tracked left_out threads \
            ate.rmse_m ate.mean_m ate.median_m ate.std_m ate.max_m ate.pairs \
            rpe.trans_rmse_m_per_s rpe.rot_rmse_deg_per_s \
            jitter.rms_m jitter.ground_truth_rms_m \
            render.psnr_db render.ssim render_static.psnr_db render_static.ssim \
            render_depth.l1_m render_depth.coverage render_depth.ghosts \
            labels.keypoints.precision labels.keypoints.recall labels.keypoints.f1 labels.keypoints.wrongly_dynamic \
            labels.pixels.precision labels.pixels.recall labels.pixels.f1 labels.pixels.iou \
            map.gaussians map.dynamic map.iterations map.final_iterations \
            timing.track.median_ms timing.track.p95_ms timing.track.calls timing.track.total_ms \
            wall_s peak_rss_mb"
            .split_whitespace()
            .collect();
        expected.sort_unstable();
        assert_eq!(found, expected, "keys");
        assert!(value["ate"]["rmse_m"].is_null(), "unknown is null");
        assert_eq!(value["schema"], 1, "schema");
        assert!(value["timing"]["track"]["calls"] == 2, "count");
    }

    #[test]
    fn text_is_stable_and_reads_back() {
        let mut metrics = Metrics::new("0.1.0", "café \"x\"");
        metrics.ate.rmse_m = Some(0.022_131);
        metrics
            .timing
            .insert("b".to_owned(), StageTiming::default());
        metrics
            .timing
            .insert("a".to_owned(), StageTiming::default());
        let text = metrics.to_json();
        assert_eq!(
            Metrics::from_json(&text).expect("own text"),
            metrics,
            "round trip"
        );
        let at = |key: &str| text.find(&format!("\"{key}\"")).expect("key");
        assert!(
            at("schema") < at("frames") && at("frames") < at("ate"),
            "order of fields"
        );
        assert!(at("a") < at("b"), "stages by name");
        metrics.render.psnr_db = Some(f64::INFINITY);
        let back = Metrics::from_json(&metrics.to_json()).expect("own text");
        assert_eq!(back.render.psnr_db, None, "no infinity in JSON");
    }

    #[test]
    fn percentiles_by_hand() {
        let hundred: Vec<f64> = (1..=100).rev().map(f64::from).collect();
        let timing = StageTiming::of(&hundred).expect("100 calls");
        let expected = StageTiming {
            median_ms: 50.5,
            p95_ms: 95.0,
            calls: 100,
            total_ms: 5050.0,
        };
        assert_eq!(timing, expected, "1..=100");
        let one = StageTiming::of(&[7.0]).expect("one call");
        assert!(
            (one.median_ms - 7.0).abs() + (one.p95_ms - 7.0).abs() < 1e-15,
            "{one:?}"
        );
        assert!(StageTiming::of(&[]).is_none(), "never ran");
    }
}
