//! What `garad golden check` says of each mistake: the hint below a failing output.

use std::fmt::Debug;

use garad_golden::Case;
use garad_golden::answers::Answers;
use garad_golden::judge::judge;
use garad_golden::verdict::Verdict;

use super::answers::{Given, shaped};
use super::faults::FaultyPort;
use super::raster::{self, Renderer};
use super::rendering::{self, Fault as Raster};
use super::second::{self, Fault as Second, Sum};
use super::{cases, stages, with_own};

/// Slips of a renderer, and a part of the hint that must be given at its stage.
const RASTER: &[(Raster, &str)] = &[
    (
        Raster::QuaternionOrder,
        "quaternions were read as (x, y, z, w)",
    ),
    (Raster::QuaternionNotNormalised, "to length 1"),
    (Raster::ColumnMajor, "transposed"),
    (Raster::WorldForCamera, "world_from_camera"),
    (Raster::PrincipalPoint, "principal point"),
    (Raster::NoClamp, "not clamped to 1.3 tan(fov/2)"),
    (Raster::NoDilation, "0.3 px² on the diagonal"),
    (Raster::DepthIsRange, "distance from the camera"),
    (Raster::ScaleNotExponential, "the exponential is missing"),
    (Raster::TwoSigma, "two standard deviations"),
    (Raster::HalfPixel, "integers + 0.5"),
    (Raster::SortReversed, "back to front"),
    (Raster::SortByDistance, "sorted by their distance"),
    (Raster::OpacityNotActivated, "the sigmoid is missing"),
    (
        Raster::ActivatedTwice,
        "the sigmoid is applied to the opacity twice",
    ),
    (Raster::ChannelsReversed, "BGR instead of RGB"),
    (Raster::NoAlphaThreshold, "alpha below 1/255 is drawn"),
    (Raster::NoAlphaLimit, "alpha is not limited to 0.99"),
    (Raster::AlphaLimitOfGsplat, "gsplat has 0.999"),
    (Raster::EarlyStop, "ends where T falls below 1e-3"),
    (Raster::NoStop, "blending does not end"),
    (Raster::BackgroundMissing, "the background is missing"),
    (Raster::BackgroundInFull, "the background is added in full"),
    (
        Raster::DepthNormalised,
        "the depth is divided by the opacity",
    ),
    (Raster::ConicFactor, "the off-diagonal of the conic"),
    (
        Raster::NoGradientThroughDirection,
        "through the view direction",
    ),
    (
        Raster::ClampGradientIgnored,
        "clamped slope is differentiated by z",
    ),
    (Raster::ScaleForLogScale, "the gradient by the scale"),
    (Raster::OpacityForLogit, "the gradient by the opacity"),
    (Raster::LengthForgotten, "not divided by the length"),
    (Raster::PoseFromTheRight, "step in the world's frame"),
    (Raster::ShSign, "the sign"),
    (Raster::ShOrder, "exchanged"),
];

/// Slips of the other stages.
const SECOND: &[(Second, &str)] = &[
    (Second::KernelWithoutHalf, "divided by σ², not by 2σ²"),
    (Second::KernelSigmaNotSquared, "divided by 2σ, not by 2σ²"),
    (Second::FieldNormalisedOtherwise, "normalised symmetrically"),
    (Second::FieldPushes, "the other sign"),
    (Second::FieldOneIterationLess, "one iteration less"),
    (Second::FieldInPlace, "updated in place"),
    (Second::FieldUnsigned, "q, not 2q - 1"),
    (Second::HuberWithoutConstant, "- δ² is missing"),
    (Second::HuberHalfWeight, "half of the weight"),
    (Second::HuberKneeNotSquared, "the scale is not squared"),
    (Second::SsimFlatWindow, "window is flat"),
    (Second::SsimConstantsOfBytes, "constants are those of bytes"),
    (Second::SsimThirteenTaps, "13 x 13"),
    (Second::SsimReflects, "reflects the image"),
    (
        Second::AdamNoCorrection,
        "the bias correction of both moments is missing",
    ),
    (Second::AdamConstantCorrection, "that of the first step"),
    (Second::AdamEpsilonInRoot, "inside of the root"),
    (Second::AdamEpsilonScaled, "before the bias correction"),
    (Second::RotationFirst, "(rotation, translation)"),
    (Second::PointNotTurned, "lacks the rotation of the camera"),
    (Second::SigmaSquared, "divided by σ², not by σ"),
    (Second::SigmaForgotten, "not divided by σ"),
];

/// Faults that no table has, and that must not get another one's name.
const NAMELESS: &[Raster] = &[
    Raster::CoarseExp,
    Raster::SubtleConic,
    Raster::FootprintOfThirtyTwo,
    Raster::OpacityCompensated,
    Raster::LastCountsSkipped,
];

/// The hints on all cases of the fault's own stage.
fn hints<F: Copy>(
    port: &FaultyPort<F>,
    cases: &[Case],
    answer: impl Fn(usize, F) -> Answers,
) -> Vec<String> {
    let own = (0..cases.len()).filter(|&i| cases[i].stage() == port.stage);
    let outputs = own.flat_map(|i| judge(&cases[i], &answer(i, port.fault), false).outputs);
    let failed = outputs.filter(|o| o.verdict == Verdict::Fail);
    failed.filter_map(|o| o.note).collect()
}

/// What is not named as the table says, and how many of all faults get some hint.
fn unnamed<F: Copy + Debug + PartialEq + 'static>(
    ports: impl Iterator<Item = &'static FaultyPort<F>>,
    table: &[(F, &str)],
    cases: &[Case],
    answer: impl Fn(usize, F) -> Answers,
) -> (Vec<String>, usize) {
    let (mut wrong, mut some) = (Vec::new(), 0);
    for port in ports {
        let hints = hints(port, cases, &answer);
        some += usize::from(!hints.is_empty());
        let expected = table.iter().find(|(fault, _)| *fault == port.fault);
        if let Some((fault, text)) = expected
            && !hints.iter().any(|hint| hint.contains(text))
        {
            wrong.push(format!("{fault:?}: {hints:?}, not '{text}'"));
        }
    }
    (wrong, some)
}

#[test]
fn usual_slips_of_a_renderer_are_named() {
    let cases = cases(&raster::STAGES);
    let answer = |i: usize, fault| {
        let case: &Case = &cases[i];
        shaped(case, &Renderer::faulty(fault).answer(Given(case.inputs())))
    };
    let ports = rendering::FAULTY_PORTS.iter();
    for port in ports.clone().filter(|p| NAMELESS.contains(&p.fault)) {
        let hints = hints(port, &cases, answer);
        assert!(hints.is_empty(), "{:?}: {hints:?}", port.fault);
    }
    let (wrong, some) = unnamed(ports, RASTER, &cases, answer);
    assert!(wrong.is_empty(), "{wrong:#?}");
    let all = rendering::FAULTY_PORTS.len();
    assert!(some >= 39, "{some} of {all}");
}

#[test]
fn usual_slips_of_the_other_stages_are_named() {
    let (mut wrong, mut named) = (Vec::new(), 0);
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
        let (missed, some) = unnamed(ports, SECOND, &cases, answer);
        wrong.extend(missed);
        named += some;
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
    let all = second::FAULTY_PORTS.len();
    assert!(named >= 31, "{named} of {all}");
}

/// A right answer needs no hint, and every entry of the tables is a port.
#[test]
fn tables_name_ports() {
    for (fault, text) in RASTER {
        let port = rendering::FAULTY_PORTS.iter().find(|p| p.fault == *fault);
        assert!(port.is_some() && !text.is_empty(), "{fault:?}");
    }
    for (fault, text) in SECOND {
        let port = second::FAULTY_PORTS.iter().find(|p| p.fault == *fault);
        assert!(port.is_some() && !text.is_empty(), "{fault:?}");
    }
}
