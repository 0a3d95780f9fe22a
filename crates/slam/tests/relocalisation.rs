//! A camera that sees nothing for a while, and one that is carried off: both are found again.
//!
//! Small images, so that the tests take seconds.

use garad_core::{DepthImage, Par, RgbImage};
use garad_eval::{AteOptions, ate};
use garad_slam::{Config, FrameInput, FrameReport, Silent, Slam, TrackingState};
use garad_synth::{Scene, SceneConfig, SceneName};

const SIZE: (usize, usize) = (320, 240);

/// A lap and more of the room with a loop, 754 frames a lap.
fn room(frames: usize) -> Scene {
    Scene::new(&SceneConfig {
        frames,
        width: SIZE.0,
        height: SIZE.1,
        supersample: 1,
        ..SceneConfig::new(SceneName::Loop)
    })
    .expect("valid scene")
}

fn slam(scene: &Scene, par: Par) -> Slam {
    let mut config = Config::default();
    config.insertion.enabled = false;
    Slam::new(scene.camera(), config, 0, par).expect("valid")
}

/// Frame `i` of the scene at time `t_s`; nothing but darkness if it is `dark`.
fn process(slam: &mut Slam, scene: &Scene, i: usize, t_s: f64, dark: bool) -> FrameReport {
    let frame = scene.frame(i, Par::Threads(2));
    let black = (
        RgbImage::new(SIZE.0, SIZE.1, [0; 3]),
        DepthImage::new(SIZE.0, SIZE.1, 0.0),
    );
    let (rgb, depth) = match dark {
        true => (&black.0, &black.1),
        false => (&frame.rgb, &frame.depth),
    };
    let input = FrameInput {
        t_s,
        depth_t_s: t_s,
        rgb,
        depth,
        mask: None,
    };
    slam.process(&input, &mut Silent).expect("a good frame")
}

/// Frames from the first one given until tracking goes on.
fn frames_until_found(reports: &[FrameReport]) -> usize {
    reports
        .iter()
        .position(|r| r.state == TrackingState::Tracking)
        .unwrap_or(reports.len())
}

#[test]
fn twenty_dark_frames_and_the_camera_is_found_within_ten() {
    let scene = room(75);
    let mut slam = slam(&scene, Par::Seq);
    let reports: Vec<_> = (0..scene.len())
        .map(|i| process(&mut slam, &scene, i, i as f64 / 30.0, (40..60).contains(&i)))
        .collect();
    let dark = &reports[40..60];
    assert!(
        dark.iter().all(|r| r.state == TrackingState::Lost),
        "nothing is seen in the dark"
    );
    let found = frames_until_found(&reports[60..]);
    assert!(found < 10, "found after {found} frames");
    let options = AteOptions::default();
    let error = ate(&scene.trajectory(), &slam.trajectory(), &options).expect("judged");
    assert!(error.stats.rmse < 0.01, "ATE {} m", error.stats.rmse);
}

/// The camera sees 60 frames of one end of the room, then at once a place seen at the start,
/// then one it has never seen.
#[test]
fn a_kidnapped_camera_is_found_where_the_map_knows_the_place() {
    let scene = room(400);
    let mut slam = slam(&scene, Par::Seq);
    let mut t = 0;
    let mut go = |slam: &mut Slam, range: &mut dyn Iterator<Item = usize>| -> Vec<FrameReport> {
        range
            .map(|i| {
                t += 1;
                process(slam, &scene, i, f64::from(t) / 30.0, false)
            })
            .collect()
    };
    let seen = go(&mut slam, &mut (0..60));
    assert!(
        seen.iter().all(|r| r.state == TrackingState::Tracking),
        "the map is built"
    );
    let away = go(&mut slam, &mut (330..335));
    assert!(
        away.iter().all(|r| r.state == TrackingState::Lost),
        "across the room nothing is known: {away:?}"
    );
    let back = go(&mut slam, &mut (21..36));
    let found = frames_until_found(&back);
    assert!(found < 10, "found after {found} frames");
    // The truth at the times given: that of the frames shown.
    let world_from_first = scene.trajectory()[0].world_from_camera;
    let pose = back[14].camera_from_world.expect("tracked");
    let truth = scene.trajectory()[35].world_from_camera;
    let error = pose * (world_from_first.inverse() * truth);
    assert!(
        error.translation.norm() < 0.02 && error.rotation.angle_rad() < 0.01,
        "found at the right place: {error:?}"
    );
}

/// From one frame to the next the camera is back at a place of the start, out of sight of the last frame: no frame
/// is lost.
#[test]
fn a_jump_to_a_known_place_costs_no_frame() {
    let scene = room(260);
    let mut slam = slam(&scene, Par::Seq);
    for i in 0..240 {
        let report = process(&mut slam, &scene, i, i as f64 / 30.0, false);
        assert_eq!(report.state, TrackingState::Tracking, "frame {i}");
    }
    let jump = process(&mut slam, &scene, 10, 8.0, false);
    assert_eq!(jump.state, TrackingState::Tracking);
    let world_from_first = scene.trajectory()[0].world_from_camera;
    let truth = world_from_first.inverse() * scene.trajectory()[10].world_from_camera;
    let error = jump.camera_from_world.expect("tracked") * truth;
    assert!(
        error.translation.norm() < 0.02 && error.rotation.angle_rad() < 0.01,
        "{error:?}"
    );
}

#[test]
fn any_number_of_threads_finds_the_same_bits() {
    let scene = room(30);
    let bits = |par: Par| -> Vec<u64> {
        let mut slam = slam(&scene, par);
        for i in 0..scene.len() {
            process(&mut slam, &scene, i, i as f64 / 30.0, (15..20).contains(&i));
        }
        let path = slam.trajectory();
        let places = path.iter().map(|p| p.world_from_camera.translation);
        places
            .flat_map(|t| [t.x.to_bits(), t.y.to_bits(), t.z.to_bits()])
            .collect()
    };
    let one = bits(Par::Seq);
    assert!(one.len() > 60, "found again: {} numbers", one.len());
    assert!(one == bits(Par::Threads(2)), "2 threads");
    assert!(one == bits(Par::Threads(3)), "3 threads");
}
