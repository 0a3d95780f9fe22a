//! Commands, options and streams.

use std::process::Stdio;

use crate::support::{Bench, arg, garad, program, short};

const COMMANDS: [&str; 10] = [
    "demo", "run", "compare", "ablate", "profiles", "eval", "render", "synth", "golden", "trace",
];

#[test]
fn help_and_version() {
    let help = garad(["--help"]).succeeds().out;
    for command in COMMANDS {
        assert!(help.contains(command), "{command} is not in: {help}");
        let help = garad([command, "--help"]).succeeds().out;
        assert!(help.contains(&format!("garad {command}")), "{help}");
    }
    let version = garad(["--version"]).succeeds().out;
    assert_eq!(version.trim(), concat!("garad ", env!("CARGO_PKG_VERSION")));
}

#[test]
fn mistakes_in_a_command_are_reported() {
    let bench = Bench::empty();
    let (rec, out) = (arg(short()).to_owned(), bench.out());
    let out = arg(&out);
    let cases: &[(&[&str], &[&str])] = &[
        (&["frobnicate"], &["frobnicate"]),
        (&["run"], &["required arguments"]),
        (
            &["run", &rec, "--preset", "kinect"],
            &["kinect", "freiburg1", "bonn"],
        ),
        (&["run", &rec, "--threads", "0"], &["--threads", "1..=256"]),
        (
            &["run", &rec, "--threads", "100000"],
            &["--threads", "1..=256"],
        ),
        (
            &["run", &rec, "--max-frames", "0"],
            &["max_frames", "at least 1"],
        ),
        (
            &["run", &rec, "--first-frame", "6"],
            &["frame 6", "6 frames"],
        ),
        (&["run", &rec, "--ground-truth", "camera"], &["BONN"]),
        (
            &["run", &rec, "--oracle-labels", "masks"],
            &["masks: no such folder"],
        ),
        (
            &["run", &rec, "--calibration", "none.txt"],
            &["none.txt: not found"],
        ),
        (&["run", &rec, "--config", "none.toml"], &["none.toml"]),
        (&["synth", "attic", "-o", out], &["attic", "quiet_desk"]),
        (
            &["synth", "loop", "-o", out, "--size", "5"],
            &["`5`", "640x480"],
        ),
        (
            &["synth", "loop", "-o", out, "--size", "0x9"],
            &["0x9", "8 to 8192"],
        ),
        (
            &["synth", "loop", "-o", out, "--frames", "0"],
            &["0 frames", "at least 1"],
        ),
        (
            &["synth", "loop", "-o", out, "--fps", "NaN"],
            &["NaN frames per second"],
        ),
        (
            &["synth", "loop", "-o", out, "--fps", "1e9"],
            &["1000000000", "at most 100000"],
        ),
        (
            &["demo", "--frames", "0", "-o", out],
            &["0 frames", "at least 1"],
        ),
    ];
    for (command, words) in cases {
        garad(*command).fails_with(words);
    }
    assert!(!bench.out().exists(), "nothing was written");
}

/// `garad ... 2>&1 | head` closes both streams; results are written all the same.
#[test]
fn closed_streams_are_ignored() {
    let bench = Bench::new();
    let mut child = program()
        .args(["run", arg(&bench.rec()), "-o", arg(&bench.out())])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    drop(child.stdout.take());
    drop(child.stderr.take());
    let status = child.wait().expect("the program ends");
    assert_eq!(status.code(), Some(0), "no reader, no error");
    assert!(bench.out().join("report.html").is_file(), "results");
}

/// An unwritable folder is reported before the work.
#[test]
fn a_file_in_the_way_of_the_results() {
    let bench = Bench::new();
    let (rec, file) = (bench.rec(), bench.path("file"));
    std::fs::write(&file, "precious").expect("written");
    for out in [file.clone(), file.join("below")] {
        let run = ["run", arg(&rec), "-o", arg(&out)];
        let synth = ["synth", "loop", "--frames", "1", "-o", arg(&out)];
        let demo = ["demo", "--frames", "1", "-o", arg(&out)];
        for command in [&run[..], &synth, &demo] {
            let answer = garad(command).fails_at_last_with(&[arg(&out), "cannot make the folder"]);
            let worked = answer.err.contains("tracking") || answer.err.contains("drawing");
            assert!(!worked, "before the work: {answer:?}");
        }
    }
    let kept = std::fs::read_to_string(&file).expect("still there");
    assert_eq!(kept, "precious", "the file in the way");
}
