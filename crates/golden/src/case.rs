//! [`Case`]: one folder with inputs, parameters and expected outputs.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::compare::{Comparison, compare};
use crate::error::GoldenError;
use crate::manifest::{Entry, Manifest, load_tensor, read};
use crate::tensor::Tensor;
use crate::tol::{self, Tolerance};

/// A golden case, read whole.
///
/// The methods without a `Result` are for tests: what they ask for must be in the case, and a
/// wrong name panics with the names there are.
#[derive(Debug)]
pub struct Case {
    folder: PathBuf,
    manifest: Manifest,
    inputs: BTreeMap<String, Tensor>,
    outputs: BTreeMap<String, Tensor>,
}

impl Case {
    /// Reads the case in a folder.
    ///
    /// # Errors
    /// [`GoldenError`] naming the file and what is wrong with it.
    pub fn load(folder: &Path) -> Result<Self, GoldenError> {
        let path = folder.join("case.json");
        let bytes = read(&path)?;
        let manifest: Manifest =
            serde_json::from_slice(&bytes).map_err(|source| GoldenError::Json {
                path: path.clone(),
                source,
            })?;
        if manifest.schema != 1 {
            return Err(GoldenError::Schema {
                path,
                found: manifest.schema,
            });
        }
        let load = |entries: &BTreeMap<String, Entry>| {
            entries
                .iter()
                .map(|(name, entry)| Ok((name.clone(), load_tensor(folder, name, entry)?)))
                .collect::<Result<BTreeMap<_, _>, GoldenError>>()
        };
        Ok(Self {
            folder: folder.to_owned(),
            inputs: load(&manifest.inputs)?,
            outputs: load(&manifest.outputs)?,
            manifest,
        })
    }

    /// The case folders of a stage under a root, in the order of their names.
    ///
    /// # Errors
    /// [`GoldenError::Io`] if the folder cannot be listed.
    pub fn folders(root: &Path, stage: &str) -> Result<Vec<PathBuf>, GoldenError> {
        let path = root.join(stage);
        let io = |source| GoldenError::Io {
            path: path.clone(),
            source,
        };
        let mut folders = Vec::new();
        for entry in std::fs::read_dir(&path).map_err(io)? {
            let folder = entry.map_err(io)?.path();
            if folder.join("case.json").is_file() {
                folders.push(folder);
            }
        }
        folders.sort();
        Ok(folders)
    }

    /// Every case under a root, ordered by stage and name. A folder without cases is passed over.
    ///
    /// # Errors
    /// [`GoldenError`] of the first folder or case that cannot be read.
    pub fn load_root(root: &Path) -> Result<Vec<Self>, GoldenError> {
        let io = |source| GoldenError::Io {
            path: root.to_owned(),
            source,
        };
        let mut stages = Vec::new();
        for entry in std::fs::read_dir(root).map_err(io)? {
            let entry = entry.map_err(io)?;
            if entry.path().is_dir() {
                stages.push(entry.file_name().to_string_lossy().into_owned());
            }
        }
        stages.sort();
        let mut cases = Vec::new();
        for stage in stages {
            for folder in Self::folders(root, &stage)? {
                cases.push(Self::load(&folder)?);
            }
        }
        Ok(cases)
    }

    /// The cases of a stage: those committed under `tests/golden/`, and, when the variable
    /// `GARAD_EXTRA_CASES` names a folder, those under it.
    ///
    /// # Panics
    /// If a case cannot be read, or if the stage has no committed case.
    #[must_use]
    pub fn load_all(stage: &str) -> Vec<Self> {
        let mut folders = Self::folders(&Self::root(), stage)
            .ok()
            .filter(|folders| !folders.is_empty())
            .unwrap_or_else(|| panic!("no golden case for stage '{stage}' in {:?}", Self::root()));
        if let Some(extra) = std::env::var_os("GARAD_EXTRA_CASES") {
            // A stage without extra cases is no mistake.
            folders.extend(Self::folders(Path::new(&extra), stage).unwrap_or_default());
        }
        folders
            .iter()
            .map(|folder| Self::load(folder).unwrap_or_else(|error| panic!("{error}")))
            .collect()
    }

    /// The workspace's `tests/golden`.
    #[must_use]
    pub fn root() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden")
    }

    /// `STAGE/CASE`.
    #[must_use]
    pub fn name(&self) -> String {
        format!("{}/{}", self.manifest.stage, self.manifest.case)
    }

    /// Stage alone.
    #[must_use]
    pub fn stage(&self) -> &str {
        &self.manifest.stage
    }

    /// Name within the stage.
    #[must_use]
    pub fn case(&self) -> &str {
        &self.manifest.case
    }

    /// The folder it was read from.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Flags: what is special about the case.
    #[must_use]
    pub fn flags(&self) -> &[String] {
        &self.manifest.flags
    }

    /// Why the case exists.
    #[must_use]
    pub fn why(&self) -> &str {
        &self.manifest.why
    }

    /// Where the expected values come from.
    #[must_use]
    pub fn basis(&self) -> &str {
        &self.manifest.basis
    }

    /// Equations the case pins.
    #[must_use]
    pub fn equations(&self) -> &[String] {
        &self.manifest.equations
    }

    /// Whether the case carries this flag.
    #[must_use]
    pub fn has_flag(&self, flag: &str) -> bool {
        self.manifest.flags.iter().any(|f| f == flag)
    }

    /// Names of the outputs, sorted.
    pub fn output_names(&self) -> impl Iterator<Item = &str> {
        self.outputs.keys().map(String::as_str)
    }

    /// Names of the inputs, sorted.
    pub fn input_names(&self) -> impl Iterator<Item = &str> {
        self.inputs.keys().map(String::as_str)
    }

    /// Names of the parameters, sorted.
    pub fn param_names(&self) -> impl Iterator<Item = &str> {
        self.manifest.params.keys().map(String::as_str)
    }

    /// A parameter, if the case has it.
    #[must_use]
    pub fn param(&self, name: &str) -> Option<&Value> {
        self.manifest.params.get(name)
    }

    /// A number.
    ///
    /// # Panics
    /// If the case has no such parameter, or if it is no number.
    #[must_use]
    pub fn param_f64(&self, name: &str) -> f64 {
        self.typed(name, "a number", Value::as_f64)
    }

    /// A count or an index.
    ///
    /// # Panics
    /// If the case has no such parameter, or if it is not a whole number ≥ 0.
    #[must_use]
    pub fn param_usize(&self, name: &str) -> usize {
        self.typed(name, "a whole number", |v| {
            v.as_u64().and_then(|n| usize::try_from(n).ok())
        })
    }

    /// A switch.
    ///
    /// # Panics
    /// If the case has no such parameter, or if it is not true or false.
    #[must_use]
    pub fn param_bool(&self, name: &str) -> bool {
        self.typed(name, "true or false", Value::as_bool)
    }

    /// A word.
    ///
    /// # Panics
    /// If the case has no such parameter, or if it is no string.
    #[must_use]
    pub fn param_str(&self, name: &str) -> &str {
        self.typed(name, "a string", Value::as_str)
    }

    fn typed<'a, T>(&'a self, name: &str, kind: &str, read: fn(&'a Value) -> Option<T>) -> T {
        let value = named(&self.manifest.params, &self.name(), "parameter", name)
            .unwrap_or_else(|error| panic!("{error}"));
        read(value).unwrap_or_else(|| panic!("{}: '{name}' is {value}, not {kind}", self.name()))
    }

    /// An input, if the case has it.
    #[must_use]
    pub fn try_input(&self, name: &str) -> Option<&Tensor> {
        self.inputs.get(name)
    }

    /// An input.
    ///
    /// # Panics
    /// If the case has no such input.
    #[must_use]
    pub fn input(&self, name: &str) -> &Tensor {
        named(&self.inputs, &self.name(), "input", name).unwrap_or_else(|error| panic!("{error}"))
    }

    /// An expected output.
    ///
    /// # Panics
    /// If the case has no such output.
    #[must_use]
    pub fn output(&self, name: &str) -> &Tensor {
        named(&self.outputs, &self.name(), "output", name).unwrap_or_else(|error| panic!("{error}"))
    }

    /// The tolerance of an output, for answers as precise as the expected values.
    ///
    /// # Errors
    /// [`GoldenError::Unknown`] if the output, or the tolerance it names, does not exist.
    pub fn tolerance(&self, name: &str) -> Result<&'static Tolerance, GoldenError> {
        let entry = named(&self.manifest.outputs, &self.name(), "output", name)?;
        let wanted = entry.tol.as_deref().unwrap_or("");
        tol::find(wanted).ok_or_else(|| GoldenError::Unknown {
            case: self.name(),
            kind: "tolerance",
            name: wanted.to_owned(),
            known: "a table in crates/golden/src/tol.rs".to_owned(),
        })
    }

    /// Compares an answer, flat in C order, with an expected output.
    ///
    /// # Errors
    /// [`GoldenError`] if the output or its tolerance is unknown, or the number of elements wrong.
    /// An answer out of tolerance is a [`Comparison`] that did not pass.
    pub fn compare(&self, name: &str, got: &[f64]) -> Result<Comparison, GoldenError> {
        let expected = named(&self.outputs, &self.name(), "output", name)?;
        let tolerance = self.tolerance(name)?;
        compare(expected, got, tolerance).map_err(|source| GoldenError::Count {
            case: self.name(),
            name: name.to_owned(),
            source,
        })
    }

    /// [`Case::compare`] for tests: `Ok` if the answer is within tolerance, else the whole report.
    ///
    /// # Errors
    /// The report as a text.
    pub fn check(&self, name: &str, got: &[f64]) -> Result<(), String> {
        match self.compare(name, got) {
            Ok(comparison) if comparison.passed => Ok(()),
            Ok(comparison) => Err(format!("{} '{name}': {comparison}", self.name())),
            Err(error) => Err(error.to_string()),
        }
    }
}

fn named<'a, T>(
    map: &'a BTreeMap<String, T>,
    case: &str,
    kind: &'static str,
    name: &str,
) -> Result<&'a T, GoldenError> {
    map.get(name).ok_or_else(|| GoldenError::Unknown {
        case: case.to_owned(),
        kind,
        name: name.to_owned(),
        known: map.keys().cloned().collect::<Vec<_>>().join(", "),
    })
}
