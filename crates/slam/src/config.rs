//! [`Config`]: every number of the pipeline that a user may set, with its reason.
//!
//! The defaults are ORB-SLAM's RGB-D values where nothing else is said (Mur-Artal & Tardós 2017,
//! Campos et al. 2021); what was changed on real recordings is argued in `docs/decisions/`.

use garad_crf::{CrfConfig, CrfError, DepthNoise};
use serde::{Deserialize, Serialize};
use thiserror::Error;

mod labels;
mod mapping;

pub use labels::LabelConfig;
pub use mapping::{DensifyConfig, Optimiser, RateConfig, ScheduleConfig, SeedConfig, TrainConfig};

pub use garad_features::flow::FlowConfig;

pub use crate::culling::CullingConfig;
pub use crate::loop_closing::LoopConfig;

/// The whole configuration; a TOML table per field.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Keypoints.
    pub features: FeatureConfig,
    /// Pose from matches.
    pub tracking: TrackingConfig,
    /// First pose from keypoints and depth together.
    pub surface: SurfaceConfig,
    /// Keyframes and landmarks.
    pub keyframes: KeyframeConfig,
    /// Matches sharpened by Lucas-Kanade.
    pub refine: RefineConfig,
    /// Local bundle adjustment.
    pub local_ba: LocalBaConfig,
    /// Places seen again.
    pub loops: LoopConfig,
    /// Keyframes given up.
    pub culling: CullingConfig,
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
    pub crf: CrfConfig,
    /// The flow check of suspects.
    pub flow: FlowConfig,
}

/// Keypoints and the depth they carry.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FeatureConfig {
    /// ORB features per frame that may be used: more are looked for when a part of those in the last
    /// frame moved.
    pub count: usize,
    /// At most so many times `count` are looked for. 1: never more.
    pub most_times: f64,
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
            most_times: 2.0,
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

/// The depth picture's say in a frame's first pose (decision 009).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SurfaceConfig {
    /// Off: keypoints alone decide, as in ORB-SLAM.
    pub enabled: bool,
    /// Pictures of so many keyframes are compared with, youngest first.
    pub keyframes: usize,
    /// Standard deviation of the mean depth of 16 x 16 pixels: a quarter of `labels.noise`, most of
    /// which the pixels share.
    pub noise: DepthNoise,
    /// Offset at which a block has lost three quarters of its weight, standard deviations.
    pub outlier_sigmas: f64,
    /// The same for a keypoint, in standard deviations of its place: px at level 0.
    pub outlier_px: f64,
}

impl Default for SurfaceConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            keyframes: 3,
            noise: DepthNoise {
                per_m: 7.5e-4,
                floor_m: 2.5e-3,
            },
            outlier_sigmas: 3.0,
            outlier_px: 1.0,
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
            ("features.most_times", f.most_times, (1.0..=10.0).contains(&f.most_times), "a number from 1 to 10"),
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
            ("surface.noise.floor_m", self.surface.noise.floor_m,
             inside(0.0, self.surface.noise.floor_m, f64::INFINITY), positive),
            ("surface.noise.per_m", self.surface.noise.per_m,
             self.surface.noise.per_m >= 0.0 && self.surface.noise.per_m.is_finite(), "0 or a positive number"),
            ("surface.outlier_sigmas", self.surface.outlier_sigmas,
             inside(0.0, self.surface.outlier_sigmas, f64::INFINITY), positive),
            ("surface.outlier_px", self.surface.outlier_px,
             inside(0.0, self.surface.outlier_px, f64::INFINITY), positive),
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
            ("labels.displacement.sigma_px", self.labels.displacement.sigma_px,
             inside(0.0, self.labels.displacement.sigma_px, f64::INFINITY), positive),
            ("labels.displacement.ages_frames",
             self.labels.displacement.ages_frames.map(f64::from).into_iter().fold(f64::INFINITY, f64::min),
             self.labels.displacement.ages_frames.iter().all(|a| *a > 0), "at least 1"),
            ("flow.covariance_floor_px2", self.flow.covariance_floor_px2,
             self.flow.covariance_floor_px2 >= 0.0 && self.flow.covariance_floor_px2.is_finite(), "0 or a positive number"),
            ("flow.min_support", self.flow.min_support as f64, self.flow.min_support >= 3, "at least 3"),
            ("flow.chi2", self.flow.chi2, inside(0.0, self.flow.chi2, f64::INFINITY), positive),
            ("loops.max_drift", self.loops.max_drift, inside(0.0, self.loops.max_drift, f64::INFINITY), positive),
            ("loops.max_drift_floor_m", self.loops.max_drift_floor_m,
             inside(0.0, self.loops.max_drift_floor_m, f64::INFINITY), positive),
            ("loops.in_a_row", self.loops.in_a_row as f64, self.loops.in_a_row > 0, "at least 1"),
            ("loops.min_inliers", self.loops.min_inliers as f64, self.loops.min_inliers >= 3, "at least 3"),
            ("culling.redundant_share", self.culling.redundant_share,
             inside(0.0, self.culling.redundant_share, 1.0 + f64::EPSILON), "a number in (0, 1]"),
            ("culling.observers", self.culling.observers as f64, self.culling.observers > 0, "at least 1"),
            ("train.max_views", self.train.max_views as f64, self.train.max_views >= 2, "at least 2"),
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
