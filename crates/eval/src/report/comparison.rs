//! The page of a [`Comparison`]: its table, and the same frames of every run.

use garad_core::RgbImage;
use maud::{Markup, html};

use super::images::figure;
use super::page::page;
use crate::comparison::{COLUMNS, Comparison};

/// Pictures of one run; a frame without one is `None`.
#[derive(Debug, Clone)]
pub struct PictureRow<'a> {
    /// Name of the run.
    pub name: &'a str,
    /// One per frame.
    pub pictures: Vec<Option<&'a RgbImage>>,
}

/// The page. `frames` are the positions in the recording of the pictures of every row.
#[must_use]
pub fn comparison_html(
    comparison: &Comparison,
    frames: &[usize],
    rows: &[PictureRow<'_>],
) -> String {
    let Comparison {
        recording,
        version,
        notes,
        ..
    } = comparison;
    page(
        recording,
        version,
        &html! {
            header {
                p.eyebrow { "garad comparison" }
                h1 { (recording) }
            }
            section {
                (table(comparison))
                @for note in notes { p.note { (note) } }
            }
            @if !frames.is_empty() {
                section {
                    h2 { "The input, and the static map from the same poses" }
                    @for row in rows { (pictures(row, frames)) }
                }
            }
        },
    )
}

fn table(comparison: &Comparison) -> Markup {
    html! {
        div.scroll {
            table {
                thead { tr { th {} @for column in COLUMNS { th { (column) } } } }
                tbody {
                    @for (name, row) in comparison.all_rows() {
                        tr {
                            th scope="row" { (name) }
                            @for cell in row.cells() { td { (cell) } }
                        }
                    }
                }
            }
        }
    }
}

fn pictures(row: &PictureRow<'_>, frames: &[usize]) -> Markup {
    let columns = format!("grid-template-columns:repeat({},1fr)", frames.len());
    html! {
        p.caption { (row.name) }
        @if row.pictures.iter().all(Option::is_none) {
            p.note { "No picture: no map, or no pose in these frames." }
        } @else {
            div.strip style=(columns) {
                @for (frame, picture) in frames.iter().zip(&row.pictures) {
                    @match picture {
                        Some(picture) => { (figure(&format!("frame {frame}"), row.name, picture)) }
                        None => { p.note { "frame " (frame) ": no pose" } }
                    }
                }
            }
        }
    }
}
