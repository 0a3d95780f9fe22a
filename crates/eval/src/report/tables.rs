//! Stages with their durations; long texts, folded.

use maud::{Markup, html};

use crate::Metrics;

/// One row per stage with a bar: full up to the median, pale up to the 95th percentile.
pub(super) fn timing(metrics: &Metrics) -> Markup {
    let timings = metrics.timing.values();
    let slowest = timings.fold(1e-9, |m: f64, t| m.max(t.p95_ms));
    let width = |ms: f64| format!("width:{:.2}%", (100.0 * ms / slowest).clamp(0.0, 100.0));
    let mut stages: Vec<_> = metrics.timing.iter().collect();
    // Slowest first; equal ones stay in the order of their names.
    stages.sort_by(|a, b| b.1.median_ms.total_cmp(&a.1.median_ms));
    html! {
        @if !stages.is_empty() {
            section {
                h2 { "Time per stage" }
                div.scroll {
                    table.timing {
                        thead {
                            tr { th { "stage" } th { "calls" } th { "median, ms" } th { "95 %, ms" } th {} }
                        }
                        tbody {
                            @for (name, t) in stages {
                                tr {
                                    th scope="row" { (name) }
                                    td { (t.calls) }
                                    td { (milliseconds(t.median_ms)) }
                                    td { (milliseconds(t.p95_ms)) }
                                    td.bars {
                                        i.p95 style=(width(t.p95_ms)) {}
                                        i.median style=(width(t.median_ms)) {}
                                    }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn milliseconds(ms: f64) -> String {
    match ms {
        ms if ms >= 100.0 => format!("{ms:.0}"),
        ms if ms >= 1.0 => format!("{ms:.1}"),
        _ => format!("{ms:.3}"),
    }
}

/// A text under a summary, folded until it is clicked; nothing if it is empty.
pub(super) fn details(summary: &str, text: &str) -> Markup {
    html! {
        @if !text.trim().is_empty() {
            details {
                summary { (summary) }
                pre { (text) }
            }
        }
    }
}
