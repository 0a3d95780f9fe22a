//! `garad golden tolerances`.

use std::collections::BTreeMap;

use anyhow::Result;
use garad_conformance::Width;
use garad_golden::judge::judge;
use garad_golden::{Case, Class, Dtype, tol};

use crate::commands::say;

/// Largest share of each tolerance that this project's own stages use, in both widths.
fn margins(cases: &[Case]) -> Result<BTreeMap<String, f64>> {
    let mut margins = BTreeMap::new();
    for width in [Width::F64, Width::F32] {
        for case in cases {
            let Some(outputs) = super::own(case, width)? else {
                continue;
            };
            for output in judge(case, &outputs.answers(), false).outputs {
                let Some(comparison) = output.comparison else {
                    continue;
                };
                let narrow = output.dtype == Some(Dtype::F32)
                    && case.output(&output.name).dtype() == Dtype::F64
                    && tol::find(comparison.tolerance.name) != Some(&comparison.tolerance);
                let suffix = if narrow { SCALED } else { "" };
                let name = format!("{}{suffix}", comparison.tolerance.name);
                let seen = margins.entry(name).or_insert(0.0f64);
                *seen = seen.max(comparison.worst);
            }
        }
    }
    Ok(margins)
}

/// Marks a tolerance of f64 that was widened for f32.
const SCALED: &str = " x 2^29";

/// Prints the table, with what this project's own stages use of it on `cases`.
pub(super) fn tolerances(cases: &[Case]) -> Result<()> {
    let margins = margins(cases)?;
    let seen = |name: &str| {
        margins
            .get(name)
            .map_or("-".to_owned(), |m| format!("{m:.3}"))
    };
    say(&format!("{:36} {:28} seen   reason", "name", "allowed"))?;
    for t in tol::TABLE {
        let part = |abs: f64, rel: f64, of: &str| match (abs > 0.0, rel > 0.0) {
            (true, false) => format!("{abs:e}"),
            (false, _) => format!("{rel:e} {of}"),
            (true, true) => format!("{abs:e} + {rel:e} {of}"),
        };
        let rule = match t.class {
            Class::Exact => "exact".to_owned(),
            Class::Ulp(n) => format!("{n} ulp"),
            Class::AbsRel { abs, rel } => part(abs, rel, "|x|"),
            Class::Vector { abs, rel } => part(abs, rel, "max |x|"),
            Class::Banded { tight, share, hard } => {
                format!("{tight:e}; {} %: {hard:e}", 100.0 * share)
            }
            Class::Rows {
                rel,
                floor,
                share,
                hard,
            } => format!(
                "{rel:e} |row| + {floor:e} scale; {} % of rows: {hard} times",
                100.0 * share
            ),
        };
        say(&format!(
            "{:36} {rule:28} {:6} {}",
            t.name,
            seen(t.name),
            t.reason
        ))?;
        let scaled = format!("{}{SCALED}", t.name);
        if margins.contains_key(&scaled) {
            say(&format!(
                "{scaled:36} {:28} {:6} as above, for f32",
                "",
                seen(&scaled)
            ))?;
        }
    }
    say(
        "seen: the largest share of it that this project's own stages use; -: they are not run here",
    )?;
    say("f32 without an entry of its own: 2^29 times the tolerance, if that is at most 1e-12")
}
