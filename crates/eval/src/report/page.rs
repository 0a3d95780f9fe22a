//! What every page has around its content.

use maud::{DOCTYPE, Markup, PreEscaped, html};

/// A page with the styles, around its content.
pub(super) fn page(title: &str, version: &str, content: &Markup) -> String {
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
