//! The top of the page: what was run, warnings, and the main figures.

use maud::{Markup, html};

use super::data::ReportData;
use crate::Metrics;
use crate::metrics::RenderMetrics;

/// Name of the recording, facts of the run, protocol.
pub(super) fn header(data: &ReportData<'_>) -> Markup {
    let m = data.metrics;
    html! {
        header {
            p.eyebrow { "garad run report" }
            h1 { (m.dataset) }
            ul.facts {
                li { (m.frames) " frames" }
                li { (threads(m)) }
                @if let Some(wall_s) = m.wall_s { li { (duration(wall_s)) " wall time" } }
                @if let Some(mb) = m.peak_rss_mb { li { (format!("{mb:.0}")) " MiB memory" } }
                li { "garad " (m.version) }
            }
            @if data.ate.is_some() && !data.protocol.is_empty() {
                p.protocol { "Trajectory judged by: " (data.protocol) "." }
            }
        }
    }
}

fn threads(m: &Metrics) -> String {
    match m.threads {
        1 => "1 thread".to_owned(),
        threads => format!("{threads} threads"),
    }
}

/// "1.4 s", "12 min 05 s".
fn duration(s: f64) -> String {
    if s < 60.0 {
        return format!("{s:.1} s");
    }
    let minutes = (s / 60.0).floor();
    format!("{minutes} min {:02.0} s", (s - 60.0 * minutes).floor())
}

pub(super) fn warnings(warnings: &[String]) -> Markup {
    html! {
        @if !warnings.is_empty() {
            aside.warnings {
                strong { "Warnings" }
                ul { @for warning in warnings { li { (warning) } } }
            }
        }
    }
}

/// The main figures as cards.
pub(super) fn headline(data: &ReportData<'_>) -> Markup {
    let m = data.metrics;
    let (keypoints, pixels) = (&m.labels.keypoints, &m.labels.pixels);
    html! {
        div.cards {
            (ate_card(data))
            @if let (Some(trans), Some(rot)) = (m.rpe.trans_rmse_m_per_s, m.rpe.rot_rmse_deg_per_s) {
                (card("Drift (RPE, RMSE)", &length(trans, "/s"), &format!("{rot:.2}°/s in rotation")))
            }
            @if let (Some(rms), Some(truth)) = (m.jitter.rms_m, m.jitter.ground_truth_rms_m) {
                (card("Jitter (RMS)", &length(rms, ""), &format!("ground truth {}", length(truth, ""))))
            }
            (tracked_card(m))
            @if let Some(wall_s) = m.wall_s.filter(|&s| s > 0.0) {
                (card("Frames per second", &format!("{:.1}", m.frames as f64 / wall_s), &threads(m)))
            }
            (render_card("Render, whole image", &m.render))
            (render_card("Render, static part", &m.render_static))
            @if let Some(f1) = keypoints.f1 {
                (card("Labels of keypoints (F1)", &format!("{f1:.2}"),
                      &precision_recall(keypoints.precision, keypoints.recall)))
            }
            @if let Some(iou) = pixels.iou {
                (card("Moving mask (IoU)", &format!("{iou:.2}"),
                      &precision_recall(pixels.precision, pixels.recall)))
            }
            @if let Some(gaussians) = m.map.gaussians {
                @let dynamic = m.map.dynamic.map(|n| format!("{} labelled dynamic", grouped(n)));
                (card("Gaussians in the map", &grouped(gaussians), &dynamic.unwrap_or_default()))
            }
        }
    }
}

fn ate_card(data: &ReportData<'_>) -> Markup {
    let ate = &data.metrics.ate;
    let name = "Trajectory error (ATE, RMSE)";
    let Some(rmse) = ate.rmse_m else {
        return card(name, "–", data.protocol);
    };
    let small = [("mean", ate.mean_m), ("std", ate.std_m), ("max", ate.max_m)];
    let small = small.map(|(name, value)| Some(format!("{name} {}", length(value?, ""))));
    card(name, &length(rmse, ""), &joined(&small))
}

fn tracked_card(m: &Metrics) -> Markup {
    let share = 100.0 * m.tracked as f64 / m.listed.max(1) as f64;
    // 99.96 % is not shown as 100 %.
    let share = match m.tracked < m.listed {
        true => format!("{:.1} %", share.min(99.9)),
        false => format!("{share:.0} %"),
    };
    let counts = format!("{} frames listed", m.tracked_of_listed());
    let parts = [counts, m.why_left_out()].map(|part| Some(part).filter(|part| !part.is_empty()));
    card("Tracked", &share, &joined(&parts))
}

fn render_card(name: &str, render: &RenderMetrics) -> Markup {
    let ssim = render.ssim.map(|ssim| format!("SSIM {ssim:.3}"));
    html! {
        @if let Some(psnr_db) = render.psnr_db {
            (card(name, &format!("{psnr_db:.1} dB"), &ssim.unwrap_or_default()))
        }
    }
}

fn precision_recall(precision: Option<f64>, recall: Option<f64>) -> String {
    let part = |name, value: Option<f64>| Some(format!("{name} {:.2}", value?));
    joined(&[part("precision", precision), part("recall", recall)])
}

fn joined(parts: &[Option<String>]) -> String {
    let known: Vec<&str> = parts.iter().flatten().map(String::as_str).collect();
    known.join(" · ")
}

fn card(name: &str, big: &str, small: &str) -> Markup {
    html! {
        div.card {
            div.name { (name) }
            div.big { (big) }
            div.small { (small) }
        }
    }
}

/// Metres in the unit that reads best: "2.21 cm".
fn length(m: f64, per: &str) -> String {
    match m.abs() {
        a if a < 0.01 => format!("{:.2} mm{per}", m * 1000.0),
        a if a < 1.0 => format!("{:.2} cm{per}", m * 100.0),
        _ => format!("{m:.2} m{per}"),
    }
}

/// 1234567 as "1 234 567", with spaces that do not break.
fn grouped(n: usize) -> String {
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
