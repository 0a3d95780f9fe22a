//! Stages written a second time from their definitions, in f64 or as the case asks: their mistakes, their liberties,
//! and where each is written.

use garad::conformance::own::{self, Width};
use garad_golden::Case;

use super::answers::Out;
use super::{adjust, corners, formulas, paths, tracks};

/// Mistakes, one at a time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Slip {
    // formulas.rs
    AdamConstantCorrection,
    AdamEpsilonInRoot,
    AdamEpsilonScaled,
    AdamNoCorrection,
    CameraKalibr,
    CameraRadialFirst,
    CameraRadiusUpdated,
    CameraTangentialFlipped,
    CameraTangentialSwapped,
    EpipolarCalibrationTransposed,
    EpipolarOrder,
    HuberHalfWeight,
    HuberWithoutConstant,
    KernelWithoutHalf,
    FieldNormalisedOtherwise,
    FieldPushes,
    FieldOneIterationLess,
    Se3LinearPartUnchanged,
    Se3RotationForJacobian,
    SsimConstantsOfBytes,
    SsimFlatWindow,
    SsimReflects,
    SsimThirteenTaps,
    // corners.rs
    FastArcOfTwelve,
    FastArcOpen,
    FastBorderOfFour,
    FastBytesWrap,
    FastCircleSwapped,
    FastNoSuppression,
    FastNotStrict,
    FastRowEndLost,
    FastSumForScore,
    FastTiesStay,
    MatchBytes,
    MatchEuclid,
    MatchHalfMutual,
    MatchLaneForgotten,
    MatchLaterOfEquals,
    MatchOneWay,
    MatchPairsOfBits,
    MatchSecondForgotten,
    OrbAngleInRadians,
    OrbAngleOfBlurred,
    OrbBitsReversed,
    OrbComparedTheOtherWay,
    OrbDegreesForRadians,
    OrbMomentsExchanged,
    OrbNotBlurred,
    OrbNotTurned,
    OrbPlaceOfTheLevel,
    OrbPlacesCutOff,
    OrbSquarePatch,
    OrbTurnedBack,
    // tracks.rs
    LkBorderRepeats,
    LkGateOfGreyLevels,
    LkGateUnscaled,
    LkLevelOffByOne,
    LkNotDoubled,
    LkOneStep,
    LkPlainDifferences,
    LkResidualUnscaled,
    LkSobel,
    LkStartNotCarried,
    LkStepBackwards,
    LkWholePixels,
    LkWindowOfTwenty,
    LkWindowOfTwentyThree,
    // adjust.rs
    CostNotHalved,
    DepthIgnored,
    FixedViewsDropped,
    FxForFy,
    GateOfTwo,
    GaugeNotFixed,
    JacobianNotWeighted,
    KneeOfTwo,
    KneeSquared,
    NoKernel,
    NormalisedForPixels,
    OutliersForGood,
    PerturbedOnTheRight,
    PointNotTurned,
    PointsHeld,
    PoseInverted,
    RightOnTheLeft,
    RotationFirst,
    RotationSign,
    ShiftNotTurned,
    SigmaForgotten,
    SigmaSquared,
    WeightOfTheSquare,
    // paths.rs
    AlignMirrored,
    AlignNeverScaled,
    AlignScaledUnasked,
    AlignShiftBackwards,
    AlignShiftUnscaled,
    AlignSpreadOfTarget,
    AlignTransposed,
    AteMeanForRmse,
    AteRootOverCount,
    AteSampleDeviation,
    AteUpperMedian,
    PairsByIndex,
    WindowCountsDynamic,
    WindowNeverSlides,
    WindowNotYetFull,
    WindowOneLong,
    WindowOneShort,
    WindowOtherReading,
}

/// In which order sums are added.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Sum {
    Forwards,
    Backwards,
    /// Halves, and halves of these.
    Tree,
}

impl Sum {
    pub(crate) fn of(self, terms: &[f64]) -> f64 {
        match self {
            Self::Forwards => terms.iter().fold(0.0, |s, t| s + t),
            Self::Backwards => terms.iter().rev().fold(0.0, |s, t| s + t),
            Self::Tree if terms.len() < 3 => Self::Forwards.of(terms),
            Self::Tree => {
                let (a, b) = terms.split_at(terms.len() / 2);
                self.of(a) + self.of(b)
            }
        }
    }
}

/// One backend.
#[derive(Debug, Clone, Copy)]
pub(crate) struct How {
    pub(crate) slip: Option<Slip>,
    pub(crate) sum: Sum,
}

impl How {
    pub(crate) fn is(&self, slip: Slip) -> bool {
        self.slip == Some(slip)
    }
}

/// Stages by the file they are written in: a mistake of one file leaves the others as they are.
pub(crate) const GROUPS: [&[&str]; 5] = [
    &[
        "se3",
        "camera",
        "epipolar",
        "robust",
        "kernel",
        "mean_field",
        "losses",
        "adam",
    ],
    &["fast", "orb", "matching"],
    &["lk"],
    &["reprojection", "pose_lm", "bundle"],
    &["trajectory", "label_window"],
];

/// garad's own answer, for what a stage is not written a second time for.
pub(crate) fn own(case: &Case) -> Out {
    let own = own::answers(case, Width::F64).expect("a sound case");
    own.unwrap_or_default()
}

/// The stage's answer over garad's own.
pub(crate) fn answer(case: &Case, own: &Out, how: &How) -> Out {
    let mut out = own.clone();
    let stage = match case.stage() {
        "se3" => formulas::se3,
        "camera" => formulas::camera,
        "epipolar" => formulas::epipolar,
        "robust" => formulas::robust,
        "kernel" => formulas::kernel,
        "mean_field" => formulas::mean_field,
        "losses" => formulas::losses,
        "adam" => formulas::adam,
        "fast" => corners::fast,
        "orb" => corners::orb,
        "matching" => corners::matching,
        "lk" => tracks::lucas_kanade,
        "reprojection" => adjust::reprojection,
        "pose_lm" => adjust::pose,
        "bundle" => adjust::bundle,
        "trajectory" => paths::trajectory,
        "label_window" => paths::label_window,
        other => unreachable!("{other} is in no group"),
    };
    stage(case, how, &mut out);
    out
}
