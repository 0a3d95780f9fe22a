//! `.npy` files: what was read is the same when written and read again.

#![no_main]

use garad_fuzz::{check_line, within_mib};
use garad_golden::npy::{decode, encode};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let tensor = match within_mib(16, || decode(data)) {
        Ok(tensor) => tensor,
        Err(error) => return check_line(&error.to_string(), ""),
    };
    assert_eq!(
        tensor.shape().iter().product::<usize>(),
        tensor.len(),
        "size"
    );
    let file = encode(&tensor);
    assert_eq!(file.len() - tensor.bytes().len() & 63, 0, "aligned");
    assert_eq!(decode(&file), Ok(tensor), "round trip");
});
