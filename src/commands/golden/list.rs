//! `garad golden list`.

use std::collections::BTreeMap;

use anyhow::Result;
use garad_golden::{Case, Tensor, stages};
use serde_json::{Value, json};

use crate::commands::say;

fn tensors<'a>(case: &'a Case, names: impl Iterator<Item = &'a str>, inputs: bool) -> Vec<Value> {
    let entry = |name: &str| {
        let tensor = if inputs {
            case.input(name)
        } else {
            case.output(name)
        };
        let tolerance = case.tolerance(name).ok().filter(|_| !inputs);
        json!({
            "name": name,
            "dtype": tensor.dtype().name(),
            "shape": tensor.shape(),
            "tolerance": tolerance.map(|t| t.name),
        })
    };
    names.map(entry).collect()
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
                "flags": case.flags(),
                "params": case.param_names().map(|n| (n, case.param(n))).collect::<BTreeMap<_, _>>(),
                "inputs": tensors(case, case.input_names(), true),
                "outputs": tensors(case, case.output_names(), false),
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
        let shape = |name: &str, tensor: &Tensor| {
            format!("{name} {}{:?}", tensor.dtype().name(), tensor.shape())
        };
        let inputs = case.input_names().map(|n| shape(n, case.input(n)));
        let outputs = case.output_names().map(|n| shape(n, case.output(n)));
        say(&format!(
            "      in   {}",
            inputs.collect::<Vec<_>>().join(", ")
        ))?;
        say(&format!(
            "      out  {}",
            outputs.collect::<Vec<_>>().join(", ")
        ))?;
    }
    say(&format!("{} cases", cases.len()))
}
