//! [`LabelWindow`]: the retention window of eq. 7. A Gaussian is removed only after a number of dynamic runs.
//!
//! As printed,
//!
//! S = 1 - (1/n) Σ_{k=i}^{i+n} (1 - L(k)),  removed where S = 0
//!
//! has n + 1 terms over n, and the wrong sign: always dynamic gives S = 1 (kept), and S = 0 means
//! exactly one dynamic run among n + 1 (removed). The text asks for the opposite, "avoiding premature
//! deletion of potential static ones", which is the printed formula without its leading "1 -":
//!
//! S = (1/n) Σ (1 - L) over the last n runs,  removed where S = 0: dynamic in every one      (C6)
//!
//! # Example
//! ```
//! use garad_core::Label::{Dynamic, Static};
//! use garad_crf::{LabelWindow, LabelWindowConfig};
//! let config = LabelWindowConfig { runs: 3, ..LabelWindowConfig::default() };
//! let mut window = LabelWindow::default();
//! for label in [Dynamic, Static, Dynamic, Dynamic] {
//!     window.push(label);
//! }
//! assert_eq!(window.score(&config), Some(1.0 / 3.0)); // of the last three, one was static
//! assert!(!window.is_removed(&config));
//! window.push(Dynamic);
//! assert!(window.is_removed(&config));
//! ```

use garad_core::Label;
use serde::{Deserialize, Serialize};

use crate::error::{CrfError, setting};
use crate::readings::WindowReading;

/// Length and reading of the window.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LabelWindowConfig {
    /// n, in runs of the field, 1..=63. The paper gives none; at two keyframes per second, 10 runs
    /// are 5 s of wrong labels before a Gaussian is lost.
    pub runs: u32,
    /// The reading.
    pub reading: WindowReading,
}

impl Default for LabelWindowConfig {
    fn default() -> Self {
        Self {
            runs: 10,
            reading: WindowReading::StaticShare,
        }
    }
}

impl LabelWindowConfig {
    /// # Errors
    /// [`CrfError::BadSetting`] for a window that is empty or longer than 63 runs.
    pub fn validate(&self) -> Result<(), CrfError> {
        let runs = f64::from(self.runs);
        let fits = (1..LabelWindow::CAPACITY).contains(&self.runs);
        setting(
            "label_window.runs",
            runs,
            "a number of runs in 1..=63",
            fits,
        )
    }
}

/// The last 64 labels of one Gaussian, one bit each.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct LabelWindow {
    /// Bit 0 is the latest run; 1 is dynamic.
    dynamic: u64,
    /// Runs so far, at most [`LabelWindow::CAPACITY`].
    seen: u32,
}

impl LabelWindow {
    /// Runs it remembers.
    pub const CAPACITY: u32 = 64;

    /// Appends the label of a run.
    pub fn push(&mut self, label: Label) {
        self.dynamic = self.dynamic << 1 | u64::from(label == Label::Dynamic);
        self.seen = (self.seen + 1).min(Self::CAPACITY);
    }

    /// Runs so far, counted up to [`LabelWindow::CAPACITY`].
    #[must_use]
    pub fn seen(&self) -> u32 {
        self.seen
    }

    /// Dynamic runs among the last `n` (up to [`LabelWindow::CAPACITY`]).
    #[must_use]
    pub fn dynamic_runs(&self, n: u32) -> u32 {
        let last = u64::MAX
            .checked_shr(Self::CAPACITY.saturating_sub(n))
            .unwrap_or(0);
        (self.dynamic & last).count_ones()
    }

    /// Static runs within the window, and the window's length in runs; `None` before it is full.
    fn static_runs(&self, config: &LabelWindowConfig) -> Option<u32> {
        let length = match config.reading {
            WindowReading::StaticShare => config.runs,
            WindowReading::Literal => config.runs + 1,
        };
        (self.seen >= length).then(|| length - self.dynamic_runs(length))
    }

    /// Eq. 7: S = (1/n) Σ (1 - L) over the last n runs, or, as printed,
    /// S = 1 - (1/n) Σ (1 - L) over n + 1. `None` before there are as many runs as it sums over.
    #[must_use]
    pub fn score(&self, config: &LabelWindowConfig) -> Option<f64> {
        let share = f64::from(self.static_runs(config)?) / f64::from(config.runs);
        Some(match config.reading {
            WindowReading::StaticShare => share,
            WindowReading::Literal => 1.0 - share,
        })
    }

    /// S = 0; exact, as S is a ratio of small whole numbers.
    #[must_use]
    pub fn is_removed(&self, config: &LabelWindowConfig) -> bool {
        self.score(config) == Some(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use Label::{Dynamic, Static};

    fn window(labels: impl IntoIterator<Item = Label>) -> LabelWindow {
        let mut window = LabelWindow::default();
        labels.into_iter().for_each(|label| window.push(label));
        window
    }

    #[test]
    fn removed_after_ten_dynamic_runs_not_after_nine() {
        let config = LabelWindowConfig::default();
        let nine = window([Dynamic; 9]);
        assert!(
            !nine.is_removed(&config) && nine.score(&config).is_none(),
            "nine"
        );
        let ten = window([Dynamic; 10]);
        assert!(
            ten.is_removed(&config) && ten.score(&config) == Some(0.0),
            "ten"
        );
        let interrupted = window([Dynamic; 9].into_iter().chain([Static]).chain([Dynamic; 9]));
        assert!(
            !interrupted.is_removed(&config),
            "one static run restarts the count"
        );
        assert_eq!(interrupted.score(&config), Some(0.1), "one of ten");
    }

    #[test]
    fn the_printed_formula_keeps_what_always_moves() {
        let config = LabelWindowConfig {
            reading: WindowReading::Literal,
            ..LabelWindowConfig::default()
        };
        assert_eq!(
            window([Dynamic; 11]).score(&config),
            Some(1.0),
            "always dynamic"
        );
        let score = window([Static; 11]).score(&config).expect("eleven runs");
        assert!((score + 0.1).abs() < 1e-15, "always static: {score}");
        let once = window([Dynamic].into_iter().chain([Static; 10]));
        assert!(
            once.score(&config) == Some(0.0) && once.is_removed(&config),
            "once in eleven"
        );
    }

    #[test]
    fn longest_windows() {
        let config = LabelWindowConfig {
            runs: 63,
            reading: WindowReading::Literal,
        };
        assert_eq!(config.validate(), Ok(()), "63");
        let full = window([Dynamic; 100]);
        assert_eq!(
            (full.seen(), full.dynamic_runs(64), full.dynamic_runs(99)),
            (64, 64, 64),
            "full"
        );
        assert_eq!(full.dynamic_runs(0), 0, "none asked for");
        assert_eq!(full.score(&config), Some(1.0), "64 terms over 63");
        for runs in [0, 64] {
            let config = LabelWindowConfig { runs, ..config };
            assert!(config.validate().is_err(), "{runs} runs");
        }
    }
}
