//! `rgb.txt`, then, behind a zero byte, `depth.txt`; the association of the two.

#![no_main]

use garad_fuzz::{CAMERA, check_error, folder_of, open, within_mib};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|data: &[u8]| {
    let mut lists = data.splitn(2, |byte| *byte == 0);
    let rgb = lists.next().unwrap_or_default();
    let depth = lists.next().unwrap_or(rgb);
    let folder = folder_of(&[
        ("rgb.txt", rgb),
        ("depth.txt", depth),
        ("camera.txt", CAMERA.as_bytes()),
    ]);
    let path = folder.path();
    let [lenient, strict] = within_mib(32, || [false, true].map(|strict| open(path, strict)));
    let Some(dataset) = lenient else {
        assert!(strict.is_none(), "strict reads what lenient refuses");
        return;
    };
    let times: Vec<f64> = (0..dataset.len())
        .filter_map(|i| dataset.timestamp(i))
        .collect();
    assert_eq!(times.len(), dataset.len(), "a time for each frame");
    assert!(times.is_sorted_by(|a, b| a < b), "ascending: {times:?}");
    assert!(times.iter().all(|t| (0.0..=1e11).contains(t)), "{times:?}");
    if let Some(strict) = strict {
        assert_eq!(strict.len(), dataset.len(), "the same frames");
    }
    for i in [0, dataset.len() / 2, dataset.len()] {
        match dataset.read(i) {
            Ok(_) => panic!("frame {i} of a folder without images"),
            Err(error) => check_error(&error, path),
        }
    }
});
