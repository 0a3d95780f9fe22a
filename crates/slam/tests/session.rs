//! A run put aside and taken up again has the bits of one that was never interrupted.
//!
//! One small scene with a person in it, with mapping and all labels on; the camera is in the dark for a
//! few frames, so that a session can be saved while it is lost.

mod common;

use std::ops::ControlFlow;
use std::sync::OnceLock;

use garad_core::{DepthImage, GaussianMap, Par, RgbImage, StampedPose};
use garad_eval::{AteOptions, ate};
use garad_slam::LabelledFrame;
use garad_slam::map::Map;
use garad_slam::mapping::job::MappingDone;
use garad_slam::session::SectionReader;
use garad_slam::{Config, FrameReport, SessionError, Slam, TrackingState};
use garad_synth::{Scene, SceneConfig, SceneName, SynthFrame};

use common::process;

const FRAMES: usize = 28;
const DARK: std::ops::Range<usize> = 19..22;

struct Recording {
    scene: Scene,
    frames: Vec<SynthFrame>,
}

fn recording() -> &'static Recording {
    static RECORDING: OnceLock<Recording> = OnceLock::new();
    RECORDING.get_or_init(|| {
        let scene = Scene::new(&SceneConfig {
            frames: FRAMES,
            width: 160,
            height: 120,
            noise: true,
            supersample: 1,
            ..SceneConfig::new(SceneName::Walking)
        })
        .expect("valid scene");
        let mut frames: Vec<_> = (0..FRAMES)
            .map(|i| scene.frame(i, Par::Threads(2)))
            .collect();
        for frame in &mut frames[DARK] {
            frame.rgb = RgbImage::new(160, 120, [0; 3]);
            frame.depth = DepthImage::new(160, 120, 0.0);
        }
        Recording { scene, frames }
    })
}

/// Keyframes are frequent, jobs wait behind each other, Gaussians are cloned and split, and colours gain
/// a degree, all within the few frames.
fn config() -> Config {
    let mut config = Config::default();
    config.features.count = 500;
    config.keyframes.max_gap = 4;
    config.schedule.handover_frames = 6;
    config.train.per_keyframe = 2;
    config.train.sh_every = 10;
    config.densify.every = 12;
    config.densify.grad_threshold = 1e-5;
    config.densify.split_extent = 0.03; // some are cloned, some split
    config.tracking.min_inliers_after_recovery = 30;
    config.train.final_iterations = 15;
    config
}

/// Everything a run says, and its whole state, before and after the final training.
#[derive(Debug, PartialEq)]
struct Outcome {
    reports: Vec<FrameReport>,
    labels: Vec<Option<LabelledFrame>>,
    path: Vec<StampedPose>,
    keyframes: Vec<StampedPose>,
    gaussians: GaussianMap,
    mapped: Vec<MappingDone>,
    states: [Vec<u8>; 2],
}

#[derive(Debug, Default)]
struct Outputs {
    reports: Vec<FrameReport>,
    labels: Vec<Option<LabelledFrame>>,
}

impl Outputs {
    fn go_on(&mut self, slam: &mut Slam, until: usize) {
        for frame in &recording().frames[self.reports.len()..until] {
            let report = process(slam, frame, None);
            self.reports.push(report);
            self.labels.push(slam.labelled_frame().cloned());
        }
    }

    fn end(mut self, mut slam: Slam) -> Outcome {
        self.go_on(&mut slam, FRAMES);
        let state = saved(&mut slam);
        slam.train_final(&mut |_| ControlFlow::Continue(()))
            .expect("trains");
        Outcome {
            reports: self.reports,
            labels: self.labels,
            path: slam.trajectory(),
            keyframes: slam.keyframe_trajectory(),
            gaussians: slam.gaussians().expect("at rest").clone(),
            mapped: slam.mapped().to_vec(),
            states: [state, saved(&mut slam)],
        }
    }
}

fn start(par: Par) -> Slam {
    Slam::new(recording().scene.camera(), config(), 5, par).expect("valid")
}

fn uninterrupted() -> &'static Outcome {
    static OUTCOME: OnceLock<Outcome> = OnceLock::new();
    OUTCOME.get_or_init(|| Outputs::default().end(start(Par::Seq)))
}

fn saved(slam: &mut Slam) -> Vec<u8> {
    let mut bytes = Vec::new();
    slam.save(&mut bytes).expect("saved");
    bytes
}

/// The state after so many frames.
fn session(frames: usize, par: Par) -> (Vec<u8>, Outputs, Slam) {
    let (mut slam, mut seen) = (start(par), Outputs::default());
    seen.go_on(&mut slam, frames);
    (saved(&mut slam), seen, slam)
}

fn load(bytes: &[u8], par: Par) -> Slam {
    Slam::load(&mut &bytes[..], par).expect("loaded")
}

#[test]
fn the_scene_has_what_the_tests_are_about() {
    let run = uninterrupted();
    let state = |i: usize| run.reports[i].state;
    assert_eq!(state(18), TrackingState::Tracking, "before the dark");
    assert_eq!(state(20), TrackingState::Lost, "in the dark");
    assert_eq!(state(FRAMES - 1), TrackingState::Tracking, "found again");
    let kept: Vec<_> = (0..FRAMES)
        .filter(|i| run.reports[*i].keyframe.is_some())
        .collect();
    assert!(
        kept.iter().any(|i| (11..17).contains(i)),
        "a job under way at 17: {kept:?}"
    );
    assert!(run.labels[16].is_some(), "labels are on");
    let inserted: usize = run.mapped.iter().map(|done| done.inserted).sum();
    assert!(
        run.gaussians.len() > inserted,
        "cloned or split: {} of {inserted} inserted",
        run.gaussians.len()
    );
    assert!(
        run.gaussians.sh_degree() > 0,
        "colours have gained a degree"
    );
}

#[test]
fn resumed_anywhere_the_run_ends_with_the_same_bits() {
    // Before the first frame, in the bootstrap, with jobs under way, lost, just found, at the end.
    for (frames, first, second) in [
        (0, Par::Seq, Par::Threads(2)),
        (5, Par::Threads(2), Par::Seq),
        (17, Par::Threads(2), Par::Threads(2)),
        (21, Par::Threads(2), Par::Seq),
        (24, Par::Seq, Par::Threads(2)),
        (FRAMES, Par::Seq, Par::Seq),
    ] {
        let (bytes, seen, _) = session(frames, first);
        let outcome = seen.end(load(&bytes, second));
        assert!(
            outcome == *uninterrupted(),
            "saved after {frames} frames, {first:?} to {second:?}"
        );
    }
}

#[test]
fn a_session_has_the_same_bits_for_any_number_of_threads_and_again_when_loaded() {
    let (one, ..) = session(17, Par::Seq);
    let (two, ..) = session(17, Par::Threads(2));
    assert!(one == two, "1 and 2 threads");
    assert!(
        saved(&mut load(&one, Par::Threads(2))) == one,
        "loaded and saved"
    );
}

#[test]
fn saving_does_not_change_the_run() {
    for par in [Par::Seq, Par::Threads(2)] {
        let (mut slam, mut seen) = (start(par), Outputs::default());
        for frames in [3, 17, 18, 21] {
            seen.go_on(&mut slam, frames);
            saved(&mut slam);
        }
        assert!(seen.end(slam) == *uninterrupted(), "{par:?}");
    }
}

#[test]
fn a_job_under_way_waits_for_its_frame() {
    let (bytes, seen, _) = session(17, Par::Threads(2));
    let slam = load(&bytes, Par::Threads(2));
    let due = seen.reports.iter().filter(|r| r.keyframe.is_some()).count() - slam.mapped().len();
    assert!(due > 0, "the session was saved with a job under way");
}

#[test]
fn damage_is_an_error_with_its_section() {
    let (bytes, ..) = session(5, Par::Seq);
    let error = |bytes: &[u8]| Slam::load(&mut &bytes[..], Par::Seq).expect_err("refused");
    assert!(
        matches!(error(b"ply\nformat ascii"), SessionError::Foreign),
        "a PLY file"
    );
    for share in 1..20 {
        let n = bytes.len() * share / 20;
        assert!(
            matches!(error(&bytes[..n]), SessionError::Truncated { .. }),
            "cut to {n} bytes"
        );
        let mut flipped = bytes.clone();
        flipped[n] ^= 16;
        let error = error(&flipped);
        assert!(
            matches!(error, SessionError::Damaged { .. }),
            "byte {n}: {error}"
        );
    }
}

/// What must stay as it is: landmarks and keyframes, and the Gaussians.
fn maps(slam: &mut Slam) -> [Vec<u8>; 2] {
    slam.finish().expect("alive");
    let gaussians = slam.gaussians().expect("at rest");
    [postcard(slam.map()), postcard(gaussians)]
}

fn postcard<T: serde::Serialize>(value: &T) -> Vec<u8> {
    postcard::to_stdvec(value).expect("a form")
}

#[test]
fn a_finished_map_is_tracked_in_and_stays_as_it_is() {
    let (_, _, mut slam) = session(FRAMES, Par::Seq);
    let before = maps(&mut slam);
    slam.localise_only().expect("alive");
    assert!(slam.trajectory().is_empty(), "a new path");
    let recording = recording();
    let mut tracked = 0;
    // Another time, the other way round, and a person who has gone on walking.
    for (i, frame) in recording.frames.iter().rev().enumerate() {
        let report = process(&mut slam, frame, None);
        assert_eq!(
            (report.id.index(), report.keyframe),
            (i, None),
            "counted anew, none kept"
        );
        tracked += usize::from(report.state == TrackingState::Tracking);
    }
    assert_eq!(
        slam.trajectory().len(),
        tracked,
        "a pose for each that was tracked"
    );
    let seen = FRAMES - DARK.len();
    assert!(
        tracked + 3 >= seen,
        "{tracked} of {seen} frames that show anything"
    );
    assert!(
        maps(&mut slam) == before,
        "not a bit of the map has changed"
    );
    let mut path = slam.trajectory();
    path.reverse();
    let error_m = |path: &[StampedPose]| {
        let error = ate(&recording.scene.trajectory(), path, &AteOptions::default());
        error.expect("judged").stats.rmse
    };
    let (again, first) = (error_m(&path), error_m(&uninterrupted().path));
    assert!(again < 2.0 * first, "ATE {again} m, when mapping {first} m"); // 0.0080, 0.0044
}

#[test]
fn a_place_outside_the_map_is_not_found() {
    let (_, _, mut slam) = session(5, Par::Seq);
    let before = maps(&mut slam);
    slam.localise_only().expect("alive");
    for frame in &recording().frames[DARK] {
        let report = process(&mut slam, frame, None);
        assert_eq!(report.state, TrackingState::Lost, "nothing to see");
    }
    assert!(
        maps(&mut slam) == before,
        "not a bit of the map has changed"
    );
}

#[test]
fn an_empty_map_keeps_the_camera_lost() {
    let mut slam = start(Par::Seq);
    slam.localise_only().expect("alive");
    let frame = &recording().frames[0];
    let report = process(&mut slam, frame, None);
    assert_eq!(report.state, TrackingState::Lost, "no place to find");
    assert!(slam.map().keyframes().is_empty(), "and none is made");
}

#[test]
fn sections_can_be_read_one_by_one() {
    let (bytes, _, slam) = session(5, Par::Seq);
    let mut reader = SectionReader::new(&bytes[..]).expect("begun");
    let camera: garad_core::Camera = reader.take("camera").expect("first");
    assert_eq!(camera, *slam.camera(), "the camera");
    let _: Config = reader.take("configuration").expect("second");
    let _: u64 = reader.take("rng_seed").expect("third");
    let map: Map = reader.take("map").expect("fourth");
    assert!(postcard(&map) == postcard(slam.map()), "the map");
}
