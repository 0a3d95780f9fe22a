//! Recordings that do not fit their calibration, and truth that does not fit the camera: said in one line.

use std::fs;

use crate::support::{Answer, Bench, arg, garad};

/// The camera of the recordings, 160x120 px, in other numbers.
fn with_camera(bench: &Bench, line: &str) -> Answer {
    bench.remove("camera.txt");
    fs::write(bench.path("cam.txt"), line).expect("written");
    let camera = bench.path("cam.txt");
    bench.run(&["--without", "mapping", "--calibration", arg(&camera)])
}

#[test]
fn cameras_that_cannot_be() {
    let bench = Bench::new();
    let text = bench.read("camera.txt");
    let numbers: Vec<&str> = text.lines().last().expect("a row").split(' ').collect();
    let [w, h, fx, fy, cx, cy, factor, fps] = numbers[..] else {
        panic!("{text}");
    };
    let line = |f: [&str; 4], lens: &str| {
        let [fx, fy, cx, cy] = f;
        format!("{w} {h} {fx} {fy} {cx} {cy} {factor} {fps} {lens}\n")
    };
    let warned = |camera: &str, words: &str| {
        let bench = Bench::new();
        let answer = with_camera(&bench, camera);
        assert!(answer.err.contains(words), "{words}: {answer:?}");
    };
    warned(
        &line([cx, cy, fx, fy], ""),
        "are fx fy and cx cy exchanged?",
    );
    warned(
        &line([fx, fy, cx, cy], "50 -95 0 0 116"),
        "the distortion moves pixels inwards",
    );
    let normalised = line(["0.825", "1.1", "0.5", "0.5"], "");
    with_camera(&bench, &normalised).fails_with(&["cam.txt", "field of view of 17", "in pixels"]);
    let bench = Bench::new();
    let folds = line([fx, fy, cx, cy], "-3 0 0 0 0");
    with_camera(&bench, &folds).fails_with(&[
        "cam.txt",
        "the distortion folds in",
        "k1 k2 p1 p2 k3",
    ]);
    assert!(
        !bench.out().join("metrics.json").exists(),
        "nothing was run"
    );
}

/// Millimetres read as fifths of a millimetre, and the other way round.
#[test]
fn depth_of_another_unit() {
    let bench = Bench::new();
    let answer = bench.run(&["--depth-factor", "20000", "--without", "mapping"]);
    for words in [
        "depth_factor 20000",
        "times shorter than the truth: is depth_factor right",
    ] {
        assert!(answer.err.contains(words), "{words}: {answer:?}");
    }
    let bench = Bench::new();
    let answer = bench.run(&["--depth-factor", "500", "--without", "mapping"]);
    let words = [
        "no frame could be tracked",
        "beyond the 8 m",
        "is depth_factor 500 right",
        "results are written",
    ];
    answer.fails_at_last_with(&words);
    assert!(bench.out().join("frames.csv").is_file(), "results");
    bench
        .run(&["--depth-factor", "0"])
        .fails_with(&["depth_factor is 0", "positive"]);
}

/// The reason, with its numbers.
#[test]
fn why_nothing_could_be_tracked() {
    let bench = Bench::new();
    let dark = image::RgbImage::new(160, 120);
    for line in bench
        .read("rgb.txt")
        .lines()
        .filter(|line| !line.starts_with('#'))
    {
        let file = line.split(' ').nth(1).expect("a file");
        dark.save(bench.rec().join(file)).expect("written");
    }
    let answer = bench.run(&["--without", "mapping"]);
    answer.fails_at_last_with(&[
        "no frame could be tracked",
        "0 corners or fewer",
        "dark, blurred",
    ]);

    let bench = Bench::new();
    let blank = image::ImageBuffer::<image::Luma<u16>, Vec<u16>>::new(160, 120);
    for line in bench
        .read("depth.txt")
        .lines()
        .filter(|line| !line.starts_with('#'))
    {
        let file = line.split(' ').nth(1).expect("a file");
        blank.save(bench.rec().join(file)).expect("written");
    }
    let answer = bench.run(&["--without", "mapping"]);
    answer.fails_at_last_with(&[
        "no frame could be tracked",
        "no depth in any of the first 6",
    ]);
}

#[test]
fn ground_truth_does_not_stop_a_run() {
    let bench = Bench::new();
    let text = bench.read("groundtruth.txt");
    let mut lines: Vec<&str> = text.lines().collect();
    lines.insert(3, lines[2]);
    lines[0] = lines[0].trim_start_matches(['#', ' ']);
    bench.write("groundtruth.txt", lines.join("\n"));
    let answer = bench.run(&["--without", "mapping"]);
    let warned = [
        "groundtruth.txt:1: ",
        "groundtruth.txt:4: ",
        "the line is left out",
    ];
    for words in warned {
        assert!(answer.err.contains(words), "{words}: {answer:?}");
    }
    assert!(
        answer.code == Some(0) && answer.out.contains("ATE [m]"),
        "{answer:?}"
    );
    bench
        .run(&["--strict"])
        .fails_with(&["groundtruth.txt:1: "]);
}

#[test]
fn lists_by_two_clocks() {
    let bench = Bench::new();
    let text = bench.read("depth.txt");
    let later = text.lines().map(|line| match line.split_once(' ') {
        Some((t, file)) if !line.starts_with('#') => {
            format!("{:.6} {file}\n", t.parse::<f64>().expect("a time") + 0.5)
        }
        _ => format!("{line}\n"),
    });
    bench.write("depth.txt", later.collect::<String>());
    bench
        .run(&[])
        .fails_with(&["--max-dt SECONDS", "--depth-offset SECONDS"]);
    let aligned = ["--depth-offset", "-0.5", "--without", "mapping"];
    let answer = bench.run(&aligned).succeeds();
    assert!(answer.out.contains("6 of 6 frames"), "{answer:?}");
    bench.run(&["--max-dt=-1"]).fails_with(&["max_dt_s is -1"]);
    let wide = ["--max-dt", "0.6", "--without", "mapping"];
    bench.run(&wide).succeeds();
}

#[test]
fn names_from_windows_and_reasons_said_once() {
    let bench = Bench::new();
    for list in ["rgb.txt", "depth.txt"] {
        bench.write(list, bench.read(list).replace('/', "\\"));
    }
    let answer = bench.run(&["--without", "mapping"]).succeeds();
    assert!(answer.out.contains("6 of 6 frames"), "{answer:?}");
    bench.replace("rgb.txt", "rgb\\", "..\\rgb\\");
    bench.run(&[]).fails_with(&["rgb.txt:", "without `..`"]);

    let answer = with_camera(&Bench::new(), "160 120 131 -131 80 60 5000 30\n");
    let answer = answer.fails_with(&["cam.txt:1: camera fy is -131"]);
    assert_eq!(answer.err.matches("camera fy").count(), 1, "{answer:?}");
    let bench = Bench::new();
    let (truth, folder) = (bench.rec().join("groundtruth.txt"), bench.rec().join("rgb"));
    let answer = garad(["eval", "trajectory", arg(&truth), arg(&folder)]);
    answer.fails_with(&["rgb: is a folder", "expected a trajectory"]);
}
