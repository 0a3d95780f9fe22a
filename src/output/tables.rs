//! The CSV files of OUT.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use garad_core::Label;

use crate::run::RunResult;
use crate::usage::FrameCost;

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

/// `frames.csv`: how each frame was tracked, and what it cost. Times, memory and processor time are
/// different in every run; nothing else is.
pub(super) fn frames(result: &RunResult) -> String {
    let header = "frame,t_s,state,keypoints,moving_share,inliers,keyframe,\
                  tracking_ms,waiting_ms,resident_mib,processor_ms";
    let costs: BTreeMap<u32, &FrameCost> = result.log.costs.iter().map(|c| (c.frame, c)).collect();
    table(header, &result.log.frames, |frame| {
        let state = match frame.weak {
            true => "weak",
            false => frame.state.name(),
        };
        let (id, t_s, keypoints, inliers) = (frame.id.0, frame.t_s, frame.keypoints, frame.inliers);
        let moving_share = frame.dynamic_keypoints as f64 / keypoints.max(1) as f64;
        let keyframe = frame.keyframe.map(|k| k.0.to_string()).unwrap_or_default();
        let cost = costs.get(&id).map(|c| cost(c)).unwrap_or_default();
        format!("{id},{t_s:.6},{state},{keypoints},{moving_share:.4},{inliers},{keyframe},{cost}")
    })
}

fn cost(cost: &FrameCost) -> String {
    let memory = cost
        .resident_mb
        .map(|m| format!("{m:.1}"))
        .unwrap_or_default();
    let processor = cost
        .processor_ms
        .map(|p| format!("{p:.0}"))
        .unwrap_or_default();
    let (tracking_ms, waiting_ms) = (cost.tracking_ms, cost.waiting_ms);
    format!("{tracking_ms:.2},{waiting_ms:.2},{memory},{processor}")
}

fn table<T>(header: &str, rows: impl IntoIterator<Item = T>, line: impl Fn(T) -> String) -> String {
    let mut text = format!("{header}\n");
    for row in rows {
        writeln!(text, "{}", line(row)).expect("a String takes everything");
    }
    text
}
