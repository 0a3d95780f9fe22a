//! [`Case`]: one folder with inputs, parameters and expected outputs.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::compare::{Comparison, compare};
use crate::error::GoldenError;
use crate::inputs::Inputs;
use crate::manifest::{Entry, Manifest, load_tensor, read};
use crate::tensor::{Dtype, Tensor};
use crate::tol::{self, Tolerance};

/// A golden case, read whole: the [`Inputs`] a stage is given, and what must come out.
#[derive(Debug)]
pub struct Case {
    inputs: Inputs,
    why: String,
    basis: String,
    equations: Vec<String>,
    outputs: BTreeMap<String, Tensor>,
    units: BTreeMap<String, String>,
    tolerances: BTreeMap<String, String>,
}

fn units(entries: &BTreeMap<String, Entry>) -> BTreeMap<String, String> {
    let unit = |(name, entry): (&String, &Entry)| (name.clone(), entry.unit.clone());
    entries.iter().map(unit).collect()
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
            let found = manifest.schema;
            return Err(GoldenError::Schema { path, found });
        }
        let load = |entries: &BTreeMap<String, Entry>| {
            entries
                .iter()
                .map(|(name, entry)| Ok((name.clone(), load_tensor(folder, name, entry)?)))
                .collect::<Result<BTreeMap<_, _>, GoldenError>>()
        };
        let tensors = load(&manifest.inputs)?;
        let outputs = load(&manifest.outputs)?;
        let input_units = units(&manifest.inputs);
        let output_units = units(&manifest.outputs);
        let tolerances = manifest.outputs.into_iter();
        Ok(Self {
            inputs: Inputs {
                stage: manifest.stage,
                case: manifest.case,
                flags: manifest.flags,
                params: manifest.params,
                tensors,
                units: input_units,
                folder: folder.to_owned(),
            },
            why: manifest.why,
            basis: manifest.basis,
            equations: manifest.equations,
            outputs,
            units: output_units,
            tolerances: tolerances
                .map(|(name, entry)| (name, entry.tol.unwrap_or_default()))
                .collect(),
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

    /// `tests/golden` of a folder, or of the nearest one above it; it is known by its `tolerances.json`.
    #[must_use]
    pub fn root_above(folder: &Path) -> Option<PathBuf> {
        let roots = folder.ancestors().map(|f| f.join("tests/golden"));
        roots
            .into_iter()
            .find(|root| root.join("tolerances.json").is_file())
    }

    /// The workspace's `tests/golden`, for tests: cargo starts them below it.
    ///
    /// # Panics
    /// If there is none above the current folder.
    #[must_use]
    pub fn root() -> PathBuf {
        let here = std::env::current_dir().expect("a current folder");
        Self::root_above(&here)
            .unwrap_or_else(|| panic!("no tests/golden in or above {}", here.display()))
    }

    /// What a stage is given.
    #[must_use]
    pub fn inputs(&self) -> &Inputs {
        &self.inputs
    }

    /// `STAGE/CASE`.
    #[must_use]
    pub fn name(&self) -> String {
        self.inputs.name()
    }

    /// Stage alone.
    #[must_use]
    pub fn stage(&self) -> &str {
        self.inputs.stage()
    }

    /// Name within the stage.
    #[must_use]
    pub fn case(&self) -> &str {
        self.inputs.case()
    }

    /// The folder it was read from.
    #[must_use]
    pub fn folder(&self) -> &Path {
        &self.inputs.folder
    }

    /// Why the case exists.
    #[must_use]
    pub fn why(&self) -> &str {
        &self.why
    }

    /// Where the expected values come from.
    #[must_use]
    pub fn basis(&self) -> &str {
        &self.basis
    }

    /// Equations the case pins.
    #[must_use]
    pub fn equations(&self) -> &[String] {
        &self.equations
    }

    /// Every expected output by name.
    #[must_use]
    pub fn outputs(&self) -> &BTreeMap<String, Tensor> {
        &self.outputs
    }

    /// The unit of an expected output, in words.
    #[must_use]
    pub fn unit(&self, name: &str) -> Option<&str> {
        self.units.get(name).map(String::as_str)
    }

    /// The tolerance of an output for answers in f32, see [`tol::for_f32`].
    ///
    /// # Errors
    /// As [`Case::tolerance`].
    pub fn tolerance_f32(&self, name: &str) -> Result<Tolerance, GoldenError> {
        let wide = self.tolerance(name)?;
        Ok(match self.output(name).dtype() {
            Dtype::F64 => tol::for_f32(self.stage(), name, self.inputs.flags(), wide),
            _ => *wide,
        })
    }

    /// An expected output.
    ///
    /// # Panics
    /// If the case has no such output.
    #[must_use]
    pub fn output(&self, name: &str) -> &Tensor {
        let output = self.named(&self.outputs, name);
        output.unwrap_or_else(|error| panic!("{error}"))
    }

    fn named<'a, T>(&self, map: &'a BTreeMap<String, T>, name: &str) -> Result<&'a T, GoldenError> {
        map.get(name).ok_or_else(|| GoldenError::Unknown {
            case: self.name(),
            kind: "output",
            name: name.to_owned(),
            known: map.keys().cloned().collect::<Vec<_>>().join(", "),
        })
    }

    /// The tolerance of an output, for answers as precise as the expected values.
    ///
    /// # Errors
    /// [`GoldenError::Unknown`] if the output, or the tolerance it names, does not exist.
    pub fn tolerance(&self, name: &str) -> Result<&'static Tolerance, GoldenError> {
        let wanted = self.named(&self.tolerances, name)?;
        tol::find(wanted).ok_or_else(|| GoldenError::Unknown {
            case: self.name(),
            kind: "tolerance",
            name: wanted.clone(),
            known: "a table in crates/golden/src/tol.rs".to_owned(),
        })
    }

    /// Compares an answer, flat in C order, with an expected output.
    ///
    /// # Errors
    /// [`GoldenError`] if the output or its tolerance is unknown, or the number of elements wrong.
    /// An answer out of tolerance is a [`Comparison`] that did not pass.
    pub fn compare(&self, name: &str, got: &[f64]) -> Result<Comparison, GoldenError> {
        let expected = self.named(&self.outputs, name)?;
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
