//! The map learns pictures: on a small scene, in a few iterations.

use garad_core::{Par, StampedPose};
use garad_raster::{RenderOptions, render};
use garad_slam::{Config, FrameInput, Silent, Slam};
use garad_synth::{Scene, SceneConfig, SceneName};

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
    config.train.refine = iterations;
    config.train.uses_per_level = 0; // full size from the start: losses can be compared
    let mut slam = Slam::new(scene.camera(), config, 0, par).expect("valid");
    for i in 0..scene.len() {
        let frame = scene.frame(i, Par::Seq);
        let input = FrameInput {
            t_s: frame.t_s,
            rgb: &frame.rgb,
            depth: &frame.depth,
            mask: None,
        };
        slam.process(&input, &mut Silent).expect("a good frame");
    }
    let mut losses = Vec::new();
    slam.refine_map(&mut |step| losses.push(step.loss))
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
fn training_makes_the_map_look_like_the_pictures() {
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
fn any_number_of_threads_trains_the_same_map() {
    let scene = scene();
    let (one, losses) = trained(&scene, 12, Par::Seq);
    for threads in [2, 3] {
        let (other, other_losses) = trained(&scene, 12, Par::Threads(threads));
        assert!(
            one.gaussians().expect("at rest") == other.gaussians().expect("at rest"),
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
