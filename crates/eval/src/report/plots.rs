//! Trajectory, error, tracking state and tracking time.

use std::ops::Range;

use maud::{Markup, PreEscaped, html};

use super::data::{FrameState, ReportData};
use crate::EvalError;
use crate::plot::{FrameTime, error_over_time, time_per_frame, trajectory_panel, widest_planes};

/// Two views of the trajectory and the error over time.
pub(super) fn trajectory(data: &ReportData<'_>) -> Markup {
    let keyframes = data.frames.iter().filter(|frame| frame.keyframe);
    let keyframes: Vec<f64> = keyframes.map(|frame| frame.t_s).collect();
    html! {
        section {
            h2 { "Trajectory" }
            @match data.ate {
                None => { p.note { "The trajectory " (data.protocol) "." } }
                Some(ate) => {
                    div.pair {
                        @for plane in widest_planes(&ate.points) {
                            (shown(trajectory_panel(&ate.points, plane, &keyframes)))
                        }
                    }
                    div.wide {
                        (shown(error_over_time(&ate.points, start_s(data), &lost_stretches(data.frames))))
                    }
                }
            }
        }
    }
}

/// Ribbon of tracked and lost frames, and the time each took.
pub(super) fn tracking(data: &ReportData<'_>) -> Markup {
    let frame_time = |frame: &FrameState| {
        Some(FrameTime {
            t_s: frame.t_s,
            ms: frame.track_ms?,
            keyframe: frame.keyframe,
        })
    };
    let times: Vec<FrameTime> = data.frames.iter().filter_map(frame_time).collect();
    let budget_ms = usual_interval_s(data.frames).map(|s| 1000.0 * s);
    html! {
        @if !data.frames.is_empty() {
            section {
                h2 { "Tracking" }
                (ribbon(data.frames))
                @if !times.is_empty() {
                    div.wide { (shown(time_per_frame(&times, start_s(data), budget_ms))) }
                }
            }
        }
    }
}

fn shown(plot: Result<String, EvalError>) -> Markup {
    match plot {
        Ok(svg) => PreEscaped(svg),
        Err(error) => html! { p.note { "No plot: " (error) "." } },
    }
}

/// Time of the first frame: plots start there.
fn start_s(data: &ReportData<'_>) -> f64 {
    let frame = data.frames.first().map(|frame| frame.t_s);
    let point = data.ate.and_then(|ate| ate.points.first());
    frame.or(point.map(|point| point.t_s)).unwrap_or(0.0)
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
fn ribbon(frames: &[FrameState]) -> Markup {
    let n = frames.len();
    let percent = |count: usize| format!("{:.3}%", 100.0 * count as f64 / n as f64);
    let count = |f: fn(&FrameState) -> bool| frames.iter().filter(|frame| f(frame)).count();
    let (lost, keyframes) = (count(|f| !f.tracked), count(|f| f.keyframe));
    html! {
        div.ribbon {
            @for run in frames.chunk_by(|a, b| a.tracked == b.tracked) {
                @let state = if run[0].tracked { "tracked" } else { "lost" };
                i class=(state) style={ "width:" (percent(run.len())) }
                    title={ (state) ": " (run.len()) " frames" } {}
            }
        }
        div.ticks {
            @for i in (0..n).filter(|&i| frames[i].keyframe) { i style={ "left:" (percent(i)) } {} }
        }
        p.key {
            span { i.tracked {} "tracked: " (n - lost) }
            span { i.lost {} "lost: " (lost) }
            span { i.tick {} "keyframes: " (keyframes) }
        }
    }
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
