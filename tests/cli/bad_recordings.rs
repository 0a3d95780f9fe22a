//! Invalid recordings, lists and cameras.

use std::fs;

use crate::support::{Bench, arg, assert_same_results, garad, metrics, run_into, short};

#[test]
fn other_files_are_refused() {
    let bench = Bench::new();
    garad(["run", arg(&bench.path("nowhere"))]).fails_with(&["nowhere: not found", "expected"]);
    fs::create_dir(bench.path("empty")).expect("made");
    let answer = garad(["run", arg(&bench.path("empty"))]);
    answer.fails_with(&["empty: a folder without rgb.txt", "expected"]);
    let image = bench.rec().join("rgb/0.000000.png");
    garad(["run", arg(&image)]).fails_with(&["0.000000.png", "neither gzip, zip nor tar"]);
    bench.remove("rgb.txt");
    bench
        .run(&[])
        .fails_with(&["rec: a folder without rgb.txt"]);
    assert!(!bench.out().exists(), "nothing to write, nothing written");
}

/// A name may contain control characters; the error is still one line.
#[cfg(unix)]
#[test]
fn names_do_not_break_lines() {
    let bench = Bench::empty();
    let answer = garad(["run", arg(&bench.path("two\nlines\u{1b}[31m"))]);
    let answer = answer.fails_at_last_with(&["two\\nlines\\u{1b}[31m: not found"]);
    assert_eq!(answer.err.lines().count(), 1, "{answer:?}");
}

/// Each message has file, line and what was expected.
#[test]
fn bad_lists_are_reported() {
    let cases = [
        ("rgb.txt", "", "", &["rgb.txt: lists no image"][..]),
        (
            "rgb.txt",
            "0.066667 rgb/0.066667.png",
            "0.066667",
            &["rgb.txt:4: ", "timestamp filename"],
        ),
        (
            "depth.txt",
            "0.066667 ",
            "NaN ",
            &["depth.txt:4: ", "\"NaN\"", "a time in seconds"],
        ),
        ("rgb.txt", "0.066667 ", "-1 ", &["rgb.txt:4: ", "\"-1\""]),
        (
            "rgb.txt",
            "rgb/0.066667",
            "../rgb/0.066667",
            &["rgb.txt:4", "../rgb/0.066667.png", "a relative path"],
        ),
        (
            "depth.txt",
            "depth/0.1",
            "/depth/0.1",
            &["depth.txt:", "a relative path"],
        ),
    ];
    for (file, from, to, words) in cases {
        let bench = Bench::new();
        if from.is_empty() {
            bench.write(file, "# timestamp filename\n");
        } else {
            bench.replace(file, from, to);
        }
        bench.run(&[]).fails_with(words);
        assert!(!bench.out().exists(), "{words:?}: nothing written");
    }
    let bench = Bench::new();
    bench.write("rgb.txt", b"0.0 rgb/\xFF.png\n");
    bench.run(&[]).fails_with(&["rgb.txt:1: ", "UTF-8"]);
}

#[test]
fn times_out_of_order_are_sorted_or_refused() {
    let sorted = Bench::empty();
    run_into(short(), &sorted.out(), &[]).succeeds();
    let bench = Bench::new();
    let list = bench.read("rgb.txt");
    let mut lines: Vec<&str> = list.lines().collect();
    lines.swap(3, 4);
    bench.write("rgb.txt", lines.join("\n"));
    let answer = bench.run(&[]).succeeds();
    assert!(
        answer.err.contains("rgb.txt:5: time goes back"),
        "{answer:?}"
    );
    assert_same_results(&sorted.out(), &bench.out());
    let words = ["rgb.txt:5: ", "0.066667 after 0.1", "ascending times"];
    bench.run(&["--strict"]).fails_with(&words);

    bench.write("rgb.txt", format!("{list}0.166667 rgb/0.000000.png\n"));
    let answer = bench.run(&[]).succeeds();
    assert!(
        answer.err.contains("rgb.txt:8: time of an earlier line"),
        "{answer:?}"
    );
    assert_same_results(&sorted.out(), &bench.out());
    bench.run(&["--strict"]).fails_with(&["rgb.txt:8: "]);
}

#[test]
fn colour_without_depth_is_dropped_or_refused() {
    let bench = Bench::new();
    bench.replace("depth.txt", "0.066667 depth/0.066667.png\n", "");
    let answer = bench.run(&[]).succeeds();
    let words = "1 of 6 colour images have no depth image";
    assert!(answer.err.contains(words), "{answer:?}");
    assert!(
        answer.out.contains("tracked    5 of 6 frames listed"),
        "{answer:?}"
    );
    let why = "1 without a depth image within 20 ms";
    assert!(
        answer.out.contains(&format!("left out   {why}\n")),
        "{answer:?}"
    );
    let figures = metrics(&bench.out());
    for (key, frames) in [("listed", 6), ("frames", 5), ("tracked", 5)] {
        assert_eq!(figures[key], frames, "{figures}");
    }
    let report = fs::read_to_string(bench.out().join("report.html")).expect("a report");
    assert!(report.contains(words), "in the report");
    let card = format!("5 of 6 frames listed · {why}");
    assert!(report.contains(&card), "in the report");
    bench.write("depth.txt", "7 depth/0.000000.png\n");
    bench
        .run(&[])
        .fails_with(&["rec: none of 6 colour images", "6.833333 s apart"]);
}

#[test]
fn invalid_cameras_are_reported() {
    let row = "160 120 131.25 131.25 80.1875 58.625 5000 30";
    let cases = [
        (
            "160 120 131.25 NaN 80.1875 58.625 5000 30",
            &["\"NaN\"", "a finite number"][..],
        ),
        ("160 120 131.25 0 80.1875 58.625 5000 30", &["fy"]),
        ("160 120 131.25 131.25 80.1875", &["numbers"]),
        (
            "160 120 131.25 131.25 80.1875 58.625 0 30",
            &["depth_factor"],
        ),
        ("-160 120 131.25 131.25 80.1875 58.625 5000 30", &["-160"]),
        ("focal = 3", &["focal"]),
    ];
    for (camera, words) in cases {
        let bench = Bench::new();
        bench.replace("camera.txt", row, camera);
        let answer = bench.run(&[]).fails_with(&["camera.txt:2: "]);
        answer.fails_with(words);
    }
    let bench = Bench::new();
    bench.replace("camera.txt", "160 120", "640 480");
    let words = [
        "frame 0: ",
        "0.000000.png: 160x120",
        "640x480",
        "camera.txt",
    ];
    bench.run(&[]).fails_with(&words);
    bench
        .run(&["--preset", "fr1"])
        .fails_with(&["160x120", "640x480", "preset freiburg1"]);
    bench.remove("camera.txt");
    bench
        .run(&[])
        .fails_with(&["rec: camera unknown", "freiburg3"]);
}

#[test]
fn ground_truth_is_read_as_far_as_it_goes() {
    let bench = Bench::new();
    let text = bench.read("groundtruth.txt");
    let line = text.lines().nth(3).expect("a third pose");
    bench.replace("groundtruth.txt", line, "0.066667 garbage");
    let words = ["groundtruth.txt:4: ", "2 columns", "timestamp tx ty tz"];
    let answer = bench.run(&[]).succeeds();
    assert!(
        words.iter().all(|w| answer.err.contains(w)) && answer.out.contains("(5 pairs)"),
        "{answer:?}"
    );
    bench.run(&["--strict"]).fails_with(&words);
    bench.write("groundtruth.txt", "# no pose\n");
    let answer = bench.run(&[]).succeeds();
    assert!(
        answer.err.contains("groundtruth.txt: holds no pose"),
        "{answer:?}"
    );
}

/// An absurd rate leads to numbers that are not finite: the map is not written, which is the error;
/// everything else is written.
#[test]
fn an_invalid_map_does_not_prevent_other_results() {
    let bench = Bench::new();
    let config = bench.path("config.toml");
    fs::write(&config, "[train.rates]\nmean = 1e300\n").expect("written");
    let words = ["map.ply: not written", "not finite"];
    let answer = bench.run(&["--config", arg(&config)]);
    answer.fails_at_last_with(&words);
    assert!(!bench.out().join("map.ply").exists(), "no map");
    for name in [
        "trajectory.txt",
        "keyframes.txt",
        "config.toml",
        "metrics.json",
        "report.html",
    ] {
        assert!(bench.out().join(name).is_file(), "{name}");
    }
}
