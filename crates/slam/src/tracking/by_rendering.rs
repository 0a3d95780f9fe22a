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

#[cfg(test)]
mod tests {
    use garad_core::{Camera, Image, KeyframeId, NewGaussian, Rng};

    use super::*;
    use crate::config::Config;

    fn context() -> Context {
        let camera = Camera::pinhole((80, 60), [70.0, 70.0, 39.5, 29.5]).expect("valid");
        let mut config = Config::default();
        let r = &mut config.render_tracking;
        (r.iterations, r.rotation_rate_rad) = (100, 0.002);
        Context::new(camera, config, 0, Par::Seq).expect("valid")
    }

    /// Two walls of random colours that meet in an edge, 2 to 2.6 m away.
    fn map() -> GaussianMap {
        let mut rng = Rng::new(5);
        let mut map = GaussianMap::new(0);
        for (i, j) in (-27i8..27).flat_map(|i| (-20i8..20).map(move |j| (i, j))) {
            let (x, y) = (0.06 * f32::from(i), 0.06 * f32::from(j));
            map.push(&NewGaussian {
                mean: [x, y, 2.0 + 0.375 * x.abs()],
                sigma_m: 0.04,
                opacity: 0.95,
                color: [(); 3].map(|()| rng.uniform().to_f32()),
                landmark: None,
                born: KeyframeId(0),
            });
        }
        map
    }

    /// What is rendered at a pose.
    fn target(context: &Context, map: &GaussianMap, pose: &Se3) -> Target {
        let (camera, options) = (context.camera, RenderOptions::default());
        let rendered = fast::render(map, &camera, pose, &options, Par::Seq).expect("drawn");
        let (width, height) = rendered.color.size();
        Target {
            camera,
            depth: Some(rendered.normalized_depth()),
            color: rendered.color,
            excluded: Image::new(width, height, 0),
        }
    }

    #[test]
    fn a_pose_two_centimetres_and_a_degree_off_is_corrected() {
        let (context, map) = (context(), map());
        let degree = 1f64.to_radians();
        let truth = Se3::exp(&Vector6::new(0.1, -0.05, 0.05, 0.02, -0.1, 0.05));
        let target = target(&context, &map, &truth);
        let (a, b) = (0.02 / 3f64.sqrt(), degree / 3f64.sqrt());
        for offset in [
            Vector6::new(0.02, 0.0, 0.0, 0.0, degree, 0.0),
            Vector6::new(-a, a, a, b, b, -b),
        ] {
            let start = Se3::exp(&offset) * truth;
            let found = pose_by_rendering(&context, &map, &target, &start);
            let (pose, pixels) = found.expect("the map is seen");
            let error = (pose * truth.inverse()).log();
            let (t, r) = (
                error.fixed_rows::<3>(0).norm(),
                error.fixed_rows::<3>(3).norm(),
            );
            assert!(t < 1e-3 && r < 0.05 * degree, "{t} m, {r} rad");
            assert!(2 * pixels > 80 * 60, "most of the image: {pixels}");
        }
    }

    #[test]
    fn without_a_visible_pixel_there_is_no_pose() {
        let (context, map) = (context(), map());
        let here = Se3::identity();
        let mut target = target(&context, &map, &here);
        let pose_from = |target: &Target, start: &Se3| {
            pose_by_rendering(&context, &map, target, start).map(|(pose, _)| pose)
        };
        assert!(pose_from(&target, &here).is_some(), "seen");
        let away = Se3::exp(&Vector6::new(0.0, 0.0, 0.0, 0.0, 3.0, 0.0));
        assert_eq!(pose_from(&target, &away), None, "looks away from the map");
        let nowhere = Se3::exp(&Vector6::new(f64::NAN, 0.0, 0.0, 0.0, 0.0, 0.0));
        assert_eq!(pose_from(&target, &nowhere), None, "not finite");
        let empty = GaussianMap::new(0);
        let found = pose_by_rendering(&context, &empty, &target, &here);
        assert_eq!(found, None, "an empty map");
        target.depth = Some(DepthImage::new(80, 60, f32::NAN));
        assert_eq!(pose_from(&target, &here), None, "no depth measured");
        target.depth = None;
        assert_eq!(pose_from(&target, &here), None, "no depth image");
    }

    #[test]
    fn pixels_with_depth_and_their_share() {
        let config = RenderTrackingConfig {
            min_share: 0.25,
            ..RenderTrackingConfig::default()
        };
        for (known, enough) in [(25, true), (24, false)] {
            let unknown = [0.0, f32::NAN, f32::INFINITY, -1.0];
            let depth = DepthImage::from_fn(20, 5, |x, y| match 20 * y + x {
                i if i < known => 2.0,
                i => unknown[i % 4],
            });
            assert_eq!(
                pixels_with_depth(&depth, &config),
                (known, enough),
                "of 100"
            );
        }
    }

    #[test]
    fn pixels_that_are_not_compared() {
        let (context, map) = (context(), map());
        let mut target = target(&context, &map, &Se3::identity());
        let options = RenderOptions::default();
        let pose = Se3::identity();
        let rendered = fast::render(&map, &context.camera, &pose, &options, Par::Seq);
        let mut rendered = rendered.expect("drawn");
        rendered.opacity = Image::new(80, 60, 0.875);
        rendered.opacity[(3, 0)] = 0.75; // not above
        rendered.opacity[(4, 0)] = 0.76;
        target.excluded[(5, 0)] = 1;
        let mut measured = DepthImage::new(80, 60, 2.0);
        for (x, z) in [(6, 0.0), (7, f32::NAN), (8, f32::INFINITY), (9, -1.0)] {
            measured[(x, 0)] = z;
        }
        let config = RenderTrackingConfig {
            min_opacity: 0.75,
            ..RenderTrackingConfig::default()
        };
        let found = not_compared(&rendered, &target, &measured, &config);
        let excluded: Vec<_> = (0..4800).filter(|i| found.data()[*i] != 0).collect();
        assert_eq!(excluded, [3, 5, 6, 7, 8, 9], "in the first row");
        assert!(excluded.iter().all(|i| found.data()[*i] == 255), "255");
    }

    /// L typed again: 1/n Σ (λ ‖C - I‖₁ + |D/O - z|).
    #[test]
    fn the_loss_weighs_the_sum_of_the_colours() {
        let (context, map) = (context(), map());
        let truth = Se3::exp(&Vector6::new(0.02, -0.01, 0.03, 0.01, -0.02, 0.03));
        let target = target(&context, &map, &truth);
        let measured = target.depth.clone().expect("rendered");
        let options = RenderOptions::default();
        let pose = Se3::identity();
        let rendered = fast::render(&map, &context.camera, &pose, &options, Par::Seq);
        let rendered = rendered.expect("drawn");
        for lambda_color in [0.0, 0.7] {
            let config = RenderTrackingConfig {
                lambda_color,
                min_opacity: 0.9,
                ..RenderTrackingConfig::default()
            };
            let (mut sum, mut n) = (0.0, 0);
            for at in (0..60).flat_map(|y| (0..80).map(move |x| (x, y))) {
                let opacity = rendered.opacity[at];
                if opacity > 0.9 && measured[at] > 0.0 {
                    let (c, i) = (rendered.color[at], target.color[at]);
                    let color: f64 = (0..3).map(|k| f64::from((c[k] - i[k]).abs())).sum();
                    let depth = rendered.depth[at] / opacity - measured[at];
                    sum += lambda_color * color + f64::from(depth.abs());
                    n += 1;
                }
            }
            let loss = tracking_loss(&map, &target, &pose, &config, Par::Seq).expect("seen");
            assert_eq!(loss.pixels, n, "pixels");
            let expected = sum / n as f64;
            let off = (f64::from(loss.value) - expected).abs();
            assert!(
                off < 1e-5 * expected,
                "λ = {lambda_color}: {} {expected}",
                loss.value
            );
        }
    }

    /// A fifth of a millimetre off, and steps of a centimetre: none is better than the first.
    #[test]
    fn the_best_of_all_poses_is_returned() {
        let (mut context, map) = (context(), map());
        let r = &mut context.config.render_tracking;
        (r.iterations, r.translation_rate_m, r.rotation_rate_rad) = (3, 0.01, 0.005);
        let truth = Se3::exp(&Vector6::new(0.1, -0.05, 0.05, 0.02, -0.1, 0.05));
        let target = target(&context, &map, &truth);
        let start = Se3::exp(&Vector6::new(2e-4, 0.0, 0.0, 0.0, 0.0, 0.0)) * truth;
        let found = pose_by_rendering(&context, &map, &target, &start);
        assert_eq!(found.expect("seen").0, start, "the start itself");
    }
}
