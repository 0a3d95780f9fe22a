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
use super::past::ReferenceImage;
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
        let off = |r: &&ReferenceImage<'_>| r.age_frames.abs_diff(config.labels.rest_frames);
        if let Some(reference) = references.iter().min_by_key(off) {
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
    let off = |r: &&ReferenceImage<'_>| r.age_frames.abs_diff(context.config.labels.rest_frames);
    let reference = references.iter().min_by_key(off)?;
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
mod tests {
    use std::sync::Arc;

    use garad_core::{DepthImage, GrayImage, MaskImage, Se3};
    use garad_features::LkPyramid;

    use super::*;
    use crate::mask::{MOVING, full_size};
    use crate::testing::{World, is_in, places, texture, wall, wall_behind};

    /// Keyframes 0, 20 and 40, all of this.
    fn world_that_saw(depth: &DepthImage, config: Config) -> World {
        let mut world = World::new(config);
        for id in [0, 20, 40] {
            let seen = world.frame(id, depth);
            world.keep(seen, depth);
        }
        world
    }

    fn moving_share(cells: &MaskImage) -> f64 {
        let moving = cells.data().iter().filter(|c| **c == MOVING).count();
        moving as f64 / cells.data().len() as f64
    }

    #[test]
    fn a_new_box_is_dynamic_to_the_cell() {
        let world = world_that_saw(&wall(), Config::default());
        let box_px = [[48, 112], [32, 96]];
        let depth = wall_behind(box_px);
        let mut now = world.frame(60, &depth);
        let cells = world.label(&mut now, &depth, None).expect("labelled");
        let expected = MaskImage::from_fn(40, 30, |x, y| {
            if is_in(box_px, 4 * x, 4 * y) {
                MOVING
            } else {
                0
            }
        });
        assert_eq!(cells, expected, "the box and nothing else");
        let near = [[44, 116], [28, 100]];
        for (i, [x, y]) in places().into_iter().enumerate() {
            let label = match is_in(box_px, x, y) {
                true => Label::Dynamic,
                false => Label::Static,
            };
            assert_eq!(now.label[i], label, "({x}, {y})");
            let in_use = !is_in(near, x, y);
            assert_eq!(now.in_use[i], in_use, "({x}, {y}), 4 px around the box");
        }
        let full = full_size(&cells, (160, 120));
        let same = |x, y| (full[(x, y)] == MOVING) == is_in(box_px, x, y);
        assert!(places().iter().all(|&[x, y]| same(x, y)), "full size");
    }

    /// A box that has come before the wall is dynamic as long as it moves over its last ten frames, and
    /// static once it has been at rest for as long.
    #[test]
    fn what_has_come_to_rest_is_static_again() {
        for (moved_px, share) in [(3, 0.2), (0, 0.0)] {
            let mut world = world_that_saw(&wall(), Config::default());
            let box_px = [[48, 112], [32, 96]];
            let depth = wall_behind(box_px);
            let image = |by_px: usize| {
                let texture = texture();
                let image = GrayImage::from_fn(160, 120, |x, y| match is_in(box_px, x, y) {
                    true => texture[(x + by_px, y)],
                    false => texture[(x, y)],
                });
                LkPyramid::new(&image, 3).expect("an image")
            };
            let arrived = world.frame(60, &depth);
            world.keep(arrived, &depth);
            let view = world.dynamics.past.back_mut().expect("just added");
            view.image = Some(Arc::new(image(0)));
            let mut now = world.frame(70, &depth);
            let cells = world.label(&mut now, &depth, Some(&image(moved_px)));
            let moving = moving_share(&cells.expect("labelled"));
            assert!((moving - share).abs() < 0.02, "{moved_px} px: {moving}");
        }
    }

    /// What an object uncovers as it leaves was occluded until now: there is no evidence against it.
    #[test]
    fn uncovered_background_is_static() {
        let world = world_that_saw(&wall_behind([[48, 112], [32, 96]]), Config::default());
        let mut now = world.frame(60, &wall());
        let cells = world.label(&mut now, &wall(), None).expect("labelled");
        assert!(moving_share(&cells) <= 0.0, "an empty wall");
        assert!(now.in_use.iter().all(|u| *u), "all of it in use");
    }

    #[test]
    fn no_labels_before_the_bootstrap_is_over_or_without_history() {
        let mut world = World::new(Config::default());
        let mut early = world.frame(9, &wall());
        assert!(world.label(&mut early, &wall(), None).is_none(), "frame 9");
        let mut alone = world.frame(10, &wall());
        assert!(
            world.label(&mut alone, &wall(), None).is_none(),
            "no history"
        );
        world.keep(early.clone(), &wall());
        assert!(world.label(&mut early, &wall(), None).is_none(), "frame 9");
        assert!(world.label(&mut alone, &wall(), None).is_some(), "frame 10");
    }

    #[test]
    fn a_keyframe_is_part_of_the_history_for_memory_frames() {
        let mut config = Config::default();
        config.labels.memory_frames = 90;
        let world = world_that_saw(&wall(), config);
        let depth = wall_behind([[48, 112], [32, 96]]);
        for (id, found) in [(130, true), (131, false)] {
            let mut now = world.frame(id, &depth);
            let cells = world.label(&mut now, &depth, None).expect("labelled");
            assert_eq!(moving_share(&cells) > 0.0, found, "frame {id}: 40 + 90");
        }
    }

    /// Of the ten columns of samples, nine may be suspects (`max_moving` = 0.9), not ten.
    #[test]
    fn nearly_everything_moving_is_a_wrong_pose() {
        let mut config = Config::default();
        let mut world = world_that_saw(&wall(), config.clone());
        let mut nine = wall_behind([[0, 144], [0, 120]]);
        let mut now = world.frame(60, &nine);
        let labelled = world.label(&mut now, &nine, None);
        assert!(
            moving_share(&labelled.expect("nine of ten")) > 0.85,
            "nearly all"
        );

        nine = wall_behind([[0, 160], [0, 120]]);
        now = world.frame(60, &nine);
        assert!(world.label(&mut now, &nine, None).is_none(), "ten of ten");
        assert!(now.label.iter().all(|l| *l == Label::Static), "no label");
        assert!(now.in_use.iter().all(|u| *u), "none put aside");

        // The same wall, but the pose is a metre off: everything floats in front of it.
        let step = Se3::exp(&[0.0, 0.0, 1.0, 0.0, 0.0, 0.0].into());
        let mut lost = world.frame(60, &wall());
        lost.camera_from_world = step;
        assert!(
            world.label(&mut lost, &wall(), None).is_none(),
            "a metre off"
        );
        lost.camera_from_world = Se3::identity();
        let right = world.label(&mut lost, &wall(), None).expect("right pose");
        assert!(moving_share(&right) <= 0.0, "the wall");

        config.labels.max_moving = 1.0;
        world = world_that_saw(&wall(), config);
        lost.camera_from_world = step;
        let cells = world.label(&mut lost, &wall(), None).expect("no guard");
        // The part within the old image: (2/3)² of it.
        assert!(moving_share(&cells) > 0.4, "{}", moving_share(&cells));
    }

    #[test]
    fn trust_grows_with_the_age_of_the_evidence() {
        let odds = |residual, agreed_frames| {
            let evidence = DepthEvidence {
                residual,
                agreed_frames,
            };
            log_odds(&Config::default(), &evidence)
        };
        let unknown = Real::ln(0.45f64 / 0.55);
        assert!((odds(None, 0) - unknown).abs() < 1e-12, "a coin, nearly");
        let ages = [0, 15, 30, 45].map(|age| odds(Some(0.0), age));
        assert!(ages.is_sorted_by(|a, b| a > b), "older, surer: {ages:?}");
        assert!((odds(Some(0.0), 90) - ages[3]).abs() < 1e-15, "settled");
        assert!(ages[3] < 0.0, "settled is static");
        // Up to 2 σ is as good as none; the likelihood falls with σ = 1.5 from there.
        let residuals = [2.0, 3.5, 5.0, 9.0].map(|r| odds(Some(r), 45));
        assert!((residuals[0] - ages[3]).abs() < 1e-15, "{residuals:?}");
        let p = 0.97 * Real::exp(-0.5f64);
        assert!(
            (residuals[1] - Real::ln((1.0 - p) / p)).abs() < 1e-12,
            "{residuals:?}"
        );
        assert!(residuals.is_sorted_by(|a, b| a < b), "{residuals:?}");
        assert!(residuals[1] < 0.0 && residuals[2] > 0.0, "{residuals:?}");
        assert!(odds(Some(1e9), 0).is_finite(), "clamped");
    }
}
