//! Two threads, one answer (decision 006).
//!
//! A keyframe at frame f starts a mapping job; the job is handed over when frame f + L begins,
//! neither sooner nor later. If it is late, tracking waits. How much a job does is a count, never a
//! time. So what tracking knows of the map at any frame follows from frame numbers alone, and the
//! mapper may work in the same thread or in one beside, on any machine, under any load.
//!
//! ```text
//! frame     f         f+1       f+2    ...     f+L
//! tracking  ──────────────────────────────────▼ takes over what the job found
//! mapping     └─ job of keyframe f ─┘  └─ next job ...
//! ```

use std::collections::VecDeque;
use std::fmt;
use std::io::{Read, Write};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{Builder, JoinHandle};

use garad_core::FrameId;

use crate::mapper::{Mapper, MappingDone, MappingJob};
use crate::observer::Observer;
use crate::session::{SectionReader, SectionWriter, SessionError};
use crate::system::SlamError;

/// Who listens to the mapper; it may do so from another thread.
pub type MappingObserver = Box<dyn Observer + Send>;

/// Jobs on their way to the mapper and back.
#[derive(Debug)]
pub(crate) struct Schedule {
    worker: Worker,
    /// When the jobs not yet handed over are due, oldest first.
    due: VecDeque<FrameId>,
    /// Answers to the oldest of these that are here already, because a session was saved.
    answers: VecDeque<MappingDone>,
    handover_frames: u32,
    /// More than one thread: the mapper gets its own.
    beside: bool,
}

/// The mapper and its listener: they go to the thread together and come back together.
struct Crew {
    mapper: Box<Mapper>,
    observer: MappingObserver,
}

#[derive(Debug)]
enum Worker {
    /// In this thread; jobs run when they are due.
    Here(Crew, VecDeque<MappingJob>),
    /// In a thread of its own.
    Beside {
        jobs: Sender<MappingJob>,
        done: Receiver<MappingDone>,
        thread: JoinHandle<Option<Crew>>,
    },
    /// The thread broke down, and the map with it.
    Lost,
}

impl Schedule {
    pub(crate) fn new(mapper: Mapper, handover_frames: u32, beside: bool) -> Self {
        let crew = Crew {
            mapper: Box::new(mapper),
            observer: Box::new(crate::observer::Silent),
        };
        Self {
            worker: Worker::Here(crew, VecDeque::new()),
            due: VecDeque::new(),
            answers: VecDeque::new(),
            handover_frames,
            beside,
        }
    }

    /// Listens to the mapper from now on. Takes effect while the mapper is at rest.
    pub(crate) fn observe(&mut self, observer: MappingObserver) {
        if let Worker::Here(crew, _) = &mut self.worker {
            crew.observer = observer;
        }
    }

    /// Takes over who listens to another schedule, which is at an end.
    pub(crate) fn listen_as(&mut self, other: Self) {
        if let Worker::Here(crew, _) = other.worker {
            self.observe(crew.observer);
        }
    }

    /// The mapper, while it is at rest.
    pub(crate) fn mapper(&self) -> Option<&Mapper> {
        match &self.worker {
            Worker::Here(crew, _) => Some(&crew.mapper),
            Worker::Beside { .. } | Worker::Lost => None,
        }
    }

    /// The mapper, while it is at rest.
    pub(crate) fn mapper_mut(&mut self) -> Option<&mut Mapper> {
        match &mut self.worker {
            Worker::Here(crew, _) => Some(&mut crew.mapper),
            Worker::Beside { .. } | Worker::Lost => None,
        }
    }

    /// Starts a job, or puts it behind those under way.
    ///
    /// # Errors
    /// [`SlamError::MappingLost`].
    pub(crate) fn submit(&mut self, job: MappingJob) -> Result<(), SlamError> {
        self.due
            .push_back(FrameId(job.frame.0.saturating_add(self.handover_frames)));
        if self.beside && matches!(self.worker, Worker::Here(..)) {
            self.worker = match std::mem::replace(&mut self.worker, Worker::Lost) {
                Worker::Here(crew, waiting) => start(crew, waiting),
                other => other,
            };
        }
        match &mut self.worker {
            Worker::Here(_, waiting) => {
                waiting.push_back(job);
                Ok(())
            }
            Worker::Beside { jobs, .. } => jobs.send(job).map_err(|_| SlamError::MappingLost),
            Worker::Lost => Err(SlamError::MappingLost),
        }
    }

    /// Whether a job is due at this frame.
    pub(crate) fn is_due(&self, frame: FrameId) -> bool {
        self.due.front().is_some_and(|due| *due <= frame)
    }

    /// The oldest job's answer, waited for if need be.
    ///
    /// # Errors
    /// [`SlamError::MappingLost`].
    pub(crate) fn take(&mut self) -> Result<Option<MappingDone>, SlamError> {
        if self.due.pop_front().is_none() {
            return Ok(None);
        }
        match self.answers.pop_front() {
            Some(done) => Ok(Some(done)),
            None => self.next_answer(),
        }
    }

    /// The oldest job not yet answered, run or waited for.
    fn next_answer(&mut self) -> Result<Option<MappingDone>, SlamError> {
        match &mut self.worker {
            Worker::Here(crew, waiting) => {
                let job = waiting.pop_front();
                Ok(job.map(|job| crew.mapper.run(job, &mut *crew.observer)))
            }
            Worker::Beside { done, .. } => {
                done.recv().map(Some).map_err(|_| SlamError::MappingLost)
            }
            Worker::Lost => Err(SlamError::MappingLost),
        }
    }

    /// Every job is done and the mapper is at rest in this thread, but nothing is handed over: the
    /// answers wait for their frame.
    ///
    /// # Errors
    /// [`SlamError::MappingLost`].
    pub(crate) fn settle(&mut self) -> Result<(), SlamError> {
        while self.answers.len() < self.due.len() {
            let answer = self.next_answer()?.ok_or(SlamError::MappingLost)?;
            self.answers.push_back(answer);
        }
        self.come_home()
    }

    /// Writes a schedule that has been settled.
    pub(crate) fn save<W: Write>(&self, to: &mut SectionWriter<W>) -> Result<(), SessionError> {
        let Self {
            worker: _, // its mapper, below
            due,
            answers,
            handover_frames: _, // from the configuration
            beside: _,          // changes no result
        } = self;
        to.put("due", due)?;
        to.put("answers", answers)?;
        self.mapper().ok_or(SlamError::MappingLost)?.save(to)
    }

    /// Into a schedule whose mapper is at rest.
    pub(crate) fn load<R: Read>(
        &mut self,
        from: &mut SectionReader<R>,
    ) -> Result<(), SessionError> {
        self.due = from.take("due")?;
        self.answers = from.take("answers")?;
        self.mapper_mut().ok_or(SlamError::MappingLost)?.load(from)
    }

    /// The mapper comes to rest in this thread. Every job must have been answered.
    ///
    /// # Errors
    /// [`SlamError::MappingLost`].
    pub(crate) fn come_home(&mut self) -> Result<(), SlamError> {
        self.worker = match std::mem::replace(&mut self.worker, Worker::Lost) {
            Worker::Beside { jobs, thread, .. } => {
                drop(jobs); // the thread ends when nobody can send any more
                match thread.join() {
                    Ok(Some(crew)) => Worker::Here(crew, VecDeque::new()),
                    Ok(None) | Err(_) => return Err(SlamError::MappingLost),
                }
            }
            here => here,
        };
        Ok(())
    }
}

/// Moves the mapper into a thread of its own. If the system gives none, it stays: the answer is the
/// same, only later.
fn start(crew: Crew, waiting: VecDeque<MappingJob>) -> Worker {
    let (jobs, inbox) = channel::<MappingJob>();
    let (outbox, done) = channel();
    let (hand_over, crews) = channel::<Crew>();
    let spawned = Builder::new().name("mapping".to_owned()).spawn(move || {
        let Ok(mut crew) = crews.recv() else {
            return None; // nobody came
        };
        for job in inbox {
            if outbox
                .send(crew.mapper.run(job, &mut *crew.observer))
                .is_err()
            {
                break;
            }
        }
        Some(crew)
    });
    match spawned {
        Err(_) => Worker::Here(crew, waiting),
        Ok(thread) => {
            let mut lost = hand_over.send(crew).is_err();
            for job in waiting {
                lost |= jobs.send(job).is_err();
            }
            if lost {
                return Worker::Lost;
            }
            Worker::Beside { jobs, done, thread }
        }
    }
}

impl fmt::Debug for Crew {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Crew")
            .field("mapper", &self.mapper)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod tests {
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
            moved: Vec::new(),
            poses: vec![Se3::identity(); keyframe as usize + 1],
            new_landmarks: Vec::new(),
            living: Vec::new(),
            iterations: 2,
        }
    }

    fn schedule(beside: bool) -> Schedule {
        let camera = Camera::pinhole((32, 24), [30.0, 30.0, 15.5, 11.5]).expect("valid");
        let mapper = Mapper::new(&camera, &Config::default(), 0, Par::Seq).expect("valid");
        Schedule::new(mapper, 5, beside)
    }

    /// Frame by frame: which keyframe's job is handed over when.
    fn handovers(beside: bool) -> (Vec<(u32, MappingDone)>, Schedule) {
        let mut schedule = schedule(beside);
        let mut seen = Vec::new();
        for frame in 0..12 {
            while schedule.is_due(FrameId(frame)) {
                let done = schedule.take().expect("alive").expect("due");
                seen.push((frame, done));
            }
            for (keyframe, at) in [(0, 0), (1, 3), (2, 4)] {
                if at == frame {
                    schedule.submit(job(keyframe, at)).expect("alive");
                }
            }
        }
        schedule.come_home().expect("alive");
        (seen, schedule)
    }

    #[test]
    fn jobs_are_handed_over_at_fixed_frames_wherever_they_run() {
        let (here, map_here) = handovers(false);
        let when: Vec<_> = here.iter().map(|(f, d)| (*f, d.keyframe.0)).collect();
        assert_eq!(when, [(5, 0), (8, 1), (9, 2)], "five frames later each");
        let (beside, map_beside) = handovers(true);
        assert_eq!(here, beside, "the same answers from a thread of its own");
        assert!(
            map_here.mapper().expect("home").gaussians()
                == map_beside.mapper().expect("home").gaussians(),
            "and the same map"
        );
    }

    #[test]
    fn a_mapper_at_work_is_not_to_be_looked_at() {
        let mut schedule = schedule(true);
        assert!(schedule.mapper().is_some(), "at rest before the first job");
        schedule.submit(job(0, 0)).expect("alive");
        assert!(schedule.mapper().is_none(), "at work");
        schedule.take().expect("alive").expect("one job");
        assert!(
            schedule.take().expect("alive").is_none(),
            "no second answer"
        );
        schedule.come_home().expect("alive");
        assert_eq!(
            schedule.mapper().expect("home").gaussians().len(),
            48,
            "8 x 6 samples"
        );
    }
}
