//! How a case is read, and what is said of one that cannot be.

use garad_golden::{Case, Dtype, Tensor, npy};

const HEAD: &str = r#""schema": 1, "stage": "s", "case": "c", "why": "w", "basis": "closed-form",
    "generator": {"script": "gen/s.py", "version": 1, "seed": null}"#;

fn folder(json: &str, files: &[(&str, &[u8])]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("case.json"), json).expect("written");
    for (name, bytes) in files {
        std::fs::write(folder.path().join(name), bytes).expect("written");
    }
    folder
}

fn with_output(entry: &str) -> String {
    format!("{{{HEAD}, \"outputs\": {{\"y\": {entry}}}}}")
}

fn error_of(json: &str, files: &[(&str, &[u8])]) -> String {
    let folder = folder(json, files);
    Case::load(folder.path()).expect_err("refused").to_string()
}

#[test]
fn a_case_reads_its_tensors_and_judges_answers() {
    let npy = npy::encode(&Tensor::from(vec![1.0, 2.0]));
    let json = format!(
        r#"{{{HEAD}, "flags": ["edge"], "params": {{"k": 3, "h": 0.5, "on": true, "mode": "raw"}},
           "inputs": {{"x": {{"dtype": "f64", "shape": [2], "unit": "m", "file": "x.npy"}}}},
           "outputs": {{"y": {{"dtype": "f64", "shape": [1, 2], "unit": "px",
                               "data": [[0.1, "nan"]], "tol": "exact"}}}}}}"#
    );
    let folder = folder(&json, &[("x.npy", &npy)]);
    let case = Case::load(folder.path()).unwrap();
    assert_eq!(case.name(), "s/c", "name");
    let inputs = case.inputs();
    assert_eq!(inputs.reals("x"), Ok(vec![1.0, 2.0]), "from a file");
    assert_eq!(inputs.row("x"), Ok([1.0, 2.0]), "as a row");
    assert_eq!(case.output("y").shape(), [1, 2], "inline");
    assert_eq!(inputs.count("k"), Ok(3), "count");
    assert_eq!(inputs.number("k"), Ok(3.0), "a count is a number");
    assert_eq!(inputs.switch("on"), Ok(true), "switch");
    assert!(inputs.has_flag("edge"), "flag");
    assert_eq!(inputs.word("mode"), Ok("raw"), "word");
    assert_eq!(
        inputs.choice("mode", &[("cooked", 1), ("raw", 2)]),
        Ok(2),
        "choice"
    );
    assert_eq!(case.check("y", &[0.1, f64::NAN]), Ok(()), "right");
    let report = case.check("y", &[0.1, 0.0]).unwrap_err();
    assert!(
        report.contains("s/c 'y'") && report.contains("worst at [0, 1]"),
        "{report}"
    );
    let report = case.check("y", &[0.1]).unwrap_err();
    assert!(report.contains("1 elements; expected 2"), "{report}");
    let report = case.check("z", &[]).unwrap_err();
    assert!(report.contains("no output 'z'; there is y"), "{report}");
}

#[test]
fn what_a_case_does_not_have_is_named() {
    let json = format!(
        r#"{{{HEAD}, "params": {{"k": 3, "mode": "raw"}}, "outputs": {{}},
           "inputs": {{"x": {{"dtype": "f64", "shape": [3], "unit": "m", "data": [1, 2, 3]}}}}}}"#
    );
    let folder = folder(&json, &[]);
    let case = Case::load(folder.path()).unwrap();
    let inputs = case.inputs();
    let errors = [
        (
            inputs.number("h").err(),
            "no parameter 'h'; there is k, mode",
        ),
        (inputs.tensor("y").err(), "no input 'y'; there is x"),
        (inputs.switch("k").err(), "'k' is 3; expected true or false"),
        (
            inputs.choice("mode", &[("cooked", 1)]).err(),
            "'mode' is raw; expected one of cooked",
        ),
        (
            inputs.rows::<2>("x").err(),
            "'x' is of shape [3]; expected rows of 2",
        ),
        (
            inputs.row::<2>("x").err(),
            "'x' is of shape [3]; expected 2 numbers",
        ),
        (
            inputs.size("x").err(),
            "'x' is of shape [3]; expected an image",
        ),
        (inputs.bytes("x").err(), "'x' is f64; expected u8 or bool"),
        (inputs.singles("x").err(), "'x' is f64; expected f32"),
        (
            inputs.indices("x").err(),
            "'x' is f64; expected whole numbers",
        ),
    ];
    for (error, expected) in errors {
        assert_eq!(
            error.map(|e| e.to_string()).as_deref(),
            Some(expected),
            "{expected}"
        );
    }
}

/// The nearest f64 of a text of 17 digits, not one next to it.
#[test]
fn numbers_are_parsed_to_the_last_bit() {
    let text = "3.5844466002796428e+298";
    let json = with_output(&format!(
        r#"{{"dtype": "f64", "shape": [], "unit": "1", "data": {text}, "tol": "exact"}}"#
    ));
    let folder = folder(&json, &[]);
    let case = Case::load(folder.path()).unwrap();
    let expected: f64 = text.parse().unwrap();
    assert_eq!(
        case.output("y").f64()[0].to_bits(),
        expected.to_bits(),
        "bits"
    );
}

#[test]
fn disagreements_are_named() {
    let x = npy::encode(&Tensor::from(vec![1.0]));
    let n = Tensor::from_bytes(Dtype::I64, vec![1], i64::MAX.to_le_bytes().into());
    let n = npy::encode(&n.expect("one number"));
    for (entry, expected) in [
        (
            r#"{"dtype": "f16", "shape": [], "unit": "1", "data": 1}"#,
            "unknown dtype 'f16'",
        ),
        (
            r#"{"dtype": "f64", "shape": [1], "unit": "1"}"#,
            "needs either",
        ),
        (
            r#"{"dtype": "f64", "shape": [2], "unit": "1", "file": "x.npy"}"#,
            "holds f64 [1]",
        ),
        (
            r#"{"dtype": "f32", "shape": [1], "unit": "1", "file": "x.npy"}"#,
            "stated f32",
        ),
        (
            r#"{"dtype": "f64", "shape": [1], "unit": "1", "file": "../x.npy"}"#,
            "plain name",
        ),
        (
            r#"{"dtype": "f64", "shape": [1], "unit": "1", "file": "..\\x.npy"}"#,
            "plain name",
        ),
        (
            r#"{"dtype": "f64", "shape": [1], "unit": "1", "file": "gone.npy"}"#,
            "gone.npy",
        ),
        (
            r#"{"dtype": "f64", "shape": [1], "unit": "1", "file": "case.json"}"#,
            "NUMPY",
        ),
        (
            r#"{"dtype": "u8", "shape": [1], "unit": "1", "data": [256]}"#,
            "256 is not a value",
        ),
        (
            r#"{"dtype": "i64", "shape": [2], "unit": "1", "data": [3, -9007199254740993]}"#,
            "tensor 'y': -9007199254740993 at position 1; expected whole numbers of at most 2^53",
        ),
        (
            r#"{"dtype": "i64", "shape": [1], "unit": "1", "file": "n.npy"}"#,
            "n.npy: 9223372036854775807 at position 0",
        ),
        (
            r#"{"dtype": "f64", "shape": [2], "unit": "1", "data": [1]}"#,
            "lists of shape [2]",
        ),
        (
            r#"{"dtype": "f64", "shape": [1], "unit": "1", "data": ["NaN"]}"#,
            "is not a value",
        ),
        (
            r#"{"dtype": "f64", "shape": [1], "unit": "1", "extra": 0}"#,
            "unknown field",
        ),
    ] {
        let error = error_of(&with_output(entry), &[("x.npy", &x), ("n.npy", &n)]);
        assert!(error.contains(expected), "{entry}: {error}");
    }
    let schema = error_of(
        &with_output("{}").replace("\"schema\": 1", "\"schema\": 2"),
        &[],
    );
    assert!(
        schema.contains("missing field"),
        "the entry comes first: {schema}"
    );
    let none = format!("{{{HEAD}, \"outputs\": {{}}}}").replace("1,", "2,");
    assert!(
        error_of(&none, &[]).contains("schema 2; expected 1"),
        "schema"
    );
}

#[test]
fn unknown_tolerances_are_refused() {
    let json =
        with_output(r#"{"dtype": "f64", "shape": [], "unit": "1", "data": 1, "tol": "loose"}"#);
    let folder = folder(&json, &[]);
    let report = Case::load(folder.path())
        .unwrap()
        .check("y", &[1.0])
        .unwrap_err();
    assert!(report.contains("no tolerance 'loose'"), "{report}");
}

#[test]
#[should_panic(expected = "no golden case for stage 'nowhere'")]
fn a_stage_without_cases_panics() {
    let _ = Case::load_all("nowhere");
}
