//! [`Stopwatch`]: how long each stage took; memory and processor time of the process.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use garad_eval::StageTiming;
use garad_slam::{Observer, Stage};
use serde::{Deserialize, Serialize};

/// Collects the duration of every call of every stage.
#[derive(Debug, Default, Serialize, Deserialize)]
pub struct Stopwatch {
    #[serde(skip)]
    begun: Option<Instant>,
    durations_ms: BTreeMap<String, Vec<f64>>,
}

impl Stopwatch {
    /// Adds one call.
    pub fn record(&mut self, stage: &str, duration: Duration) {
        self.durations_ms
            .entry(stage.to_owned())
            .or_default()
            .push(duration.as_secs_f64() * 1e3);
    }

    /// Every call of a stage, milliseconds, in order.
    #[must_use]
    pub fn calls_ms(&self, stage: &str) -> &[f64] {
        self.durations_ms.get(stage).map_or(&[], Vec::as_slice)
    }

    /// All calls of a stage together, milliseconds.
    #[must_use]
    pub fn total_ms(&self, stage: &str) -> f64 {
        self.calls_ms(stage).iter().sum()
    }

    /// Adds the calls collected by another one.
    pub fn merge(&mut self, other: &Self) {
        for (stage, ms) in &other.durations_ms {
            let all = self.durations_ms.entry(stage.clone()).or_default();
            all.extend_from_slice(ms);
        }
    }

    /// Median, 95th percentile and number of calls per stage.
    #[must_use]
    pub fn summary(&self) -> BTreeMap<String, StageTiming> {
        let stages = self.durations_ms.iter();
        stages
            .filter_map(|(stage, ms)| Some((stage.clone(), StageTiming::of(ms)?)))
            .collect()
    }
}

impl Observer for Stopwatch {
    fn begin(&mut self, _: Stage) {
        self.begun = Some(Instant::now());
    }

    fn end(&mut self, stage: Stage) {
        if let Some(begun) = self.begun.take() {
            self.record(stage.name(), begun.elapsed());
        }
    }
}

/// Time and memory of one frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct FrameCost {
    /// Position in the recording.
    pub frame: u32,
    /// Tracking, without the wait, milliseconds.
    pub tracking_ms: f64,
    /// Waiting for the mapper, milliseconds.
    pub waiting_ms: f64,
    /// Memory in use after it, MiB; `None` where the system does not report it.
    pub resident_mb: Option<f64>,
    /// Processor time of all threads from the start of the program to its end, milliseconds; `None` where
    /// the system does not report it.
    pub processor_ms: Option<f64>,
}

/// A line of `/proc/self/status` that counts memory, such as `VmRSS:` or `VmHWM:`, MiB. `None` on
/// systems that have no such file.
#[must_use]
pub fn memory_mb(line: &str) -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with(line))?;
    let kib: f64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kib / 1024.0)
}

/// Processor time of all threads so far, milliseconds, in steps of 10. `None` on systems that have no
/// `/proc/self/stat`.
#[must_use]
pub fn processor_ms() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    processor_ms_of(&stat)
}

/// Of the fields behind the program's name in parentheses, the 12th and the 13th: time in its own code and
/// in the system's, in hundredths of a second (`man 5 proc`).
fn processor_ms_of(stat: &str) -> Option<f64> {
    let (_, fields) = stat.rsplit_once(')')?;
    let mut fields = fields.split_whitespace().skip(11);
    let own: f64 = fields.next()?.parse().ok()?;
    let system: f64 = fields.next()?.parse().ok()?;
    Some(10.0 * (own + system))
}

/// A stopwatch shared by two threads.
#[derive(Debug, Clone, Default)]
pub struct SharedStopwatch(Arc<Mutex<Stopwatch>>);

impl SharedStopwatch {
    fn lock(&self) -> MutexGuard<'_, Stopwatch> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns what was collected so far, and starts anew.
    #[must_use]
    pub fn take(&self) -> Stopwatch {
        std::mem::take(&mut *self.lock())
    }
}

impl Observer for SharedStopwatch {
    fn begin(&mut self, stage: Stage) {
        self.lock().begin(stage);
    }

    fn end(&mut self, stage: Stage) {
        self.lock().end(stage);
    }
}

#[cfg(test)]
mod tests {
    use super::processor_ms_of;

    #[test]
    fn processor_time_is_own_and_system_time() {
        // A name may hold spaces and parentheses.
        let stat = "7 (a ) b) S 1 7 7 0 -1 4 10 0 0 0 123 45 6 7 20 0 3 0";
        assert_eq!(processor_ms_of(stat), Some(1680.0), "(123 + 45) / 100 s");
        assert_eq!(processor_ms_of("7 (a) S 1 7"), None, "cut off");
    }
}
