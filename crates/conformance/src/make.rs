//! Golden cases made on demand, of any size: `garad golden make`.
//!
//! The committed cases are small and their values come from outside. What goes wrong only at size (batches, long
//! lists, big sorts, crowded tiles) needs cases of 100 000 Gaussians, whose values come from the plain f64 stages here. Those
//! stages are held to the committed cases, and each case made says so in its `basis`.

mod masks;
mod others;
mod scene;
mod splatting;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use garad_golden::{Dtype, Inputs, Tensor, npy, tol};
use serde_json::{Value, json};

use crate::outputs::{Error, Outputs};

pub use others::Other;
pub use scene::{SceneKind, SceneOptions};
pub use splatting::{SPLATTING, TILE_PX, splatting};

/// Flag of every case that was made.
pub const FLAG: &str = "made";
/// Where the expected values come from.
pub const BASIS: &str = "garad's reference in f64, itself held to the committed cases from outside";
/// Larger files are refused when a case is read.
const MAX_FILE_BYTES: usize = 64 << 20;

/// A case before it is written.
#[derive(Debug)]
pub struct Made {
    stage: &'static str,
    case: String,
    why: String,
    flags: Vec<&'static str>,
    seed: u64,
    params: BTreeMap<String, Value>,
    inputs: BTreeMap<String, Tensor>,
    units: BTreeMap<String, &'static str>,
    outputs: BTreeMap<String, (Tensor, &'static str, &'static str)>,
}

impl Made {
    fn new(stage: &'static str, case: String, seed: u64, why: String) -> Self {
        Self {
            stage,
            case,
            why,
            flags: vec![FLAG],
            seed,
            params: BTreeMap::new(),
            inputs: BTreeMap::new(),
            units: BTreeMap::new(),
            outputs: BTreeMap::new(),
        }
    }

    fn param(&mut self, name: &str, value: impl Into<Value>) {
        self.params.insert(name.to_owned(), value.into());
    }

    fn input(&mut self, name: &str, tensor: Tensor, unit: &'static str) {
        self.units.insert(name.to_owned(), unit);
        self.inputs.insert(name.to_owned(), tensor);
    }

    /// What the stage is given.
    fn question(&self) -> Inputs {
        let (params, tensors) = (self.params.clone(), self.inputs.clone());
        Inputs::new([self.stage, &self.case], &self.flags, params, tensors)
    }

    /// The outputs of a table (name, type, unit, tolerance); those with another number of axes are given one.
    fn expect(&mut self, found: &Outputs, table: &[Output]) -> Result<(), Error> {
        for &(name, dtype, unit, tolerance) in table {
            let tensor = found.tensors().get(name);
            let tensor = tensor.ok_or_else(|| format!("{}: no output '{name}'", self.stage))?;
            let tensor =
                converted(tensor, dtype).ok_or_else(|| format!("'{name}' in {dtype:?}"))?;
            if tol::find(tolerance).is_none() {
                return Err(format!("no tolerance '{tolerance}'").into());
            }
            self.outputs
                .insert(name.to_owned(), (tensor, unit, tolerance));
        }
        Ok(())
    }

    /// Writes `root/STAGE/CASE`, in place of what was there, and returns that folder.
    ///
    /// # Errors
    /// If a file cannot be written, or an array is larger than a case may hold.
    pub fn write(&self, root: &Path) -> Result<PathBuf, Error> {
        let folder = root.join(self.stage).join(&self.case);
        if folder.exists() {
            std::fs::remove_dir_all(&folder)?;
        }
        std::fs::create_dir_all(&folder)?;
        let write = |name: &str, tensor: &Tensor, unit: &str| -> Result<Value, Error> {
            let bytes = npy::encode(tensor);
            if bytes.len() > MAX_FILE_BYTES {
                let mib = bytes.len() >> 20;
                let most = MAX_FILE_BYTES >> 20;
                return Err(format!("'{name}' has {mib} MiB, a case at most {most}: fewer Gaussians, or a lower degree").into());
            }
            let file = format!("{name}.npy");
            std::fs::write(folder.join(&file), bytes)?;
            let dtype = tensor.dtype().name();
            Ok(json!({"dtype": dtype, "shape": tensor.shape(), "unit": unit, "file": file}))
        };
        let (mut inputs, mut outputs) = (BTreeMap::new(), BTreeMap::new());
        for (name, tensor) in &self.inputs {
            inputs.insert(name, write(name, tensor, self.units[name])?);
        }
        for (name, (tensor, unit, tolerance)) in &self.outputs {
            let mut entry = write(name, tensor, unit)?;
            entry["tol"] = json!(tolerance);
            outputs.insert(name, entry);
        }
        let head = json!({
            "schema": 1, "stage": self.stage, "case": self.case, "equations": [], "why": self.why,
            "flags": self.flags, "basis": BASIS,
            "generator": {"script": "garad golden make", "version": 1, "seed": self.seed},
            "params": self.params, "inputs": inputs, "outputs": outputs,
        });
        // Last: a folder without it is no case.
        std::fs::write(
            folder.join("case.json"),
            serde_json::to_string_pretty(&head)? + "\n",
        )?;
        Ok(folder)
    }
}

/// Name, type, unit, tolerance.
type Output = (&'static str, Dtype, &'static str, &'static str);

/// The same numbers in another type that holds them.
#[allow(
    clippy::cast_possible_truncation,
    reason = "values come from this type, or are whole and in its range"
)]
fn converted(tensor: &Tensor, dtype: Dtype) -> Option<Tensor> {
    let bytes: Vec<u8> = match dtype {
        _ if tensor.dtype() == dtype => return Some(tensor.clone()),
        Dtype::F32 => tensor
            .f64()
            .iter()
            .flat_map(|&v| (v as f32).to_le_bytes())
            .collect(),
        Dtype::F64 => tensor.f64().iter().flat_map(|v| v.to_le_bytes()).collect(),
        Dtype::I32 => tensor
            .f64()
            .iter()
            .flat_map(|&v| (v as i32).to_le_bytes())
            .collect(),
        Dtype::U8 => {
            let bytes = tensor.f64().into_iter().map(|v| u8::try_from(v as i64));
            bytes.collect::<Result<_, _>>().ok()?
        }
        _ => return None,
    };
    Tensor::from_bytes(dtype, tensor.shape().to_vec(), bytes)
}

fn shaped(values: Vec<f64>, shape: &[usize], dtype: Dtype) -> Tensor {
    let tensor = Tensor::from(values).reshape(shape);
    let tensor = tensor.expect("as many numbers as the shape says");
    converted(&tensor, dtype).expect("a type of this file")
}

fn bytes(values: Vec<u8>, shape: &[usize], dtype: Dtype) -> Tensor {
    let tensor = Tensor::from_bytes(dtype, shape.to_vec(), values);
    tensor.expect("as many bytes as the shape says")
}

/// Rounded to f32, so that every port reads the same number.
#[allow(clippy::cast_possible_truncation, reason = "the rounding is the point")]
fn f32_of(v: f64) -> f64 {
    f64::from(v as f32)
}

#[cfg(test)]
mod tests;
