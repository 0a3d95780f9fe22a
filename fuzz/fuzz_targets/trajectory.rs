//! Trajectories in TUM format: read, written, read again; and the BONN marker's poses.

#![no_main]

use std::path::Path;

use garad_core::StampedPose;
use garad_dataset::{bonn_camera_from_marker, format_trajectory, parse_trajectory};
use garad_fuzz::{check_error, within_mib};
use libfuzzer_sys::fuzz_target;

fn written(poses: &[StampedPose]) -> Vec<u8> {
    let mut bytes = Vec::new();
    format_trajectory(&mut bytes, poses).expect("memory takes everything");
    bytes
}

fuzz_target!(|data: &[u8]| {
    let path = Path::new("t.txt");
    let poses = match within_mib(16, || parse_trajectory(path, data)) {
        Ok(poses) => poses,
        Err(error) => return check_error(&error, path),
    };
    assert!(poses.is_sorted_by(|a, b| a.t_s < b.t_s), "ascending");
    for pose in &poses {
        let (r, t) = (
            &pose.world_from_camera.rotation,
            pose.world_from_camera.translation,
        );
        let numbers = r.quaternion().into_iter().chain(t.iter().copied());
        assert!(numbers.chain([pose.t_s]).all(f64::is_finite), "{pose:?}");
        let norm = r.quaternion().iter().map(|q| q * q).sum::<f64>();
        assert!((norm - 1.0).abs() < 1e-14, "{pose:?}");
    }
    assert_eq!(
        bonn_camera_from_marker(&poses).len(),
        poses.len(),
        "one each"
    );

    // Six decimals: times closer than that do not ascend once they are written.
    let apart = |a: &StampedPose, b: &StampedPose| b.t_s - a.t_s > 2e-6 + 1e-15 * b.t_s;
    if !poses.is_sorted_by(apart) {
        return;
    }
    let text = written(&poses);
    let again = parse_trajectory(path, &text).expect("what was written");
    assert_eq!(again.len(), poses.len(), "poses");
    for (a, b) in poses.iter().zip(&again) {
        let near = |x: f64, y: f64, step: f64| (x - y).abs() <= step + x.abs() * 1e-15;
        assert!(near(a.t_s, b.t_s, 0.5e-6), "{a:?} {b:?}");
        let (a, b) = (&a.world_from_camera, &b.world_from_camera);
        for (x, y) in a.translation.iter().zip(b.translation.iter()) {
            assert!(near(*x, *y, 0.5e-9), "{a:?} {b:?}");
        }
        for (x, y) in a
            .rotation
            .quaternion()
            .into_iter()
            .zip(b.rotation.quaternion())
        {
            assert!((x - y).abs() <= 3e-9, "{a:?} {b:?}");
        }
    }
});
