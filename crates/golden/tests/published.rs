//! What judges in other languages read: `tolerances.json` is what the table says, and every case keeps to `case.schema.json`.

use std::fs;

use garad_golden::{Case, Dtype, table};
use serde_json::{Map, Value, json};

fn published(name: &str) -> String {
    fs::read_to_string(Case::root().join(name)).expect("committed")
}

fn cases() -> Vec<Case> {
    Case::load_root(&Case::root()).expect("committed")
}

#[test]
fn the_table_of_tolerances_is_current() {
    let now = table::text(&cases()).expect("finite numbers");
    assert!(
        published("tolerances.json") == now,
        "tests/golden/tolerances.json is not current: garad golden tolerances --json > tests/golden/tolerances.json"
    );
}

/// JSON Schema, as far as `case.schema.json` uses it; an unknown keyword is an error of the schema.
struct Schema {
    root: Value,
}

impl Schema {
    /// The problems of `value`, each with its place.
    fn problems(&self, schema: &Map<String, Value>, value: &Value, at: &str) -> Vec<String> {
        let problems = |of: &Value, value: &Value, at: &str| {
            self.problems(of.as_object().expect("a schema"), value, at)
        };
        let list = |of: &Value| of.as_array().expect("a list").clone();
        let object = value.as_object();
        let rule = |(keyword, of): (&String, &Value)| -> Vec<String> {
            let limit = || of.as_u64().expect("a count");
            let holds = match keyword.as_str() {
                "$schema" | "$defs" | "title" | "description" => true,
                "$ref" => {
                    let name = of.as_str().expect("a text").strip_prefix("#");
                    let to = self.root.pointer(name.expect("local")).expect("there");
                    return problems(to, value, at);
                }
                "const" => value == of,
                "enum" => list(of).contains(value),
                "type" => match of {
                    Value::Array(types) => types.iter().any(|t| is_of_type(value, t)),
                    one => is_of_type(value, one),
                },
                "minLength" => value
                    .as_str()
                    .is_none_or(|s| s.chars().count() as u64 >= limit()),
                "minimum" => value
                    .as_f64()
                    .is_none_or(|v| v >= of.as_f64().expect("a number")),
                "maxItems" => value.as_array().is_none_or(|a| a.len() as u64 <= limit()),
                "minProperties" => object.is_none_or(|o| o.len() as u64 >= limit()),
                "required" => {
                    let there = |key: &Value| {
                        object.is_none_or(|o| o.contains_key(key.as_str().expect("a key")))
                    };
                    list(of).iter().all(there)
                }
                "anyOf" => list(of).iter().any(|s| problems(s, value, at).is_empty()),
                "oneOf" => {
                    list(of)
                        .iter()
                        .filter(|s| problems(s, value, at).is_empty())
                        .count()
                        == 1
                }
                "items" => {
                    let items = value.as_array().into_iter().flatten().enumerate();
                    return items
                        .flat_map(|(i, v)| problems(of, v, &format!("{at}/{i}")))
                        .collect();
                }
                "properties" => {
                    let known = of.as_object().expect("by name").iter();
                    let there = known.filter_map(|(key, s)| Some((key, s, object?.get(key)?)));
                    return there
                        .flat_map(|(key, s, v)| problems(s, v, &format!("{at}/{key}")))
                        .collect();
                }
                "additionalProperties" => {
                    let known = |key: &String| {
                        schema
                            .get("properties")
                            .is_some_and(|p| p.get(key).is_some())
                    };
                    let others = object.into_iter().flatten().filter(|(key, _)| !known(key));
                    return match of {
                        Value::Bool(false) => others
                            .map(|(key, _)| format!("{at}/{key}: not known"))
                            .collect(),
                        of => others
                            .flat_map(|(key, v)| problems(of, v, &format!("{at}/{key}")))
                            .collect(),
                    };
                }
                other => panic!("this test does not know the keyword {other}"),
            };
            if holds {
                Vec::new()
            } else {
                vec![format!("{at}: {keyword} {of}")]
            }
        };
        schema.iter().flat_map(rule).collect()
    }

    fn check(&self, value: &Value) -> Vec<String> {
        self.problems(self.root.as_object().expect("a schema"), value, "")
    }
}

fn is_of_type(value: &Value, name: &Value) -> bool {
    match name.as_str().expect("a name") {
        "object" => value.is_object(),
        "array" => value.is_array(),
        "string" => value.is_string(),
        "number" => value.is_number(),
        "integer" => value.as_f64().is_some_and(|v| v.fract() == 0.0),
        "boolean" => value.is_boolean(),
        "null" => value.is_null(),
        other => panic!("no type {other}"),
    }
}

fn schema() -> Schema {
    let root = serde_json::from_str(&published("case.schema.json")).expect("JSON");
    Schema { root }
}

#[test]
fn every_case_keeps_to_the_schema() {
    let schema = schema();
    let cases = cases();
    assert!(cases.len() >= 177, "only {} cases", cases.len());
    for case in cases {
        let text = fs::read_to_string(case.folder().join("case.json")).expect("read before");
        let problems = schema.check(&serde_json::from_str(&text).expect("read before"));
        assert!(problems.is_empty(), "{}: {problems:#?}", case.name());
    }
    let dtypes: Vec<&str> = Dtype::ALL.iter().map(|d| d.name()).collect();
    assert_eq!(
        schema.root["$defs"]["dtype"]["enum"],
        json!(dtypes),
        "element types"
    );
}

/// A small case, and what is wrong after one change of it.
#[test]
fn what_is_no_case_does_not() {
    let tensor = json!({ "dtype": "f64", "shape": [2], "unit": "m", "data": [1.0, "nan"] });
    let mut output = tensor.clone();
    output["tol"] = json!("exact");
    let case = json!({
        "schema": 1, "stage": "sh", "case": "one", "why": "an example of a case", "basis": "closed-form",
        "generator": { "script": "gen/sh.py", "version": 1, "seed": null },
        "params": { "degree": 3, "fast": true, "loss": "huber" },
        "inputs": { "x": tensor }, "outputs": { "y": output },
    });
    let schema = schema();
    assert_eq!(schema.check(&case), Vec::<String>::new(), "as it is");
    for (place, value, problem) in [
        ("/schema", json!(2), "/schema: const"),
        ("/why", json!("short"), "/why: minLength"),
        ("/basis", json!(""), "/basis: minLength"),
        ("/stage", json!(7), "/stage: type"),
        ("/params/degree", json!([3]), "/params/degree: type"),
        (
            "/generator/version",
            json!(0),
            "/generator/version: minimum",
        ),
        ("/generator/seed", json!(1.5), "/generator/seed: type"),
        ("/outputs", json!({}), "/outputs: minProperties"),
        ("/inputs/x/dtype", json!("f16"), "/inputs/x/dtype: enum"),
        ("/inputs/x/shape", json!([-2]), "/inputs/x/shape/0: minimum"),
        (
            "/inputs/x/shape",
            json!(vec![1; 33]),
            "/inputs/x/shape: maxItems",
        ),
        (
            "/inputs/x/data",
            json!([1.0, "NaN"]),
            "/inputs/x/data: anyOf",
        ),
        ("/inputs/x/data", json!([[null]]), "/inputs/x/data: anyOf"),
    ] {
        let mut wrong = case.clone();
        *wrong.pointer_mut(place).expect("there") = value;
        let problems = schema.check(&wrong);
        assert!(
            problems.len() == 1 && problems[0].starts_with(problem),
            "{place}: {problems:?}"
        );
    }
    for (place, key, value, problem) in [
        ("", "basis", None, ": required"),
        ("/outputs/y", "tol", None, "/outputs/y: required"),
        ("/outputs/y", "data", None, "/outputs/y: oneOf"),
        ("/inputs/x", "unit", None, "/inputs/x: required"),
        (
            "/inputs/x",
            "file",
            Some(json!("x.npy")),
            "/inputs/x: oneOf",
        ),
        (
            "/inputs/x",
            "tol",
            Some(json!("exact")),
            "/inputs/x/tol: not known",
        ),
        ("", "notes", Some(json!("x")), "/notes: not known"),
    ] {
        let mut wrong = case.clone();
        let object = wrong
            .pointer_mut(place)
            .and_then(Value::as_object_mut)
            .expect("there");
        match value {
            Some(value) => drop(object.insert(key.to_owned(), value)),
            None => drop(object.remove(key).expect("there")),
        }
        let problems = schema.check(&wrong);
        assert!(
            problems.len() == 1 && problems[0].starts_with(problem),
            "{place} {key}: {problems:?}"
        );
    }
}
