//! `case.json` and the tensors it names, as they lie on disk.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;
use serde_json::Value;

use crate::error::GoldenError;
use crate::npy;
use crate::tensor::{Dtype, Tensor};

/// No file of a case is larger; what claims to be is refused unread.
pub(crate) const MAX_FILE_BYTES: u64 = 64 << 20;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Manifest {
    pub(crate) schema: u32,
    pub(crate) stage: String,
    pub(crate) case: String,
    #[serde(default)]
    pub(crate) equations: Vec<String>,
    pub(crate) why: String,
    #[serde(default)]
    pub(crate) flags: Vec<String>,
    pub(crate) basis: String,
    #[serde(rename = "generator")]
    pub(crate) _generator: Value,
    #[serde(default)]
    pub(crate) params: BTreeMap<String, Value>,
    #[serde(default)]
    pub(crate) inputs: BTreeMap<String, Entry>,
    pub(crate) outputs: BTreeMap<String, Entry>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Entry {
    pub(crate) dtype: String,
    pub(crate) shape: Vec<usize>,
    pub(crate) unit: String,
    pub(crate) file: Option<String>,
    pub(crate) data: Option<Value>,
    pub(crate) tol: Option<String>,
}

pub(crate) fn read(path: &Path) -> Result<Vec<u8>, GoldenError> {
    let io = |source| GoldenError::Io {
        path: path.to_owned(),
        source,
    };
    let bytes = std::fs::metadata(path).map_err(io)?.len();
    if bytes > MAX_FILE_BYTES {
        return Err(GoldenError::TooLarge {
            path: path.to_owned(),
            bytes,
            limit: MAX_FILE_BYTES,
        });
    }
    std::fs::read(path).map_err(io)
}

/// From its file or its inline data; type and shape must be those `case.json` states.
pub(crate) fn load_tensor(folder: &Path, name: &str, entry: &Entry) -> Result<Tensor, GoldenError> {
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
            let tensor = read_npy(&folder.join(file))?;
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
                .ok_or_else(|| problem("data and shape disagree".to_owned()))?
                .exact()
                .map_err(|error| problem(error.to_string()))
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
/// A `.npy` file, whatever is in it, as long as its numbers can be compared.
pub(crate) fn read_npy(path: &Path) -> Result<Tensor, GoldenError> {
    npy::decode(&read(path)?)
        .and_then(Tensor::exact)
        .map_err(|source| GoldenError::Npy {
            path: path.to_owned(),
            source,
        })
}
