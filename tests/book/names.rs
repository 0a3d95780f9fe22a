//! Files, links, images and parts of the documents.

use std::fs;
use std::path::{Component, Path, PathBuf};

use crate::{
    chapters, documents, is_file_of_code, links, none, pages, quoted, read, root, section, source,
};

const MAX_IMAGES_BYTES: u64 = 3 * 1024 * 1024;

/// `a/../b` as `b`.
fn tidy(path: &Path) -> PathBuf {
    let mut out = PathBuf::new();
    for part in path.components() {
        match part {
            Component::ParentDir => {
                out.pop();
            }
            part => out.push(part),
        }
    }
    out
}

/// In the history of changes old names are right; two documents leave out `crates/slam/src`.
#[test]
fn files_that_are_named_exist() {
    let mut problems = Vec::new();
    for (page, text) in documents() {
        if page == "CHANGELOG.md" {
            continue;
        }
        let folder = match page.as_str() {
            "docs/paper_map.md" | "ARCHITECTURE.md" => root().join("crates/slam/src"),
            _ => root().join(&page).parent().expect("a folder").to_owned(),
        };
        let is_named = |name: &&str| is_file_of_code(name) && !name.contains(['{', '*', ' ', '$']);
        for name in quoted(&text).into_iter().filter(is_named) {
            if !root().join(name).is_file() && !folder.join(name).is_file() {
                problems.push(format!("{page}: no file {name}"));
            }
        }
    }
    none(&problems);
}

#[test]
fn links_have_targets() {
    let mut problems = Vec::new();
    for (page, text) in documents() {
        for link in links(&text) {
            let local = link.split('#').next().unwrap_or_default();
            if link.starts_with("https://") || local.is_empty() {
                continue;
            }
            let folder = root().join(&page).parent().expect("a folder").to_owned();
            let target = tidy(&folder.join(local));
            if !target.starts_with(root()) || !target.exists() {
                problems.push(format!("{page}: {link} has no target"));
            }
        }
    }
    none(&problems);
}

/// Every document below docs, once, under its own title.
#[test]
fn the_summary_lists_every_document_once() {
    let summary = read(&root().join("docs/SUMMARY.md"));
    let listed = links(&summary);
    let mut problems = Vec::new();
    for (page, text) in documents() {
        let Some(path) = page.strip_prefix("docs/").filter(|p| *p != "SUMMARY.md") else {
            continue;
        };
        let times = listed.iter().filter(|link| **link == path).count();
        if times != 1 {
            problems.push(format!("{page}: {times} times in the summary"));
        }
        let title = text.lines().next().unwrap_or_default();
        if !title.starts_with("# ") {
            problems.push(format!("{page}: starts without a title"));
        } else if times == 1 && !summary.contains(&format!("[{}]", &title[2..])) {
            problems.push(format!("{page}: the summary has another title"));
        }
    }
    none(&problems);
}

#[test]
fn chapters_have_their_parts() {
    let mut problems = Vec::new();
    for (page, text) in chapters() {
        let mut parts = vec!["By hand", "Read", "Pinned by"];
        if page != "porting.md" {
            parts.push("On a GPU");
        }
        for part in parts {
            if section(&text, part).is_none_or(|body| body.len() < 100) {
                problems.push(format!("{page}: no section \"{part}\""));
            }
        }
    }
    none(&problems);
}

#[test]
fn images_exist_are_small_and_used() {
    let all: String = pages().into_iter().map(|(_, text)| text).collect();
    let mut bytes = 0;
    for entry in fs::read_dir(source().join("images")).expect("images") {
        let path = entry.expect("readable").path();
        let name = path.file_name().expect("a name").to_string_lossy();
        assert!(all.contains(&format!("](images/{name})")), "{name}: unused");
        let file = fs::read(&path).expect("readable");
        assert!(image::load_from_memory(&file).is_ok(), "{name}: no image");
        bytes += file.len() as u64;
    }
    assert!(bytes > 0, "no image at all");
    assert!(bytes <= MAX_IMAGES_BYTES, "{bytes} bytes of images");
}
