//! The CSV files of OUT.

use std::fmt::Write as _;

use garad_core::Label;

use crate::run::RunResult;

/// `labels/keypoints.csv`: the label of every keypoint of every labelled frame.
pub(super) fn keypoints(result: &RunResult) -> String {
    let found = result.log.labels.found.iter();
    let rows = found.flat_map(|frame| frame.keypoints().map(|keypoint| (frame.frame.0, keypoint)));
    table("frame,x_px,y_px,moves", rows, |(frame, ([x, y], label))| {
        let moves = u8::from(label == Label::Dynamic);
        format!("{frame},{x:.1},{y:.1},{moves}")
    })
}

/// `labels/gaussians.csv`: labels of the map, a row per mapping job.
pub(super) fn gaussians(result: &RunResult) -> String {
    let header = "frame,keyframe,gaussians,dynamic,to_dynamic,to_static,removed";
    table(header, result.slam.mapped(), |done| {
        let (frame, keyframe, n, dynamic) =
            (done.frame.0, done.keyframe.0, done.gaussians, done.dynamic);
        let counts = done.relabelled;
        let (to_dynamic, to_static, removed) =
            (counts.to_dynamic, counts.to_static, counts.removed);
        format!("{frame},{keyframe},{n},{dynamic},{to_dynamic},{to_static},{removed}")
    })
}

/// `costs.csv`: time and memory, a row per frame.
pub(super) fn costs(result: &RunResult) -> String {
    let header = "frame,tracking_ms,waiting_ms,resident_mib,processor_ms";
    table(header, &result.log.costs, |cost| {
        let memory = cost.resident_mb.map(|m| format!("{m:.1}"));
        let processor = cost.processor_ms.map(|p| format!("{p:.0}"));
        let (memory, processor) = (memory.unwrap_or_default(), processor.unwrap_or_default());
        let (frame, tracking_ms, waiting_ms) = (cost.frame, cost.tracking_ms, cost.waiting_ms);
        format!("{frame},{tracking_ms:.2},{waiting_ms:.2},{memory},{processor}")
    })
}

/// `losses.csv`: the losses of training. A number is the shortest decimal that reads back as the same
/// f32, so equal files mean equal bits. A mapping job that did not train has no row.
pub(super) fn losses(result: &RunResult) -> String {
    let jobs = result.slam.mapped().iter();
    let jobs = jobs.filter_map(|done| Some((done, done.loss?)));
    let jobs = jobs.enumerate().map(|(i, (done, loss))| {
        let (keyframe, gaussians) = (done.keyframe.0, done.gaussians);
        format!("job,{i},{keyframe},,{gaussians},{loss}")
    });
    let steps = result.log.refined.iter().enumerate().map(|(i, step)| {
        let (keyframe, level, gaussians, loss) =
            (step.keyframe.0, step.level, step.gaussians, step.loss);
        format!("refine,{i},{keyframe},{level},{gaussians},{loss}")
    });
    let header = "when,iteration,keyframe,level,gaussians,loss";
    table(header, jobs.chain(steps), |row| row)
}

/// `frames.csv`: whether each frame was tracked.
pub(super) fn frames(result: &RunResult) -> String {
    table("frame,t_s,state,inliers", &result.log.frames, |frame| {
        let (id, t_s, state) = (frame.id.0, frame.t_s, frame.state.name());
        format!("{id},{t_s:.6},{state},{}", frame.inliers)
    })
}

fn table<T>(header: &str, rows: impl IntoIterator<Item = T>, line: impl Fn(T) -> String) -> String {
    let mut text = format!("{header}\n");
    for row in rows {
        writeln!(text, "{}", line(row)).expect("a String takes everything");
    }
    text
}
