//! The tracker on scenes whose truth is exact.
//!
//! Small images and few frames, so that every test takes seconds; the long one is ignored unless asked for.

mod common;

use garad_core::{DepthImage, Par, RgbImage, StampedPose};
use garad_eval::{AteOptions, ate};
use garad_slam::{Config, FrameInput, Silent, Slam, SlamError, TrackingState};
use garad_synth::{Scene, SceneConfig, SceneName};

use common::process;

fn small(name: SceneName, frames: usize) -> SceneConfig {
    SceneConfig {
        frames,
        width: 320,
        height: 240,
        static_twin: true,
        supersample: 1,
        ..SceneConfig::new(name)
    }
}

fn slam(scene: &Scene, par: Par) -> Slam {
    let mut config = Config::default();
    config.insertion.enabled = false;
    Slam::new(scene.camera(), config, 0, par).expect("valid")
}

fn ate_m(scene: &Scene, estimate: &[StampedPose]) -> f64 {
    ate(&scene.trajectory(), estimate, &AteOptions::default())
        .expect("judged")
        .stats
        .rmse
}

fn run(scene: &Scene, with_mask: bool, par: Par) -> Slam {
    let mut slam = slam(scene, par);
    for i in 0..scene.len() {
        let frame = scene.frame(i, Par::Threads(2));
        process(&mut slam, &frame, with_mask.then_some(&frame.mask));
    }
    slam
}

#[test]
fn a_static_scene_is_followed() {
    let scene = Scene::new(&small(SceneName::QuietDesk, 30)).expect("valid scene");
    let slam = run(&scene, false, Par::Seq);
    let path = slam.trajectory();
    assert_eq!(path.len(), 30, "every frame has a pose");
    let error = ate_m(&scene, &path);
    assert!(error < 0.003, "ATE {error} m"); // 0.5 px at 320 pixels and 2 m is 4 mm
    assert!(slam.map().keyframes().len() >= 3, "the camera moved");
    // Landmarks lie where the depth says: on average within a few millimetres of their pixel.
    let last = slam.last_frame().expect("tracked");
    let mut errors: Vec<f64> = (0..last.len())
        .filter_map(|i| {
            let landmark = slam.map().landmark(last.landmark[i]?)?;
            let p_cam = last.camera_from_world * landmark.p_world;
            Some((p_cam.z - last.depth_m[i]?).abs())
        })
        .collect();
    errors.sort_unstable_by(f64::total_cmp);
    assert!(
        errors.len() > 100 && errors[errors.len() / 2] < 0.01,
        "landmark depths"
    );
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let scene = Scene::new(&small(SceneName::QuietDesk, 12)).expect("valid scene");
    let bits = |par: Par| -> Vec<u64> {
        let slam = run(&scene, false, par);
        let landmarks = slam
            .map()
            .landmarks()
            .flat_map(|(_, l)| [l.p_world.x, l.p_world.z]);
        let poses = slam.trajectory().into_iter().flat_map(|p| {
            let (q, t) = (
                p.world_from_camera.rotation.quaternion(),
                p.world_from_camera.translation,
            );
            [q[0], q[1], q[2], q[3], t.x, t.y, t.z]
        });
        poses.chain(landmarks).map(f64::to_bits).collect()
    };
    let one = bits(Par::Seq);
    assert!(one.len() > 500, "there is something to compare");
    assert!(one == bits(Par::Threads(2)), "2 threads");
    assert!(one == bits(Par::Threads(3)), "3 threads");
}

/// Images turn black: lost, and relocalised where the map covers the place.
#[test]
fn a_lost_camera_is_found_again() {
    let scene = Scene::new(&small(SceneName::QuietDesk, 24)).expect("valid scene");
    let mut slam = slam(&scene, Par::Seq);
    let dark = (
        RgbImage::new(320, 240, [0; 3]),
        DepthImage::new(320, 240, 0.0),
    );
    let mut states = Vec::new();
    for i in 0..scene.len() {
        let mut frame = scene.frame(i, Par::Threads(2));
        if (12..18).contains(&i) {
            (frame.rgb, frame.depth) = dark.clone();
        }
        states.push(process(&mut slam, &frame, None).state);
    }
    assert!(
        states[..12].iter().all(|s| *s == TrackingState::Tracking),
        "before: {states:?}"
    );
    assert!(
        states[12..18].iter().all(|s| *s == TrackingState::Lost),
        "dark: {states:?}"
    );
    assert!(
        states[19..].iter().all(|s| *s == TrackingState::Tracking),
        "after: {states:?}"
    );
    let path = slam.trajectory();
    assert!(path.len() < 24, "no pose is made up for dark frames");
    let error = ate_m(&scene, &path);
    assert!(error < 0.004, "found at the right place: ATE {error} m");
}

/// Dark from the start, then a scene: the first usable frame is the world.
#[test]
fn it_waits_for_the_first_usable_frame() {
    let scene = Scene::new(&small(SceneName::QuietDesk, 3)).expect("valid scene");
    let mut slam = slam(&scene, Par::Seq);
    let mut frame = scene.frame(0, Par::Seq);
    let good = frame.clone();
    frame.depth = DepthImage::new(320, 240, 0.0);
    let waiting = process(&mut slam, &frame, None);
    assert_eq!(
        waiting.state,
        TrackingState::NotInitialised,
        "no depth, no world"
    );
    assert_eq!(
        process(&mut slam, &good, None).state,
        TrackingState::Tracking,
        "starts"
    );
    assert_eq!(slam.trajectory().len(), 1, "one pose");
}

#[test]
fn an_image_of_another_size_is_refused_and_the_run_goes_on() {
    let scene = Scene::new(&small(SceneName::QuietDesk, 3)).expect("valid scene");
    let mut slam = slam(&scene, Par::Seq);
    let mut frame = scene.frame(0, Par::Seq);
    process(&mut slam, &frame, None);
    frame.depth = DepthImage::new(160, 120, 1.0);
    let input = FrameInput {
        t_s: 1.0,
        depth_t_s: 1.0,
        rgb: &frame.rgb,
        depth: &frame.depth,
        mask: None,
    };
    let error = slam
        .process(&input, &mut Silent)
        .expect_err("depth is smaller");
    assert!(
        matches!(error, SlamError::SizeMismatch { what: "depth", .. }),
        "{error}"
    );
    let next = process(&mut slam, &scene.frame(2, Par::Seq), None);
    assert_eq!(next.state, TrackingState::Tracking, "{next:?}");
}

/// With people over half the image, true labels keep the path near what it is without them.
#[test]
fn true_labels_keep_people_out_of_the_pose() {
    let mut config = small(SceneName::Huddle, 20);
    (config.width, config.height, config.static_twin) = (640, 480, false);
    let scene = Scene::new(&config).expect("valid scene");
    let labelled = run(&scene, true, Par::Seq);
    let dynamic = labelled.last_frame().expect("tracked").label.iter();
    assert!(
        dynamic
            .filter(|l| **l == garad_core::Label::Dynamic)
            .count()
            > 100,
        "people are seen"
    );
    let with = ate_m(&scene, &labelled.trajectory());
    let mut config = Config::default();
    (config.insertion.enabled, config.labels.enabled) = (false, false);
    let mut blind = Slam::new(scene.camera(), config, 0, Par::Seq).expect("valid");
    for i in 0..scene.len() {
        process(&mut blind, &scene.frame(i, Par::Threads(2)), None);
    }
    let without = ate_m(&scene, &blind.trajectory());
    assert!(with < 0.004, "ATE with labels {with} m"); // 0.0021
    assert!(
        without > 4.0 * with,
        "labels matter: {without} m without, {with} m with"
    );
}

/// The figures of the README on full-size images.
#[test]
#[ignore = "minutes: 640x480, twice"]
fn static_twins_at_full_size() {
    for (noise, limit_m) in [(false, 0.0015), (true, 0.003)] {
        let scene = Scene::new(&SceneConfig {
            noise,
            static_twin: true,
            ..SceneConfig::new(SceneName::QuietDesk)
        });
        let scene = scene.expect("valid scene");
        let slam = run(&scene, false, Par::Threads(2));
        let error = ate_m(&scene, &slam.trajectory());
        assert!(error < limit_m, "noise {noise}: ATE {error} m");
    }
}
