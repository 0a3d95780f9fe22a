//! `garad golden list`.

use anyhow::Result;
use garad_golden::{Case, Tensor, Tolerance, stages, table};
use serde_json::{Value, json};

use crate::commands::say;

fn tensor(name: &str, tensor: &Tensor, unit: Option<&str>) -> Value {
    json!({
        "name": name,
        "dtype": tensor.dtype().name(),
        "shape": tensor.shape(),
        "unit": unit,
    })
}

/// Name, class and numbers.
fn tolerance(of: &Tolerance) -> Value {
    let (class, mut entry) = table::class(of.class);
    entry.insert("class".to_owned(), json!(class));
    entry.insert("name".to_owned(), json!(of.name));
    Value::Object(entry)
}

fn inputs(case: &Case) -> Vec<Value> {
    let inputs = case.inputs();
    let all = inputs.tensors().iter();
    all.map(|(name, t)| tensor(name, t, inputs.unit(name)))
        .collect()
}

/// Each with what it is held to, in f64 and in f32.
fn outputs(case: &Case) -> Result<Vec<Value>> {
    let entry = |(name, t): (&String, &Tensor)| {
        let wide = case.tolerance(name)?;
        let mut entry = tensor(name, t, case.unit(name));
        entry["tolerance"] = json!(wide.name);
        entry["allowed"] = tolerance(wide);
        entry["allowed_f32"] = tolerance(&case.tolerance_f32(name)?);
        Ok(entry)
    };
    case.outputs().iter().map(entry).collect()
}

/// Prints them, `as_json` or to read.
pub(super) fn list(cases: &[Case], as_json: bool) -> Result<()> {
    if as_json {
        let entry = |case: &Case| {
            Ok(json!({
                "stage": case.stage(),
                "case": case.case(),
                "folder": case.folder(),
                "why": case.why(),
                "basis": case.basis(),
                "equations": case.equations(),
                "flags": case.inputs().flags(),
                "params": case.inputs().params(),
                "inputs": inputs(case),
                "outputs": outputs(case)?,
            }))
        };
        let list: Vec<Value> = cases.iter().map(entry).collect::<Result<_>>()?;
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
