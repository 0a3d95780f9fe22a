//! Golden cases: `case.json` and `.npy` in, `.npy` out. Expected outputs are not looked at.

use std::fs;
use std::path::{Path, PathBuf};

use serde_json::Value;

use crate::Error;

/// The inputs of one case.
pub struct Case {
    folder: PathBuf,
    pub stage: String,
    params: Value,
    inputs: Value,
}

/// Numbers with their shape.
#[derive(Debug)]
pub struct Array {
    pub shape: Vec<usize>,
    pub data: Vec<f64>,
}

impl Case {
    pub fn read(folder: &Path) -> Result<Self, Error> {
        let path = folder.join("case.json");
        let text = fs::read_to_string(&path).map_err(|e| format!("{}: {e}", path.display()))?;
        let mut manifest: Value =
            serde_json::from_str(&text).map_err(|e| format!("{}: {e}", path.display()))?;
        let stage = manifest["stage"].as_str().ok_or("case.json: no stage")?;
        Ok(Self {
            folder: folder.to_owned(),
            stage: stage.to_owned(),
            params: manifest["params"].take(),
            inputs: manifest["inputs"].take(),
        })
    }

    pub fn number(&self, name: &str) -> Result<f64, Error> {
        let value = self.params[name].as_f64();
        value.ok_or_else(|| format!("no number {name} in params"))
    }

    /// A parameter in single precision.
    pub fn single(&self, name: &str) -> Result<f32, Error> {
        Ok(self.number(name)? as f32)
    }

    pub fn whole(&self, name: &str) -> Result<u32, Error> {
        let value = self.params[name]
            .as_u64()
            .and_then(|v| u32::try_from(v).ok());
        value.ok_or_else(|| format!("no whole number {name} in params"))
    }

    pub fn word(&self, name: &str) -> Result<&str, Error> {
        let value = self.params[name].as_str();
        value.ok_or_else(|| format!("no word {name} in params"))
    }

    pub fn switch(&self, name: &str) -> Result<bool, Error> {
        let value = self.params[name].as_bool();
        value.ok_or_else(|| format!("no switch {name} in params"))
    }

    pub fn has_param(&self, name: &str) -> bool {
        !self.params[name].is_null()
    }

    pub fn has(&self, name: &str) -> bool {
        !self.inputs[name].is_null()
    }

    pub fn array(&self, name: &str) -> Result<Array, Error> {
        let entry = &self.inputs[name];
        if let Some(file) = entry["file"].as_str() {
            return read_npy(&self.folder.join(file));
        }
        let wrong = || format!("input {name} is missing or not as the format says");
        // Empty lists do not say how wide they are, so the shape is stated.
        let shape = entry["shape"].as_array().ok_or_else(wrong)?;
        let shape = shape
            .iter()
            .map(|v| v.as_u64().and_then(|v| usize::try_from(v).ok()));
        let shape: Vec<usize> = shape.collect::<Option<_>>().ok_or_else(wrong)?;
        let mut data = Vec::new();
        flatten(&entry["data"], &mut data).ok_or_else(wrong)?;
        if data.len() != shape.iter().product::<usize>() {
            return Err(wrong());
        }
        Ok(Array { shape, data })
    }

    /// An input in single precision.
    pub fn singles(&self, name: &str) -> Result<Vec<f32>, Error> {
        Ok(self.array(name)?.data.iter().map(|&v| v as f32).collect())
    }

    /// 1 where `name` is not 0, otherwise 0.
    pub fn flags(&self, name: &str) -> Result<Vec<u32>, Error> {
        let data = self.array(name)?.data;
        Ok(data.iter().map(|&v| u32::from(v != 0.0)).collect())
    }
}

fn flatten(value: &Value, into: &mut Vec<f64>) -> Option<()> {
    match value {
        Value::Array(rows) => rows.iter().try_for_each(|row| flatten(row, into))?,
        Value::Bool(b) => into.push(f64::from(*b)),
        Value::String(s) => into.push(s.parse().ok()?),
        number => into.push(number.as_f64()?),
    }
    Some(())
}

/// The part of an npy header after `'key':`.
fn after<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    let start = header.find(&format!("'{key}':"))? + key.len() + 3;
    Some(header[start..].trim_start())
}

fn parse_npy(bytes: &[u8]) -> Option<Array> {
    let start = 10 + usize::from(u16::from_le_bytes(bytes.get(8..10)?.try_into().ok()?));
    if &bytes[..8] != b"\x93NUMPY\x01\x00" {
        return None;
    }
    let header = std::str::from_utf8(bytes.get(10..start)?).ok()?;
    if !after(header, "fortran_order")?.starts_with("False") {
        return None;
    }
    let shape = after(header, "shape")?.strip_prefix('(')?.split_once(')')?;
    let numbers = shape.0.split(',').map(str::trim).filter(|s| !s.is_empty());
    let shape: Vec<usize> = numbers.map(|s| s.parse().ok()).collect::<Option<_>>()?;
    let kind = after(header, "descr")?
        .strip_prefix('\'')?
        .split_once('\'')?;
    let body = &bytes[start..];
    macro_rules! numbers {
        ($t:ty) => {{
            let values = body.chunks_exact(size_of::<$t>());
            let value = |c: &[u8]| <$t>::from_le_bytes(c.try_into().expect("exact chunks"));
            values.map(|c| value(c) as f64).collect::<Vec<f64>>()
        }};
    }
    let data = match kind.0 {
        "<f8" => numbers!(f64),
        "<f4" => numbers!(f32),
        "<i8" => numbers!(i64),
        "<i4" => numbers!(i32),
        "<u4" => numbers!(u32),
        "<i2" => numbers!(i16),
        "<u2" => numbers!(u16),
        "|i1" => numbers!(i8),
        "|u1" | "|b1" => numbers!(u8),
        _ => return None,
    };
    (data.len() == shape.iter().product::<usize>()).then_some(Array { shape, data })
}

pub fn read_npy(path: &Path) -> Result<Array, Error> {
    let bytes = fs::read(path).map_err(|e| format!("{}: {e}", path.display()))?;
    parse_npy(&bytes).ok_or_else(|| format!("{}: no npy 1.0 of a known type", path.display()))
}

/// One output: what was computed in f32 is saved as f32, because the check takes the tolerance from
/// the type.
pub enum Output {
    F32(Vec<f32>),
    I32(Vec<i32>),
    U8(Vec<u8>),
}

impl From<Vec<f32>> for Output {
    fn from(data: Vec<f32>) -> Self {
        Self::F32(data)
    }
}

impl From<Vec<i32>> for Output {
    fn from(data: Vec<i32>) -> Self {
        Self::I32(data)
    }
}

impl From<Vec<u8>> for Output {
    fn from(data: Vec<u8>) -> Self {
        Self::U8(data)
    }
}

/// Outputs with their names and shapes.
#[derive(Default)]
pub struct Answer(Vec<(String, Vec<usize>, Output)>);

impl Answer {
    pub fn put(&mut self, name: impl Into<String>, shape: &[usize], data: impl Into<Output>) {
        self.0.push((name.into(), shape.to_vec(), data.into()));
    }

    pub fn write(&self, folder: &Path) -> Result<(), Error> {
        fs::create_dir_all(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
        for (name, shape, data) in &self.0 {
            let (kind, body): (&str, &[u8]) = match data {
                Output::F32(v) => ("<f4", bytemuck::cast_slice(v)),
                Output::I32(v) => ("<i4", bytemuck::cast_slice(v)),
                Output::U8(v) => ("|u1", v),
            };
            let tuple: String = shape.iter().map(|n| format!("{n}, ")).collect();
            let header =
                format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({tuple}), }}");
            // Magic, version, length and header fill whole multiples of 64 bytes, the last a newline.
            let padded = (header.len() + 11).next_multiple_of(64) - 10;
            let length = u16::try_from(padded).map_err(|e| format!("{name}: {e}"))?;
            let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
            bytes.extend(length.to_le_bytes());
            bytes.extend(format!("{header:<0$}\n", padded - 1).bytes());
            bytes.extend(body);
            let path = folder.join(format!("{name}.npy"));
            fs::write(&path, bytes).map_err(|e| format!("{}: {e}", path.display()))?;
        }
        Ok(())
    }
}
