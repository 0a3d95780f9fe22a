//! Training on a small scene, in a few iterations.

mod common;

use std::ops::ControlFlow;

use garad_core::{Par, StampedPose};
use garad_raster::{RenderOptions, render};
use garad_slam::{Config, Slam};
use garad_synth::{Scene, SceneConfig, SceneName};

use common::process;

const SIZE: (usize, usize) = (160, 120);

fn scene() -> Scene {
    Scene::new(&SceneConfig {
        frames: 6,
        width: SIZE.0,
        height: SIZE.1,
        static_twin: true,
        supersample: 1,
        ..SceneConfig::new(SceneName::QuietDesk)
    })
    .expect("valid scene")
}

/// Tracks the scene and trains for so many iterations. Returns the losses, too.
fn trained(scene: &Scene, iterations: usize, par: Par) -> (Slam, Vec<f32>) {
    let mut config = Config::default();
    config.train.per_keyframe = 0;
    config.train.per_frame = 0;
    config.train.final_iterations = iterations;
    config.train.uses_per_level = 0; // full size from the start: losses can be compared
    run(scene, config, par)
}

/// Tracks the scene, maps beside it, and refines.
fn run(scene: &Scene, config: Config, par: Par) -> (Slam, Vec<f32>) {
    let mut slam = Slam::new(scene.camera(), config, 0, par).expect("valid");
    for i in 0..scene.len() {
        let frame = scene.frame(i, Par::Seq);
        process(&mut slam, &frame, None);
    }
    let mut losses = Vec::new();
    slam.train_final(&mut |step| {
        losses.push(step.loss);
        ControlFlow::Continue(())
    })
    .expect("trains");
    (slam, losses)
}

/// Mean squared error of the map against the last frame, drawn from its pose.
fn error_of_last_frame(slam: &Slam, scene: &Scene) -> f32 {
    let pose: StampedPose = *slam.trajectory().last().expect("tracked");
    let camera_from_world = pose.world_from_camera.inverse();
    let options = RenderOptions::default();
    let drawn = render(
        slam.gaussians().expect("at rest"),
        slam.camera(),
        &camera_from_world,
        &options,
        Par::Seq,
    )
    .expect("drawn");
    let truth = scene.frame(scene.len() - 1, Par::Seq).rgb;
    let pairs = drawn.color.data().iter().zip(truth.data());
    let sum: f32 = pairs
        .flat_map(|(a, b)| [0, 1, 2].map(|c| a[c] - f32::from(b[c]) / 255.0))
        .map(|d| d * d)
        .fold(0.0, |a, b| a + b);
    sum / (3 * SIZE.0 * SIZE.1) as f32
}

#[test]
fn training_makes_the_map_look_like_the_images() {
    let scene = scene();
    let (seeded, _) = trained(&scene, 0, Par::Seq);
    let (learnt, losses) = trained(&scene, 60, Par::Threads(2));
    assert_eq!(losses.len(), 60, "every iteration is reported");
    let (before, after) = (
        error_of_last_frame(&seeded, &scene),
        error_of_last_frame(&learnt, &scene),
    );
    assert!(after < 0.5 * before, "3 dB at least: {before} to {after}");
    learnt
        .gaussians()
        .expect("at rest")
        .validate()
        .expect("finite");
}

#[test]
fn the_observer_can_end_the_training() {
    let (mut slam, losses) = trained(&scene(), 5, Par::Seq);
    assert_eq!(losses.len(), 5, "to its end");
    let mut steps = 0;
    slam.train_final(&mut |_| {
        steps += 1;
        match steps {
            3 => ControlFlow::Break(()),
            _ => ControlFlow::Continue(()),
        }
    })
    .expect("trains");
    assert_eq!(steps, 3, "after the third iteration");
}

#[test]
fn any_number_of_threads_trains_the_same_map() {
    let scene = scene();
    let mut config = Config::default();
    (config.keyframes.min_gap, config.keyframes.max_gap) = (1, 2); // jobs wait in line behind each other
    config.schedule.handover_frames = 3;
    config.train.per_keyframe = 8;
    config.train.per_frame = 2;
    config.train.final_iterations = 150;
    config.train.sh_every = 60;
    config.densify.every = 40;
    config.densify.grad_threshold = 2e-4;
    let (one, losses) = run(&scene, config.clone(), Par::Seq);
    let map = one.gaussians().expect("at rest");
    assert!(one.map().keyframes().len() >= 3, "several jobs");
    assert_eq!(map.sh_degree(), 3, "200 iterations and more");
    for threads in [2, 3] {
        let (other, other_losses) = run(&scene, config.clone(), Par::Threads(threads));
        assert_eq!(
            one.trajectory(),
            other.trajectory(),
            "{threads} threads: path"
        );
        assert!(
            map == other.gaussians().expect("at rest"),
            "{threads} threads: map"
        );
        let bits = |l: &[f32]| l.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        assert_eq!(
            bits(&losses),
            bits(&other_losses),
            "{threads} threads: losses"
        );
    }
}

#[test]
fn clones_and_children_are_added_and_faded_ones_pruned() {
    let scene = scene();
    let mut config = Config::default();
    config.train.per_keyframe = 0;
    config.train.per_frame = 0;
    config.train.final_iterations = 60;
    config.train.uses_per_level = 0;
    config.densify.every = 20;
    config.densify.grad_threshold = 1e-4;
    let (grown, _) = run(&scene, config.clone(), Par::Threads(2));
    config.densify.enabled = false;
    let (plain, _) = run(&scene, config.clone(), Par::Threads(2));
    let count = |slam: &Slam| slam.gaussians().expect("at rest").len();
    assert!(
        count(&grown) > count(&plain),
        "{} against {}",
        count(&grown),
        count(&plain)
    );
    let (dense, sparse) = (
        error_of_last_frame(&grown, &scene),
        error_of_last_frame(&plain, &scene),
    );
    assert!(dense < sparse, "better: {sparse} to {dense}"); // 0.00866 to 0.00848
    config.densify.min_opacity = 0.6;
    let (pruned, _) = run(&scene, config, Par::Threads(2));
    let logits = &pruned.gaussians().expect("at rest").opacity_logits;
    let faintest = logits.iter().copied().fold(f32::INFINITY, f32::min);
    let least = garad_core::Real::ln(0.6f32 / 0.4) - 1e-6;
    assert!(faintest >= least, "none below: {faintest}");
    assert!(
        logits.len() < count(&plain),
        "{} of {}",
        logits.len(),
        count(&plain)
    );
}
