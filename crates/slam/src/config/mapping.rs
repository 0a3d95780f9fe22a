//! The map of Gaussians: insertion, training, growth, schedule.

use serde::{Deserialize, Serialize};

/// New Gaussians from a keyframe's landmarks and depth.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InsertionConfig {
    /// Off: there is no map of Gaussians.
    pub enabled: bool,
    /// One candidate every so many pixels, each way.
    pub stride_px: usize,
    /// Where the standard deviation of a new Gaussian comes from.
    pub scale: InitialScale,
    /// Standard deviation as a multiple of the candidate's footprint `stride * z / f`, if it comes from
    /// that.
    pub footprint: f64,
    /// Opacity of a new Gaussian.
    pub opacity: f64,
    /// Pixels whose rendered opacity is lower are not yet explained.
    pub explained_opacity: f64,
    /// Nor are pixels whose surface lies in front of the rendered one by more than this share.
    pub depth_ratio: f64,
    /// A Gaussian for each new landmark, too, tagged with it.
    pub landmarks: bool,
    /// No Gaussian from depth where the mask says that something moves, or within one stride of it.
    pub avoid_moving: bool,
    /// Gaussians at most.
    pub max_gaussians: usize,
}

/// Where the standard deviation of a new Gaussian comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum InitialScale {
    /// `footprint` times the distance between neighbouring samples at its depth.
    #[default]
    Footprint,
    /// The distances to the three nearest other Gaussians, as in 3D Gaussian Splatting
    /// ([`garad_raster::knn_scales_m`]): the static ones of the map, and those of the same keyframe.
    Neighbours,
}

impl Default for InsertionConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            stride_px: 4,
            scale: InitialScale::Footprint,
            footprint: 0.6,
            opacity: 0.9,
            explained_opacity: 0.6,
            depth_ratio: 0.05,
            landmarks: true,
            avoid_moving: true,
            max_gaussians: 400_000,
        }
    }
}

/// Training of the map on the keyframes' images (paper eq. 12, 13, 16).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    /// Iterations for each new keyframe, while tracking goes on.
    pub per_keyframe: usize,
    /// Further iterations for each frame since the keyframe before.
    pub per_frame: usize,
    /// Iterations after the last frame.
    #[serde(alias = "refine")]
    pub final_iterations: usize,
    /// Images kept to train on at most, 2.4 MB each at 640 x 480 (decision 010).
    pub max_views: usize,
    /// Uses of a keyframe at 1/4 and again at 1/2 of its size, before it is used whole.
    pub uses_per_level: usize,
    /// Weight of the photometric loss (eq. 12).
    pub lambda_photometric: f64,
    /// Weight of the penalty on dynamic Gaussians (eq. 12).
    pub lambda_dynamic: f64,
    /// The weight of each dynamic Gaussian in that penalty.
    pub dynamic_weight: DynamicWeight,
    /// Share of 1 - SSIM in the photometric loss (eq. 13).
    pub lambda_ssim: f64,
    /// Weight of the depth error, 1/m. The paper has no such term: 0 is its loss. Without it white
    /// walls drift towards the camera (decision 006).
    pub lambda_depth: f64,
    /// Exclude from the loss what moves: the mask with a border of `labels.dilate_px`, and what
    /// `labels.mask_freed_space` finds. Off: the whole image, as in the paper.
    pub exclude_moving: bool,
    /// The optimiser.
    pub optimiser: Optimiser,
    /// Degree that the colours' spherical harmonics may reach, 0 to 3, ...
    pub sh_degree: usize,
    /// ... one more every so many iterations; 0: at once.
    pub sh_every: usize,
    /// Step sizes.
    pub rates: RateConfig,
}

/// The weight wᵢ of a dynamic Gaussian in the penalty Σ wᵢ αᵢ² of eq. 12.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DynamicWeight {
    /// 1, as the equation has it.
    #[default]
    Uniform,
    /// Dynamic runs among the last n of its window, over n: what the text calls the credibility of the label (the
    /// share of dynamic runs) and the duration of observation (the share of n there has been).
    BeliefAndAge,
}

/// The paper's text says "SGD"; the code it builds on uses Adam.
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

impl TrainConfig {
    /// Iterations of the job of a keyframe that comes so many frames after the one before.
    #[must_use]
    pub fn iterations_of_job(&self, since_last: usize) -> usize {
        self.per_keyframe + self.per_frame * since_last
    }

    /// Whether images are kept to train on.
    #[must_use]
    pub fn keeps_views(&self) -> bool {
        self.per_keyframe + self.per_frame + self.final_iterations > 0
    }
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            per_keyframe: 6,
            per_frame: 1,
            final_iterations: 0,
            max_views: 150,
            uses_per_level: 8,
            lambda_photometric: 0.8,
            lambda_dynamic: 0.2,
            dynamic_weight: DynamicWeight::Uniform,
            lambda_ssim: 0.2,
            lambda_depth: 0.2,
            exclude_moving: true,
            optimiser: Optimiser::Adam,
            sh_degree: 3,
            sh_every: 1000,
            rates: RateConfig::default(),
        }
    }
}

/// Adaptive density control: clone, split, prune (Kerbl et al. 2023).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DensifyConfig {
    /// Off: only insertion adds Gaussians, only the end drops them.
    pub enabled: bool,
    /// Once in so many iterations.
    pub every: usize,
    /// Mean |∂L/∂ centre| from which a Gaussian is cloned or split, per unit of NDC.
    #[serde(alias = "pull")]
    pub grad_threshold: f64,
    /// Beside tracking, only Gaussians born in the last so many keyframes are cloned and split: a place
    /// is refined while it is new. Training after the last frame has no such limit.
    pub young_keyframes: u32,
    /// Those with a standard deviation above this share of the path's extent are split.
    pub split_extent: f64,
    /// Static Gaussians less opaque than this are dropped, ...
    pub min_opacity: f64,
    /// ... and those with a standard deviation above a tenth of the path's extent, as the paper and 3D Gaussian
    /// Splatting have it.
    pub prune_large: bool,
    /// Gaussians at most, clones and children included.
    pub max_gaussians: usize,
}

impl Default for DensifyConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            every: 100,
            grad_threshold: 4e-4,
            young_keyframes: 100,
            split_extent: 0.01,
            min_opacity: 0.05,
            prune_large: false,
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

#[cfg(test)]
mod tests {
    use super::*;

    /// One iteration of any kind is enough.
    #[test]
    fn views_are_kept_if_there_is_training() {
        for (per_keyframe, per_frame, final_iterations, keeps) in [
            (0, 0, 0, false),
            (1, 0, 0, true),
            (0, 1, 0, true),
            (0, 0, 1, true),
        ] {
            let config = TrainConfig {
                per_keyframe,
                per_frame,
                final_iterations,
                ..TrainConfig::default()
            };
            assert_eq!(
                config.keeps_views(),
                keeps,
                "{per_keyframe}, {per_frame}, {final_iterations}"
            );
        }
    }

    #[test]
    fn a_job_has_iterations_for_its_keyframe_and_for_every_frame_since_the_last() {
        let config = TrainConfig {
            per_keyframe: 5,
            per_frame: 3,
            ..TrainConfig::default()
        };
        assert_eq!(
            [0, 1, 7].map(|since| config.iterations_of_job(since)),
            [5, 8, 26]
        );
    }

    /// The numbers of 3D Gaussian Splatting (its paper's section 5.2 and the defaults of its code), those of eq. 12 and
    /// 13, and those of decisions 006 and 010.
    #[test]
    fn defaults_are_those_of_their_sources() {
        let bits = |numbers: [f64; 4]| numbers.map(f64::to_bits);
        let rates = RateConfig::default();
        let steps = [
            rates.log_scale,
            rates.quaternion,
            rates.opacity_logit,
            rates.sh,
        ];
        let expected = [0.005, 0.001, 0.05, 0.0025];
        assert_eq!(bits(steps), bits(expected), "3D Gaussian Splatting");
        assert!((rates.sh_rest_divisor - 20.0).abs() < 1e-12, "the same");
        let train = TrainConfig::default();
        let lambdas = [
            train.lambda_photometric,
            train.lambda_dynamic,
            train.lambda_ssim,
            train.lambda_depth,
        ];
        let expected = [0.8, 0.2, 0.2, 0.2];
        assert_eq!(bits(lambdas), bits(expected), "eq. 12, 13, decision 006");
        let levels = (train.sh_degree, train.sh_every, train.uses_per_level);
        assert_eq!(levels, (3, 1000, 8), "3D Gaussian Splatting, 006");
        let iterations = (train.per_keyframe, train.per_frame, train.final_iterations);
        assert_eq!(iterations, (6, 1, 0), "006");
        let kinds = (train.optimiser, train.dynamic_weight);
        assert_eq!(kinds, (Optimiser::Adam, DynamicWeight::Uniform), "006");
        assert_eq!((train.max_views, train.exclude_moving), (150, true), "010");
        let densify = DensifyConfig::default();
        let limits = [
            densify.grad_threshold,
            densify.split_extent,
            densify.min_opacity,
            rates.mean,
        ];
        assert_eq!(bits(limits), bits([4e-4, 0.01, 0.05, 3.2e-4]), "010");
        let counts = (densify.every, densify.young_keyframes, densify.prune_large);
        assert_eq!(counts, (100, 100, false), "010");
        let insertion = InsertionConfig::default();
        let shares = [
            insertion.footprint,
            insertion.opacity,
            insertion.explained_opacity,
            insertion.depth_ratio,
        ];
        assert_eq!(bits(shares), bits([0.6, 0.9, 0.6, 0.05]), "the book");
        assert_eq!(
            insertion.stride_px, 4,
            "the book: docs/book/src/training.md"
        );
        assert_eq!(ScheduleConfig::default().handover_frames, 5, "006");
    }
}
