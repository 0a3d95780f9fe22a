//! `report.html`: one run on one page, in one file; `compare.html`: several runs on one.
//!
//! Everything is inline: styles, plots (SVG), images (JPEG in base64). No scripts, nothing is
//! fetched. The page follows the reader's light or dark setting and fits a phone. `maud` escapes
//! every text that is put into it.

mod comparison;
mod data;
mod figures;
mod images;
mod plots;
mod tables;

use maud::{DOCTYPE, Markup, PreEscaped, html};

pub use self::comparison::{PictureRow, comparison_html};
pub use self::data::{FrameState, ReportData, Strip};

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

/// A page with the styles, around its content.
fn page(title: &str, version: &str, content: &Markup) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                title { (title) " · garad" }
                style { (PreEscaped(include_str!("style.css"))) }
            }
            body {
                main {
                    (content)
                    footer { "garad " (version) " · GARAD-SLAM on the CPU" }
                }
            }
        }
    };
    page.into_string()
}

#[cfg(test)]
mod tests;
