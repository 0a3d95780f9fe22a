//! `report.html`: one run on one page that can be mailed around.
//!
//! Everything is inline: styles, plots (SVG), pictures (JPEG in base64). No scripts, nothing is
//! fetched. The page follows the reader's light or dark setting and fits a phone.

mod figures;
mod pictures;
mod plots;
mod tables;

use garad_core::RgbImage;

use crate::{Ate, ImageQuality, Metrics};

/// What the page shows. Whatever is empty or `None` is left out or said to be unknown.
#[derive(Debug, Clone, Copy)]
pub struct ReportData<'a> {
    /// Figures, counts, version and name of the recording.
    pub metrics: &'a Metrics,
    /// How the trajectory was judged, e.g. "rigid alignment, nearest time within 0.02 s, raw
    /// ground truth".
    pub protocol: &'a str,
    /// Trajectory errors; without them the page says `not_judged`.
    pub ate: Option<&'a Ate>,
    /// Why there are no trajectory errors, e.g. "no ground truth".
    pub not_judged: &'a str,
    /// All frames in order of time.
    pub frames: &'a [FrameState],
    /// Frames to look at.
    pub strips: &'a [Strip<'a>],
    /// What the reader should know, one sentence each.
    pub warnings: &'a [String],
    /// The configuration as used.
    pub config_toml: &'a str,
}

/// One frame of the recording.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameState {
    /// Seconds, in the recording's time.
    pub t_s: f64,
    /// Whether it has a pose.
    pub tracked: bool,
    /// Whether it became a keyframe.
    pub keyframe: bool,
    /// Duration of tracking, milliseconds.
    pub track_ms: Option<f64>,
}

/// Pictures of one frame side by side.
#[derive(Debug, Clone, Copy)]
pub struct Strip<'a> {
    /// Index of the frame.
    pub frame: usize,
    /// Seconds since the first frame.
    pub t_s: f64,
    /// What the camera saw.
    pub input: &'a RgbImage,
    /// The map seen from the estimated pose.
    pub render: Option<&'a RgbImage>,
    /// Labels, drawn over the input or as a mask.
    pub labels: Option<&'a RgbImage>,
    /// Render against input.
    pub quality: Option<ImageQuality>,
}

/// The page. The same data give the same text.
///
/// A part that cannot be made (a plot of non-finite numbers, a picture of no pixels) is replaced
/// by a sentence that says why.
#[must_use]
pub fn html(data: &ReportData<'_>) -> String {
    let title = escape(&data.metrics.dataset);
    let version = escape(&data.metrics.version);
    let sections = [
        figures::header(data),
        figures::warnings(data.warnings),
        figures::headline(data),
        plots::trajectory(data),
        plots::tracking(data),
        pictures::strips(data.strips),
        tables::timing(data.metrics),
        tables::all_figures(data.metrics),
        tables::configuration(data.config_toml),
    ];
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
         <meta name=\"color-scheme\" content=\"light dark\">\n\
         <title>{title} · garad</title>\n<style>\n{}</style>\n</head>\n<body>\n<main>\n{}\
         <footer>garad {version} · GARAD-SLAM on the CPU</footer>\n</main>\n</body>\n</html>\n",
        include_str!("style.css"),
        sections.concat()
    )
}

/// Text as HTML and XML show it, in content and in attributes.
pub(crate) fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            '\'' => escaped.push_str("&#39;"),
            // No page shows them, and XML forbids them.
            c if c.is_control() && c != '\n' && c != '\t' => escaped.push('\u{fffd}'),
            c => escaped.push(c),
        }
    }
    escaped
}

/// A heading and what stands below it; nothing if there is nothing.
fn section(heading: &str, body: &str) -> String {
    if body.is_empty() {
        return String::new();
    }
    format!("<section>\n<h2>{heading}</h2>\n{body}</section>\n")
}

/// A sentence in place of what is missing.
fn note(text: &str) -> String {
    format!("<p class=\"note\">{}</p>\n", escape(text))
}

/// Time of the first frame: plots and ribbons start there.
fn start_s(data: &ReportData<'_>) -> f64 {
    let frame = data.frames.first().map(|frame| frame.t_s);
    let point = data.ate.and_then(|ate| ate.points.first());
    frame.or(point.map(|point| point.t_s)).unwrap_or(0.0)
}

#[cfg(test)]
mod tests;
