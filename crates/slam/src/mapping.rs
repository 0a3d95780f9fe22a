//! Mapping: the map of Gaussians, trained beside tracking (paper sec. III-C; decision 006).
//!
//! A keyframe at frame f starts a mapping job; the job is handed over when frame f + L begins,
//! neither sooner nor later. If it is late, tracking waits. How much a job does is a count, never a
//! time. So what tracking knows of the map at any frame follows from frame numbers alone, and the
//! mapper may run in the same thread or in its own, on any machine, under any load.
//!
//! ```text
//! frame     f         f+1       f+2    ...     f+L
//! tracking  ──────────────────────────────────▼ takes over the answer
//! mapping     └─ job of keyframe f ─┘  └─ next job ...
//! ```
//!
//! | file | what | paper |
//! |---|---|---|
//! | [`job`], [`worker`], [`mapper`] | a job, where it runs, its stages | III |
//! | [`loop_correction`], [`relabel`], [`insert`] | what changes the map before training | III-A, III-C |
//! | [`train`], [`iteration`], [`loss`], [`optimiser`], `coarse_to_fine` | one iteration | eq. 12, 13, 15, 16 |
//! | [`view`], `view_mask` | the images, and what is excluded from them | |
//! | [`densify`] | clone, split, prune | III-C |

pub(crate) mod coarse_to_fine;
pub mod densify;
pub mod error;
pub mod insert;
pub mod iteration;
pub mod job;
pub mod loop_correction;
pub mod loss;
pub mod mapper;
pub mod optimiser;
pub mod relabel;
pub mod train;
pub mod view;
pub(crate) mod view_mask;
pub mod worker;

use std::collections::VecDeque;
use std::io::{Read, Write};

use garad_core::FrameId;

use self::job::{MapFeedback, MappingDone, MappingJob};
use self::mapper::Mapper;
use self::worker::{MappingObserver, ObservedMapper, Worker};
use crate::context::Context;
use crate::io::SlamError;
use crate::observer::Silent;
use crate::session::sections::{SectionReader, SectionWriter, SessionError};

/// The mapper, its jobs under way, and what was handed over.
#[derive(Debug)]
pub struct Mapping {
    worker: Worker,
    /// The frames at which the jobs not yet handed over are due, oldest first.
    due: VecDeque<FrameId>,
    /// Answers to the oldest of these that are already known, because a session was saved.
    answers: VecDeque<MappingDone>,
    /// What was handed over.
    done: Vec<MappingDone>,
    handover_frames: u32,
    /// The mapper has a thread of its own.
    threaded: bool,
}

impl Mapping {
    /// An empty map.
    ///
    /// # Errors
    /// As [`Mapper::new`].
    pub fn new(context: &Context) -> Result<Self, SlamError> {
        let observed = ObservedMapper {
            mapper: Box::new(Mapper::new(context)?),
            observer: Box::new(Silent),
        };
        Ok(Self {
            worker: Worker::Inline(observed, VecDeque::new()),
            due: VecDeque::new(),
            answers: VecDeque::new(),
            done: Vec::new(),
            handover_frames: context.config.schedule.handover_frames,
            threaded: context.par.threads() > 1,
        })
    }

    /// Observes the mapper from now on. Takes effect while the mapper is at rest.
    pub(crate) fn observe(&mut self, observer: MappingObserver) {
        if let Some(observed) = self.worker.observed_mut() {
            observed.observer = observer;
        }
    }

    /// An empty map, with the observer of this one, which must be at rest.
    pub(crate) fn restarted(self, context: &Context) -> Result<Self, SlamError> {
        let mut fresh = Self::new(context)?;
        if let Worker::Inline(observed, _) = self.worker {
            fresh.observe(observed.observer);
        }
        Ok(fresh)
    }

    /// The mapper, while it is at rest.
    pub(crate) fn mapper(&self) -> Option<&Mapper> {
        self.worker.observed().map(|observed| &*observed.mapper)
    }

    /// The mapper, while it is at rest.
    pub(crate) fn mapper_mut(&mut self) -> Option<&mut Mapper> {
        self.worker
            .observed_mut()
            .map(|observed| &mut *observed.mapper)
    }

    /// What was handed over so far.
    pub(crate) fn done(&self) -> &[MappingDone] {
        &self.done
    }

    /// Forgets what was handed over.
    pub(crate) fn clear_done(&mut self) {
        self.done.clear();
    }

    /// Starts a job, or queues it behind those under way.
    ///
    /// # Errors
    /// [`SlamError::MappingLost`].
    pub(crate) fn submit(&mut self, job: MappingJob) -> Result<(), SlamError> {
        let due = job.frame.0.saturating_add(self.handover_frames);
        self.due.push_back(FrameId(due));
        self.worker.submit(job, self.threaded)
    }

    /// Whether a job is due at this frame.
    pub(crate) fn is_due(&self, frame: FrameId) -> bool {
        self.due.front().is_some_and(|due| *due <= frame)
    }

    /// Hands over the oldest job, waited for if need be: what the map gives back. `None` if there is none.
    ///
    /// # Errors
    /// [`SlamError::MappingLost`].
    pub(crate) fn hand_over(&mut self) -> Result<Option<MapFeedback>, SlamError> {
        if self.due.pop_front().is_none() {
            return Ok(None);
        }
        let mut done = match self.answers.pop_front() {
            Some(done) => done,
            None => self.worker.next_answer()?,
        };
        tracing::debug!(
            keyframe = done.keyframe.0,
            inserted = done.inserted,
            gaussians = done.gaussians,
            loss = done.loss,
            "mapped"
        );
        let feedback = std::mem::take(&mut done.feedback);
        self.done.push(done);
        Ok(Some(feedback))
    }

    /// Hands over every job and brings the mapper to rest in this thread. Returns what the map gives back, oldest first.
    ///
    /// # Errors
    /// [`SlamError::MappingLost`].
    pub(crate) fn finish(&mut self) -> Result<Vec<MapFeedback>, SlamError> {
        let mut feedback = Vec::new();
        while let Some(next) = self.hand_over()? {
            feedback.push(next);
        }
        self.worker.join()?;
        Ok(feedback)
    }

    /// Finishes every job and brings the mapper to rest in this thread, but hands nothing over: the
    /// answers wait for their frame.
    ///
    /// # Errors
    /// [`SlamError::MappingLost`].
    pub(crate) fn settle(&mut self) -> Result<(), SlamError> {
        while self.answers.len() < self.due.len() {
            self.answers.push_back(self.worker.next_answer()?);
        }
        self.worker.join()
    }

    /// Writes what a session must keep, after [`Mapping::settle`].
    pub(crate) fn save<W: Write>(&self, to: &mut SectionWriter<W>) -> Result<(), SessionError> {
        let Self {
            worker: _, // its mapper, below
            due,
            answers,
            done,
            handover_frames: _, // from the configuration
            threaded: _,        // changes no result
        } = self;
        to.put("due", due)?;
        to.put("answers", answers)?;
        to.put("mapped", done)?;
        self.mapper().ok_or(SlamError::MappingLost)?.save(to)
    }

    /// Reads what [`Mapping::save`] wrote.
    pub(crate) fn load<R: Read>(
        from: &mut SectionReader<R>,
        context: &Context,
    ) -> Result<Self, SessionError> {
        let mut mapping = Self {
            due: from.take("due")?,
            answers: from.take("answers")?,
            done: from.take("mapped")?,
            ..Self::new(context)?
        };
        let mapper = mapping.mapper_mut().expect("a new mapper is at rest");
        mapper.load(from)?;
        Ok(mapping)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use garad_core::{Camera, DepthImage, KeyframeId, Par, RgbImage, Se3};

    use super::*;
    use crate::config::Config;

    fn job(keyframe: u32, frame: u32) -> MappingJob {
        MappingJob {
            keyframe: KeyframeId(keyframe),
            frame: FrameId(frame),
            rgb: RgbImage::new(32, 24, [90, 120, 30]),
            depth: DepthImage::new(32, 24, 2.0),
            mask: None,
            cells: None,
            labels: Vec::new(),
            cues: Vec::new(),
            restored: BTreeSet::new(),
            moved: Vec::new(),
            poses: vec![Se3::identity(); keyframe as usize + 1],
            new_landmarks: Vec::new(),
            living: Vec::new(),
            iterations: 2,
        }
    }

    fn context(threads: usize, handover_frames: u32) -> Context {
        let camera = Camera::pinhole((32, 24), [30.0, 30.0, 15.5, 11.5]).expect("valid");
        let mut config = Config::default();
        config.schedule.handover_frames = handover_frames;
        Context::new(camera, config, 0, Par::new(threads)).expect("valid")
    }

    fn mapping(threads: usize) -> Mapping {
        Mapping::new(&context(threads, 5)).expect("valid")
    }

    /// Frame by frame: which keyframe's job is handed over when.
    fn handovers(threads: usize) -> (Vec<(u32, MappingDone)>, Mapping) {
        let mut mapping = mapping(threads);
        let mut seen = Vec::new();
        for frame in 0..12 {
            while mapping.is_due(FrameId(frame)) {
                assert!(mapping.hand_over().expect("alive").is_some(), "due");
                let done = mapping.done().last().expect("handed over");
                seen.push((frame, done.clone()));
            }
            for (keyframe, at) in [(0, 0), (1, 3), (2, 4)] {
                if at == frame {
                    mapping.submit(job(keyframe, at)).expect("alive");
                }
            }
        }
        mapping.worker.join().expect("alive");
        (seen, mapping)
    }

    #[test]
    fn jobs_are_handed_over_at_fixed_frames_wherever_they_run() {
        let (inline, map_inline) = handovers(1);
        let when: Vec<_> = inline.iter().map(|(f, d)| (*f, d.keyframe.0)).collect();
        assert_eq!(when, [(5, 0), (8, 1), (9, 2)], "five frames later each");
        let (threaded, map_threaded) = handovers(2);
        assert_eq!(
            inline, threaded,
            "the same answers from a thread of its own"
        );
        assert!(
            map_inline.mapper().expect("at rest").gaussians()
                == map_threaded.mapper().expect("at rest").gaussians(),
            "and the same map"
        );
    }

    #[test]
    fn a_job_is_due_at_its_frame_and_the_configured_number_more() {
        for (handover_frames, due) in [(0, 7), (3, 10), (u32::MAX, u32::MAX)] {
            let mut mapping = Mapping::new(&context(1, handover_frames)).expect("valid");
            assert!(!mapping.is_due(FrameId(u32::MAX)), "nothing was submitted");
            assert!(mapping.hand_over().expect("alive").is_none(), "nothing");
            mapping.submit(job(0, 7)).expect("alive");
            assert!(
                !mapping.is_due(FrameId(due - 1)),
                "{handover_frames}: too soon"
            );
            assert!(mapping.is_due(FrameId(due)), "{handover_frames}");
        }
    }

    /// Two jobs, settled as for a session, then a third: answers come in the order of the keyframes.
    #[test]
    fn answers_of_a_settled_mapper_wait_for_their_frame() {
        for threads in [1, 2] {
            let mut mapping = mapping(threads);
            mapping.submit(job(0, 0)).expect("alive");
            mapping.submit(job(1, 3)).expect("alive");
            mapping.settle().expect("alive");
            assert!(
                mapping.mapper().is_some_and(|m| !m.gaussians().is_empty()),
                "at rest"
            );
            assert!(mapping.done().is_empty(), "nothing is handed over");
            assert!(
                mapping.is_due(FrameId(5)) && !mapping.is_due(FrameId(4)),
                "as before"
            );
            mapping.settle().expect("twice is once");
            mapping.submit(job(2, 4)).expect("alive");
            assert_eq!(mapping.finish().expect("alive").len(), 3, "of each job");
            let done: Vec<_> = mapping
                .done()
                .iter()
                .map(|d| (d.keyframe.0, d.frame.0))
                .collect();
            assert_eq!(done, [(0, 0), (1, 3), (2, 4)]);
            assert!(mapping.done().iter().all(|d| d.loss.is_some()), "trained");
            mapping.clear_done();
            assert!(mapping.done().is_empty(), "forgotten");
            assert!(
                mapping.finish().expect("alive").is_empty(),
                "no job is left"
            );
        }
    }

    #[test]
    fn feedback_is_handed_over_once() {
        let mut context = context(1, 0);
        context.config.labels.source = crate::config::LabelSource::Gaussians;
        let mut mapping = Mapping::new(&context).expect("valid");
        mapping.submit(job(0, 0)).expect("alive");
        let feedback = mapping.hand_over().expect("alive").expect("a job");
        assert!(feedback.dynamic.is_some(), "{feedback:?}");
        assert_eq!(
            mapping.done()[0].feedback,
            MapFeedback::default(),
            "not kept"
        );
    }

    #[test]
    fn the_map_is_not_accessible_while_the_mapper_works() {
        let mut mapping = mapping(2);
        assert!(mapping.mapper().is_some(), "at rest before the first job");
        mapping.submit(job(0, 0)).expect("alive");
        assert!(mapping.mapper().is_none(), "at work");
        let mut answers = || mapping.hand_over().expect("alive").is_some();
        assert!(answers(), "one job");
        assert!(!answers(), "no second answer");
        mapping.worker.join().expect("alive");
        assert_eq!(
            mapping.mapper().expect("at rest").gaussians().len(),
            48,
            "8 x 6 samples"
        );
    }
}
