//! `garad golden`: ports that are right, wrong, slow, silent or dead.

use std::fs;
use std::path::Path;
use std::process::Command;

use garad_golden::{Dtype, Tensor, npy};
use serde_json::Value;
use tempfile::TempDir;

use crate::support::{arg, garad, program};

/// Runs `garad golden`; exit code and everything it said.
fn golden(args: &[&str]) -> (i32, String) {
    let output = program().arg("golden").args(args).output();
    let output = output.expect("the program starts");
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let said = text(&output.stdout) + &text(&output.stderr);
    assert!(!said.contains("panicked"), "{said}");
    (output.status.code().expect("no signal"), said)
}

/// The cases of the checkout.
fn cases() -> String {
    format!("{}/tests/golden", env!("CARGO_MANIFEST_DIR"))
}

/// This program as a port of its own, by `--exec`.
fn ourselves(rest: &str) -> String {
    format!("'{}' {rest}", env!("CARGO_BIN_EXE_garad"))
}

/// A folder that holds a right answer to one case.
fn answered(stage: &str, case: &str) -> TempDir {
    let folder = TempDir::new().expect("a folder");
    let out = folder.path().join(stage).join(case);
    let from = format!("{}/{stage}/{case}", cases());
    let (code, said) = golden(&["answer", &from, arg(&out)]);
    assert_eq!(code, 0, "{said}");
    folder
}

/// Replaces one output by what `change` makes of it.
fn damage(path: &Path, change: impl Fn(usize, f64) -> f64) {
    let tensor = npy::decode(&fs::read(path).expect("there")).expect("as written");
    let values = tensor.f64().into_iter().enumerate();
    let bytes = values
        .flat_map(|(i, v)| change(i, v).to_le_bytes())
        .collect();
    let damaged = Tensor::from_bytes(Dtype::F64, tensor.shape().to_vec(), bytes);
    let damaged = npy::encode(&damaged.expect("as many"));
    fs::write(path, damaged).expect("written");
}

#[test]
fn every_case_is_listed_with_its_basis() {
    let (code, text) = golden(&["list"]);
    assert_eq!(code, 0, "{text}");
    for word in [
        "raster_backward: gradients",
        "sh3_80",
        "numpy-f64",
        "f64[45, 61, 3]",
    ] {
        assert!(text.contains(word), "{word}: {text}");
    }
    let (code, text) = golden(&["list", "--json", "--stage", "lk", "--tag", "opencv"]);
    assert_eq!(code, 0, "{text}");
    let list: Value = serde_json::from_str(&text).expect("JSON");
    let list = list.as_array().expect("a list");
    assert_eq!(list.len(), 5, "{text}");
    let residual = &list[0]["outputs"][0];
    assert_eq!(residual["tolerance"], "lk.residual", "{text}");
    assert_eq!(residual["unit"], "1", "{text}");
    assert_eq!(residual["allowed"]["class"], "abs_rel", "{text}");
    assert_eq!(residual["allowed"]["abs"], 1e-4, "{text}");
    assert_eq!(list[0]["inputs"][1]["unit"], "px", "{text}");
    assert!(list[0]["params"]["levels"].is_number(), "{text}");
    let text = golden(&["list", "--json", "--stage", "sh"]).1;
    let list: Value = serde_json::from_str(&text).expect("JSON");
    let basis = &list[0]["outputs"][0];
    assert_eq!(basis["allowed"]["abs"], 1e-15, "{text}");
    assert_eq!(basis["allowed_f32"]["abs"], 1e-15 * 536_870_912.0, "{text}");
    assert_eq!(basis["allowed_f32"]["name"], "sh.basis", "{text}");
}

/// Neither the folder of the build nor the current one need have the cases.
#[test]
fn cases_are_found_where_the_program_is_told() {
    let elsewhere = TempDir::new().expect("a folder");
    let run = |folder: &str, variable: Option<&str>, args: &[&str]| {
        let mut command = program();
        command
            .env_remove("GARAD_GOLDEN")
            .current_dir(folder)
            .args(["golden", "list", "--stage", "sh"]);
        command
            .envs(variable.map(|v| ("GARAD_GOLDEN", v)))
            .args(args);
        let output = command.output().expect("the program starts");
        let said = [output.stdout, output.stderr].concat();
        (
            output.status.code(),
            String::from_utf8_lossy(&said).into_owned(),
        )
    };
    let (cases, away) = (cases(), arg(elsewhere.path()));
    let below = format!("{cases}/gen");
    for (folder, variable, args) in [
        (below.as_str(), None, &[][..]),
        (away, Some(cases.as_str()), &[]),
        (away, Some("/nowhere"), &["--cases", &cases]),
    ] {
        let (code, said) = run(folder, variable, args);
        assert!(
            code == Some(0) && said.contains("sh: basis functions"),
            "{folder} {variable:?}: {said}"
        );
    }
    for (folder, variable, words) in [
        (away, None, &["--cases", "GARAD_GOLDEN", "tests/golden"][..]),
        (below.as_str(), Some("/nowhere"), &["GARAD_GOLDEN=/nowhere"]),
        (below.as_str(), Some(away), &["no stage 'sh'"]),
    ] {
        let (code, said) = run(folder, variable, &[]);
        let named = words.iter().all(|word| said.contains(word));
        assert!(code == Some(2) && named, "{folder} {variable:?}: {said}");
    }
}

#[test]
fn our_own_stages_pass_in_both_widths() {
    let folder = TempDir::new().expect("a folder");
    let json = folder.path().join("report.json");
    for width in ["--self", "--self=f32"] {
        let (code, text) = golden(&["check", width, "--json", arg(&json)]);
        assert_eq!(code, 0, "{width}: {text}");
        let report: Value =
            serde_json::from_slice(&fs::read(&json).expect("written")).expect("JSON");
        assert_eq!(report["passed"], true, "{width}");
        let passed = report["counts"]["pass"].as_u64().expect("a count");
        assert!(passed >= 50, "{width}: {passed} passed");
    }
}

#[test]
fn a_right_answer_passes_and_a_wrong_one_says_where() {
    let folder = answered("raster_backward", "one");
    let base = [
        "check",
        "--actual",
        arg(folder.path()),
        "--stage",
        "raster_backward",
    ];
    let one = [&base[..], &["--case", "one"]].concat();
    let (code, text) = golden(&one);
    assert_eq!(code, 0, "{text}");
    let (code, text) = golden(&base);
    assert!(
        code == 1 && text.contains("missing"),
        "others are asked for: {text}"
    );
    let (code, text) = golden(&[&base[..], &["--allow-missing"]].concat());
    assert_eq!(code, 0, "others may be missing: {text}");

    let wrong = folder.path().join("raster_backward/one/d_pose.npy");
    damage(&wrong, |_, v| -v);
    let (code, text) = golden(&one);
    assert_eq!(code, 1, "{text}");
    for word in [
        "FAIL d_pose[4]",
        "cosine -1.000000",
        "the sign",
        "raster_backward FAILS",
        "raster was not run",
    ] {
        assert!(text.contains(word), "{word}: {text}");
    }
    fs::write(&wrong, "nonsense").expect("written");
    let (code, text) = golden(&one);
    assert!(code == 1 && text.contains("UNREADABLE d_pose"), "{text}");
    fs::remove_file(&wrong).expect("there");
    let (code, text) = golden(&one);
    assert!(code == 1 && text.contains("missing d_pose"), "{text}");
}

#[test]
fn conics_without_blur_are_recognised() {
    let folder = answered("projection_covariance", "one");
    let path = folder.path().join("projection_covariance/one/conic.npy");
    let [a, b, c] = [0, 1, 2].map(|k| {
        npy::decode(&fs::read(&path).expect("there"))
            .expect("as written")
            .f64()[k]
    });
    let det = a * c - b * b;
    let (xx, xy, yy) = (c / det - 0.3, -b / det, a / det - 0.3);
    let det = xx * yy - xy * xy;
    damage(&path, |i, _| [yy / det, -xy / det, xx / det][i]);
    let checked = [
        "check",
        "--actual",
        arg(folder.path()),
        "--stage",
        "projection_covariance",
        "--case",
        "one",
    ];
    let (code, text) = golden(&checked);
    assert!(
        code == 1 && text.contains("0.3 px² on the diagonal"),
        "{text}"
    );
}

#[test]
fn a_port_is_a_program() {
    let folder = TempDir::new().expect("a folder");
    let keep = folder.path().join("two words");
    let port = ourselves("golden answer {case} {out}");
    let stages = ["--stage", "sh", "--stage", "losses"];
    let check = ["check", "--exec", &port, "--keep", arg(&keep)];
    let (code, text) = golden(&[&check[..], &stages].concat());
    assert_eq!(code, 0, "{text}");
    assert!(keep.join("sh/degree_3/basis.npy").is_file(), "kept");

    let silent = ourselves("--version");
    let (code, text) = golden(&["check", "--exec", &silent, "--stage", "sh"]);
    assert!(code == 1 && text.contains("missing"), "{text}");
    let dead = ourselves("frobnicate");
    let (code, text) = golden(&["check", "--exec", &dead, "--stage", "sh"]);
    assert!(code == 1 && text.contains("CRASH"), "{text}");
    assert!(
        text.contains("exit status: 2") || text.contains("exit code: 2"),
        "{text}"
    );
    assert!(text.contains("frobnicate"), "the end of its output: {text}");
}

#[cfg(unix)]
#[test]
fn a_port_may_leave_stages_out() {
    let (code, text) = golden(&["check", "--exec", "sh -c 'exit 77'", "--stage", "decode"]);
    assert!(
        code == 0 && text.contains("unsupported: decode"),
        "{code}: {text}"
    );
}

#[cfg(unix)]
#[test]
fn a_port_that_hangs_is_ended() {
    let (code, text) = golden(&[
        "check",
        "--exec",
        "sleep 60",
        "--timeout",
        "0.2",
        "--stage",
        "sh",
    ]);
    assert!(code == 1 && text.contains("TIMEOUT"), "{text}");
}

/// A small one of each kind passes in both widths; the same options write the same bytes.
#[test]
fn cases_are_made_and_passed() {
    let folder = TempDir::new().expect("a folder");
    let [one, two] = ["one", "two"].map(|name| folder.path().join(name));
    let options = [
        "--scene",
        "stack",
        "--gaussians",
        "300",
        "--size",
        "70x50",
        "--sh",
        "2",
    ];
    for (root, threads) in [(&one, "1"), (&two, "2")] {
        let (code, text) = golden(
            &[
                &["make", "-o", arg(root), "--threads", threads][..],
                &options,
            ]
            .concat(),
        );
        assert!(
            code == 0 && text.contains("raster_backward"),
            "{code}: {text}"
        );
    }
    for file in [
        "raster/stack_300_70x50_sh2_1/color.npy",
        "raster_backward/stack_300_70x50_sh2_1/scale_d_sh.npy",
    ] {
        let [a, b] = [&one, &two].map(|root| fs::read(root.join(file)).expect("written"));
        assert!(a == b, "{file}");
    }
    let (code, text) = golden(&["make", "--stage", "adam", "--count", "50", "-o", arg(&one)]);
    assert_eq!(code, 0, "{text}");
    for width in ["--self", "--self=f32"] {
        let (code, text) = golden(&["check", "--cases", arg(&one), width]);
        assert!(code == 0 && text.contains("3 "), "{width}: {text}");
    }
    let opacities = two.join("raster_backward/stack_300_70x50_sh2_1/d_opacities.npy");
    damage(&opacities, |i, v| if i == 7 { v + 100.0 } else { v });
    let (code, text) = golden(&["check", "--cases", arg(&two), "--self"]);
    assert!(code == 1 && text.contains("of 300"), "one row: {text}");
}

/// One process for all: ourselves, then scripts that leave out, fail, write nothing, and die in the middle.
#[test]
fn a_port_may_be_started_once_for_all() {
    let folder = TempDir::new().expect("a folder");
    let keep = folder.path().join("two words");
    let port = ourselves("golden answer --list {list} --width f32");
    let stages = ["--stage", "sh", "--stage", "se3"];
    let check = ["check", "--exec-batch", &port, "--keep", arg(&keep)];
    let (code, text) = golden(&[&check[..], &stages].concat());
    assert_eq!(code, 0, "{text}");
    let status = fs::read_to_string(keep.join("sh/degree_3/status")).expect("there");
    assert_eq!(status, "0\n", "the protocol");
    let list = fs::read_to_string(keep.join("cases.tsv")).expect("there");
    assert!(
        list.lines().count() >= 4 && list.contains("two words"),
        "{list}"
    );

    let silent = ourselves("--version");
    let (code, text) = golden(&["check", "--exec-batch", &silent, "--stage", "sh"]);
    assert!(code == 1 && text.contains("missing"), "{text}");
}

#[cfg(unix)]
#[test]
fn a_batch_says_how_each_case_ended() {
    let folder = TempDir::new().expect("a folder");
    let script = folder.path().join("port.sh");
    let port = format!("sh '{}' {{list}}", script.display());
    let own = env!("CARGO_BIN_EXE_garad");
    let run = |body: &str, more: &[&str]| {
        let text = format!("while IFS='\t' read -r stage case out; do\n{body}\ndone\n");
        fs::write(&script, text).expect("written");
        let check = ["check", "--exec-batch", &port, "--stage", "raster"];
        golden(&[&check, more].concat())
    };
    let answer = format!("'{own}' golden answer \"$case\" \"$out\" && echo 0 >\"$out/status\"");
    let rest = |special: &str| format!("case \"$case\" in {special};; *) {answer};; esac");

    let (code, text) = run("echo 77 >\"$out/status\"", &[]);
    assert!(
        code == 0 && text.contains("unsupported: raster"),
        "{code}: {text}"
    );
    let (code, text) = run(&rest("*needles) echo 5 no memory >\"$out/status\""), &[]);
    assert!(code == 1 && text.contains("status 5: no memory"), "{text}");
    assert!(text.contains("1 CRASH, 6 pass"), "the others pass: {text}");
    // Cases are in the order cuts, gsplat_sh0, sh2, sh3, needles, one, sh3_80: two are not reached.
    let (code, text) = run(&rest("*needles) echo out of luck; kill -9 $$"), &[]);
    assert!(code == 1 && text.contains("out of luck"), "{text}");
    let crash = text
        .lines()
        .find(|l| l.contains("CRASH"))
        .unwrap_or_default();
    assert!(crash.contains("needles"), "names the case: {text}");
    let two = text.matches("missing").count();
    assert!(two >= 2, "not reached: {text}");
    let (code, text) = run("sleep 60", &["--timeout", "0.1"]);
    assert!(code == 1 && text.contains("TIMEOUT"), "{text}");
}

#[test]
fn mistakes_in_the_command_are_named() {
    let mistakes: &[(&[&str], &str)] = &[
        (&["check"], "--exec"),
        (&["check", "--self", "--actual", "."], "--actual"),
        (&["check", "--self", "--stage", "rasta"], "rasta"),
        (
            &["check", "--self", "--stage", "sh", "--case", "none"],
            "no such case",
        ),
        (&["check", "--self", "--cases", "/nowhere"], "/nowhere"),
        (&["check", "--actual", "/nowhere"], "/nowhere"),
        (&["check", "--exec", "a 'b"], "without its end"),
        (&["check", "--exec-batch", "a 'b"], "--exec-batch: a 'b"),
        (&["answer", "--list", "/nowhere"], "/nowhere"),
        (&["answer", "/tmp"], "OUT"),
        (&["make", "-o", "/nowhere", "--stage", "sh"], "--stage sh"),
        (
            &["make", "-o", "/nowhere", "--size", "9x640"],
            "--size 9x640",
        ),
        (
            &["check", "--exec", "/nowhere/port", "--stage", "sh"],
            "/nowhere/port",
        ),
        (&["check", "--self", "--timeout", "0"], "--timeout"),
        (&["answer", "/nowhere", "/tmp"], "/nowhere"),
    ];
    for (args, word) in mistakes {
        let (code, text) = golden(args);
        assert!(code == 2 && text.contains(word), "{args:?}: {code}, {text}");
    }
}

#[test]
fn tolerances_have_reasons() {
    let text = garad(["golden", "tolerances"]).succeeds().out;
    assert!(
        text.contains("raster.f32.color") && text.contains("seen"),
        "{text}"
    );
}

/// Of the mutants of `mutants.py`, those with the mistakes that ports to a GPU make most often.
const USUAL_MUTANTS: [&str; 12] = [
    "half_pixel",
    "no_dilation",
    "quaternion_order",
    "world_for_camera",
    "sh_sign",
    "sort_in_half",
    "background_in_full",
    "conic_factor",
    "opacity_for_logit",
    "ssim_window",
    "adam_without_correction",
    "truncated_window",
];

fn has_numpy() -> bool {
    let numpy = Command::new("python3")
        .args(["-c", "import numpy"])
        .output();
    let found = numpy.is_ok_and(|output| output.status.success());
    if !found {
        eprintln!("skipped: no python3 with numpy");
    }
    found
}

/// Where there is a Python with numpy, the example port passes; a usual mutant of it fails, and first at its own
/// stage; with rounding of its own it passes.
#[test]
fn the_example_port_passes() {
    if !has_numpy() {
        return;
    }
    let example = format!("{}/examples/adapter_numpy", env!("CARGO_MANIFEST_DIR"));
    let port = format!("python3 '{example}/adapter.py' {{case}} {{out}}");
    let mut check = vec!["check", "--exec", &port];
    for stage in [
        "sh",
        "projection_covariance",
        "raster",
        "raster_backward",
        "losses",
        "adam",
        "train_step",
        "lk",
    ] {
        check.extend(["--stage", stage]);
    }
    let (code, text) = golden(&check);
    assert!(code == 0 && text.contains("28 pass"), "{text}");
    let usual: Vec<&str> = USUAL_MUTANTS.into_iter().chain(["noisy_exp"]).collect();
    mutants_of_the_example_fail(&usual);
}

#[test]
#[ignore = "minutes: all mutants of the example port"]
fn every_mutant_of_the_example_port_fails() {
    if has_numpy() {
        mutants_of_the_example_fail(&[]);
    }
}

/// Those named, or all, each first at its own stage; the usual ones are always among them.
fn mutants_of_the_example_fail(named: &[&str]) {
    let script = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/examples/adapter_numpy/mutants.py"
    );
    let mutants = Command::new("python3")
        .arg(script)
        .args(named)
        .env("GARAD", env!("CARGO_BIN_EXE_garad"))
        .output()
        .expect("python3 starts");
    let text = String::from_utf8_lossy(&mutants.stdout).into_owned();
    assert!(
        mutants.status.success(),
        "{text}{}",
        String::from_utf8_lossy(&mutants.stderr)
    );
    for mutant in USUAL_MUTANTS {
        assert!(text.contains(mutant), "{mutant}: {text}");
    }
    assert!(text.contains("half a pixel"), "{text}");
}
