//! Every stage against its golden cases, in every form it has; the same bits from one and from two threads.

use garad_conformance::{Form, STAGES, forms};
use garad_core::Par;
use garad_golden::Case;
use garad_golden::judge::judge;
use garad_golden::verdict::Outcome;

fn problem(case: &Case, form: &Form) -> Option<String> {
    let answer = |par| form.answer(case.inputs(), par).map_err(|e| e.to_string());
    let outputs = match answer(Par::Seq) {
        Ok(outputs) => outputs,
        Err(error) => return Some(error),
    };
    if answer(Par::Threads(2)) != Ok(outputs.clone()) {
        return Some("two threads change bits".to_owned());
    }
    let verdict = judge(case, &outputs.answers(), false);
    let worst = verdict.worst().map(|o| (&o.name, &o.comparison, &o.note));
    (verdict.outcome != Outcome::Pass).then(|| format!("{}: {worst:?}", verdict.outcome.name()))
}

fn check(stage: &str) {
    let forms = forms(stage);
    assert!(!forms.is_empty(), "{stage}: no form");
    let mut problems = Vec::new();
    for case in Case::load_all(stage) {
        for form in forms {
            let named = |what| format!("{}, {}: {what}", case.name(), form.name);
            problems.extend(problem(&case, form).map(named));
        }
    }
    assert!(problems.is_empty(), "{}", problems.join("\n"));
}

macro_rules! stages {
    ($(fn $stage:ident();)*) => {
        $(#[test]
        fn $stage() {
            check(stringify!($stage));
        })*

        #[test]
        fn every_stage_is_checked_here() {
            let checked = [$(stringify!($stage)),*];
            let stages: Vec<&str> = STAGES.iter().map(|s| s.0).collect();
            assert_eq!(stages, checked, "in the order of STAGES");
        }
    };
}

stages! {
    fn decode();
    fn associate();
    fn bonn();
    fn ply();
    fn se3();
    fn camera();
    fn undistort();
    fn pyramid();
    fn fast();
    fn orb();
    fn matching();
    fn lk();
    fn epipolar();
    fn flow();
    fn robust();
    fn reprojection();
    fn place();
    fn pnp();
    fn pose_lm();
    fn landmark_links();
    fn keyframe();
    fn bundle();
    fn pose_graph();
    fn free_space();
    fn cues();
    fn unary();
    fn kernel();
    fn mean_field();
    fn label_window();
    fn relabel();
    fn sh();
    fn projection_covariance();
    fn raster();
    fn raster_backward();
    fn losses();
    fn knn_scale();
    fn adam();
    fn sgd();
    fn image_pyramid();
    fn densify();
    fn train_step();
    fn train_run();
    fn trajectory();
    fn image_metrics();
}

/// Both kinds of case, descriptors of an image and angles alone, are there.
#[test]
fn orb_cases_are_of_both_kinds() {
    let angles = |case: &Case| case.outputs().contains_key("atan2");
    let cases = Case::load_all("orb");
    assert!(cases.iter().any(angles), "no angles");
    assert!(!cases.iter().all(angles), "no descriptors");
}

/// Tracked points are the same bits in both forms.
#[test]
fn fast_tracking_is_the_reference() {
    for case in Case::load_all("lk") {
        let answer = |form: &Form| form.answer(case.inputs(), Par::Seq).expect("sound");
        let all: Vec<_> = forms("lk").iter().map(answer).collect();
        assert!(all.len() == 2 && all[0] == all[1], "{}", case.name());
    }
}
