//! [`Frames`]: frames in order, decoded ahead.

use std::panic::resume_unwind;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::{Builder, JoinHandle};

use crate::dataset::{Dataset, Frame};
use crate::errors::DatasetError;

/// All frames of a recording in order; made by [`Dataset::frames`].
///
/// A frame that cannot be read comes out as its error, and the next call goes on with the next
/// frame. A panic while decoding continues on the thread that asks. Dropping the iterator early
/// ends the decoding thread, after the frame it is at.
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

impl Frames {
    pub(crate) fn new(dataset: Dataset, prefetch: usize) -> Self {
        // Without a thread (none asked for, or none to be had) frames are decoded when asked for.
        let ahead = (prefetch > 0).then(|| start(&dataset, prefetch)).flatten();
        Self {
            dataset,
            next: 0,
            ahead,
        }
    }
}

fn start(dataset: &Dataset, prefetch: usize) -> Option<Ahead> {
    let dataset = dataset.clone();
    // One more frame waits in the hand of the thread, so the channel holds one less.
    let (sender, frames) = sync_channel(prefetch - 1);
    let thread = Builder::new()
        .name("decode".to_owned())
        .spawn(move || {
            for i in 0..dataset.len() {
                if sender.send(dataset.read(i)).is_err() {
                    return; // nobody listens any more
                }
            }
        })
        .ok()?;
    Some(Ahead { frames, thread })
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
        if let Ok(frame) = ahead.frames.recv() {
            return Some(frame);
        }
        // The thread is gone before its last frame: it panicked.
        self.next = self.dataset.len();
        if let Some(Err(panic)) = self.ahead.take().map(|ahead| ahead.thread.join()) {
            resume_unwind(panic);
        }
        None
    }

    fn size_hint(&self) -> (usize, Option<usize>) {
        let left = self.dataset.len() - self.next;
        (left, Some(left))
    }
}

impl ExactSizeIterator for Frames {}

impl Drop for Frames {
    fn drop(&mut self) {
        if let Some(Ahead { frames, thread }) = self.ahead.take() {
            drop(frames); // the thread's next send fails
            // A panic in a frame nobody waits for is not passed on.
            let _ = thread.join();
        }
    }
}
