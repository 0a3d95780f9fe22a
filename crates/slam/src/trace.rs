//! The trace: what went into every stage of some frames, and what came out of it.
//!
//! A port that ends somewhere else asks where it left the path; the answer is the first tensor that
//! differs. So the pipeline writes down, for the frames asked for, the inputs and outputs of its
//! stages in the order in which they run. The stages themselves know nothing of it: the pipeline
//! hands them over where it calls them, one line each, and `stages` says what is written.
//!
//! Without a trace each of these lines is one comparison; nothing is copied or allocated.
//! The numbers are those of the run, untouched: the same bits for any number of threads.

mod stages;

use std::ops::RangeInclusive;
use std::sync::{Mutex, PoisonError};

use garad_core::{FrameId, Se3};

/// One tensor of one stage in one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct TraceRecord {
    /// The frame; for mapping the keyframe's, though it may have run later.
    pub frame: FrameId,
    /// The stage, see [`STAGES`].
    pub stage: &'static str,
    /// A stage may run several times in a frame (`pose`, `train`): which time, from 0.
    pub call: usize,
    /// Taken by the stage, or made by it.
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

/// On which side of a stage a tensor stands.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// Taken.
    Input,
    /// Made.
    Output,
}

/// Numbers as the pipeline has them. NaN stands for what is missing.
#[derive(Debug, Clone, PartialEq)]
pub enum Values {
    /// Pictures, masks, levels, decisions.
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

/// Every stage that writes, in the order of the data within a frame. `pose` and
/// `agreement` run after each search for matches; what follows `trajectory` is the mapper's.
pub const STAGES: [&str; 23] = [
    "input",
    "orb",
    "keypoints",
    "surface",
    "predict",
    "match_motion",
    "match_reference",
    "pose",
    "agreement",
    "label",
    "masks",
    "flow_lk",
    "flow",
    "match_local_map",
    "refine",
    "keyframe",
    "label_map",
    "bundle",
    "trajectory",
    "map_before",
    "insert",
    "train",
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

/// Where one side of the pipeline, tracking or mapping, writes.
///
/// The records are behind a lock because the tracker's methods read the system while they write here;
/// only one thread ever asks for it.
#[derive(Debug, Default)]
pub(crate) struct Tape {
    frames: Option<RangeInclusive<u32>>,
    now: Option<FrameId>,
    records: Mutex<Vec<TraceRecord>>,
}

impl Tape {
    /// Writes down these frames from now on.
    pub(crate) fn watch(&mut self, frames: RangeInclusive<u32>) {
        self.frames = Some(frames);
    }

    /// What is written down.
    pub(crate) fn frames(&self) -> Option<RangeInclusive<u32>> {
        self.frames.clone()
    }

    /// What follows belongs to this frame.
    pub(crate) fn turn_to(&mut self, frame: FrameId) {
        let watched = self.frames.as_ref().is_some_and(|f| f.contains(&frame.0));
        self.now = watched.then_some(frame);
    }

    /// Whether the frame at hand is written down.
    pub(crate) fn is_on(&self) -> bool {
        self.now.is_some()
    }

    /// One run of a stage: `write` fills the page, if anybody wants it.
    pub(crate) fn put(&self, stage: &'static str, write: impl FnOnce(&mut Page)) {
        let Some(frame) = self.now else { return };
        let mut page = Page(Vec::new());
        write(&mut page);
        let mut records = self.records.lock().unwrap_or_else(PoisonError::into_inner);
        let earlier = records
            .iter()
            .filter(|r| r.frame == frame && r.stage == stage)
            .map(|r| r.call + 1);
        let call = earlier.max().unwrap_or(0);
        records.extend(page.0.into_iter().map(|line| TraceRecord {
            frame,
            stage,
            call,
            role: line.role,
            tensor: line.tensor,
            unit: line.unit,
            shape: line.shape,
            values: line.values,
        }));
    }

    /// Everything written so far.
    pub(crate) fn take(&mut self) -> Vec<TraceRecord> {
        let records = self.records.get_mut();
        std::mem::take(records.unwrap_or_else(PoisonError::into_inner))
    }
}

/// What one run of a stage takes and makes.
#[derive(Debug)]
pub(crate) struct Page(Vec<Line>);

#[derive(Debug)]
struct Line {
    role: Role,
    tensor: String,
    unit: &'static str,
    shape: Vec<usize>,
    values: Values,
}

impl Page {
    /// Rows of the shape `row`; `[]` for one number each.
    fn line(
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
        self.0.push(Line {
            role,
            tensor: tensor.into(),
            unit,
            shape,
            values,
        });
    }

    pub(crate) fn takes(
        &mut self,
        tensor: impl Into<String>,
        unit: &'static str,
        row: &[usize],
        values: impl Into<Values>,
    ) {
        self.line(Role::Input, tensor, unit, row, values.into());
    }

    pub(crate) fn makes(
        &mut self,
        tensor: impl Into<String>,
        unit: &'static str,
        row: &[usize],
        values: impl Into<Values>,
    ) {
        self.line(Role::Output, tensor, unit, row, values.into());
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
    fn only_watched_frames_are_written_and_calls_are_counted() {
        let mut tape = Tape::default();
        tape.turn_to(FrameId(4));
        tape.put("pose", |_| panic!("nobody watches"));
        tape.watch(4..=5);
        for frame in 3..7 {
            tape.turn_to(FrameId(frame));
            assert_eq!(tape.is_on(), (4..=5).contains(&frame), "frame {frame}");
            for x in [1.0, 2.0] {
                tape.put("pose", |page| page.makes("x", "m", &[1], vec![x]));
            }
        }
        let records = tape.take();
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
        assert!(tape.take().is_empty(), "handed out once");
    }
}
