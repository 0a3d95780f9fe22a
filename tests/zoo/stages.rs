//! Stages written a second time from their definitions, in f64 or as the case asks, and where each is written.

use garad_conformance::{Outputs, Width};
use garad_golden::Inputs;

use super::answers::Given;
use super::second::How;
use super::{adjust, corners, field, geometry, paths, reprojection, tracks, training};

/// Stages that share code: a fault of one group leaves the others as they are.
pub(crate) const GROUPS: [&[&str]; 7] = [
    &["se3", "camera", "epipolar", "robust"],
    &["kernel", "mean_field"],
    &["losses", "adam"],
    &["fast", "orb", "matching"],
    &["lk"],
    &["reprojection", "pose_lm", "bundle"],
    &["trajectory", "label_window"],
];

/// garad's own answer, for what a stage is not written a second time for.
pub(crate) fn own(inputs: &Inputs) -> Outputs {
    let own = garad_conformance::answer(inputs, Width::F64).expect("a sound case");
    own.expect("a stage of garad")
}

/// The stage's answer over garad's own.
pub(crate) fn answer(case: Given<'_>, own: &Outputs, how: &How) -> Outputs {
    let mut out = own.clone();
    let stage = match case.0.stage() {
        "se3" => geometry::se3,
        "camera" => geometry::camera,
        "epipolar" => geometry::epipolar,
        "robust" => geometry::robust,
        "kernel" => field::kernel,
        "mean_field" => field::mean_field,
        "losses" => training::losses,
        "adam" => training::adam,
        "fast" => corners::fast,
        "orb" => corners::orb,
        "matching" => corners::matching,
        "lk" => tracks::lucas_kanade,
        "reprojection" => reprojection::reprojection,
        "pose_lm" => adjust::pose,
        "bundle" => adjust::bundle,
        "trajectory" => paths::trajectory,
        "label_window" => paths::label_window,
        other => unreachable!("{other} is in no group"),
    };
    stage(case, how, &mut out);
    out
}
