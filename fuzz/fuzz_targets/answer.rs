//! A port's answers to a golden case: a `.npy` of any content for each of its outputs.

#![no_main]

use garad_fuzz::{folder_of, within_mib};
use garad_golden::Case;
use garad_golden::answers::read_answers;
use garad_golden::judge::judge;
use libfuzzer_sys::fuzz_target;

/// Outputs of each kind of number, inline.
const CASE: &str = r#"{ "schema": 1, "stage": "fast", "case": "small", "why": "fuzz", "basis": "hand",
  "generator": {}, "inputs": {},
  "outputs": {
    "real":  { "dtype": "f64", "shape": [2, 3], "unit": "m", "data": [[1, 2.5, -3], [0, 1e-9, 7]], "tol": "camera.undistorted" },
    "whole": { "dtype": "i64", "shape": [4], "unit": "1", "data": [3, -1, 4, 1], "tol": "exact" },
    "label": { "dtype": "bool", "shape": [3, 1], "unit": "1", "data": [[true], [false], [true]], "tol": "exact" } } }"#;

fuzz_target!(|data: &[u8]| {
    let folder = folder_of(&[
        ("case.json", CASE.as_bytes()),
        ("real.npy", data),
        ("whole.npy", data),
        ("label.npy", data),
    ]);
    let case = Case::load(folder.path()).expect("the case above");
    within_mib(32, || {
        let answers = read_answers(&case, folder.path());
        let verdict = judge(&case, &answers, true);
        assert_eq!(verdict.outputs.len(), 3, "a verdict on each");
    });
});
