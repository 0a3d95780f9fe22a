use std::fs;
use std::path::Path;

use tempfile::TempDir;

use super::*;

fn folder() -> TempDir {
    tempfile::tempdir().expect("temporary folder")
}

/// One run of `command` that writes these files, each with its own name as content.
fn written(root: &Path, command: &str, names: &[&str]) -> Result<()> {
    let mut out = ResultFolder::open(root, command).expect("a folder that can be written");
    for name in names {
        out.bytes(name, name.as_bytes());
    }
    out.finish()
}

/// Every file and empty folder below `root`, without the lists.
fn names(root: &Path) -> Vec<String> {
    let mut found = Vec::new();
    let mut left = vec![root.to_path_buf()];
    while let Some(folder) = left.pop() {
        let entries: Vec<_> = fs::read_dir(&folder).expect("a folder").collect();
        let is_empty = entries.is_empty() && folder != root;
        let paths = entries.into_iter().map(|e| e.expect("an entry").path());
        for path in paths.chain(is_empty.then(|| folder.clone())) {
            if path.symlink_metadata().expect("there").is_dir() && path != folder {
                left.push(path);
            } else if !path.ends_with(LIST) {
                let name = path.strip_prefix(root).expect("below the root");
                found.push(name.to_str().expect("UTF-8").replace('\\', "/"));
            }
        }
    }
    found.sort();
    found
}

#[test]
fn a_second_run_leaves_nothing_of_the_first() {
    let out = folder();
    let root = out.path();
    written(root, "run", &["a", "labels/masks/1.png", "labels/b"]).expect("written");
    for mine in ["notes", "labels/notes", "pictures/mine.png"] {
        make_folder(root.join(mine).parent().expect("a folder")).expect("made");
        fs::write(root.join(mine), "mine").expect("written");
    }
    written(root, "render", &["000000_color.png"]).expect("written");
    written(root, "run", &["a", "c"]).expect("written");
    let left = [
        "000000_color.png",
        "a",
        "c",
        "labels/notes",
        "notes",
        "pictures/mine.png",
    ];
    assert_eq!(
        names(root),
        left,
        "other commands' and the user's files stay"
    );
    written(root, "render", &["000001_color.png"]).expect("written");
    assert_eq!(names(root)[0], "000001_color.png", "replaced");
    assert_eq!(
        names(root).len(),
        left.len(),
        "and what the run wrote stays"
    );
}

#[test]
fn until_the_first_file_is_written_nothing_is_removed() {
    let out = folder();
    let root = out.path();
    written(root, "run", &["a", "b"]).expect("written");
    drop(ResultFolder::open(root, "run").expect("tried"));
    ResultFolder::open(root, "run")
        .and_then(ResultFolder::finish)
        .expect("nothing to write");
    let mut failing = ResultFolder::open(root, "run").expect("tried");
    failing.write("a", |_| bail!("no space"));
    failing.finish().expect_err("not written");
    assert_eq!(names(root), ["a", "b"], "as they were");
    // Killed after its first file.
    let mut killed = ResultFolder::open(root, "run").expect("tried");
    killed.bytes("labels/c", b"");
    drop(killed);
    assert_eq!(names(root), ["a", "b", "labels/c"], "old and new");
    written(root, "run", &["d"]).expect("written");
    assert_eq!(names(root), ["d"], "the next one knows them all");
}

#[test]
fn with_settings_another_set_is_removed_first() {
    let out = folder();
    let root = out.path();
    let begun = |settings: &str| {
        let synth = ResultFolder::open(root, "synth").expect("tried");
        let mut synth = synth.of(settings);
        synth.bytes("rgb/0.png", b"");
        synth
    };
    let mut first = begun("walking");
    first.bytes("mask/0.png", b"");
    first.bytes("rgb.txt", b"");
    first.finish().expect("written");
    drop(begun("walking"));
    assert_eq!(
        names(root),
        ["mask/0.png", "rgb.txt", "rgb/0.png"],
        "the same scene"
    );
    drop(begun("crowd"));
    assert_eq!(names(root), ["rgb/0.png"], "another one");
}

#[cfg(target_os = "linux")]
#[test]
fn what_a_killed_program_left_of_a_file_is_removed() {
    let out = folder();
    let root = out.path();
    drop({
        let mut killed = ResultFolder::open(root, "run").expect("tried");
        killed.bytes("labels/a", b"");
        killed
    });
    // The largest number of a process on Linux is 2^22.
    let (nobody, running) = (4_194_305, std::process::id());
    for (file, process) in [("a", nobody), ("a", running), ("b", nobody)] {
        fs::write(root.join(format!("labels/.{file}.part{process}")), "half").expect("written");
    }
    written(root, "run", &["c"]).expect("written");
    let left = ["labels/.a.part", "labels/.b.part"];
    let left = [
        "c".to_owned(),
        format!("{}{running}", left[0]),
        format!("{}{nobody}", left[1]),
    ];
    assert_eq!(names(root), left, "of a running program, or not listed");
}

/// Entries of the list that garad would not write remove nothing.
#[test]
fn a_list_that_was_changed_removes_nothing_elsewhere() {
    let out = folder();
    let root = out.path().join("out");
    written(&root, "run", &["a"]).expect("written");
    fs::write(out.path().join("outside"), "").expect("written");
    fs::create_dir_all(root.join("kept")).expect("made");
    let absolute = out.path().join("outside");
    let absolute = absolute.to_str().expect("UTF-8");
    let mut list = fs::read_to_string(root.join(LIST)).expect("a list");
    for name in [
        "../outside",
        absolute,
        "kept",
        ".",
        "",
        LIST,
        "kept/../../outside",
    ] {
        list += &format!("run {name}\n");
    }
    list += "run cut_of"; // the program was killed here
    fs::write(root.join("cut_of"), "").expect("written");
    fs::write(root.join(LIST), list).expect("written");
    written(&root, "run", &["b"]).expect("written");
    assert_eq!(names(&root), ["b", "cut_of", "kept"], "only `a` is removed");
    assert!(out.path().join("outside").exists(), "outside");
    let list = fs::read_to_string(root.join(LIST)).expect("a list");
    assert_eq!(list, format!("{HEADER}\nrun b\n"), "what was written");
    fs::write(root.join(LIST), "my own list\n").expect("written");
    let error = ResultFolder::open(&root, "run").expect_err("not ours");
    assert!(error.to_string().contains(LIST), "{error}");
}

#[cfg(unix)]
#[test]
fn links_are_not_followed() {
    let out = folder();
    let (root, other) = (out.path().join("out"), out.path().join("other"));
    written(&root, "run", &["labels/a", "b"]).expect("written");
    written(&other, "run", &["a"]).expect("written");
    fs::remove_dir_all(root.join("labels")).expect("removed");
    fs::remove_file(root.join("b")).expect("removed");
    std::os::unix::fs::symlink(&other, root.join("labels")).expect("linked");
    std::os::unix::fs::symlink(other.join("a"), root.join("b")).expect("linked");
    written(&root, "run", &["c"]).expect("written");
    assert_eq!(names(&root), ["b", "c", "labels"], "the links stay");
    assert!(other.join("a").exists(), "what they point at, too");
}

#[test]
fn all_files_that_fail_are_named_and_the_others_written() {
    let out = folder();
    let root = out.path();
    written(root, "run", &["map.ply", "old"]).expect("written");
    let mut failing = ResultFolder::open(root, "run").expect("tried");
    for name in ["map.ply", "labels/b"] {
        failing.write(name, |_| bail!("no space"));
    }
    fs::create_dir_all(root.join("c/full")).expect("made");
    failing.bytes("c", b"");
    failing.bytes("d", b"");
    assert!(failing.has_failed(), "already");
    let error = failing.finish().expect_err("three").to_string();
    for words in ["3 files", "map.ply, labels/b: no space", "c: "] {
        assert!(error.contains(words), "`{words}` in {error}");
    }
    assert_eq!(
        names(root),
        ["c/full", "d", "labels"],
        "the older map is not beside the new files"
    );
    let mut one = ResultFolder::open(root, "run").expect("tried");
    one.write("map.ply", |_| bail!("no space"));
    let error = reason(&one.finish().expect_err("one"));
    let path = root.join("map.ply");
    assert_eq!(error, format!("{}: no space", path.display()), "its path");
}

/// A comparison and the runs in it.
#[test]
fn folders_of_runs_belong_to_the_comparison() {
    let out = folder();
    let root = out.path();
    let compare = |runs: &[(&str, &str)]| {
        let mut out = ResultFolder::open(root, "compare").expect("tried");
        for (name, file) in runs {
            let mut run = out.child(name).expect("a folder");
            run.bytes(file, b"");
            run.finish().expect("written");
        }
        out.bytes("compare.md", b"");
        out.finish().expect("written");
    };
    compare(&[("full", "a"), ("other", "labels/a")]);
    fs::write(root.join("full/notes"), "").expect("written");
    written(&root.join("other"), "render", &["picture"]).expect("written");
    written(&root.join("other"), "run", &["b"]).expect("written");
    compare(&[("full", "b")]);
    let expected = ["compare.md", "full/b", "full/notes", "other/picture"];
    assert_eq!(names(root), expected, "one run less");
    compare(&[("third", "a")]);
    let expected = ["compare.md", "full/notes", "other/picture", "third/a"];
    assert_eq!(names(root), expected, "another one");
    written(&root.join("other"), "render", &[]).expect("nothing");
    let list = fs::read_to_string(root.join("other").join(LIST)).expect("a list");
    assert!(list.ends_with("\nrender picture\n"), "{list}");
}
