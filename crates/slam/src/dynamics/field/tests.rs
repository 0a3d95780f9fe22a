//! The field over frames before a wall at 3 m, with or without a box at half the way to it.

use std::sync::Arc;

use garad_core::{DepthImage, GrayImage, MaskImage, Se3};
use garad_features::LkPyramid;

use super::*;
use crate::mask::{MOVING, full_size};
use crate::testing::{World, is_in, places, texture, wall, wall_behind};

/// Keyframes 0, 20 and 40, all of this.
fn world_that_saw(depth: &DepthImage, config: Config) -> World {
    let mut world = World::new(config);
    for id in [0, 20, 40] {
        let seen = world.frame(id, depth);
        world.keep(seen, depth);
    }
    world
}

fn moving_share(cells: &MaskImage) -> f64 {
    let moving = cells.data().iter().filter(|c| **c == MOVING).count();
    moving as f64 / cells.data().len() as f64
}

#[test]
fn a_new_box_is_dynamic_to_the_cell() {
    let world = world_that_saw(&wall(), Config::default());
    let box_px = [[48, 112], [32, 96]];
    let depth = wall_behind(box_px);
    let mut now = world.frame(60, &depth);
    let cells = world.label(&mut now, &depth, None).expect("labelled");
    let expected = MaskImage::from_fn(40, 30, |x, y| {
        if is_in(box_px, 4 * x, 4 * y) {
            MOVING
        } else {
            0
        }
    });
    assert_eq!(cells, expected, "the box and nothing else");
    let near = [[44, 116], [28, 100]];
    for (i, [x, y]) in places().into_iter().enumerate() {
        let label = match is_in(box_px, x, y) {
            true => Label::Dynamic,
            false => Label::Static,
        };
        assert_eq!(now.label[i], label, "({x}, {y})");
        let in_use = !is_in(near, x, y);
        assert_eq!(now.in_use[i], in_use, "({x}, {y}), 4 px around the box");
    }
    let full = full_size(&cells, (160, 120));
    let same = |x, y| (full[(x, y)] == MOVING) == is_in(box_px, x, y);
    assert!(places().iter().all(|&[x, y]| same(x, y)), "full size");
}

/// A box that has come before the wall is dynamic as long as it moves over its last ten frames, and
/// static once it has been at rest for as long.
#[test]
fn what_has_come_to_rest_is_static_again() {
    for (moved_px, share) in [(3, 0.2), (0, 0.0)] {
        let mut world = world_that_saw(&wall(), Config::default());
        let box_px = [[48, 112], [32, 96]];
        let depth = wall_behind(box_px);
        let image = |by_px: usize| {
            let texture = texture();
            let image = GrayImage::from_fn(160, 120, |x, y| match is_in(box_px, x, y) {
                true => texture[(x + by_px, y)],
                false => texture[(x, y)],
            });
            LkPyramid::new(&image, 3).expect("an image")
        };
        let arrived = world.frame(60, &depth);
        world.keep(arrived, &depth);
        let view = world.dynamics.past.back_mut().expect("just added");
        view.image = Some(Arc::new(image(0)));
        let mut now = world.frame(70, &depth);
        let cells = world.label(&mut now, &depth, Some(&image(moved_px)));
        let moving = moving_share(&cells.expect("labelled"));
        assert!((moving - share).abs() < 0.02, "{moved_px} px: {moving}");
    }
}

/// What an object uncovers as it leaves was occluded until now: there is no evidence against it.
#[test]
fn uncovered_background_is_static() {
    let world = world_that_saw(&wall_behind([[48, 112], [32, 96]]), Config::default());
    let mut now = world.frame(60, &wall());
    let cells = world.label(&mut now, &wall(), None).expect("labelled");
    assert!(moving_share(&cells) <= 0.0, "an empty wall");
    assert!(now.in_use.iter().all(|u| *u), "all of it in use");
}

#[test]
fn no_labels_before_the_bootstrap_is_over_or_without_history() {
    let mut world = World::new(Config::default());
    let mut early = world.frame(9, &wall());
    assert!(world.label(&mut early, &wall(), None).is_none(), "frame 9");
    let mut alone = world.frame(10, &wall());
    assert!(
        world.label(&mut alone, &wall(), None).is_none(),
        "no history"
    );
    world.keep(early.clone(), &wall());
    assert!(world.label(&mut early, &wall(), None).is_none(), "frame 9");
    assert!(world.label(&mut alone, &wall(), None).is_some(), "frame 10");
}

#[test]
fn a_keyframe_is_part_of_the_history_for_memory_frames() {
    let mut config = Config::default();
    config.labels.memory_frames = 90;
    let world = world_that_saw(&wall(), config);
    let depth = wall_behind([[48, 112], [32, 96]]);
    for (id, found) in [(130, true), (131, false)] {
        let mut now = world.frame(id, &depth);
        let cells = world.label(&mut now, &depth, None).expect("labelled");
        assert_eq!(moving_share(&cells) > 0.0, found, "frame {id}: 40 + 90");
    }
}

/// Of the ten columns of samples, nine may be suspects (`max_moving` = 0.9), not ten.
#[test]
fn nearly_everything_moving_is_a_wrong_pose() {
    let mut config = Config::default();
    let mut world = world_that_saw(&wall(), config.clone());
    let mut nine = wall_behind([[0, 144], [0, 120]]);
    let mut now = world.frame(60, &nine);
    let labelled = world.label(&mut now, &nine, None);
    assert!(
        moving_share(&labelled.expect("nine of ten")) > 0.85,
        "nearly all"
    );

    nine = wall_behind([[0, 160], [0, 120]]);
    now = world.frame(60, &nine);
    assert!(world.label(&mut now, &nine, None).is_none(), "ten of ten");
    assert!(now.label.iter().all(|l| *l == Label::Static), "no label");
    assert!(now.in_use.iter().all(|u| *u), "none put aside");

    // The same wall, but the pose is a metre off: everything floats in front of it.
    let step = Se3::exp(&[0.0, 0.0, 1.0, 0.0, 0.0, 0.0].into());
    let mut lost = world.frame(60, &wall());
    lost.camera_from_world = step;
    assert!(
        world.label(&mut lost, &wall(), None).is_none(),
        "a metre off"
    );
    lost.camera_from_world = Se3::identity();
    let right = world.label(&mut lost, &wall(), None).expect("right pose");
    assert!(moving_share(&right) <= 0.0, "the wall");

    config.labels.max_moving = 1.0;
    world = world_that_saw(&wall(), config);
    lost.camera_from_world = step;
    let cells = world.label(&mut lost, &wall(), None).expect("no guard");
    // The part within the old image: (2/3)² of it.
    assert!(moving_share(&cells) > 0.4, "{}", moving_share(&cells));
}

/// Three of 20 columns are suspects by their depth, from four to six others because their patches went 6 px: of all
/// together `max_moving` is asked again.
#[test]
fn patch_motion_may_show_that_the_pose_is_wrong() {
    let image = |by_px: usize| {
        let texture = texture();
        let image = GrayImage::from_fn(160, 120, |x, y| match (40..88).contains(&x) {
            true => texture[(x + by_px, y)],
            false => texture[(x, y)],
        });
        LkPyramid::new(&image, 3).expect("an image")
    };
    let depth = wall_behind([[136, 160], [0, 120]]);
    for (max_moving, patch_motion, labelled) in [
        (0.25, true, false),
        (0.25, false, true),
        (0.5, true, true),
        (0.125, false, false),
    ] {
        let mut config = Config::default();
        config.labels.max_moving = max_moving;
        config.labels.patch_motion.enabled = patch_motion;
        let mut world = world_that_saw(&wall(), config);
        let seen = world.frame(60, &wall());
        world.keep(seen, &wall());
        let view = world.dynamics.past.back_mut().expect("just added");
        view.image = Some(Arc::new(image(0)));
        let mut now = world.frame(70, &depth);
        let found = world.label(&mut now, &depth, Some(&image(6))).is_some();
        assert_eq!(
            found, labelled,
            "up to {max_moving}, patch motion {patch_motion}"
        );
    }
}

#[test]
fn trust_grows_with_the_age_of_the_evidence() {
    let odds = |residual, agreed_frames| {
        let evidence = DepthEvidence {
            residual,
            agreed_frames,
        };
        log_odds(&Config::default(), &evidence)
    };
    let unknown = Real::ln(0.45f64 / 0.55);
    assert!((odds(None, 0) - unknown).abs() < 1e-12, "a coin, nearly");
    let ages = [0, 15, 30, 45].map(|age| odds(Some(0.0), age));
    assert!(ages.is_sorted_by(|a, b| a > b), "older, surer: {ages:?}");
    assert!((odds(Some(0.0), 90) - ages[3]).abs() < 1e-15, "settled");
    assert!(ages[3] < 0.0, "settled is static");
    // Up to 2 σ is as good as none; the likelihood falls with σ = 1.5 from there.
    let residuals = [2.0, 3.5, 5.0, 9.0].map(|r| odds(Some(r), 45));
    assert!((residuals[0] - ages[3]).abs() < 1e-15, "{residuals:?}");
    let p = 0.97 * Real::exp(-0.5f64);
    assert!(
        (residuals[1] - Real::ln((1.0 - p) / p)).abs() < 1e-12,
        "{residuals:?}"
    );
    assert!(residuals.is_sorted_by(|a, b| a < b), "{residuals:?}");
    assert!(residuals[1] < 0.0 && residuals[2] > 0.0, "{residuals:?}");
    assert!(odds(Some(1e9), 0).is_finite(), "clamped");
}

/// Young 0.6, old 0.9 from 20 frames on, 0.7 for what no view saw. 5 σ are (5 - 2) / 1.5 = 2 deviations beyond the mean.
#[test]
fn the_prior_is_linear_in_the_age_and_multiplies_the_likelihood() {
    let mut config = Config::default();
    config.labels.trust_young = 0.6;
    config.labels.trust_old = 0.9;
    config.labels.settle_frames = 20;
    config.labels.trust_unknown = 0.7;
    config.crf.unary.clamp = 0.02;
    let at_5_sigma = Real::exp(-2.0f64);
    for (residual, agreed_frames, p) in [
        (None, 40, 0.7),
        (Some(0.0), 0, 0.6),
        (Some(0.0), 5, 0.675),
        (Some(0.0), 19, 0.885),
        (Some(0.0), 20, 0.9),
        (Some(0.0), 40, 0.9),
        (Some(5.0), 0, 0.6 * at_5_sigma),
        (Some(5.0), 5, 0.675 * at_5_sigma),
        (Some(50.0), 5, 0.02),
    ] {
        let evidence = DepthEvidence {
            residual,
            agreed_frames,
        };
        let found = log_odds(&config, &evidence);
        let expected = Real::ln((1.0 - p) / p);
        // The likelihood has a limit of its own at 1 - 0.02.
        let expected_at_limit = Real::ln((1.0 - 0.98 * p) / (0.98 * p));
        let expected = match residual {
            Some(r) if r <= 0.0 => expected_at_limit,
            _ => expected,
        };
        assert!((found - expected).abs() < 1e-12, "{evidence:?}: {found}");
    }
}

#[test]
fn suspects_are_a_share_of_what_is_judged() {
    let mut config = Config::default();
    config.labels.suspect_sigmas = 4.0;
    for (residuals, share) in [
        (vec![], 0.0),
        (vec![None, None], 0.0),
        (vec![Some(4.0), Some(3.5)], 0.0),
        (
            vec![Some(4.1), None, None, Some(0.0), Some(3.9), Some(1.0)],
            0.25,
        ),
        (vec![None, Some(9.0)], 1.0),
    ] {
        let evidence = residuals.iter().map(|residual| DepthEvidence {
            residual: *residual,
            agreed_frames: 7,
        });
        let found = suspected_share(&config, &evidence.collect::<Vec<_>>());
        assert!((found - share).abs() < 1e-15, "{residuals:?}: {found}");
    }
}

/// Of the lattice the second column moves: above 0.55 are its cells 5 and 6, from 20 to 27 px (the shares of its samples in
/// the cells 4 to 7 are 0.522, 0.573, 0.584 and 0.536). A reach of 5 px is two cells, one of 4 px is one. Of the
/// keypoints at x = 140 one is above the threshold by itself.
#[test]
fn labels_are_those_of_the_mask_and_of_the_keypoints_themselves() {
    for (reach_px, unused) in [
        (0, vec![20]),
        (4, vec![20, 28]),
        (5, vec![12, 20, 28]),
        (8, vec![12, 20, 28]),
        (9, vec![12, 20, 28, 36]),
    ] {
        let mut config = Config::default();
        config.crf.threshold = 0.55;
        config.labels.reach_px = reach_px;
        let world = World::new(config);
        let context = &world.context;
        let mut frame = world.frame(60, &wall());
        let own = |place: &[usize; 2]| places().iter().position(|at| at == place);
        let [above, at, hidden] = [[140, 60], [140, 20], [140, 100]]
            .map(|place| own(&place).expect("a keypoint is there"));
        frame.depth_m[hidden] = None;
        let lattice = Lattice::new(&context.camera, 16);
        let blocks = lattice.samples(&frame, &wall(), context);
        let keypoints = keypoint_samples(&frame, &context.camera);
        assert_eq!(keypoints.len(), 299, "one without depth");
        let of_keypoint = |(i, _): &(usize, Sample)| match *i {
            i if i == above => 0.56,
            i if i == at => 0.55,
            _ => 0.0,
        };
        let of_block = |i: usize| f64::from(u8::from(i % 10 == 1));
        let beliefs: Vec<f64> = (keypoints.iter().map(of_keypoint))
            .chain((0..80).map(of_block))
            .collect();
        let depth = wall();
        let view = FrameView {
            frame: &frame,
            depth: &depth,
            pyramid: None,
        };
        let found = labels_from_beliefs(context, view, &lattice, (&keypoints, &blocks), &beliefs);
        let moving = MaskImage::from_fn(40, 30, |x, _| if x == 5 || x == 6 { MOVING } else { 0 });
        assert_eq!(found.cells, moving, "cells");
        assert_eq!(found.restored, [], "landmarks");
        for (i, [x, y]) in places().into_iter().enumerate() {
            let label = match x == 20 || i == above {
                true => Label::Dynamic,
                false => Label::Static,
            };
            assert_eq!(found.label[i], label, "({x}, {y})");
            let in_use = !unused.contains(&x) && i != above;
            assert_eq!(found.in_use[i], in_use, "({x}, {y}), {reach_px} px");
        }
    }
}

/// A box that came before the wall after frame 40. Its texture is now where it was in frame 60, and 3 px beside where it
/// was in frame 50.
fn a_box_that_came(config: Config) -> Option<f64> {
    let box_px = [[48, 112], [32, 96]];
    let depth = wall_behind(box_px);
    let image = |by_px: usize| {
        let texture = texture();
        let image = GrayImage::from_fn(160, 120, |x, y| match is_in(box_px, x, y) {
            true => texture[(x + by_px, y)],
            false => texture[(x, y)],
        });
        LkPyramid::new(&image, 3).expect("an image")
    };
    let mut world = world_that_saw(&wall(), config);
    for (id, by_px) in [(50, 0), (60, 3)] {
        let seen = world.frame(id, &depth);
        world.keep(seen, &depth);
        let view = world.dynamics.past.back_mut().expect("just added");
        view.image = Some(Arc::new(image(by_px)));
    }
    let mut now = world.frame(70, &depth);
    let cells = world.label(&mut now, &depth, Some(&image(3)));
    cells.map(|cells| moving_share(&cells))
}

/// The box has 64 of 300 keypoints and 16 of 80 blocks: 80 of 380 samples, or 0.2105.
#[test]
fn rest_is_checked_against_the_image_of_the_age_that_is_set() {
    for (rest_frames, min_suspects, flow, share) in [
        (10, 0.02, true, 0.0),
        (14, 0.02, true, 0.0),
        (16, 0.02, true, 0.2),
        (20, 0.02, true, 0.2),
        (10, 0.21, true, 0.0),
        (10, 0.211, true, 0.2),
        (10, 0.02, false, 0.2),
    ] {
        let mut config = Config::default();
        config.labels.rest_frames = rest_frames;
        config.labels.patch_motion.min_suspects = min_suspects;
        config.flow.enabled = flow;
        // What was seen there ten frames ago is trusted, and what has just come is not.
        config.labels.trust_young = 0.3;
        config.labels.settle_frames = 10;
        let found = a_box_that_came(config).expect("labelled");
        let what = format!("{rest_frames} frames, {min_suspects}, {flow}: {found}");
        assert!((found - share).abs() < 0.02, "{what}");
    }
}

#[test]
fn by_flow_alone_a_box_moves_against_the_image_of_the_age_that_is_set() {
    for (rest_frames, share) in [(10, 0.0), (14, 0.0), (16, 0.2), (20, 0.2)] {
        let mut config = Config::default();
        config.labels.rest_frames = rest_frames;
        config.labels.source = crate::config::LabelSource::Flow;
        let found = a_box_that_came(config).expect("labelled");
        assert!(
            (found - share).abs() < 0.03,
            "{rest_frames} frames: {found}"
        );
    }
}
