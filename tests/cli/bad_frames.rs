//! A bad single frame is skipped and counted; `--strict` ends the run with results so far.

use std::fs;

use image::{GrayImage, ImageBuffer, Luma};

use crate::support::{Bench, arg, assert_same_results, garad, metrics, run_into, short};

const RGB: &str = "rgb/0.066667.png";
const DEPTH: &str = "depth/0.066667.png";

/// Damage to frame 2: name, function, and words of the message.
type Damage = (&'static str, fn(&Bench), &'static [&'static str]);

const DAMAGES: &[Damage] = &[
    (
        "absent colour",
        |b| b.remove(RGB),
        &[RGB, "absent", "rgb.txt:4"],
    ),
    (
        "absent depth",
        |b| b.remove(DEPTH),
        &[DEPTH, "absent", "depth.txt:4"],
    ),
    (
        "truncated colour",
        |b| truncate(b, RGB),
        &[RGB, "8-bit PNG"],
    ),
    (
        "truncated depth",
        |b| truncate(b, DEPTH),
        &[DEPTH, "16-bit grey PNG"],
    ),
    (
        "empty colour",
        |b| b.write(RGB, ""),
        &[RGB, "an empty file"],
    ),
    (
        "empty depth",
        |b| b.write(DEPTH, ""),
        &[DEPTH, "an empty file"],
    ),
    (
        "no image",
        |b| b.write(RGB, "GIF89a"),
        &[RGB, "neither PNG nor JPEG"],
    ),
    ("small depth", small_depth, &[DEPTH, "80x60", "160x120"]),
    (
        "8-bit depth",
        |b| eight_bits(b, DEPTH),
        &[DEPTH, "8-bit grey PNG", "16-bit"],
    ),
    ("a folder", a_folder, &[RGB, "absent"]),
];

fn truncate(bench: &Bench, name: &str) {
    let bytes = fs::read(bench.rec().join(name)).expect("an image");
    bench.write(name, &bytes[..bytes.len() / 2]);
}

fn small_depth(bench: &Bench) {
    let depth = ImageBuffer::from_pixel(80, 60, Luma([5000u16]));
    depth.save(bench.rec().join(DEPTH)).expect("written");
}

fn eight_bits(bench: &Bench, name: &str) {
    let depth = GrayImage::from_pixel(160, 120, Luma([50]));
    depth.save(bench.rec().join(name)).expect("written");
}

fn a_folder(bench: &Bench) {
    bench.remove(RGB);
    fs::create_dir(bench.rec().join(RGB)).expect("made");
}

#[test]
fn bad_frames_are_skipped_and_counted() {
    for (what, damage, words) in DAMAGES {
        let bench = Bench::new();
        damage(&bench);
        let answer = bench.run(&[]).succeeds();
        let warning = format!("{what}: {}", answer.err);
        assert!(warning.contains("frame skipped: frame 2: "), "{warning}");
        assert!(answer.out.contains("5 of 6 frames"), "{what}: {answer:?}");
        let report = fs::read_to_string(bench.out().join("report.html")).expect("a report");
        assert!(report.contains("frame skipped: frame 2: "), "{what}");
        for word in *words {
            assert!(warning.contains(word), "`{word}` is not in {warning}");
            assert!(
                report.contains(word),
                "{what}: `{word}` is not in the report"
            );
        }
        let metrics = metrics(&bench.out());
        assert_eq!(metrics["frames"], 6, "{what}");
        let skipped = serde_json::json!([{"frames": 1, "why": "skipped"}]);
        assert_eq!(metrics["left_out"], skipped, "{what}");
        assert_eq!(metrics["tracked"], 5, "{what}");
        assert!(metrics["ate"]["rmse_m"].is_f64(), "{what}: {metrics}");
    }
}

#[test]
fn a_strict_run_equals_a_run_of_the_good_frames() {
    let good = Bench::empty();
    run_into(short(), &good.out(), &["--max-frames", "2"]).succeeds();
    for (what, damage, words) in DAMAGES {
        let bench = Bench::new();
        damage(&bench);
        let answer = bench.run(&["--strict"]).fails_at_last_with(words);
        let answer = answer.fails_with(&["frame 2: ", "results so far are written"]);
        assert_same_results(&good.out(), &bench.out());
        let metrics = metrics(&bench.out());
        assert_eq!(metrics["frames"], 3, "{what}: two good ones, one bad");
        assert_eq!(metrics["listed"], 6, "{what}");
        assert!(
            answer.out.contains("left out   1 skipped, 3 not reached\n"),
            "{answer:?}"
        );
        assert_eq!(metrics["tracked"], 2, "{what}");
        assert!(bench.out().join("report.html").is_file(), "{what}");
    }
}

/// The header of the first frame is read when the recording is opened.
#[test]
fn the_first_and_the_last_frame_may_be_bad() {
    let bench = Bench::new();
    bench.write("rgb/0.000000.png", "");
    bench.write("depth/0.166667.png", "\u{89}PNG\r\n");
    let answer = bench.run(&[]).succeeds();
    assert!(answer.out.contains("4 of 6 frames"), "{answer:?}");
    assert!(answer.err.contains("frame 0: "), "{answer:?}");
    assert!(answer.err.contains("frame 5: "), "{answer:?}");
}

#[test]
fn without_a_good_frame_nothing_is_tracked_but_all_is_written() {
    let bench = Bench::new();
    for i in [
        "0.000000", "0.033333", "0.066667", "0.100000", "0.133333", "0.166667",
    ] {
        bench.write(&format!("rgb/{i}.png"), "");
    }
    let answer = bench
        .run(&[])
        .fails_at_last_with(&["no frame could be tracked"]);
    assert_eq!(answer.err.matches("frame skipped").count(), 5, "{answer:?}");
    assert!(answer.err.contains("1 more skipped"), "{answer:?}");
    assert!(answer.out.contains("no frame has a pose"), "{answer:?}");
    let metrics = metrics(&bench.out());
    assert_eq!(metrics["tracked"], 0, "{metrics}");
    assert!(metrics["ate"]["rmse_m"].is_null(), "{metrics}");
    let report = fs::read_to_string(bench.out().join("report.html")).expect("a report");
    assert_eq!(report.matches("frame skipped").count(), 6, "all named");
    let map = bench.out().join("map.ply");
    let calibration = bench.rec().join("camera.txt");
    let pose = ["--pose", "0 0 0 0 0 0 1", "--quiet", "-o"];
    let images = bench.path("images");
    let mut render = vec!["render", arg(&map), "--calibration", arg(&calibration)];
    render.extend(pose);
    render.push(arg(&images));
    garad(render).succeeds(); // an empty map is a map
}

/// A frame with an unreadable mask is skipped.
#[test]
fn bad_masks_are_bad_frames() {
    let bench = Bench::new();
    let grey = GrayImage::from_pixel(160, 120, Luma([7]));
    grey.save(bench.rec().join("mask/0.066667.png"))
        .expect("written");
    bench.remove("mask/0.100000.png");
    let answer = bench.run(&["--oracle-labels", "mask"]).succeeds();
    assert!(answer.out.contains("4 of 6 frames"), "{answer:?}");
    for words in [
        "frame 2: ",
        "value 7 at pixel (0, 0)",
        "0.100000.png: not found",
    ] {
        assert!(answer.err.contains(words), "`{words}`: {answer:?}");
    }
    let strict = bench.run(&["--oracle-labels", "mask", "--strict"]);
    strict.fails_at_last_with(&["frame 2: ", "mask/0.066667.png", "value 7"]);
}
