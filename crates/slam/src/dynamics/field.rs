//! The random field over one frame (eq. 1 to 6): samples, their depth evidence, labels and mask.
//!
//! ```text
//! first pose ─→ samples of the frame ─→ free space of the last seconds ─→ depth evidence ←─ patch motion
//!                                                                              │
//!            keypoint labels, mask in cells ←─ beliefs ←─ random field ←───────┴──── flow check of suspects
//! ```

use garad_core::{Label, Real};
use garad_crf::{Crf, Cues, Node, unary};

use super::evidence::{DepthEvidence, FreeSpaceHistory};
use super::flow_check::{at_rest, outliers};
use super::mask::{label_at, mask_from_beliefs};
use super::past::{ReferenceImage, nearest_to_rest};
use super::patch_motion::add_patch_motion;
use super::samples::{FrameView, Lattice, Sample, keypoint_samples};
use crate::config::Config;
use crate::context::Context;
use crate::frame::FrameLabels;
use crate::mask::{self, CELL_PX};
use crate::trace::Recorder;

/// Labels a frame's keypoints and mask from its first pose. `None` if the history contradicts
/// nearly every sample, which is a wrong pose rather than a crowd.
pub(crate) fn label_samples(
    context: &Context,
    view: FrameView<'_>,
    lattice: &Lattice,
    crf: &Crf,
    history: &FreeSpaceHistory<'_>,
    references: &[ReferenceImage<'_>],
    recorder: &mut Recorder,
) -> Option<FrameLabels> {
    let config = &context.config;
    let FrameView { frame, depth, .. } = view;
    let keypoints = keypoint_samples(frame, &context.camera);
    let blocks = lattice.samples(frame, depth, context);
    let samples: Vec<Sample> = keypoints
        .iter()
        .map(|(_, sample)| *sample)
        .chain(blocks.iter().flatten().copied())
        .collect();
    let mut evidence = depth_evidence(context, history, &samples);
    let contradicted =
        |evidence: &[DepthEvidence]| suspected_share(config, evidence) > config.labels.max_moving;
    if contradicted(&evidence) {
        return None;
    }
    let nodes: Vec<Node> = samples
        .iter()
        .map(|sample| Node {
            p_world: sample.p_world,
            uv_px: Some(sample.px),
            ..Node::default()
        })
        .collect();
    let infer = |evidence: &[DepthEvidence], recorder: &mut Recorder| {
        let log_odds: Vec<f64> = evidence.iter().map(|e| log_odds(config, e)).collect();
        let beliefs = crf
            .infer_from_log_odds(&nodes, &log_odds, context.par)
            .expect("samples and log-odds are finite, one of each per node");
        recorder.record("label", |record| {
            record.field(&nodes, evidence, &log_odds, &beliefs);
        });
        beliefs
    };
    let mut beliefs = infer(&evidence, recorder);
    let threshold = config.crf.threshold;
    let suspected: Vec<bool> = beliefs.dynamic.iter().map(|b| *b > threshold).collect();
    let suspects = suspected.iter().filter(|s| **s).count() as f64 / samples.len().max(1) as f64;
    if let Some(pyramid) = view
        .pyramid
        .filter(|_| suspects > 0.0 && suspects >= config.labels.patch_motion.min_suspects)
    {
        add_patch_motion(context, view, pyramid, references, &samples, &mut evidence);
        if contradicted(&evidence) {
            return None;
        }
        if let Some(reference) = nearest_to_rest(references, config.labels.rest_frames) {
            let rests = at_rest(context, pyramid, *reference, &samples, &suspected, recorder);
            let at_rest = DepthEvidence {
                residual: Some(0.0),
                agreed_frames: reference.age_frames,
            };
            let restored = evidence.iter_mut().zip(rests).filter(|(_, rests)| *rests);
            restored.for_each(|(evidence, _)| *evidence = at_rest);
        }
        beliefs = infer(&evidence, recorder);
    }

    let labels = labels_from_beliefs(
        context,
        view,
        lattice,
        (&keypoints, &blocks),
        &beliefs.dynamic,
    );
    recorder.record("masks", |record| record.labels(&labels));
    Some(labels)
}

/// Labels a frame's keypoints and mask by their flow since the reference image nearest to `rest_frames`, against
/// that of all samples (`labels.source = "flow"`). `None` without an image.
pub(crate) fn label_by_flow(
    context: &Context,
    view: FrameView<'_>,
    lattice: &Lattice,
    references: &[ReferenceImage<'_>],
    recorder: &mut Recorder,
) -> Option<FrameLabels> {
    let reference = nearest_to_rest(references, context.config.labels.rest_frames)?;
    let keypoints = keypoint_samples(view.frame, &context.camera);
    let blocks = lattice.samples(view.frame, view.depth, context);
    let samples: Vec<Sample> = (keypoints.iter().map(|(_, sample)| *sample))
        .chain(blocks.iter().flatten().copied())
        .collect();
    let moves = outliers(context, view.pyramid?, *reference, &samples, recorder);
    let beliefs: Vec<f64> = moves.into_iter().map(|m| f64::from(u8::from(m))).collect();
    let labels = labels_from_beliefs(context, view, lattice, (&keypoints, &blocks), &beliefs);
    recorder.record("masks", |record| record.labels(&labels));
    Some(labels)
}

/// The labels of a frame from the beliefs of its samples, keypoints before the lattice.
fn labels_from_beliefs(
    context: &Context,
    FrameView { frame, depth, .. }: FrameView<'_>,
    lattice: &Lattice,
    (keypoints, blocks): (&[(usize, Sample)], &[Option<Sample>]),
    beliefs: &[f64],
) -> FrameLabels {
    let config = &context.config;
    let threshold = config.crf.threshold;
    let (of_keypoints, of_lattice) = beliefs.split_at(keypoints.len());
    let edge_ratio = config.labels.edge_ratio;
    let cells = mask_from_beliefs(lattice, blocks, of_lattice, depth, edge_ratio, threshold);
    let mut label: Vec<Label> = frame.px.iter().map(|px| label_at(&cells, px)).collect();
    // Keypoints crowd where there is texture and support each other there; the lattice is even.
    for ((i, _), belief) in keypoints.iter().zip(of_keypoints) {
        if *belief > threshold {
            label[*i] = Label::Dynamic;
        }
    }
    let near = mask::dilated(&cells, config.labels.reach_px.div_ceil(CELL_PX));
    let in_use = (frame.px.iter().zip(&label))
        .map(|(px, label)| *label == Label::Static && label_at(&near, px) == Label::Static);
    FrameLabels {
        in_use: in_use.collect(),
        label,
        cells,
        restored: Vec::new(),
    }
}

/// Share of suspects among the samples that the history judges; 0 if it judges none.
fn suspected_share(config: &Config, evidence: &[DepthEvidence]) -> f64 {
    let judged = evidence.iter().filter_map(|e| e.residual);
    let suspects = judged.clone().filter(|r| *r > config.labels.suspect_sigmas);
    suspects.count() as f64 / judged.count().max(1) as f64
}

/// The evidence on every sample.
fn depth_evidence(
    context: &Context,
    history: &FreeSpaceHistory<'_>,
    samples: &[Sample],
) -> Vec<DepthEvidence> {
    let query = |range: std::ops::Range<usize>| {
        let evidence = range.map(|i| history.query(&samples[i].p_world));
        evidence.collect::<Vec<_>>()
    };
    context.par.map_chunks(samples.len(), 128, query).concat()
}

/// ln((1 - P) / P) of a sample, with P(static) = likelihood of its depth residual (eq. 2) times a
/// prior that grows with the age of the evidence.
///
/// A surface seen at this position a moment ago says little: a person takes a second to leave
/// their own outline. One seen there a second ago says a lot.
fn log_odds(config: &Config, evidence: &DepthEvidence) -> f64 {
    let labels = &config.labels;
    let unary = &config.crf.unary;
    let (prior, likelihood) = match evidence.residual {
        None => (labels.trust_unknown, 1.0),
        Some(_) => {
            let settled = f64::from(evidence.agreed_frames) / f64::from(labels.settle_frames);
            let [young, old] = [labels.trust_young, labels.trust_old];
            let cues = Cues {
                depth_residual: evidence.residual,
                ..Cues::default()
            };
            let prior = young + (old - young) * settled.min(1.0);
            (prior, unary::p_static(&cues, unary))
        }
    };
    let p = (likelihood * prior).max(unary.clamp);
    Real::ln((1.0 - p) / p)
}

#[cfg(test)]
mod tests;
