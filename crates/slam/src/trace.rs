//! The trace: the inputs and outputs of every stage in some frames.
//!
//! A port whose result differs needs the first tensor that does. For the frames asked for, the
//! pipeline records what goes into its stages and what comes out, in the order in which they run.
//! Each stage is given a [`Recorder`] and hands it its tensors; `stages` lists them.
//!
//! Without a trace each call is one comparison; nothing is copied or allocated. The numbers are
//! those of the run, untouched: the same bits for any number of threads.

mod stages;

use std::ops::RangeInclusive;

use garad_core::{FrameId, Se3};

/// One tensor of one stage in one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct TraceRecord {
    /// The frame; for mapping the keyframe's, though it may have run later.
    pub frame: FrameId,
    /// The stage, see [`STAGES`].
    pub stage: &'static str,
    /// Number of the call within the frame, from 0 (`pose` and `train` run several times).
    pub call: usize,
    /// Input or output of the stage.
    pub role: Role,
    /// Name within the stage.
    pub tensor: String,
    /// Unit, `1` for none.
    pub unit: &'static str,
    /// Sizes, slowest first.
    pub shape: Vec<usize>,
    /// The numbers, last index fastest.
    pub values: Values,
}

/// Side of a stage on which a tensor stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Read by the stage.
    Input,
    /// Computed by it.
    Output,
}

/// Numbers as the pipeline has them. NaN stands for what is missing.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// Images, masks, levels, decisions.
    U8(Vec<u8>),
    /// Ids, counts, indices; [`NONE`] for no id.
    U32(Vec<u32>),
    /// What is computed in f32.
    F32(Vec<f32>),
    /// What is computed in f64.
    F64(Vec<f64>),
}

/// No landmark, no keyframe.
pub const NONE: u32 = u32::MAX;

/// Every recorded stage, in the order of the data within a frame. `pose` and `depth_pose` run after
/// each search for matches; the stages after `trajectory` are the mapper's.
pub const STAGES: [&str; 30] = [
    "input",
    "orb",
    "keypoints",
    "depth_planes",
    "predict",
    "match_motion",
    "match_reference",
    "relocalise",
    "pose",
    "depth_pose",
    "label",
    "gaussian_mask",
    "flow_lk",
    "flow",
    "restore",
    "masks",
    "match_local_map",
    "subpixel",
    "keyframe",
    "label_map",
    "bundle",
    "loop",
    "cull",
    "trajectory",
    "map_before",
    "label_gaussians",
    "insert",
    "train",
    "densify",
    "map_after",
];

macro_rules! from_numbers {
    ($($number:ty => $variant:ident),*) => {$(
        impl From<Vec<$number>> for Values {
            fn from(values: Vec<$number>) -> Self {
                Self::$variant(values)
            }
        }
    )*};
}
from_numbers!(u8 => U8, u32 => U32, f32 => F32, f64 => F64);

impl Values {
    /// How many.
    #[must_use]
    pub fn len(&self) -> usize {
        match self {
            Self::U8(v) => v.len(),
            Self::U32(v) => v.len(),
            Self::F32(v) => v.len(),
            Self::F64(v) => v.len(),
        }
    }

    /// None at all.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

/// Records the stages of one thread, tracking or mapping, in the frames asked for.
#[derive(Debug, Default)]
pub struct Recorder {
    frames: Option<RangeInclusive<u32>>,
    /// The frame at hand, if it is recorded.
    now: Option<FrameId>,
    records: Vec<TraceRecord>,
}

impl Recorder {
    /// Records these frames from now on.
    pub(crate) fn set_frames(&mut self, frames: Option<RangeInclusive<u32>>) {
        self.frames = frames;
    }

    /// The frames that are recorded.
    pub(crate) fn frames(&self) -> Option<RangeInclusive<u32>> {
        self.frames.clone()
    }

    /// The following stages belong to this frame.
    pub(crate) fn begin_frame(&mut self, frame: FrameId) {
        let recorded = self.frames.as_ref().is_some_and(|f| f.contains(&frame.0));
        self.now = recorded.then_some(frame);
    }

    /// Whether the frame at hand is recorded.
    pub(crate) fn is_recording(&self) -> bool {
        self.now.is_some()
    }

    /// One call of a stage: `write` fills the record, if the frame is recorded.
    pub(crate) fn record(&mut self, stage: &'static str, write: impl FnOnce(&mut StageRecord)) {
        let Some(frame) = self.now else { return };
        let mut record = StageRecord(Vec::new());
        write(&mut record);
        let same = |r: &&TraceRecord| r.frame == frame && r.stage == stage;
        let earlier = self.records.iter().filter(same).map(|r| r.call + 1);
        let call = earlier.max().unwrap_or(0);
        let tensors = record.0.into_iter().map(|tensor| TraceRecord {
            frame,
            stage,
            call,
            ..tensor
        });
        self.records.extend(tensors);
    }

    /// Everything recorded so far.
    pub(crate) fn take(&mut self) -> Vec<TraceRecord> {
        std::mem::take(&mut self.records)
    }
}

/// The tensors of one call of a stage.
#[derive(Debug)]
pub(crate) struct StageRecord(Vec<TraceRecord>);

impl StageRecord {
    /// Rows of the shape `row`; `[]` for one number each.
    fn tensor(
        &mut self,
        role: Role,
        tensor: impl Into<String>,
        unit: &'static str,
        row: &[usize],
        values: Values,
    ) {
        let per_row = row.iter().product::<usize>().max(1);
        let mut shape = vec![values.len() / per_row];
        shape.extend_from_slice(row);
        self.0.push(TraceRecord {
            frame: FrameId(0), // frame, stage and call are those of the whole record
            stage: "",
            call: 0,
            role,
            tensor: tensor.into(),
            unit,
            shape,
            values,
        });
    }

    pub(crate) fn input(
        &mut self,
        tensor: impl Into<String>,
        unit: &'static str,
        row: &[usize],
        values: impl Into<Values>,
    ) {
        self.tensor(Role::Input, tensor, unit, row, values.into());
    }

    pub(crate) fn output(
        &mut self,
        tensor: impl Into<String>,
        unit: &'static str,
        row: &[usize],
        values: impl Into<Values>,
    ) {
        self.tensor(Role::Output, tensor, unit, row, values.into());
    }
}

/// \[R | t\], row by row.
pub(crate) fn matrix(pose: &Se3) -> Vec<f64> {
    let (r, t) = (pose.rotation.matrix(), pose.translation);
    (0..3)
        .flat_map(|i| [r[(i, 0)], r[(i, 1)], r[(i, 2)], t[i]])
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_given_frames_are_recorded_and_calls_are_counted() {
        let mut recorder = Recorder::default();
        recorder.begin_frame(FrameId(4));
        recorder.record("pose", |_| panic!("no frame is recorded"));
        recorder.set_frames(Some(4..=5));
        for frame in 3..7 {
            recorder.begin_frame(FrameId(frame));
            let expected = (4..=5).contains(&frame);
            assert_eq!(recorder.is_recording(), expected, "frame {frame}");
            for x in [1.0, 2.0] {
                recorder.record("pose", |record| record.output("x", "m", &[1], vec![x]));
            }
        }
        let records = recorder.take();
        let of = |r: &TraceRecord| (r.frame.0, r.call, r.shape.clone(), r.values.clone());
        let expected = |frame, call, x| (frame, call, vec![1, 1], Values::F64(vec![x]));
        assert_eq!(
            records.iter().map(of).collect::<Vec<_>>(),
            [
                expected(4, 0, 1.0),
                expected(4, 1, 2.0),
                expected(5, 0, 1.0),
                expected(5, 1, 2.0)
            ],
            "two calls in each of two frames"
        );
        assert!(recorder.take().is_empty(), "handed out once");
    }
}
