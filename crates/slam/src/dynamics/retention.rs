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
