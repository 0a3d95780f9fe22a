//! [`pose_by_rendering`]: the pose at which the rendered map looks like the frame.

use garad_core::{DepthImage, GaussianMap, MaskImage, Par, Real, Se3};
use garad_optim::{Adam, AdamConfig};
use garad_raster::losses::{depth_l1, l1};
use garad_raster::{Include, RenderOptions, Rendered, Upstream, fast};
use nalgebra::Vector6;

use crate::config::RenderTrackingConfig;
use crate::context::Context;
use crate::mapping::view::Target;

/// Tracking as in SplaTAM (Keetha et al. 2024, sec. 3.3): with C, D and O the colour, depth and opacity
/// (silhouette) rendered at a pose, I and z the frame's colour and depth, and P the n pixels with
/// O > `min_opacity` and a depth z,
///
/// L = 1/n Σ_P (λ ‖C - I‖₁ + |D/O - z|),   λ = `lambda_color`
///
/// is descended by Adam: pose ← exp(-Δ) pose, with Δ the step (O6) along ∂L/∂ξ of exp(ξ) pose at ξ = 0
/// and step sizes η (1 - i/N) in iteration i of N. Of the N + 1 poses the one with the smallest L is
/// returned, with its n.
///
/// `None` if fewer than `min_share` of the pixels are in P at `start`, or numbers are not finite there.
///
/// In SplaTAM L is a sum, which falls with every pixel that leaves P, and D is not divided by O; P and
/// the weights are the same.
pub(crate) fn pose_by_rendering(
    context: &Context,
    map: &GaussianMap,
    target: &Target,
    start: &Se3,
) -> Option<(Se3, usize)> {
    let config = &context.config.render_tracking;
    let mut adam = Adam::new(AdamConfig::default(), 1, 6).ok()?;
    let mut pose = *start;
    let mut best: Option<(f32, Se3, usize)> = None;
    for i in 0..=config.iterations {
        let Some(loss) = tracking_loss(map, target, &pose, config, context.par) else {
            break;
        };
        if best.is_none_or(|(least, ..)| loss.value < least) {
            best = Some((loss.value, pose, loss.pixels));
        }
        let falling = 1.0 - i as f64 / config.iterations as f64;
        let (t, r) = (config.translation_rate_m, config.rotation_rate_rad);
        let rates = [t, t, t, r, r, r].map(|rate| falling * rate);
        let mut xi = [0.0; 6];
        if adam.step_by_column(&mut xi, &loss.by_pose, &rates).is_err() {
            break;
        }
        pose = Se3::exp(&Vector6::from(xi)) * pose;
    }
    best.map(|(_, pose, pixels)| (pose, pixels))
}

/// Pixels of a depth image that could be compared, and whether they are enough.
pub(crate) fn pixels_with_depth(
    depth: &DepthImage,
    config: &RenderTrackingConfig,
) -> (usize, bool) {
    let known = depth.data().iter().filter(|z| **z > 0.0 && z.is_finite());
    let pixels = known.count();
    (pixels, is_enough(pixels, depth.data().len(), config))
}

fn is_enough(pixels: usize, of: usize, config: &RenderTrackingConfig) -> bool {
    pixels as f64 >= config.min_share * of as f64
}

/// L at a pose, ∂L/∂ξ, and the number of pixels compared.
struct TrackingLoss {
    value: f32,
    by_pose: [f64; 6],
    pixels: usize,
}

/// `None` if too few pixels can be compared or numbers are not finite.
fn tracking_loss(
    map: &GaussianMap,
    target: &Target,
    pose: &Se3,
    config: &RenderTrackingConfig,
    par: Par,
) -> Option<TrackingLoss> {
    let camera = &target.camera;
    let measured = target.depth.as_ref()?;
    let options = RenderOptions {
        include: Include::StaticOnly,
        ..RenderOptions::default()
    };
    let rendered = fast::render(map, camera, pose, &options, par).ok()?;
    let excluded = Some(&not_compared(&rendered, target, measured, config));
    let (opacity, least) = (&rendered.opacity, config.min_opacity);
    let depth = depth_l1(&rendered.depth, opacity, measured, least, excluded).ok()?;
    if !is_enough(depth.pixels, measured.data().len(), config) {
        return None;
    }
    // The mean over pixels and channels; L has the sum over channels.
    let color = l1(&rendered.color, &target.color, excluded).ok()?;
    let weight = 3.0 * config.lambda_color.to_f32();
    let upstream = Upstream {
        color: color.gradient.map(|g| g.map(|v| weight * v)),
        depth: Some(depth.depth),
        opacity: Some(depth.opacity),
    };
    let gradients = fast::backward(map, camera, pose, &options, &rendered, &upstream, par).ok()?;
    Some(TrackingLoss {
        value: depth.value + weight * color.value,
        by_pose: gradients.pose.map(Real::to_f64),
        pixels: depth.pixels,
    })
}

/// 255 at the pixels outside P.
fn not_compared(
    rendered: &Rendered<f32>,
    target: &Target,
    measured: &DepthImage,
    config: &RenderTrackingConfig,
) -> MaskImage {
    let least = config.min_opacity.to_f32();
    let (width, height) = measured.size();
    MaskImage::from_fn(width, height, |x, y| {
        let at = (x, y);
        let z = measured[at];
        let seen = rendered.opacity[at] > least && z > 0.0 && z.is_finite();
        match seen && target.excluded[at] == 0 {
            true => 0,
            false => 255,
        }
    })
}
