//! How a renderer in f32 computes: its faults, and the ways to round that are all right.

use super::faults::faults;

/// Footprints end at multiples of this, pixels.
pub(crate) const CELL: i64 = 16;

faults! {
    "sh" {
        ShSign "nerfstudio-project/nerfstudio#2112"
        ShConstant "nerfstudio-project/nerfstudio#1667"
        ShDegreeThree "cvlab-epfl/gaussian-splatting-web#2"
        ShOrder "port"
    }
    "projection_covariance" {
        QuaternionOrder "aras-p/UnityGaussianSplatting#163"
        QuaternionNotNormalised "port"
        ColumnMajor "tatsuya-ogawa/GaussianSplattingMlx#28"
        ClampOfZ "tatsuya-ogawa/GaussianSplattingMlx#28"
        PrincipalPoint "nerfstudio-project/gsplat#305"
        WorldForCamera "nerfstudio-project/gsplat#180"
        JacobianAtCamera "nerfstudio-project/gsplat#532"
        NoClamp "graphdeco-inria/diff-gaussian-rasterization#75"
        NoDilation "graphdeco-inria/gaussian-splatting#294"
        DepthIsRange "port"
        ScaleNotExponential "port"
        TwoSigma "port"
        FootprintOfEight "port"
        FootprintOfThirtyTwo "port"
    }
    "raster" {
        // Of the projection, where no case has needles thin enough.
        PlainDeterminant "port"
        HalfPixel "autonomousvision/gaussian-opacity-fields#48"
        SortInHalf "altunenes/cuneus#180"
        SortReversed "mosure/bevy_gaussian_splatting#204"
        SortByDistance "port"
        SortDropsOne "antimatter15/splat#59"
        SortDoublesOne "antimatter15/splat#59"
        PaddingDrawsZero "BabylonJS/Babylon.js#18752"
        PayloadOverwritten "aras-p/UnityGaussianSplatting#82"
        MaskBySortedIndex "tatsuya-ogawa/GaussianSplattingMlx#29"
        TooFewTiles "google/slang-gaussian-rasterization#4"
        CoarseExp "google/slang-gaussian-rasterization#4"
        ShRestNotZeroed "playcanvas/engine#7182"
        OpacityNotActivated "port"
        ChannelsReversed "port"
        AlphaLimitOfGsplat "port"
        ActivatedTwice "playcanvas/supersplat-viewer#253"
        OpacityCompensated "graphdeco-inria/gaussian-splatting#294"
        DirectionOfOtherCamera "nerfstudio-project/gsplat#528"
        LastCountsSkipped "joeyan/gaussian_splatting#35"
        PremultipliedTwice "strands-labs/robots#2322"
        DepthNormalised "strands-labs/robots#2322"
        BackgroundInFull "port"
        BackgroundMissing "graphdeco-inria/gaussian-splatting#542"
        NoAlphaThreshold "port"
        NoAlphaLimit "port"
        NoStop "port"
        EarlyStop "port"
    }
    "raster_backward" {
        ConicFactor "graphdeco-inria/gaussian-splatting#551"
        EmptyShape "graphdeco-inria/gaussian-splatting#472"
        SubtleConic "port"
        AbsoluteGradient "openvdb/fvdb-core#354"
        ScaleForLogScale "openvdb/fvdb-core#432"
        NoGradientThroughDirection "ArthurBrussee/brush, crates/brush-bench-test/src/reference.rs"
        ClampGradientIgnored "graphdeco-inria/diff-gaussian-rasterization#75"
        AlphaLimitIgnored "port"
        BackgroundNotInGradient "wanmeihuali/taichi_3d_gaussian_splatting#94"
        BackgroundTwiceInGradient "humansensinglab/taming-3dgs#2"
        OpacityForLogit "port"
        LengthForgotten "port"
        QuaternionNotProjected "port"
        DepthNotInGradient "port"
        TransmittanceBehind "port"
        PoseFromTheRight "port"
        PoseWithoutJacobian "nerfstudio-project/gsplat#85"
    }
}

/// In which order pixels are added up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Walk {
    Rows,
    Columns,
    Backwards,
    /// Squares of so many pixels, each summed by itself.
    Tiles(i64),
    /// Two neighbours, then all of these.
    Pairs,
}

/// How the exponent is put together.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Density {
    /// a dx² + 2 b dx dy + c dy².
    Plain,
    /// dᵀ (conic d).
    Product,
    /// As a sum of squares.
    Slanted,
}

/// One renderer.
#[derive(Debug, Clone, Copy)]
pub(crate) struct How {
    pub(crate) fault: Option<Fault>,
    pub(crate) walk: Walk,
    pub(crate) density: Density,
    pub(crate) exp_ulp: u32,
}

impl How {
    pub(crate) fn footprint_cell(&self) -> i64 {
        match self.fault {
            Some(Fault::FootprintOfEight) => 8,
            Some(Fault::FootprintOfThirtyTwo) => 32,
            _ => CELL,
        }
    }
}
