//! Progress of long work: a bar on a terminal, plain lines elsewhere, nothing when quiet.

use std::io::{IsTerminal, Write as _};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressStyle};

/// How often plain lines appear.
const LINE_EVERY: Duration = Duration::from_secs(5);

/// One line on stderr.
///
/// Control characters, which file names may contain, are escaped. A closed stream (`2>&1 | head`) is
/// ignored.
pub fn note(line: &str) {
    let mut shown = String::with_capacity(line.len() + 1);
    for c in line.chars() {
        if c.is_control() {
            shown.extend(c.escape_default());
        } else {
            shown.push(c);
        }
    }
    shown.push('\n');
    let _ = std::io::stderr().write_all(shown.as_bytes());
}

/// Counts steps of one job on stderr.
#[derive(Debug)]
pub struct Progress {
    what: &'static str,
    total: usize,
    done: usize,
    begun: Instant,
    last_line: Instant,
    how: How,
}

#[derive(Debug)]
enum How {
    Quiet,
    Lines,
    Bar(ProgressBar),
}

impl Progress {
    /// A job of `total` steps.
    #[must_use]
    pub fn new(what: &'static str, total: usize, quiet: bool) -> Self {
        let how = if quiet {
            How::Quiet
        } else if std::io::stderr().is_terminal() {
            let bar = ProgressBar::new(total as u64);
            let template = "{prefix:>12} [{bar:32}] {pos}/{len} {per_sec} {msg}";
            if let Ok(style) = ProgressStyle::with_template(template) {
                bar.set_style(style.progress_chars("=> "));
            }
            bar.set_prefix(what);
            How::Bar(bar)
        } else {
            How::Lines
        };
        let now = Instant::now();
        Self {
            what,
            total,
            done: 0,
            begun: now,
            last_line: now,
            how,
        }
    }

    /// One step more; `note` describes the state of the job.
    pub fn step(&mut self, note: &str) {
        self.done += 1;
        match &self.how {
            How::Quiet => {}
            How::Bar(bar) => {
                bar.set_message(note.to_owned());
                bar.inc(1);
            }
            How::Lines => {
                let now = Instant::now();
                let due = now.duration_since(self.last_line) >= LINE_EVERY;
                if due || self.done == self.total {
                    self.last_line = now;
                    let rate = self.done as f64 / now.duration_since(self.begun).as_secs_f64();
                    self::note(&format!(
                        "{}: {}/{} ({rate:.1}/s) {note}",
                        self.what, self.done, self.total
                    ));
                }
            }
        }
    }

    /// Ends the job.
    pub fn finish(&self) {
        if let How::Bar(bar) = &self.how {
            bar.finish();
        }
    }
}
