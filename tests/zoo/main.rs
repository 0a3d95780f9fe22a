//! Faulty ports, each with one mistake as it was reported of a real program, and ports that compute otherwise but
//! rightly. The golden cases must catch every one of the first, name its stage, and pass all of the second.

mod adjust;
mod answers;
mod at_size;
mod blend;
mod corners;
mod faults;
mod field;
mod geometry;
mod harmonics;
mod hints;
mod number;
mod paths;
mod perturbed;
mod python;
mod raster;
mod rendering;
mod reprojection;
mod second;
mod splats;
mod stages;
mod tracks;
mod training;

use std::fmt::Debug;

use answers::{Given, shaped};
use faults::FaultyPort;
use garad_conformance::Outputs;
use garad_golden::Case;
use garad_golden::answers::Answers;
use garad_golden::judge::judge;
use garad_golden::verdict::{CaseVerdict, Outcome};
use raster::Renderer;
use rendering::{Density, How, Walk};
use second::Sum;

fn cases(of: &[&str]) -> Vec<Case> {
    let mut cases = Case::load_root(&Case::root()).expect("committed");
    cases.retain(|c| of.contains(&c.stage()));
    cases.sort_by_key(|c| (garad_golden::stages::rank(c.stage()), c.name()));
    cases
}

fn failed(verdicts: impl Iterator<Item = CaseVerdict>) -> Vec<String> {
    let bad = verdicts.filter(|v| v.outcome != Outcome::Pass);
    bad.map(|v| {
        let worst = v
            .worst()
            .map(|o| format!("{}: {:?}", o.name, o.comparison.as_ref().map(|c| c.worst)));
        format!("{}/{} {}", v.stage, v.case, worst.unwrap_or_default())
    })
    .collect()
}

/// The faulty ports that no case catches first at their stage, by `answer`.
fn escaped<F: Copy + Debug + 'static>(
    ports: impl Iterator<Item = &'static FaultyPort<F>>,
    cases: &[Case],
    answer: impl Fn(usize, F) -> Answers,
) -> Vec<String> {
    let wrong = ports.filter_map(|port| {
        let mut verdicts =
            (0..cases.len()).map(|i| judge(&cases[i], &answer(i, port.fault), false));
        let first = verdicts.find(|v| v.outcome != Outcome::Pass);
        let first = first.as_ref().map(|v| v.stage.as_str());
        let FaultyPort {
            fault,
            stage,
            report,
        } = port;
        (first != Some(stage))
            .then(|| format!("{fault:?} ({report}): first {first:?}, not {stage}"))
    });
    wrong.collect()
}

#[test]
fn every_faulty_renderer_is_caught_at_its_stage() {
    let cases = cases(&raster::STAGES);
    let answer = |i: usize, fault| {
        let case: &Case = &cases[i];
        shaped(case, &Renderer::faulty(fault).answer(Given(case.inputs())))
    };
    let wrong = escaped(rendering::FAULTY_PORTS.iter(), &cases, answer);
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// Every way of computing the same in f32.
fn renderers() -> Vec<Renderer> {
    let walks = [
        Walk::Rows,
        Walk::Columns,
        Walk::Backwards,
        Walk::Pairs,
        Walk::Tiles(8),
        Walk::Tiles(16),
        Walk::Tiles(32),
    ];
    let mut all = Vec::new();
    for walk in walks {
        for density in [Density::Plain, Density::Product, Density::Slanted] {
            for exp_ulp in [0, 2, 4] {
                for (fma, ftz) in [(false, false), (true, false), (false, true), (true, true)] {
                    let how = How {
                        fault: None,
                        walk,
                        density,
                        exp_ulp,
                    };
                    all.push(Renderer { fma, ftz, how });
                }
            }
        }
    }
    all
}

/// Of the renderers that round otherwise every so many, through every case of the rasterizer.
fn every_renderer_passes(step: usize) {
    let cases = cases(&raster::STAGES);
    let all = renderers();
    assert!(all.len() >= 100, "{}", all.len());
    let mut alarms = Vec::new();
    for renderer in all.iter().step_by(step) {
        let answer = |case: &Case| shaped(case, &renderer.answer(Given(case.inputs())));
        let bad = failed(cases.iter().map(|case| judge(case, &answer(case), false)));
        if !bad.is_empty() {
            alarms.push(format!("{renderer:?}: {bad:?}"));
        }
    }
    assert!(alarms.is_empty(), "false alarms: {alarms:#?}");
}

#[test]
fn renderers_that_round_otherwise_pass() {
    every_renderer_passes(5);
}

#[test]
#[ignore = "minutes: all of them instead of every fifth"]
fn all_renderers_that_round_otherwise_pass() {
    every_renderer_passes(1);
}

/// The cases of a group of stages, and garad's own answers.
fn with_own(group: &[&str]) -> (Vec<Case>, Vec<Outputs>) {
    let cases = cases(group);
    let own = cases
        .iter()
        .map(|case| stages::own(case.inputs()))
        .collect();
    (cases, own)
}

#[test]
fn every_faulty_formula_is_caught_at_its_stage() {
    let mut wrong = Vec::new();
    for group in stages::GROUPS {
        let (cases, own) = with_own(group);
        let answer = |i: usize, fault| {
            let how = second::How {
                fault: Some(fault),
                sum: Sum::Forwards,
            };
            let case: &Case = &cases[i];
            shaped(case, &stages::answer(Given(case.inputs()), &own[i], &how))
        };
        let ports = second::FAULTY_PORTS.iter();
        let ports = ports.filter(|port| group.contains(&port.stage));
        wrong.extend(escaped(ports, &cases, answer));
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn formulas_summed_otherwise_pass() {
    for group in stages::GROUPS {
        let (cases, own) = with_own(group);
        for sum in [Sum::Forwards, Sum::Backwards, Sum::Tree] {
            let how = second::How { fault: None, sum };
            let verdicts = cases.iter().zip(&own).map(|(case, own)| {
                let out = stages::answer(Given(case.inputs()), own, &how);
                judge(case, &shaped(case, &out), false)
            });
            let bad = failed(verdicts);
            assert!(bad.is_empty(), "{sum:?}: {bad:#?}");
        }
    }
}

/// What the suite is for: mistakes that people have made.
#[test]
fn most_faults_have_been_reported_of_real_programs() {
    let raster = rendering::FAULTY_PORTS.iter().map(|p| p.report);
    let second = second::FAULTY_PORTS.iter().map(|p| p.report);
    let reports: Vec<&str> = raster.chain(second).collect();
    let real = reports.iter().filter(|r| **r != "port").count();
    assert!(
        reports.len() >= 174 && real >= 85,
        "{real} of {}",
        reports.len()
    );
}
