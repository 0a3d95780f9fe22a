//! The documents of layouts whose images are named by number: a `transforms.json` of nerfstudio; `camera_intrinsic.json`
//! and, behind a zero byte, `trajectory.log` of Open3D; `cam_params.json` and `traj.txt` of Replica.

#![no_main]

use garad_dataset::Dataset;
use garad_fuzz::{CAMERA, check_error, folder_of, open, within_mib};
use libfuzzer_sys::fuzz_target;

/// Opens a folder with these files as the program does, leniently and strictly, and checks what there is.
fn check(files: &[(&str, &[u8])]) {
    let folder = folder_of(files);
    let path = folder.path();
    let [lenient, strict] = within_mib(64, || [false, true].map(|strict| open(path, strict)));
    let Some(dataset) = lenient else {
        assert!(strict.is_none(), "strict reads what lenient refuses");
        return;
    };
    check_dataset(&dataset);
    if let Some(strict) = strict {
        assert_eq!(strict.len(), dataset.len(), "the same frames");
        assert_eq!(
            strict.ground_truth(),
            dataset.ground_truth(),
            "the same poses"
        );
    }
    match within_mib(64, || dataset.read(dataset.len() - 1)) {
        Ok(_) => {}
        Err(error) => check_error(&error, path),
    }
}

fn check_dataset(dataset: &Dataset) {
    let calibration = dataset.calibration();
    calibration.camera.validate().expect("a valid camera");
    for value in [calibration.depth_factor, calibration.fps] {
        assert!(value > 0.0 && value.is_finite(), "{calibration:?}");
    }
    let times = (0..dataset.len()).filter_map(|i| dataset.timestamp(i));
    assert!(times.is_sorted_by(|a, b| a < b), "ascending times");
    let left_out = dataset.left_out().map_or(0, |out| out.frames);
    assert_eq!(
        dataset.listed(),
        dataset.len() + left_out,
        "every image listed"
    );
    for pose in dataset.ground_truth().unwrap_or_default() {
        let pose = &pose.world_from_camera;
        let unit: f64 = pose.rotation.quaternion().iter().map(|q| q * q).sum();
        assert!((unit - 1.0).abs() < 1e-9, "{pose:?}");
        assert!(pose.translation.iter().all(|t| t.is_finite()), "{pose:?}");
    }
}

fuzz_target!(|data: &[u8]| {
    let mut parts = data.splitn(2, |byte| *byte == 0);
    let first = parts.next().unwrap_or_default();
    let second = parts.next().unwrap_or_default();
    check(&[("transforms.json", first)]);
    check(&[
        ("transforms.json", first),
        ("camera.txt", CAMERA.as_bytes()),
    ]);
    check(&[
        ("color/000000.jpg", b""),
        ("color/000001.jpg", b""),
        ("depth/000001.png", b""),
        ("camera_intrinsic.json", first),
        ("trajectory.log", second),
    ]);
    check(&[
        ("results/frame000000.jpg", b""),
        ("results/depth000000.png", b""),
        ("cam_params.json", first),
        ("traj.txt", second),
    ]);
});
