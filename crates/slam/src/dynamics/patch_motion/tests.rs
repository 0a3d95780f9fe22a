//! A shirt that sways before a wall, and what else the images of older frames show.

use std::sync::Arc;

use garad_core::{FrameId, GrayImage, Real, Se3};
use nalgebra::Vector3;

use super::*;
use crate::config::Config;
use crate::dynamics::bootstrap::FutureView;
use crate::dynamics::free_space::FreeSpace;
use crate::dynamics::past::reference_images;
use crate::testing::{World, is_in, texture, wall, wall_behind};

/// What has moved sideways, and how far in ten frames, px.
const SHIRT_PX: [[usize; 2]; 2] = [[48, 112], [32, 96]];
const SWAY_PX: usize = 3;
/// Samples whose windows lie within the shirt, before and after.
const WITHIN_PX: [[usize; 2]; 2] = [[70, 98], [46, 82]];

fn config() -> Config {
    let mut config = Config::default();
    config.labels.patch_motion.enabled = true;
    config
}

/// The texture with the shirt moved to the left by this much.
fn swayed(by_px: usize) -> LkPyramid {
    let texture = texture();
    let image = GrayImage::from_fn(160, 120, |x, y| match is_in(SHIRT_PX, x, y) {
        true => texture[(x + by_px, y)],
        false => texture[(x, y)],
    });
    LkPyramid::new(&image, 3).expect("an image")
}

/// Where the camera is: beside the world's origin, and turned.
fn away() -> Se3 {
    Se3::exp(&[1.0, -0.5, 0.3, 0.1, 0.2, -0.3].into())
}

/// A camera at rest before a wall, whose depth does not depend on what is painted on it: images of
/// these frames, with the shirt this far to the left.
fn world_that_saw(images: &[(u32, usize)], config: Config) -> World {
    let mut world = World::new(config);
    for (id, by_px) in images {
        let mut seen = world.frame(*id, &wall());
        seen.camera_from_world = away();
        world.keep(seen, &wall());
        let view = world.dynamics.past.back_mut().expect("just added");
        view.image = Some(Arc::new(swayed(*by_px)));
    }
    world
}

/// Residuals of every fourth pixel of frame 40, in units of σ, where free space finds everything
/// static: those of the shirt, and those whose windows do not touch it.
fn residuals(world: &World, depth: &DepthImage, pyramid: &LkPyramid) -> [Vec<f64>; 2] {
    residuals_from(world, depth, pyramid, [0.0, 0.0])
}

/// The same where free space finds this residual within the shirt and elsewhere.
fn residuals_from(
    world: &World,
    depth: &DepthImage,
    pyramid: &LkPyramid,
    [of_shirt, elsewhere]: [f64; 2],
) -> [Vec<f64>; 2] {
    let World {
        context,
        map,
        dynamics,
        ..
    } = world;
    let mut now = world.frame(40, depth);
    now.camera_from_world = away();
    let columns = (4..156usize).step_by(4);
    let places = columns.flat_map(|x| (4..116usize).step_by(4).map(move |y| (x, y)));
    let places: Vec<(usize, usize)> = places.collect();
    let samples: Vec<Sample> = places
        .iter()
        .map(|&(x, y)| {
            let px = Vector2::new(x as f64, y as f64);
            let depth_m = f64::from(depth[(x, y)]);
            let p_world: Vector3<f64> = away().inverse() * context.camera.unproject(&px, depth_m);
            Sample {
                px,
                depth_m,
                p_world,
            }
        })
        .collect();
    let before = |(x, y): &(usize, usize)| DepthEvidence {
        residual: Some(match is_in(WITHIN_PX, *x, *y) {
            true => of_shirt,
            false => elsewhere,
        }),
        agreed_frames: 40,
    };
    let mut evidence: Vec<_> = places.iter().map(before).collect();
    let references = reference_images(context, map, &dynamics.past, &dynamics.future, now.id);
    let view = FrameView {
        frame: &now,
        depth,
        pyramid: Some(pyramid),
    };
    add_patch_motion(context, view, pyramid, &references, &samples, &mut evidence);
    let of = |is: &dyn Fn(usize, usize) -> bool| {
        let both = places.iter().zip(&evidence);
        both.filter(|((x, y), _)| is(*x, *y))
            .filter_map(|(_, e)| e.residual)
            .collect::<Vec<_>>()
    };
    let near = [[34, 126], [18, 110]];
    [
        of(&|x, y| is_in(WITHIN_PX, x, y)),
        of(&|x, y| !is_in(near, x, y)),
    ]
}

fn largest(residuals: &[f64]) -> f64 {
    residuals.iter().copied().fold(0.0, f64::max)
}

#[test]
fn a_swaying_shirt_is_found_though_depth_agrees() {
    let world = world_that_saw(&[(10, 0), (20, 0), (30, 0)], config());
    let [shirt, wall_around] = residuals(&world, &wall(), &swayed(SWAY_PX));
    assert!(shirt.len() >= 49 && wall_around.len() > 300, "samples");
    // 3 px are 10 units of 0.3 px.
    for residual in shirt {
        assert!((residual - 10.0).abs() < 0.5, "{residual}");
    }
    assert!(largest(&wall_around) <= 0.0, "the wall is at rest");
}

/// Where the shirt was, something with another texture is now.
#[test]
fn a_patch_that_is_nowhere_near_has_changed() {
    let world = world_that_saw(&[(10, 0), (20, 0), (30, 0)], config());
    let texture = texture();
    let other = GrayImage::from_fn(160, 120, |x, y| match is_in(SHIRT_PX, x, y) {
        true => texture[(159 - x, 119 - y)],
        false => texture[(x, y)],
    });
    let now = LkPyramid::new(&other, 3).expect("an image");
    let [shirt, wall_around] = residuals(&world, &wall(), &now);
    let changed = shirt.iter().filter(|r| **r >= CHANGED_SIGMAS).count();
    assert!(
        10 * changed >= 9 * shirt.len(),
        "{changed} of {}",
        shirt.len()
    );
    assert!(largest(&wall_around) <= 0.0, "the wall is at rest");
}

/// In the older images something stood before the shirt: they do not say where it was.
#[test]
fn images_in_which_a_sample_was_hidden_have_no_answer() {
    let mut world = world_that_saw(&[(10, 0), (20, 0), (30, 0)], config());
    for view in &mut world.dynamics.past {
        view.free_space = FreeSpace::new(&wall_behind(SHIRT_PX), 8.0);
    }
    let [shirt, _] = residuals(&world, &wall(), &swayed(SWAY_PX));
    assert!(largest(&shirt) <= 0.0, "hidden");
    for view in &mut world.dynamics.past {
        view.free_space = FreeSpace::new(&DepthImage::new(160, 120, 0.0), 8.0);
    }
    let [shirt, _] = residuals(&world, &wall(), &swayed(SWAY_PX));
    assert!(largest(&shirt) <= 0.0, "no depth");
}

#[test]
fn one_image_against_two_does_not_count() {
    let shirt_of = |images: [(u32, usize); 3]| {
        let world = world_that_saw(&images, config());
        let [shirt, _] = residuals(&world, &wall(), &swayed(SWAY_PX));
        largest(&shirt)
    };
    assert!(shirt_of([(10, 0), (20, 3), (30, 3)]) <= 0.0, "one of three");
    assert!(shirt_of([(10, 0), (20, 0), (30, 3)]) > 5.0, "two of three");
}

#[test]
fn images_too_young_or_too_old_are_not_compared() {
    let world = world_that_saw(&[(4, 0), (36, 0)], config());
    let [shirt, _] = residuals(&world, &wall(), &swayed(SWAY_PX));
    assert!(largest(&shirt) <= 0.0, "36 and 4 frames old");
    let world = world_that_saw(&[(5, 0)], config());
    let [shirt, _] = residuals(&world, &wall(), &swayed(SWAY_PX));
    assert!(largest(&shirt) > 5.0, "35 frames: within half a step of 30");
}

/// A future view is one more reference.
#[test]
fn future_views_are_references() {
    let mut world = world_that_saw(&[], config());
    world.dynamics.future.push(FutureView {
        frame: FrameId(49),
        free_space: FreeSpace::new(&wall(), 8.0),
        pyramid: Some(swayed(0)),
        camera_from_world: away(),
    });
    let [shirt, _] = residuals(&world, &wall(), &swayed(SWAY_PX));
    assert!(largest(&shirt) > 5.0, "9 frames ahead");
    world.dynamics.future[0].frame = FrameId(42);
    let [shirt, _] = residuals(&world, &wall(), &swayed(SWAY_PX));
    assert!(largest(&shirt) <= 0.0, "2 frames ahead is too near");
}

/// The camera has moved 5 cm to the right: with fx = 120 px, a wall at 3 m moves 2 px to the left.
#[test]
fn camera_motion_is_no_displacement() {
    let mut world = world_that_saw(&[(10, 0), (20, 0), (30, 0)], config());
    let now_from_then = Se3::exp(&[-0.05, 0.0, 0.0, 0.0, 0.0, 0.0].into());
    for k in world.dynamics.past.iter().map(|view| view.reference) {
        world.map.keyframe_mut(k).camera_from_world = now_from_then.inverse() * away();
    }
    let all = residuals(&world, &wall(), &passed(2)).concat();
    assert!(largest(&all) <= 0.0, "as predicted");
    let [shirt, around] = residuals(&world, &wall(), &passed(0));
    let least = shirt.into_iter().fold(f64::INFINITY, f64::min);
    assert!(least > 3.5, "what moved with the camera: {least}");
    assert!(largest(&around) <= 0.0, "the wall has not");
}

/// The texture moved to the left by 2 px, the shirt by this much.
fn passed(shirt_px: usize) -> LkPyramid {
    let texture = texture();
    let image = GrayImage::from_fn(160, 120, |x, y| match is_in(SHIRT_PX, x, y) {
        true => texture[(x + shirt_px, y)],
        false => texture[((x + 2).min(159), y)],
    });
    LkPyramid::new(&image, 3).expect("an image")
}

#[test]
fn no_residual_on_plain_cloth_beside_edges_or_if_switched_off() {
    let images = [(10, 0), (20, 0), (30, 0)];
    let world = world_that_saw(&images, config());
    let plain = LkPyramid::new(&GrayImage::new(160, 120, 90), 3).expect("an image");
    let [shirt, _] = residuals(&world, &wall(), &plain);
    assert!(largest(&shirt) <= 0.0, "plain");
    // Something half as far in the middle of the shirt reaches into all its windows.
    let before = wall_behind([[80, 88], [60, 68]]);
    let [beside, _] = residuals(&world, &before, &swayed(SWAY_PX));
    let found = beside.iter().filter(|r| **r > 0.0).count();
    let [all, _] = residuals(&world, &wall(), &swayed(SWAY_PX));
    assert!(
        2 * found < all.len(),
        "{found} of {} beside an edge",
        all.len()
    );
    let mut config = config();
    config.labels.patch_motion.enabled = false;
    let off = world_that_saw(&images, config);
    let [shirt, _] = residuals(&off, &wall(), &swayed(SWAY_PX));
    assert!(largest(&shirt) <= 0.0, "off");
}

/// Up to 6 σ free space leaves it open whether a sample moves; what passes for static, below 2 σ, gives the spread.
#[test]
fn free_space_decides_who_is_searched_for_and_who_passes_for_static() {
    let world = world_that_saw(&[(10, 0), (20, 0), (30, 0)], config());
    for (before, shirt_residual) in [
        ([6.0, 0.0], 10.0),
        ([6.1, 0.0], 6.1),
        ([12.0, 0.0], 12.0),
        ([0.0, 1.9], 10.0),
        ([2.0, 2.0], 2.0),
    ] {
        let [shirt, around] = residuals_from(&world, &wall(), &swayed(SWAY_PX), before);
        for residual in shirt {
            let off = (residual - shirt_residual).abs();
            assert!(off < 0.5 && residual >= before[0], "{before:?}: {residual}");
        }
        let is_as_before = |residual: &f64| (residual - before[1]).abs() < 1e-12;
        assert!(around.iter().all(is_as_before), "{before:?}");
    }
}

#[test]
fn displacements_are_in_units_of_the_sigma_that_is_set() {
    for (sigma_px, expected) in [(0.3, 10.0), (0.6, 5.0), (1.0, 3.0)] {
        let mut config = config();
        config.labels.patch_motion.sigma_px = sigma_px;
        let world = world_that_saw(&[(10, 0), (20, 0), (30, 0)], config);
        for residual in &residuals(&world, &wall(), &swayed(SWAY_PX))[0] {
            assert!(
                (residual - expected).abs() < 0.25,
                "{sigma_px} px: {residual}"
            );
        }
    }
}

/// The camera has moved by 5 cm, and the shirt 2 px against its prediction. At 3 m, σ = 0.45 m of depth is
/// s = 120 · 0.05 · 0.45 / 9 = 0.3 px, as much as σ: 2 px / √2 in units of 0.3 px. Twice σ makes it 2 px / √5.
#[test]
fn the_error_of_the_depth_is_one_of_the_prediction() {
    for (floor_m, share) in [(0.45, 1.0f64), (0.9, 2.0), (0.009, 0.06)] {
        let mut config = config();
        config.labels.noise.floor_m = floor_m;
        config.labels.noise.per_m = 0.0;
        let mut world = world_that_saw(&[(10, 0), (20, 0), (30, 0)], config);
        let then_from_now = Se3::exp(&[0.05, 0.0, 0.0, 0.0, 0.0, 0.0].into());
        for k in world.dynamics.past.iter().map(|view| view.reference) {
            world.map.keyframe_mut(k).camera_from_world = then_from_now * away();
        }
        let expected = 2.0 / 0.3 / (1.0 + share * share).sqrt();
        for residual in &residuals(&world, &wall(), &passed(0))[0] {
            let off = (residual - expected).abs();
            assert!(off < 0.06 * expected, "{floor_m} m: {residual}, {expected}");
        }
    }
}

/// Steps of 5 px up to 10 px around (50, 40), where it is 2 m away; the edge is 0.25 m.
#[test]
fn a_window_is_whole_unless_something_nearer_reaches_into_it() {
    let with = |at: (usize, usize), depth_m: f32, px: [f64; 2]| {
        let mut depth = DepthImage::new(160, 120, 2.0);
        depth[at] = depth_m;
        let px = Vector2::from(px);
        let sample = Sample {
            px,
            depth_m: 2.0,
            p_world: px.push(2.0),
        };
        is_whole(&sample, &depth, 0.25)
    };
    for (at, whole) in [
        ((60, 40), false),
        ((50, 50), false),
        ((40, 30), false),
        ((55, 35), false),
        ((50, 40), false),
        ((61, 40), true),
        ((50, 29), true),
        ((53, 40), true),
    ] {
        assert_eq!(with(at, 1.5, [50.0, 40.0]), whole, "{at:?}");
    }
    assert!(!with((60, 40), 1.5, [49.6, 40.3]), "the nearest pixel");
    assert!(with((60, 40), 1.5, [49.4, 40.3]), "the nearest is 59");
    for (depth_m, whole) in [
        (1.74, false),
        (1.75, true),
        (1.76, true),
        (3.0, true),
        (0.0, true),
        (-1.0, true),
    ] {
        assert_eq!(with((60, 40), depth_m, [50.0, 40.0]), whole, "{depth_m} m");
    }
    assert!(with((0, 0), 1.5, [4.0, 3.0]), "what is outside is left out");
    assert!(!with((4, 3), 1.5, [4.0, 3.0]), "the rest is not");
}

/// The shirt 3 px to the left of where it was.
fn comparison<T>(config: Config, of: impl Fn(&Comparison<'_>) -> T) -> T {
    let (world, now, then) = (World::new(config), swayed(SWAY_PX), swayed(0));
    let free_space = FreeSpace::new(&wall(), 8.0);
    of(&Comparison {
        context: &world.context,
        pyramid: &now,
        reference: ReferenceImage::new(&then, &free_space, Se3::identity()),
        baseline_m: 0.0,
    })
}

/// A patch of the shirt that is found so far to the right of its prediction.
fn task(sample: usize, off_px: f32, correlation: f64) -> Task {
    Task {
        sample,
        at: [84.0, 64.0],
        predicted: [84.0 + 3.0 - off_px, 64.0],
        correlation,
    }
}

/// Lengths of 0.1 to 2 px, of which the one in the middle is 1.1 px; then 125 of 250 count, every other one.
#[test]
fn the_spread_is_that_of_the_median_of_up_to_two_hundred() {
    let sigma_of_median = (2.0 * Real::ln(2.0f64)).sqrt();
    let upwards = |n: u8| (1..=n).map(|k| 0.1 * f32::from(k)).collect::<Vec<_>>();
    let in_turn = [1.0, 2.0].repeat(125);
    for (lengths_px, expected_px) in [
        (upwards(19), None),
        (upwards(20), Some(1.1)),
        (in_turn, Some(1.0)),
    ] {
        let tasks: Vec<Task> = lengths_px.iter().map(|off| task(0, *off, 0.0)).collect();
        let found = comparison(config(), |c| c.spread_px(tasks.iter()));
        let what = format!("{} tasks: {found:?}", tasks.len());
        assert_eq!(found.is_some(), expected_px.is_some(), "{what}");
        let off = found.unwrap_or(0.0) - expected_px.unwrap_or(0.0) / sigma_of_median;
        assert!(off.abs() < 0.03, "{what}");
    }
}

/// All are found 3 px beside the prediction, where the correlation is 1: it must exceed that at the prediction by 0.2, and from
/// 0.97 on nothing is searched for.
#[test]
fn a_displacement_must_explain_the_patch_better() {
    let mut config = config();
    let settings = &mut config.labels.patch_motion;
    settings.same_correlation = 0.97;
    settings.min_gain = 0.2;
    settings.min_correlation = 0.5;
    let correlations = [0.98, 0.96, 0.81, 0.79, 0.6, 0.3, -0.4];
    let tasks: Vec<Task> = (correlations.iter().enumerate())
        .map(|(i, correlation)| task(i, 3.0, *correlation))
        .collect();
    let sample = Sample {
        px: Vector2::new(84.0, 64.0),
        depth_m: 3.0,
        p_world: Vector3::new(0.0, 0.0, 3.0),
    };
    let mut found = comparison(config, |c| c.answers(tasks.clone(), &[sample; 7], 0.5));
    found.sort_by_key(|(i, _)| *i);
    let found: Vec<f64> = found
        .into_iter()
        .map(|(_, answer)| match answer {
            Answer::Displaced(px) => px,
            Answer::Changed => f64::NAN,
        })
        .collect();
    assert_eq!(found.len(), 7, "an answer each");
    for (found, expected) in found.iter().zip([0.0, 0.0, 0.0, 3.0, 3.0, 3.0, 3.0]) {
        assert!((found - expected).abs() < 0.1, "{found} for {expected}");
    }
}
