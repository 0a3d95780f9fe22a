//! The top of the page: what was run, what went wrong, and the figures people ask for.

use super::{ReportData, escape};
use crate::Metrics;

/// Name of the recording, facts of the run, protocol.
pub(super) fn header(data: &ReportData<'_>) -> String {
    let metrics = data.metrics;
    let mut facts = vec![
        format!("{} frames", metrics.frames),
        match metrics.threads {
            1 => "1 thread".to_owned(),
            threads => format!("{threads} threads"),
        },
    ];
    if let Some(wall_s) = metrics.wall_s {
        facts.push(format!("{} wall time", duration(wall_s)));
    }
    if let Some(mb) = metrics.peak_rss_mb {
        facts.push(format!("{mb:.0} MiB memory"));
    }
    facts.push(format!("garad {}", escape(&metrics.version)));
    let facts: String = facts
        .iter()
        .map(|fact| format!("<li>{fact}</li>"))
        .collect();
    let protocol = if data.ate.is_some() && !data.protocol.is_empty() {
        let protocol = escape(data.protocol);
        format!("<p class=\"protocol\">Trajectory judged by: {protocol}.</p>\n")
    } else {
        String::new()
    };
    let dataset = escape(&metrics.dataset);
    format!(
        "<header>\n<p class=\"eyebrow\">garad run report</p>\n<h1>{dataset}</h1>\n\
         <ul class=\"facts\">{facts}</ul>\n{protocol}</header>\n"
    )
}

/// "1.4 s", "12 min 05 s".
fn duration(s: f64) -> String {
    if s < 60.0 {
        return format!("{s:.1} s");
    }
    let minutes = (s / 60.0).floor();
    format!("{minutes} min {:02.0} s", (s - 60.0 * minutes).floor())
}

pub(super) fn warnings(warnings: &[String]) -> String {
    if warnings.is_empty() {
        return String::new();
    }
    let items = warnings.iter().map(|w| format!("<li>{}</li>", escape(w)));
    format!(
        "<aside class=\"warnings\"><strong>Warnings</strong>\n<ul>{}</ul></aside>\n",
        items.collect::<String>()
    )
}

/// The big numbers.
pub(super) fn headline(data: &ReportData<'_>) -> String {
    let m = data.metrics;
    let mut cards = vec![ate_card(data)];
    if let (Some(trans), Some(rot)) = (m.rpe.trans_rmse_m_per_s, m.rpe.rot_rmse_deg_per_s) {
        let small = format!("{rot:.2}°/s in rotation");
        cards.push(card("Drift (RPE, RMSE)", &length(trans, "/s"), &small));
    }
    cards.push(tracked_card(m));
    if let Some(card) = speed_card(m) {
        cards.push(card);
    }
    cards.extend(render_card("Render, whole picture", &m.render));
    cards.extend(render_card("Render, static part", &m.render_static));
    if let Some(f1) = m.labels.keypoints.f1 {
        let small = precision_recall(m.labels.keypoints.precision, m.labels.keypoints.recall);
        cards.push(card(
            "Labels of keypoints (F1)",
            &format!("{f1:.2}"),
            &small,
        ));
    }
    if let Some(iou) = m.labels.pixels.iou {
        let small = precision_recall(m.labels.pixels.precision, m.labels.pixels.recall);
        cards.push(card("Moving mask (IoU)", &format!("{iou:.2}"), &small));
    }
    if let Some(gaussians) = m.map.gaussians {
        let small = m.map.dynamic.map_or(String::new(), |n| {
            format!("{} labelled dynamic", grouped(n))
        });
        cards.push(card("Gaussians in the map", &grouped(gaussians), &small));
    }
    format!("<div class=\"cards\">\n{}</div>\n", cards.concat())
}

fn ate_card(data: &ReportData<'_>) -> String {
    let ate = &data.metrics.ate;
    let name = "Trajectory error (ATE, RMSE)";
    let Some(rmse) = ate.rmse_m else {
        let reason = match data.not_judged {
            "" => "cannot be judged".to_owned(),
            reason => format!("cannot be judged: {reason}"),
        };
        return card(name, "–", &reason);
    };
    let mut small = Vec::new();
    for (name, value) in [("mean", ate.mean_m), ("std", ate.std_m), ("max", ate.max_m)] {
        if let Some(value) = value {
            small.push(format!("{name} {}", length(value, "")));
        }
    }
    card(name, &length(rmse, ""), &small.join(" · "))
}

fn tracked_card(m: &Metrics) -> String {
    let share = 100.0 * m.tracked as f64 / m.frames.max(1) as f64;
    let small = format!("{} of {} frames", m.tracked, m.frames);
    // 99.96 % is not 100 %.
    let shown = if m.tracked < m.frames {
        share.min(99.9)
    } else {
        share
    };
    let digits = usize::from(m.tracked < m.frames);
    card("Tracked", &format!("{shown:.digits$} %"), &small)
}

fn speed_card(m: &Metrics) -> Option<String> {
    let wall_s = m.wall_s.filter(|&s| s > 0.0)?;
    let fps = m.frames as f64 / wall_s;
    let small = match m.threads {
        1 => "1 thread".to_owned(),
        threads => format!("{threads} threads"),
    };
    Some(card("Frames per second", &format!("{fps:.1}"), &small))
}

fn render_card(name: &str, render: &crate::metrics::RenderMetrics) -> Option<String> {
    let small = render
        .ssim
        .map_or(String::new(), |ssim| format!("SSIM {ssim:.3}"));
    Some(card(name, &format!("{:.1} dB", render.psnr_db?), &small))
}

fn precision_recall(precision: Option<f64>, recall: Option<f64>) -> String {
    let part = |name, value: Option<f64>| value.map(|v| format!("{name} {v:.2}"));
    let parts = [part("precision", precision), part("recall", recall)];
    parts.into_iter().flatten().collect::<Vec<_>>().join(" · ")
}

fn card(name: &str, big: &str, small: &str) -> String {
    let (name, big, small) = (escape(name), escape(big), escape(small));
    format!(
        "<div class=\"card\"><div class=\"name\">{name}</div><div class=\"big\">{big}</div>\
         <div class=\"small\">{small}</div></div>\n"
    )
}

/// Metres in the unit that reads best: "2.21 cm".
pub(super) fn length(m: f64, per: &str) -> String {
    match m.abs() {
        a if a < 0.01 => format!("{:.2} mm{per}", m * 1000.0),
        a if a < 1.0 => format!("{:.2} cm{per}", m * 100.0),
        _ => format!("{m:.2} m{per}"),
    }
}

/// 1234567 as "1 234 567", with spaces that do not break.
pub(super) fn grouped(n: usize) -> String {
    let digits = n.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push('\u{202f}');
        }
        text.push(digit);
    }
    text
}
