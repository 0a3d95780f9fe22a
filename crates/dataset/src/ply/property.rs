//! The properties of an element by name, and what is said of those that cannot be used.

use std::collections::BTreeMap;
use std::path::Path;

use serde_ply::{ElementDef, PropertyType, ScalarType};

use crate::errors::DatasetError;

pub(super) fn error(path: &Path, found: impl Into<String>, expected: &'static str) -> DatasetError {
    DatasetError::Ply {
        path: path.to_path_buf(),
        found: found.into(),
        expected,
    }
}

/// What was found, and what was expected.
pub(super) type Refused = (String, &'static str);

/// Position and type of each property of an element; lists have none.
pub(super) type Names<'a> = BTreeMap<&'a str, (usize, Option<ScalarType>)>;

pub(super) fn names<'a>(path: &Path, element: &'a ElementDef) -> Result<Names<'a>, DatasetError> {
    let mut names = BTreeMap::new();
    for (i, property) in element.properties.iter().enumerate() {
        let kind = match property.property_type {
            PropertyType::Scalar(kind) => Some(kind),
            PropertyType::List { .. } => None,
        };
        if names.insert(property.name.as_str(), (i, kind)).is_some() {
            let found = format!("two properties {}", property.name);
            return Err(error(path, found, "each property once"));
        }
    }
    Ok(names)
}
