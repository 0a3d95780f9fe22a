//! Stages answer without the expected outputs: a case whose outputs were removed gets the same answers.

use std::fs;
use std::path::{Path, PathBuf};

use garad_conformance::forms;
use garad_core::Par;
use garad_golden::Case;
use serde_json::{Value, json};

fn entries(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).expect("a folder");
    entries.map(|e| e.expect("readable").path()).collect()
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).expect("made");
    for path in entries(from) {
        let target = to.join(path.file_name().expect("a name"));
        match path.is_dir() {
            true => copy(&path, &target),
            false => fs::copy(&path, &target).map(drop).expect("copied"),
        }
    }
}

/// The case with its inputs alone.
fn without_outputs(case: &Case, root: &Path) -> Case {
    let folder = root.join(case.name());
    copy(case.folder(), &folder);
    let path = folder.join("case.json");
    let text = fs::read_to_string(&path).expect("there");
    let mut manifest: Value = serde_json::from_str(&text).expect("JSON");
    for output in manifest["outputs"].as_object().expect("outputs").values() {
        if let Some(file) = output["file"].as_str() {
            fs::remove_file(folder.join(file)).expect("there");
        }
    }
    manifest["outputs"] = json!({});
    fs::write(&path, manifest.to_string()).expect("written");
    Case::load(&folder).expect("a case without outputs")
}

#[test]
fn answers_need_no_expected_output() {
    let temporary = tempfile::tempdir().expect("a folder");
    let root = temporary.path().join("golden");
    copy(
        &Case::root().join("../data"),
        &temporary.path().join("data"),
    );
    let cases = Case::load_root(&Case::root()).expect("committed");
    let mut answered = 0;
    for case in &cases {
        let stripped = without_outputs(case, &root);
        assert!(stripped.outputs().is_empty(), "{}", case.name());
        for form in forms(case.stage()) {
            let answer = |case: &Case| form.answer(case.inputs(), Par::Seq).expect("sound");
            assert_eq!(
                answer(&stripped),
                answer(case),
                "{}, {}",
                case.name(),
                form.name
            );
            answered += 1;
        }
    }
    assert!(answered >= 147, "only {answered} answers");
}
