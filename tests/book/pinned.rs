//! Derivations, tests and golden cases that documents name.

use std::collections::BTreeSet;
use std::path::PathBuf;

use garad_golden::stages::STAGES;

use crate::{
    chapters, files_below, has_function, is_file_of_code, none, quoted, read, root, rust_code,
    section,
};

/// A derivation names the function or the module that computes it, behind a dash in its title.
#[test]
fn derivations_name_functions() {
    let (code, mut problems, mut names) = (rust_code(), Vec::new(), 0);
    let files = files_below(&root().join("crates"), &["rs"]);
    for page in ["docs/math.md", "docs/math_crf.md"] {
        let text = read(&root().join(page));
        for title in text.lines().filter(|line| line.starts_with("### ")) {
            let (_, named) = title.split_once(" — ").unwrap_or((title, ""));
            for name in quoted(named) {
                names += 1;
                let last = name.rsplit("::").next().expect("a name");
                let is_module = |path: &PathBuf| path.file_stem().is_some_and(|stem| stem == last);
                let is_module_folder = |path: &PathBuf| path.ends_with(format!("{last}/mod.rs"));
                let is_type = code.contains(&format!("struct {last}"));
                let module = files
                    .iter()
                    .any(|path| is_module(path) || is_module_folder(path));
                if !(module || is_type || has_function(&code, last)) {
                    problems.push(format!("{page}: {title:?} names no code"));
                }
            }
        }
    }
    none(&problems);
    assert!(names > 40, "only {names} names");
}

/// A line under "Pinned by" names a file and tests in it (several, parted by semicolons), or golden
/// cases.
#[test]
fn tests_and_golden_cases_that_are_named_exist() {
    let (mut problems, mut tests, mut cases) = (Vec::new(), 0, BTreeSet::new());
    for (page, text) in chapters() {
        let Some(pinned) = section(&text, "Pinned by") else {
            problems.push(format!("{page}: no section \"Pinned by\""));
            continue;
        };
        for part in pinned.split("\n- ").flat_map(|item| item.split(';')) {
            let mut file = None;
            for name in quoted(part) {
                if is_file_of_code(name) {
                    file = Some((name, read(&root().join(name))));
                } else if let Some((path, code)) = &file {
                    tests += 1;
                    if !code.contains(&format!("fn {name}(")) {
                        problems.push(format!("{page}: no test {name} in {path}"));
                    }
                } else if name.contains('/') {
                    let case = root().join("tests/golden").join(name);
                    if !["case.json", "trace.json"]
                        .iter()
                        .any(|f| case.join(f).is_file())
                    {
                        problems.push(format!("{page}: no golden case {name}"));
                    }
                    cases.extend(name.split('/').next().map(str::to_owned));
                }
            }
        }
    }
    none(&problems);
    assert!(tests > 80, "only {tests} tests are named");
    let unnamed: Vec<&str> = (STAGES.iter().map(|stage| stage.name))
        .filter(|name| !cases.contains(*name))
        .collect();
    assert!(unnamed.is_empty(), "stages in no chapter: {unnamed:?}");
}
