//! Stages answer without the expected outputs: a case whose outputs were removed gets the same answers. A case without
//! inputs is an error.

use std::fs;
use std::path::{Path, PathBuf};

use garad_conformance::{STAGES, Width, answer, forms};
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

/// The case without its outputs, or without more of its parts.
fn without(case: &Case, parts: &[&str], root: &Path) -> Case {
    let folder = root.join(case.name());
    copy(case.folder(), &folder);
    let path = folder.join("case.json");
    let text = fs::read_to_string(&path).expect("there");
    let mut manifest: Value = serde_json::from_str(&text).expect("JSON");
    for part in parts {
        for entry in manifest[part].as_object().expect("a list").values() {
            if let Some(file) = entry["file"].as_str() {
                fs::remove_file(folder.join(file)).expect("there");
            }
        }
        manifest[part] = json!({});
    }
    fs::write(&path, manifest.to_string()).expect("written");
    Case::load(&folder).expect("a case with less in it")
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
        let stripped = without(case, &["outputs"], &root);
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
    assert!(answered >= 174, "only {answered} answers");
}

#[test]
fn what_is_missing_is_an_error_and_names_the_case() {
    let temporary = tempfile::tempdir().expect("a folder");
    for (stage, _) in STAGES {
        let case = &Case::load_all(stage)[0];
        let empty = without(case, &["inputs", "params"], temporary.path());
        let error = answer(empty.inputs(), Width::F64).expect_err("nothing to compute with");
        let text = error.to_string();
        assert!(text.starts_with(&format!("{}: ", case.name())), "{text}");
    }
}
