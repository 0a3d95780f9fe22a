//! `--config`: mistakes are reported with file and line; the written configuration reproduces the run.

use std::fs;

use crate::support::{Bench, arg, assert_same_results, run_into, short};

#[test]
fn mistakes_are_reported_with_their_line() {
    let bench = Bench::empty();
    let file = bench.path("settings.toml");
    let cases: &[(&str, &[&str])] = &[
        (
            "[tracking]\nbff = 40.0\n",
            &["settings.toml:2: ", "unknown field `bff`"],
        ),
        (
            "\n[tracker]\n",
            &["settings.toml:2: ", "unknown field `tracker`"],
        ),
        (
            "[features]\ncount = \"many\"\n",
            &["settings.toml:2: ", "invalid type"],
        ),
        ("[features]\n\ncount = -5\n", &["settings.toml:3: ", "-5"]),
        (
            "[features]\ncount = 0\n",
            &["settings.toml: ", "features.count = 0", "expected"],
        ),
        (
            "[features]\nscale = nan\n",
            &["settings.toml: ", "features.scale", "expected"],
        ),
        ("[features\n", &["settings.toml:1: "]),
    ];
    for (text, words) in cases {
        fs::write(&file, text).expect("written");
        let answer = run_into(short(), &bench.out(), &["--config", arg(&file)]);
        let answer = answer.fails_at_last_with(words);
        assert_eq!(answer.err.lines().count(), 1, "one line: {answer:?}");
    }
    fs::write(&file, b"\xFF\xFE").expect("written");
    let answer = run_into(short(), &bench.out(), &["--config", arg(&file)]);
    answer.fails_with(&["settings.toml", "UTF-8"]);
    assert!(!bench.out().exists(), "nothing was run");
}

#[test]
fn the_written_configuration_gives_the_same_run() {
    let bench = Bench::empty();
    let file = bench.path("settings.toml");
    fs::write(&file, "[features]\ncount = 300\n").expect("written");
    run_into(short(), &bench.path("plain"), &[]).succeeds();
    run_into(short(), &bench.path("fewer"), &["--config", arg(&file)]).succeeds();
    for first in ["plain", "fewer"] {
        let used = bench.path(first).join("config.toml");
        run_into(short(), &bench.path("again"), &["--config", arg(&used)]).succeeds();
        assert_same_results(&bench.path(first), &bench.path("again"));
    }
    let trajectory = |name: &str| fs::read(bench.path(name).join("trajectory.txt")).expect("one");
    assert!(
        trajectory("plain") != trajectory("fewer"),
        "the file counts"
    );
}
