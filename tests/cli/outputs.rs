//! What the program writes is one set of whole files, in a folder that was tried before the work.

use std::collections::BTreeSet;
use std::fs;

use crate::support::{
    Bench, answer, arg, files, frame_rows, garad, metrics, program, run_into, short, walking,
    walking_on,
};

#[test]
fn a_second_run_leaves_nothing_of_the_first() {
    let bench = Bench::empty();
    let less = ["--without", "mapping", "--without", "crf"];
    let (out, fresh) = (bench.out(), bench.path("fresh"));
    run_into(walking_on(), &out, &["--refine", "1"]).succeeds();
    let first = files(&out);
    for name in ["labels/keypoints.csv", "labels/masks/000011.png", "map.ply"] {
        assert!(first.contains(name), "{name}: {first:?}");
    }
    fs::write(out.join("labels/notes.txt"), "mine").expect("written");
    // A run that fails before it has results leaves those that are there.
    run_into(&bench.rec(), &out, &less).fails_with(&["rec"]);
    assert!(files(&out).is_superset(&first), "as they were");
    run_into(short(), &fresh, &less).succeeds();
    run_into(short(), &out, &less).succeeds();
    let mut expected = files(&fresh);
    assert!(!expected.contains("labels/keypoints.csv"), "{expected:?}");
    expected.insert("labels/notes.txt".to_owned());
    assert_eq!(files(&out), expected, "the second run's files and mine");
}

#[test]
fn a_second_scene_leaves_nothing_of_the_first() {
    let bench = Bench::empty();
    let synth = |name: &str, scene: &str, options: &[&str]| {
        let out = bench.path(name);
        let size = ["--size", "64x48", "--quiet"];
        garad(
            ["synth", scene, "-o", arg(&out)]
                .iter()
                .chain(&size)
                .chain(options),
        )
        .succeeds();
        files(&out)
    };
    let first = synth("out", "walking", &["--frames", "3", "--flow"]);
    assert!(first.contains("flow/0.000000.npy"), "{first:?}");
    fs::write(bench.out().join("mask/notes.txt"), "mine").expect("written");
    let options = ["--frames", "2", "--fps", "10"];
    let mut expected = synth("fresh", "quiet_desk", &options);
    expected.insert("mask/notes.txt".to_owned());
    assert_eq!(synth("out", "quiet_desk", &options), expected, "one scene");
    // A run into the folder of its recording does not take the recording for results.
    run_into(&bench.out(), &bench.out(), &[]);
    run_into(&bench.out(), &bench.out(), &[]);
    let after = files(&bench.out());
    assert!(expected.is_subset(&after), "{after:?}");
}

/// No permission needs to be missing for this: nobody can write into that folder.
#[cfg(target_os = "linux")]
#[test]
fn a_folder_that_cannot_be_written_is_found_before_the_work() {
    let rec = arg(walking());
    let bench = Bench::empty();
    run_into(short(), &bench.out(), &["--max-frames", "1"]).succeeds();
    let map = bench.out().join("map.ply");
    let pose = "0 0 0 0 0 0 1";
    let commands = [
        &["run", rec][..],
        &["compare", rec],
        &["ablate", rec],
        &["demo"],
        &["synth", "hall"],
        &["trace", rec, "--frames", "0..3"],
        &["render", arg(&map), "--preset", "bonn", "--pose", pose],
    ];
    for command in commands {
        for (folder, words) in [
            ("/proc/self", "/proc/self: cannot write into the folder"),
            ("/proc/self/new", "/proc/self/new: cannot make the folder"),
        ] {
            let answer = garad([command, &["-o", folder, "--quiet"]].concat());
            let answer = answer.fails_with(&[words]);
            assert!(answer.out.is_empty(), "{answer:?}");
            assert_eq!(answer.err.lines().count(), 1, "nothing else: {answer:?}");
        }
    }
    let options = ["--save-session", "/proc/self/new"];
    let answer = run_into(walking(), &bench.path("unused"), &options);
    answer.fails_with(&["/proc/self/new: cannot make the folder"]);
}

/// A limit on the size of files does what a full disk does, for the large files alone.
#[cfg(unix)]
#[test]
fn files_that_cannot_be_written_are_all_named() {
    let bench = Bench::empty();
    let out = bench.out();
    run_into(walking(), &out, &[]).succeeds();
    let all = files(&out);
    let limited = |args: &[&str]| {
        let mut shell = std::process::Command::new("sh");
        shell.args(["-c", "ulimit -f 64; exec \"$0\" \"$@\""]);
        answer(shell.arg(program().get_program()).args(args).arg("--quiet"))
    };
    let answer = limited(&["run", arg(walking()), "-o", arg(&out)]);
    let answer = answer.fails_with(&["out: ", "files cannot be written: map.ply, "]);
    assert!(answer.out.contains("tracked    12 of 12"), "{answer:?}");
    let left = files(&out);
    assert!(left.is_subset(&all), "no temporary file: {left:?}");
    assert!(left.contains("trajectory.txt"), "{left:?}");
    let missing: Vec<_> = all.difference(&left).collect();
    assert!(missing.len() > 2, "{missing:?}");
    for name in missing {
        assert!(answer.err.contains(name.as_str()), "{name}: {answer:?}");
    }
    for name in left.iter().filter(|name| name.ends_with(".png")) {
        image::open(out.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
    }
    // A recording without its lists is none.
    let scene = bench.path("scene");
    let answer = limited(&["synth", "walking", "--noise", "-o", arg(&scene)]);
    answer.fails_with(&["rgb/0.000000.png", "depth/0.000000.png"]);
    let expected = ["garad_files.txt", "mask/0.000000.png"].map(str::to_owned);
    assert_eq!(files(&scene), BTreeSet::from(expected), "the first frame");
}

#[test]
fn every_run_has_a_row_per_frame() {
    let bench = Bench::empty();
    let file = bench.path("never.toml");
    fs::write(&file, "[keyframes]\nfirst_min_keypoints = 100000\n").expect("written");
    let answer = bench.run_on(short(), &["--config", arg(&file)]);
    answer.fails_with(&["no frame could be tracked", "results are written"]);
    let rows = frame_rows(&bench.out());
    assert_eq!(rows.len(), 6, "{rows:?}");
    for (i, row) in rows.iter().enumerate() {
        assert_eq!(row[0], i.to_string(), "{row:?}");
        assert_ne!(row[2], "tracking", "{row:?}");
        assert_eq!([&row[5], &row[6]], ["0", ""], "{row:?}");
        assert!(row[3].parse::<usize>().expect("keypoints") > 0, "{row:?}");
    }
    assert_eq!(metrics(&bench.out())["tracked"], 0, "none");
    // Frames that cannot be read have no row.
    bench
        .run_on(short(), &["--oracle-labels", "rgb"])
        .fails_with(&["all 6 frames were skipped", "results are written"]);
    assert_eq!(frame_rows(&bench.out()).len(), 0, "none");
}
