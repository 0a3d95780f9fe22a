//! Trajectory, error, tracking state and tracking time.

use std::ops::Range;

use super::{FrameState, ReportData, note, section, start_s};
use crate::EvalError;
use crate::plot::{FrameTime, error_over_time, time_per_frame, trajectory_panel, widest_planes};

/// Two views of the trajectory and the error over time.
pub(super) fn trajectory(data: &ReportData<'_>) -> String {
    let Some(ate) = data.ate else {
        let reason = match data.not_judged {
            "" => "The trajectory cannot be judged.".to_owned(),
            reason => format!("The trajectory cannot be judged: {reason}."),
        };
        return section("Trajectory", &note(&reason));
    };
    let keyframes: Vec<f64> = data
        .frames
        .iter()
        .filter(|frame| frame.keyframe)
        .map(|frame| frame.t_s)
        .collect();
    let panels = widest_planes(&ate.points)
        .map(|plane| shown(trajectory_panel(&ate.points, plane, &keyframes)));
    let error = shown(error_over_time(
        &ate.points,
        start_s(data),
        &lost_stretches(data.frames),
    ));
    let body = format!(
        "<div class=\"pair\">{}</div>\n<div class=\"wide\">{error}</div>\n",
        panels.concat()
    );
    section("Trajectory", &body)
}

/// Ribbon of tracked and lost frames, and the time each took.
pub(super) fn tracking(data: &ReportData<'_>) -> String {
    if data.frames.is_empty() {
        return String::new();
    }
    let times: Vec<FrameTime> = data
        .frames
        .iter()
        .filter_map(|frame| {
            Some(FrameTime {
                t_s: frame.t_s,
                ms: frame.track_ms?,
                keyframe: frame.keyframe,
            })
        })
        .collect();
    let plot = if times.is_empty() {
        String::new()
    } else {
        let budget = usual_interval_s(data.frames).map(|s| 1000.0 * s);
        let plot = shown(time_per_frame(&times, start_s(data), budget));
        format!("<div class=\"wide\">{plot}</div>\n")
    };
    section("Tracking", &(ribbon(data.frames) + &plot))
}

fn shown(plot: Result<String, EvalError>) -> String {
    plot.unwrap_or_else(|error| note(&format!("No plot: {error}.")))
}

/// From the last frame with a pose to the first with one again.
fn lost_stretches(frames: &[FrameState]) -> Vec<Range<f64>> {
    let mut stretches = Vec::new();
    let mut first = 0;
    for run in frames.chunk_by(|a, b| a.tracked == b.tracked) {
        let end = first + run.len();
        if !run[0].tracked {
            let after = frames.get(end).unwrap_or(&frames[end - 1]);
            stretches.push(frames[first.saturating_sub(1)].t_s..after.t_s);
        }
        first = end;
    }
    stretches
}

fn usual_interval_s(frames: &[FrameState]) -> Option<f64> {
    let mut steps: Vec<f64> = frames.windows(2).map(|w| w[1].t_s - w[0].t_s).collect();
    steps.sort_by(f64::total_cmp);
    steps.get(steps.len() / 2).copied()
}

/// One bar per run of equal state, keyframes as ticks below; each frame has the same width.
fn ribbon(frames: &[FrameState]) -> String {
    let n = frames.len();
    let share = |count: usize| 100.0 * count as f64 / n as f64;
    let mut bars = String::new();
    for run in frames.chunk_by(|a, b| a.tracked == b.tracked) {
        let state = if run[0].tracked { "tracked" } else { "lost" };
        let width = share(run.len());
        let title = format!("{state}: {} frames", run.len());
        bars += &format!("<i class=\"{state}\" style=\"width:{width:.3}%\" title=\"{title}\"></i>");
    }
    let ticks: String = (0..n)
        .filter(|&i| frames[i].keyframe)
        .map(|i| format!("<i style=\"left:{:.3}%\"></i>", share(i)))
        .collect();
    let count = |f: fn(&FrameState) -> bool| frames.iter().filter(|frame| f(frame)).count();
    let (lost, keyframes) = (count(|f| !f.tracked), count(|f| f.keyframe));
    format!(
        "<div class=\"ribbon\">{bars}</div><div class=\"ticks\">{ticks}</div>\n\
         <p class=\"key\"><span><i class=\"tracked\"></i>tracked: {}</span>\
         <span><i class=\"lost\"></i>lost: {lost}</span>\
         <span><i class=\"tick\"></i>keyframes: {keyframes}</span></p>\n",
        n - lost
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lost_stretches_reach_from_pose_to_pose() {
        let frames = |states: &[bool]| -> Vec<FrameState> {
            let frame = |(t_s, &tracked): (f64, &bool)| FrameState {
                t_s,
                tracked,
                keyframe: false,
                track_ms: None,
            };
            let times = (0..).map(f64::from);
            times.zip(states).map(frame).collect()
        };
        let lost = |states: &[bool]| lost_stretches(&frames(states));
        assert_eq!(
            lost(&[true, false, false, true]),
            [0.0..3.0],
            "in the middle"
        );
        assert_eq!(
            lost(&[false, true, false]),
            [0.0..1.0, 1.0..2.0],
            "at both ends"
        );
        assert!(
            lost(&[true, true]).is_empty() && lost(&[]).is_empty(),
            "never"
        );
        assert_eq!(usual_interval_s(&frames(&[true; 4])), Some(1.0), "interval");
    }
}
