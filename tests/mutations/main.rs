//! Every mutant of the list can still be made: each text is there, once, to be replaced.
//!
//! Whether the tests notice the mutants takes `tests/mutations/run.py` hours; `results.csv` has its answers.

use std::fs;
use std::path::Path;

use serde::Deserialize;

/// One wrong character in the right place: `find` occurs exactly once in `file` and is replaced. A test of that
/// file's crate has to fail then, or a golden case.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Mutant {
    file: String,
    what: String,
    find: String,
    replace: String,
}

#[derive(Debug, Deserialize)]
struct Mutants {
    mutant: Vec<Mutant>,
}

#[test]
fn every_mutant_can_still_be_made() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut mutants = Vec::new();
    for entry in fs::read_dir(root.join("tests/mutations/mutants")).expect("the lists") {
        let path = entry.expect("readable").path();
        let list = fs::read_to_string(&path).expect("readable");
        let list: Mutants = toml::from_str(&list).expect("the list's form");
        mutants.extend(list.mutant);
    }
    assert!(mutants.len() >= 40, "only {} mutants", mutants.len());
    let mut wrong = Vec::new();
    for (i, mutant) in mutants.iter().enumerate() {
        let text = fs::read_to_string(root.join(&mutant.file)).unwrap_or_default();
        let count = text.matches(&mutant.find).count();
        let inside = mutant.file.starts_with("crates/") && mutant.file.contains("/src/");
        let twice = mutants[..i]
            .iter()
            .any(|s| s.file == mutant.file && s.find == mutant.find && s.replace == mutant.replace);
        if count != 1 || mutant.find == mutant.replace || !inside || twice {
            wrong.push(format!(
                "{}: `{}` found {count} times ({})",
                mutant.file, mutant.find, mutant.what
            ));
        }
    }
    assert!(
        wrong.is_empty(),
        "code has changed under these mutants; mend tests/mutations/mutants:\n{}",
        wrong.join("\n")
    );
}
