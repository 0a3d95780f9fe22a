//! Sensors that do not fit the room or the motion: depth that ends before the walls, frames that come rarely.

mod common;

use garad_core::Par;
use garad_eval::{AteOptions, ate};
use garad_slam::{Config, Slam, TrackingState};
use garad_synth::{Scene, SceneConfig, SceneName};

use common::process;

/// Tracked frames and ATE in metres of every `step`th frame.
fn run(scene: &Scene, step: usize, change: impl FnOnce(&mut Config)) -> (usize, f64) {
    let mut config = Config::default();
    config.insertion.enabled = false;
    change(&mut config);
    let mut slam = Slam::new(scene.camera(), config, 0, Par::Threads(2)).expect("valid");
    let mut tracked = 0;
    for i in (0..scene.len()).step_by(step) {
        let frame = scene.frame(i, Par::Threads(2));
        let report = process(&mut slam, &frame, None);
        tracked += usize::from(report.state == TrackingState::Tracking);
    }
    let error = ate(
        &scene.trajectory(),
        &slam.trajectory(),
        &AteOptions::default(),
    );
    (tracked, error.expect("judged").stats.rmse)
}

/// Nine tenths of the corners are beyond 5 m. The few near ones are not always enough.
#[test]
fn far_corners_keep_the_camera_in_a_hall() {
    let scene = Scene::new(&SceneConfig {
        frames: 60,
        noise: true,
        seed: 3,
        supersample: 1,
        ..SceneConfig::new(SceneName::Hall)
    });
    let scene = scene.expect("valid scene");
    let (with, error) = run(&scene, 1, |_| ());
    let (without, _) = run(&scene, 1, |config| config.two_view.enabled = false);
    assert_eq!(with, 60, "all");
    assert!(
        without < 50,
        "{without} of 60 without landmarks from two views"
    );
    assert!(error < 0.02, "ATE {error} m");
}

/// Ten frames a second instead of thirty, with people in the picture.
#[test]
fn every_third_frame_is_enough() {
    let scene = Scene::new(&SceneConfig {
        frames: 120,
        width: 320,
        height: 240,
        ..SceneConfig::new(SceneName::Walking)
    });
    let scene = scene.expect("valid scene");
    let [all, third] = [1, 3].map(|step| {
        let (tracked, error) = run(&scene, step, |_| ());
        assert_eq!(tracked, 120 / step, "one of {step}");
        error
    });
    assert!(third < 1.5 * all, "{third} m, {all} m with all frames");
}
