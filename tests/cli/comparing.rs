//! Profiles, `garad compare` and `garad ablate`.

use std::fs;
use std::path::Path;

use crate::support::{
    Bench, arg, assert_same_results, garad, recording, run_into, short, walking, walking_on,
};

fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

fn json(path: &Path) -> serde_json::Value {
    serde_json::from_str(&read(path)).expect("JSON")
}

#[test]
fn profiles_are_listed_and_printed() {
    let list = garad(["profiles"]).succeeds().out;
    for name in ["default ", "orb_slam ", "photo_slam "] {
        assert!(
            list.lines().any(|line| line.starts_with(name)),
            "{name} in {list}"
        );
    }
    let toml = garad(["profiles", "orb_slam"]).succeeds().out;
    assert!(toml.contains("depth_residual = \"right\""), "{toml}");
    let rec = arg(short());
    for unknown in [
        &["profiles", "slam_orb"][..],
        &["run", rec, "--profile", "slam_orb"],
        &["compare", rec, "--profiles", "default,slam_orb"],
    ] {
        garad(unknown).fails_with(&["slam_orb", "default", "photo_slam"]);
    }
}

/// Defaults, profile, file, options: each overrides those before it.
#[test]
fn a_profile_lies_between_the_defaults_and_the_file() {
    let bench = Bench::empty();
    let file = bench.path("settings.toml");
    fs::write(
        &file,
        "[labels]\nenabled = true\n[train]\nfinal_iterations = 5\n",
    )
    .expect("written");
    let used = |name: &str, options: &[&str]| {
        run_into(short(), &bench.path(name), options).succeeds();
        read(&bench.path(name).join("config.toml"))
    };
    let profile = used("profile", &["--profile", "orb_slam"]);
    assert!(profile.contains("[labels]\nenabled = false"), "{profile}");
    let options = [
        "--profile",
        "orb_slam",
        "--config",
        arg(&file),
        "--refine",
        "0",
    ];
    let all = used("all", &options);
    for expected in [
        "[labels]\nenabled = true",
        "[insertion]\nenabled = false",
        "final_iterations = 0",
    ] {
        assert!(all.contains(expected), "{expected} in {all}");
    }
    used("default", &["--profile", "default"]);
    used("plain", &[]);
    assert_same_results(&bench.path("default"), &bench.path("plain"));
}

#[test]
fn every_profile_has_the_same_bits_on_any_number_of_threads() {
    let bench = Bench::empty();
    let list = garad(["profiles"]).succeeds().out;
    let names: Vec<&str> = list.lines().filter_map(|l| l.split(' ').next()).collect();
    assert!(
        names.contains(&"paper") && names.contains(&"splatam"),
        "{names:?}"
    );
    for name in names {
        let [one, two, three] = ["1", "2", "3"].map(|threads| {
            let out = bench.path(&format!("{name}_{threads}"));
            let options = ["--profile", name, "--threads", threads];
            run_into(walking_on(), &out, &options).succeeds();
            out
        });
        assert_same_results(&one, &two);
        assert_same_results(&one, &three);
    }
}

#[test]
fn profiles_are_compared_on_one_recording() {
    let bench = Bench::empty();
    let out = bench.out();
    let profiles = ["--profiles", "default,orb_slam", "--quiet", "-o", arg(&out)];
    let answer = garad(["compare", arg(walking())].iter().chain(&profiles)).succeeds();
    for row in ["| default | 0.", "| orb_slam | 0."] {
        assert!(answer.out.contains(row), "{row} in {answer:?}");
    }
    assert!(
        answer.out.contains("DDN-SLAM needs a detector"),
        "{answer:?}"
    );
    assert!(
        answer.out.contains(&read(&out.join("compare.md"))),
        "the same text"
    );
    let table = json(&out.join("compare.json"));
    assert_eq!(
        table["published"].as_array().map(Vec::len),
        Some(0),
        "{table}"
    );
    let [default, orb] = [0, 1].map(|i| &table["rows"][i]);
    for key in [
        "static_psnr_db",
        "ghosts",
        "gaussians",
        "mask_iou",
        "processor_ms_per_frame",
    ] {
        assert!(default[key].is_number(), "{key}: {default}");
    }
    for key in ["static_psnr_db", "ghosts", "gaussians", "dynamic_gaussians"] {
        assert!(orb[key].is_null(), "{key}: {orb}");
    }
    let page = read(&out.join("compare.html"));
    assert_eq!(
        page.matches("data:image/jpeg;base64,").count(),
        10,
        "input and a map"
    );
    for name in ["default", "orb_slam"] {
        assert!(out.join(name).join("report.html").is_file(), "{name}");
    }
    let twice = garad(["compare", arg(walking()), "--profiles", "default,default"]);
    twice.fails_with(&["default", "twice"]);
}

#[test]
fn a_profile_that_fails_is_a_row_with_the_reason() {
    let bench = Bench::new();
    let (rec, out, file) = (bench.rec(), bench.out(), bench.path("settings.toml"));
    fs::create_dir_all(&out).expect("made");
    fs::write(out.join("default"), "in the way").expect("written");
    let profiles = ["--profiles", "default,orb_slam", "--quiet", "-o", arg(&out)];
    let compare = |options: &[&str]| {
        let command = ["compare", arg(&rec)];
        garad(command.iter().chain(&profiles).chain(options))
    };
    compare(&[]).succeeds();
    let rows = json(&out.join("compare.json"))["rows"].clone();
    let remark = rows[0]["remark"].as_str().expect("a reason");
    assert!(remark.contains("cannot make the folder"), "{rows}");
    assert!(rows[1]["ate_rmse_m"].is_number(), "the next one: {rows}");

    fs::write(&file, "[keyframes]\nfirst_min_keypoints = 100000\n").expect("written");
    compare(&["--config", arg(&file)]).fails_with(&["no run has tracked a frame"]);
    let rows = json(&out.join("compare.json"))["rows"].clone();
    assert_eq!(rows[1]["remark"], "no frame could be tracked", "{rows}");
    assert_eq!(rows[1]["tracked"], 0, "{rows}");
}

#[test]
fn published_figures_stand_below_the_rows_of_a_known_recording() {
    let bench = Bench::new();
    let (crowd, out) = (bench.path("bonn_crowd_1_6"), bench.out());
    fs::rename(bench.rec(), &crowd).expect("renamed");
    let options = ["--profiles", "orb_slam", "--quiet", "-o", arg(&out)];
    let answer = garad(["compare", arg(&crowd)].iter().chain(&options)).succeeds();
    let row = "| GARAD-SLAM, published | 0.0182 | 0.0091 |";
    assert!(answer.out.contains(row), "{answer:?}");
    assert!(
        answer.out.contains("frames 0 to 5 of bonn_crowd_1_6"),
        "{answer:?}"
    );
}

#[test]
fn ablation_runs_every_variant() {
    let bench = Bench::empty();
    let out = bench.out();
    let answer = garad(["ablate", arg(walking()), "--quiet", "-o", arg(&out)]).succeeds();
    let parts = [
        "crf",
        "pairwise",
        "flow",
        "map_labels",
        "penalty",
        "retention",
        "loops",
    ];
    let without = parts.map(|part| format!("without {part}"));
    for variant in std::iter::once("full").chain(without.iter().map(String::as_str)) {
        let row = format!("| {variant} | 0.");
        assert!(answer.out.contains(&row), "{row} in {answer:?}");
    }
    let table = json(&out.join("ablation.json"));
    let rows = table["rows"].as_array().expect("rows");
    assert_eq!(rows.len(), 8, "{table}");
    assert!(rows[0]["mask_iou"].is_number(), "{table}");
    assert!(rows[1]["mask_iou"].is_null(), "without crf: {table}");
    assert_eq!(
        rows[4]["dynamic_gaussians"], 0,
        "without map labels: {table}"
    );
    for folder in ["full", "without_map_labels"] {
        assert!(out.join(folder).join("report.html").is_file(), "{folder}");
    }
    assert!(out.join("ablation.html").is_file(), "a page");
    for row in [
        "| GARAD-SLAM, mean of TUM, published | 0.0194 | 0.0114 |",
        "| w/o Mapping, mean of BONN, published | 0.0274 | 0.0127 |",
    ] {
        assert!(answer.out.contains(row), "{row} in {answer:?}");
    }

    let answer = garad(["ablate", arg(&bench.path("nowhere"))]);
    answer.fails_with(&["nowhere"]);
}

/// Table III on forty frames with two people, by the paper's loop. The rows in this order: without the field the path is
/// the worst; without labels in the map the path stays and people are in the render; without retention the mask is lost
/// with its Gaussians. Without pairwise edges, flow check, penalty or loops this scene is much the same.
#[test]
fn parts_of_the_papers_loop_matter_as_its_ablation_says() {
    let bench = Bench::empty();
    let out = bench.out();
    let recording = recording("walking", 40);
    let options = ["--profile", "paper_tuned", "--quiet", "-o", arg(&out)];
    garad(["ablate", arg(&recording)].iter().chain(&options)).succeeds();
    let table = json(&out.join("ablation.json"));
    let rows = table["rows"].as_array().expect("rows");
    let of = |part: &str, key: &str| {
        let row = rows.iter().find(|row| row["name"] == part);
        row.and_then(|row| row[key].as_f64())
            .unwrap_or_else(|| panic!("{key} of {part}: {table}"))
    };
    let [full, crf, map, retention] = [
        "full",
        "without crf",
        "without map_labels",
        "without retention",
    ];
    let [ate, ghosts, f1, dynamic] = ["ate_rmse_m", "ghosts", "keypoint_f1", "dynamic_gaussians"]
        .map(|key| move |part| of(part, key));
    let table = read(&out.join("ablation.md"));
    assert!(ate(crf) > 2.0 * ate(full), "0.0231 and 0.0086 m: {table}");
    assert!(ate(crf) > 2.0 * ate(map), "0.0231 and 0.0089 m: {table}");
    assert!(ate(map) < 1.15 * ate(full), "0.0089 and 0.0086 m: {table}");
    assert!((f1(map) - f1(full)).abs() < 0.05, "0.676 both: {table}");
    assert!(ghosts(map) > 3.0 * ghosts(full), "3.65 and 0.57 %: {table}");
    assert!(ghosts(crf) > 3.0 * ghosts(full), "4.16 and 0.57 %: {table}");
    assert!(dynamic(full) > 300.0, "573: {table}");
    assert!(dynamic(map) < 0.5, "all are static: {table}");
    assert!(
        dynamic(retention) < 0.8 * dynamic(full),
        "362 and 573: {table}"
    );
    assert!(f1(retention) < 0.75 * f1(full), "0.378 and 0.676: {table}");
}
