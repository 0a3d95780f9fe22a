//! The programs in `examples` run, and use the book's numbers.

use std::fs;
use std::process::Command;

use crate::{none, read, root, source};

/// Runs an example of this package, built as the tests are; what it printed.
fn run_example(name: &str, args: &[&str]) -> String {
    let mut cargo = Command::new(env!("CARGO"));
    cargo
        .current_dir(root())
        .args(["run", "--quiet", "--offline"]);
    if !cfg!(debug_assertions) {
        cargo.arg("--release");
    }
    cargo.args(["--example", name, "--"]).args(args);
    let output = cargo.output().expect("cargo starts");
    let error = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{name}: {error}");
    String::from_utf8(output.stdout).expect("text")
}

/// The last number of the line that holds `words`.
fn number_after(text: &str, words: &str) -> f64 {
    let line = text.lines().find(|line| line.contains(words));
    let line = line.unwrap_or_else(|| panic!("no line with {words:?}:\n{text}"));
    let rest = line.split(words).nth(1).unwrap_or_default();
    let word = rest.split_whitespace().next().unwrap_or_default();
    let number = word.trim_end_matches([',', ':']).parse();
    number.unwrap_or_else(|_| panic!("no number after {words:?}:\n{text}"))
}

/// The numbers in a text. A superscript is a number of its own, ½ is 0.5.
fn numbers(text: &str) -> Vec<f64> {
    let mut plain = String::new();
    let mut raised = false;
    for c in text.replace('½', " 0.5 ").chars() {
        let digit = "⁰¹²³⁴⁵⁶⁷⁸⁹".chars().position(|s| s == c);
        if raised != digit.is_some() {
            plain.push(' ');
        }
        raised = digit.is_some();
        match digit {
            Some(d) => plain.push_str(&d.to_string()),
            None => plain.push(c),
        }
    }
    let word = |c: char| !(c.is_alphanumeric() || ".-_".contains(c));
    let mut found = Vec::new();
    for word in plain.split(word) {
        // A minus belongs to an exponent or to nothing.
        let whole = word.trim_matches(['-', '.']).parse::<f64>();
        match whole {
            Ok(number) => found.push(number.abs()),
            Err(_) => {
                let parts = word.split('-');
                found.extend(parts.filter_map(|part| part.trim_matches('.').parse::<f64>().ok()));
            }
        }
    }
    found
}

#[test]
fn numbers_are_found() {
    let text = "T < 1e-4, 0.01² px, 2⁻²⁰, ½ of x_3, 16-bit, (2y2) k = -5..5.";
    let expected = [1e-4, 0.01, 2.0, 2.0, 20.0, 0.5, 16.0];
    let found = numbers(text);
    assert!(
        expected.iter().all(|e| found.contains(e)) && !found.contains(&3.0),
        "{found:?}"
    );
}

/// Python without its strings of several lines and its comments.
fn code_of(python: &str) -> String {
    let outside = python.split("\"\"\"").step_by(2);
    let lines = outside.flat_map(str::lines);
    let code = lines.filter_map(|line| line.split('#').next());
    code.collect::<Vec<_>>().join("\n")
}

/// The port in numpy is written from the book alone: each of its thresholds, factors and taps is in the chapters
/// of its file. Numbers below 10 without a fraction are indices as often as not.
#[test]
fn the_book_states_every_number_of_the_example_port() {
    let mut problems = Vec::new();
    for (file, named) in [
        ("harmonics", ["splatting", "backward"]),
        ("splats", ["splatting", "backward"]),
        ("render", ["splatting", "backward"]),
        ("losses", ["losses", "losses"]),
        ("adam", ["training", "training"]),
        ("train", ["training", "losses"]),
        ("flow", ["lucas_kanade", "features"]),
    ] {
        let stated: Vec<f64> = named
            .iter()
            .flat_map(|chapter| numbers(&read(&source().join(format!("{chapter}.md")))))
            .collect();
        let path = root().join(format!("examples/adapter_numpy/{file}.py"));
        let used = numbers(&code_of(&read(&path)));
        assert!(used.len() > 3, "{file}: {used:?}");
        for number in used {
            let small = number < 10.0 && number.fract().abs() < f64::EPSILON;
            if !small && !stated.iter().any(|s| s.total_cmp(&number).is_eq()) {
                problems.push(format!("{file}.py has {number}, its chapters do not"));
            }
        }
    }
    none(&problems);
}

#[test]
fn the_examples_run_and_print_what_they_should() {
    let text = run_example("track_two_frames", &[]);
    assert!(
        number_after(&text, "with depth,") > 150.0,
        "inliers:\n{text}"
    );
    assert!(
        number_after(&text, "the pose is off by") < 10.0,
        "mm:\n{text}"
    );

    let text = run_example("solve_pnp", &[]);
    assert!(number_after(&text, "matches that agree:") > 50.0, "{text}");
    assert!(number_after(&text, "pose is off by") < 5.0, "mm:\n{text}");

    let text = run_example("run_crf", &[]);
    let alone = number_after(&text, "alone,");
    let together = number_after(&text, "after asking the neighbours,");
    assert!(together < 0.4 * alone, "the field helps:\n{text}");

    let text = run_example("check_gradient", &[]);
    for name in [
        "means",
        "log-scales",
        "quaternions",
        "opacities",
        "harmonics",
        "pose",
    ] {
        let row = text.lines().find(|line| line.starts_with(name));
        let worst = row.and_then(|row| row.split_whitespace().last()?.parse::<f64>().ok());
        assert!(worst.is_some_and(|worst| worst < 1e-6), "{name}:\n{text}");
    }

    let text = run_example("render_ply", &[]);
    assert!(text.contains("120 of them visible"), "{text}");
    assert!(
        text.lines().any(|line| line.contains('@')),
        "an image:\n{text}"
    );
}

/// The committed images are those of today's code, byte for byte.
#[test]
#[ignore = "ten seconds in a release build, minutes in a debug build"]
fn images_are_those_of_the_code() {
    let folder = tempfile::tempdir().expect("a folder");
    run_example("book_pictures", &[folder.path().to_str().expect("UTF-8")]);
    for entry in fs::read_dir(source().join("images")).expect("images") {
        let name = entry.expect("readable").file_name();
        let fresh = fs::read(folder.path().join(&name)).expect("drawn");
        let committed = fs::read(source().join("images").join(&name)).expect("readable");
        assert!(fresh == committed, "{}: draw it again", name.display());
    }
}
