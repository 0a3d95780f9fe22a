//! Every stage, every equation of the paper, and what the expected values rest on.

use std::collections::BTreeSet;
use std::fs;

use garad::conformance::own::{self, Width};
use garad_golden::judge::{Outcome, judge};
use garad_golden::{Case, stages};

/// The paper's equations by the labels of its LaTeX; there is no 8 and no 14.
const EQUATIONS: [u32; 14] = [1, 2, 3, 4, 5, 6, 7, 9, 10, 11, 12, 13, 15, 16];

/// A folder with an index of its own kind, see `trace.rs` beside this file.
const TRACE: &str = "trace";

fn cases() -> Vec<Case> {
    Case::load_root(&Case::root()).expect("committed")
}

#[test]
fn every_stage_has_a_case_and_every_case_a_stage() {
    let cases = cases();
    let folders: BTreeSet<String> = fs::read_dir(Case::root())
        .expect("there")
        .map(|entry| entry.expect("readable"))
        .filter(|entry| entry.path().is_dir())
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .filter(|name| name != "gen")
        .collect();
    for stage in stages::STAGES {
        let name = stage.name;
        let there = cases.iter().any(|c| c.stage() == name) || name == TRACE;
        assert!(there && folders.contains(name), "{name}: no case");
        let own = own::STAGES.contains(&name) || name == TRACE;
        assert!(own, "{name}: `garad golden check --self` does not run it");
    }
    for folder in folders {
        assert!(stages::find(&folder).is_some(), "{folder}: not in STAGES");
    }
}

#[test]
fn every_equation_of_the_paper_has_a_case() {
    let cases = cases();
    for equation in EQUATIONS {
        let tag = format!("paper:{equation}");
        let of = |case: &&Case| case.equations().contains(&tag);
        let n = cases.iter().filter(of).count();
        assert!(n > 0, "eq. {equation} of the paper has no case");
    }
}

#[test]
fn expected_values_come_from_outside() {
    let cases = cases();
    let own = |case: &&Case| {
        ["self", "garad", "pin"]
            .iter()
            .any(|w| case.basis().starts_with(w))
    };
    let pins = cases.iter().filter(own).count();
    // The trace is the one that is pinned in part; what of it is checked, trace.rs counts.
    let share = 1.0 - (pins + 1) as f64 / (cases.len() + 1) as f64;
    assert!(
        share >= 0.9,
        "only {share:.3} of the cases rest on something outside"
    );
}

#[test]
fn own_stages_pass_all_cases() {
    let mut bad = Vec::new();
    for case in cases() {
        for width in [Width::F64, Width::F32] {
            let answers = own::answers(&case, width).expect("a sound case");
            let answers = answers.unwrap_or_else(|| panic!("{}: not run", case.name()));
            let verdict = judge(&case, &answers, false);
            if verdict.outcome != Outcome::Pass {
                let worst = verdict.worst().map(|o| (o.name.clone(), o.note.clone()));
                bad.push(format!(
                    "{} {width:?}: {} {worst:?}",
                    case.name(),
                    verdict.outcome.name()
                ));
            }
        }
    }
    assert!(bad.is_empty(), "{}", bad.join("\n"));
}
