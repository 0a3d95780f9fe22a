//! The readers for C++ and Node, and the ports written with them: they read every input of every case, and their stage
//! passes. Each is skipped, with a word, where there is no compiler or no Node.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use garad_golden::{Case, npy};
use tempfile::TempDir;

use crate::support::program;

fn ports() -> PathBuf {
    Case::root().join("../../ports")
}

/// The first of these programs that there is.
fn found(names: &[&str]) -> Option<String> {
    let starts = |name: &&&str| {
        let version = Command::new(name).arg("--version").output();
        version.is_ok_and(|output| output.status.success())
    };
    let found = names.iter().find(starts).map(|name| (*name).to_owned());
    if found.is_none() {
        eprintln!("skipped: none of {names:?}");
    }
    found
}

fn run(command: &mut Command) {
    let output = command.output().expect("it was started before");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.success() && said.is_empty(),
        "{command:?}: {said}"
    );
}

fn compiled(compiler: &str, source: &str, folder: &Path) -> PathBuf {
    let out = folder.join(source.trim_end_matches(".cpp"));
    let warnings = ["-Wall", "-Wextra", "-Wpedantic", "-Werror"];
    let mut command = Command::new(compiler);
    command
        .args(["-std=c++17", "-ffp-contract=off"])
        .args(warnings);
    run(command
        .arg(ports().join("cpp").join(source))
        .arg("-o")
        .arg(&out));
    out
}

/// Every input of every case, read and written again, is what it was.
fn reads_every_input(mut reader: Command) {
    let folder = TempDir::new().expect("a folder");
    let cases = Case::load_root(&Case::root()).expect("committed");
    let out = |case: &Case| folder.path().join(case.name());
    for case in &cases {
        fs::create_dir_all(out(case)).expect("made");
        reader.arg(case.folder()).arg(out(case));
    }
    run(&mut reader);
    let mut read = 0;
    for case in &cases {
        for (name, input) in case.inputs().tensors() {
            let file = fs::read(out(case).join(format!("{name}.npy"))).expect("written");
            let again = npy::decode(&file).expect("a file of numpy");
            let bits = |values: Vec<f64>| {
                values
                    .into_iter()
                    .map(|v| if v.is_nan() { u64::MAX } else { v.to_bits() })
                    .collect::<Vec<_>>()
            };
            assert_eq!(again.shape(), input.shape(), "{} {name}", case.name());
            assert_eq!(
                bits(again.f64()),
                bits(input.f64()),
                "{} {name}",
                case.name()
            );
            read += 1;
        }
    }
    assert!(read >= 776, "only {read} inputs");
}

/// `sh` passes, as a stage of this type; another stage is not done.
fn passes(port: &str, dtype: &str) {
    let check = [
        "golden", "check", "--stage", "sh", "--stage", "decode", "--exec",
    ];
    let output = program()
        .args(check)
        .arg(format!("{port} {{case}} {{out}}"))
        .output();
    let output = output.expect("the program starts");
    let said = String::from_utf8_lossy(&output.stdout);
    let words = ["2 pass", &format!("({dtype})"), "unsupported: decode"];
    let named = words.iter().all(|word| said.contains(word));
    assert!(output.status.success() && named, "{port}: {said}");
}

#[test]
fn the_port_in_cpp_passes() {
    let Some(compiler) = found(&["c++", "g++", "clang++"]) else {
        return;
    };
    let folder = TempDir::new().expect("a folder");
    let port = compiled(&compiler, "sh.cpp", folder.path());
    passes(&format!("'{}'", port.display()), "f32");
    reads_every_input(Command::new(compiled(
        &compiler,
        "inputs.cpp",
        folder.path(),
    )));
}

#[test]
fn the_port_for_node_passes() {
    let Some(node) = found(&["node"]) else {
        return;
    };
    let script = |name: &str| ports().join("node").join(name);
    passes(&format!("'{node}' '{}'", script("sh.mjs").display()), "f64");
    let mut reader = Command::new(node);
    reader.arg(script("inputs.mjs"));
    reads_every_input(reader);
}
