//! [`Comparison`]: runs of one recording side by side, as Markdown and as JSON; as a page,
//! [`crate::report::comparison_html`].

use serde::Serialize;

use crate::Metrics;

/// The table of several runs on one recording.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Comparison {
    /// Name of the recording.
    pub recording: String,
    /// Version of the program.
    pub version: String,
    /// The runs.
    pub rows: Vec<Row>,
    /// Published figures of other systems.
    pub published: Vec<Row>,
    /// How it was measured, a sentence each.
    pub notes: Vec<String>,
}

/// One run.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Row {
    /// Name of the run.
    pub name: String,
    /// Its figures, as far as they are known.
    #[serde(flatten)]
    pub figures: Figures,
    /// What is missing and why; empty if nothing is.
    pub remark: String,
}

/// The columns. Unknown figures are `None`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Figures {
    /// Absolute trajectory error, root mean square, metres.
    pub ate_rmse_m: Option<f64>,
    /// Its standard deviation, metres.
    pub ate_std_m: Option<f64>,
    /// Frames with a pose.
    pub tracked: Option<usize>,
    /// Colour images listed.
    pub listed: Option<usize>,
    /// Frames read.
    pub frames: Option<usize>,
    /// Labels of keypoints, F1.
    pub keypoint_f1: Option<f64>,
    /// Masks, intersection over union.
    pub mask_iou: Option<f64>,
    /// Render of the static Gaussians outside the moving mask, dB.
    pub static_psnr_db: Option<f64>,
    /// Share of the pixels whose rendered depth is in front of the measured depth ([`crate::ghosts()`]).
    pub ghosts: Option<f64>,
    /// Gaussians labelled dynamic.
    pub dynamic_gaussians: Option<usize>,
    /// All Gaussians.
    pub gaussians: Option<usize>,
    /// Processor time of all threads per frame, milliseconds.
    pub processor_ms_per_frame: Option<f64>,
}

/// Heads of the columns beside the name.
pub(crate) const COLUMNS: [&str; 11] = [
    "ATE RMSE [m]",
    "STD [m]",
    "tracked",
    "keypoint F1",
    "mask IoU",
    "static PSNR [dB]",
    "ghosts [%]",
    "dynamic Gaussians",
    "Gaussians",
    "CPU [ms/frame]",
    "remark",
];

impl Figures {
    /// Those of a run that took so much processor time.
    #[must_use]
    pub fn new(metrics: &Metrics, processor_ms: Option<f64>) -> Self {
        let (labels, map) = (&metrics.labels, &metrics.map);
        let has_map = map.gaussians.is_some_and(|n| n > 0);
        Self {
            ate_rmse_m: metrics.ate.rmse_m,
            ate_std_m: metrics.ate.std_m,
            tracked: Some(metrics.tracked),
            listed: Some(metrics.listed),
            frames: Some(metrics.frames),
            keypoint_f1: labels.keypoints.f1,
            mask_iou: labels.pixels.iou,
            static_psnr_db: metrics.render_static.psnr_db,
            ghosts: metrics.render_depth.ghosts,
            dynamic_gaussians: map.dynamic.filter(|_| has_map),
            gaussians: map.gaussians.filter(|_| has_map),
            processor_ms_per_frame: processor_ms.map(|ms| ms / metrics.frames.max(1) as f64),
        }
    }
}

impl Row {
    /// A run without a result.
    #[must_use]
    pub fn failed(name: &str, reason: &str) -> Self {
        Self {
            name: name.to_owned(),
            remark: reason.to_owned(),
            ..Self::default()
        }
    }

    /// A text for each of [`COLUMNS`].
    pub(crate) fn cells(&self) -> [String; COLUMNS.len()] {
        let f = &self.figures;
        let number = |v: Option<f64>, digits: usize| v.map(|v| format!("{v:.digits$}"));
        let count = |n: Option<usize>| n.map(|n| n.to_string());
        let tracked = f
            .tracked
            .zip(f.listed)
            .map(|(n, of)| format!("{n} of {of}"));
        [
            number(f.ate_rmse_m, 4),
            number(f.ate_std_m, 4),
            tracked,
            number(f.keypoint_f1, 3),
            number(f.mask_iou, 3),
            number(f.static_psnr_db, 1),
            number(f.ghosts.map(|share| 100.0 * share), 2),
            count(f.dynamic_gaussians),
            count(f.gaussians),
            number(f.processor_ms_per_frame, 0),
            Some(self.remark.clone()),
        ]
        .map(|cell| cell.unwrap_or_else(|| "-".to_owned()))
    }
}

impl Comparison {
    /// Runs first, then published figures.
    pub(crate) fn all_rows(&self) -> impl Iterator<Item = (String, &Row)> {
        let runs = self.rows.iter().map(|row| (row.name.clone(), row));
        let published = self.published.iter();
        runs.chain(published.map(|row| (format!("{}, published", row.name), row)))
    }

    /// The table and its notes.
    #[must_use]
    pub fn markdown(&self) -> String {
        let line = |name: &str, cells: &[&str]| {
            let cells: Vec<String> = (cells.iter())
                .map(|cell| cell.replace('|', "\\|").replace('\n', " "))
                .collect();
            format!("| {name} | {} |\n", cells.join(" | "))
        };
        let mut text = line("", &COLUMNS);
        text += &format!("|{}\n", "---|".repeat(COLUMNS.len() + 1));
        for (name, row) in self.all_rows() {
            text += &line(&name, &row.cells().each_ref().map(String::as_str));
        }
        if !self.notes.is_empty() {
            text += &format!("\n{}\n", self.notes.join("\n"));
        }
        text
    }

    /// Every figure, two spaces of indentation, ending in a newline. Unknown figures are `null`.
    ///
    /// # Panics
    /// Never: it contains only text keys and numbers.
    #[must_use]
    pub fn to_json(&self) -> String {
        let text = serde_json::to_string_pretty(self);
        text.expect("text keys and numbers have a JSON form") + "\n"
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn sample() -> Comparison {
        let mut metrics = Metrics::new("0.1.0", "walk");
        (metrics.listed, metrics.frames, metrics.tracked) = (64, 60, 59);
        metrics.ate.rmse_m = Some(0.012_34);
        metrics.render_depth.ghosts = Some(0.0123);
        metrics.map.gaussians = Some(5000);
        metrics.map.dynamic = Some(12);
        let whole = Row {
            name: "whole".to_owned(),
            figures: Figures::new(&metrics, Some(6000.0)),
            remark: String::new(),
        };
        let mut published = Row::failed("X-SLAM", "");
        published.figures.ate_rmse_m = Some(0.5);
        Comparison {
            recording: "walk".to_owned(),
            version: "0.1.0".to_owned(),
            rows: vec![whole, Row::failed("broken", "no <map> | none")],
            published: vec![published],
            notes: vec!["Measured once.".to_owned()],
        }
    }

    #[test]
    fn markdown_has_a_row_for_each_run() {
        let text = sample().markdown();
        let expected = [
            "| whole | 0.0123 | - | 59 of 64 | - | - | - | 1.23 | 12 | 5000 | 100 |  |",
            "| broken | - | - | - | - | - | - | - | - | - | - | no <map> \\| none |",
            "| X-SLAM, published | 0.5000 | - | - | - | - | - | - | - | - | - |  |",
            "",
            "Measured once.",
        ];
        let lines: Vec<&str> = text.lines().skip(2).collect();
        assert_eq!(lines, expected, "rows and notes");
    }

    #[test]
    fn json_has_null_for_what_is_not_known() {
        let value: serde_json::Value =
            serde_json::from_str(&sample().to_json()).expect("valid JSON");
        let rows = &value["rows"];
        assert_eq!(rows[0]["tracked"], 59, "{rows}");
        assert!(rows[1]["ate_rmse_m"].is_null(), "{rows}");
        assert_eq!(rows[1]["remark"], "no <map> | none", "{rows}");
        assert_eq!(value["published"][0]["name"], "X-SLAM", "{value}");
    }

    #[test]
    fn without_a_map_there_are_no_counts() {
        let mut metrics = Metrics::new("0.1.0", "walk");
        metrics.map.gaussians = Some(0);
        metrics.map.dynamic = Some(0);
        let figures = Figures::new(&metrics, None);
        assert_eq!(figures.gaussians, None, "none");
        assert_eq!(figures.dynamic_gaussians, None, "none");
    }
}
