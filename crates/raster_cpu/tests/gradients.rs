//! Gradients against differences of the image, and what holds for every gradient.
//!
//! The image jumps where a splat crosses a cut. A difference quotient across a jump says
//! nothing, so pixels in which any probe changes what is blended get no weight in L; few are lost.

mod common;

use common::{camera, map, pose, upstream};
use garad_core::{Camera, GaussianMap, Image, KeyframeId, Label, NewGaussian, Par, Rng, Se3};
use garad_raster::{
    ClampGradient, Gradients, Include, RasterError, RenderOptions, Rendered, Upstream, backward,
    render,
};
use nalgebra::{Vector3, Vector6};
use proptest::prelude::*;

const H: f64 = 1e-5;

struct Scene {
    map: GaussianMap<f64>,
    camera: Camera,
    pose: Se3,
    options: RenderOptions,
}

impl Scene {
    fn draw(&self) -> Rendered<f64> {
        render(&self.map, &self.camera, &self.pose, &self.options, Par::Seq).expect("an image")
    }

    fn back(&self, upstream: &Upstream<f64>) -> Gradients<f64> {
        let image = self.draw();
        let Self {
            map,
            camera,
            pose,
            options,
        } = self;
        backward(map, camera, pose, options, &image, upstream, Par::Seq).expect("gradients")
    }
}

/// Eight turned ellipsoids of degree 3 in general position, principal point off the middle, all
/// clamps inactive.
fn smooth_scene(seed: u64) -> Scene {
    let mut rng = Rng::keyed(seed, &[8]);
    let camera = Camera::pinhole((36, 28), [40.0, 43.0, 14.2, 16.7]).expect("valid");
    let pose = pose();
    let mut map = GaussianMap::new(3);
    for i in 0..8 {
        let z = rng.range(1.0, 3.0);
        let uv = nalgebra::Vector2::new(rng.range(2.0, 34.0), rng.range(2.0, 26.0));
        let mean = pose.inverse() * camera.unproject(&uv, z);
        map.push(&NewGaussian {
            mean: [mean.x, mean.y, mean.z],
            sigma_m: 0.1 * z,
            opacity: rng.range(0.2, 0.9),
            color: [0; 3].map(|_| rng.range(0.5, 1.0)),
            landmark: None,
            born: KeyframeId(0),
        });
        map.quaternions[i] = [0; 4].map(|_| rng.normal());
        map.log_scales[i] = map.log_scales[i].map(|s| s + rng.range(-0.7, 0.7));
        for coefficient in &mut map.sh[16 * i + 1..16 * (i + 1)] {
            *coefficient = [0; 3].map(|_| rng.range(-0.08, 0.08));
        }
    }
    let options = RenderOptions {
        background: [0.2, 0.4, 0.1],
        ..RenderOptions::default()
    };
    Scene {
        map,
        camera,
        pose,
        options,
    }
}

/// One number of the input.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Probe {
    Mean(usize, usize),
    LogScale(usize, usize),
    Quaternion(usize, usize),
    Logit(usize),
    Sh(usize, usize),
    Pose(usize),
}

impl Probe {
    fn all(map: &GaussianMap<f64>) -> Vec<Self> {
        let mut probes: Vec<Self> = (0..6).map(Self::Pose).collect();
        for i in 0..map.len() {
            probes.extend((0..3).map(|k| Self::Mean(i, k)));
            probes.extend((0..3).map(|k| Self::LogScale(i, k)));
            probes.extend((0..4).map(|k| Self::Quaternion(i, k)));
            probes.push(Self::Logit(i));
        }
        probes.extend((0..map.sh.len()).flat_map(|i| (0..3).map(move |k| Self::Sh(i, k))));
        probes
    }

    fn moved(self, scene: &Scene, h: f64) -> Rendered<f64> {
        let mut map = scene.map.clone();
        let mut pose = scene.pose;
        match self {
            Self::Mean(i, k) => map.means[i][k] += h,
            Self::LogScale(i, k) => map.log_scales[i][k] += h,
            Self::Quaternion(i, k) => map.quaternions[i][k] += h,
            Self::Logit(i) => map.opacity_logits[i] += h,
            Self::Sh(i, k) => map.sh[i][k] += h,
            Self::Pose(k) => {
                let mut xi = Vector6::zeros();
                xi[k] = h;
                pose = Se3::exp(&xi) * pose;
            }
        }
        render(&map, &scene.camera, &pose, &scene.options, Par::Seq).expect("an image")
    }

    fn of(self, g: &Gradients<f64>) -> f64 {
        match self {
            Self::Mean(i, k) => g.means[i][k],
            Self::LogScale(i, k) => g.log_scales[i][k],
            Self::Quaternion(i, k) => g.quaternions[i][k],
            Self::Logit(i) => g.opacity_logits[i],
            Self::Sh(i, k) => g.sh[i][k],
            Self::Pose(k) => g.pose[k],
        }
    }
}

/// Five images in one: (r, g, b, depth, opacity) per pixel.
fn channels(r: &Rendered<f64>) -> Vec<[f64; 5]> {
    (0..r.depth.data().len())
        .map(|p| {
            let c = r.color.data()[p];
            [c[0], c[1], c[2], r.depth.data()[p], r.opacity.data()[p]]
        })
        .collect()
}

/// Central differences with h = 1e-5 for every parameter of every Gaussian, 59 each at degree 3, and
/// the pose, L being of all five images: they agree to 2e-7 of each element (measured 8e-8, on
/// elements that almost cancel; median 3e-10), and none is zero.
#[test]
fn every_parameter_against_differences() {
    for seed in [1, 2, 3] {
        let scene = smooth_scene(seed);
        let base = scene.draw();
        assert_eq!(base.projected.len(), 8, "scene {seed}: all visible");
        let brightest = base.projected.iter().map(|s| s.opacity).fold(0.0, f64::max);
        assert!(brightest < 0.95, "scene {seed}: alpha unclamped");
        let darkest = base
            .projected
            .iter()
            .flat_map(|s| s.color)
            .fold(1.0, f64::min);
        assert!(darkest > 0.1, "scene {seed}: colour unclamped");

        // Slopes of every pixel by every probe, and the pixels that jump.
        let mut smooth = vec![1.0; base.depth.data().len()];
        let slopes: Vec<(Probe, Vec<[f64; 5]>)> = Probe::all(&scene.map)
            .into_iter()
            .map(|probe| {
                let (plus, minus) = (probe.moved(&scene, H), probe.moved(&scene, -H));
                for (p, keep) in smooth.iter_mut().enumerate() {
                    let blended = |r: &Rendered<f64>| (r.contributors.data()[p], r.last.data()[p]);
                    if blended(&plus) != blended(&base) || blended(&minus) != blended(&base) {
                        *keep = 0.0;
                    }
                }
                let pairs = channels(&plus).into_iter().zip(channels(&minus));
                let slope = pairs.map(|(a, b)| [0, 1, 2, 3, 4].map(|c| (a[c] - b[c]) / (2.0 * H)));
                (probe, slope.collect())
            })
            .collect();
        let lost = smooth.iter().filter(|&&s| s < 0.5).count();
        assert!(lost * 20 < smooth.len(), "scene {seed}: {lost} pixels jump");

        let mut up = upstream(seed, &scene.camera);
        for (p, keep) in smooth.iter().enumerate() {
            let at = (p % 36, p / 36);
            up.color[at] = up.color[at].map(|v| v * keep);
            for image in [&mut up.depth, &mut up.opacity] {
                image.as_mut().expect("given")[at] *= keep;
            }
        }
        let gradients = scene.back(&up);
        let weights: Vec<[f64; 5]> = (0..smooth.len())
            .map(|p| {
                let c = up.color.data()[p];
                let of = |i: &Option<Image<f64>>| i.as_ref().expect("given").data()[p];
                [c[0], c[1], c[2], of(&up.depth), of(&up.opacity)]
            })
            .collect();
        for (probe, slope) in &slopes {
            let numeric: f64 = (weights.iter().zip(slope))
                .map(|(w, s)| (0..5).map(|c| w[c] * s[c]).sum::<f64>())
                .sum();
            let analytic = probe.of(&gradients);
            assert!(
                (analytic - numeric).abs() < 2e-7 * analytic.abs(),
                "scene {seed}, {probe:?}: {analytic} against {numeric}"
            );
            assert!(
                analytic.abs() > 1e-9,
                "scene {seed}, {probe:?} is {analytic}"
            );
        }
        // The image does not depend on the length of a quaternion.
        for (g, q) in gradients.quaternions.iter().zip(&scene.map.quaternions) {
            let dot: f64 = g.iter().zip(q).map(|(g, q)| g * q).sum();
            let norm = |v: &[f64; 4]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
            assert!(dot.abs() < 1e-14 * norm(g) * norm(q), "radial {dot:e}");
        }
    }
}

/// Rasterizers after 3D Gaussian Splatting divide by z + 1e-7, the principal point being part of
/// what is divided: a splat at z then stands 1e-7/z of its distance from the image's middle
/// aside. Returns by how much that changes colours and ∂L/∂(centre), by their largest.
fn cost_of_another_division(nearest: f64, farthest: f64) -> (f64, f64) {
    let camera = camera();
    let mut rng = Rng::new(12);
    let mut map = GaussianMap::new(0);
    let mut moved = GaussianMap::new(0);
    for _ in 0..60 {
        let z = rng.range(nearest, farthest);
        let uv = nalgebra::Vector2::new(rng.range(0.0, 70.0), rng.range(0.0, 50.0));
        let middle = nalgebra::Vector2::new(34.5, 24.5);
        let other = middle + (uv - middle) * (z / (z + 1e-7));
        for (map, uv) in [(&mut map, uv), (&mut moved, other)] {
            let mean = camera.unproject(&uv, z);
            map.push(&NewGaussian {
                mean: [mean.x, mean.y, mean.z],
                sigma_m: 2.0 * z / camera.fx,
                opacity: 0.5,
                color: [0.9, 0.5, 0.1],
                landmark: None,
                born: KeyframeId(0),
            });
        }
    }
    let scene = |map| Scene {
        map,
        camera,
        pose: Se3::default(),
        options: RenderOptions::default(),
    };
    let (a, b) = (scene(map), scene(moved));
    let mut up = upstream(12, &camera);
    let (pa, pb) = (a.draw(), b.draw());
    // A splat that crosses 1/255 says nothing about rounding.
    let same = |at: (usize, usize)| pa.contributors[at] == pb.contributors[at];
    let places = || (0..50).flat_map(|y| (0..70).map(move |x| (x, y)));
    for at in places().filter(|&at| !same(at)) {
        up.color[at] = [0.0; 3];
    }
    let change = |a: &[f64], b: &[f64]| {
        let largest = a.iter().fold(0.0f64, |m, v| m.max(v.abs()));
        let pairs = a.iter().zip(b);
        pairs.fold(0.0f64, |m, (a, b)| m.max((a - b).abs())) / largest
    };
    let colors = |p: &Rendered<f64>| -> Vec<f64> {
        places()
            .filter(|&at| same(at))
            .flat_map(|at| p.color[at])
            .collect()
    };
    let color = change(&colors(&pa), &colors(&pb));
    let (ga, gb) = (a.back(&up), b.back(&up));
    (
        color,
        change(ga.means2d.as_flattened(), gb.means2d.as_flattened()),
    )
}

/// Close to the near plane images and gradients of the two differ by more than 1e-6 of their
/// largest (measured 2.9e-6 and 4.1e-6 at 0.21 to 0.3 m; 2.5e-7 and 4.2e-7 at 2 to 5 m): no
/// tolerance of 1e-6 holds across them there, whatever is done in f64.
#[test]
fn dividing_by_a_little_more_than_z_shows_near_the_camera() {
    let (color, gradient) = cost_of_another_division(0.21, 0.3);
    assert!(color > 1e-6 && color < 1e-5, "near: colour {color:e}");
    assert!(
        gradient > 1e-6 && gradient < 1e-5,
        "near: gradient {gradient:e}"
    );
    let (color, gradient) = cost_of_another_division(2.0, 5.0);
    assert!(color < 1e-6, "far: colour {color:e}");
    assert!(gradient < 1e-6, "far: gradient {gradient:e}");
}

fn random_scene(seed: u64, options: RenderOptions) -> Scene {
    Scene {
        map: map(seed, 40),
        camera: camera(),
        pose: pose(),
        options,
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    /// Moving all Gaussians by v is moving the camera's world by W v: Σ ∂L/∂mean = Wᵀ ∂L/∂ρ.
    #[test]
    fn moving_the_map_is_moving_the_camera(seed in 0u64..1000) {
        let scene = random_scene(seed, RenderOptions::default());
        let g = scene.back(&upstream(seed, &scene.camera));
        let sum = g.means.iter().fold(Vector3::zeros(), |s, m| s + Vector3::from(*m));
        let size: f64 = g.means.iter().map(|m| Vector3::from(*m).norm()).sum();
        let rho = Vector3::new(g.pose[0], g.pose[1], g.pose[2]);
        let back = scene.pose.rotation.matrix().transpose() * rho;
        prop_assert!((sum - back).norm() < 1e-13 * size, "{sum} against {back}");
    }

    #[test]
    fn threads_change_nothing_and_tiles_only_rounding(seed in 0u64..1000) {
        let scene = random_scene(seed, RenderOptions::default());
        let up = upstream(seed, &scene.camera);
        let one = scene.back(&up);
        let Scene { map, camera, pose, options } = &scene;
        for threads in [2, 3] {
            let many = backward(map, camera, pose, options, &scene.draw(), &up, Par::Threads(threads));
            prop_assert!(many.as_ref() == Ok(&one), "{threads} threads");
        }
        let coarse = random_scene(seed, RenderOptions { tile_px: 32, ..*options });
        let other = coarse.back(&up);
        let size = one.means.iter().flatten().fold(0.0f64, |m, v| m.max(v.abs()));
        for (a, b) in one.means.iter().flatten().zip(other.means.iter().flatten()) {
            prop_assert!((a - b).abs() < 1e-12 * size, "{a} against {b}");
        }
    }

    /// L is linear in the upstream gradients, and an absent one is zero.
    #[test]
    fn absent_images_are_zero(seed in 0u64..1000) {
        let scene = random_scene(seed, RenderOptions::default());
        let up = upstream(seed, &scene.camera);
        let color = Upstream { depth: None, opacity: None, ..up.clone() };
        let rest = Upstream { color: Image::new(70, 50, [0.0; 3]), ..up.clone() };
        let (all, color, rest) = (scene.back(&up), scene.back(&color), scene.back(&rest));
        for k in 0..6 {
            let size = color.pose[k].abs() + rest.pose[k].abs();
            prop_assert!((color.pose[k] + rest.pose[k] - all.pose[k]).abs() < 1e-12 * size, "{k}");
        }
    }
}

/// One pixel on the axis.
fn pinhole_of_one() -> Camera {
    Camera::pinhole((1, 1), [20.0, 20.0, 0.0, 0.0]).expect("valid")
}

fn ball(z: f64, opacity: f64) -> NewGaussian<f64> {
    NewGaussian {
        mean: [0.001, 0.0, z],
        sigma_m: 0.5,
        opacity,
        color: [0.8, 0.6, 0.7],
        landmark: None,
        born: KeyframeId(0),
    }
}

fn stack(balls: &[NewGaussian<f64>]) -> Scene {
    let mut map = GaussianMap::new(0);
    for ball in balls {
        map.push(ball);
    }
    Scene {
        map,
        camera: pinhole_of_one(),
        pose: Se3::default(),
        options: RenderOptions::default(),
    }
}

/// Largest absolute number in row i.
fn row_size(g: &Gradients<f64>, i: usize) -> f64 {
    let rows = [
        &g.means[i][..],
        &g.log_scales[i],
        &g.quaternions[i],
        &g.sh[i],
        &g.means2d[i],
        &g.conics[i],
    ];
    let single = [g.opacity_logits[i], g.opacities[i], g.depths[i]];
    let all = rows
        .into_iter()
        .flatten()
        .chain(&single)
        .chain(&g.colors[i]);
    all.fold(0.0, |m, v| m.max(v.abs()))
}

#[test]
fn saturated_alpha_passes_nothing_unless_asked_to() {
    let mut scene = stack(&[ball(2.0, 0.995)]);
    let up = upstream(4, &scene.camera);
    let g = scene.back(&up);
    assert!(
        g.opacity_logits[0].abs() < 1e-300,
        "opacity: {}",
        g.opacity_logits[0]
    );
    assert!(g.means2d[0][0].abs() < 1e-300, "place: {:?}", g.means2d);
    assert!(
        g.colors[0][0].abs() > 1e-3 && g.depths[0].abs() > 1e-3,
        "colour is not clamped"
    );
    scene.options.clamp_gradient = ClampGradient::PassThrough;
    let through = scene.back(&up);
    assert!(
        through.opacity_logits[0].abs() > 1e-4,
        "{}",
        through.opacity_logits[0]
    );
    assert!(through.means2d[0][0].abs() > 1e-9, "{:?}", through.means2d);
    // Just below the clamp both are the derivative.
    let below = stack(&[ball(2.0, 0.985)]);
    assert!(below.back(&up).opacity_logits[0].abs() > 1e-4, "unclamped");
}

#[test]
fn clamped_channels_pass_no_gradient() {
    let mut scene = stack(&[ball(2.0, 0.5)]);
    scene.map.sh[0] = [-3.0, 0.0, 0.3];
    let g = scene.back(&upstream(5, &scene.camera));
    assert!(g.sh[0][0].abs() < 1e-300, "red is clamped: {:?}", g.sh[0]);
    assert!(
        g.sh[0][1].abs() > 1e-4 && g.sh[0][2].abs() > 1e-4,
        "the others not: {:?}",
        g.sh[0]
    );
}

#[test]
fn what_is_not_drawn_has_no_gradient() {
    // Behind the camera; before the near plane; three opaque ones; behind them; dynamic.
    let mut dynamic = stack(&[
        ball(-1.0, 0.5),
        ball(0.1999, 0.5),
        ball(1.0, 0.98),
        ball(1.1, 0.98),
        ball(1.2, 0.98),
        ball(3.0, 0.9),
        ball(0.5, 0.5),
    ]);
    dynamic.map.label[6] = Label::Dynamic;
    dynamic.options.include = Include::StaticOnly;
    let up = upstream(6, &dynamic.camera);
    let g = dynamic.back(&up);
    for i in [0, 1, 4, 5, 6] {
        assert!(row_size(&g, i) < 1e-300, "row {i}: {}", row_size(&g, i));
    }
    for i in [2, 3] {
        assert!(row_size(&g, i) > 1e-3, "row {i} is seen");
    }
    // Nor do they add to the gradient of the pose.
    let seen = stack(&[ball(1.0, 0.98), ball(1.1, 0.98)]).back(&up);
    assert_eq!(
        seen.pose.map(f64::to_bits),
        g.pose.map(f64::to_bits),
        "pose"
    );
    assert!(g.pose.iter().any(|v| v.abs() > 1e-3), "{:?}", g.pose);
}

#[test]
fn an_empty_map_has_empty_gradients() {
    let scene = stack(&[]);
    let g = scene.back(&upstream(7, &scene.camera));
    assert!(g.means.is_empty() && g.sh.is_empty(), "no rows");
    assert!(
        g.pose.iter().all(|v| v.abs() < 1e-300),
        "pose: {:?}",
        g.pose
    );
}

#[test]
fn images_of_the_wrong_size_are_errors() {
    let scene = random_scene(1, RenderOptions::default());
    let Scene {
        map,
        camera,
        pose,
        options,
    } = &scene;
    let (image, up) = (scene.draw(), upstream(1, camera));
    let error = |map, image: &Rendered<f64>, up: &Upstream<f64>| {
        backward(map, camera, pose, options, image, up, Par::Seq).expect_err("does not fit")
    };
    let mut small = up.clone();
    small.depth = Some(Image::new(70, 49, 0.0));
    assert_eq!(
        error(map, &image, &small),
        RasterError::SizeMismatch {
            image: "upstream.depth",
            expected: (70, 50),
            got: (70, 49)
        },
        "depth"
    );
    let mut cut = image.clone();
    cut.last = Image::new(1, 1, 0);
    assert!(
        matches!(
            error(map, &cut, &up),
            RasterError::SizeMismatch {
                image: "rendered.last",
                ..
            }
        ),
        "last"
    );
    let few = common::map(1, 3);
    assert!(
        matches!(error(&few, &image, &up), RasterError::NotThisMap { .. }),
        "another map"
    );
    let mut wide = image.clone();
    wide.projected[2].footprint.x1 = 71;
    assert_eq!(
        error(map, &wide, &up),
        RasterError::NotThisMap { splat: 2 },
        "outside"
    );
    let mut poisoned = map.clone();
    poisoned.quaternions[image.projected[0].index as usize] = [0.0; 4];
    assert_eq!(
        error(&poisoned, &image, &up),
        RasterError::NotThisMap { splat: 0 },
        "never drawn"
    );
}
