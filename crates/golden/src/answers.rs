//! [`Answers`]: a backend's outputs of one case.

use std::collections::BTreeMap;
use std::path::Path;

use crate::case::Case;
use crate::npy;
use crate::tensor::Tensor;

/// A backend's outputs by name; a text where a file is there and cannot be used.
pub type Answers = BTreeMap<String, Result<Tensor, String>>;

/// Reads `OUTPUT.npy` for every output of a case; a file that is not there is no answer.
#[must_use]
pub fn read_answers(case: &Case, folder: &Path) -> Answers {
    let read = |name: &str| {
        let bytes = match std::fs::read(folder.join(format!("{name}.npy"))) {
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return None,
            other => other,
        };
        let text = |error: &dyn std::fmt::Display| error.to_string();
        Some(match bytes {
            Ok(bytes) => npy::decode(&bytes).map_err(|error| text(&error)),
            Err(error) => Err(text(&error)),
        })
    };
    let names = case.outputs().keys();
    names
        .filter_map(|name| Some((name.clone(), read(name)?)))
        .collect()
}
