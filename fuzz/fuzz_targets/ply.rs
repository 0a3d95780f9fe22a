//! Maps as PLY in the three encodings: read, written, read again.

#![no_main]

use std::path::Path;

use garad_dataset::PlyOptions;
use garad_dataset::ply::{format_ply, parse_ply};
use garad_fuzz::{check_error, within_mib};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let path = Path::new("map.ply");
    let read = |mut bytes: &[u8]| within_mib(32, || parse_ply(path, &mut bytes));
    let map = match read(data) {
        Ok(map) => map,
        Err(error) => return check_error(&error, path),
    };
    map.validate().expect("what is read can be written");
    let mut file = Vec::new();
    format_ply(&mut file, &map, &PlyOptions { label: true }).expect("memory");
    let again = read(&file).expect("what was written");
    for i in 0..map.len() {
        let (low, high) = again.sh_of(i).split_at(map.coefficients());
        assert_eq!(low, map.sh_of(i), "colour {i}");
        assert!(high.as_flattened().iter().all(|v| *v == 0.0), "padding {i}");
    }
    assert_eq!(
        (again.means, again.log_scales, again.quaternions),
        (map.means, map.log_scales, map.quaternions),
        "geometry"
    );
    assert_eq!(
        (again.opacity_logits, again.label),
        (map.opacity_logits, map.label),
        "the rest"
    );
});
