//! A run that begins while people walk, against scenes whose truth is exact.
//!
//! Pictures of 320 x 240 with the noise of a Kinect, and no map of Gaussians. Every bound stands next
//! to what was measured when it was set: 0.030 m with the restart and 0.282 m without, IoU 0.90.

mod common;

use std::sync::OnceLock;

use garad_core::{DepthImage, FrameId, Par, Se3, StampedPose};
use garad_eval::Confusion;
use garad_slam::{Config, FrameInput, ReplayedFrame, Silent, Slam};
use garad_synth::{Scene, SceneConfig, SceneName, SynthFrame};

use common::process;

/// Two more than the bootstrap.
const FRAMES: usize = 12;

struct Recording {
    scene: Scene,
    frames: Vec<SynthFrame>,
}

fn recording(name: SceneName) -> Recording {
    let config = SceneConfig {
        frames: 30,
        width: 320,
        height: 240,
        noise: true,
        supersample: 1,
        ..SceneConfig::new(name)
    };
    let scene = Scene::new(&config).expect("valid scene");
    let frame = |i| scene.frame(i, Par::Threads(2));
    let frames = (0..FRAMES).map(frame).collect();
    Recording { scene, frames }
}

/// Two people go beside the camera, as fast as it does.
fn in_step() -> &'static Recording {
    static IN_STEP: OnceLock<Recording> = OnceLock::new();
    IN_STEP.get_or_init(|| recording(SceneName::InStep))
}

fn config() -> Config {
    let mut config = Config::default();
    config.insertion.enabled = false;
    config
}

fn begin(recording: &Recording, config: Config, par: Par) -> Slam {
    Slam::new(recording.scene.camera(), config, 0, par).expect("valid")
}

/// Processes these frames, and returns the first ones if they were replayed.
fn go_on(slam: &mut Slam, frames: &[SynthFrame]) -> Vec<ReplayedFrame> {
    let mut again = Vec::new();
    for frame in frames {
        process(slam, frame, None);
        again.extend(slam.take_replayed());
    }
    again
}

/// Farthest that a camera of the first frames is from where it was, metres, the first being right.
fn farthest_m(recording: &Recording, path: &[StampedPose]) -> f64 {
    let truth = recording.scene.trajectory();
    let first = path[0].world_from_camera * truth[0].world_from_camera.inverse();
    let off = |(found, truth): (&StampedPose, &StampedPose)| {
        let expected: Se3 = first * truth.world_from_camera;
        (found.world_from_camera.translation - expected.translation).norm()
    };
    path.iter().zip(&truth).map(off).fold(0.0, f64::max)
}

#[test]
fn people_in_the_first_frames_are_found_and_distort_no_pose() {
    let recording = in_step();
    let mut blind = config();
    blind.labels.bootstrap_restart = false;
    let mut slam = begin(recording, blind, Par::Seq);
    assert!(!slam.may_restart(), "switched off");
    assert_eq!(
        go_on(&mut slam, &recording.frames).len(),
        0,
        "nothing again"
    );
    let before_m = farthest_m(recording, &slam.trajectory());

    slam = begin(recording, config(), Par::Seq);
    assert!(slam.may_restart(), "not known yet");
    let again = go_on(&mut slam, &recording.frames);
    assert!(!slam.may_restart(), "only once");
    let after_m = farthest_m(recording, &slam.trajectory());
    assert_eq!(slam.trajectory().len(), FRAMES, "every frame has its place");
    assert!(
        after_m < 0.045 && before_m > 0.15,
        "{after_m:.4} m, and {before_m:.4} m at first sight"
    );

    let ids: Vec<u32> = again.iter().map(|s| s.report.id.0).collect();
    assert_eq!(
        ids,
        (0..9).collect::<Vec<_>>(),
        "all but the last, which is answered"
    );
    let mut all = Confusion::default();
    for (sight, frame) in again.iter().zip(&recording.frames) {
        let labels = sight
            .labels
            .as_ref()
            .expect("labelled from the first frame on");
        assert_eq!(labels.frame, sight.report.id, "its own labels");
        let mask = labels.mask(frame.rgb.size());
        all += Confusion::of_masks(&mask, &frame.mask).expect("same size");
    }
    assert!(all.iou().expect("people") > 0.85, "IoU {:?}", all.iou());
}

#[test]
fn a_static_scene_is_not_restarted() {
    let recording = recording(SceneName::QuietDesk);
    let mut blind = config();
    blind.labels.bootstrap_restart = false;
    let mut once = begin(&recording, blind, Par::Seq);
    go_on(&mut once, &recording.frames);
    let mut slam = begin(&recording, config(), Par::Seq);
    assert_eq!(go_on(&mut slam, &recording.frames).len(), 0, "no need");
    assert_eq!(slam.trajectory(), once.trajectory(), "the same bits");
}

#[test]
fn same_bits_for_two_threads_and_after_a_resume() {
    let recording = in_step();
    let mut slam = begin(recording, config(), Par::Seq);
    go_on(&mut slam, &recording.frames);
    let expected = slam.trajectory();

    slam = begin(recording, config(), Par::Threads(2));
    go_on(&mut slam, &recording.frames[..6]);
    let mut session = Vec::new();
    slam.save(&mut session).expect("saved");
    let mut resumed = Slam::load(&mut session.as_slice(), Par::Threads(3)).expect("loaded");
    for (what, slam) in [("went on", &mut slam), ("resumed", &mut resumed)] {
        assert!(slam.may_restart(), "{what}: the first frames are kept");
        let again = go_on(slam, &recording.frames[6..]);
        assert_eq!(again.len(), 9, "{what}: began again");
        assert_eq!(slam.trajectory(), expected, "{what}");
    }
}

/// Frames without depth come before the first that is a world, and one that cannot be read between.
#[test]
fn frames_keep_their_numbers() {
    let recording = in_step();
    let mut slam = begin(recording, config(), Par::Seq);
    let mut dark = recording.frames[0].clone();
    dark.depth = DepthImage::new(320, 240, 0.0);
    go_on(&mut slam, &[dark]);
    go_on(&mut slam, &recording.frames[..4]);
    let wrong = DepthImage::new(16, 16, 1.0);
    let input = FrameInput {
        t_s: recording.frames[4].t_s,
        depth_t_s: recording.frames[4].t_s,
        rgb: &recording.frames[4].rgb,
        depth: &wrong,
        mask: None,
    };
    slam.process(&input, &mut Silent)
        .expect_err("the wrong size");
    let again = go_on(&mut slam, &recording.frames[5..]);
    let ids: Vec<FrameId> = again.iter().map(|s| s.report.id).collect();
    let expected = [1, 2, 3, 4, 6, 7, 8, 9, 10].map(FrameId);
    assert_eq!(
        ids, expected,
        "from the first with depth, without the one not read"
    );
}
