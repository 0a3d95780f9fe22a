//! [`Inputs`]: what a stage is given of a case: parameters and input tensors, and nothing of the outputs.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde_json::Value;
use thiserror::Error;

use crate::tensor::{Dtype, Tensor};

/// An input or parameter that a case does not have, or has in another form.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum InputError {
    /// No such name.
    #[error("no {kind} '{name}'; there is {known}")]
    Missing {
        /// Input or parameter.
        kind: &'static str,
        /// Asked for.
        name: String,
        /// The names there are.
        known: String,
    },
    /// Another type or shape.
    #[error("'{name}' is {found}; expected {expected}")]
    Type {
        /// Name.
        name: String,
        /// What it is.
        found: String,
        /// What it should be.
        expected: String,
    },
}

/// The question of a case. There is no way from here to the expected outputs.
#[derive(Debug)]
pub struct Inputs {
    pub(crate) stage: String,
    pub(crate) case: String,
    pub(crate) flags: Vec<String>,
    pub(crate) params: BTreeMap<String, Value>,
    pub(crate) tensors: BTreeMap<String, Tensor>,
    pub(crate) units: BTreeMap<String, String>,
    pub(crate) folder: PathBuf,
}

impl Inputs {
    /// Of a case that lies in no folder.
    #[must_use]
    pub fn new(
        [stage, case]: [&str; 2],
        flags: &[&str],
        params: BTreeMap<String, Value>,
        tensors: BTreeMap<String, Tensor>,
    ) -> Self {
        Self {
            stage: stage.to_owned(),
            case: case.to_owned(),
            flags: flags.iter().map(|&flag| flag.to_owned()).collect(),
            params,
            tensors,
            units: BTreeMap::new(),
            folder: PathBuf::new(),
        }
    }

    /// Stage.
    #[must_use]
    pub fn stage(&self) -> &str {
        &self.stage
    }

    /// Name within the stage.
    #[must_use]
    pub fn case(&self) -> &str {
        &self.case
    }

    /// `STAGE/CASE`.
    #[must_use]
    pub fn name(&self) -> String {
        format!("{}/{}", self.stage, self.case)
    }

    /// Flags: what is special about the case.
    #[must_use]
    pub fn flags(&self) -> &[String] {
        &self.flags
    }

    /// Whether the case carries this flag.
    #[must_use]
    pub fn has_flag(&self, flag: &str) -> bool {
        self.flags.iter().any(|f| f == flag)
    }

    /// Every parameter by name.
    #[must_use]
    pub fn params(&self) -> &BTreeMap<String, Value> {
        &self.params
    }

    /// Every input tensor by name.
    #[must_use]
    pub fn tensors(&self) -> &BTreeMap<String, Tensor> {
        &self.tensors
    }

    /// An input, if the case has it.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<&Tensor> {
        self.tensors.get(name)
    }

    /// The unit of an input, in words.
    #[must_use]
    pub fn unit(&self, name: &str) -> Option<&str> {
        self.units.get(name).map(String::as_str)
    }

    /// The folder `data` beside the root of the cases: recordings that cases refer to.
    #[must_use]
    pub fn data_folder(&self) -> PathBuf {
        self.folder.join("../../../data")
    }

    /// An input.
    ///
    /// # Errors
    /// [`InputError`] if the case has none of this name; so all methods below.
    pub fn tensor(&self, name: &str) -> Result<&Tensor, InputError> {
        named(&self.tensors, "input", name)
    }

    fn param<'a, T>(
        &'a self,
        name: &str,
        expected: &str,
        read: impl Fn(&'a Value) -> Option<T>,
    ) -> Result<T, InputError> {
        let value = named(&self.params, "parameter", name)?;
        read(value).ok_or_else(|| wrong(name, value, expected))
    }

    /// A parameter: a number.
    ///
    /// # Errors
    /// [`InputError`].
    pub fn number(&self, name: &str) -> Result<f64, InputError> {
        self.param(name, "a number", Value::as_f64)
    }

    /// A parameter: a count or an index.
    ///
    /// # Errors
    /// [`InputError`].
    pub fn count(&self, name: &str) -> Result<usize, InputError> {
        let whole = |v: &Value| usize::try_from(v.as_u64()?).ok();
        self.param(name, "a whole number", whole)
    }

    /// A parameter: a word.
    ///
    /// # Errors
    /// [`InputError`].
    pub fn word(&self, name: &str) -> Result<&str, InputError> {
        self.param(name, "a string", Value::as_str)
    }

    /// A parameter: the value that stands for its word.
    ///
    /// # Errors
    /// [`InputError`], also for a word that is not in the list.
    pub fn choice<T: Copy>(&self, name: &str, known: &[(&str, T)]) -> Result<T, InputError> {
        let word = self.word(name)?;
        let found = known.iter().find(|(k, _)| *k == word);
        let words = || known.iter().map(|k| k.0).collect::<Vec<_>>().join(", ");
        found
            .map(|(_, value)| *value)
            .ok_or_else(|| wrong(name, word, &format!("one of {}", words())))
    }

    /// A parameter: a switch.
    ///
    /// # Errors
    /// [`InputError`].
    pub fn switch(&self, name: &str) -> Result<bool, InputError> {
        self.param(name, "true or false", Value::as_bool)
    }

    /// An input as f64, flat; any type fits.
    ///
    /// # Errors
    /// [`InputError`].
    pub fn reals(&self, name: &str) -> Result<Vec<f64>, InputError> {
        Ok(self.tensor(name)?.f64())
    }

    /// An input of type f32, flat.
    ///
    /// # Errors
    /// [`InputError`].
    pub fn singles(&self, name: &str) -> Result<Vec<f32>, InputError> {
        let tensor = self.tensor(name)?;
        match tensor.dtype() {
            Dtype::F32 => Ok(tensor.f32()),
            other => Err(wrong(name, other.name(), "f32")),
        }
    }

    /// An input of type u8 or bool, flat.
    ///
    /// # Errors
    /// [`InputError`].
    pub fn bytes(&self, name: &str) -> Result<&[u8], InputError> {
        let tensor = self.tensor(name)?;
        match tensor.dtype() {
            Dtype::U8 | Dtype::Bool => Ok(tensor.bytes()),
            other => Err(wrong(name, other.name(), "u8 or bool")),
        }
    }

    /// An input of whole numbers, as indices or counts.
    ///
    /// # Errors
    /// [`InputError`].
    pub fn indices(&self, name: &str) -> Result<Vec<usize>, InputError> {
        let tensor = self.tensor(name)?;
        if matches!(tensor.dtype(), Dtype::F32 | Dtype::F64) {
            return Err(wrong(name, tensor.dtype().name(), "whole numbers"));
        }
        let index = |i: i64| usize::try_from(i).map_err(|_| wrong(name, i, "a whole number"));
        tensor.i64().into_iter().map(index).collect()
    }

    /// An input as rows of `N` numbers.
    ///
    /// # Errors
    /// [`InputError`].
    pub fn rows<const N: usize>(&self, name: &str) -> Result<Vec<[f64; N]>, InputError> {
        let values = self.reals(name)?;
        match values.as_chunks::<N>() {
            (rows, []) => Ok(rows.to_vec()),
            _ => Err(self.shape_is_not(name, &format!("rows of {N}"))),
        }
    }

    /// An input of exactly `N` numbers.
    ///
    /// # Errors
    /// [`InputError`].
    pub fn row<const N: usize>(&self, name: &str) -> Result<[f64; N], InputError> {
        let values = self.reals(name)?;
        let row = values.try_into();
        row.map_err(|_| self.shape_is_not(name, &format!("{N} numbers")))
    }

    /// Width and height of an input that is an image.
    ///
    /// # Errors
    /// [`InputError`].
    pub fn size(&self, name: &str) -> Result<(usize, usize), InputError> {
        match *self.tensor(name)?.shape() {
            [height, width, ..] => Ok((width, height)),
            _ => Err(self.shape_is_not(name, "an image")),
        }
    }

    /// The error for an input of another shape.
    #[must_use]
    pub fn shape_is_not(&self, name: &str, expected: &str) -> InputError {
        let shape = self.get(name).map(Tensor::shape).unwrap_or_default();
        wrong(name, format!("of shape {shape:?}"), expected)
    }
}

fn wrong(name: &str, found: impl std::fmt::Display, expected: &str) -> InputError {
    InputError::Type {
        name: name.to_owned(),
        found: found.to_string(),
        expected: expected.to_owned(),
    }
}

fn named<'a, T>(
    map: &'a BTreeMap<String, T>,
    kind: &'static str,
    name: &str,
) -> Result<&'a T, InputError> {
    map.get(name).ok_or_else(|| InputError::Missing {
        kind,
        name: name.to_owned(),
        known: map.keys().cloned().collect::<Vec<_>>().join(", "),
    })
}
