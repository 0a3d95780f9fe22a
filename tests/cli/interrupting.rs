//! Ctrl-C and SIGTERM: the results so far.
#![cfg(unix)]

use std::io::{BufRead as _, BufReader, Read as _};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use crate::support::{
    Answer, Bench, STABLE, arg, assert_same_results, files, frame_rows, long, metrics, program,
    run_into,
};

/// Starts the program and waits until it says `words` on stderr. With `GARAD_LOG=debug` it says something at each
/// keyframe.
fn started(args: &[&str], words: &str) -> (Child, BufReader<std::process::ChildStderr>) {
    let mut command = program();
    command.args(args).env("GARAD_LOG", "debug");
    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().expect("the program starts");
    let mut err = BufReader::new(child.stderr.take().expect("piped"));
    let mut line = String::new();
    while !line.contains(words) {
        line.clear();
        let n = err.read_line(&mut line).expect("text");
        assert!(n > 0, "it ended without `{words}`");
    }
    (child, err)
}

fn send(signal: &str, child: &Child) {
    let id = child.id().to_string();
    let sent = Command::new("kill").args(["-s", signal, &id]).status();
    assert!(sent.expect("kill starts").success(), "{signal} is sent");
}

fn ended((mut child, mut err): (Child, BufReader<std::process::ChildStderr>)) -> Answer {
    let (mut out, mut rest) = (String::new(), String::new());
    err.read_to_string(&mut rest).expect("text");
    let mut stdout = child.stdout.take().expect("piped");
    stdout.read_to_string(&mut out).expect("text");
    let code = child.wait().expect("it ends").code();
    Answer {
        code,
        out,
        err: rest,
    }
}

/// A run on [`long`], interrupted after its first keyframe.
fn interrupted(signal: &str, out: &Path, options: &[&str]) -> Answer {
    let args = [&["run", arg(long()), "-o", arg(out)], options].concat();
    let running = started(&args, "keyframe");
    send(signal, &running.0);
    let answer = ended(running);
    assert_eq!(answer.code, Some(130), "{answer:?}");
    assert!(!answer.err.contains("error"), "{answer:?}");
    answer
}

#[test]
fn the_results_so_far_and_a_session_are_written() {
    let bench = Bench::empty();
    let session = bench.path("session");
    let options = ["--save-session", arg(&session), "--refine", "2"];
    let answer = interrupted("INT", &bench.out(), &options);
    let n = frame_rows(&bench.out()).len();
    assert!((1..40).contains(&n), "{n} of 40 frames");
    let words = format!("interrupted after {n} of 40 frames; results so far are written");
    let last = answer.err.lines().last().unwrap_or_default();
    assert!(
        last.starts_with(&words) && last.contains("--resume"),
        "{answer:?}"
    );
    assert_eq!(metrics(&bench.out())["frames"], n, "the metrics so far");
    let trajectory = std::fs::read_to_string(bench.out().join("trajectory.txt")).expect("poses");
    let poses = trajectory.lines().filter(|line| !line.starts_with('#'));
    assert_eq!(poses.count(), n, "the path so far");
    for name in STABLE {
        assert!(bench.out().join(name).is_file(), "{name}");
    }

    let (resumed, whole) = (bench.path("resumed"), bench.path("whole"));
    run_into(
        long(),
        &resumed,
        &["--resume", arg(&session), "--refine", "2"],
    )
    .succeeds();
    run_into(long(), &whole, &["--refine", "2"]).succeeds();
    assert_same_results(&resumed, &whole);
    assert_eq!(frame_rows(&resumed), frame_rows(&whole), "all frames");
}

#[test]
fn without_a_session_it_says_how() {
    let bench = Bench::empty();
    let answer = interrupted("TERM", &bench.out(), &[]);
    let last = answer.err.lines().last().unwrap_or_default();
    assert!(last.contains("--save-session DIR"), "{answer:?}");
    assert!(!frame_rows(&bench.out()).is_empty(), "the frames so far");
    assert!(answer.out.contains("results in"), "{answer:?}");
}

#[test]
fn the_second_signal_ends_it_at_once() {
    let bench = Bench::empty();
    let out = bench.out();
    let args = ["run", arg(long()), "-o", arg(&out)];
    let running = started(&args, "keyframe");
    send("INT", &running.0);
    std::thread::sleep(Duration::from_millis(5));
    send("INT", &running.0);
    let answer = ended(running);
    assert_eq!(answer.code, Some(130), "{answer:?}");
    assert!(!answer.err.contains("are written"), "{answer:?}");
    assert!(!answer.out.contains("results in"), "{answer:?}");
}

#[test]
fn a_comparison_keeps_the_runs_that_are_complete() {
    let bench = Bench::empty();
    let out = bench.out();
    let profiles = "--profiles=orb_slam,default,nid_slam";
    let args = ["compare", arg(long()), profiles, "-o", arg(&out)];
    let first = started(&args, "orb_slam (1 of 3)");
    send("TERM", &first.0);
    let answer = ended(first);
    assert_eq!(answer.code, Some(130), "{answer:?}");
    assert!(answer.err.contains("nothing is written"), "{answer:?}");
    assert!(files(&out).is_empty(), "{:?}", files(&out));

    let second = started(&args, "default (2 of 3)");
    send("INT", &second.0);
    let answer = ended(second);
    assert_eq!(answer.code, Some(130), "{answer:?}");
    assert!(answer.err.contains("1 of 3 runs"), "{answer:?}");
    let table = std::fs::read_to_string(out.join("compare.md")).expect("a table");
    for words in ["40 of 40", " of 40 frames |", "not run: interrupted"] {
        assert!(table.contains(words), "`{words}` in {table}");
    }
    let written = files(&out);
    assert!(written.contains("orb_slam/trajectory.txt"), "{written:?}");
    let incomplete = |name: &String| name.starts_with("default") || name.starts_with("nid_slam");
    assert!(!written.iter().any(incomplete), "{written:?}");
}
