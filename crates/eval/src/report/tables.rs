//! Stages with their durations, all figures, and the configuration.

use super::{escape, section};
use crate::Metrics;

/// One row per stage with a bar: full up to the median, pale up to the 95th percentile.
pub(super) fn timing(metrics: &Metrics) -> String {
    if metrics.timing.is_empty() {
        return String::new();
    }
    let slowest = metrics
        .timing
        .values()
        .fold(1e-9, |m: f64, t| m.max(t.p95_ms));
    let mut stages: Vec<_> = metrics.timing.iter().collect();
    // Slowest first; equal ones stay in the order of their names.
    stages.sort_by(|a, b| b.1.median_ms.total_cmp(&a.1.median_ms));
    let rows: String = stages
        .iter()
        .map(|(name, t)| {
            let share = |ms: f64| (100.0 * ms / slowest).clamp(0.0, 100.0);
            format!(
                "<tr><th scope=\"row\">{}</th><td>{}</td><td>{}</td><td>{}</td>\
                 <td class=\"bars\"><i class=\"p95\" style=\"width:{:.2}%\"></i>\
                 <i class=\"median\" style=\"width:{:.2}%\"></i></td></tr>\n",
                escape(name),
                t.calls,
                milliseconds(t.median_ms),
                milliseconds(t.p95_ms),
                share(t.p95_ms),
                share(t.median_ms)
            )
        })
        .collect();
    let table = format!(
        "<div class=\"scroll\"><table class=\"timing\"><thead><tr><th>stage</th><th>calls</th>\
         <th>median, ms</th><th>95 %, ms</th><th></th></tr></thead>\n<tbody>\n{rows}</tbody>\
         </table></div>\n"
    );
    section("Time per stage", &table)
}

fn milliseconds(ms: f64) -> String {
    match ms {
        ms if ms >= 100.0 => format!("{ms:.0}"),
        ms if ms >= 1.0 => format!("{ms:.1}"),
        _ => format!("{ms:.3}"),
    }
}

/// What `metrics.json` holds, in full precision.
pub(super) fn all_figures(metrics: &Metrics) -> String {
    details("All figures (metrics.json)", &metrics.to_json())
}

pub(super) fn configuration(toml: &str) -> String {
    if toml.trim().is_empty() {
        return String::new();
    }
    details("Configuration as used", toml)
}

fn details(summary: &str, text: &str) -> String {
    let text = escape(text);
    format!("<details><summary>{summary}</summary>\n<pre>{text}</pre></details>\n")
}
