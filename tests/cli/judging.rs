//! `garad eval trajectory` on trajectories with known errors.

use std::fs;

use serde_json::Value;

use crate::support::{Bench, arg, garad, long};

/// Poses without rotation, one every 0.5 s.
fn path(positions: &[[f64; 3]]) -> String {
    let mut text = "# timestamp tx ty tz qx qy qz qw\n".to_owned();
    for (i, [x, y, z]) in positions.iter().enumerate() {
        text += &format!("{}.{} {x} {y} {z} 0 0 0 1\n", i / 2, 5 * (i % 2));
    }
    text
}

/// A path with bends, so that its alignment is unique.
const TRUTH: [[f64; 3]; 5] = [
    [0.0, 0.0, 0.0],
    [1.0, 0.0, 0.0],
    [1.0, 1.0, 0.0],
    [1.0, 1.0, 1.0],
    [2.0, 1.0, 1.0],
];

fn judge(bench: &Bench, options: &[&str]) -> Value {
    let (truth, estimate) = (bench.path("truth.txt"), bench.path("estimate.txt"));
    let files = ["eval", "trajectory", arg(&truth), arg(&estimate), "--json"];
    let answer = garad(files.iter().chain(options)).succeeds();
    serde_json::from_str(&answer.out).expect("JSON and nothing else")
}

fn bench_with(estimate: &str) -> Bench {
    let bench = Bench::empty();
    fs::write(bench.path("truth.txt"), path(&TRUTH)).expect("written");
    fs::write(bench.path("estimate.txt"), estimate).expect("written");
    bench
}

#[track_caller]
fn assert_close(value: &Value, expected: f64) {
    let value = value.as_f64().expect("a number");
    assert!(
        (value - expected).abs() < 1e-9,
        "{value}, expected {expected}"
    );
}

/// All numbers are finite (JSON has no NaN: it would be null).
fn assert_no_null(value: &Value) {
    match value {
        Value::Object(map) => map.values().for_each(assert_no_null),
        other => assert!(!other.is_null(), "null in the figures"),
    }
}

#[test]
fn a_path_against_itself() {
    let truth = long().join("groundtruth.txt");
    let answer = garad(["eval", "trajectory", arg(&truth), arg(&truth)]).succeeds();
    for line in [
        "ATE [m]    rmse 0.000000  mean 0.000000",
        "40 pairs",
        "per 1 s",
        "jitter [mm]  rms ",
    ] {
        assert!(answer.out.contains(line), "`{line}`: {answer:?}");
    }
    let answer = garad(["eval", "trajectory", arg(&truth), arg(&truth), "--json"]).succeeds();
    let figures: Value = serde_json::from_str(&answer.out).expect("JSON");
    assert_no_null(&figures);
    for figure in ["rmse", "mean", "median", "std", "min", "max"] {
        assert_close(&figures["ate"][figure], 0.0);
        assert_close(&figures["rpe"]["trans_m"][figure], 0.0);
    }
    assert_eq!(figures["ate"]["pairs"], 40, "{figures}");
    assert_eq!(figures["jitter"]["triples"], 38, "{figures}");
    assert_eq!(
        figures["jitter"]["rms_m"], figures["jitter"]["ground_truth_rms_m"],
        "one path"
    );
    // A second lies between frames 0 and 30, ..., 9 and 39; intervals do not overlap.
    assert!(
        figures["rpe"]["trans_m"]["pairs"].as_u64() >= Some(1),
        "{figures}"
    );
}

#[test]
fn alignment_removes_motion_and_scale() {
    let moved = TRUTH.map(|[x, y, z]| [x + 3.0, y, z - 4.0]);
    let bench = bench_with(&path(&moved));
    assert_close(&judge(&bench, &["--align", "none"])["ate"]["rmse"], 5.0);
    assert_close(&judge(&bench, &["--align", "rigid"])["ate"]["rmse"], 0.0);
    assert_close(&judge(&bench, &[])["rpe"]["trans_m"]["max"], 0.0);

    let larger = TRUTH.map(|p| p.map(|v| 2.0 * v));
    let bench = bench_with(&path(&larger));
    assert_close(&judge(&bench, &["--align", "sim3"])["ate"]["rmse"], 0.0);
    let rigid = judge(&bench, &[]);
    assert!(rigid["ate"]["rmse"].as_f64() > Some(0.5), "{rigid}");
    // Steps of 1 m, each round a corner: sqrt(2) m, and twice that in the larger one.
    assert_close(&rigid["jitter"]["ground_truth_rms_m"], 2f64.sqrt());
    assert_close(&rigid["jitter"]["rms_m"], 8f64.sqrt());
    // Twice as fast: in 1 s (two steps of 1 m round a corner) too far by sqrt(2) m.
    assert_close(&rigid["rpe"]["trans_m"]["min"], 2f64.sqrt());
    assert!(
        rigid["protocol"]
            .as_str()
            .is_some_and(|p| p.contains("rigid")),
        "{rigid}"
    );
}

/// Poses after 0, 0.5 and 2 s: no step is close to the median of 1 s.
#[test]
fn jitter_that_cannot_be_judged_is_left_out_with_the_reason() {
    let text = path(&TRUTH);
    let lines = text.lines().enumerate();
    let uneven: Vec<_> = lines.filter(|(i, _)| [1, 2, 5].contains(i)).collect();
    let uneven: String = uneven.iter().map(|(_, line)| format!("{line}\n")).collect();
    let bench = bench_with(&uneven);
    let files = [bench.path("truth.txt"), bench.path("estimate.txt")];
    let answer = garad(["eval", "trajectory", arg(&files[0]), arg(&files[1])]).succeeds();
    let words = "jitter     cannot be judged: 0 triples of frames at equal time steps";
    assert!(answer.out.contains(words), "{answer:?}");
    assert!(judge(&bench, &[])["jitter"].is_null(), "no figure");
}

#[test]
fn a_plot_on_request() {
    let bench = bench_with(&path(&TRUTH));
    let plot = bench.path("plot.svg");
    judge(&bench, &["--plot", arg(&plot)]);
    let svg = fs::read_to_string(&plot).expect("a plot");
    assert!(
        svg.trim_start().starts_with("<svg") || svg.contains("<svg "),
        "{svg}"
    );
}

#[test]
fn bad_trajectories_are_reported() {
    let good = path(&TRUTH);
    let cases = [
        (
            good.replace("1.0 1 1 0 ", "1.0 1 one 0 "),
            &["estimate.txt:4: ", "\"one\""][..],
        ),
        (
            good.replace("0.5 ", "nan "),
            &["estimate.txt:3: ", "\"nan\""],
        ),
        (
            good.replace("1.5 ", "0.25 "),
            &["estimate.txt:5: ", "ascending"],
        ),
        (
            good.replace(" 0 0 0 1", " 0 0 0 3"),
            &["estimate.txt:2: ", "length 3"],
        ),
        (
            "garbage\n".to_owned(),
            &["estimate.txt:1: ", "1 columns", "timestamp tx ty tz"],
        ),
        ("# nothing\n".to_owned(), &["estimate.txt: holds no pose"]),
        (
            path(&TRUTH[..2]),
            &["estimate.txt", "2 points", "at least 3"],
        ),
        (
            "90 0 0 0 0 0 0 1\n".to_owned(),
            &["estimate.txt", "no pair of poses within 0.02 s"],
        ),
    ];
    for (estimate, words) in cases {
        let bench = bench_with(&estimate);
        let files = [bench.path("truth.txt"), bench.path("estimate.txt")];
        let answer = garad(["eval", "trajectory", arg(&files[0]), arg(&files[1])]);
        answer.fails_at_last_with(words);
    }
    let bench = bench_with(&good);
    let files = [bench.path("truth.txt"), bench.path("none.txt")];
    let command = ["eval", "trajectory", arg(&files[0]), arg(&files[1])];
    garad(command).fails_with(&["none.txt: not found"]);
    let command = ["eval", "trajectory", arg(&files[1]), arg(&files[0])];
    garad(command).fails_with(&["none.txt: not found"]);
    let command = [
        "eval",
        "trajectory",
        arg(&files[0]),
        arg(&files[0]),
        "--max-dt",
        "NaN",
    ];
    garad(command).fails_with(&["max_dt", "NaN"]);
}

/// A similarity prints its scale, and refuses a reference that says nothing of it.
#[test]
fn the_scale_of_a_similarity() {
    let halved = TRUTH.map(|p| p.map(|v| 0.5 * v));
    let bench = bench_with(&path(&halved));
    let (truth, estimate) = (bench.path("truth.txt"), bench.path("estimate.txt"));
    let sim3 = [
        "eval",
        "trajectory",
        arg(&truth),
        arg(&estimate),
        "--align",
        "sim3",
    ];
    let answer = garad(sim3).succeeds();
    assert!(answer.out.contains("scale      2.000000"), "{answer:?}");
    assert!(!answer.out.contains("uncertain"), "{answer:?}");
    assert_close(&judge(&bench, &["--align", "sim3"])["scale"], 2.0);
    assert_close(&judge(&bench, &[])["scale"], 1.0);

    fs::write(&truth, path(&[[1.0, 2.0, 3.0]; 5])).expect("written");
    garad(sim3).fails_with(&["estimate.txt against", "scale is undetermined"]);
    // A reference that trembles at rest.
    let tremble = [
        [0.0, 0.0, 0.0],
        [1e-4, 0.0, 0.0],
        [0.0, 1e-4, 0.0],
        [1e-4, 0.0, 1e-4],
        [0.0; 3],
    ];
    fs::write(&truth, path(&tremble)).expect("written");
    let answer = garad(sim3).succeeds();
    assert!(answer.out.contains("uncertain"), "{answer:?}");
}
