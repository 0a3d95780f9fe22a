//! Runs of one recording side by side: `STEM.md`, `STEM.json` and `STEM.html`.

use anyhow::Result;
use garad_core::RgbImage;
use garad_eval::report::{PictureRow, comparison_html};
use garad_eval::{Comparison, Figures, Row};
use std::collections::BTreeMap;

use super::folder::ResultFolder;
use super::judged::Judged;
use super::moments::Moment;
use crate::reason::reason;
use crate::run::RunResult;

/// A run as it is compared with others.
#[derive(Debug)]
pub struct Compared {
    /// Its row of the table.
    pub row: Row,
    /// What its static map shows at the frames of the snapshots that have a pose; empty without a map.
    views: BTreeMap<usize, RgbImage>,
    /// The input of the frames of the snapshots.
    inputs: BTreeMap<usize, RgbImage>,
}

impl Compared {
    /// A run that took so much processor time.
    ///
    /// # Errors
    /// If the map cannot be rendered.
    pub fn new(
        name: &str,
        result: &RunResult,
        judged: &Judged,
        processor_ms: Option<f64>,
    ) -> Result<Self> {
        let snapshots = &result.log.snapshots;
        let mut views = BTreeMap::new();
        for snapshot in snapshots.iter().filter(|_| !result.gaussians().is_empty()) {
            let view = Moment::draw(result, snapshot)?.into_color();
            views.extend(view.map(|view| (snapshot.frame, view)));
        }
        let inputs = snapshots.iter().map(|s| (s.frame, s.rgb.clone()));
        Ok(Self {
            row: Row {
                name: name.to_owned(),
                figures: Figures::new(&judged.metrics, processor_ms),
                remark: remark(result, judged),
            },
            views,
            inputs: inputs.collect(),
        })
    }

    /// A run that ended with an error.
    #[must_use]
    pub fn failed(name: &str, error: &anyhow::Error) -> Self {
        Self {
            row: Row::failed(name, &reason(error)),
            views: BTreeMap::new(),
            inputs: BTreeMap::new(),
        }
    }
}

/// Why a figure is missing.
fn remark(result: &RunResult, judged: &Judged) -> String {
    match &result.log.stopped_by {
        Some(error) => format!("stopped by --strict: {}", reason(error)),
        None if result.trajectory.is_empty() => "no frame could be tracked".to_owned(),
        None if judged.ate.is_none() => judged.protocol.clone(),
        None => judged.metrics.why_left_out(),
    }
}

/// Writes the table, with the pictures of all runs on its page, and removes what an earlier comparison left
/// there.
///
/// # Errors
/// Every file that cannot be written.
pub fn write_comparison(
    mut out: ResultFolder,
    stem: &str,
    comparison: &Comparison,
    compared: &[Compared],
) -> Result<()> {
    let file = |extension: &str| format!("{stem}.{extension}");
    out.bytes(&file("md"), comparison.markdown().as_bytes());
    out.bytes(&file("json"), comparison.to_json().as_bytes());
    let mut inputs = BTreeMap::new();
    for run in compared {
        inputs.extend(&run.inputs);
    }
    let frames: Vec<usize> = inputs.keys().map(|frame| **frame).collect();
    let mut rows = vec![PictureRow {
        name: "input",
        pictures: inputs.into_values().map(Some).collect(),
    }];
    rows.extend(compared.iter().map(|run| PictureRow {
        name: &run.row.name,
        pictures: frames.iter().map(|frame| run.views.get(frame)).collect(),
    }));
    let page = comparison_html(comparison, &frames, &rows);
    out.bytes(&file("html"), page.as_bytes());
    out.finish()
}
