//! Tracking by rendering (`tracking.method = "render"`): the map alone, no feature.

mod common;

use garad_core::{DepthImage, GaussianMap, Par, RgbImage, StampedPose};
use garad_eval::{AteOptions, ate};
use garad_slam::config::TrackingMethod;
use garad_slam::{Config, Slam, TrackingState};
use garad_synth::{Scene, SceneConfig, SceneName, SynthFrame};

use common::process;

const FRAMES: usize = 20;

fn scene() -> Scene {
    Scene::new(&SceneConfig {
        frames: FRAMES,
        width: 160,
        height: 120,
        static_twin: true,
        supersample: 1,
        ..SceneConfig::new(SceneName::Walking)
    })
    .expect("valid scene")
}

fn frames(scene: &Scene) -> Vec<SynthFrame> {
    (0..FRAMES)
        .map(|i| scene.frame(i, Par::Threads(2)))
        .collect()
}

fn start(scene: &Scene, par: Par) -> Slam {
    let mut config = Config::default();
    config.tracking.method = TrackingMethod::Render;
    config.render_tracking.iterations = 12;
    config.render_tracking.level = 0;
    config.keyframes.max_gap = 5;
    config.schedule.handover_frames = 1;
    config.insertion.stride_px = 2;
    (config.insertion.footprint, config.insertion.opacity) = (0.8, 0.95);
    config.train.per_keyframe = 15;
    config.train.uses_per_level = 0;
    config.train.lambda_depth = 1.0;
    config.labels.enabled = false;
    Slam::new(scene.camera(), config, 0, par).expect("valid")
}

fn end(mut slam: Slam) -> (Vec<StampedPose>, GaussianMap) {
    slam.finish().expect("mapped");
    let map = slam.gaussians().expect("at rest").clone();
    (slam.trajectory(), map)
}

/// The path and the map after all frames; the state is saved and loaded before frame `interrupted`.
fn run(
    scene: &Scene,
    frames: &[SynthFrame],
    par: Par,
    interrupted: Option<usize>,
) -> (Vec<StampedPose>, GaussianMap) {
    let mut slam = start(scene, par);
    for (i, frame) in frames.iter().enumerate() {
        if interrupted == Some(i) {
            let mut bytes = Vec::new();
            slam.save(&mut bytes).expect("saved");
            slam = Slam::load(&mut &bytes[..], par).expect("loaded");
        }
        let report = process(&mut slam, frame, None);
        assert_eq!(report.state, TrackingState::Tracking, "frame {i}");
        assert_eq!(report.keyframe.is_some(), i % 5 == 0, "frame {i}");
        assert_eq!(report.keypoints, 0, "no features");
    }
    end(slam)
}

#[test]
fn a_static_scene_is_tracked_with_the_same_bits_for_any_number_of_threads() {
    let scene = scene();
    let frames = frames(&scene);
    let (path, map) = run(&scene, &frames, Par::Seq, None);
    let error = ate(&scene.trajectory(), &path, &AteOptions::default());
    let error = error.expect("judged").stats.rmse;
    assert!(error < 0.01, "ATE {error} m");
    // The state is put aside while a map is under way to the tracker.
    let again = run(&scene, &frames, Par::Threads(3), Some(11));
    assert!(again == (path, map), "the same bits, interrupted or not");
}

/// The camera is covered for two frames: lost, and found again where it was.
#[test]
fn a_camera_that_sees_nothing_is_lost_until_it_sees_the_map() {
    let scene = scene();
    let mut slam = start(&scene, Par::Threads(2));
    let mut states = Vec::new();
    for i in [0, 1, 2, 3, 3, 3] {
        let mut frame = scene.frame(i, Par::Threads(2));
        frame.t_s = states.len() as f64 / 30.0;
        if (3..5).contains(&states.len()) {
            frame.rgb = RgbImage::new(160, 120, [0; 3]);
            frame.depth = DepthImage::new(160, 120, 0.0);
        }
        states.push(process(&mut slam, &frame, None).state);
    }
    use TrackingState::{Lost, Tracking};
    assert_eq!(states, [Tracking, Tracking, Tracking, Lost, Lost, Tracking]);
}
