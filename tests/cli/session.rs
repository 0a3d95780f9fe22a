//! Runs saved and resumed, tracking in a finished map, and messages about invalid sessions.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use garad_slam::session::FORMAT;

use crate::support::{
    Answer, Bench, arg, assert_same_results, copy, long, metrics, recording, run_into, short,
    walking,
};

/// The same results and labels.
#[track_caller]
fn assert_same_run(a: &Path, b: &Path) {
    assert_same_results(a, b);
    for name in [
        "labels/keypoints.csv",
        "labels/gaussians.csv",
        "labels/gaussians.ply",
    ] {
        let read = |folder: &Path| fs::read(folder.join(name)).expect("a result");
        assert!(read(a) == read(b), "{name} differs");
    }
}

/// A session after the first eleven frames of [`walking`]: a folder to copy from.
fn saved() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("session");
        let (out, session) = (folder.join("out"), folder.join("session"));
        if session.exists() {
            fs::remove_dir_all(&session).expect("that of an earlier test is removed");
        }
        let options = [
            "--max-frames",
            "11",
            "--threads",
            "2",
            "--save-session",
            arg(&session),
        ];
        run_into(walking(), &out, &options).succeeds();
        session
    })
}

fn state(session: &Path) -> PathBuf {
    ["state-a.bin", "state-b.bin"]
        .map(|name| session.join(name))
        .into_iter()
        .find(|path| path.exists())
        .expect("a state")
}

/// `garad run --resume` of [`walking`] from a session, with options.
fn resume(bench: &Bench, session: &Path, options: &[&str]) -> Answer {
    let options: Vec<_> = ["--resume", arg(session)]
        .iter()
        .chain(options)
        .copied()
        .collect();
    bench.run_on(walking(), &options)
}

/// Another calibration for images of the size of [`walking`].
fn other_lens(bench: &Bench) -> PathBuf {
    let path = bench.path("lens.txt");
    fs::write(&path, "160 120 99 99 80 60 5000 30\n").expect("written");
    path
}

/// A copy of [`saved`] to be damaged.
fn own(bench: &Bench) -> PathBuf {
    let session = bench.path("session");
    copy(saved(), &session);
    session
}

#[test]
fn a_resumed_run_equals_an_uninterrupted_run() {
    let bench = Bench::empty();
    let whole = bench.path("whole");
    run_into(walking(), &whole, &["--refine", "5"]).succeeds();
    for threads in ["1", "2"] {
        resume(&bench, saved(), &["--refine", "5", "--threads", threads]).succeeds();
        assert_same_run(&whole, &bench.out());
        let figures = metrics(&bench.out());
        assert_eq!(figures["frames"], 12, "those of the first part count");
        assert_eq!(
            figures["labels"],
            metrics(&whole)["labels"],
            "and are judged"
        );
    }
}

#[test]
fn oracle_masks_must_be_given_again() {
    let bench = Bench::empty();
    let (whole, session) = (bench.path("whole"), bench.path("session"));
    let masks = ["--oracle-labels", "mask"];
    run_into(walking(), &whole, &masks).succeeds();
    let part = ["--max-frames", "5", "--save-session", arg(&session)];
    run_into(
        walking(),
        &bench.path("part"),
        &[masks, [part[0], part[1]], [part[2], part[3]]].concat(),
    )
    .succeeds();
    resume(&bench, &session, &masks).succeeds();
    assert_same_results(&whole, &bench.out());
    resume(&bench, &session, &[]).fails_with(&["--oracle-labels", "with", "without"]);
}

#[test]
fn repeated_saves_keep_one_state() {
    let bench = Bench::empty();
    let (whole, session) = (bench.path("whole"), bench.path("session"));
    run_into(walking(), &whole, &[]).succeeds();
    let mut options = vec!["--save-session", arg(&session)];
    for frames in ["2", "5", "6", "12"] {
        let part = [&options[..], &["--max-frames", frames]].concat();
        let answer = bench.run_on(walking(), &part).succeeds();
        assert!(answer.out.contains("session in"), "{answer:?}");
        let files = fs::read_dir(&session).expect("a folder").count();
        assert_eq!(files, 2, "the older state is gone");
        options = vec!["--save-session", arg(&session), "--resume", arg(&session)];
    }
    assert_same_run(&whole, &bench.out());
    let header = fs::read_to_string(session.join("session.json")).expect("the header");
    let header: serde_json::Value = serde_json::from_str(&header).expect("JSON");
    assert_eq!(header["frames_done"], 12, "{header}");
    assert_eq!(header["recording"], "walking_12", "{header}");
    let keyframes = fs::read_to_string(whole.join("keyframes.txt")).expect("keyframes");
    let count = keyframes
        .lines()
        .filter(|line| !line.starts_with('#'))
        .count();
    assert_eq!(header["keyframes"], count, "{header}");
}

#[test]
fn skipped_frames_stay_skipped() {
    let bench = Bench::new();
    let (whole, session) = (bench.path("whole"), bench.path("session"));
    let depth = bench.read("depth.txt");
    let file = depth.lines().filter(|line| !line.starts_with('#')).nth(2);
    let file = file
        .and_then(|line| line.split_whitespace().nth(1))
        .expect("a file");
    bench.write(file, "no image");
    run_into(&bench.rec(), &whole, &[]).succeeds();
    bench
        .run(&["--max-frames", "4", "--save-session", arg(&session)])
        .succeeds();
    bench.run(&["--resume", arg(&session)]).succeeds();
    assert_same_results(&whole, &bench.out());
    assert_eq!(
        metrics(&bench.out())["frames"],
        6,
        "five and the skipped one"
    );
}

#[test]
fn differences_from_the_session_are_reported() {
    let bench = Bench::empty();
    let few = bench.path("few.toml");
    fs::write(&few, "[features]\ncount = 700\n").expect("written");
    let session = saved();
    let differs = |options: &[&str], words: &[&str]| {
        resume(&bench, session, options).fails_with(words);
    };
    differs(&["--seed", "1"], &["seed", "the session has 0, this run 1"]);
    differs(
        &["--without", "flow"],
        &["configuration.flow.enabled", "true", "false"],
    );
    differs(
        &["--config", arg(&few)],
        &["configuration.features.count", "1000", "700"],
    );
    let lens = other_lens(&bench);
    differs(&["--calibration", arg(&lens)], &["camera.cx"]);
    differs(&["--first-frame", "1"], &["walking_12", "frame 0 is at"]);
    differs(&["--max-frames", "3"], &["3 frames", "11 are already done"]);
    differs(&["--oracle-labels", "mask"], &["--oracle-labels"]);
    let options = ["--resume", arg(session)];
    bench
        .run_on(short(), &options)
        .fails_with(&["quiet_desk_6"]);
    // The same times, the same camera, another scene.
    bench
        .run_on(&recording("quiet_desk", 12), &options)
        .fails_with(&["frame 0", "differs from that of", "walking_12"]);
    assert!(
        !bench.out().join("trajectory.txt").exists(),
        "nothing was run"
    );
}

#[test]
fn damaged_sessions_are_reported() {
    let bench = Bench::empty();
    let session = own(&bench);
    let file = state(&session);
    let name = file
        .file_name()
        .and_then(|name| name.to_str())
        .expect("a name")
        .to_owned();
    let good = fs::read(&file).expect("read");
    let refused = |bytes: &[u8], words: &[&str]| {
        fs::write(&file, bytes).expect("written");
        let words = [&[name.as_str()], words].concat();
        for option in ["--resume", "--localise"] {
            bench
                .run_on(walking(), &[option, arg(&session)])
                .fails_with(&words);
        }
    };
    refused(b"", &["not a session"]);
    refused(b"ply\nformat ascii 1.0\n", &["not a session"]);
    refused(&good[..good.len() / 3], &["cut off", "section"]);
    let mut flipped = good.clone();
    flipped[good.len() / 4] ^= 1;
    refused(&flipped, &["damaged", "section"]);
    let mut newer = good.clone();
    newer[14] += 1; // behind `garad session\n`
    let formats = [FORMAT + 1, FORMAT].map(|f| format!("format {f}"));
    refused(&newer, &[&formats[0], &formats[1]]);
    // The part of the run, behind that of the system, counts as well.
    fs::write(&file, &good[..good.len() - 1]).expect("written");
    resume(&bench, &session, &[]).fails_with(&[&name, "cut off"]);
    fs::remove_file(&file).expect("removed");
    resume(&bench, &session, &[]).fails_with(&[&name, "cannot be read"]);
}

#[test]
fn damaged_headers_are_reported() {
    let bench = Bench::empty();
    let session = own(&bench);
    let header = session.join("session.json");
    let good = fs::read_to_string(&header).expect("the header");
    let refused = |text: &str, words: &[&str]| {
        fs::write(&header, text).expect("written");
        resume(&bench, &session, &[]).fails_with(&[&["session.json"], words].concat());
    };
    refused("{", &["expected the header of a session"]);
    refused("{\"program\": \"another\"}", &["missing field"]);
    let version = format!("\"program\": \"{}\"", env!("CARGO_PKG_VERSION"));
    assert!(good.contains(&version), "{good}");
    refused(
        &good.replace(&version, "\"program\": \"0.0.7\""),
        &["0.0.7"],
    );
    refused(
        &good.replace("\"state-a.bin\"", "\"../../etc/passwd\""),
        &["state-a.bin"],
    );
    let none = bench.path("none");
    resume(&bench, &none, &[]).fails_with(&["none", "--save-session"]);
    bench
        .run_on(walking(), &["--localise", arg(&none)])
        .fails_with(&["none", "--save-session"]);
}

#[test]
fn folders_with_other_files_are_not_touched() {
    let bench = Bench::empty();
    let folder = bench.path("letters");
    fs::create_dir(&folder).expect("made");
    fs::write(folder.join("letter.txt"), "Dear").expect("written");
    let answer = bench.run_on(short(), &["--save-session", arg(&folder)]);
    answer.fails_with(&["letters", "holds files but no session"]);
    assert!(
        !bench.out().join("trajectory.txt").exists(),
        "found out before the run"
    );
    assert_eq!(
        fs::read_dir(&folder).expect("a folder").count(),
        1,
        "as it was"
    );
}

/// The program was killed in its first save, before the header.
#[test]
fn an_unfinished_session_is_overwritten() {
    let bench = Bench::empty();
    let session = own(&bench);
    fs::remove_file(session.join("session.json")).expect("removed");
    fs::write(session.join(".state-b.bin.part77"), "half").expect("written");
    let options = ["--max-frames", "2", "--save-session", arg(&session)];
    bench.run_on(short(), &options).succeeds();
    assert!(session.join("session.json").exists(), "a session");
    fs::write(session.join("session.json"), "{").expect("written");
    let answer = bench.run_on(short(), &options);
    answer.fails_with(&["holds files but no session"]);
}

#[test]
fn a_failed_save_keeps_the_older_session() {
    let bench = Bench::empty();
    let session = own(&bench);
    let before = fs::read(state(&session)).expect("read");
    // A folder in the place of the file that is to be written.
    fs::create_dir_all(session.join("state-b.bin/full")).expect("made");
    let answer = resume(&bench, &session, &["--save-session", arg(&session)]);
    answer.fails_with(&[
        "state-b.bin",
        "the session is not saved",
        "results are written",
    ]);
    assert!(
        bench.out().join("trajectory.txt").exists(),
        "the results are"
    );
    assert_eq!(
        fs::read(state(&session)).expect("read"),
        before,
        "the older state"
    );
    resume(&bench, &session, &[]).succeeds();
}

#[test]
fn localisation_in_a_finished_map() {
    let bench = Bench::empty();
    let (mapped, session) = (bench.path("mapped"), bench.path("session"));
    run_into(long(), &mapped, &["--save-session", arg(&session)]).succeeds();
    let before = fs::read(state(&session)).expect("read");
    let options = ["--localise", arg(&session), "--first-frame", "3"];
    bench.run_on(long(), &options).succeeds();
    assert_eq!(
        fs::read(state(&session)).expect("read"),
        before,
        "the session stays"
    );
    for name in ["map.ply", "keyframes.txt"] {
        let read = |folder: &Path| fs::read(folder.join(name)).expect("a result");
        assert!(read(&mapped) == read(&bench.out()), "{name} is the map's");
    }
    let rows = fs::read_to_string(bench.out().join("frames.csv")).expect("frames");
    let states: Vec<_> = rows
        .lines()
        .skip(1)
        .filter_map(|row| row.split(',').nth(2))
        .collect();
    assert_eq!(states.len(), 37, "a line per frame");
    let tracked = states.iter().filter(|state| **state == "tracking").count();
    let figures = metrics(&bench.out());
    assert_eq!(figures["tracked"], tracked, "{figures}");
    assert!(tracked >= 30, "{tracked} of 37 in its own map");
    let error_m = figures["ate"]["rmse_m"].as_f64().expect("judged");
    assert!(error_m < 0.02, "ATE {error_m} m");
}

#[test]
fn localisation_fails_in_another_room() {
    let bench = Bench::empty();
    let other = recording("quiet_desk", 12);
    let answer = bench.run_on(&other, &["--localise", arg(saved())]);
    let answer = answer.fails_with(&["no frame could be tracked"]);
    assert!(
        answer.out.contains("tracked    0 of 12 frames"),
        "{answer:?}"
    );
    let rows = fs::read_to_string(bench.out().join("frames.csv")).expect("frames");
    assert_eq!(rows.matches(",lost,").count(), 12, "{rows}");
    for options in [["--config", "x.toml"], ["--resume", "x"], ["--refine", "5"]] {
        let answer = bench.run_on(walking(), &[&["--localise", "x"], &options[..]].concat());
        answer.fails_with(&["cannot be used with"]);
    }
    let lens = other_lens(&bench);
    let options = ["--calibration", arg(&lens), "--localise", arg(saved())];
    bench.run_on(walking(), &options).fails_with(&["camera.cx"]);
}
