//! [`Frames`]: frames in order, decoded ahead.

use std::ops::Range;
use std::panic::resume_unwind;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::{Builder, JoinHandle};

use crate::dataset::{Dataset, Frame};
use crate::errors::DatasetError;

/// All frames of a recording in order; made by [`Dataset::frames`].
///
/// A frame that cannot be read is returned as its error, and the next call continues with the next
/// frame. A panic while decoding resumes on the calling thread. Dropping the iterator early ends the
/// decoding thread after its current frame.
#[derive(Debug)]
pub struct Frames {
    dataset: Dataset,
    next: usize,
    ahead: Option<Ahead>,
}

/// The decoding thread and its channel.
#[derive(Debug)]
struct Ahead {
    frames: Receiver<Result<Frame, DatasetError>>,
    thread: JoinHandle<()>,
}

impl Dataset {
    /// All frames in order, decoded up to `prefetch` frames ahead on another thread; with 0 they are
    /// decoded on demand, on the calling thread.
    #[must_use]
    pub fn frames(&self, prefetch: usize) -> Frames {
        self.frames_from(0, prefetch)
    }

    /// [`Dataset::frames`] from frame `first` on; earlier ones are not decoded.
    #[must_use]
    pub fn frames_from(&self, first: usize, prefetch: usize) -> Frames {
        Frames::new(self.clone(), first, prefetch)
    }
}

impl Frames {
    fn new(dataset: Dataset, first: usize, prefetch: usize) -> Self {
        // Without a thread (0 requested, or none available) frames are decoded on demand.
        let ahead = (prefetch > 0)
            .then(|| {
                let dataset = dataset.clone();
                Ahead::start(first..dataset.len(), prefetch, move |i| dataset.read(i))
            })
            .flatten();
        Self {
            dataset,
            next: first,
            ahead,
        }
    }
}

impl Ahead {
    /// Starts to read these frames; `None` if no thread can be started.
    fn start(
        frames: Range<usize>,
        prefetch: usize,
        read: impl Fn(usize) -> Result<Frame, DatasetError> + Send + 'static,
    ) -> Option<Self> {
        // The thread holds one more frame itself, so the channel holds one less.
        let (sender, decoded) = sync_channel(prefetch - 1);
        let thread = Builder::new()
            .name("decode".to_owned())
            .spawn(move || {
                for i in frames {
                    if sender.send(read(i)).is_err() {
                        return; // the iterator has been dropped
                    }
                }
            })
            .ok()?;
        Some(Self {
            frames: decoded,
            thread,
        })
    }

    /// The next frame; `None` when the thread has ended.
    fn next(&self) -> Option<Result<Frame, DatasetError>> {
        self.frames.recv().ok()
    }

    /// Waits for the end of the thread and resumes its panic.
    fn finish(self) {
        drop(self.frames);
        if let Err(panic) = self.thread.join() {
            resume_unwind(panic);
        }
    }
}

impl Iterator for Frames {
    type Item = Result<Frame, DatasetError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.next >= self.dataset.len() {
            return None;
        }
        let i = self.next;
        self.next += 1;
        let Some(ahead) = &self.ahead else {
            return Some(self.dataset.read(i));
        };
        let frame = ahead.next();
        if frame.is_none() {
            // The thread has ended before its last frame: it panicked.
            self.next = self.dataset.len();
            if let Some(ahead) = self.ahead.take() {
                ahead.finish();
            }
        }
        frame
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        let left = self.dataset.len().saturating_sub(self.next);
        (left, Some(left))
    }
}

impl ExactSizeIterator for Frames {}

impl Drop for Frames {
    fn drop(&mut self) {
        if let Some(Ahead { frames, thread }) = self.ahead.take() {
            drop(frames); // the thread's next send fails
            // A panic in a frame that is not needed is ignored.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use std::panic::{AssertUnwindSafe, catch_unwind};

    use super::*;

    #[test]
    fn panics_resume_on_the_calling_thread() {
        let ahead = Ahead::start(0..5, 2, |i| {
            assert!(i < 1, "frame {i} panics");
            Err(DatasetError::Option {
                option: "frame",
                value: i.to_string(),
                expected: "nothing",
            })
        })
        .expect("a thread");
        assert!(matches!(ahead.next(), Some(Err(_))), "frame 0");
        assert!(ahead.next().is_none(), "frame 1");
        let panic = catch_unwind(AssertUnwindSafe(|| ahead.finish())).expect_err("passed on");
        let message = panic.downcast_ref::<String>().expect("a message");
        assert!(message.contains("frame 1 panics"), "{message}");
    }
}
