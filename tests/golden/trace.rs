//! `tests/golden/trace`: some frames through every stage, and the command that compares such traces.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use garad_golden::trace::diff::{Judge, Why, diff};
use garad_golden::trace::{Entry, INDEX, Index, Role};
use garad_golden::{Case, Dtype, Tensor, npy};
use serde_json::Value;
use tempfile::TempDir;

const MAX_FILE_BYTES: u64 = 256 * 1024;
const MAX_TRACE_BYTES: u64 = 1200 * 1024;

/// A committed trace: its name, the frames, and the recording it is made of.
struct Committed {
    name: &'static str,
    frames: &'static str,
    recording: &'static [&'static str],
}

impl Committed {
    fn folder(&self) -> PathBuf {
        Case::root().join("trace").join(self.name)
    }
}

const WALKING: Committed = Committed {
    name: "walking_4_to_6",
    frames: "4..6",
    recording: &["walking", "--frames", "7"],
};

/// The paper's loop, where the light has been off.
const PAPER_LOOP: Committed = Committed {
    name: "paper_loop_35",
    frames: "35..35",
    recording: &["lights_out", "--frames", "36", "--fps", "25", "--seed", "7"],
};

fn committed() -> PathBuf {
    WALKING.folder()
}

fn garad(args: &[&str]) -> Output {
    let output = Command::new(env!("CARGO_BIN_EXE_garad"))
        .args(args)
        .output();
    output.expect("the program starts")
}

fn code(output: &Output) -> i32 {
    output.status.code().expect("no signal")
}

fn text(path: &Path) -> &str {
    path.to_str().expect("UTF-8")
}

/// The recording of a committed trace.
fn recording(of: &Committed, folder: &Path) -> PathBuf {
    let out = folder.join(of.recording[0]);
    let mut args = vec!["synth"];
    args.extend(of.recording);
    args.extend(["--size", "96x72", "--noise", "--quiet", "-o", text(&out)]);
    let made = garad(&args);
    assert_eq!(code(&made), 0, "{made:?}");
    out
}

/// A copy of the committed trace, to be damaged.
fn copy(to: &Path) -> Index {
    let from = committed();
    let index = Index::load(&from).expect("committed");
    for file in index.tensors.iter().map(|e| e.file.as_str()).chain([INDEX]) {
        let path = to.join(file);
        fs::create_dir_all(path.parent().expect("a folder")).expect("made");
        fs::copy(from.join(file), path).expect("copied");
    }
    index
}

fn entry<'a>(index: &'a Index, file: &str) -> &'a Entry {
    let found = index.tensors.iter().find(|e| e.file == file);
    found.unwrap_or_else(|| panic!("no {file}"))
}

/// Adds to one number of a tensor.
fn nudge(folder: &Path, entry: &Entry, at: usize, by: f64) {
    let path = folder.join(&entry.file);
    let tensor = npy::decode(&fs::read(&path).expect("there")).expect("as written");
    let mut values = tensor.f64();
    values[at] += by;
    let bytes = values.iter().flat_map(|v| v.to_le_bytes()).collect();
    let changed = Tensor::from_bytes(Dtype::F64, tensor.shape().to_vec(), bytes).expect("as many");
    fs::write(&path, npy::encode(&changed)).expect("written");
}

#[test]
fn committed_traces_are_made_again_by_one_and_by_two_threads() {
    for (trace, least) in [(WALKING, 300), (PAPER_LOOP, 300)] {
        let folder = TempDir::new().expect("a folder");
        let recording = recording(&trace, folder.path());
        let config = trace.folder().with_extension("toml");
        for threads in ["1", "2"] {
            let out = folder.path().join(threads);
            let made = garad(&[
                "trace",
                text(&recording),
                "--frames",
                trace.frames,
                "--config",
                text(&config),
                "--threads",
                threads,
                "--quiet",
                "-o",
                text(&out),
            ]);
            assert_eq!(code(&made), 0, "{made:?}");
            let found = diff(&trace.folder(), &out, Judge::Exact).expect("two traces");
            assert!(
                found.differences.is_empty(),
                "{}, {threads} thread(s): {found}\nif that is meant, tests/golden/README.md says how to write the trace anew",
                trace.name
            );
            let compared = found.compared;
            assert!(compared > least, "{}: only {compared} tensors", trace.name);
        }
    }
}

/// What the second trace is there for; the first has none of it.
#[test]
fn the_trace_of_the_papers_loop_has_what_is_rare() {
    let folder = PAPER_LOOP.folder();
    let index = Index::load(&folder).expect("committed");
    let all = |stage: &str, tensor: &str| -> Vec<f64> {
        let entries = (index.tensors.iter()).filter(|e| (&*e.stage, &*e.tensor) == (stage, tensor));
        let read = |e: &Entry| npy::decode(&fs::read(folder.join(&e.file)).expect("there"));
        let tensors = entries.map(|e| read(e).expect("as written").f64());
        tensors.collect::<Vec<_>>().concat()
    };
    let count = |stage: &str, tensor: &str, of: fn(f64) -> bool| {
        let values = all(stage, tensor).into_iter();
        values.filter(|v| of(*v)).count()
    };
    for (what, stage, tensor, of) in [
        (
            "a lost camera is found",
            "relocalise",
            "found",
            (|v| v > 0.0) as fn(f64) -> bool,
        ),
        ("a loop", "loop", "drift_m", |v| v > 0.0),
        ("a culled keyframe", "cull", "culled", |v| v > 0.0),
        ("a dynamic landmark", "label_map", "label", |v| v > 0.0),
        (
            "a keypoint in the Gaussian mask",
            "gaussian_mask",
            "in_mask",
            |v| v > 0.0,
        ),
        ("keypoints set static again", "restore", "keypoint", |_| {
            true
        }),
        ("a landmark set static again", "restore", "landmark", |_| {
            true
        }),
        (
            "a Gaussian removed by eq. 7",
            "label_gaussians",
            "removed",
            |v| v > 0.0,
        ),
        ("a split Gaussian", "densify", "normals", |_| true),
        ("an iteration at level 2", "train", "level", |v| v > 1.5),
        ("an iteration at level 1", "train", "level", |v| {
            v > 0.5 && v < 1.5
        }),
        ("an iteration at level 0", "train", "level", |v| v < 0.5),
    ] {
        assert!(count(stage, tensor, of) > 0, "{what}: {stage}/{tensor}");
    }
    let gaussians = all("map_after", "landmark").into_iter();
    let gaussians: Vec<_> = gaussians.zip(all("map_after", "label")).collect();
    let landmarks = all("label_map", "landmark").into_iter();
    let both = (landmarks.zip(all("label_map", "label")))
        .filter(|(id, label)| *label > 0.0 && gaussians.contains(&(*id, 1.0)));
    assert!(both.count() > 0, "a dynamic landmark with its Gaussian");
}

/// `gen/trace.py` computes outputs again from the inputs beside them and writes down how; what it cannot is called
/// a pin.
#[test]
fn every_output_says_what_it_rests_on_and_most_on_something_outside() {
    let stages = garad_slam::trace::STAGES;
    let mut written: Vec<String> = Vec::new();
    for trace in [WALKING, PAPER_LOOP] {
        let folder = trace.folder();
        let index = Index::load(&folder).expect("committed");
        let basis = fs::read(folder.join("basis.json")).expect("there");
        let basis: Value = serde_json::from_slice(&basis).expect("JSON");
        let (mut outputs, mut checked) = (0.0, 0.0);
        let mut known: Vec<String> = Vec::new();
        for entry in index.tensors.iter().filter(|e| e.role == Role::Output) {
            let name = format!("{}/{}", entry.stage, entry.tensor);
            assert!(basis[&name]["basis"].is_string(), "{name}: no basis");
            outputs += 1.0;
            if !known.contains(&name) {
                checked += basis[&name]["tensors"].as_f64().unwrap_or(0.0);
                known.push(name);
            }
        }
        let listed = basis.as_object().map_or(0, serde_json::Map::len);
        assert_eq!(listed, known.len(), "{}: nothing else", trace.name);
        assert!(
            checked / outputs > 0.75,
            "{}: {checked} of {outputs} outputs are checked",
            trace.name
        );
        let mut all = 0;
        for entry in &index.tensors {
            let bytes = fs::metadata(folder.join(&entry.file)).expect("there").len();
            assert!(bytes <= MAX_FILE_BYTES, "{entry}: {bytes} bytes");
            all += bytes;
        }
        assert!(all <= MAX_TRACE_BYTES, "{}: {all} bytes", trace.name);
        written.extend(index.tensors.into_iter().map(|e| e.stage));
    }
    let unknown = written.iter().find(|s| !stages.contains(&s.as_str()));
    assert!(unknown.is_none(), "{unknown:?}: not in STAGES");
    let missing = stages.iter().filter(|s| !written.iter().any(|w| w == *s));
    // A reference keyframe is looked at only where prediction fails.
    assert_eq!(missing.collect::<Vec<_>>(), [&"match_reference"]);
}

#[test]
fn the_first_stage_that_differs_is_named_and_then_the_later_ones() {
    let folder = TempDir::new().expect("a folder");
    let index = copy(folder.path());
    let pose = entry(&index, "000005/pose_1/after.npy");
    nudge(folder.path(), pose, 7, 1e-3);
    nudge(
        folder.path(),
        entry(&index, "000006/bundle_0/points_after.npy"),
        2,
        1e-3,
    );
    nudge(
        folder.path(),
        entry(&index, "000006/bundle_0/cost.npy"),
        0,
        1e-3,
    );
    let found = diff(&committed(), folder.path(), Judge::Exact).expect("two traces");
    let names: Vec<&str> = found
        .differences
        .iter()
        .map(|d| d.entry.file.as_str())
        .collect();
    assert_eq!(
        names,
        [
            "000005/pose_1/after.npy",
            "000006/bundle_0/points_after.npy",
            "000006/bundle_0/cost.npy"
        ],
        "in the order of the data"
    );
    let Why::Numbers(comparison) = &found.differences[0].why else {
        panic!("{found}");
    };
    assert_eq!(
        (comparison.worst_index.as_slice(), comparison.outside),
        (&[1, 3][..], 1),
        "row 1, t"
    );
    assert!(
        (comparison.got - comparison.expected - 1e-3).abs() < 1e-12,
        "{comparison}"
    );
    let said = garad(&["trace", "diff", text(&committed()), text(folder.path())]);
    let out = String::from_utf8_lossy(&said.stdout).into_owned();
    assert_eq!(code(&said), 1, "{out}");
    for words in [
        "first difference: frame 5, pose, run 1, after",
        "at [1, 3]",
        "1 of 12 differ",
        "frame 6, bundle: points_after, cost",
    ] {
        assert!(out.contains(words), "'{words}' is not in\n{out}");
    }
}

#[test]
fn tolerances_forgive_rounding_and_nothing_more() {
    let folder = TempDir::new().expect("a folder");
    let index = copy(folder.path());
    let pose = entry(&index, "000005/pose_1/after.npy");
    let judged = |judge| {
        let found = diff(&committed(), folder.path(), judge).expect("two traces");
        found.differences.len()
    };
    nudge(folder.path(), pose, 3, 1e-10);
    assert_eq!(
        (judged(Judge::Exact), judged(Judge::Tolerances)),
        (1, 0),
        "1e-10 m"
    );
    nudge(folder.path(), pose, 3, 1e-6);
    assert_eq!(judged(Judge::Tolerances), 1, "1e-6 m");
    nudge(
        folder.path(),
        entry(&index, "000004/orb_0/level.npy"),
        0,
        1.0,
    );
    assert_eq!(judged(Judge::Tolerances), 2, "a level has no rounding");
}

#[test]
fn a_ports_folder_needs_no_index_and_may_be_incomplete() {
    let folder = TempDir::new().expect("a folder");
    let index = copy(folder.path());
    fs::remove_file(folder.path().join("000004/orb_0/xy.npy")).expect("there");
    let exact = |folder: &Path| diff(&committed(), folder, Judge::Exact);
    let lost = exact(folder.path()).expect("two traces").differences;
    assert!(
        matches!(lost[0].why, Why::Unreadable(_)),
        "its index promises it: {lost:?}"
    );
    fs::remove_file(folder.path().join(INDEX)).expect("there");
    let found = exact(folder.path()).expect("a folder");
    assert_eq!((found.absent, found.differences.len()), (1, 0), "{found}");
    assert_eq!(found.compared, index.tensors.len() - 1, "all others");
    let empty = TempDir::new().expect("a folder");
    for (second, words) in [
        (empty.path().to_path_buf(), "nothing to compare"),
        (empty.path().join("nowhere"), "no such folder"),
    ] {
        let said = garad(&["trace", "diff", text(&committed()), text(&second)]);
        let err = String::from_utf8_lossy(&said.stderr).into_owned();
        assert!(code(&said) == 2 && err.contains(words), "{err}");
    }
    let said = garad(&["trace", "diff", text(empty.path()), text(&committed())]);
    assert_eq!(code(&said), 2, "no trace: {said:?}");
}

#[test]
fn shapes_and_tensors_of_one_side_only_are_differences() {
    let folder = TempDir::new().expect("a folder");
    let mut index = copy(folder.path());
    let flat = Tensor::from(vec![0.0; 12]);
    fs::write(
        folder.path().join("000005/pose_1/after.npy"),
        npy::encode(&flat),
    )
    .expect("written");
    let gone = index.tensors.remove(0);
    let extra = Entry {
        stage: "dream".to_owned(),
        file: "000004/dream_0/x.npy".to_owned(),
        ..gone
    };
    index.tensors.push(extra);
    let json = serde_json::to_string(&index).expect("JSON");
    fs::write(folder.path().join(INDEX), json).expect("written");
    let found = diff(&committed(), folder.path(), Judge::Exact).expect("two traces");
    let why: Vec<&Why> = found.differences.iter().map(|d| &d.why).collect();
    assert_eq!(
        why,
        [&Why::Missing, &Why::Shape(vec![12]), &Why::Extra],
        "{found}"
    );
}

#[test]
fn frames_that_cannot_be_and_folders_in_use_are_refused() {
    let folder = TempDir::new().expect("a folder");
    let recording = recording(&WALKING, folder.path());
    let used = folder.path();
    let fresh = used.join("fresh");
    for (frames, out, words) in [
        ("6..4", &fresh, "FIRST..LAST"),
        ("7..9", &fresh, "has 7 frames"),
        ("1..2", &used.to_path_buf(), "not empty"),
    ] {
        let said = garad(&[
            "trace",
            text(&recording),
            "--frames",
            frames,
            "-o",
            text(out),
        ]);
        let err = String::from_utf8_lossy(&said.stderr).into_owned();
        assert!(code(&said) == 2 && err.contains(words), "{frames}: {err}");
    }
}
