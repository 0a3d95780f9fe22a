//! The judge of `python/garad_golden` against this one: the same verdict, worst element, bound and advice for right answers,
//! for answers at the edge of every tolerance, for files that are none, and for every faulty port.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use garad_conformance::Width;
use garad_golden::answers::{Answers, read_answers};
use garad_golden::judge::judge;
use garad_golden::{Case, npy, report, stages as order};
use serde_json::{Value, json};
use tempfile::TempDir;

use super::answers::{Given, shaped};
use super::perturbed::PERTURBATIONS;
use super::raster::Renderer;
use super::second::Sum;
use super::{raster, rendering, second, stages, with_own};

/// `python3` with the package's sources, or what the variable names.
fn python() -> Command {
    let named = std::env::var_os("GARAD_PYTHON").unwrap_or_else(|| "python3".into());
    let mut command = Command::new(named);
    command.env("PYTHONPATH", package().join("src"));
    command
}

fn package() -> PathBuf {
    Case::root().join("../../python/garad_golden")
}

/// In the order of the data.
fn cases(root: &Path) -> Vec<Case> {
    let mut cases = Case::load_root(root).expect("sound cases");
    cases.sort_by_key(|c| (order::rank(c.stage()), c.name()));
    cases
}

/// SET/STAGE/CASE under a folder.
struct Sets<'a>(&'a Path);

impl Sets<'_> {
    fn folder(&self, set: &str, case: &Case) -> PathBuf {
        let folder = self.0.join(set).join(case.stage()).join(case.case());
        fs::create_dir_all(&folder).expect("made");
        folder
    }

    fn put(&self, set: &str, case: &Case, answers: &Answers) {
        let folder = self.folder(set, case);
        for (name, tensor) in answers {
            let file = npy::encode(tensor.as_ref().expect("a port that answers"));
            fs::write(folder.join(format!("{name}.npy")), file).expect("written");
        }
    }

    /// Our own stages in both widths.
    fn own(&self, cases: &[Case]) {
        for (set, width) in [("own", Width::F64), ("own_f32", Width::F32)] {
            for case in cases {
                let answer = garad_conformance::answer(case.inputs(), width).expect("a sound case");
                self.put(set, case, &answer.expect("a stage of garad").answers());
            }
        }
    }

    fn perturbed(&self, cases: &[Case]) {
        for (set, _, answer) in PERTURBATIONS {
            for case in cases {
                let folder = self.folder(set, case);
                for name in case.outputs().keys() {
                    if let Some(file) = answer(case, name) {
                        fs::write(folder.join(format!("{name}.npy")), file).expect("written");
                    }
                }
            }
        }
    }

    fn faulty(&self) {
        for case in super::cases(&raster::STAGES) {
            for port in rendering::FAULTY_PORTS {
                let answer = Renderer::faulty(port.fault).answer(Given(case.inputs()));
                self.put(&format!("{:?}", port.fault), &case, &shaped(&case, &answer));
            }
        }
        for group in stages::GROUPS {
            let (cases, own) = with_own(group);
            for port in second::FAULTY_PORTS
                .iter()
                .filter(|port| group.contains(&port.stage))
            {
                let how = second::How {
                    fault: Some(port.fault),
                    sum: Sum::Forwards,
                };
                for (case, own) in cases.iter().zip(&own) {
                    let answer = stages::answer(Given(case.inputs()), own, &how);
                    self.put(&format!("{:?}", port.fault), case, &shaped(case, &answer));
                }
            }
        }
    }

    fn names(&self) -> Vec<String> {
        let entries = fs::read_dir(self.0)
            .expect("a folder")
            .map(|e| e.expect("readable"));
        let mut names: Vec<String> = entries
            .filter(|e| e.path().is_dir())
            .map(|e| e.file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    /// Where the two judges differ.
    fn judged_otherwise(&self, root: &Path, cases: &[Case]) -> Vec<String> {
        let script = package().join("tests/judge_folders.py");
        let run = python().arg(script).arg(root).arg(self.0).output();
        let run = run.expect("python3 starts");
        if !run.status.success() {
            return vec![String::from_utf8_lossy(&run.stderr).into_owned()];
        }
        let mut wrong = Vec::new();
        for set in self.names() {
            let text = fs::read_to_string(self.0.join(format!("{set}.json")));
            let theirs = serde_json::from_str(&text.expect("written")).expect("JSON");
            let [ours, theirs] = [self.report(&set, cases), theirs].map(without_own_notes);
            differences(&ours, &theirs, &set, &mut wrong);
        }
        wrong
    }

    /// This judge's report, as the command writes it.
    fn report(&self, set: &str, cases: &[Case]) -> Value {
        let lenient = set.starts_with("lenient_");
        let folder = self.0.join(set);
        let there = cases.iter().filter(|c| folder.join(c.stage()).is_dir());
        let verdict = |case: &Case| {
            let answers = read_answers(case, &folder.join(case.stage()).join(case.case()));
            judge(case, &answers, lenient)
        };
        let verdicts: Vec<_> = there.map(verdict).collect();
        let passed = !verdicts.iter().any(|v| v.fails(lenient));
        report::to_json(&verdicts, passed)
    }
}

/// Notes that only one of the two judges makes: which mistake it is, what a library says of a file, the rows themselves.
fn without_own_notes(mut report: Value) -> Value {
    let cases = report["cases"].as_array_mut().expect("a list");
    for output in cases
        .iter_mut()
        .flat_map(|c| c["outputs"].as_array_mut().expect("a list"))
    {
        let note = output["note"].as_str().unwrap_or_default();
        let rows = note
            .find(" rows are missing")
            .map(|end| note[..end].to_owned());
        let own = note.starts_with("fits, if")
            || output["verdict"] == "unreadable"
            || note.starts_with("every number");
        if own || rows.is_some() {
            output["note"] = Value::from(rows);
        }
    }
    report
}

/// The first places where two documents differ.
fn differences(ours: &Value, theirs: &Value, at: &str, out: &mut Vec<String>) {
    match (ours, theirs) {
        (Value::Object(a), Value::Object(b)) => {
            let keys: BTreeSet<&String> = a.keys().chain(b.keys()).collect();
            for key in keys {
                let of =
                    |o: &serde_json::Map<String, Value>| o.get(key).cloned().unwrap_or(Value::Null);
                differences(&of(a), &of(b), &format!("{at}/{key}"), out);
            }
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            for (i, (a, b)) in a.iter().zip(b).enumerate() {
                differences(a, b, &format!("{at}/{i}"), out);
            }
        }
        _ if ours == theirs => (),
        _ => out.push(format!("{at}: {ours} here, {theirs} in Python")),
    }
}

fn verdicts(report: &Value) -> BTreeSet<&str> {
    let cases = report["cases"].as_array().expect("a list").iter();
    let outputs = cases.flat_map(|c| c["outputs"].as_array().expect("a list"));
    outputs
        .map(|o| o["verdict"].as_str().expect("a word"))
        .collect()
}

#[test]
#[ignore = "needs python3 with numpy: .ci/run has a virtual environment for it (GARAD_PYTHON names the interpreter)"]
fn the_judge_in_python_gives_the_same_verdicts() {
    let temporary = TempDir::new().expect("a folder");
    let (sets, cases) = (Sets(temporary.path()), cases(&Case::root()));
    sets.own(&cases);
    sets.perturbed(&cases);
    sets.faulty();
    let names = sets.names();
    assert!(
        names.len() >= 165 + PERTURBATIONS.len() + 2,
        "only {} sets",
        names.len()
    );
    let mut wrong = sets.judged_otherwise(&Case::root(), &cases);
    for (set, words, _) in PERTURBATIONS {
        let report = sets.report(set, &cases);
        let seen = verdicts(&report);
        let absent = words.split(' ').filter(|word| !seen.contains(word));
        wrong.extend(absent.map(|word| format!("{set}: no {word} in {seen:?}")));
    }
    report_all(wrong, temporary);
}

/// Tolerances of classes that committed cases have few or none of: which takes which one's place.
const IN_PLACE: [(&str, &str); 4] = [
    ("raster_backward.gradient", "raster_backward.rows"),
    ("lk.xy", "ulp1"),
    ("lk.residual", "ulp1"),
    ("sh.basis", "ulp1"),
];

/// The classes ulp, of f32 and of f64, and rows: with scales of the rows, without, and with too many; masks of one output, and
/// the budgets of a flag.
#[test]
#[ignore = "needs python3 with numpy: .ci/run has a virtual environment for it (GARAD_PYTHON names the interpreter)"]
fn other_classes_are_judged_alike_in_python() {
    let temporary = TempDir::new().expect("a folder");
    let (root, answers) = (
        temporary.path().join("cases"),
        temporary.path().join("answers"),
    );
    for (i, case) in super::cases(&["raster", "raster_backward", "lk", "sh"])
        .iter()
        .enumerate()
    {
        let folder = root.join(case.name());
        fs::create_dir_all(&folder).expect("made");
        for entry in fs::read_dir(case.folder()).expect("read before") {
            let path = entry.expect("readable").path();
            fs::copy(&path, folder.join(path.file_name().expect("a name"))).expect("copied");
        }
        let path = folder.join("case.json");
        let mut text = fs::read_to_string(&path).expect("read before");
        for (from, to) in IN_PLACE {
            text = text.replace(&format!("\"{from}\""), &format!("\"{to}\""));
        }
        let mut manifest: Value = serde_json::from_str(&text).expect("JSON");
        if i % 2 == 0 {
            manifest["flags"] = json!(["made"]);
        }
        let mask = manifest["inputs"]["robust"].take();
        let inputs = manifest["inputs"].as_object_mut().expect("by name");
        inputs.remove("robust");
        if !mask.is_null() {
            let name = if i % 3 == 0 { "robust_color" } else { "robust" };
            inputs.insert(name.to_owned(), mask);
        }
        for (name, output) in case.outputs() {
            let rows = output.shape().first().copied().unwrap_or(1) + usize::from(i % 3 == 2);
            let scales: Vec<f64> = (0..rows).map(|row| 0.5 * (row % 3) as f64).collect();
            if i % 3 > 0 {
                manifest["inputs"][format!("scale_{name}")] =
                    json!({ "dtype": "f64", "shape": [rows], "unit": "1", "data": scales });
            }
        }
        fs::write(&path, manifest.to_string()).expect("written");
    }
    let cases = cases(&root);
    let sets = Sets(&answers);
    sets.perturbed(&cases);
    let mut wrong = sets.judged_otherwise(&root, &cases);
    let words = |set: &str| -> Vec<String> {
        let report = sets.report(set, &cases);
        verdicts(&report).into_iter().map(str::to_owned).collect()
    };
    for (set, seen) in [
        ("right", "pass"),
        ("right", "shape"),
        ("one_outside", "fail"),
    ] {
        if !words(set).iter().any(|word| word == seen) {
            wrong.push(format!("{set}: no {seen} in {:?}", words(set)));
        }
    }
    report_all(wrong, temporary);
}

/// Fails with the first problems; the answers are kept to look at.
fn report_all(mut wrong: Vec<String>, answers: TempDir) {
    wrong.truncate(40);
    if !wrong.is_empty() {
        panic!(
            "{}\nanswers: {}",
            wrong.join("\n"),
            answers.keep().display()
        );
    }
}

/// Both commands with the same arguments: exit code and report, or for a wrong command what they say.
#[test]
#[ignore = "needs python3 with numpy: .ci/run has a virtual environment for it (GARAD_PYTHON names the interpreter)"]
fn the_command_in_python_ends_alike() {
    let temporary = TempDir::new().expect("a folder");
    let own = temporary.path().join("own");
    let garad = env!("CARGO_BIN_EXE_garad");
    let own = own.to_str().expect("UTF-8");
    let made = Command::new(garad)
        .args([
            "golden", "check", "--stage", "sh", "--stage", "losses", "--keep", own,
        ])
        .args([
            "--exec",
            &format!("'{garad}' golden answer {{case}} {{out}}"),
        ])
        .output()
        .expect("the program starts");
    assert!(made.status.success(), "{made:?}");
    let port = format!("'{garad}' golden answer {{case}} {{out}}");
    let nothing = format!("'{garad}' --version");
    let dead = format!("'{garad}' frobnicate");
    let answers = ["check", "--actual", own];
    let runs: &[(&[&str], &[&str], i32)] = &[
        (&answers, &["--stage", "sh"], 0),
        (&answers, &["--stage", "sh", "--stage", "raster"], 1),
        (
            &answers,
            &["--stage", "sh", "--stage", "raster", "--allow-missing"],
            0,
        ),
        (&answers, &["--tag", "flat"], 0),
        (&answers, &["--case", "one"], 1),
        (&answers, &["--stage", "rasta"], 2),
        (&answers, &["--stage", "sh", "--case", "none"], 2),
        (&answers, &["--cases", "/nowhere"], 2),
        (&["check", "--actual", "/nowhere"], &[], 2),
        (&["check"], &[], 2),
        (&["check", "--exec", &port], &["--stage", "adam"], 0),
        (&["check", "--exec", "false"], &["--stage", "adam"], 1),
        (&["check", "--exec", &nothing], &["--stage", "adam"], 1),
        (&["check", "--exec", &dead], &["--stage", "adam"], 1),
        (
            &["check", "--exec", "sh -c 'exit 77'"],
            &["--stage", "adam"],
            0,
        ),
        (
            &["check", "--exec", "sleep 60", "--timeout", "0.2"],
            &["--stage", "sh"],
            1,
        ),
        (&["check", "--exec", "a 'b"], &[], 2),
        (&["check", "--exec", "/nowhere/port"], &["--stage", "sh"], 2),
        (&["check", "--exec", "true", "--timeout", "0"], &[], 2),
    ];
    for (command, rest, code) in runs {
        let report = |name: &str, mut program: Command| -> (Option<i32>, Option<Value>) {
            let path = temporary.path().join(name);
            let _ = fs::remove_file(&path);
            let all = program.args(*command).args(*rest).arg("--json").arg(&path);
            let Output { status, stderr, .. } = all.output().expect("starts");
            let said = String::from_utf8_lossy(&stderr);
            assert!(!said.contains("Traceback"), "{command:?} {rest:?}: {said}");
            let text = fs::read_to_string(&path).ok();
            (
                status.code(),
                text.map(|t| serde_json::from_str(&t).expect("JSON")),
            )
        };
        let mut ours = Command::new(garad);
        ours.arg("golden");
        let mut theirs = python();
        theirs.args(["-m", "garad_golden"]);
        let (ours, theirs) = (report("ours.json", ours), report("theirs.json", theirs));
        assert_eq!(
            (ours.0, theirs.0),
            (Some(*code), Some(*code)),
            "{command:?} {rest:?}"
        );
        let mut wrong = Vec::new();
        let (ours, theirs) = (ours.1.unwrap_or_default(), theirs.1.unwrap_or_default());
        differences(&ours, &theirs, "", &mut wrong);
        // The reasons of a crash are each program's words.
        wrong.retain(|w| !w.contains("/reason: "));
        assert!(
            wrong.is_empty(),
            "{command:?} {rest:?}: {}",
            wrong.join("\n")
        );
    }
}
