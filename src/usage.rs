//! Memory and processor time of the process.

use serde::{Deserialize, Serialize};

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

/// Memory in use, MiB; `None` on systems without `/proc/self/status`.
#[must_use]
pub fn resident_mb() -> Option<f64> {
    status_mb("VmRSS:")
}

/// Largest memory in use so far, MiB; `None` on systems without `/proc/self/status`.
#[must_use]
pub fn peak_resident_mb() -> Option<f64> {
    status_mb("VmHWM:")
}

fn status_mb(key: &str) -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let value = status.lines().find_map(|line| line.strip_prefix(key))?;
    let kib: f64 = value.split_whitespace().next()?.parse().ok()?;
    Some(kib / 1024.0)
}

/// Processor time of all threads so far, milliseconds, in steps of 10. `None` on systems that have no
/// `/proc/self/stat`.
#[must_use]
pub fn processor_ms() -> Option<f64> {
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    processor_ms_of(&stat)
}

/// The sum of the 12th and 13th field after the program's name in parentheses: time in user and in system
/// mode, in hundredths of a second (`man 5 proc`).
fn processor_ms_of(stat: &str) -> Option<f64> {
    let (_, fields) = stat.rsplit_once(')')?;
    let mut fields = fields.split_whitespace().skip(11);
    let user: f64 = fields.next()?.parse().ok()?;
    let system: f64 = fields.next()?.parse().ok()?;
    Some(10.0 * (user + system))
}

#[cfg(test)]
mod tests {
    use super::processor_ms_of;

    #[test]
    fn processor_time_is_user_and_system_time() {
        // A name may contain spaces and parentheses.
        let stat = "7 (a ) b) S 1 7 7 0 -1 4 10 0 0 0 123 45 6 7 20 0 3 0";
        assert_eq!(processor_ms_of(stat), Some(1680.0), "(123 + 45) / 100 s");
        assert_eq!(processor_ms_of("7 (a) S 1 7"), None, "cut off");
    }
}
