//! The bug zoo: backends with one mistake each, as they have been reported of real ones, and backends that compute
//! otherwise but rightly. The golden cases must catch every one of the first, name the stage, and pass all of the
//! second.
//!
//! `GARAD_EXTENSIVE=1` runs all liberties instead of every fifth.

mod adjust;
mod answers;
mod blend;
mod corners;
mod formulas;
mod harmonics;
mod number;
mod paths;
mod raster;
mod second;
mod splats;
mod tracks;

use garad_golden::judge::{CaseVerdict, Outcome, judge};
use garad_golden::{Case, stages};
use raster::{Backend, Density, How, Slip, Walk};

/// A backend with one mistake.
struct Bug {
    slip: Slip,
    /// Where it belongs.
    stage: &'static str,
    /// Who reported it, or `port`: a mistake that the port in examples/adapter_numpy is tried with.
    report: &'static str,
}

fn bug(slip: Slip, stage: &'static str, report: &'static str) -> Bug {
    Bug {
        slip,
        stage,
        report,
    }
}

#[rustfmt::skip]
fn raster_bugs() -> Vec<Bug> {
    use Slip::*;
    let (sh, projection, forward, backward) = ("sh", "projection_covariance", "raster", "raster_backward");
    vec![
        bug(ShSign, sh, "nerfstudio-project/nerfstudio#2112"),
        bug(ShConstant, sh, "nerfstudio-project/nerfstudio#1667"),
        bug(ShDegreeThree, sh, "cvlab-epfl/gaussian-splatting-web#2"),
        bug(ShOrder, sh, "port"),
        bug(QuaternionOrder, projection, "aras-p/UnityGaussianSplatting#163"),
        bug(QuaternionNotNormalised, projection, "port"),
        bug(ColumnMajor, projection, "tatsuya-ogawa/GaussianSplattingMlx#28"),
        bug(ClampOfZ, projection, "tatsuya-ogawa/GaussianSplattingMlx#28"),
        bug(PrincipalPoint, projection, "nerfstudio-project/gsplat#305"),
        bug(WorldForCamera, projection, "nerfstudio-project/gsplat#180"),
        bug(JacobianAtCamera, projection, "nerfstudio-project/gsplat#532"),
        bug(NoClamp, projection, "graphdeco-inria/diff-gaussian-rasterization#75"),
        bug(NoDilation, projection, "graphdeco-inria/gaussian-splatting#294"),
        bug(PlainDeterminant, projection, "port"),
        bug(TwoSigma, projection, "port"),
        bug(FootprintOfEight, projection, "port"),
        bug(FootprintOfThirtyTwo, projection, "port"),
        bug(HalfPixel, forward, "autonomousvision/gaussian-opacity-fields#48"),
        bug(SortInHalf, forward, "altunenes/cuneus#180"),
        bug(SortReversed, forward, "mosure/bevy_gaussian_splatting#204"),
        bug(SortByDistance, forward, "port"),
        bug(SortDropsOne, forward, "antimatter15/splat#59"),
        bug(SortDoublesOne, forward, "antimatter15/splat#59"),
        bug(PaddingDrawsZero, forward, "BabylonJS/Babylon.js#18752"),
        bug(PayloadOverwritten, forward, "aras-p/UnityGaussianSplatting#82"),
        bug(MaskBySortedIndex, forward, "tatsuya-ogawa/GaussianSplattingMlx#29"),
        bug(TooFewTiles, forward, "google/slang-gaussian-rasterization#4"),
        bug(CoarseExp, forward, "google/slang-gaussian-rasterization#4"),
        bug(ShRestNotZeroed, forward, "playcanvas/engine#7182"),
        bug(ActivatedTwice, forward, "playcanvas/supersplat-viewer#253"),
        bug(OpacityCompensated, forward, "graphdeco-inria/gaussian-splatting#294"),
        bug(DirectionOfOtherCamera, forward, "nerfstudio-project/gsplat#528"),
        bug(LastCountsSkipped, forward, "joeyan/gaussian_splatting#35"),
        bug(PremultipliedTwice, forward, "strands-labs/robots#2322"),
        bug(DepthNormalised, forward, "strands-labs/robots#2322"),
        bug(BackgroundInFull, forward, "port"),
        bug(BackgroundMissing, forward, "graphdeco-inria/gaussian-splatting#542"),
        bug(NoAlphaThreshold, forward, "port"),
        bug(NoAlphaLimit, forward, "port"),
        bug(NoStop, forward, "port"),
        bug(EarlyStop, forward, "port"),
        bug(ConicFactor, backward, "graphdeco-inria/gaussian-splatting#551"),
        bug(EmptyShape, backward, "graphdeco-inria/gaussian-splatting#472"),
        bug(SubtleConic, backward, "port"),
        bug(AbsoluteGradient, backward, "openvdb/fvdb-core#354"),
        bug(ScaleForLogScale, backward, "openvdb/fvdb-core#432"),
        bug(NoGradientThroughDirection, backward, "ArthurBrussee/brush, crates/brush-bench-test/src/reference.rs"),
        bug(ClampGradientIgnored, backward, "graphdeco-inria/diff-gaussian-rasterization#75"),
        bug(AlphaLimitIgnored, backward, "port"),
        bug(BackgroundNotInGradient, backward, "wanmeihuali/taichi_3d_gaussian_splatting#94"),
        bug(BackgroundTwiceInGradient, backward, "humansensinglab/taming-3dgs#2"),
        bug(OpacityForLogit, backward, "port"),
        bug(LengthForgotten, backward, "port"),
        bug(QuaternionNotProjected, backward, "port"),
        bug(DepthNotInGradient, backward, "port"),
        bug(TransmittanceBehind, backward, "port"),
        bug(PoseFromTheRight, backward, "port"),
        bug(PoseWithoutJacobian, backward, "nerfstudio-project/gsplat#85"),
    ]
}

fn cases(of: &[&str]) -> Vec<Case> {
    let mut cases = Case::load_root(&Case::root()).expect("committed");
    cases.retain(|c| of.contains(&c.stage()));
    cases.sort_by_key(|c| (stages::rank(c.stage()), c.name()));
    cases
}

fn verdicts(cases: &[Case], backend: &Backend) -> Vec<CaseVerdict> {
    cases
        .iter()
        .map(|case| judge(case, &backend.answer(case), false))
        .collect()
}

fn failed(verdicts: &[CaseVerdict]) -> Vec<String> {
    let bad = verdicts.iter().filter(|v| v.outcome != Outcome::Pass);
    bad.map(|v| {
        let worst = v
            .worst()
            .map(|o| format!("{}: {:?}", o.name, o.comparison.as_ref().map(|c| c.worst)));
        format!("{}/{} {}", v.stage, v.case, worst.unwrap_or_default())
    })
    .collect()
}

#[test]
fn every_bug_of_a_renderer_is_caught_and_named_at_its_stage() {
    let cases = cases(&raster::STAGES);
    let (mut escaped, mut elsewhere) = (Vec::new(), Vec::new());
    let bugs = raster_bugs();
    for bug in &bugs {
        let how = How {
            slip: Some(bug.slip),
            ..How::PLAIN
        };
        let found = verdicts(
            &cases,
            &Backend {
                fma: false,
                ftz: false,
                how,
            },
        );
        let first = found.iter().find(|v| v.outcome != Outcome::Pass);
        match first {
            None => escaped.push(format!("{:?} ({})", bug.slip, bug.report)),
            Some(v) if v.stage != bug.stage => {
                elsewhere.push(format!("{:?}: first {}", bug.slip, v.stage))
            }
            Some(_) => {}
        }
    }
    assert!(escaped.is_empty(), "not caught: {escaped:#?}");
    let right = bugs.len() - elsewhere.len();
    assert!(
        right * 10 >= bugs.len() * 9,
        "{right} of {} at the right stage: {elsewhere:#?}",
        bugs.len()
    );
}

/// Every way of computing the same in f32.
fn liberties() -> Vec<Backend> {
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
                        slip: None,
                        walk,
                        density,
                        exp_ulp,
                    };
                    all.push(Backend { fma, ftz, how });
                }
            }
        }
    }
    all
}

fn extensive() -> bool {
    std::env::var_os("GARAD_EXTENSIVE").is_some_and(|v| v == "1")
}

#[test]
fn renderers_that_round_otherwise_pass() {
    let cases = cases(&raster::STAGES);
    let all = liberties();
    assert!(all.len() >= 100, "{}", all.len());
    let step = if extensive() { 1 } else { 5 };
    let mut alarms = Vec::new();
    for backend in all.iter().step_by(step) {
        let bad = failed(&verdicts(&cases, backend));
        if !bad.is_empty() {
            alarms.push(format!("{backend:?}: {bad:?}"));
        }
    }
    assert!(alarms.is_empty(), "false alarms: {alarms:#?}");
}

struct FormulaBug {
    slip: second::Slip,
    stage: &'static str,
    report: &'static str,
}

#[rustfmt::skip]
fn formula_bugs() -> Vec<FormulaBug> {
    use second::Slip::*;
    let bug = |slip, stage, report| FormulaBug { slip, stage, report };
    vec![
        bug(Se3RotationForJacobian, "se3", "strasdat/Sophus#186"),
        bug(Se3LinearPartUnchanged, "se3", "gbionics/idyntree#561"),
        bug(CameraTangentialSwapped, "camera", "nerfstudio-project/nerfstudio#3714"),
        bug(CameraTangentialFlipped, "camera", "nerfstudio-project/nerfstudio#2627"),
        bug(CameraRadialFirst, "camera", "nvidia-isaac/cuVSLAM#151"),
        bug(CameraKalibr, "camera", "ethz-asl/kalibr#698"),
        bug(CameraRadiusUpdated, "camera", "realsenseai/librealsense#939"),
        bug(EpipolarOrder, "epipolar", "magicleap/SuperGluePretrainedNetwork#84"),
        bug(EpipolarCalibrationTransposed, "epipolar", "Foundations-of-Computer-Vision/visionbook#88"),
        bug(HuberHalfWeight, "robust", "KumarRobotics/msckf_vio#85"),
        bug(HuberWithoutConstant, "robust", "tum-vision/lsd_slam#120"),
        bug(KernelWithoutHalf, "kernel", "lucasb-eyer/pydensecrf#118"),
        bug(FieldNormalisedOtherwise, "mean_field", "NifTK/NiftyNet#211"),
        bug(FieldPushes, "mean_field", "port"),
        bug(FieldOneIterationLess, "mean_field", "port"),
        bug(SsimFlatWindow, "losses", "chinue/Fast-SSIM#4"),
        bug(SsimConstantsOfBytes, "losses", "Po-Hsun-Su/pytorch-ssim#17"),
        bug(SsimThirteenTaps, "losses", "scikit-image/scikit-image#3802"),
        bug(SsimReflects, "losses", "kornia/kornia#1204"),
        bug(AdamNoCorrection, "adam", "port"),
        bug(AdamConstantCorrection, "adam", "ufal/npfl114#79"),
        bug(AdamEpsilonInRoot, "adam", "keras-team/keras#17391"),
        bug(AdamEpsilonScaled, "adam", "tensorflow/tensorflow#9047"),
        bug(FastCircleSwapped, "fast", "image-rs/imageproc#680"),
        bug(FastRowEndLost, "fast", "webarkit/jsfeatNext#202"),
        bug(FastSumForScore, "fast", "kornia/kornia-rs#343"),
        bug(FastArcOfTwelve, "fast", "port"),
        bug(FastArcOpen, "fast", "port"),
        bug(FastBorderOfFour, "fast", "port"),
        bug(FastBytesWrap, "fast", "port"),
        bug(FastNoSuppression, "fast", "port"),
        bug(FastNotStrict, "fast", "port"),
        bug(FastTiesStay, "fast", "port"),
        bug(OrbNotBlurred, "orb", "webarkit/purecv#124"),
        bug(OrbAngleInRadians, "orb", "fixstars/cuda-efficient-features#1"),
        bug(OrbDegreesForRadians, "orb", "opencv/opencv#5768"),
        bug(OrbMomentsExchanged, "orb", "opencv/opencv#11065"),
        bug(OrbAngleOfBlurred, "orb", "port"),
        bug(OrbBitsReversed, "orb", "port"),
        bug(OrbComparedTheOtherWay, "orb", "port"),
        bug(OrbNotTurned, "orb", "port"),
        bug(OrbPlaceOfTheLevel, "orb", "port"),
        bug(OrbPlacesCutOff, "orb", "port"),
        bug(OrbSquarePatch, "orb", "port"),
        bug(OrbTurnedBack, "orb", "port"),
        bug(MatchEuclid, "matching", "gestom/stroll_bearnav#51"),
        bug(MatchPairsOfBits, "matching", "opencv/opencv#7989"),
        bug(MatchHalfMutual, "matching", "opencv/opencv#11855"),
        bug(MatchSecondForgotten, "matching", "Celebrandil/CudaSift#75"),
        bug(MatchBytes, "matching", "port"),
        bug(MatchLaneForgotten, "matching", "port"),
        bug(MatchLaterOfEquals, "matching", "port"),
        bug(MatchOneWay, "matching", "port"),
        bug(LkSobel, "lk", "webarkit/purecv#143"),
        bug(LkGateUnscaled, "lk", "webarkit/purecv#143"),
        bug(LkWindowOfTwentyThree, "lk", "webarkit/purecv#144"),
        bug(LkLevelOffByOne, "lk", "JuliaImages/ImageTracking.jl#34"),
        bug(LkResidualUnscaled, "lk", "opencv/opencv#8608"),
        bug(LkBorderRepeats, "lk", "port"),
        bug(LkGateOfGreyLevels, "lk", "port"),
        bug(LkNotDoubled, "lk", "port"),
        bug(LkOneStep, "lk", "port"),
        bug(LkPlainDifferences, "lk", "port"),
        bug(LkStartNotCarried, "lk", "port"),
        bug(LkStepBackwards, "lk", "port"),
        bug(LkWholePixels, "lk", "port"),
        bug(LkWindowOfTwenty, "lk", "port"),
        bug(PerturbedOnTheRight, "reprojection", "cashiwamochi/SimpleBundleAdjustment#1"),
        bug(NormalisedForPixels, "reprojection", "UZ-SLAMLab/ORB_SLAM3#133"),
        bug(FxForFy, "reprojection", "sair-lab/AirSLAM#134"),
        bug(PointNotTurned, "reprojection", "port"),
        bug(RightOnTheLeft, "reprojection", "port"),
        bug(RotationFirst, "reprojection", "port"),
        bug(RotationSign, "reprojection", "port"),
        bug(ShiftNotTurned, "reprojection", "port"),
        bug(SigmaForgotten, "reprojection", "port"),
        bug(SigmaSquared, "reprojection", "port"),
        bug(KneeSquared, "pose_lm", "openMVG/openMVG#1373"),
        bug(CostNotHalved, "pose_lm", "port"),
        bug(GateOfTwo, "pose_lm", "port"),
        bug(JacobianNotWeighted, "pose_lm", "port"),
        bug(KneeOfTwo, "pose_lm", "port"),
        bug(NoKernel, "pose_lm", "port"),
        bug(OutliersForGood, "pose_lm", "port"),
        bug(PoseInverted, "pose_lm", "port"),
        bug(WeightOfTheSquare, "pose_lm", "port"),
        bug(FixedViewsDropped, "bundle", "port"),
        bug(GaugeNotFixed, "bundle", "port"),
        bug(PointsHeld, "bundle", "port"),
        bug(AlignMirrored, "trajectory", "kornia/kornia-rs#799"),
        bug(AlignTransposed, "trajectory", "iperov/DeepFaceLab#453"),
        bug(AlignNeverScaled, "trajectory", "PointCloudLibrary/pcl#45"),
        bug(AlignShiftUnscaled, "trajectory", "PointCloudLibrary/pcl#885"),
        bug(AlignShiftBackwards, "trajectory", "cgraumann/umeyama-matlab#1"),
        bug(AteRootOverCount, "trajectory", "tinghuiz/SfMLearner#75"),
        bug(PairsByIndex, "trajectory", "AutoLab-SAI-SJTU/InfiniteVGGT#18"),
        bug(AlignScaledUnasked, "trajectory", "port"),
        bug(AlignSpreadOfTarget, "trajectory", "port"),
        bug(AteMeanForRmse, "trajectory", "port"),
        bug(AteSampleDeviation, "trajectory", "port"),
        bug(AteUpperMedian, "trajectory", "port"),
        bug(WindowCountsDynamic, "label_window", "port"),
        bug(WindowNeverSlides, "label_window", "port"),
        bug(WindowNotYetFull, "label_window", "port"),
        bug(WindowOneLong, "label_window", "port"),
        bug(WindowOneShort, "label_window", "port"),
        bug(WindowOtherReading, "label_window", "port"),
    ]
}

/// The cases of a group of stages, each with garad's own answer.
fn with_own(group: &[&str]) -> Vec<(Case, answers::Out)> {
    let own = |case: Case| {
        let answer = second::own(&case);
        (case, answer)
    };
    cases(group).into_iter().map(own).collect()
}

fn formula_verdicts<'c>(
    cases: &'c [(Case, answers::Out)],
    how: &'c second::How,
) -> impl Iterator<Item = CaseVerdict> + 'c {
    let answers = cases.iter();
    answers.map(|(case, own)| judge(case, &second::answer(case, own, how), false))
}

#[test]
fn every_bug_of_a_formula_is_caught_and_named_at_its_stage() {
    let mut wrong = Vec::new();
    for group in second::GROUPS {
        let cases = with_own(group);
        let bugs = formula_bugs().into_iter();
        for bug in bugs.filter(|bug| group.contains(&bug.stage)) {
            let how = second::How {
                slip: Some(bug.slip),
                sum: second::Sum::Forwards,
            };
            let first = formula_verdicts(&cases, &how).find(|v| v.outcome != Outcome::Pass);
            let first = first.as_ref().map(|v| v.stage.as_str());
            if first != Some(bug.stage) {
                wrong.push(format!(
                    "{:?} ({}): first {first:?}, not {}",
                    bug.slip, bug.report, bug.stage
                ));
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn formulas_summed_otherwise_pass() {
    for group in second::GROUPS {
        let cases = with_own(group);
        for sum in [
            second::Sum::Forwards,
            second::Sum::Backwards,
            second::Sum::Tree,
        ] {
            let how = second::How { slip: None, sum };
            let bad = failed(&formula_verdicts(&cases, &how).collect::<Vec<_>>());
            assert!(bad.is_empty(), "{sum:?}: {bad:#?}");
        }
    }
}

/// What the suite is for: mistakes that people have made.
#[test]
fn most_bugs_have_been_reported_of_real_programs() {
    let raster = raster_bugs().into_iter().map(|b| b.report);
    let reports: Vec<&str> = raster
        .chain(formula_bugs().iter().map(|b| b.report))
        .collect();
    let real = reports.iter().filter(|r| **r != "port").count();
    assert!(real >= 40, "{real} of {}", reports.len());
}
