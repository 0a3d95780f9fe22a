//! What moves: samples, free space, retention, patch motion.

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
    /// ... but the run restarts with the first frame if later frames show that something moved
    /// there (decision 011).
    #[serde(alias = "second_sight")]
    pub bootstrap_restart: bool,
    /// Keypoints this near to the moving part of a given mask are not used, px; the photometric
    /// loss excludes as wide a border around every mask.
    pub dilate_px: usize,
    /// A keypoint this near to a pixel that was found to move is not used, px: its descriptor and
    /// its depth reach across the edge.
    pub reach_px: usize,
    /// Probability of being static of a sample on a surface that was seen there before: if the
    /// oldest view that saw it is recent, ...
    pub trust_young: f64,
    /// ... or `settle_frames` old and more.
    pub trust_old: f64,
    /// See `trust_old`.
    pub settle_frames: u32,
    /// The same for a sample that no earlier view saw.
    pub trust_unknown: f64,
    /// Age up to which a depth image is part of the free-space history, frames.
    pub memory_frames: u32,
    /// Frames between the depth images of the history; those of keyframes are always part of it.
    pub history_gap: u32,
    /// Exclude from training what a later keyframe, up to `memory_frames` younger, shows to be free
    /// space (decision 013).
    #[serde(alias = "hindsight")]
    pub mask_freed_space: bool,
    /// Distance between samples of the image, px.
    pub step_px: usize,
    /// Noise of the depth camera, with room for registration and pose.
    pub noise: DepthNoise,
    /// A depth residual above this makes a suspect, standard deviations.
    pub suspect_sigmas: f64,
    /// If more than this share of the judged samples is suspect, the pose is taken to be wrong and
    /// nothing is labelled.
    pub max_moving: f64,
    /// Suspects that have been at rest for about so many frames, by the flow check, are static again.
    pub rest_frames: u32,
    /// When the mask is interpolated, samples whose depth differs by more than this share belong to
    /// another object.
    pub edge_ratio: f64,
    /// Where the field runs.
    pub source: LabelSource,
    /// The depth cue of a landmark.
    pub depth_cue: DepthCue,
    /// Label Gaussians, too. Off: all of them are static, and none is removed by its label; a field over Gaussians
    /// (`source`) goes on for landmarks and the mask alone.
    pub map: bool,
    /// What decides the label of a tagged Gaussian, with `source = "frames"`.
    pub tagged: TaggedLabels,
    /// What decides the label of the other Gaussians, with the other sources.
    pub spread: SpreadConfig,
    /// The mask rendered from the dynamic Gaussians, with the other sources.
    pub gaussian_mask: GaussianMaskConfig,
    /// The retention window (eq. 7).
    pub window: LabelWindowConfig,
    /// Motion of samples' patches since older images.
    #[serde(alias = "displacement")]
    pub patch_motion: PatchMotionConfig,
}

/// Where the field runs, and how its labels reach the keypoints (decision 020).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum LabelSource {
    /// Over the samples of every frame and, at a keyframe, over landmarks; the frame's own mask labels its
    /// keypoints.
    #[default]
    Frames,
    /// Over the tagged Gaussians, in the mapping job of a keyframe; the mask rendered from the dynamic ones labels
    /// the keypoints of later frames. The paper's loop.
    Gaussians,
    /// Over both; a keypoint in either mask is dynamic.
    Both,
    /// Nowhere: a sample of a frame is dynamic if its flow is not that of the others (eq. 10), and landmarks and
    /// Gaussians keep their labels.
    Flow,
}

impl LabelSource {
    /// Whether tagged Gaussians are labelled, and their mask is rendered.
    #[must_use]
    pub fn has_gaussians(self) -> bool {
        matches!(self, Self::Gaussians | Self::Both)
    }
}

/// Cue β of eq. 2.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DepthCue {
    /// Distance in front of the surfaces that earlier frames saw.
    #[default]
    FreeSpace,
    /// "Variation of depth": standard deviation, over the observations, of measured minus predicted
    /// depth, each in units of the sensor's σ.
    Spread,
}

/// Labels of Gaussians without a node in the field, by a vote of their nearest neighbours that have one.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SpreadConfig {
    /// Off: they keep the label they have.
    pub enabled: bool,
    /// Neighbours that vote at most.
    pub neighbours: usize,
    /// Distance of a neighbour at most, metres.
    pub radius_m: f64,
    /// A Gaussian inserted inside the keyframe's mask is dynamic, whatever the vote.
    pub from_mask: bool,
}

impl Default for SpreadConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            neighbours: 5,
            radius_m: 0.2,
            from_mask: false,
        }
    }
}

/// The mask rendered from the dynamic Gaussians. The defaults are the mask as the paper has it; the other settings are for
/// people who have gone on since the Gaussians were made.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GaussianMaskConfig {
    /// Accumulated opacity above which a pixel is in the mask.
    pub opacity: f64,
    /// A keypoint or sample is in the mask only if its depth differs by less than this from the rendered one, metres: behind
    /// a Gaussian whose surface has gone it is not. 0: depth is not compared.
    pub depth_m: f64,
    /// A cell is moving if more than this share of the samples of its surface around is in the mask, and its keypoints
    /// with it. 0: the rendered mask alone decides, and a block of samples that the flow check finds at rest clears its
    /// own cells, not those around.
    pub surface_share: f64,
}

impl Default for GaussianMaskConfig {
    fn default() -> Self {
        Self {
            opacity: 0.5,
            depth_m: 0.0,
            surface_share: 0.0,
        }
    }
}

/// What decides the label of a Gaussian that is tagged with a landmark.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TaggedLabels {
    /// Its landmark's label at a keyframe where that changed, else its own depth evidence. The two
    /// can differ: training moves a Gaussian off its landmark.
    #[default]
    Evidence,
    /// Its landmark's label, always: a landmark and its Gaussian are one thing, as in the paper.
    Landmark,
}

/// The search for sideways motion of image patches (decision 012).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PatchMotionConfig {
    /// Whether it is searched for: decision 012 says what it gains and what it costs.
    pub enabled: bool,
    /// Share of the samples that the field must find dynamic from free space alone; with fewer, neither patch
    /// motion nor the flow check runs.
    pub min_suspects: f64,
    /// Ages of the images compared with, frames; one may be off by half the least of these.
    pub ages_frames: [u32; 3],
    /// Standard deviation of a position found, px.
    pub sigma_px: f64,
    /// Texture a sample needs, in the units of [`garad_features::LkConfig::min_eigenvalue`].
    pub min_eigenvalue: f32,
    /// Correlation ([`garad_features::LkPyramid::correlation`]) at the static prediction from which a
    /// sample is at rest without a search.
    pub same_correlation: f64,
    /// Correlation below which two patches do not show the same.
    pub min_correlation: f64,
    /// 1 - correlation at the static prediction must be at least so many times that at the position found ...
    pub min_ratio: f64,
    /// ... plus this.
    pub min_gain: f64,
    /// Samples with a surface nearer by more than this in their window, in either image, are left out, metres.
    pub edge_m: f64,
}

impl PatchMotionConfig {
    /// Tolerance of an age: half the least of them.
    pub(crate) fn slack_frames(&self) -> u32 {
        self.ages_frames.into_iter().min().unwrap_or(0) / 2
    }

    /// Age of the oldest image compared with.
    pub(crate) fn reach_frames(&self) -> u32 {
        self.ages_frames.into_iter().max().unwrap_or(0) + self.slack_frames()
    }
}

impl Default for PatchMotionConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            min_suspects: 0.02,
            ages_frames: [10, 20, 30],
            sigma_px: 0.3,
            min_eigenvalue: 5e-3,
            same_correlation: 0.9,
            min_correlation: 0.4,
            min_ratio: 1.5,
            min_gain: 0.05,
            edge_m: 0.15,
        }
    }
}

impl Default for LabelConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            bootstrap_frames: 10,
            bootstrap_restart: true,
            dilate_px: 8,
            reach_px: 4,
            trust_young: 0.55,
            trust_old: 0.97,
            settle_frames: 45,
            trust_unknown: 0.55,
            memory_frames: 180,
            history_gap: 5,
            mask_freed_space: true,
            step_px: 16,
            noise: DepthNoise {
                per_m: 3e-3,
                floor_m: 0.01,
            },
            suspect_sigmas: 3.0,
            max_moving: 0.9,
            rest_frames: 10,
            edge_ratio: 0.04,
            source: LabelSource::Frames,
            depth_cue: DepthCue::FreeSpace,
            map: true,
            tagged: TaggedLabels::Evidence,
            spread: SpreadConfig::default(),
            gaussian_mask: GaussianMaskConfig::default(),
            window: LabelWindowConfig::default(),
            patch_motion: PatchMotionConfig::default(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ages_may_be_off_by_half_the_least_of_them() {
        for (ages_frames, slack, reach) in [
            ([9, 25, 14], 4, 29),
            ([40, 6, 8], 3, 43),
            ([5, 5, 5], 2, 7),
            ([1, 2, 3], 0, 3),
        ] {
            let config = PatchMotionConfig {
                ages_frames,
                ..PatchMotionConfig::default()
            };
            assert_eq!(config.slack_frames(), slack, "{ages_frames:?}");
            assert_eq!(config.reach_frames(), reach, "{ages_frames:?}");
        }
    }

    /// The numbers of decisions 005, 011, 012 and 020, and of eq. 7.
    #[test]
    fn defaults_are_those_of_their_decisions() {
        let labels = LabelConfig::default();
        let counts = [
            labels.bootstrap_frames,
            labels.settle_frames,
            labels.memory_frames,
        ];
        assert_eq!(counts, [10, 45, 180], "011, 005");
        let gaps = (labels.history_gap, labels.rest_frames);
        assert_eq!(
            gaps,
            (5, 10),
            "005: one in five frames; as long as the bootstrap"
        );
        let sides = [labels.step_px, labels.dilate_px, labels.reach_px];
        assert_eq!(sides, [16, 8, 4], "005");
        let bits = |numbers: &[f64]| numbers.iter().map(|n| n.to_bits()).collect::<Vec<_>>();
        let trust = [labels.trust_young, labels.trust_old, labels.trust_unknown];
        assert_eq!(bits(&trust), bits(&[0.55, 0.97, 0.55]), "005");
        let gates = [labels.suspect_sigmas, labels.max_moving, labels.edge_ratio];
        assert_eq!(bits(&gates), bits(&[3.0, 0.9, 0.04]), "005");
        let noise = [labels.noise.per_m, labels.noise.floor_m];
        assert_eq!(bits(&noise), bits(&[0.003, 0.01]), "005");
        let switches = [
            labels.enabled,
            labels.bootstrap_restart,
            labels.mask_freed_space,
            labels.map,
        ];
        assert_eq!(switches, [true; 4], "011, 013");
        assert_eq!(labels.window.runs, 10, "eq. 7");
        let choices = (labels.source, labels.depth_cue, labels.tagged);
        let expected = (
            LabelSource::Frames,
            DepthCue::FreeSpace,
            TaggedLabels::Evidence,
        );
        assert_eq!(choices, expected, "005, 020");
        let patch = PatchMotionConfig::default();
        assert_eq!(
            (patch.enabled, patch.ages_frames),
            (true, [10, 20, 30]),
            "012"
        );
        let limits = [
            patch.min_suspects,
            patch.sigma_px,
            patch.same_correlation,
            patch.min_correlation,
            patch.min_ratio,
            patch.min_gain,
            patch.edge_m,
        ];
        assert_eq!(
            bits(&limits),
            bits(&[0.02, 0.3, 0.9, 0.4, 1.5, 0.05, 0.15]),
            "012"
        );
    }

    #[test]
    fn gaussians_are_labelled_by_two_of_four_sources() {
        use LabelSource::{Both, Flow, Frames, Gaussians};
        let labelled = [Frames, Gaussians, Both, Flow].map(LabelSource::has_gaussians);
        assert_eq!(labelled, [false, true, true, false]);
    }
}
