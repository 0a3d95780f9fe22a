//! The documents against the code: every file, function, test, golden case, link and image named in them exists, and the
//! examples run.
//!
//! | file | what |
//! |---|---|
//! | `names` | files, links, images and parts of all documents |
//! | `pinned` | derivations, tests and golden cases that documents name |
//! | `paper_map` | the map from the paper |
//! | `by_hand` | the examples by hand that are no test elsewhere |
//! | `examples` | the programs in `examples` |

mod by_hand;
mod examples;
mod names;
mod paper_map;
mod pinned;

use std::fs;
use std::path::{Path, PathBuf};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn source() -> PathBuf {
    root().join("docs/book/src")
}

fn read(path: &Path) -> String {
    fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// File name and text of each page.
fn pages() -> Vec<(String, String)> {
    let mut pages: Vec<(String, String)> = fs::read_dir(source())
        .expect("the book's folder")
        .map(|entry| entry.expect("readable").path())
        .filter(|path| path.extension().is_some_and(|e| e == "md"))
        .map(|path| {
            let name = path.file_name().expect("a name").to_string_lossy();
            (name.into_owned(), read(&path))
        })
        .collect();
    pages.sort();
    pages
}

/// The pages without the preface.
fn chapters() -> Vec<(String, String)> {
    let mut pages = pages();
    pages.retain(|(name, _)| name != "README.md");
    assert!(pages.len() >= 16, "only {} chapters", pages.len());
    pages
}

/// Every file below a folder with one of these endings; build outputs and hidden folders are left out.
fn files_below(folder: &Path, endings: &[&str]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).expect("a folder") {
        let path = entry.expect("readable").path();
        let name = path.file_name().expect("a name").to_string_lossy();
        let is_wanted = |ending: &&str| path.extension().is_some_and(|e| e == *ending);
        if path.is_dir() && !name.starts_with('.') && !["target", "out"].contains(&&*name) {
            found.extend(files_below(&path, endings));
        } else if path.is_file() && endings.iter().any(is_wanted) {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// Path below the root and text of every Markdown file.
fn documents() -> Vec<(String, String)> {
    let files = files_below(root(), &["md"]);
    let named = files.into_iter().map(|path| {
        let name = path.strip_prefix(root()).expect("below the root");
        (name.to_string_lossy().into_owned(), read(&path))
    });
    let documents: Vec<_> = named.collect();
    assert!(documents.len() >= 40, "only {} documents", documents.len());
    documents
}

/// All Rust code, in one string.
fn rust_code() -> String {
    let folders = ["crates", "src", "tests", "benches", "examples"];
    let files = folders.map(|folder| files_below(&root().join(folder), &["rs"]));
    files.concat().iter().map(|path| read(path)).collect()
}

fn has_function(code: &str, name: &str) -> bool {
    ["(", "<"]
        .iter()
        .any(|end| code.contains(&format!("fn {name}{end}")))
}

/// What is between backticks, blocks of code left out.
fn quoted(text: &str) -> Vec<&str> {
    let prose = text.split("```").step_by(2);
    prose
        .flat_map(|part| part.split('`').skip(1).step_by(2))
        .collect()
}

/// Link targets, those of images included.
fn links(text: &str) -> Vec<&str> {
    let prose = text.split("```").step_by(2);
    prose
        .flat_map(|part| part.split("](").skip(1))
        .filter_map(|rest| rest.split(')').next())
        .collect()
}

/// The part of a chapter under a heading.
fn section<'t>(text: &'t str, heading: &str) -> Option<&'t str> {
    let start = text.find(&format!("\n## {heading}\n"))?;
    let body = &text[start + 4 + heading.len()..];
    Some(body.find("\n## ").map_or(body, |end| &body[..end]))
}

fn is_file_of_code(name: &str) -> bool {
    let kinds = [".rs", ".py", ".md", ".toml"];
    name.contains('/') && kinds.iter().any(|kind| name.ends_with(kind)) && !name.contains("//")
}

fn none(problems: &[String]) {
    assert!(problems.is_empty(), "\n{}", problems.join("\n"));
}
