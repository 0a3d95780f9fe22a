//! `camera.txt` and `calibration.toml`: what was read is the same when written as `key = value`.

#![no_main]

use std::fmt::Write as _;
use std::path::Path;

use garad_dataset::{Calibration, limits};
use garad_fuzz::{check_error, within_mib};
use libfuzzer_sys::fuzz_target;

fn written(calibration: &Calibration) -> String {
    let c = &calibration.camera;
    let d = &c.distortion;
    let mut text = format!("width = {}\nheight = {}\n", c.width, c.height);
    for (key, value) in [
        ("fx", c.fx),
        ("fy", c.fy),
        ("cx", c.cx),
        ("cy", c.cy),
        ("depth_factor", calibration.depth_factor),
        ("fps", calibration.fps),
        ("k1", d.k1),
        ("k2", d.k2),
        ("p1", d.p1),
        ("p2", d.p2),
        ("k3", d.k3),
        ("depth_delay_s", calibration.depth_delay_s),
    ] {
        writeln!(text, "{key} = {value:?}").expect("memory");
    }
    if let Some(raw) = calibration.depth_max_raw {
        writeln!(text, "depth_max_raw = {raw}").expect("memory");
    }
    text
}

fuzz_target!(|data: &[u8]| {
    let path = Path::new("camera.txt");
    let read = |bytes: &[u8]| within_mib(16, || Calibration::parse(path, bytes));
    let calibration = match read(data) {
        Ok(calibration) => calibration,
        Err(error) => return check_error(&error, path),
    };
    let side = limits::IMAGE_SIDE_PX as usize;
    let camera = &calibration.camera;
    camera.validate().expect("valid");
    assert!(camera.width.max(camera.height) <= side, "{camera:?}");
    for value in [calibration.depth_factor, calibration.fps] {
        assert!(value > 0.0 && value.is_finite(), "{calibration:?}");
    }
    assert!(calibration.depth_delay_s.is_finite(), "{calibration:?}");
    let again = read(written(&calibration).as_bytes()).expect("what was written");
    assert_eq!(again, calibration, "round trip");
});
