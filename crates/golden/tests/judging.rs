//! The judge against answers that are wrong in known ways.

use std::collections::BTreeMap;

use garad_golden::answers::{Answers, read_answers};
use garad_golden::judge::judge;
use garad_golden::verdict::{Outcome, Verdict};
use garad_golden::{Case, Dtype, Tensor, npy, report};
use serde_json::{Value, json};

type Output<'a> = (&'a str, &'a [usize], &'a [f64], &'a str);

/// A case whose outputs are given as (name, shape, numbers, tolerance).
fn case(stage: &str, inputs: Value, outputs: &[Output<'_>]) -> Case {
    flagged(stage, json!([]), inputs, outputs)
}

fn flagged(stage: &str, flags: Value, inputs: Value, outputs: &[Output<'_>]) -> Case {
    let folder = tempfile::tempdir().expect("a folder");
    let mut entries = serde_json::Map::new();
    for (name, shape, numbers, tol) in outputs {
        let file = format!("{name}.npy");
        let tensor = Tensor::from(numbers.to_vec())
            .reshape(shape)
            .expect("as many");
        std::fs::write(folder.path().join(&file), npy::encode(&tensor)).expect("written");
        let entry = json!({"dtype": "f64", "shape": shape, "unit": "1", "file": file, "tol": tol});
        entries.insert((*name).to_owned(), entry);
    }
    let manifest = json!({
        "schema": 1, "stage": stage, "case": "c", "why": "a test", "basis": "closed-form",
        "generator": {}, "flags": flags, "inputs": inputs, "outputs": entries,
    });
    std::fs::write(folder.path().join("case.json"), manifest.to_string()).expect("written");
    Case::load(folder.path()).expect("a sound case")
}

fn wide(shape: &[usize], numbers: &[f64]) -> Tensor {
    Tensor::from(numbers.to_vec())
        .reshape(shape)
        .expect("as many")
}

fn narrow(shape: &[usize], numbers: &[f64]) -> Tensor {
    #[allow(clippy::cast_possible_truncation, reason = "f32 is what is wanted")]
    let bytes = numbers.iter().flat_map(|&v| (v as f32).to_le_bytes());
    Tensor::from_bytes(Dtype::F32, shape.to_vec(), bytes.collect()).expect("as many")
}

fn answer(name: &str, tensor: Tensor) -> Answers {
    BTreeMap::from([(name.to_owned(), Ok(tensor))])
}

/// Numbers without a pattern that a mistake could imitate.
fn numbers(n: usize) -> Vec<f64> {
    let mut state = 7u64;
    let next = |_| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (state >> 33) as f64 / 2_147_483_648.0 + 0.25
    };
    (0..n).map(next).collect()
}

/// What the judge says to `mistake(right numbers)`.
fn note(shape: &[usize], mistake: impl Fn(usize, &[f64]) -> f64) -> String {
    let right = numbers(shape.iter().product());
    let case = case("se3", json!({}), &[("y", shape, &right, "se3.rotation")]);
    let wrong: Vec<f64> = (0..right.len()).map(|i| mistake(i, &right)).collect();
    let verdict = judge(&case, &answer("y", wide(shape, &wrong)), false);
    assert_eq!(verdict.outcome, Outcome::Fail, "{shape:?} must fail");
    verdict.outputs[0].note.clone().unwrap_or_default()
}

#[test]
fn mistakes_are_named() {
    let image = [12, 10];
    let next = |i: usize, n: usize, by: usize| i - i % n + (i % n + by) % n;
    let cases: Vec<(String, &str)> = vec![
        (note(&[9], |i, v| -v[i]), "the sign"),
        (note(&[9], |i, v| v[i] / 2.0), "a factor of 1/2"),
        (
            note(&[5, 3], |i, v| v[i] * if i % 3 == 1 { 2.0 } else { 1.0 }),
            "component 1: a factor of 2",
        ),
        (
            note(&[5, 3], |i, v| v[i] * if i % 3 == 2 { -1.0 } else { 1.0 }),
            "component 2: the sign",
        ),
        (note(&[5, 3], |i, v| v[i - i % 3 + 2 - i % 3]), "BGR"),
        (note(&[5, 2], |i, v| v[next(i, 2, 1)]), "(row, column)"),
        (note(&[5, 2], |i, v| v[i] + 0.5), "half a unit too much"),
        (
            note(&[5, 2], |i, v| v[i] - if i % 2 == 0 { 31.5 } else { 0.0 }),
            "component 0: a constant of -31.5",
        ),
        (
            note(&[5, 4], |i, v| v[next(i, 4, 1)]),
            "(x, y, z, w) instead of (w, x, y, z)",
        ),
        (
            note(&[5, 4], |i, v| if i % 4 == 0 { v[i] } else { -v[i] }),
            "conjugated",
        ),
        (
            note(&[5, 6], |i, v| v[next(i, 6, 3)]),
            "(rotation, translation)",
        ),
        (
            note(&[2, 3, 3], |i, v| v[i - i % 9 + i % 3 * 3 + i % 9 / 3]),
            "transposed",
        ),
        (note(&[4, 5], |i, v| v[i % 4 * 5 + i / 4]), "column-major"),
        (
            note(&[7, 2], |i, v| v[(6 - i / 2) * 2 + i % 2]),
            "first axis is reversed",
        ),
        (
            note(&[7, 2], |i, v| v[(i / 2 * 3 % 7) * 2 + i % 2]),
            "the same rows in another order",
        ),
        (
            note(&image, |i, v| v[if i % 10 == 0 { i } else { i - 1 }]),
            "displaced by one pixel to the right",
        ),
        (note(&image, |i, v| v[i - i % 10 + 9 - i % 10]), "mirrored"),
        (
            note(&[9], |i, v| 1.0 - v[i]),
            "opacity instead of transmittance",
        ),
        (note(&[9], |i, v| libm::log(v[i] / 4.0)), ""),
        (note(&[9], |i, v| libm::log(v[i])), "the logarithm"),
        (note(&[9], |i, v| v[i] + 1e-3 * (i % 2) as f64), ""),
    ];
    for (k, (note, expected)) in cases.iter().enumerate() {
        let named = !note.is_empty();
        assert_eq!(named, !expected.is_empty(), "mistake {k}: '{note}'");
        assert!(
            note.contains(expected),
            "mistake {k}: '{note}', not '{expected}'"
        );
    }
}

#[test]
fn other_tensors_show_mistakes() {
    let rotation = [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    let pose = case(
        "se3",
        json!({}),
        &[
            ("rotation", &[1, 3, 3], &rotation, "se3.rotation"),
            ("translation", &[1, 3], &[1.0, 2.0, 3.0], "se3.translation"),
        ],
    );
    let inverse = wide(&[1, 3], &[-2.0, 1.0, -3.0]);
    let verdict = judge(&pose, &answer("translation", inverse), true);
    let note = verdict.outputs[1].note.as_deref().unwrap_or_default();
    assert!(note.contains("world_from_camera"), "{note}");

    let background =
        json!({"background": {"dtype": "f64", "shape": [1], "unit": "1", "data": [0.5]}});
    let image = case(
        "raster",
        background,
        &[
            ("color", &[2, 2, 1], &[0.3, 0.4, 0.5, 0.6], "raster.color"),
            (
                "transmittance",
                &[2, 2],
                &[0.1, 0.2, 0.3, 0.4],
                "raster.transmittance",
            ),
        ],
    );
    let without = wide(&[2, 2, 1], &[0.25, 0.3, 0.35, 0.4]);
    let verdict = judge(&image, &answer("color", without), true);
    let note = verdict.outputs[0].note.as_deref().unwrap_or_default();
    assert!(note.contains("background is missing"), "{note}");
}

#[test]
fn f32_is_held_to_its_own_tolerance() {
    let right = numbers(6);
    let case = case("se3", json!({}), &[("y", &[6], &right, "se3.rotation")]);
    let off = |by: f64| -> Vec<f64> { right.iter().map(|v| v + by).collect() };
    let outcome = |tensor: Tensor| judge(&case, &answer("y", tensor), false).outcome;
    assert_eq!(
        outcome(narrow(&[6], &off(4e-7))),
        Outcome::Pass,
        "2^29 x 1e-15 is 5.4e-7"
    );
    assert_eq!(outcome(narrow(&[6], &off(7e-7))), Outcome::Fail, "beyond");
    assert_eq!(outcome(wide(&[6], &off(4e-7))), Outcome::Fail, "in f64");
    let rounded = narrow(&[6], &off(1e-7)).f64();
    let verdict = judge(&case, &answer("y", wide(&[6], &rounded)), false);
    let note = verdict.outputs[0].note.as_deref().unwrap_or_default();
    assert!(note.contains("save it as float32"), "{note}");
}

/// Near a cut an answer in f32 may decide the other way, within a budget; in f64 it may not.
#[test]
fn cuts_have_a_budget_in_f32_only() {
    let n = 200;
    let right = numbers(n);
    let mut mask = vec![true; n];
    mask[17] = false;
    let robust = json!({"robust": {"dtype": "bool", "shape": [n], "unit": "1", "data": mask}});
    let case = case("raster", robust, &[("color", &[n], &right, "raster.color")]);
    let flipped = |at: usize, by: f64| {
        let mut numbers = right.clone();
        numbers[at] += by;
        numbers
    };
    let outcome = |tensor: Tensor| judge(&case, &answer("color", tensor), false).outcome;
    assert_eq!(
        outcome(narrow(&[n], &flipped(17, 5e-3))),
        Outcome::Pass,
        "a flip at the cut"
    );
    assert_eq!(
        outcome(narrow(&[n], &flipped(18, 5e-3))),
        Outcome::Fail,
        "away from it"
    );
    assert_eq!(
        outcome(narrow(&[n], &flipped(17, 5e-2))),
        Outcome::Fail,
        "more than a splat of 1/255"
    );
    assert_eq!(
        outcome(wide(&[n], &flipped(17, 5e-3))),
        Outcome::Fail,
        "in f64"
    );
}

#[test]
fn what_cannot_be_compared_is_said() {
    let right = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0];
    let case = case("fast", json!({}), &[("xy", &[3, 2], &right, "exact")]);
    let verdict = |tensor: Tensor| judge(&case, &answer("xy", tensor), false).outputs.remove(0);
    let short = verdict(wide(&[2, 2], &[0.0, 1.0, 4.0, 5.0]));
    assert_eq!(short.verdict, Verdict::Shape, "two rows of three");
    let note = short.note.unwrap_or_default();
    assert!(
        note.contains("1 rows are missing, for one [2.0, 3.0]; 0 should not"),
        "{note}"
    );
    let turned = verdict(wide(&[2, 3], &right)).note.unwrap_or_default();
    assert!(turned.contains("axes are reversed"), "{turned}");
    let mut lost = right;
    lost[4] = f64::NAN;
    let lost = verdict(wide(&[3, 2], &lost));
    assert_eq!(lost.verdict, Verdict::NonFinite, "NaN");
    assert_eq!(
        verdict(wide(&[3, 1, 2], &right)).verdict,
        Verdict::Pass,
        "an axis of 1"
    );

    let folder = tempfile::tempdir().expect("a folder");
    assert_eq!(
        judge(&case, &read_answers(&case, folder.path()), false).outcome,
        Outcome::Missing,
        "nothing"
    );
    let file = folder.path().join("xy.npy");
    let unreadable = |expected: &str| {
        let verdict = judge(&case, &read_answers(&case, folder.path()), true);
        let output = &verdict.outputs[0];
        assert_eq!(output.verdict, Verdict::Unreadable, "{expected}");
        let note = output.note.clone().unwrap_or_default();
        assert!(note.contains(expected), "{note}");
    };
    std::fs::write(&file, "not numpy").expect("written");
    unreadable("NUMPY");
    std::fs::write(&file, npy::encode(&whole(&[3, (1 << 53) + 1]))).expect("written");
    unreadable("9007199254740993 at position 1; expected whole numbers of at most 2^53");
    let sparse = std::fs::File::create(&file).expect("made");
    sparse.set_len((64 << 20) + 1).expect("a hole");
    unreadable("67108865 bytes; at most 67108864 are read");
}

fn whole(numbers: &[i64]) -> Tensor {
    let bytes = numbers.iter().flat_map(|v| v.to_le_bytes());
    Tensor::from_bytes(Dtype::I64, vec![numbers.len()], bytes.collect()).expect("as many")
}

/// The largest whole numbers that f64 holds are still compared.
#[test]
fn whole_numbers_up_to_2_53_are_answers() {
    let edge = 1i64 << 53;
    let case = case(
        "se3",
        json!({}),
        &[("n", &[2], &[edge as f64, -(edge as f64)], "exact")],
    );
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(
        folder.path().join("n.npy"),
        npy::encode(&whole(&[edge, -edge])),
    )
    .expect("written");
    let verdict = judge(&case, &read_answers(&case, folder.path()), false);
    assert_eq!(verdict.outcome, Outcome::Pass, "{verdict:?}");
}

#[test]
fn missing_outputs_fail_unless_allowed() {
    let tol = "se3.rotation";
    let case = case(
        "se3",
        json!({}),
        &[("a", &[1], &[1.0], tol), ("b", &[1], &[2.0], tol)],
    );
    let half = answer("a", wide(&[1], &[1.0]));
    assert_eq!(
        judge(&case, &half, false).outcome,
        Outcome::Fail,
        "b is asked for"
    );
    assert_eq!(
        judge(&case, &half, true).outcome,
        Outcome::Pass,
        "b may be missing"
    );
    let none = judge(&case, &Answers::new(), true);
    assert!(!none.fails(true) && none.fails(false), "{none:?}");
}

/// A wrong backward pass on a right forward pass is the backward pass's fault; a wrong
/// projection is the projection's.
#[test]
fn the_report_says_where_to_look() {
    let verdict = |stage: &str, right: bool| {
        let case = case(stage, json!({}), &[("y", &[1], &[1.0], "exact")]);
        let got = wide(&[1], &[if right { 1.0 } else { 3.7 }]);
        judge(&case, &answer("y", got), false)
    };
    let stages = ["projection_covariance", "sh", "raster", "raster_backward"];
    let table = |wrong: &[&str]| {
        let verdicts: Vec<_> = stages.map(|s| verdict(s, !wrong.contains(&s))).into();
        (
            report::table(&verdicts),
            report::to_json(&verdicts, wrong.is_empty()),
        )
    };
    let (text, json) = table(&["raster_backward"]);
    assert!(
        text.contains("raster passes): the stages it needs pass: the mistake is in this stage"),
        "{text}"
    );
    assert!(
        text.contains("y[0]: got 3.7, expected 1.0 exactly"),
        "{text}"
    );
    assert_eq!(json["stages"]["raster_backward"], "FAILS", "{json}");
    assert_eq!(json["cases"][3]["outputs"][0]["got"], 3.7, "{json}");
    let (text, _) = table(&["projection_covariance", "raster", "raster_backward"]);
    assert!(
        text.contains("first stage that differs: projection_covariance"),
        "{text}"
    );
    assert!(text.contains("raster FAILS (projection_covariance FAILS, sh passes): look at projection_covariance first"), "{text}");
}

/// Problems with several solutions: the nearest of each row is judged, and other cases may not be answered so.
#[test]
fn one_of_several_solutions_is_enough() {
    let right = numbers(6);
    let mut several = vec![f64::NAN; 2 * 4 * 3];
    several[3..6].copy_from_slice(&right[..3]);
    several[..3].copy_from_slice(&[7.0; 3]);
    several[12..15].copy_from_slice(&right[3..]);
    let y: &[Output<'_>] = &[("y", &[2, 3], &right, "pnp.exact")];
    let outcome = |case: &Case, numbers: &[f64], shape: &[usize]| {
        judge(case, &answer("y", wide(shape, numbers)), false).outcome
    };
    let exact = flagged("pnp", json!(["exact"]), json!({}), y);
    assert_eq!(
        outcome(&exact, &several, &[2, 4, 3]),
        Outcome::Pass,
        "among others"
    );
    assert_eq!(outcome(&exact, &right, &[2, 3]), Outcome::Pass, "alone");
    let five = [several.as_slice(), &[0.0; 6]].concat();
    assert_eq!(
        outcome(&exact, &five, &[2, 5, 3]),
        Outcome::Fail,
        "more than there can be"
    );
    several[13] += 1e-6;
    assert_eq!(
        outcome(&exact, &several, &[2, 4, 3]),
        Outcome::Fail,
        "none is right"
    );
    let plain = case("pnp", json!({}), y);
    assert_eq!(
        outcome(&plain, &several, &[2, 4, 3]),
        Outcome::Fail,
        "another case"
    );
}
