//! [`Case`]: one folder with inputs, parameters and expected outputs.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use serde_json::Value;
use thiserror::Error;

use crate::compare::{Comparison, CountMismatch, compare};
use crate::npy::{self, NpyError};
use crate::tensor::{Dtype, Tensor};
use crate::tol;

/// No file of a case is larger; what claims to be is refused unread.
const MAX_FILE_BYTES: u64 = 64 << 20;

/// What is wrong with a case, or with an answer to it.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum GoldenError {
    /// A file cannot be read.
    #[error("{}: {source}", path.display())]
    Io {
        /// File.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file larger than any case's.
    #[error("{}: {bytes} bytes; at most {MAX_FILE_BYTES} are read", path.display())]
    TooLarge {
        /// File.
        path: PathBuf,
        /// Its size.
        bytes: u64,
    },
    /// `case.json` is not what it should be.
    #[error("{}: {source}", path.display())]
    Json {
        /// File.
        path: PathBuf,
        /// Where and why.
        source: serde_json::Error,
    },
    /// A schema this version does not know.
    #[error("{}: schema {found}; expected 1", path.display())]
    Schema {
        /// File.
        path: PathBuf,
        /// Its schema.
        found: u32,
    },
    /// A `.npy` file that cannot be used.
    #[error("{}: {source}", path.display())]
    Npy {
        /// File.
        path: PathBuf,
        /// Why.
        source: NpyError,
    },
    /// A tensor whose description and content disagree.
    #[error("{}: tensor '{tensor}': {problem}", path.display())]
    Tensor {
        /// The case's `case.json`.
        path: PathBuf,
        /// Name.
        tensor: String,
        /// What disagrees.
        problem: String,
    },
    /// An answer for an output the case does not have, or in a tolerance the table does not have.
    #[error("{case}: no {kind} '{name}'; there is {known}")]
    Unknown {
        /// Name of the case.
        case: String,
        /// Input, output, parameter or tolerance.
        kind: &'static str,
        /// Asked for.
        name: String,
        /// The names there are.
        known: String,
    },
    /// An answer of the wrong size.
    #[error("{case}: output '{name}': {source}")]
    Count {
        /// Name of the case.
        case: String,
        /// Output.
        name: String,
        /// The two counts.
        source: CountMismatch,
    },
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Manifest {
    schema: u32,
    stage: String,
    case: String,
    #[serde(default)]
    equations: Vec<String>,
    why: String,
    #[serde(default)]
    flags: Vec<String>,
    basis: String,
    #[serde(rename = "generator")]
    _generator: Value,
    #[serde(default)]
    params: BTreeMap<String, Value>,
    #[serde(default)]
    inputs: BTreeMap<String, Entry>,
    outputs: BTreeMap<String, Entry>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    dtype: String,
    shape: Vec<usize>,
    #[serde(rename = "unit")]
    _unit: String,
    file: Option<String>,
    data: Option<Value>,
    tol: Option<String>,
}

/// A golden case, read whole.
///
/// The methods without a `Result` are for tests: what they ask for must be in the case, and a
/// wrong name panics with the names there are.
#[derive(Debug)]
pub struct Case {
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

    /// Compares an answer, flat in C order, with an expected output.
    ///
    /// # Errors
    /// [`GoldenError`] if the output or its tolerance is unknown, or the number of elements wrong.
    /// An answer out of tolerance is a [`Comparison`] that did not pass.
    pub fn compare(&self, name: &str, got: &[f64]) -> Result<Comparison, GoldenError> {
        let expected = named(&self.outputs, &self.name(), "output", name)?;
        let wanted = self.manifest.outputs[name].tol.as_deref().unwrap_or("");
        let tolerance = tol::find(wanted).ok_or_else(|| GoldenError::Unknown {
            case: self.name(),
            kind: "tolerance",
            name: wanted.to_owned(),
            known: "a table in crates/golden/src/tol.rs".to_owned(),
        })?;
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

fn read(path: &Path) -> Result<Vec<u8>, GoldenError> {
    let io = |source| GoldenError::Io {
        path: path.to_owned(),
        source,
    };
    let bytes = std::fs::metadata(path).map_err(io)?.len();
    if bytes > MAX_FILE_BYTES {
        return Err(GoldenError::TooLarge {
            path: path.to_owned(),
            bytes,
        });
    }
    std::fs::read(path).map_err(io)
}

/// From its file or its inline data; type and shape must be those `case.json` states.
fn load_tensor(folder: &Path, name: &str, entry: &Entry) -> Result<Tensor, GoldenError> {
    let problem = |problem: String| GoldenError::Tensor {
        path: folder.join("case.json"),
        tensor: name.to_owned(),
        problem,
    };
    let dtype = Dtype::from_name(&entry.dtype)
        .ok_or_else(|| problem(format!("unknown dtype '{}'", entry.dtype)))?;
    match (&entry.file, &entry.data) {
        (Some(file), None) => {
            if file.contains(['/', '\\']) || file.starts_with('.') {
                return Err(problem(format!("file '{file}' is not a plain name")));
            }
            let path = folder.join(file);
            let tensor =
                npy::decode(&read(&path)?).map_err(|source| GoldenError::Npy { path, source })?;
            if (tensor.dtype(), tensor.shape()) == (dtype, &entry.shape[..]) {
                Ok(tensor)
            } else {
                Err(problem(format!(
                    "stated {} {:?}, but {file} holds {} {:?}",
                    entry.dtype,
                    entry.shape,
                    tensor.dtype().name(),
                    tensor.shape()
                )))
            }
        }
        (None, Some(data)) => {
            let mut bytes = Vec::new();
            flatten(data, &entry.shape, dtype, &mut bytes).map_err(problem)?;
            Tensor::from_bytes(dtype, entry.shape.clone(), bytes)
                .ok_or_else(|| problem("data and shape disagree".to_owned()))
        }
        _ => Err(problem("needs either 'file' or 'data'".to_owned())),
    }
}

/// Nested lists, as deep as the shape is long, to bytes in C order.
fn flatten(data: &Value, shape: &[usize], dtype: Dtype, out: &mut Vec<u8>) -> Result<(), String> {
    match (data, shape) {
        (Value::Array(items), [size, rest @ ..]) if items.len() == *size => items
            .iter()
            .try_for_each(|item| flatten(item, rest, dtype, out)),
        (scalar, []) => push_scalar(scalar, dtype, out)
            .ok_or_else(|| format!("{scalar} is not a value of type {}", dtype.name())),
        (other, _) => Err(format!("expected lists of shape {shape:?}, got {other}")),
    }
}

/// Numbers as numbers; "nan", "inf" and "-inf", which JSON lacks, as strings.
#[allow(
    clippy::cast_possible_truncation,
    reason = "f32 values are written with all their digits"
)]
fn push_scalar(value: &Value, dtype: Dtype, out: &mut Vec<u8>) -> Option<()> {
    fn int<T: TryFrom<i64>>(value: &Value) -> Option<T> {
        T::try_from(value.as_i64()?).ok()
    }
    let float = || match value.as_str() {
        Some("nan") => Some(f64::NAN),
        Some("inf") => Some(f64::INFINITY),
        Some("-inf") => Some(f64::NEG_INFINITY),
        Some(_) => None,
        None => value.as_f64(),
    };
    match dtype {
        Dtype::F64 => out.extend(float()?.to_le_bytes()),
        Dtype::F32 => out.extend((float()? as f32).to_le_bytes()),
        Dtype::I8 => out.extend(int::<i8>(value)?.to_le_bytes()),
        Dtype::U8 => out.push(int(value)?),
        Dtype::I16 => out.extend(int::<i16>(value)?.to_le_bytes()),
        Dtype::U16 => out.extend(int::<u16>(value)?.to_le_bytes()),
        Dtype::I32 => out.extend(int::<i32>(value)?.to_le_bytes()),
        Dtype::U32 => out.extend(int::<u32>(value)?.to_le_bytes()),
        Dtype::I64 => out.extend(int::<i64>(value)?.to_le_bytes()),
        Dtype::Bool => out.push(u8::from(value.as_bool()?)),
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str = r#""schema": 1, "stage": "s", "case": "c", "why": "w", "basis": "closed-form",
        "generator": {"script": "gen/s.py", "version": 1, "seed": null}"#;

    fn folder(json: &str, files: &[(&str, &[u8])]) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("case.json"), json).unwrap();
        for (name, bytes) in files {
            std::fs::write(folder.path().join(name), bytes).unwrap();
        }
        folder
    }

    fn with_output(entry: &str) -> String {
        format!("{{{HEAD}, \"outputs\": {{\"y\": {entry}}}}}")
    }

    fn error_of(json: &str, files: &[(&str, &[u8])]) -> String {
        let folder = folder(json, files);
        Case::load(folder.path()).unwrap_err().to_string()
    }

    #[test]
    fn a_case_reads_its_tensors_and_judges_answers() {
        let npy = npy::encode(&Tensor::from(vec![1.0, 2.0]));
        let json = format!(
            r#"{{{HEAD}, "flags": ["edge"], "params": {{"k": 3, "h": 0.5, "on": true, "mode": "raw"}},
               "inputs": {{"x": {{"dtype": "f64", "shape": [2], "unit": "m", "file": "x.npy"}}}},
               "outputs": {{"y": {{"dtype": "f64", "shape": [1, 2], "unit": "px",
                                   "data": [[0.1, "nan"]], "tol": "exact"}}}}}}"#
        );
        let folder = folder(&json, &[("x.npy", &npy)]);
        let case = Case::load(folder.path()).unwrap();
        assert_eq!(case.name(), "s/c", "name");
        assert_eq!(case.input("x").f64(), [1.0, 2.0], "from a file");
        assert_eq!(case.output("y").shape(), [1, 2], "inline");
        assert_eq!(case.param_usize("k"), 3, "count");
        assert!(
            (case.param_f64("k") - 3.0).abs() < 1e-15,
            "a count is a number"
        );
        assert!(case.param_bool("on") && case.has_flag("edge"), "switches");
        assert_eq!(case.param_str("mode"), "raw", "word");
        assert_eq!(case.check("y", &[0.1, f64::NAN]), Ok(()), "right");
        let report = case.check("y", &[0.1, 0.0]).unwrap_err();
        assert!(
            report.contains("s/c 'y'") && report.contains("worst at [0, 1]"),
            "{report}"
        );
        let report = case.check("y", &[0.1]).unwrap_err();
        assert!(report.contains("1 elements; expected 2"), "{report}");
        let report = case.check("z", &[]).unwrap_err();
        assert!(report.contains("no output 'z'; there is y"), "{report}");
    }

    /// The nearest f64 of a text of 17 digits, not one next to it.
    #[test]
    fn numbers_are_parsed_to_the_last_bit() {
        let text = "3.5844466002796428e+298";
        let json = with_output(&format!(
            r#"{{"dtype": "f64", "shape": [], "unit": "1", "data": {text}, "tol": "exact"}}"#
        ));
        let folder = folder(&json, &[]);
        let case = Case::load(folder.path()).unwrap();
        let expected: f64 = text.parse().unwrap();
        assert_eq!(
            case.output("y").f64()[0].to_bits(),
            expected.to_bits(),
            "bits"
        );
    }

    #[test]
    fn disagreements_are_named() {
        let x = npy::encode(&Tensor::from(vec![1.0]));
        for (entry, expected) in [
            (
                r#"{"dtype": "f16", "shape": [], "unit": "1", "data": 1}"#,
                "unknown dtype 'f16'",
            ),
            (
                r#"{"dtype": "f64", "shape": [1], "unit": "1"}"#,
                "needs either",
            ),
            (
                r#"{"dtype": "f64", "shape": [2], "unit": "1", "file": "x.npy"}"#,
                "holds f64 [1]",
            ),
            (
                r#"{"dtype": "f32", "shape": [1], "unit": "1", "file": "x.npy"}"#,
                "stated f32",
            ),
            (
                r#"{"dtype": "f64", "shape": [1], "unit": "1", "file": "../x.npy"}"#,
                "plain name",
            ),
            (
                r#"{"dtype": "f64", "shape": [1], "unit": "1", "file": "..\\x.npy"}"#,
                "plain name",
            ),
            (
                r#"{"dtype": "f64", "shape": [1], "unit": "1", "file": "gone.npy"}"#,
                "gone.npy",
            ),
            (
                r#"{"dtype": "f64", "shape": [1], "unit": "1", "file": "case.json"}"#,
                "NUMPY",
            ),
            (
                r#"{"dtype": "u8", "shape": [1], "unit": "1", "data": [256]}"#,
                "256 is not a value",
            ),
            (
                r#"{"dtype": "f64", "shape": [2], "unit": "1", "data": [1]}"#,
                "lists of shape [2]",
            ),
            (
                r#"{"dtype": "f64", "shape": [1], "unit": "1", "data": ["NaN"]}"#,
                "is not a value",
            ),
            (
                r#"{"dtype": "f64", "shape": [1], "unit": "1", "extra": 0}"#,
                "unknown field",
            ),
        ] {
            let error = error_of(&with_output(entry), &[("x.npy", &x)]);
            assert!(error.contains(expected), "{entry}: {error}");
        }
        let schema = error_of(
            &with_output("{}").replace("\"schema\": 1", "\"schema\": 2"),
            &[],
        );
        assert!(
            schema.contains("missing field"),
            "the entry comes first: {schema}"
        );
        let none = format!("{{{HEAD}, \"outputs\": {{}}}}").replace("1,", "2,");
        assert!(
            error_of(&none, &[]).contains("schema 2; expected 1"),
            "schema"
        );
    }

    #[test]
    fn unknown_tolerances_are_refused() {
        let json =
            with_output(r#"{"dtype": "f64", "shape": [], "unit": "1", "data": 1, "tol": "loose"}"#);
        let folder = folder(&json, &[]);
        let report = Case::load(folder.path())
            .unwrap()
            .check("y", &[1.0])
            .unwrap_err();
        assert!(report.contains("no tolerance 'loose'"), "{report}");
    }

    #[test]
    #[should_panic(expected = "no golden case for stage 'nowhere'")]
    fn a_stage_without_cases_panics() {
        let _ = Case::load_all("nowhere");
    }
}
