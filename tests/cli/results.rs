//! `garad run`: its results, and that the same input gives the same bytes.

use std::fs;
use std::path::Path;

use serde_json::Value;

use crate::support::{
    Bench, STABLE, answer, arg, assert_same_results, long, metrics, program, run_into, short,
    walking,
};

/// Keys of metrics.json.
const KEYS: &[&str] = &[
    "/frames",
    "/tracked",
    "/threads",
    "/wall_s",
    "/peak_rss_mb",
    "/ate/rmse_m",
    "/ate/mean_m",
    "/ate/median_m",
    "/ate/std_m",
    "/ate/max_m",
    "/ate/pairs",
    "/rpe/trans_rmse_m_per_s",
    "/rpe/rot_rmse_deg_per_s",
    "/jitter/rms_m",
    "/jitter/ground_truth_rms_m",
    "/render/psnr_db",
    "/render/ssim",
    "/render_static/psnr_db",
    "/render_static/ssim",
    "/labels/keypoints/precision",
    "/labels/keypoints/recall",
    "/labels/keypoints/f1",
    "/labels/pixels/precision",
    "/labels/pixels/recall",
    "/labels/pixels/f1",
    "/labels/pixels/iou",
    "/map/gaussians",
    "/map/dynamic",
    "/timing/frame/median_ms",
    "/timing/frame/p95_ms",
    "/timing/frame/calls",
];

/// Keys with a number for every recording with ground truth.
const JUDGED: &[&str] = &[
    "/frames",
    "/tracked",
    "/threads",
    "/wall_s",
    "/ate/rmse_m",
    "/ate/mean_m",
    "/ate/median_m",
    "/ate/std_m",
    "/ate/max_m",
    "/ate/pairs",
    "/rpe/trans_rmse_m_per_s",
    "/rpe/rot_rmse_deg_per_s",
    "/jitter/rms_m",
    "/jitter/ground_truth_rms_m",
    "/map/gaussians",
    "/map/dynamic",
    "/timing/frame/median_ms",
];

#[test]
fn a_run_writes_all_results() {
    let bench = Bench::empty();
    let answer = run_into(long(), &bench.out(), &[]).succeeds();
    for words in [
        "40 of 40 frames",
        "ATE [m]",
        "RPE",
        "jitter [mm]",
        "results in",
    ] {
        assert!(answer.out.contains(words), "`{words}`: {answer:?}");
    }
    for name in STABLE {
        assert!(bench.out().join(name).is_file(), "{name}");
    }
    let poses = |name: &str| -> Vec<f64> {
        let text = fs::read_to_string(bench.out().join(name)).expect("poses");
        let lines = text.lines().filter(|line| !line.starts_with('#'));
        let times = lines.map(|line| line.split(' ').next().and_then(|t| t.parse().ok()));
        times.map(|t| t.expect("a time")).collect()
    };
    let (all, keyframes) = (poses("trajectory.txt"), poses("keyframes.txt"));
    assert_eq!(all.len(), 40, "a pose for each frame");
    assert!(
        keyframes.iter().all(|t| all.contains(t)),
        "keyframes are frames"
    );
    assert!((1..40).contains(&keyframes.len()), "{keyframes:?}");

    let metrics = metrics(&bench.out());
    for key in KEYS {
        assert!(metrics.pointer(key).is_some(), "no {key}: {metrics}");
    }
    for key in JUDGED {
        let value = metrics.pointer(key).and_then(Value::as_f64);
        assert!(
            value.is_some_and(|v| v.is_finite() && v >= 0.0),
            "{key}: {value:?}"
        );
    }
    assert_eq!(metrics["ate"]["pairs"], 40, "{metrics}");
    let ate = metrics["ate"]["rmse_m"].as_f64().expect("judged");
    assert!(ate < 0.05, "{ate} m, from images of 160x120");
    check_report(&bench.out(), "quiet_desk_40");
}

#[test]
fn every_iteration_of_training_has_its_loss() {
    let bench = Bench::empty();
    run_into(long(), &bench.out(), &["--refine", "3"]).succeeds();
    let text = fs::read_to_string(bench.out().join("losses.csv")).expect("losses");
    let mut lines = text.lines();
    assert_eq!(
        lines.next(),
        Some("when,iteration,keyframe,level,gaussians,loss"),
        "header"
    );
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    let jobs = rows.iter().filter(|row| row[0] == "job").count();
    assert!(jobs > 1, "a job per keyframe: {text}");
    let refined = rows.iter().filter(|row| row[0] == "refine");
    let refined: Vec<_> = refined.map(|row| row[1]).collect();
    assert_eq!(refined, ["0", "1", "2"], "{text}");
    for row in &rows {
        let loss: f32 = row[5].parse().expect("a number");
        assert!(loss > 0.0 && loss.is_finite(), "{row:?}");
    }
}

/// The page is complete and refers to no other file.
fn check_report(out: &Path, name: &str) {
    let report = fs::read_to_string(out.join("report.html")).expect("a report");
    assert!(
        report.contains("<svg") && report.contains(name),
        "a drawing of {name}"
    );
    assert!(report.trim_end().ends_with("</html>"), "whole");
    for link in ["src=\"", "href=\"", "url("] {
        for (at, _) in report.match_indices(link) {
            let target = &report[at + link.len()..];
            let inside = target.starts_with("data:") || target.starts_with('#');
            let shown: String = target.chars().take(40).collect();
            assert!(inside, "{link}{shown}");
        }
    }
    // The name of the SVG language is the only address.
    let addresses = report.matches("http").count();
    assert_eq!(
        addresses,
        report.matches("http://www.w3.org/2000/svg").count(),
        "an address"
    );
    assert!(!report.contains("<script src"), "no code from elsewhere");
}

#[cfg(unix)] // elsewhere such names do not exist
#[test]
fn names_of_recordings_are_escaped_in_the_report() {
    let bench = Bench::empty();
    let odd = bench.path("<img src=x>&\"'");
    crate::support::copy(short(), &odd);
    bench.run_on(&odd, &[]).succeeds();
    let report = fs::read_to_string(bench.out().join("report.html")).expect("a report");
    assert!(!report.contains("<img src=x>"), "escaped");
    check_report(&bench.out(), "&lt;img");
}

#[test]
fn the_same_bytes_on_any_number_of_threads_and_again() {
    let bench = Bench::empty();
    let masks = ["--oracle-labels", "mask"];
    for (recording, options) in [(long(), &[][..]), (walking(), &masks[..])] {
        for (name, threads) in [("1", "1"), ("2", "2"), ("3", "3"), ("again", "3")] {
            let options = [options, &["--threads", threads]].concat();
            run_into(recording, &bench.path(name), &options).succeeds();
        }
        for other in ["2", "3", "again"] {
            assert_same_results(&bench.path("1"), &bench.path(other));
        }
        let trajectory = fs::read_to_string(bench.path("1").join("trajectory.txt"));
        assert!(
            trajectory.expect("poses").lines().count() > 6,
            "something to compare"
        );
    }
}

/// Without `-o`, results go to `out/NAME`; a second run replaces the first.
#[test]
fn results_have_a_default_folder() {
    let bench = Bench::new();
    let run = |options: &[&str]| {
        let mut command = program();
        command
            .current_dir(bench.path(""))
            .args(["run", "rec", "--quiet"]);
        answer(command.args(options)).succeeds();
        fs::read(bench.path("out/rec/trajectory.txt")).expect("a trajectory")
    };
    let (all, few) = (run(&[]), run(&["--max-frames", "3"]));
    assert!(
        few.len() < all.len() && all.starts_with(&few[..50]),
        "replaced"
    );
    let later = run(&["--first-frame", "4"]);
    let text = String::from_utf8(later).expect("text");
    let second = text.lines().nth(1).unwrap_or_default();
    assert!(
        second.starts_with("0.133333 0.000000000 "),
        "begins at frame 4: {text}"
    );
}

#[test]
fn without_ground_truth_nothing_is_judged() {
    let bench = Bench::new();
    bench.remove("groundtruth.txt");
    let answer = bench.run(&[]).succeeds();
    let words = "cannot be judged: no ground truth";
    assert!(answer.out.contains(words), "{answer:?}");
    let metrics = metrics(&bench.out());
    for figure in ["rmse_m", "mean_m", "median_m", "std_m", "max_m", "pairs"] {
        assert!(metrics["ate"][figure].is_null(), "{figure}: {metrics}");
    }
    assert!(metrics["rpe"]["trans_rmse_m_per_s"].is_null(), "{metrics}");
    for figure in ["rms_m", "ground_truth_rms_m"] {
        assert!(metrics["jitter"][figure].is_null(), "{figure}: {metrics}");
    }
    assert_eq!(metrics["tracked"], 6, "{metrics}");
    let report = fs::read_to_string(bench.out().join("report.html")).expect("a report");
    assert!(report.contains(words), "the report says so");
}

/// Masks inside the recording, by path, and missing.
#[test]
fn true_labels_are_used() {
    let bench = Bench::empty();
    let masks = walking().join("mask");
    let run = |name: &str, options: &[&str]| {
        run_into(walking(), &bench.path(name), options).succeeds();
        fs::read(bench.path(name).join("trajectory.txt")).expect("a trajectory")
    };
    let without = run("without", &[]);
    let inside = run("inside", &["--oracle-labels", "mask"]);
    let by_path = run("by_path", &["--oracle-labels", arg(&masks)]);
    assert!(inside == by_path, "the same masks");
    assert!(inside != without, "masks count");
    assert_eq!(metrics(&bench.path("inside"))["tracked"], 12, "all tracked");

    let answer = run_into(walking(), &bench.out(), &["--oracle-labels", "nowhere"]);
    answer.fails_with(&["nowhere: no such folder", "walking_12"]);
    let answer = run_into(walking(), &bench.out(), &["--oracle-labels", "rgb"]);
    let answer = answer.fails_at_last_with(&["no frame could be tracked"]);
    assert!(
        answer
            .err
            .contains("8-bit RGB PNG; expected an 8-bit grey PNG"),
        "{answer:?}"
    );
}

/// Nine frames of the TUM benchmark's freiburg1_desk.
#[test]
fn a_real_recording_is_tracked() {
    let bench = Bench::empty();
    let desk = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/tum_fr1_desk_9");
    let answer = bench.run_on(&desk, &[]).succeeds();
    assert!(answer.out.contains("9 of 9 frames"), "{answer:?}");
    let ate = metrics(&bench.out())["ate"]["rmse_m"]
        .as_f64()
        .expect("judged");
    assert!(ate < 0.01, "ATE {ate} m");
}
