//! Every stage, every equation of the paper, and where the expected values come from.

use std::collections::BTreeSet;
use std::fs;

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
        let own = !garad_conformance::forms(name).is_empty() || name == TRACE;
        assert!(own, "{name}: `garad golden check --self` does not run it");
    }
    for stage in folders
        .iter()
        .map(String::as_str)
        .chain(cases.iter().map(Case::stage))
    {
        assert!(
            stages::find(stage).is_some(),
            "{stage}: not in crates/golden/src/stages.rs"
        );
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

/// What of the trace is checked, trace.rs counts.
#[test]
fn expected_values_come_from_outside() {
    for case in cases() {
        let own = ["self", "garad", "pin"]
            .iter()
            .any(|w| case.basis().starts_with(w));
        assert!(!own, "{}: rests on this project alone", case.name());
    }
}

/// The rasterizer is held to another project's code, not only to its formulas written again.
#[test]
fn the_rasterizer_is_judged_by_gsplat() {
    let cases = cases();
    for stage in ["sh", "projection_covariance", "raster", "raster_backward"] {
        let found = cases.iter().find(|case| {
            case.stage() == stage
                && case.basis() == "gsplat-torch-f64"
                && case.inputs().has_flag("gsplat")
        });
        assert!(found.is_some(), "{stage}: no case by gsplat");
    }
}
