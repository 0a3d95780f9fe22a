//! Retention (eq. 7): the one rule by which a landmark or a Gaussian takes on a label.

use garad_core::Label;
use garad_crf::{LabelWindow, LabelWindowConfig};

/// What a new label did.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Retention {
    /// The label differs from the one before.
    pub(crate) changed: bool,
    /// Dynamic in every run of the window: to be removed.
    pub(crate) expired: bool,
}

/// Stores the label of a run and adds it to the window of eq. 7.
pub(crate) fn push_label(
    stored: &mut Label,
    window: &mut LabelWindow,
    label: Label,
    config: &LabelWindowConfig,
) -> Retention {
    window.push(label);
    Retention {
        changed: std::mem::replace(stored, label) != label,
        expired: window.is_removed(config),
    }
}

#[cfg(test)]
mod tests {
    use Label::{Dynamic, Static};
    use garad_crf::WindowReading;

    use super::*;

    /// Three runs: removed after the third dynamic one in a row. As printed, eq. 7 sums over four, and removes what was
    /// dynamic in one of them.
    #[test]
    fn a_label_is_stored_counted_once_and_expires_with_a_whole_window() {
        let at_once = [
            (Static, false, false),
            (Dynamic, true, false),
            (Dynamic, false, false),
            (Static, true, false),
            (Dynamic, true, false),
            (Dynamic, false, false),
            (Dynamic, false, true),
            (Static, true, false),
            (Dynamic, true, false),
        ];
        let as_printed = [
            (Static, false, false),
            (Dynamic, true, false),
            (Static, true, false),
            (Static, false, true),
            (Dynamic, true, false),
        ];
        for (reading, runs) in [
            (WindowReading::StaticShare, &at_once[..]),
            (WindowReading::Literal, &as_printed[..]),
        ] {
            let config = LabelWindowConfig { runs: 3, reading };
            let (mut stored, mut window) = (Static, LabelWindow::default());
            for (run, (label, changed, expired)) in (1u32..).zip(runs.iter().copied()) {
                let found = push_label(&mut stored, &mut window, label, &config);
                let expected = Retention { changed, expired };
                assert_eq!(found, expected, "{reading:?}, run {run}");
                assert_eq!((stored, window.seen()), (label, run), "run {run}");
            }
        }
    }
}
