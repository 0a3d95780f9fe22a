//! [`text`]: the table of tolerances, the rules that go with it and the order of the stages as JSON, for judges in
//! other languages. `tests/golden/tolerances.json` is this text.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;
use serde_json::{Map, Value, json};

use crate::alternatives::SEVERAL;
use crate::case::Case;
use crate::judge::robust;
use crate::manifest::MAX_FILE_BYTES;
use crate::stages::STAGES;
use crate::tensor::EXACT_F64;
use crate::tol::{self, Class, F32_OVER_F64, LARGEST_ROUNDING, TABLE, Tolerance};

/// Each class with its rule for one element: e is expected, g is got, E all that is expected.
const CLASSES: &[(&str, &str)] = &[
    ("exact", "g = e as numbers; 0.0 = -0.0, NaN = NaN"),
    (
        "ulp",
        "at most `ulp` representable numbers apart, of f32 if e is of dtype f32, else of f64",
    ),
    ("abs_rel", "|g - e| <= abs + rel |e|"),
    (
        "vector",
        "|g - e| <= abs + rel max |E|, the largest of the finite numbers",
    ),
    (
        "banded",
        "|g - e| <= hard, and |g - e| / hard <= tight / hard for all but at most share of the elements",
    ),
    (
        "rows",
        "a row is all behind the first index, its size the largest finite |e| in it, its scale number i of the input \
         scale_OUTPUT or without that the lower median of the sizes above 0; b = hard (rel size + floor scale): |g - e| <= b, and \
         |g - e| / b <= 1 / hard in all but at most share of the rows",
    ),
];

const F32_RULE: &str = "for an answer of dtype f32 where f64 is expected: for the class rows WIDE, the name of the tolerance of \
     the output with f32 after its first point, if that is in `tolerances`; else the first of `names` that is there (the first for each \
     flag of the case); else, for abs_rel and vector with max(abs, rel) <= at_most, abs and rel times factor; else unchanged";

const ROBUST_RULE: &str = "if any answer of a case is of dtype f32 where f64 is expected, and the case has an input \
     `robust_OUTPUT`, or else `robust`, whose shape is that of the first axes of an output: elements where it is 0 count as right; with \
     `robust`, unless the class is exact, all elements are held to the tolerance STAGE.f32.flips_FLAG for the first flag of the case \
     that has one, else STAGE.f32.flips, as well, if there is one";

const SEVERAL_RULE: &str = "an answer to a case of this stage with this flag may have one more axis after the first, of at \
     most `most` solutions, NaN in the places left over, the same number in all outputs that have it; in each row the solution \
     is judged whose squared distance from the expected one, summed over these outputs (NaN: infinite), is least, the first of equals";

/// The name of a class and its numbers by name, as the JSON has them.
#[must_use]
pub fn class(class: Class) -> (&'static str, Map<String, Value>) {
    let (name, numbers) = match class {
        Class::Exact => ("exact", vec![]),
        Class::Ulp(n) => ("ulp", vec![("ulp", json!(n))]),
        Class::AbsRel { abs, rel } => ("abs_rel", vec![("abs", json!(abs)), ("rel", json!(rel))]),
        Class::Vector { abs, rel } => ("vector", vec![("abs", json!(abs)), ("rel", json!(rel))]),
        Class::Rows {
            rel,
            floor,
            share,
            hard,
        } => (
            "rows",
            vec![
                ("rel", json!(rel)),
                ("floor", json!(floor)),
                ("share", json!(share)),
                ("hard", json!(hard)),
            ],
        ),
        Class::Banded { tight, share, hard } => (
            "banded",
            vec![
                ("tight", json!(tight)),
                ("share", json!(share)),
                ("hard", json!(hard)),
            ],
        ),
    };
    let numbers = numbers.into_iter().map(|(k, v)| (k.to_owned(), v));
    (name, numbers.collect())
}

#[derive(Serialize)]
struct Entry<'a> {
    name: &'static str,
    class: &'static str,
    #[serde(flatten)]
    numbers: Map<String, Value>,
    /// Of the outputs judged by it.
    units: Vec<&'a str>,
    reason: &'static str,
}

#[derive(Serialize)]
struct StageEntry {
    name: &'static str,
    part: &'static str,
    needs: &'static [&'static str],
}

/// Units of the outputs that each tolerance judges, in f64 or in f32.
fn units(cases: &[Case]) -> BTreeMap<&'static str, BTreeSet<&str>> {
    let mut units: BTreeMap<_, BTreeSet<_>> = BTreeMap::new();
    for case in cases {
        for name in case.outputs().keys() {
            let both = [
                case.tolerance(name).copied().ok(),
                case.tolerance_f32(name).ok(),
            ];
            let judged = both.iter().flatten().any(|t| t.class != Class::Exact);
            let inputs = case.inputs();
            let budget = judged
                && robust(case, name, case.output(name)).is_some()
                && inputs.get(&format!("robust_{name}")).is_none();
            let flips = tol::flips(case.stage(), inputs.flags()).filter(|_| budget);
            for tolerance in both.iter().flatten().chain(flips) {
                let entry = units.entry(tolerance.name).or_default();
                entry.extend(case.unit(name));
            }
        }
    }
    units
}

/// A list with one element a line.
fn lines<T: Serialize>(elements: impl Iterator<Item = T>) -> Result<String, serde_json::Error> {
    let lines = elements.map(|element| Ok(format!("    {}", serde_json::to_string(&element)?)));
    let lines: Vec<String> = lines.collect::<Result<_, serde_json::Error>>()?;
    Ok(format!("[\n{}\n  ]", lines.join(",\n")))
}

/// The whole file, with the units of the outputs of `cases`.
///
/// # Errors
/// If a number cannot be written as JSON; none of the table is such.
pub fn text(cases: &[Case]) -> Result<String, serde_json::Error> {
    let units = units(cases);
    let entry = |tolerance: &Tolerance| {
        let (class, numbers) = class(tolerance.class);
        let units = units.get(tolerance.name);
        Entry {
            name: tolerance.name,
            class,
            numbers,
            units: units
                .map(|u| u.iter().copied().collect())
                .unwrap_or_default(),
            reason: tolerance.reason,
        }
    };
    let stages = STAGES.iter().map(|stage| StageEntry {
        name: stage.name,
        part: stage.part,
        needs: stage.needs,
    });
    let classes = CLASSES
        .iter()
        .map(|(name, rule)| json!({ "name": name, "rule": rule }));
    let several = SEVERAL.iter().map(|(stage, flag, most)| {
        json!({ "stage": stage, "flag": flag, "most": most, "rule": SEVERAL_RULE })
    });
    let f32s = json!({
        "rule": F32_RULE,
        "names": ["STAGE.f32.OUTPUT_FLAG", "STAGE.f32.OUTPUT", "WIDE"],
        "factor": F32_OVER_F64,
        "at_most": LARGEST_ROUNDING,
    });
    let limits = json!({ "file_bytes": MAX_FILE_BYTES, "whole_number": EXACT_F64 });
    let parts = [
        ("schema", json!(1).to_string()),
        (
            "about",
            json!("written by `garad golden tolerances --json` from crates/golden/src/tol.rs")
                .to_string(),
        ),
        ("classes", lines(classes)?),
        ("f32", f32s.to_string()),
        ("robust", json!({ "rule": ROBUST_RULE }).to_string()),
        ("several_solutions", lines(several)?),
        ("limits", limits.to_string()),
        ("stages", lines(stages)?),
        ("tolerances", lines(TABLE.iter().map(entry))?),
    ];
    let parts = parts.map(|(key, value)| format!("  \"{key}\": {value}"));
    Ok(format!("{{\n{}\n}}\n", parts.join(",\n")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_class_has_a_rule_and_every_number_its_name() {
        let band = Class::Banded {
            tight: 0.5,
            share: 0.25,
            hard: 2.0,
        };
        let rows = Class::Rows {
            rel: 5.5,
            floor: 6.5,
            share: 0.75,
            hard: 7.5,
        };
        for (of, name, numbers) in [
            (Class::Exact, "exact", json!({})),
            (Class::Ulp(3), "ulp", json!({ "ulp": 3 })),
            (
                Class::AbsRel { abs: 1.5, rel: 2.5 },
                "abs_rel",
                json!({ "abs": 1.5, "rel": 2.5 }),
            ),
            (
                Class::Vector { abs: 3.5, rel: 4.5 },
                "vector",
                json!({ "abs": 3.5, "rel": 4.5 }),
            ),
            (
                rows,
                "rows",
                json!({ "rel": 5.5, "floor": 6.5, "share": 0.75, "hard": 7.5 }),
            ),
            (
                band,
                "banded",
                json!({ "tight": 0.5, "share": 0.25, "hard": 2.0 }),
            ),
        ] {
            assert_eq!(
                class(of),
                (name, numbers.as_object().unwrap().clone()),
                "{of:?}"
            );
            assert!(CLASSES.iter().any(|(n, _)| *n == name), "{name}: no rule");
        }
    }
}
