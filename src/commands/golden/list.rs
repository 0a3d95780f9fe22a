//! `garad golden list`.

use std::collections::BTreeMap;

use anyhow::Result;
use garad_golden::{Case, Tensor, stages};
use serde_json::{Value, json};

use crate::commands::say;

fn tensors(case: &Case, tensors: &BTreeMap<String, Tensor>, inputs: bool) -> Vec<Value> {
    let entry = |(name, tensor): (&String, &Tensor)| {
        let tolerance = case.tolerance(name).ok().filter(|_| !inputs);
        json!({
            "name": name,
            "dtype": tensor.dtype().name(),
            "shape": tensor.shape(),
            "tolerance": tolerance.map(|t| t.name),
        })
    };
    tensors.iter().map(entry).collect()
}

/// Prints them, `as_json` or to read.
pub(super) fn list(cases: &[Case], as_json: bool) -> Result<()> {
    if as_json {
        let entry = |case: &Case| {
            json!({
                "stage": case.stage(),
                "case": case.case(),
                "folder": case.folder(),
                "why": case.why(),
                "basis": case.basis(),
                "equations": case.equations(),
                "flags": case.inputs().flags(),
                "params": case.inputs().params(),
                "inputs": tensors(case, case.inputs().tensors(), true),
                "outputs": tensors(case, case.outputs(), false),
            })
        };
        let list: Vec<Value> = cases.iter().map(entry).collect();
        return say(&serde_json::to_string_pretty(&list)?);
    }
    let mut stage = "";
    for case in cases {
        if case.stage() != stage {
            stage = case.stage();
            let about = stages::find(stage).map_or("", |s| s.about);
            say(&format!("{stage}: {about}"))?;
        }
        let equations = match case.equations() {
            [] => String::new(),
            some => format!(" · {}", some.join(", ")),
        };
        say(&format!("  {} · {}{equations}", case.case(), case.basis()))?;
        say(&format!("      {}", case.why()))?;
        for (side, tensors) in [("in ", case.inputs().tensors()), ("out", case.outputs())] {
            let shape = |(name, t): (&String, &Tensor)| {
                format!("{name} {}{:?}", t.dtype().name(), t.shape())
            };
            let shapes: Vec<String> = tensors.iter().map(shape).collect();
            say(&format!("      {side}  {}", shapes.join(", ")))?;
        }
    }
    say(&format!("{} cases", cases.len()))
}
