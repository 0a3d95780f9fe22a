//! Verdicts as a table to read and as JSON for machines.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use serde_json::{Value, json};

use crate::stages;
use crate::table;
use crate::tol::Class;
use crate::verdict::{CaseVerdict, Outcome, OutputVerdict, Verdict};

/// One line per case, with what failed below it; then the stages the backend does not do, and which
/// stage to look at first.
#[must_use]
pub fn table(verdicts: &[CaseVerdict]) -> String {
    let mut text = String::new();
    let width = |f: fn(&CaseVerdict) -> usize| verdicts.iter().map(f).max().unwrap_or(0).max(5);
    let (stage, case) = (width(|v| v.stage.len()), width(|v| v.case.len()));
    line(
        &mut text,
        format_args!(
            "{:stage$}  {:case$}  verdict      worst/tolerance",
            "stage", "case"
        ),
    );
    let silent = |v: &&CaseVerdict| v.outcome == Outcome::Unsupported;
    for verdict in verdicts.iter().filter(|v| !silent(v)) {
        let worst = verdict.worst().and_then(|output| {
            let comparison = output.comparison.as_ref()?;
            let dtype = output.dtype.map_or("", crate::Dtype::name);
            let share = share(comparison.worst);
            Some(format!("{share:<10} {} ({dtype})", output.name))
        });
        line(
            &mut text,
            format_args!(
                "{:stage$}  {:case$}  {:<11}  {}",
                verdict.stage,
                verdict.case,
                verdict.outcome.name(),
                worst.unwrap_or_default()
            ),
        );
        if let Outcome::Crash(why) | Outcome::Timeout(why) = &verdict.outcome {
            line(&mut text, format_args!("    {why}"));
        }
        if verdict.outcome == Outcome::Fail {
            for output in verdict
                .outputs
                .iter()
                .filter(|o| o.verdict != Verdict::Pass)
            {
                line(&mut text, format_args!("    {}", describe(output)));
                if let Some(metrics) = &output.metrics {
                    line(&mut text, format_args!("        {metrics}"));
                }
                if let Some(note) = &output.note {
                    line(&mut text, format_args!("        {note}"));
                }
            }
        }
    }
    let mut stages: Vec<&str> = verdicts
        .iter()
        .filter(silent)
        .map(|v| v.stage.as_str())
        .collect();
    stages.dedup();
    if !stages.is_empty() {
        line(
            &mut text,
            format_args!("unsupported: {}", stages.join(", ")),
        );
    }
    text.push_str(&advice(verdicts));
    line(&mut text, format_args!("{}", summary(verdicts)));
    text
}

/// A multiple of a tolerance, with a power of ten from 1e5 on.
fn share(worst: f64) -> String {
    if worst.is_finite() && worst >= 1e5 {
        format!("{worst:.1e}")
    } else {
        format!("{worst:.3}")
    }
}

fn line(text: &mut String, arguments: std::fmt::Arguments<'_>) {
    // Writing into a string does not fail.
    let _ = text.write_fmt(arguments);
    while text.ends_with(' ') {
        text.pop();
    }
    text.push('\n');
}

/// The worst element: where, what, how far.
fn describe(output: &OutputVerdict) -> String {
    let Some(c) = &output.comparison else {
        return format!("{} {}", output.verdict.name(), output.name);
    };
    let bound = match c.tolerance.class {
        Class::Exact => "exactly".to_owned(),
        Class::Ulp(n) => format!("within {n} representable numbers"),
        Class::Banded { tight, share, hard } => {
            format!(
                "within {hard:e}, all but {:.1} % within {tight:e}",
                100.0 * share
            )
        }
        Class::Rows { share, hard, .. } => format!(
            "within {:.3e}, all but {:.1} % of the rows within {:.3e}",
            c.bound,
            100.0 * share,
            c.bound / hard
        ),
        _ => format!("within {:.3e}", c.bound),
    };
    format!(
        "{} {}{:?}: got {:?}, expected {:?} {bound} ({}); {} of {} are outside",
        output.verdict.name(),
        output.name,
        c.worst_index,
        c.got,
        c.expected,
        c.tolerance.name,
        c.outside,
        c.elements
    )
}

/// How each stage went: the worst of its cases.
fn by_stage(verdicts: &[CaseVerdict]) -> BTreeMap<&str, &'static str> {
    let mut stages: BTreeMap<&str, &'static str> = BTreeMap::new();
    for verdict in verdicts {
        let word = match verdict.outcome {
            Outcome::Pass => "passes",
            Outcome::Missing | Outcome::Unsupported => "was not run",
            _ => "FAILS",
        };
        let rank = |word: &str| {
            ["was not run", "passes", "FAILS"]
                .iter()
                .position(|w| *w == word)
        };
        let entry = stages.entry(&verdict.stage).or_insert(word);
        if rank(word) > rank(entry) {
            *entry = word;
        }
    }
    stages
}

/// Which stage to look at first: a failing one whose needs pass.
fn advice(verdicts: &[CaseVerdict]) -> String {
    let stages = by_stage(verdicts);
    let mut failing: Vec<&str> = stages
        .iter()
        .filter(|(_, word)| **word == "FAILS")
        .map(|(stage, _)| *stage)
        .collect();
    failing.sort_by_key(|stage| stages::rank(stage));
    let mut text = String::new();
    for stage in &failing {
        let needs = stages::find(stage).map_or(&[][..], |s| s.needs);
        let words: Vec<String> = needs
            .iter()
            .map(|need| format!("{need} {}", stages.get(need).unwrap_or(&"was not run")))
            .collect();
        let below = needs
            .iter()
            .find(|need| stages.get(*need) == Some(&"FAILS"));
        let all_hold = needs.iter().all(|need| stages.get(need) == Some(&"passes"));
        let advice = match below {
            Some(below) => format!("look at {below} first"),
            None if all_hold => "the stages it needs pass: the mistake is in this stage".to_owned(),
            None => "run the stages it needs as well".to_owned(),
        };
        let words = if words.is_empty() {
            String::new()
        } else {
            format!(" ({})", words.join(", "))
        };
        line(&mut text, format_args!("{stage} FAILS{words}: {advice}"));
    }
    if let [first, _, ..] = failing.as_slice() {
        line(&mut text, format_args!("first stage that differs: {first}"));
    }
    text
}

/// Cases by outcome.
#[must_use]
pub fn counts(verdicts: &[CaseVerdict]) -> BTreeMap<&'static str, usize> {
    let mut counts = BTreeMap::new();
    for verdict in verdicts {
        *counts.entry(verdict.outcome.name()).or_insert(0) += 1;
    }
    counts
}

fn summary(verdicts: &[CaseVerdict]) -> String {
    let counts = counts(verdicts);
    let words: Vec<String> = counts
        .iter()
        .map(|(name, n)| format!("{n} {name}"))
        .collect();
    format!("{} cases: {}", verdicts.len(), words.join(", "))
}

/// Everything, output by output. Numbers that JSON lacks are strings.
#[must_use]
pub fn to_json(verdicts: &[CaseVerdict], passed: bool) -> Value {
    let number = |v: f64| {
        if v.is_finite() {
            json!(v)
        } else {
            json!(v.to_string())
        }
    };
    let output = |output: &OutputVerdict| {
        let mut entry = json!({
            "output": output.name,
            "verdict": output.verdict.name().to_lowercase(),
            "dtype": output.dtype.map(crate::Dtype::name),
            "note": output.note,
        });
        if let Some(c) = &output.comparison {
            entry["tolerance"] = json!(c.tolerance.name);
            let (class, numbers) = table::class(c.tolerance.class);
            entry["class"] = json!(class);
            entry["numbers"] = json!(numbers);
            entry["allowed"] = number(c.bound);
            entry["worst"] = number(c.worst);
            entry["at"] = json!(c.worst_index);
            entry["expected"] = number(c.expected);
            entry["got"] = number(c.got);
            entry["outside"] = json!(c.outside);
            entry["elements"] = json!(c.elements);
        }
        if let Some(m) = &output.metrics {
            entry["rel_l2"] = json!(m.rel_l2);
            entry["cosine"] = json!(m.cosine);
            entry["rows_missing"] = json!(m.rows_missing);
            entry["rows_extra"] = json!(m.rows_extra);
        }
        entry
    };
    let case = |verdict: &CaseVerdict| {
        json!({
            "stage": verdict.stage,
            "case": verdict.case,
            "basis": verdict.basis,
            "verdict": verdict.outcome.name().to_lowercase(),
            "reason": match &verdict.outcome {
                Outcome::Crash(why) | Outcome::Timeout(why) => Some(why),
                _ => None,
            },
            "outputs": verdict.outputs.iter().map(output).collect::<Vec<_>>(),
        })
    };
    json!({
        "passed": passed,
        "counts": counts(verdicts),
        "stages": by_stage(verdicts),
        "advice": advice(verdicts).lines().collect::<Vec<_>>(),
        "cases": verdicts.iter().map(case).collect::<Vec<_>>(),
    })
}

#[cfg(test)]
mod tests {
    use super::share;

    #[test]
    fn large_shares_have_a_power_of_ten() {
        for (worst, text) in [
            (0.0, "0.000"),
            (1.5, "1.500"),
            (99_999.0, "99999.000"),
            (1e5, "1.0e5"),
            (1.04e15, "1.0e15"),
            (f64::INFINITY, "inf"),
        ] {
            assert_eq!(share(worst), text, "{worst}");
        }
    }
}
