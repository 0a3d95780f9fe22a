//! Numbers to tensors.

use garad_golden::judge::Answers;
use garad_golden::{Case, Dtype, Tensor};

pub(crate) type Out = Answers;

fn put(out: &mut Out, case: &Case, name: &str, dtype: Dtype, count: usize, bytes: Vec<u8>) {
    if !case.output_names().any(|n| n == name) {
        return;
    }
    let expected = case.output(name);
    let shape = match expected.len() == count {
        true => expected.shape().to_vec(),
        false => vec![count],
    };
    let tensor = Tensor::from_bytes(dtype, shape, bytes);
    out.insert(name.to_owned(), tensor.ok_or_else(|| "odd size".to_owned()));
}

pub(crate) fn put_f32(out: &mut Out, case: &Case, name: &str, values: &[f32]) {
    let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    put(out, case, name, Dtype::F32, values.len(), bytes);
}

pub(crate) fn put_f64(out: &mut Out, case: &Case, name: &str, values: &[f64]) {
    let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    put(out, case, name, Dtype::F64, values.len(), bytes);
}

pub(crate) fn put_i64(out: &mut Out, case: &Case, name: &str, values: impl Iterator<Item = i64>) {
    let values: Vec<i64> = values.collect();
    let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    put(out, case, name, Dtype::I64, values.len(), bytes);
}
