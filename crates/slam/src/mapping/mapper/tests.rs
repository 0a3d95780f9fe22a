//! The mapper by hand: a few Gaussians, a few jobs.

use std::ops::ControlFlow;

use std::collections::BTreeSet;

use Label::{Dynamic, Static};
use garad_core::{Camera, DepthImage, FrameId, KeyframeId, MaskImage, Par, RgbImage};
use garad_crf::Cues;
use nalgebra::Vector2;

use super::*;
use crate::config::{Config, LabelSource};
use crate::dynamics::landmarks::LandmarkCues;
use crate::mapping::job::NewLandmark;
use crate::mask::MOVING;
use crate::observer::Silent;

/// The second of two keyframes in front of a wall, all of which moves, and the map after it.
fn second_of_two(config: &Config) -> (MappingDone, GaussianMap) {
    let camera = Camera::pinhole((32, 24), [30.0, 30.0, 15.5, 11.5]).expect("valid");
    let context = Context::new(camera, config.clone(), 0, Par::Seq).expect("valid");
    let mut mapper = Mapper::new(&context).expect("valid");
    let job = |k: u32| MappingJob {
        keyframe: KeyframeId(k),
        frame: FrameId(10 * k),
        rgb: RgbImage::from_fn(32, 24, |x, _| [if x % 2 == 0 { 200 } else { 20 }; 3]),
        depth: DepthImage::new(32, 24, 2.0),
        mask: Some(MaskImage::new(32, 24, MOVING)),
        cells: Some(MaskImage::new(8, 6, MOVING)),
        labels: Vec::new(),
        cues: Vec::new(),
        restored: BTreeSet::new(),
        moved: Vec::new(),
        poses: vec![Se3::identity(); k as usize + 1],
        new_landmarks: Vec::new(),
        living: Vec::new(),
        iterations: 2,
    };
    mapper.run(job(0), &mut Silent);
    let done = mapper.run(job(1), &mut Silent);
    (done, mapper.gaussians)
}

/// The settings behind "without map labels": each turns off one use of labels in the map.
#[test]
fn the_map_can_be_made_without_labels() {
    let mut config = Config::default();
    let (_, map) = second_of_two(&config);
    assert_eq!(map.len(), 0, "nothing is at rest");

    config.insertion.avoid_moving = false;
    config.train.lambda_dynamic = 0.0;
    let (masked, _) = second_of_two(&config);
    assert!(masked.gaussians >= 48, "8 x 6 samples: {masked:?}");
    assert!(masked.dynamic >= 48, "of the mask: {masked:?}");
    assert!(masked.loss.is_none_or(|l| l <= 0.0), "no pixel: {masked:?}");

    config.train.exclude_moving = false;
    let (whole, _) = second_of_two(&config);
    assert!(whole.loss.is_some_and(|l| l > 0.01), "stripes: {whole:?}");

    config.labels.map = false;
    let (unlabelled, _) = second_of_two(&config);
    assert_eq!(unlabelled.dynamic, 0, "{unlabelled:?}");
}

/// The paper's loop, without training and without a vote.
fn by_gaussians() -> Config {
    let mut config = Config::default();
    config.labels.source = LabelSource::Gaussians;
    config.labels.spread.enabled = false;
    config.labels.window.runs = 2;
    config.insertion.avoid_moving = false;
    config
}

fn mapper(config: Config) -> Mapper {
    let camera = Camera::pinhole((32, 24), [30.0, 30.0, 15.5, 11.5]).expect("valid");
    let context = Context::new(camera, config, 0, Par::Seq).expect("valid");
    Mapper::new(&context).expect("valid")
}

/// A keyframe without depth, so that only landmarks make Gaussians; these landmarks live.
fn without_depth(k: u32, living: &[u32]) -> MappingJob {
    MappingJob {
        keyframe: KeyframeId(k),
        frame: FrameId(10 * k),
        rgb: RgbImage::new(32, 24, [90, 120, 30]),
        depth: DepthImage::new(32, 24, 0.0),
        mask: None,
        cells: None,
        labels: Vec::new(),
        cues: Vec::new(),
        restored: BTreeSet::new(),
        moved: Vec::new(),
        poses: vec![Se3::identity(); k as usize + 1],
        new_landmarks: Vec::new(),
        living: living.iter().map(|id| (LandmarkId(*id), Static)).collect(),
        iterations: 0,
    }
}

/// A landmark at 2 m, so many centimetres right of the optical axis.
fn landmark(id: u32, right_cm: u32) -> NewLandmark {
    let x_m = 0.01 * f64::from(right_cm);
    NewLandmark {
        id: LandmarkId(id),
        p_world: Vector3::new(x_m, 0.0, 2.0),
        px: [16, 12],
    }
}

/// So many standard deviations in front of what was seen there.
fn cues(id: u32, depth_residual: f64) -> LandmarkCues {
    LandmarkCues {
        id: LandmarkId(id),
        uv_px: Vector2::new(16.0, 12.0),
        cues: Cues {
            depth_residual: Some(depth_residual),
            ..Cues::default()
        },
    }
}

fn given(id: u32, label: Label, removed: bool) -> TaggedLabel {
    let id = LandmarkId(id);
    TaggedLabel { id, label, removed }
}

/// Two landmarks 0.6 m apart, of which 0 moves.
fn first_of_two_landmarks() -> MappingJob {
    MappingJob {
        new_landmarks: vec![landmark(0, 0), landmark(1, 60)],
        cues: vec![cues(0, 50.0), cues(1, 0.0)],
        ..without_depth(0, &[0, 1])
    }
}

fn labels(mapper: &Mapper) -> Vec<(Option<u32>, Label)> {
    let map = &mapper.gaussians;
    let tags = map.landmark.iter().map(|l| l.map(|l| l.0));
    tags.zip(map.label.iter().copied()).collect()
}

/// A map as it is handed back: the tags and labels of the dynamic Gaussians.
fn handed_back(done: &MappingDone) -> Vec<(Option<u32>, Label)> {
    let map = done.feedback.dynamic.as_ref().expect("handed back");
    let tags = map.landmark.iter().map(|l| l.map(|l| l.0));
    tags.zip(map.label.iter().copied()).collect()
}

#[test]
fn a_tagged_gaussian_with_dynamic_cues_is_dynamic_and_handed_back() {
    let mut mapper = mapper(by_gaussians());
    let done = mapper.run(first_of_two_landmarks(), &mut Silent);
    assert_eq!(labels(&mapper), [(Some(0), Dynamic), (Some(1), Static)]);
    let expected = [given(0, Dynamic, false), given(1, Static, false)];
    assert_eq!(done.feedback.labels, expected, "of both landmarks");
    assert_eq!(handed_back(&done), [(Some(0), Dynamic)], "for the mask");
    assert_eq!((done.relabelled.to_dynamic, done.dynamic), (1, 1));
    assert_eq!((done.inserted, done.relabelled.removed), (2, 0));
}

#[test]
fn what_was_dynamic_in_every_run_of_the_window_is_removed() {
    let mut mapper = mapper(by_gaussians());
    mapper.run(first_of_two_landmarks(), &mut Silent);
    let again = MappingJob {
        cues: vec![cues(0, 50.0), cues(1, 0.0)],
        ..without_depth(1, &[0, 1])
    };
    let done = mapper.run(again, &mut Silent);
    assert_eq!(labels(&mapper), [(Some(1), Static)], "0 is gone");
    let expected = [given(0, Dynamic, true), given(1, Static, false)];
    assert_eq!(done.feedback.labels, expected, "and its landmark is told");
    assert_eq!(handed_back(&done), [], "no more in the mask");
    assert_eq!((done.relabelled.removed, done.inserted), (1, 0));
}

#[test]
fn a_restored_gaussian_is_static_again_and_its_window_begins_anew() {
    let mut mapper = mapper(by_gaussians());
    mapper.run(first_of_two_landmarks(), &mut Silent);
    let restored = MappingJob {
        restored: BTreeSet::from([LandmarkId(0)]),
        ..without_depth(1, &[0, 1])
    };
    let done = mapper.run(restored, &mut Silent);
    assert_eq!(labels(&mapper), [(Some(0), Static), (Some(1), Static)]);
    assert_eq!(done.feedback.labels, [given(0, Static, false)], "told");
    assert_eq!(handed_back(&done), [], "no more in the mask");

    // Dynamic in this run and in the first, but restored between them.
    let again = MappingJob {
        cues: vec![cues(0, 50.0)],
        ..without_depth(2, &[0, 1])
    };
    let done = mapper.run(again, &mut Silent);
    assert_eq!(done.feedback.labels, [given(0, Dynamic, false)], "kept");
    assert_eq!(done.relabelled.removed, 0, "{:?}", done.relabelled);
}

/// A third Gaussian loses its landmark: the nearest nodes decide, 0 at 0.1 m and 1 at 0.5 m.
#[test]
fn gaussians_without_a_landmark_follow_the_vote_of_their_neighbours() {
    for (spread, expected) in [(true, Dynamic), (false, Static)] {
        let mut config = by_gaussians();
        config.labels.spread.enabled = spread;
        let mut mapper = mapper(config);
        let mut job = first_of_two_landmarks();
        job.new_landmarks.push(landmark(2, 10));
        mapper.run(
            MappingJob {
                living: vec![0, 1, 2]
                    .into_iter()
                    .map(|id| (LandmarkId(id), Static))
                    .collect(),
                cues: Vec::new(),
                ..job
            },
            &mut Silent,
        );
        let next = MappingJob {
            cues: vec![cues(0, 50.0), cues(1, 0.0)],
            ..without_depth(1, &[0, 1])
        };
        mapper.run(next, &mut Silent);
        let expected = [(Some(0), Dynamic), (Some(1), Static), (None, expected)];
        assert_eq!(labels(&mapper), expected, "spread: {spread}");
    }
}

/// The right half of a wall moves in the keyframe's mask, and there is no landmark.
#[test]
fn gaussians_inserted_inside_the_mask_are_dynamic_where_the_mask_decides() {
    for (spread, from_mask) in [(true, true), (true, false), (false, true)] {
        let mut config = by_gaussians();
        (config.labels.spread.enabled, config.labels.spread.from_mask) = (spread, from_mask);
        let mut mapper = mapper(config);
        let right = |x, _| if x < 16 { 0 } else { MOVING };
        let job = MappingJob {
            depth: DepthImage::new(32, 24, 2.0),
            mask: Some(MaskImage::from_fn(32, 24, right)),
            ..without_depth(0, &[])
        };
        let done = mapper.run(job, &mut Silent);
        assert_eq!(done.inserted, 48, "8 x 6 samples");
        let is_right = |mean: &[f32; 3]| mean[0] > 0.0;
        let decides = spread && from_mask;
        for (mean, label) in mapper.gaussians.means.iter().zip(&mapper.gaussians.label) {
            let expected = match decides && is_right(mean) {
                true => Dynamic,
                false => Static,
            };
            assert_eq!(*label, expected, "{mean:?}, {spread}, {from_mask}");
        }
        assert_eq!(done.dynamic, if decides { 24 } else { 0 }, "4 x 6 of them");
        assert_eq!(handed_back(&done).len(), done.dynamic, "for the mask");
    }
}

/// The same field, mask and feedback as with labels of the map; the map itself has none, and loses no Gaussian.
#[test]
fn with_labels_of_the_map_off_the_field_labels_for_the_mask_alone() {
    let [mut with, mut without] = [true, false].map(|map| {
        let mut config = by_gaussians();
        config.labels.map = map;
        config.labels.spread.enabled = true;
        config.labels.spread.from_mask = true;
        mapper(config)
    });
    let right = |x, _| if x < 16 { 0 } else { MOVING };
    let first = MappingJob {
        depth: DepthImage::new(32, 24, 2.0),
        mask: Some(MaskImage::from_fn(32, 24, right)),
        ..first_of_two_landmarks()
    };
    let [a, b] = [&mut with, &mut without].map(|m| m.run(first.clone(), &mut Silent));
    assert_eq!(a.feedback, b.feedback, "labels of landmarks, and the mask");
    assert!(a.dynamic > 20, "of the mask: {a:?}");
    assert_eq!((b.dynamic, b.inserted), (0, a.inserted), "the map's own");
    assert_eq!(a.relabelled, b.relabelled, "{a:?}");
    let rows = without.gaussians.len();
    assert_eq!(without.gaussians.label, vec![Static; rows], "all");

    // 0 and its like have been dynamic for a whole window.
    let again = MappingJob {
        cues: vec![cues(0, 50.0), cues(1, 0.0)],
        ..without_depth(1, &[0, 1])
    };
    let [a, b] = [&mut with, &mut without].map(|m| m.run(again.clone(), &mut Silent));
    let expected = [given(0, Dynamic, true), given(1, Static, false)];
    assert_eq!(b.feedback.labels, expected, "0 is told to go");
    assert_eq!(handed_back(&a), handed_back(&b), "no more in the mask");
    assert!(a.relabelled.removed > 0, "{a:?}");
    assert_eq!((b.relabelled.removed, b.inserted), (0, 0), "{b:?}");
    assert_eq!(without.gaussians.len(), rows, "still in the map");
    assert_eq!(without.gaussians.label, vec![Static; rows], "all");
    let tags = labels(&without).into_iter().filter_map(|(tag, _)| tag);
    assert_eq!(tags.collect::<Vec<_>>(), [1], "0 is no node any more");
}

/// A wall at 2 m, seen at the keyframes 0 and 1, without labels; 8 x 6 samples.
fn of_a_wall(k: u32, iterations: usize) -> MappingJob {
    MappingJob {
        rgb: RgbImage::from_fn(32, 24, |x, _| [if x % 2 == 0 { 200 } else { 20 }; 3]),
        depth: DepthImage::new(32, 24, 2.0),
        iterations,
        ..without_depth(k, &[])
    }
}

/// Everything is cloned whenever density control comes.
fn all_are_cloned() -> Config {
    let mut config = Config::default();
    config.densify.every = 1;
    config.densify.grad_threshold = 1e-30;
    config.densify.split_extent = 1.0;
    config.densify.min_opacity = 1e-3;
    config.densify.young_keyframes = 0;
    config
}

#[test]
fn density_control_is_for_young_gaussians_beside_tracking() {
    for (enabled, expected) in [(true, [48 * 4, 48 * 4]), (false, [48, 48])] {
        let mut config = all_are_cloned();
        config.densify.enabled = enabled;
        let mut mapper = mapper(config);
        let first = mapper.run(of_a_wall(0, 2), &mut Silent);
        assert_eq!(
            (first.gaussians, first.inserted),
            (expected[0], 48),
            "two iterations"
        );
        let second = mapper.run(of_a_wall(1, 3), &mut Silent);
        assert_eq!(
            (second.gaussians, second.inserted),
            (expected[1], 0),
            "none is young"
        );
    }
}

#[test]
fn density_control_of_the_final_training_is_for_all_and_ends_half_way() {
    for (iterations, expected) in [
        (5, &[true, true, true, false, false][..]),
        (4, &[true, true, false, false]),
        (1, &[true]),
    ] {
        let mut mapper = mapper(all_are_cloned());
        mapper.run(of_a_wall(0, 0), &mut Silent);
        mapper.run(of_a_wall(1, 0), &mut Silent);
        let mut counts = vec![48];
        let poses = vec![Se3::identity(); 2];
        let done = mapper.train_final(iterations, poses, &mut |step| {
            counts.push(step.gaussians);
            ControlFlow::Continue(())
        });
        done.expect("trained");
        let grows: Vec<_> = counts.windows(2).map(|pair| pair[1] > pair[0]).collect();
        assert_eq!(grows, expected, "in the first half: {counts:?}");
    }
    // New ones have an opacity of 0.9.
    for (min_opacity, left) in [(0.95, 0), (0.85, 48)] {
        let mut config = all_are_cloned();
        config.densify.enabled = false;
        config.densify.min_opacity = min_opacity;
        let mut mapper = mapper(config);
        mapper.run(of_a_wall(0, 0), &mut Silent);
        let done = mapper.train_final(0, vec![Se3::identity()], &mut |_| ControlFlow::Continue(()));
        done.expect("nothing to train");
        assert_eq!(mapper.gaussians.len(), left, "pruned below {min_opacity}");
    }
}

/// Counts the iterations.
#[derive(Default)]
struct Iterations(usize);

impl Observer for Iterations {
    fn begin(&mut self, stage: Stage) {
        self.0 += usize::from(stage == Stage::Train);
    }

    fn end(&mut self, _: Stage) {}
}

#[test]
fn a_job_has_its_number_of_iterations_and_one_view() {
    for (iterations, has_loss) in [(0, false), (1, true), (5, true)] {
        let mut mapper = mapper(Config::default());
        let mut counted = Iterations::default();
        let done = mapper.run(of_a_wall(0, iterations), &mut counted);
        assert_eq!(counted.0, iterations, "as asked for");
        assert_eq!((done.loss.is_some(), done.error), (has_loss, None));
        assert_eq!(mapper.trainer.views(), 1, "of the keyframe");
    }
    let mut config = Config::default();
    config.train.max_views = 2;
    let mut thinned = mapper(config.clone());
    (0..4).for_each(|k| drop(thinned.run(of_a_wall(k, 0), &mut Silent)));
    assert_eq!(thinned.trainer.views(), 2, "at most two");
    (config.train.per_keyframe, config.train.per_frame) = (0, 0);
    let mut untrained = mapper(config);
    untrained.run(of_a_wall(0, 0), &mut Silent);
    assert_eq!(untrained.trainer.views(), 0, "nothing to train");
}

/// Somebody at the first keyframe, who has left at the second: at columns 8 to 23, half way to the wall. The mask has
/// one pixel.
#[test]
fn a_view_excludes_the_mask_and_what_is_later_free() {
    let [own, freed] = [(28, 2), (15, 12)];
    for (what, expected) in [
        ("default", [true, true, true]),
        ("exclude_moving", [false, false, true]),
        ("mask_freed_space", [true, false, true]),
        ("mask is given", [true, false, true]),
        ("later without cells", [true, false, true]),
        ("lambda_depth", [true, true, false]),
    ] {
        let mut config = Config::default();
        config.labels.dilate_px = 0;
        config.train.exclude_moving = what != "exclude_moving";
        config.labels.mask_freed_space = what != "mask_freed_space";
        config.train.lambda_depth = if what == "lambda_depth" { 0.0 } else { 0.1 };
        let mut mapper = mapper(config);
        let cells = |job: MappingJob, there: bool| MappingJob {
            cells: there.then(|| MaskImage::new(8, 6, 0)),
            ..job
        };
        let mask = MaskImage::from_fn(32, 24, |x, y| if (x, y) == own { MOVING } else { 0 });
        let first = MappingJob {
            depth: DepthImage::from_fn(32, 24, |x, _| if (8..24).contains(&x) { 1.0 } else { 2.0 }),
            mask: Some(mask),
            ..of_a_wall(0, 0)
        };
        mapper.run(cells(first, what != "mask is given"), &mut Silent);
        mapper.run(
            cells(of_a_wall(1, 0), what != "later without cells"),
            &mut Silent,
        );
        let camera = mapper.context.camera;
        let straight = garad_core::undistort::Undistortion::new(&camera);
        let target = mapper
            .trainer
            .view(0)
            .target(&camera, &straight, 0, Par::Seq);
        let excluded = [own, freed].map(|at| target.excluded[at] == MOVING);
        assert_eq!(
            [excluded[0], excluded[1], target.depth.is_some()],
            expected,
            "{what}"
        );
    }
}

/// Without a mask in cells a keyframe speaks of landmarks, and only where these decide.
#[test]
fn a_keyframe_without_cells_labels_by_landmarks_alone() {
    use crate::dynamics::landmarks::LandmarkLabel;
    for (tagged, cells, expected) in [
        (TaggedLabels::Landmark, false, 1),
        (TaggedLabels::Evidence, false, 0),
        (TaggedLabels::Evidence, true, 1),
    ] {
        let mut config = Config::default();
        config.labels.tagged = tagged;
        let mut mapper = mapper(config);
        let first = MappingJob {
            new_landmarks: vec![landmark(0, 0)],
            ..without_depth(0, &[0])
        };
        mapper.run(first, &mut Silent);
        let id = LandmarkId(0);
        let label = LandmarkLabel {
            id,
            label: Dynamic,
            changed: true,
        };
        let second = MappingJob {
            labels: vec![label],
            living: vec![(id, Dynamic)],
            cells: cells.then(|| MaskImage::new(8, 6, 0)),
            ..without_depth(1, &[])
        };
        let done = mapper.run(second, &mut Silent);
        let counts = (
            done.relabelled.to_dynamic,
            done.dynamic,
            done.relabelled.to_static,
        );
        assert_eq!(counts, (expected, expected, 0), "{tagged:?}, {cells}");
    }
}

/// What tracking is given beside labels.
#[test]
fn the_map_is_handed_back_as_tracking_asks_for_it() {
    for (points, method, source) in [
        (
            PointSource::Landmarks,
            TrackingMethod::Features,
            LabelSource::Frames,
        ),
        (
            PointSource::Gaussians,
            TrackingMethod::Features,
            LabelSource::Gaussians,
        ),
        (
            PointSource::Landmarks,
            TrackingMethod::Render,
            LabelSource::Frames,
        ),
    ] {
        let mut config = Config::default();
        config.labels.source = source;
        (config.tracking.points, config.tracking.method) = (points, method);
        let mut mapper = mapper(config);
        let job = MappingJob {
            new_landmarks: vec![landmark(4, 0), landmark(7, 60)],
            ..without_depth(0, &[4, 7])
        };
        let feedback = mapper.run(job, &mut Silent).feedback;
        let positions: Vec<_> = feedback
            .positions
            .iter()
            .map(|(id, p)| (id.0, p.x > 0.5))
            .collect();
        match points {
            PointSource::Gaussians => assert_eq!(positions, [(4, false), (7, true)]),
            _ => assert_eq!(positions, []),
        }
        let renders = method == TrackingMethod::Render;
        assert_eq!(
            feedback.map.is_some_and(|map| map.len() == 2),
            renders,
            "{method:?}"
        );
        assert_eq!(
            feedback.dynamic.is_some(),
            source.has_gaussians(),
            "{source:?}"
        );
    }
}
