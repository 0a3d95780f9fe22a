//! `garad synth`: the layout of the recording.

use std::fs;

use garad_golden::{Dtype, npy};

use crate::support::{Bench, answer, arg, garad, program, walking};

/// Lines without comments.
fn lines(text: &str) -> Vec<&str> {
    text.lines().filter(|line| !line.starts_with('#')).collect()
}

#[test]
fn a_recording_in_tum_layout() {
    let bench = Bench::empty();
    let rec = bench.rec();
    let size = [
        "--size", "160x120", "--frames", "3", "--fps", "10", "--flow", "--quiet",
    ];
    answer(
        program()
            .args(["synth", "walking", "-o"])
            .arg(&rec)
            .args(size),
    )
    .succeeds();
    let times = ["0.000000", "0.100000", "0.200000"];
    for (list, folder) in [("rgb.txt", "rgb"), ("depth.txt", "depth")] {
        let expected: Vec<_> = times.map(|t| format!("{t} {folder}/{t}.png")).to_vec();
        assert_eq!(lines(&bench.read(list)), expected, "{list}");
    }
    let truth = bench.read("groundtruth.txt");
    let stamps: Vec<_> = lines(&truth)
        .iter()
        .filter_map(|l| l.split(' ').next())
        .collect();
    assert_eq!(stamps, times, "a pose for each frame");
    let camera = bench.read("camera.txt");
    assert!(lines(&camera)[0].starts_with("160 120 "), "{camera}");
    assert!(lines(&camera)[0].ends_with(" 5000 10"), "{camera}");
    for time in times {
        let open =
            |folder: &str| image::open(rec.join(format!("{folder}/{time}.png"))).expect(time);
        assert!(
            matches!(open("rgb"), image::DynamicImage::ImageRgb8(_)),
            "{time}"
        );
        let image::DynamicImage::ImageLuma16(depth) = open("depth") else {
            panic!("{time}: depth has 16 bits");
        };
        let near = depth
            .iter()
            .filter(|raw| (500..50_000).contains(*raw))
            .count();
        assert!(
            near > 160 * 120 / 2,
            "{time}: a room is 0.1 to 10 m deep, {near} pixels"
        );
        let image::DynamicImage::ImageLuma8(mask) = open("mask") else {
            panic!("{time}: a mask has 8 bits");
        };
        assert!(
            mask.iter().all(|v| [0, 255].contains(v)),
            "{time}: moving or not"
        );
        assert!(mask.contains(&255), "{time}: a person is in the image");
    }
}

#[test]
fn flow_is_an_array_of_numpy() {
    let bench = Bench::empty();
    let rec = bench.rec();
    let size = ["--size", "64x48", "--frames", "3", "--flow", "--quiet"];
    answer(
        program()
            .args(["synth", "quiet_desk", "-o"])
            .arg(&rec)
            .args(size),
    )
    .succeeds();
    let mut names: Vec<_> = fs::read_dir(rec.join("flow"))
        .expect("a folder")
        .map(|entry| {
            entry
                .expect("an entry")
                .file_name()
                .into_string()
                .expect("UTF-8")
        })
        .collect();
    names.sort();
    assert_eq!(
        names,
        ["0.000000.npy", "0.033333.npy"],
        "none from the last frame"
    );
    for name in names {
        let bytes = fs::read(rec.join("flow").join(&name)).expect("a file");
        assert!(bytes.starts_with(b"\x93NUMPY\x01\x00"), "{name}");
        let flow = npy::decode(&bytes).expect("an array");
        assert_eq!(flow.dtype(), Dtype::F32, "{name}");
        assert_eq!(flow.shape(), [48, 64, 2], "{name}: rows, columns, (x, y)");
        let known: Vec<f32> = flow.f32().into_iter().filter(|v| v.is_finite()).collect();
        assert!(known.len() > 48 * 64, "{name}: {} known", known.len());
        assert!(known.iter().all(|v| v.abs() < 8.0), "{name}: a frame later");
        assert!(
            known.iter().any(|v| v.abs() > 0.01),
            "{name}: the camera moves"
        );
    }
}

#[test]
fn scenes_are_the_same_on_any_number_of_threads() {
    let bench = Bench::empty();
    for threads in ["1", "3"] {
        let size = [
            "--size", "64x48", "--frames", "2", "--noise", "--flow", "--quiet",
        ];
        let out = bench.path(threads);
        garad(
            ["synth", "crowd", "-o", arg(&out), "--threads", threads]
                .iter()
                .chain(&size),
        )
        .succeeds();
    }
    let mut files = vec![
        "rgb.txt".to_owned(),
        "groundtruth.txt".to_owned(),
        "camera.txt".to_owned(),
    ];
    files.push("flow/0.000000.npy".to_owned());
    for folder in ["rgb", "depth", "mask"] {
        files.push(format!("{folder}/0.033333.png"));
    }
    for file in files {
        let read = |threads: &str| fs::read(bench.path(threads).join(&file)).expect("a file");
        assert!(read("1") == read("3"), "{file} differs");
    }
}

/// The same camera path, and no moving objects.
#[test]
fn the_twin_without_movers() {
    let bench = Bench::empty();
    let twin = bench.path("twin");
    let size = [
        "--size",
        "160x120",
        "--frames",
        "12",
        "--static-twin",
        "--quiet",
    ];
    garad(["synth", "walking", "-o", arg(&twin)].iter().chain(&size)).succeeds();
    let read = |folder: &std::path::Path| fs::read(folder.join("groundtruth.txt")).expect("poses");
    assert!(
        read(&twin) == read(walking()),
        "the camera moves the same way"
    );
    let mask = image::open(twin.join("mask/0.000000.png"))
        .expect("a mask")
        .to_luma8();
    assert!(mask.iter().all(|v| *v == 0), "nothing moves");
}
