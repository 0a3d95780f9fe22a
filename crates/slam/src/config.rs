//! [`Config`]: every number of the pipeline that a user may set, with its reason.
//!
//! The defaults are ORB-SLAM's RGB-D values where nothing else is said (Mur-Artal & Tardós 2017,
//! Campos et al. 2021); what was changed on real recordings is argued in `docs/decisions/`.

use garad_crf::{
    CrfConfig, CrfError, CueModel, DepthNoise, LabelWindowConfig, Method, Pooling, Side,
};
use garad_features::flow::{FlowConfig, FlowEstimator, FlowForm};
use serde::{Deserialize, Serialize};
use thiserror::Error;

pub use crate::loop_closing::LoopConfig;

/// The whole configuration; a TOML table per field.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Keypoints.
    pub features: FeatureConfig,
    /// Pose from matches.
    pub tracking: TrackingConfig,
    /// Keyframes and landmarks.
    pub keyframes: KeyframeConfig,
    /// Matches sharpened by Lucas-Kanade.
    pub refine: RefineConfig,
    /// Local bundle adjustment.
    pub local_ba: LocalBaConfig,
    /// Places seen again.
    pub loops: LoopConfig,
    /// Gaussians from depth.
    pub seed: SeedConfig,
    /// Training of the map.
    pub train: TrainConfig,
    /// Clone, split and prune.
    pub densify: DensifyConfig,
    /// Mapping beside tracking.
    pub schedule: ScheduleConfig,
    /// What moves, and what that does to features.
    pub labels: LabelConfig,
    /// The conditional random field behind the labels.
    #[serde(default = "crf_default")]
    pub crf: CrfConfig,
    /// The flow check of suspects.
    pub flow: FlowCheckConfig,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            features: FeatureConfig::default(),
            tracking: TrackingConfig::default(),
            keyframes: KeyframeConfig::default(),
            refine: RefineConfig::default(),
            local_ba: LocalBaConfig::default(),
            loops: LoopConfig::default(),
            seed: SeedConfig::default(),
            train: TrainConfig::default(),
            densify: DensifyConfig::default(),
            schedule: ScheduleConfig::default(),
            labels: LabelConfig::default(),
            crf: crf_default(),
            flow: FlowCheckConfig::default(),
        }
    }
}

/// The field as it is used here; what differs from [`CrfConfig::default`] is argued in decision 005.
fn crf_default() -> CrfConfig {
    let mut crf = CrfConfig::default();
    crf.unary.reprojection = CueModel::new(2.5, 1.0, Side::Above);
    crf.unary.depth = CueModel::new(2.0, 1.5, Side::Above);
    crf.unary.observations = CueModel::new(2.0, 1.0, Side::Below);
    crf.unary.epipolar = CueModel::new(2.0, 1.0, Side::Above);
    crf.unary.pooling = Pooling::Geometric;
    crf.kernels.sigma_m = 0.2;
    crf.kernels.sigma_px = 30.0;
    crf.mean_field.iterations = 5;
    crf.mean_field.method = Method::Fast { tail: 1e-4 };
    crf
}

/// Keypoints and the depth they carry.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FeatureConfig {
    /// ORB features per frame.
    pub count: usize,
    /// Pyramid factor.
    pub scale: f64,
    /// Pyramid levels.
    pub levels: usize,
    /// FAST threshold, and the one tried where a cell stays empty.
    pub fast_threshold: u8,
    /// See `fast_threshold`.
    pub fast_min_threshold: u8,
    /// Place keypoints of coarse levels at the centre of what their pixel covers; off: multiply by
    /// the scale, as ORB-SLAM does. See decision 003.
    pub exact_levels: bool,
    /// Depth beyond this is not used, metres.
    pub max_depth_m: f64,
    /// A keypoint whose 3x3 depths differ by more than this share of its depth sits on an edge:
    /// its depth may be the background's, so it is used as a direction only.
    pub edge_ratio: f64,
}

impl Default for FeatureConfig {
    fn default() -> Self {
        Self {
            count: 1000,
            scale: 1.2,
            levels: 8,
            fast_threshold: 20,
            fast_min_threshold: 7,
            exact_levels: true,
            max_depth_m: 8.0,
            edge_ratio: 0.05,
        }
    }
}

/// Tracking: matching radii, distances and the number of matches that count as success.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrackingConfig {
    /// Hamming distance up to which two descriptors may be the same point.
    pub match_distance: u32,
    /// Stricter distance for matches without a predicted place.
    pub match_distance_strict: u32,
    /// Radius around the predicted place, px at level 0; doubled once if too few are found.
    pub motion_radius_px: f64,
    /// Matches needed from the motion model before a pose is tried.
    pub motion_min_matches: usize,
    /// Inliers needed after the motion model or the reference keyframe.
    pub motion_min_inliers: usize,
    /// Matches needed with the reference keyframe, and the ratio of best to second distance.
    pub reference_min_matches: usize,
    /// See `reference_min_matches`.
    pub reference_ratio: f32,
    /// Radius for local-map points seen head on, px at level 0, and for all others.
    pub local_radius_px: f64,
    /// See `local_radius_px`.
    pub local_radius_oblique_px: f64,
    /// Ratio of best to second distance at the same level in the local map.
    pub local_ratio: f64,
    /// Inliers below which the camera is lost, and shortly after it was found again.
    pub min_inliers: usize,
    /// See `min_inliers`.
    pub min_inliers_after_recovery: usize,
    /// Keyframes in the local map at most.
    pub max_local_keyframes: usize,
    /// Virtual stereo: focal length times baseline, px·m.
    pub bf: f64,
    /// How a depth reading enters the pose and the bundle.
    pub depth_residual: DepthResidual,
    /// For `disparity`: standard deviation of the sensor's depth, px at `bf`: σ_z = σ z² / bf. A
    /// Kinect alone has 0.05 to 0.08; more leaves room for depth not quite registered to colour.
    pub disparity_sigma_px: f64,
}

/// The third residual of an observation with depth.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum DepthResidual {
    /// The reading alone, as a disparity with the sensor's σ.
    Disparity,
    /// ORB-SLAM's virtual right coordinate, with the σ of the keypoint.
    #[default]
    Right,
}

impl Default for TrackingConfig {
    fn default() -> Self {
        Self {
            match_distance: 100,
            match_distance_strict: 50,
            motion_radius_px: 15.0,
            motion_min_matches: 20,
            motion_min_inliers: 10,
            reference_min_matches: 15,
            reference_ratio: 0.7,
            local_radius_px: 7.5,
            local_radius_oblique_px: 12.0,
            local_ratio: 0.8,
            min_inliers: 30,
            min_inliers_after_recovery: 50,
            max_local_keyframes: 80,
            bf: 40.0,
            depth_residual: DepthResidual::Right,
            disparity_sigma_px: 0.3,
        }
    }
}

/// Matches sharpened by Lucas-Kanade against the keyframe they were learnt from.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RefineConfig {
    /// Off: keypoints stay where they were detected, as in ORB-SLAM.
    pub enabled: bool,
    /// Keyframes whose pictures are kept for it, youngest first.
    pub keyframes: usize,
    /// Standard deviation of a sharpened match, px.
    pub sigma_px: f64,
    /// A match farther than this from where the pose predicts it is not believed, px.
    pub max_shift_px: f64,
    /// Nor is one whose patches differ by more than this, mean grey levels.
    pub max_residual: f32,
    /// Only patches of one surface are followed: depths 10 px around the keypoint differ from its
    /// own by no more than this share. Across an edge the two sides move differently.
    pub surface_ratio: f64,
}

impl Default for RefineConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            keyframes: 20,
            sigma_px: 0.7,
            max_shift_px: 3.0,
            max_residual: 20.0,
            surface_ratio: 0.05,
        }
    }
}

/// When a frame becomes a keyframe, and which landmarks it makes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct KeyframeConfig {
    /// Keypoints the first frame needs.
    pub first_min_keypoints: usize,
    /// Fewer inliers than this share of the reference keyframe's landmarks: new keyframe.
    pub ref_ratio: f64,
    /// A frame with fewer inliers than this is too weak to become one.
    pub min_inliers: usize,
    /// At most this many frames between two keyframes (ORB-SLAM: a second's worth); see decision 003.
    pub max_gap: usize,
    /// At least this many frames between two keyframes.
    pub min_gap: usize,
    /// Landmarks nearer than this are made at once, metres. ORB-SLAM takes 40 baselines, about 3 m;
    /// see decision 003.
    pub close_m: f64,
    /// Fewer tracked close points than this, while ...
    pub close_tracked_min: usize,
    /// ... more untracked close points than this: new keyframe.
    pub close_untracked_min: usize,
    /// At least this many landmarks per keyframe, nearest first.
    pub min_new_landmarks: usize,
    /// A landmark found in less than this share of the frames that should see it is dropped.
    pub found_ratio: f64,
    /// Observing keyframes a landmark needs two keyframes after its birth.
    pub min_observations: usize,
}

impl Default for KeyframeConfig {
    fn default() -> Self {
        Self {
            first_min_keypoints: 100,
            ref_ratio: 0.75,
            min_inliers: 15,
            max_gap: 10,
            min_gap: 0,
            close_m: 6.0,
            close_tracked_min: 100,
            close_untracked_min: 70,
            min_new_landmarks: 100,
            found_ratio: 0.25,
            min_observations: 2,
        }
    }
}

/// Local bundle adjustment after each keyframe.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LocalBaConfig {
    /// Off: keyframe poses stay as tracked.
    pub enabled: bool,
    /// LM iterations.
    pub iterations: usize,
    /// Keyframes whose poses are free at most, nearest in covisibility first.
    pub max_free: usize,
    /// Keyframes that see the same landmarks and stay fixed at most.
    pub max_fixed: usize,
}

impl Default for LocalBaConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            iterations: 10,
            max_free: 10,
            max_fixed: 20,
        }
    }
}

/// Gaussians seeded from a keyframe's depth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SeedConfig {
    /// Off: no map is drawn.
    pub enabled: bool,
    /// One candidate every so many pixels, each way.
    pub stride_px: usize,
    /// Standard deviation as a multiple of the candidate's footprint `stride * z / f`.
    pub footprint: f64,
    /// Opacity of a new Gaussian.
    pub opacity: f64,
    /// Pixels whose rendered opacity is lower are not yet explained.
    pub explained_opacity: f64,
    /// Nor are pixels whose surface lies in front of the rendered one by more than this share.
    pub depth_ratio: f64,
    /// A Gaussian for each new landmark, too, tagged with it.
    pub landmarks: bool,
    /// Gaussians at most.
    pub max_gaussians: usize,
}

impl Default for SeedConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            stride_px: 4,
            footprint: 0.6,
            opacity: 0.9,
            explained_opacity: 0.6,
            depth_ratio: 0.05,
            landmarks: true,
            max_gaussians: 400_000,
        }
    }
}

/// How the map learns the pictures (paper eq. 12, 13, 16).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    /// Iterations for each new keyframe, while tracking goes on.
    pub per_keyframe: usize,
    /// Further iterations for each frame since the keyframe before.
    pub per_frame: usize,
    /// Iterations after the last frame.
    pub refine: usize,
    /// Uses of a keyframe at 1/4 and again at 1/2 of its size, before it is used whole.
    pub uses_per_level: usize,
    /// Weight of the photometric loss (eq. 12).
    pub lambda_photometric: f64,
    /// Weight of the penalty on dynamic Gaussians (eq. 12).
    pub lambda_dynamic: f64,
    /// Share of 1 - SSIM in the photometric loss (eq. 13).
    pub lambda_ssim: f64,
    /// Weight of the depth error, 1/m. The paper has no such term: 0 is its loss. Without it white
    /// walls drift towards the camera (decision 006).
    pub lambda_depth: f64,
    /// Who takes the steps.
    pub optimiser: Optimiser,
    /// Degree that the colours' spherical harmonics may reach, 0 to 3, ...
    pub sh_degree: usize,
    /// ... one more every so many iterations; 0: at once.
    pub sh_every: usize,
    /// Step sizes.
    pub rates: RateConfig,
}

/// The paper says "SGD" in its text; its code base and everything built on it uses Adam.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Optimiser {
    /// Adam with the moments of 3D Gaussian Splatting.
    #[default]
    Adam,
    /// Plain gradient descent with the same step sizes (a rate per group, that of its first
    /// column).
    Sgd,
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            per_keyframe: 6,
            per_frame: 1,
            refine: 0,
            uses_per_level: 8,
            lambda_photometric: 0.8,
            lambda_dynamic: 0.2,
            lambda_ssim: 0.2,
            lambda_depth: 0.2,
            optimiser: Optimiser::Adam,
            sh_degree: 3,
            sh_every: 1000,
            rates: RateConfig::default(),
        }
    }
}

/// Where Gaussians are added and dropped while the map learns (Kerbl et al. 2023).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DensifyConfig {
    /// Off: only insertion adds Gaussians, only the end drops them.
    pub enabled: bool,
    /// Once in so many iterations.
    pub every: usize,
    /// Mean |∂L/∂ centre| from which a Gaussian is cloned or split, per unit of NDC.
    pub pull: f64,
    /// Those with a standard deviation above this share of the path's extent are split.
    pub split_extent: f64,
    /// Static Gaussians less opaque than this are dropped.
    pub min_opacity: f64,
    /// Gaussians at most, clones and children included.
    pub max_gaussians: usize,
}

impl Default for DensifyConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            every: 100,
            pull: 1e-3,
            split_extent: 0.01,
            min_opacity: 0.005,
            max_gaussians: 400_000,
        }
    }
}

/// Mapping beside tracking, on a schedule of frame numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ScheduleConfig {
    /// A keyframe's mapping is handed over to tracking this many frames later, neither sooner nor
    /// later, whatever the machine: tracking waits if it has to.
    pub handover_frames: u32,
}

impl Default for ScheduleConfig {
    fn default() -> Self {
        Self { handover_frames: 5 }
    }
}

/// Step sizes per kind of parameter, those of 3D Gaussian Splatting.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RateConfig {
    /// Means, times the extent of the camera's path (1.1 times its radius, at least a metre).
    pub mean: f64,
    /// Log-scales.
    pub log_scale: f64,
    /// Quaternions.
    pub quaternion: f64,
    /// Opacity logits.
    pub opacity_logit: f64,
    /// Spherical harmonics of degree 0.
    pub sh: f64,
    /// The same divided by this: those of higher degrees.
    pub sh_rest_divisor: f64,
}

impl Default for RateConfig {
    fn default() -> Self {
        Self {
            mean: 3.2e-4,
            log_scale: 0.005,
            quaternion: 0.001,
            opacity_logit: 0.05,
            sh: 2.5e-3,
            sh_rest_divisor: 20.0,
        }
    }
}

/// What moves, and what that does to features.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LabelConfig {
    /// Off (`--without crf`): everything is static, unless a mask is given.
    pub enabled: bool,
    /// Everything is static in the first frames.
    pub bootstrap_frames: u32,
    /// Keypoints this near to what a given mask says moves are not used, px; the photometric loss
    /// keeps as far from every mask.
    pub dilate_px: usize,
    /// A keypoint this near to a pixel that was found to move is not used, px: its descriptor and
    /// its depth reach across the edge.
    pub reach_px: usize,
    /// Probability of being static that a sample keeps if every witness agrees with it, the oldest of
    /// them from just now, ...
    pub trust_young: f64,
    /// ... or from `settle_frames` ago and more.
    pub trust_old: f64,
    /// See `trust_old`.
    pub settle_frames: u32,
    /// The same for a sample that no witness knows.
    pub trust_unknown: f64,
    /// Keyframes of the last so many frames are asked what was there before.
    pub memory_frames: u32,
    /// One sample of the picture every so many pixels, each way.
    pub step_px: usize,
    /// Noise of the depth camera, with room for registration and pose.
    pub noise: DepthNoise,
    /// A depth residual above this makes a suspect, standard deviations.
    pub suspect_sigmas: f64,
    /// If more than this share of the judged samples is suspect, the pose is: nothing is labelled.
    pub max_moving: f64,
    /// Samples whose depth differs by more than this share belong to another thing, when the mask is
    /// filled in between them.
    pub edge_ratio: f64,
    /// Runs of the field before what moves is dropped (eq. 7).
    pub window: LabelWindowConfig,
}

impl Default for LabelConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            bootstrap_frames: 10,
            dilate_px: 8,
            reach_px: 8,
            trust_young: 0.55,
            trust_old: 0.97,
            settle_frames: 45,
            trust_unknown: 0.55,
            memory_frames: 90,
            step_px: 16,
            noise: DepthNoise {
                per_m: 3e-3,
                floor_m: 0.01,
            },
            suspect_sigmas: 3.0,
            max_moving: 0.9,
            edge_ratio: 0.04,
            window: LabelWindowConfig::default(),
        }
    }
}

/// The flow check of suspects (paper sec. III-B).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FlowCheckConfig {
    /// Off (`--without flow`): suspects stay suspects.
    pub enabled: bool,
    /// Flow as measured (the paper to the letter), or what is left after taking off what the
    /// camera's motion does at the measured depth.
    pub model: FlowModelKind,
    /// How mean and covariance of the static flow are found.
    pub estimator: FlowEstimatorKind,
    /// Added to both variances, px².
    pub covariance_floor_px2: f64,
    /// Static points a model needs.
    pub min_support: usize,
    /// χ² with two degrees of freedom.
    pub chi2: f64,
}

/// See [`FlowCheckConfig::model`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FlowModelKind {
    /// As measured.
    Raw,
    /// Without what the camera's motion explains.
    #[default]
    Residual,
}

/// See [`garad_features::flow::FlowEstimator`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FlowEstimatorKind {
    /// Plain mean and covariance: the paper.
    Moments,
    /// Median and median absolute deviation.
    MedianMad,
    /// Moments of what lies within 95 % of those.
    #[default]
    Trimmed,
}

impl Default for FlowCheckConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            model: FlowModelKind::Residual,
            estimator: FlowEstimatorKind::Trimmed,
            covariance_floor_px2: 0.04,
            min_support: 10,
            chi2: garad_features::flow::CHI2_2DOF_95,
        }
    }
}

impl FlowCheckConfig {
    /// As the check wants it.
    #[must_use]
    pub fn check(&self) -> FlowConfig {
        FlowConfig {
            form: match self.model {
                FlowModelKind::Raw => FlowForm::Raw,
                FlowModelKind::Residual => FlowForm::Residual,
            },
            estimator: match self.estimator {
                FlowEstimatorKind::Moments => FlowEstimator::Moments,
                FlowEstimatorKind::MedianMad => FlowEstimator::MedianMad,
                FlowEstimatorKind::Trimmed => FlowEstimator::Trimmed,
            },
            covariance_floor_px2: self.covariance_floor_px2,
            min_support: self.min_support,
            chi2: self.chi2,
        }
    }
}

/// A value that cannot be.
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// Out of its range.
    #[error("{key} = {value}: expected {expected}")]
    OutOfRange {
        /// Table and key.
        key: &'static str,
        /// What it is.
        value: f64,
        /// What it may be.
        expected: &'static str,
    },
    /// A setting of the field.
    #[error("crf.{0}")]
    Crf(#[from] CrfError),
}

impl Config {
    /// Checks every value that could make a stage meaningless.
    ///
    /// # Errors
    /// [`ConfigError::OutOfRange`] naming the first one.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let (f, t, s) = (&self.features, &self.tracking, &self.seed);
        let positive = "a positive number";
        let share = "a number in (0, 1)";
        let inside = |low: f64, v: f64, high: f64| v > low && v < high;
        #[rustfmt::skip]
        let checks = [
            ("features.count", f.count as f64, f.count > 0 && f.count <= 100_000, "1..100000"),
            ("features.scale", f.scale, inside(1.0, f.scale, 4.0), "a number in (1, 4)"),
            ("features.levels", f.levels as f64, (1..=16).contains(&f.levels), "1..16"),
            ("features.fast_min_threshold", f64::from(f.fast_min_threshold),
             f.fast_min_threshold > 0 && f.fast_min_threshold <= f.fast_threshold, "1..fast_threshold"),
            ("features.max_depth_m", f.max_depth_m, inside(0.0, f.max_depth_m, f64::INFINITY), positive),
            ("features.edge_ratio", f.edge_ratio, inside(0.0, f.edge_ratio, f64::INFINITY), positive),
            ("tracking.bf", t.bf, inside(0.0, t.bf, f64::INFINITY), positive),
            ("tracking.disparity_sigma_px", t.disparity_sigma_px,
             inside(0.0, t.disparity_sigma_px, f64::INFINITY), positive),
            ("tracking.motion_radius_px", t.motion_radius_px,
             inside(0.0, t.motion_radius_px, 1e4), "a number in (0, 10000)"),
            ("train.lambda_ssim", self.train.lambda_ssim,
             (0.0..=1.0).contains(&self.train.lambda_ssim), "a number in [0, 1]"),
            ("train.lambda_depth", self.train.lambda_depth,
             self.train.lambda_depth >= 0.0 && self.train.lambda_depth.is_finite(), "0 or a positive number"),
            ("train.sh_degree", self.train.sh_degree as f64, self.train.sh_degree <= 3, "0..3"),
            ("train.rates.sh_rest_divisor", self.train.rates.sh_rest_divisor,
             inside(0.0, self.train.rates.sh_rest_divisor, f64::INFINITY), positive),
            ("densify.every", self.densify.every as f64, self.densify.every > 0, "at least 1"),
            ("densify.pull", self.densify.pull, inside(0.0, self.densify.pull, f64::INFINITY), positive),
            ("densify.min_opacity", self.densify.min_opacity, inside(0.0, self.densify.min_opacity, 1.0), share),
            ("labels.step_px", self.labels.step_px as f64, (4..=128).contains(&self.labels.step_px), "4..128"),
            ("labels.noise.floor_m", self.labels.noise.floor_m,
             inside(0.0, self.labels.noise.floor_m, f64::INFINITY), positive),
            ("labels.noise.per_m", self.labels.noise.per_m,
             self.labels.noise.per_m >= 0.0 && self.labels.noise.per_m.is_finite(), "0 or a positive number"),
            ("labels.trust_young", self.labels.trust_young, inside(0.0, self.labels.trust_young, 1.0), share),
            ("labels.trust_old", self.labels.trust_old, inside(0.0, self.labels.trust_old, 1.0), share),
            ("labels.settle_frames", f64::from(self.labels.settle_frames), self.labels.settle_frames > 0, "at least 1"),
            ("labels.trust_unknown", self.labels.trust_unknown,
             inside(0.0, self.labels.trust_unknown, 1.0), share),
            ("labels.edge_ratio", self.labels.edge_ratio,
             inside(0.0, self.labels.edge_ratio, f64::INFINITY), positive),
            ("flow.covariance_floor_px2", self.flow.covariance_floor_px2,
             self.flow.covariance_floor_px2 >= 0.0 && self.flow.covariance_floor_px2.is_finite(), "0 or a positive number"),
            ("flow.min_support", self.flow.min_support as f64, self.flow.min_support >= 3, "at least 3"),
            ("flow.chi2", self.flow.chi2, inside(0.0, self.flow.chi2, f64::INFINITY), positive),
            ("loops.max_drift", self.loops.max_drift, inside(0.0, self.loops.max_drift, f64::INFINITY), positive),
            ("loops.max_drift_floor_m", self.loops.max_drift_floor_m,
             inside(0.0, self.loops.max_drift_floor_m, f64::INFINITY), positive),
            ("loops.in_a_row", self.loops.in_a_row as f64, self.loops.in_a_row > 0, "at least 1"),
            ("loops.min_inliers", self.loops.min_inliers as f64, self.loops.min_inliers >= 3, "at least 3"),
            ("keyframes.max_gap", self.keyframes.max_gap as f64, self.keyframes.max_gap > 0, "at least 1"),
            ("seed.stride_px", s.stride_px as f64, s.stride_px > 0, "at least 1"),
            ("seed.footprint", s.footprint, inside(0.0, s.footprint, f64::INFINITY), positive),
            ("seed.opacity", s.opacity, inside(0.0, s.opacity, 1.0), share),
        ];
        for (key, value, good, expected) in checks {
            if !good {
                return Err(ConfigError::OutOfRange {
                    key,
                    value,
                    expected,
                });
            }
        }
        self.crf.validate()?;
        self.labels.window.validate()?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn defaults_are_valid_and_nan_is_not() {
        Config::default().validate().expect("defaults");
        let mut config = Config::default();
        config.tracking.bf = f64::NAN;
        let error = config.validate().expect_err("NaN");
        assert!(error.to_string().contains("tracking.bf"), "{error}");
    }
}
