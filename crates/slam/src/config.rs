//! [`Config`]: every number of the pipeline that a user may set, with its reason.
//!
//! The defaults are ORB-SLAM's RGB-D values where nothing else is said (Mur-Artal & Tardós 2017,
//! Campos et al. 2021); what was changed on real recordings is argued in `docs/decisions/`.

mod keyframing;
mod labels;
mod mapping;
mod tracking;
mod validate;

use garad_crf::CrfConfig;
pub use garad_features::flow::FlowConfig;
pub use garad_optim::LinearSolver;
use serde::{Deserialize, Serialize};

pub use keyframing::{CullingConfig, KeyframeConfig, LocalBaConfig, LoopConfig, TwoViewConfig};
pub use labels::{
    DepthCue, GaussianMaskConfig, LabelConfig, LabelSource, PatchMotionConfig, SpreadConfig,
    TaggedLabels,
};
pub use mapping::{
    DensifyConfig, DynamicWeight, InitialScale, InsertionConfig, Optimiser, RateConfig,
    ScheduleConfig, TrainConfig,
};
pub use tracking::{
    DepthPlanesConfig, DepthResidual, FeatureConfig, MotionConfig, PointSource,
    RenderTrackingConfig, SubpixelConfig, TrackingConfig, TrackingMethod,
};
pub use validate::ConfigError;

/// Keys that were renamed in 0.2.0: (before, now). The old ones are read for one version more, as
/// aliases.
pub const RENAMED_KEYS: [(&str, &str); 9] = [
    ("seed", "insertion"),
    ("refine", "subpixel"),
    ("surface", "depth_planes"),
    ("features.most_times", "features.max_oversampling"),
    ("train.refine", "train.final_iterations"),
    ("densify.pull", "densify.grad_threshold"),
    ("labels.second_sight", "labels.bootstrap_restart"),
    ("labels.hindsight", "labels.mask_freed_space"),
    ("labels.displacement", "labels.patch_motion"),
];

/// The whole configuration; a TOML table per field.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Keypoints.
    pub features: FeatureConfig,
    /// Pose from matches.
    pub tracking: TrackingConfig,
    /// Pose from rendered images.
    pub render_tracking: RenderTrackingConfig,
    /// Pose from keypoints and depth planes together.
    #[serde(alias = "surface")]
    pub depth_planes: DepthPlanesConfig,
    /// Keyframes and landmarks.
    pub keyframes: KeyframeConfig,
    /// Landmarks from two views.
    pub two_view: TwoViewConfig,
    /// Matches refined by Lucas-Kanade.
    #[serde(alias = "refine")]
    pub subpixel: SubpixelConfig,
    /// The last frames' poses solved together.
    pub motion: MotionConfig,
    /// Local bundle adjustment.
    pub local_ba: LocalBaConfig,
    /// Loop closing.
    pub loops: LoopConfig,
    /// Culling of redundant keyframes.
    pub culling: CullingConfig,
    /// New Gaussians from landmarks and depth.
    #[serde(alias = "seed")]
    pub insertion: InsertionConfig,
    /// Training of the map.
    pub train: TrainConfig,
    /// Clone, split and prune.
    pub densify: DensifyConfig,
    /// Mapping beside tracking.
    pub schedule: ScheduleConfig,
    /// What moves, and what that does to features.
    pub labels: LabelConfig,
    /// The conditional random field behind the labels.
    pub crf: CrfConfig,
    /// The flow check of suspects.
    pub flow: FlowConfig,
}
