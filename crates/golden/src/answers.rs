//! [`Answers`]: a backend's outputs of one case.

use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::Path;

use crate::case::Case;
use crate::error::GoldenError;
use crate::manifest::read_npy;
use crate::tensor::Tensor;

/// A backend's outputs by name; a text where a file is there and cannot be used.
pub type Answers = BTreeMap<String, Result<Tensor, String>>;

/// Reads `OUTPUT.npy` for every output of a case; a file that is not there is no answer.
#[must_use]
pub fn read_answers(case: &Case, folder: &Path) -> Answers {
    let read = |name: &str| match read_npy(&folder.join(format!("{name}.npy"))) {
        Err(GoldenError::Io { source, .. }) if source.kind() == ErrorKind::NotFound => None,
        // The name of the output is in the report already.
        Err(GoldenError::Io { source, .. }) => Some(Err(source.to_string())),
        Err(GoldenError::Npy { source, .. }) => Some(Err(source.to_string())),
        answer => Some(answer.map_err(|error| error.to_string())),
    };
    let names = case.outputs().keys();
    names
        .filter_map(|name| Some((name.clone(), read(name)?)))
        .collect()
}
