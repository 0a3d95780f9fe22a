//! [`Stopwatch`]: how long each stage took.

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
