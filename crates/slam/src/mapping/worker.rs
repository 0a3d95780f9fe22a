//! `Worker`: the mapper in this thread or in one of its own.

use std::collections::VecDeque;
use std::fmt;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{Builder, JoinHandle};

use super::job::{MappingDone, MappingJob};
use super::mapper::Mapper;
use crate::io::SlamError;
use crate::observer::Observer;

/// An observer of the mapper's stages, called from whatever thread the mapper runs in.
pub type MappingObserver = Box<dyn Observer + Send>;

/// The mapper and its observer: they move between threads together.
pub(crate) struct ObservedMapper {
    pub(crate) mapper: Box<Mapper>,
    pub(crate) observer: MappingObserver,
}

impl ObservedMapper {
    fn run(&mut self, job: MappingJob) -> MappingDone {
        self.mapper.run(job, &mut *self.observer)
    }
}

/// Where mapping jobs run. Jobs are answered in order.
#[derive(Debug)]
pub(crate) enum Worker {
    /// In this thread; a job runs when its answer is taken.
    Inline(ObservedMapper, VecDeque<MappingJob>),
    /// In a thread of its own.
    Threaded {
        jobs: Sender<MappingJob>,
        done: Receiver<MappingDone>,
        thread: JoinHandle<Option<ObservedMapper>>,
    },
    /// The thread panicked, and the map is lost with it.
    Lost,
}

impl Worker {
    /// The mapper and its observer, while they are in this thread.
    pub(crate) fn observed(&self) -> Option<&ObservedMapper> {
        match self {
            Self::Inline(observed, _) => Some(observed),
            Self::Threaded { .. } | Self::Lost => None,
        }
    }

    /// The mapper and its observer, while they are in this thread.
    pub(crate) fn observed_mut(&mut self) -> Option<&mut ObservedMapper> {
        match self {
            Self::Inline(observed, _) => Some(observed),
            Self::Threaded { .. } | Self::Lost => None,
        }
    }

    /// Queues a job; `threaded` moves the mapper into a thread of its own before.
    ///
    /// # Errors
    /// [`SlamError::MappingLost`].
    pub(crate) fn submit(&mut self, job: MappingJob, threaded: bool) -> Result<(), SlamError> {
        if threaded && matches!(self, Self::Inline(..)) {
            *self = match std::mem::replace(self, Self::Lost) {
                Self::Inline(observed, waiting) => start(observed, waiting),
                other => other,
            };
        }
        match self {
            Self::Inline(_, waiting) => {
                waiting.push_back(job);
                Ok(())
            }
            Self::Threaded { jobs, .. } => jobs.send(job).map_err(|_| SlamError::MappingLost),
            Self::Lost => Err(SlamError::MappingLost),
        }
    }

    /// The answer to the oldest job not yet answered, run or waited for; there must be one.
    ///
    /// # Errors
    /// [`SlamError::MappingLost`].
    pub(crate) fn next_answer(&mut self) -> Result<MappingDone, SlamError> {
        match self {
            Self::Inline(observed, waiting) => {
                let job = waiting.pop_front().expect("a job was submitted");
                Ok(observed.run(job))
            }
            Self::Threaded { done, .. } => done.recv().map_err(|_| SlamError::MappingLost),
            Self::Lost => Err(SlamError::MappingLost),
        }
    }

    /// Moves the mapper back into this thread. Every job must have been answered.
    ///
    /// # Errors
    /// [`SlamError::MappingLost`].
    pub(crate) fn join(&mut self) -> Result<(), SlamError> {
        *self = match std::mem::replace(self, Self::Lost) {
            Self::Threaded { jobs, thread, .. } => {
                drop(jobs); // the thread ends when no sender is left
                match thread.join() {
                    Ok(Some(observed)) => Self::Inline(observed, VecDeque::new()),
                    Ok(None) | Err(_) => return Err(SlamError::MappingLost),
                }
            }
            other => other,
        };
        Ok(())
    }
}

/// Moves the mapper into a thread of its own. If the system grants none, it stays: the answer is the
/// same, only later.
fn start(observed: ObservedMapper, waiting: VecDeque<MappingJob>) -> Worker {
    let (jobs, inbox) = channel::<MappingJob>();
    let (outbox, done) = channel();
    let (hand_over, mappers) = channel::<ObservedMapper>();
    let spawned = Builder::new().name("mapping".to_owned()).spawn(move || {
        let mut observed = mappers.recv().ok()?; // none if the sender was dropped
        for job in inbox {
            if outbox.send(observed.run(job)).is_err() {
                break;
            }
        }
        Some(observed)
    });
    match spawned {
        Err(_) => Worker::Inline(observed, waiting),
        Ok(thread) => {
            let mut lost = hand_over.send(observed).is_err();
            for job in waiting {
                lost |= jobs.send(job).is_err();
            }
            if lost {
                return Worker::Lost;
            }
            Worker::Threaded { jobs, done, thread }
        }
    }
}

impl fmt::Debug for ObservedMapper {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ObservedMapper")
            .field("mapper", &self.mapper)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
    use std::thread;

    use garad_core::{DepthImage, FrameId, KeyframeId, RgbImage};

    use super::*;

    fn job() -> MappingJob {
        MappingJob {
            keyframe: KeyframeId(0),
            frame: FrameId(0),
            rgb: RgbImage::new(2, 2, [0; 3]),
            depth: DepthImage::new(2, 2, 1.0),
            mask: None,
            cells: None,
            labels: Vec::new(),
            cues: Vec::new(),
            restored: std::collections::BTreeSet::new(),
            moved: Vec::new(),
            poses: Vec::new(),
            new_landmarks: Vec::new(),
            living: Vec::new(),
            iterations: 0,
        }
    }

    /// A worker whose thread has ended without its mapper, as one that panicked.
    fn ended() -> Worker {
        let (jobs, inbox) = channel::<MappingJob>();
        let (outbox, done) = channel();
        let thread = thread::spawn(move || {
            drop((inbox, outbox));
            None
        });
        let worker = Worker::Threaded { jobs, done, thread };
        while let Worker::Threaded { thread, .. } = &worker
            && !thread.is_finished()
        {
            thread::yield_now();
        }
        worker
    }

    /// Each call returns the error instead of waiting, before and after the loss is known.
    #[test]
    fn a_worker_that_lost_its_thread_says_so() {
        let is_lost =
            |outcome: Result<(), SlamError>| matches!(outcome, Err(SlamError::MappingLost));
        type Call = fn(&mut Worker) -> Result<(), SlamError>;
        let calls: [(&str, Call); 4] = [
            ("submit", |worker| worker.submit(job(), false)),
            ("submit to a thread", |worker| worker.submit(job(), true)),
            ("next_answer", |worker| worker.next_answer().map(drop)),
            ("join", Worker::join),
        ];
        for (what, call) in calls {
            let mut worker = ended();
            assert!(is_lost(call(&mut worker)), "{what}");
            assert!(
                worker.observed().is_none() && worker.observed_mut().is_none(),
                "{what}"
            );
            let expected = what == "join";
            assert_eq!(matches!(worker, Worker::Lost), expected, "{what}");
        }
        for (what, call) in &calls[..3] {
            assert!(is_lost(call(&mut Worker::Lost)), "{what} after the loss");
        }
        let mut worker = ended();
        assert!(is_lost(worker.join()), "ended");
        assert!(worker.join().is_ok(), "nothing left to wait for");
        assert!(is_lost(worker.next_answer().map(drop)), "after join");
    }
}
