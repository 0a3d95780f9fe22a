//! The map from the paper: equations, sections and sentences have functions and tests.

use std::collections::BTreeSet;
use std::path::PathBuf;

use garad_golden::stages::STAGES;

use crate::{has_function, is_file_of_code, none, quoted, read, root, rust_code, section};

/// The cells of each row of the tables under a heading, the rows of titles left out.
fn table(text: &str, heading: &str) -> Vec<Vec<String>> {
    let body = section(text, heading).unwrap_or_else(|| panic!("no section {heading:?}"));
    let rows = body.lines().filter(|line| line.starts_with("| "));
    let cells = rows.map(|row| row.split('|').map(|cell| cell.trim().to_owned()).collect());
    let all: Vec<Vec<String>> = cells.collect();
    assert!(all.len() > 10, "{heading}: only {} rows", all.len());
    all[1..].to_vec()
}

/// A path of the map from the paper.
fn path_of_map(name: &str) -> PathBuf {
    let below = [root().join(name), root().join("crates/slam/src").join(name)];
    let found = below.iter().find(|path| path.exists());
    found
        .cloned()
        .unwrap_or_else(|| panic!("paper_map.md: no {name}"))
}

/// The documentation of a function: the lines of comment right above it.
fn documentation(code: &str, name: &str) -> Option<String> {
    let lines: Vec<&str> = code.lines().collect();
    let at = lines.iter().position(|line| has_function(line, name))?;
    let above = lines[..at].iter().rev().map(|line| line.trim_start());
    let block = above.take_while(|line| line.starts_with("///") || line.starts_with("#["));
    Some(block.collect::<Vec<_>>().join("\n"))
}

/// Each equation has a row; its functions are in the files named before them, and their documentation says `Eq. N`.
#[test]
fn equations_have_functions_that_say_so() {
    let mut problems = Vec::new();
    let mut equations = BTreeSet::new();
    for row in table(&read(&root().join("docs/paper_map.md")), "Equations") {
        let (number, functions) = (&row[1], &row[4]);
        if number.is_empty() || !number.chars().all(|c| c.is_ascii_digit()) {
            continue;
        }
        let (mut code, mut named) = (String::new(), false);
        for name in quoted(functions) {
            if is_file_of_code(name) {
                code = read(&path_of_map(name));
                continue;
            }
            let Some(says) = documentation(&code, name) else {
                problems.push(format!("eq. {number}: no function {name}"));
                continue;
            };
            let numbers = says.to_lowercase();
            let mut after = numbers.split("eq. ").skip(1);
            named |= after.any(|rest| {
                let digits = rest.find(|c: char| !c.is_ascii_digit());
                rest[..digits.unwrap_or(rest.len())] == **number
            });
        }
        if !named {
            problems.push(format!("eq. {number}: no function says Eq. {number}"));
        }
        equations.insert(number.clone());
    }
    none(&problems);
    let expected = [1, 2, 3, 4, 5, 6, 7, 9, 10, 11, 12, 13, 15, 16].map(|n: u32| n.to_string());
    assert_eq!(equations, expected.into(), "one row per equation");
}

/// Every path, test and golden stage of the map from the paper.
#[test]
fn the_map_from_the_paper_names_what_exists() {
    let (map, code) = (read(&root().join("docs/paper_map.md")), rust_code());
    let mut problems = Vec::new();
    let rows = |heading, columns: [usize; 3]| {
        let rows = table(&map, heading).into_iter();
        rows.map(move |row| columns.map(|column| row[column].clone()))
    };
    for [paths, tests, stages] in rows("Equations", [5, 6, 7]).chain(rows("Sections", [3, 4, 5])) {
        let is_path = |name: &&str| is_file_of_code(name) || name.contains('/');
        for name in quoted(&paths).into_iter().filter(is_path) {
            path_of_map(name);
        }
        for name in quoted(&tests) {
            if !code.contains(&format!("fn {name}(")) {
                problems.push(format!("no test {name}"));
            }
        }
        for name in quoted(&stages) {
            if !STAGES.iter().any(|stage| stage.name == name) {
                problems.push(format!("no golden stage {name}"));
            }
        }
    }
    none(&problems);
}

/// Each function that the sentences of the paper are given is in the file named before it.
#[test]
fn sentences_of_the_paper_have_functions() {
    let map = read(&root().join("docs/paper_map.md"));
    let (mut problems, mut named) = (Vec::new(), 0);
    for row in table(&map, "Sentence by sentence") {
        for cell in &row[2..4] {
            let mut code = String::new();
            for name in quoted(cell) {
                if name.ends_with(".rs") {
                    code = read(&path_of_map(name));
                } else if !name.contains('.') {
                    named += 1;
                    if !has_function(&code, name) {
                        problems.push(format!("{}: no function {name}", row[1]));
                    }
                }
            }
        }
    }
    none(&problems);
    assert!(named > 40, "only {named} functions");
}
