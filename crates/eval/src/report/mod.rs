//! `report.html`: one run on one page, in one file; `compare.html`: several runs on one.
//!
//! Everything is inline: styles, plots (SVG), images (JPEG in base64). No scripts, nothing is
//! fetched. The page follows the reader's light or dark setting and fits a phone. `maud` escapes
//! every text that is put into it.

mod comparison;
mod data;
mod figures;
mod images;
mod page;
mod plots;
mod tables;

use maud::html;

pub use self::comparison::{PictureRow, comparison_html};
pub use self::data::{FrameState, ReportData, Strip};
use self::page::page;

/// The page. The same data give the same text.
///
/// A part that cannot be made (a plot of non-finite numbers, an image without pixels) is replaced
/// by a sentence that says why.
#[must_use]
pub fn html(data: &ReportData<'_>) -> String {
    let metrics = data.metrics;
    page(
        &metrics.dataset,
        &metrics.version,
        &html! {
            (figures::header(data))
            (figures::warnings(data.warnings))
            (figures::headline(data))
            (plots::trajectory(data))
            (plots::tracking(data))
            (images::strips(data.strips))
            (tables::timing(metrics))
            (tables::details("All figures (metrics.json)", &metrics.to_json()))
            (tables::details("Configuration as used", data.config_toml))
        },
    )
}

#[cfg(test)]
mod tests;
