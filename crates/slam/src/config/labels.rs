//! What moves: samples and witnesses.

use garad_crf::{DepthNoise, LabelWindowConfig};
use serde::{Deserialize, Serialize};

/// What moves, and what that does to features.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LabelConfig {
    /// Off (`--without crf`): everything is static, unless a mask is given.
    pub enabled: bool,
    /// Everything is static in the first frames, ...
    pub bootstrap_frames: u32,
    /// ... unless the run begins again after them, when it has turned out that somebody moves there.
    pub second_sight: bool,
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
    /// Leave out of the map what a later keyframe, as long as it remembers, sees through in an
    /// earlier one.
    pub hindsight: bool,
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
    /// Whether samples are also looked for in older pictures.
    pub displacement: DisplacementConfig,
}

/// The search for what has gone sideways (decision 012).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DisplacementConfig {
    /// Off by default: decision 012 says what it gains and what it costs.
    pub enabled: bool,
    /// Ages of the pictures that are asked, frames; kept ones half a step off will do.
    pub ages_frames: [u32; 3],
    /// A place found this far from the predicted one says nothing, px.
    pub sigma_px: f64,
    /// Texture a sample needs, in the units of [`garad_features::LkConfig::min_eigenvalue`].
    pub min_eigenvalue: f32,
    /// Largest mean absolute difference of two patches that are the same, grey levels.
    pub max_residual: f32,
    /// The difference at rest must be so many times that at the place found ...
    pub better_ratio: f64,
    /// ... and so many grey levels more.
    pub better_by: f64,
    /// Samples with something nearer than this before them in their window are not asked, metres.
    pub edge_m: f64,
}

impl DisplacementConfig {
    /// How far off an age may be: half the least of them.
    pub(crate) fn slack_frames(&self) -> u32 {
        self.ages_frames.into_iter().min().unwrap_or(0) / 2
    }
}

impl Default for DisplacementConfig {
    fn default() -> Self {
        Self {
            enabled: false,
            ages_frames: [10, 20, 30],
            sigma_px: 0.5,
            min_eigenvalue: 5e-3,
            max_residual: 10.0,
            better_ratio: 1.5,
            better_by: 1.0,
            edge_m: 0.5,
        }
    }
}

impl Default for LabelConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            bootstrap_frames: 10,
            second_sight: true,
            dilate_px: 8,
            reach_px: 4,
            trust_young: 0.55,
            trust_old: 0.97,
            settle_frames: 45,
            trust_unknown: 0.55,
            memory_frames: 90,
            hindsight: true,
            step_px: 16,
            noise: DepthNoise {
                per_m: 3e-3,
                floor_m: 0.01,
            },
            suspect_sigmas: 3.0,
            max_moving: 0.9,
            edge_ratio: 0.04,
            window: LabelWindowConfig::default(),
            displacement: DisplacementConfig::default(),
        }
    }
}
