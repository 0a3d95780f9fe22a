//! [`LabelLog`]: the labels of every frame, and how they compare with the true masks.

use std::io::{Read, Write};

use garad_core::{FrameId, Label, MaskImage};
use garad_eval::{Confusion, RunLabels};
use garad_slam::LabelledFrame;
use garad_slam::session::{SectionReader, SectionWriter};
use garad_slam::{FrameReport, ReplayedFrame, SessionError, Slam};

use crate::packed_labels::PackedLabels;
use crate::source::SourceFrame;

/// Labels of a run, frame by frame.
#[derive(Debug, Default)]
pub struct LabelLog {
    /// Counts against the true mask, for each frame that has one.
    pub judged: RunLabels,
    /// Labels of every frame that was labelled.
    pub found: Vec<PackedLabels>,
    /// True masks of the first frames, kept for as long as the run may restart.
    early_truth: Vec<(FrameId, MaskImage)>,
}

impl LabelLog {
    /// Adds the frame that `slam` has just processed. A frame without labels (one of the first, or one
    /// without a pose) is judged as one in which nothing moves.
    pub(super) fn add(&mut self, slam: &Slam, frame: &SourceFrame, report: &FrameReport) {
        let labels = slam.labelled_frame();
        if let Some(truth) = &frame.truth {
            if slam.config().labels.enabled && frame.mask.is_none() {
                self.judged.frames.push(match labels {
                    Some(labels) => judge(labels, report.t_s, truth),
                    None => judge_unlabelled(slam, report, truth),
                });
            }
            if slam.may_restart() {
                self.early_truth.push((report.id, truth.clone()));
            }
        }
        self.found.extend(labels.map(PackedLabels::new));
    }

    /// Replaces the labels of the first frames by those of their second pass.
    pub(super) fn replace(&mut self, replayed: &[ReplayedFrame]) {
        for ReplayedFrame { report, labels } in replayed {
            let Some(labels) = labels else { continue };
            let at = self.found.partition_point(|f| f.frame < labels.frame);
            match self.found.get_mut(at) {
                Some(old) if old.frame == labels.frame => *old = PackedLabels::new(labels),
                _ => self.found.insert(at, PackedLabels::new(labels)),
            }
            let truth = self.early_truth.iter().find(|(id, _)| *id == report.id);
            let Some((_, truth)) = truth else { continue };
            let judged = self.judged.frames.iter_mut();
            for old in judged.filter(|j| j.t_s.total_cmp(&report.t_s).is_eq()) {
                *old = judge(labels, report.t_s, truth);
            }
        }
        if !replayed.is_empty() {
            self.early_truth.clear();
        }
    }

    pub(super) fn save<W: Write>(&self, to: &mut SectionWriter<W>) -> Result<(), SessionError> {
        let Self {
            judged,
            found,
            early_truth,
        } = self;
        to.put("judged", judged)?;
        to.put("early_truth", early_truth)?;
        to.put("found", found)
    }

    pub(super) fn load<R: Read>(from: &mut SectionReader<R>) -> Result<Self, SessionError> {
        let judged = from.take("judged")?;
        let early_truth = from.take("early_truth")?;
        Ok(Self {
            judged,
            early_truth,
            found: from.take("found")?,
        })
    }
}

fn judge(labels: &LabelledFrame, t_s: f64, truth: &MaskImage) -> garad_eval::FrameLabels {
    let dynamic = |(px, label): &([f64; 2], Label)| (*px, *label == Label::Dynamic);
    let keypoints = labels.keypoints.iter().map(dynamic);
    garad_eval::FrameLabels {
        t_s,
        keypoints: Some(Confusion::of_keypoints(keypoints, truth)),
        pixels: Some(compare(&labels.mask(truth.size()), truth)),
    }
}

/// All keypoints of the frame, if it has any, and all pixels as static.
fn judge_unlabelled(
    slam: &Slam,
    report: &FrameReport,
    truth: &MaskImage,
) -> garad_eval::FrameLabels {
    let last = slam.last_frame().filter(|last| last.id == report.id);
    let px = last.map_or(&[][..], |last| &last.px);
    let keypoints = px.iter().map(|p| ([p.x, p.y], false));
    let (width, height) = truth.size();
    let nothing = MaskImage::new(width, height, 0);
    garad_eval::FrameLabels {
        t_s: report.t_s,
        keypoints: Some(Confusion::of_keypoints(keypoints, truth)),
        pixels: Some(compare(&nothing, truth)),
    }
}

fn compare(mask: &MaskImage, truth: &MaskImage) -> Confusion {
    Confusion::of_masks(mask, truth).expect("a mask made in the size of the true one")
}
