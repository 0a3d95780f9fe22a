//! `case.json` of a golden case, beside three tensors that it may name.

#![no_main]

use garad_fuzz::{folder_of, within_mib};
use garad_golden::answers::read_answers;
use garad_golden::judge::judge;
use garad_golden::verdict::Outcome;
use garad_golden::{Case, Dtype, Tensor, npy};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let floats = npy::encode(&Tensor::from(vec![1.5, -2.0, 0.25, f64::NAN, 8.0, 1e-9]));
    let bytes = Tensor::from_bytes(Dtype::U8, vec![3, 1], vec![1, 0, 2]).expect("three");
    let whole = [7i64, -9].map(i64::to_le_bytes).concat();
    let whole = Tensor::from_bytes(Dtype::I64, vec![2], whole).expect("two");
    let folder = folder_of(&[
        ("case.json", data),
        ("a.npy", &floats),
        ("b.npy", &npy::encode(&bytes)),
        ("c.npy", &npy::encode(&whole)),
    ]);
    let path = folder.path();
    let case = match within_mib(16, || Case::load(path)) {
        Ok(case) => case,
        Err(error) => {
            let place = path.display().to_string();
            assert!(error.to_string().contains(&place), "{error}");
            return;
        }
    };
    let verdict = within_mib(16, || judge(&case, &read_answers(&case, path), false));
    let missing = verdict
        .outputs
        .iter()
        .any(|output| output.comparison.is_none());
    assert!(verdict.outcome != Outcome::Pass || !missing, "{verdict:?}");
});
