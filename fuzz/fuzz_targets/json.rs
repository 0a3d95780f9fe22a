//! `metrics.json`, `session.json`, and `trace.json` with one tensor.

#![no_main]

use garad::eval::Metrics;
use garad_fuzz::{check_line, folder_of, within_mib};
use garad_golden::trace::diff::{Judge, diff};
use garad_golden::{Tensor, npy};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let tensor = npy::encode(&Tensor::from(vec![1.5, -2.0, f64::NAN]));
    let folder = folder_of(&[
        ("session.json", data),
        ("state-a.bin", b""),
        ("trace.json", data),
        ("000010/pose_0/after.npy", &tensor),
    ]);
    let (path, place) = (folder.path(), folder.path().display().to_string());
    within_mib(32, || {
        if let Err(error) = garad::session::open(path) {
            check_line(&format!("{error:#}"), &place);
        }
        match diff(path, path, Judge::Tolerances) {
            Ok(found) => assert_eq!(found.absent, 0, "an index names its files"),
            Err(error) => assert!(error.to_string().contains(&place), "{error}"),
        }
    });
    let Ok(text) = std::str::from_utf8(data) else {
        return;
    };
    match within_mib(32, || Metrics::from_json(text)) {
        Ok(metrics) => {
            let again = Metrics::from_json(&metrics.to_json()).expect("what was written");
            assert_eq!(again.to_json(), metrics.to_json(), "round trip");
        }
        Err(error) => check_line(&error.to_string(), "line"),
    }
});
