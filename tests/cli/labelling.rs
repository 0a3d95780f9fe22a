//! Computed labels, and parts left out.

use std::fs;

use crate::support::{Bench, metrics, run_into, walking};

#[test]
fn labels_are_written_and_judged_by_the_masks_of_the_recording() {
    let bench = Bench::empty();
    let answer = run_into(walking(), &bench.out(), &[]).succeeds();
    assert!(answer.out.contains("labels     keypoints"), "{answer:?}");
    let labels = bench.out().join("labels");
    let rows = fs::read_to_string(labels.join("keypoints.csv")).expect("keypoints");
    let mut rows = rows.lines();
    assert_eq!(rows.next(), Some("frame,x_px,y_px,moves"), "a head");
    let row: Vec<&str> = rows.next().expect("a keypoint").split(',').collect();
    let first: usize = row[0].parse().expect("a frame");
    assert_eq!(first, 0, "the first frames, too, in their second pass");
    let mask = image::open(labels.join(format!("masks/{first:06}.png"))).expect("a mask");
    assert_eq!((mask.width(), mask.height()), (40, 30), "4 x 4 pixels each");
    let gaussians = fs::read_to_string(labels.join("gaussians.csv")).expect("counts");
    assert!(
        gaussians.starts_with("frame,keyframe,gaussians,dynamic"),
        "{gaussians}"
    );
    let head = fs::read(labels.join("gaussians.ply")).expect("all Gaussians");
    let head = String::from_utf8_lossy(&head[..2000]).into_owned();
    assert!(head.contains("property uchar label"), "with a label each");
    let metrics = metrics(&bench.out());
    let labels = &metrics["labels"];
    assert!(labels["pixels"]["iou"].is_number(), "{metrics}");
    assert!(
        labels["keypoints"]["wrongly_dynamic"].is_number(),
        "{metrics}"
    );
}

#[test]
fn parts_can_be_left_out() {
    let bench = Bench::empty();
    let run = |name: &str, options: &[&str]| {
        run_into(walking(), &bench.path(name), options).succeeds();
        (bench.path(name), metrics(&bench.path(name)))
    };
    let (out, no_labels) = run("crf", &["--without", "crf"]);
    assert!(!out.join("labels").exists(), "nothing was labelled");
    assert!(
        no_labels["labels"]["keypoints"]["f1"].is_null(),
        "{no_labels}"
    );
    let (_, no_map) = run("map", &["--without", "mapping", "--without", "flow"]);
    assert_eq!(no_map["map"]["gaussians"], 0, "{no_map}");
    let config = fs::read_to_string(bench.path("map").join("config.toml")).expect("as used");
    assert!(config.contains("[flow]\nenabled = false"), "{config}");
    let (_, unlabelled) = run("map_labels", &["--without", "map_labels"]);
    assert_eq!(unlabelled["map"]["dynamic"], 0, "{unlabelled}");
    assert!(
        unlabelled["labels"]["keypoints"]["f1"].is_number(),
        "{unlabelled}"
    );
    let config = fs::read_to_string(bench.path("map_labels").join("config.toml")).expect("as used");
    for key in [
        "avoid_moving = false",
        "exclude_moving = false",
        "map = false",
    ] {
        assert!(config.contains(key), "{key} in {config}");
    }
    let answer = run_into(walking(), &bench.out(), &["--without", "tracking"]);
    answer.fails_with(&["tracking"]);
}
