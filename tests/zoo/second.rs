//! How a stage that is written a second time computes: its faults, and its order of summation.

use super::faults::faults;

faults! {
    "se3" {
        Se3RotationForJacobian "strasdat/Sophus#186"
        Se3LinearPartUnchanged "gbionics/idyntree#561"
    }
    "camera" {
        CameraTangentialSwapped "nerfstudio-project/nerfstudio#3714"
        CameraTangentialFlipped "nerfstudio-project/nerfstudio#2627"
        CameraRadialFirst "nvidia-isaac/cuVSLAM#151"
        CameraKalibr "ethz-asl/kalibr#698"
        CameraRadiusUpdated "realsenseai/librealsense#939"
    }
    "epipolar" {
        EpipolarOrder "magicleap/SuperGluePretrainedNetwork#84"
        EpipolarCalibrationTransposed "Foundations-of-Computer-Vision/visionbook#88"
    }
    "robust" {
        HuberHalfWeight "KumarRobotics/msckf_vio#85"
        HuberWithoutConstant "tum-vision/lsd_slam#120"
        HuberKneeNotSquared "port"
    }
    "kernel" {
        KernelWithoutHalf "lucasb-eyer/pydensecrf#118"
        KernelSigmaNotSquared "port"
    }
    "mean_field" {
        FieldNormalisedOtherwise "NifTK/NiftyNet#211"
        FieldPushes "port"
        FieldInPlace "port"
        FieldUnsigned "port"
        FieldOneIterationLess "port"
    }
    "losses" {
        SsimFlatWindow "chinue/Fast-SSIM#4"
        SsimConstantsOfBytes "Po-Hsun-Su/pytorch-ssim#17"
        SsimThirteenTaps "scikit-image/scikit-image#3802"
        SsimReflects "kornia/kornia#1204"
    }
    "adam" {
        AdamNoCorrection "port"
        AdamConstantCorrection "ufal/npfl114#79"
        AdamEpsilonInRoot "keras-team/keras#17391"
        AdamEpsilonScaled "tensorflow/tensorflow#9047"
    }
    "fast" {
        FastCircleSwapped "image-rs/imageproc#680"
        FastRowEndLost "webarkit/jsfeatNext#202"
        FastSumForScore "kornia/kornia-rs#343"
        FastArcOfTwelve "port"
        FastArcOpen "port"
        FastBorderOfFour "port"
        FastBytesWrap "port"
        FastNoSuppression "port"
        FastNotStrict "port"
        FastTiesStay "port"
    }
    "orb" {
        OrbNotBlurred "webarkit/purecv#124"
        OrbAngleInRadians "fixstars/cuda-efficient-features#1"
        OrbDegreesForRadians "opencv/opencv#5768"
        OrbMomentsExchanged "opencv/opencv#11065"
        OrbAngleOfBlurred "port"
        OrbBitsReversed "port"
        OrbComparedTheOtherWay "port"
        OrbNotTurned "port"
        OrbPlaceOfTheLevel "port"
        OrbPlacesCutOff "port"
        OrbSquarePatch "port"
        OrbTurnedBack "port"
    }
    "matching" {
        MatchEuclid "gestom/stroll_bearnav#51"
        MatchPairsOfBits "opencv/opencv#7989"
        MatchHalfMutual "opencv/opencv#11855"
        MatchSecondForgotten "Celebrandil/CudaSift#75"
        MatchBytes "port"
        MatchLaneForgotten "port"
        MatchLaterOfEquals "port"
        MatchOneWay "port"
    }
    "lk" {
        LkSobel "webarkit/purecv#143"
        LkGateUnscaled "webarkit/purecv#143"
        LkWindowOfTwentyThree "webarkit/purecv#144"
        LkLevelOffByOne "JuliaImages/ImageTracking.jl#34"
        LkResidualUnscaled "opencv/opencv#8608"
        LkBorderRepeats "port"
        LkGateOfGreyLevels "port"
        LkNotDoubled "port"
        LkOneStep "port"
        LkPlainDifferences "port"
        LkStartNotCarried "port"
        LkStepBackwards "port"
        LkWholePixels "port"
        LkWindowOfTwenty "port"
    }
    "reprojection" {
        PerturbedOnTheRight "cashiwamochi/SimpleBundleAdjustment#1"
        NormalisedForPixels "UZ-SLAMLab/ORB_SLAM3#133"
        FxForFy "sair-lab/AirSLAM#134"
        PointNotTurned "port"
        RightOnTheLeft "port"
        RotationFirst "port"
        RotationSign "port"
        ShiftNotTurned "port"
        SigmaForgotten "port"
        SigmaSquared "port"
    }
    "pose_lm" {
        KneeSquared "openMVG/openMVG#1373"
        CostNotHalved "port"
        GateOfTwo "port"
        JacobianNotWeighted "port"
        KneeOfTwo "port"
        NoKernel "port"
        OutliersForGood "port"
        PoseInverted "port"
        WeightOfTheSquare "port"
    }
    "bundle" {
        FixedViewsDropped "port"
        GaugeNotFixed "port"
        PointsHeld "port"
    }
    "trajectory" {
        AlignMirrored "kornia/kornia-rs#799"
        AlignTransposed "iperov/DeepFaceLab#453"
        AlignNeverScaled "PointCloudLibrary/pcl#45"
        AlignShiftUnscaled "PointCloudLibrary/pcl#885"
        AlignShiftBackwards "cgraumann/umeyama-matlab#1"
        AteRootOverCount "tinghuiz/SfMLearner#75"
        PairsByIndex "AutoLab-SAI-SJTU/InfiniteVGGT#18"
        AlignScaledUnasked "port"
        AlignSpreadOfTarget "port"
        AteMeanForRmse "port"
        AteSampleDeviation "port"
        AteUpperMedian "port"
    }
    "label_window" {
        WindowCountsDynamic "port"
        WindowNeverSlides "port"
        WindowNotYetFull "port"
        WindowOneLong "port"
        WindowOneShort "port"
        WindowOtherReading "port"
    }
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

/// One port.
#[derive(Debug, Clone, Copy)]
pub(crate) struct How {
    pub(crate) fault: Option<Fault>,
    pub(crate) sum: Sum,
}

impl How {
    pub(crate) fn is(&self, fault: Fault) -> bool {
        self.fault == Some(fault)
    }
}
