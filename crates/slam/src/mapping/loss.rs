//! The training loss (eq. 12).

use garad_core::{DepthImage, GaussianMap, Image, Label, MaskImage, Par, Real};
use garad_raster::losses::{depth_l1, opacity_penalty, photometric};
use garad_raster::{RasterError, Rendered, Upstream};

use crate::config::TrainConfig;

/// Rendered opacity from which a pixel's depth is compared.
pub const DEPTH_MIN_OPACITY: f64 = 0.5;

/// What a rendered image is compared with.
#[derive(Debug, Clone, Copy)]
pub struct TargetImages<'a, T> {
    /// Colour, in [0, 1].
    pub color: &'a Image<[T; 3]>,
    /// Metres, 0 where it is not known; without it there is no depth term.
    pub depth: Option<&'a DepthImage>,
    /// Not 0 where the loss is not evaluated.
    pub excluded: &'a MaskImage,
}

/// The loss of one iteration and its gradients.
pub(crate) struct TrainingLoss<T> {
    pub(crate) value: T,
    /// With respect to the rendered image.
    pub(crate) upstream: Upstream<T>,
    /// With respect to the opacity logits, beside their part in the image; `None` without dynamic
    /// Gaussians.
    pub(crate) opacity_logits: Option<Vec<T>>,
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
pub(crate) fn training_loss<T: Real>(
    rendered: &Rendered<T>,
    target: TargetImages<'_, T>,
    map: &GaussianMap<T>,
    weights: Option<&[T]>,
    config: &TrainConfig,
    par: Par,
) -> Result<TrainingLoss<T>, RasterError> {
    let [lambda_photo, lambda_depth, lambda_dynamic] = [
        config.lambda_photometric,
        config.lambda_depth,
        config.lambda_dynamic,
    ]
    .map(T::from_f64);
    let excluded = Some(target.excluded);
    let lambda = config.lambda_ssim;
    let photo = photometric(&rendered.color, target.color, lambda, excluded, par)?;
    let depth = match target.depth {
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
    let value_of_depth = depth.as_ref().map_or(T::ZERO, |depth| depth.value);
    let value_of_penalty = penalty.as_ref().map_or(T::ZERO, |penalty| penalty.value);
    let scaled = |gradient: Image<T>| gradient.map(|g| *g * lambda_depth);
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

#[cfg(test)]
mod tests {
    use garad_core::{KeyframeId, NewGaussian};

    use super::*;

    const SIZE: (usize, usize) = (4, 2);

    fn image<P: Copy>(pixel: P) -> Image<P> {
        Image::new(SIZE.0, SIZE.1, pixel)
    }

    /// Colour 0.75 and a depth of 2 m, with opacity 0.8.
    fn rendered(opacity: f32) -> Rendered<f32> {
        Rendered {
            color: image([0.75; 3]),
            depth: image(2.0 * opacity),
            opacity: image(opacity),
            transmittance: image(1.0 - opacity),
            contributors: image(1),
            last: image(1),
            radii: Vec::new(),
            projected: Vec::new(),
        }
    }

    /// Opacities of 1/2; the second is dynamic.
    fn map(dynamic: bool) -> GaussianMap {
        let mut map = GaussianMap::new(0);
        for _ in 0..2 {
            map.push(&NewGaussian {
                mean: [0.0, 0.0, 2.0],
                sigma_m: 0.02,
                opacity: 0.5,
                color: [0.5; 3],
                landmark: None,
                born: KeyframeId(0),
            });
        }
        map.label[1] = if dynamic {
            Label::Dynamic
        } else {
            Label::Static
        };
        map
    }

    fn config() -> TrainConfig {
        TrainConfig {
            lambda_photometric: 0.7,
            lambda_ssim: 0.0,
            lambda_depth: 0.3,
            lambda_dynamic: 0.06,
            ..TrainConfig::default()
        }
    }

    /// L1 = 0.5, L_depth = 0.5 m and L_dyn = w/4, in which ∂/∂logit = 2 w o² (1 - o) = w/4.
    #[test]
    fn each_term_has_its_weight_in_the_value_and_in_the_gradient() {
        let (color, depth, none) = (image([0.25; 3]), image(1.5), MaskImage::new(4, 2, 0));
        for (with_depth, dynamic, weights, expected) in [
            (true, true, None, 0.7 * 0.5 + 0.3 * 0.5 + 0.06 * 0.25),
            (
                true,
                true,
                Some([9.0, 3.0]),
                0.7 * 0.5 + 0.3 * 0.5 + 0.06 * 0.75,
            ),
            (true, false, None, 0.7 * 0.5 + 0.3 * 0.5),
            (false, true, None, 0.7 * 0.5 + 0.06 * 0.25),
        ] {
            let target = TargetImages {
                color: &color,
                depth: with_depth.then_some(&depth),
                excluded: &none,
            };
            let (rendered, map) = (rendered(0.8), map(dynamic));
            let weights = weights.as_ref().map(|w: &[f32; 2]| &w[..]);
            let loss = training_loss(&rendered, target, &map, weights, &config(), Par::Seq);
            let loss = loss.expect("of one size");
            let near = |got: f32, expected: f64, what: &str| {
                assert!(
                    (f64::from(got) - expected).abs() < 1e-6,
                    "{what}: {got}, {expected}"
                );
            };
            near(loss.value, expected, "value");
            near(loss.upstream.color[(3, 1)][2], 0.7 / 24.0, "colour");
            match (&loss.upstream.depth, &loss.upstream.opacity) {
                (Some(by_depth), Some(by_opacity)) if with_depth => {
                    near(by_depth[(3, 1)], 0.3 / 8.0 / 0.8, "depth");
                    near(by_opacity[(3, 1)], -2.0 * 0.3 / 8.0 / 0.8, "opacity");
                }
                found => assert!(!with_depth && found == (&None, &None), "{found:?}"),
            }
            let by_logit = loss.opacity_logits.map(|g| (g[0].abs() <= 0.0, g[1]));
            assert_eq!(by_logit.is_some(), dynamic, "only for dynamic ones");
            let weight = weights.map_or(1.0, |w| f64::from(w[1]));
            if let Some((static_is_free, dynamic)) = by_logit {
                assert!(static_is_free, "no penalty");
                near(dynamic, 0.06 * 0.25 * weight, "logit");
            }
        }
    }

    #[test]
    fn depth_is_compared_from_half_opacity_on_and_outside_what_is_excluded() {
        let (color, depth) = (image([0.75; 3]), image(1.5));
        for (opacity, excluded, expected) in [(0.5, 0, 0.15), (0.499, 0, 0.0), (0.5, 1, 0.0)] {
            let target = TargetImages {
                color: &color,
                depth: Some(&depth),
                excluded: &MaskImage::new(4, 2, excluded),
            };
            let loss = training_loss(
                &rendered(opacity),
                target,
                &map(false),
                None,
                &config(),
                Par::Seq,
            );
            let value = loss.expect("of one size").value;
            assert!(
                (value - expected).abs() < 1e-6,
                "{opacity}, {excluded}: {value}"
            );
        }
        let target = TargetImages {
            color: &image([0.25; 3]),
            depth: None,
            excluded: &MaskImage::new(4, 2, 1),
        };
        let loss = training_loss(
            &rendered(0.5),
            target,
            &map(false),
            None,
            &config(),
            Par::Seq,
        );
        let value = loss.expect("of one size").value;
        assert!(value.abs() < 1e-6, "colour is excluded, too: {value}");
    }
}
