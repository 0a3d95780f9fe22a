//! Features, tracking, depth planes and subpixel matches.

use garad_crf::DepthNoise;
use serde::{Deserialize, Serialize};

/// Keypoints and the depth they carry.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FeatureConfig {
    /// ORB features per frame that may be used; more are detected when a part of those in the last
    /// frame moved.
    pub count: usize,
    /// Features detected at most, as a multiple of `count`. 1: never more.
    #[serde(alias = "most_times")]
    pub max_oversampling: f64,
    /// Pyramid factor.
    pub scale: f64,
    /// Pyramid levels.
    pub levels: usize,
    /// FAST threshold, and the one used where a cell stays empty.
    pub fast_threshold: u8,
    /// See `fast_threshold`.
    pub fast_min_threshold: u8,
    /// Place keypoints of coarse levels at the centre of what their pixel covers; off: multiply by
    /// the scale, as ORB-SLAM does. See decision 003.
    pub exact_levels: bool,
    /// Bring depth to the time of the colour image, by the camera's motion before (decision 019).
    pub sync_depth: bool,
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
            max_oversampling: 2.0,
            scale: 1.2,
            levels: 8,
            fast_threshold: 20,
            fast_min_threshold: 7,
            exact_levels: true,
            sync_depth: true,
            max_depth_m: 8.0,
            edge_ratio: 0.05,
        }
    }
}

/// Tracking: matching radii, distances and the number of matches that count as success.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrackingConfig {
    /// What the pose of a frame is found by.
    pub method: TrackingMethod,
    /// Hamming distance up to which two descriptors may be the same point.
    pub match_distance: u32,
    /// Stricter distance for matches without a predicted position.
    pub match_distance_strict: u32,
    /// Radius around the predicted position, px at level 0; doubled once if too few are found.
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
    /// How far the camera turns while it reads an image out (rolling shutter): standard deviation
    /// per axis, radians. 0: all rows at once (global shutter).
    pub shutter_sigma_rad: f64,
    /// Virtual stereo: focal length times baseline, px·m.
    pub bf: f64,
    /// Positions of the points that the pose is computed from.
    pub points: PointSource,
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
    #[default]
    Disparity,
    /// ORB-SLAM's virtual right coordinate, with the σ of the keypoint.
    Right,
    /// None: the printed eq. 11, two rows per keypoint.
    None,
}

/// Positions of the points that the pose is computed from (P of eq. 11).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PointSource {
    /// Those of the landmarks, which bundle adjustment moves.
    #[default]
    Landmarks,
    /// The means of their Gaussians, which training moves: at each hand-over a landmark takes that of its
    /// Gaussian.
    Gaussians,
}

/// What the pose of a frame is found by.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TrackingMethod {
    /// ORB features matched with landmarks.
    #[default]
    Features,
    /// The rendered map compared with colour and depth, as in SplaTAM (Keetha et al. 2024); see
    /// [`RenderTrackingConfig`]. No features are detected, so there are no landmarks, and what is
    /// made of them (bundle adjustment, loops, relocalisation) has nothing to work on.
    Render,
}

impl Default for TrackingConfig {
    fn default() -> Self {
        Self {
            method: TrackingMethod::Features,
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
            shutter_sigma_rad: 0.01,
            bf: 40.0,
            points: PointSource::Landmarks,
            depth_residual: DepthResidual::Disparity,
            disparity_sigma_px: 0.4,
        }
    }
}

/// Pose by gradient descent through the rasterizer, if `tracking.method` is `render`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RenderTrackingConfig {
    /// Steps of Adam per frame. SplaTAM takes 40 (Replica) to 200 (TUM).
    pub iterations: usize,
    /// Halvings of the image that is compared: each saves about three quarters of the time.
    pub level: usize,
    /// Step size of the translation, metres; it falls linearly to 0 over the iterations, so that the
    /// last steps are finer than the first. SplaTAM: 0.002, constant.
    pub translation_rate_m: f64,
    /// Step size of the rotation, radians; it falls likewise. SplaTAM: 0.0004 to 0.002, of a
    /// quaternion.
    pub rotation_rate_rad: f64,
    /// Rendered opacity (the silhouette) above which a pixel is compared: below, the map does not
    /// know yet what is there. SplaTAM: 0.99. New Gaussians must overlap enough to reach it before they
    /// are trained (`insertion.stride_px`, `footprint`, `opacity`: see `profiles/splatam.toml`); those
    /// of the defaults do not.
    pub min_opacity: f64,
    /// Weight of the colour error, metres per unit of colour in [0, 1]: the sum over the channels
    /// beside the depth error. SplaTAM: 0.5.
    pub lambda_color: f64,
    /// Share of the image that must be compared; with less the camera is lost.
    pub min_share: f64,
}

impl Default for RenderTrackingConfig {
    fn default() -> Self {
        Self {
            iterations: 40,
            level: 1,
            translation_rate_m: 0.002,
            rotation_rate_rad: 0.001,
            min_opacity: 0.99,
            lambda_color: 0.5,
            min_share: 0.05,
        }
    }
}

/// The camera's motion between frames (decision 015).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct MotionConfig {
    /// Standard deviation of the camera's acceleration, per axis, m/s². A hand's is about 1.
    pub acceleration_m_s2: f64,
    /// The error that all links of a frame share, as a part of the error of one.
    pub shared_error: f64,
}

impl Default for MotionConfig {
    fn default() -> Self {
        Self {
            acceleration_m_s2: 1.0,
            shared_error: 0.3,
        }
    }
}

/// The part of the depth image in a frame's pose (decision 009).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DepthPlanesConfig {
    /// Off: keypoints alone decide, as in ORB-SLAM.
    pub enabled: bool,
    /// Depth images of so many keyframes are compared with, youngest first.
    pub keyframes: usize,
    /// Standard deviation of the mean depth of 16 x 16 pixels: a quarter of `labels.noise`, most of
    /// which the pixels share.
    pub noise: DepthNoise,
    /// Offset at which a block has lost three quarters of its weight, standard deviations.
    pub outlier_sigmas: f64,
    /// The same for a keypoint, in standard deviations of its place: px at level 0.
    pub outlier_px: f64,
}

impl Default for DepthPlanesConfig {
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

/// Matches refined by Lucas-Kanade against the image of the keyframe that first saw them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SubpixelConfig {
    /// Off: keypoints stay where they were detected, as in ORB-SLAM.
    pub enabled: bool,
    /// Keyframes whose images are kept for it, youngest first.
    pub keyframes: usize,
    /// Standard deviation of a refined match, px.
    pub sigma_px: f64,
    /// A match farther than this from where the pose predicts it is rejected, px.
    pub max_shift_px: f64,
    /// So is one whose patches differ by more than this, mean grey levels.
    pub max_residual: f32,
    /// Only patches of one surface are tracked: depths 10 px around the keypoint differ from its
    /// own by no more than this share. Across an edge the two sides move differently.
    pub surface_ratio: f64,
}

impl Default for SubpixelConfig {
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
