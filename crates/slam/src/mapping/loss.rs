//! The training loss (eq. 12).

use garad_core::{GaussianMap, Label, Par, Real};
use garad_raster::losses::{depth_l1, opacity_penalty, photometric};
use garad_raster::{RasterError, Rendered, Upstream};

use super::view::Target;
use crate::config::TrainConfig;

/// Rendered opacity from which a pixel's depth is compared.
const DEPTH_MIN_OPACITY: f64 = 0.5;

/// The loss of one iteration and its gradients.
pub(crate) struct TrainingLoss {
    pub(crate) value: f32,
    /// With respect to the rendered image.
    pub(crate) upstream: Upstream<f32>,
    /// With respect to the opacity logits, beside their part in the image; `None` without dynamic
    /// Gaussians.
    pub(crate) opacity_logits: Option<Vec<f32>>,
}

/// Eq. 12, with the depth term of decision 006 (`lambda_depth = 0` is the printed loss):
///
/// L = λ_p-ssim L_p-ssim + λ_depth L_depth + λ_dyn L_dyn
///
/// with L_p-ssim of eq. 13 ([`photometric`]) and L_dyn = Σ wᵢ αᵢ² over the dynamic Gaussians
/// ([`opacity_penalty`]); wᵢ = 1 unless `weights` are given.
///
/// # Errors
/// [`RasterError`] for images of other sizes.
pub(crate) fn training_loss(
    rendered: &Rendered<f32>,
    target: &Target,
    map: &GaussianMap,
    weights: Option<&[f32]>,
    config: &TrainConfig,
    par: Par,
) -> Result<TrainingLoss, RasterError> {
    let [lambda_photo, lambda_depth, lambda_dynamic] = [
        config.lambda_photometric,
        config.lambda_depth,
        config.lambda_dynamic,
    ]
    .map(Real::to_f32);
    let excluded = Some(&target.excluded);
    let lambda = config.lambda_ssim;
    let photo = photometric(&rendered.color, &target.color, lambda, excluded, par)?;
    let depth = match &target.depth {
        Some(measured) => Some(depth_l1(
            &rendered.depth,
            &rendered.opacity,
            measured,
            DEPTH_MIN_OPACITY,
            excluded,
        )?),
        None => None,
    };
    let penalty = match map.label.contains(&Label::Dynamic) {
        true => Some(opacity_penalty(&map.opacity_logits, &map.label, weights)?),
        false => None,
    };
    let value_of_depth = depth.as_ref().map_or(0.0, |depth| depth.value);
    let value_of_penalty = penalty.as_ref().map_or(0.0, |penalty| penalty.value);
    let scaled = |gradient: garad_core::Image<f32>| gradient.map(|g| g * lambda_depth);
    let (by_depth, by_opacity) = depth.map(|d| (scaled(d.depth), scaled(d.opacity))).unzip();
    Ok(TrainingLoss {
        value: lambda_photo * photo.value
            + lambda_depth * value_of_depth
            + lambda_dynamic * value_of_penalty,
        upstream: Upstream {
            color: photo.gradient.map(|g| g.map(|v| v * lambda_photo)),
            depth: by_depth,
            opacity: by_opacity,
        },
        opacity_logits: penalty.map(|penalty| {
            let gradient = penalty.opacity_logits.into_iter();
            gradient.map(|g| lambda_dynamic * g).collect()
        }),
    })
}
