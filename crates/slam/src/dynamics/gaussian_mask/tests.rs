//! The mask of a few Gaussians in front of a wall at 3 m, or on a box at half the way to it.

use Label::{Dynamic, Static};
use garad_core::{Image, KeyframeId, NewGaussian, Real};
use garad_features::Descriptor;

use super::*;
use crate::config::{Config, LabelSource};
use crate::dynamics::free_space::FreeSpace;
use crate::dynamics::landmarks::{TaggedLabel, take_labels_of_gaussians};
use crate::images::lk_pyramid;
use crate::testing::{World, is_in, places, texture, wall, wall_behind};

/// The box: 4 x 4 blocks of the lattice, whose samples are at 8, 24, 40, ...
const BOX_PX: [[usize; 2]; 2] = [[48, 112], [32, 96]];
const BOX_M: f64 = 1.5;
const WALL_M: f64 = 3.0;

fn world(mask: GaussianMaskConfig) -> World {
    let mut config = Config::default();
    config.labels.source = LabelSource::Gaussians;
    config.labels.gaussian_mask = mask;
    World::new(config)
}

/// Gaussians at these pixels, at this depth, as round spots of this standard deviation.
fn spots(at_px: &[[f64; 2]], depth_m: f64, sigma_px: f64, opacity: f32) -> GaussianMap {
    let camera = world(GaussianMaskConfig::default()).context.camera;
    let mut map = GaussianMap::new(0);
    for at in at_px {
        let mean = camera.unproject(&Vector2::from(*at), depth_m);
        let row = map.push(&NewGaussian {
            mean: mean.map(Real::to_f32).into(),
            sigma_m: (sigma_px * depth_m / camera.fx).to_f32(),
            opacity,
            color: [0.5; 3],
            landmark: None,
            born: KeyframeId(0),
        });
        map.label[row] = Dynamic;
    }
    map
}

/// What a mask says at pixels of a row, at a level or for a keypoint.
fn along_row<T: Copy>(at: &[T], label: impl Fn(T) -> Label) -> Vec<Label> {
    at.iter().map(|at| label(*at)).collect()
}

fn frame_labels(
    world: &World,
    dynamic: &GaussianMap,
    (frame, depth): (&Frame, &DepthImage),
    images: Option<(&LkPyramid, &FreeSpace)>,
) -> FrameLabels {
    let references = images.map(|(pyramid, free_space)| {
        let pose = garad_core::Se3::identity();
        ReferenceImage::new(pyramid, free_space, pose)
    });
    let view = FrameView {
        frame,
        depth,
        pyramid: images.map(|(pyramid, _)| pyramid),
    };
    let given = MaskLabelling {
        dynamic,
        map: &world.map,
        lattice: &Lattice::new(&world.context.camera, 16),
        centres: Some(&CellCentres::new(&world.context.camera)),
        references: references.as_slice(),
    };
    label_by_mask(&world.context, view, given, &mut Recorder::default())
}

/// The labels of the keypoints of a row, from left to right.
fn row_of(labels: &FrameLabels, y: usize, columns: &[usize]) -> Vec<Label> {
    let label = |x: &usize| {
        let at = places().iter().position(|at| *at == [*x, y]);
        labels.label[at.expect("a keypoint is there")]
    };
    columns.iter().map(label).collect()
}

/// One level at a time is opaque; the scales of ORB are 1.2 to the power of 0 to 7.
#[test]
fn a_keypoint_is_looked_up_in_the_level_of_the_nearest_scale() {
    let world = world(GaussianMaskConfig::default());
    let frame = world.frame(20, &wall());
    let levels_of = |scales: &[f64]| -> Vec<usize> {
        let mut levels = vec![usize::MAX; scales.len()];
        for opaque in 0..=TOP_LEVEL {
            let none = GaussianMap::new(0);
            let mut mask = GaussianMask::render(&world.context, &none, &frame, &wall());
            assert_eq!(mask.levels.len(), 3, "levels");
            let (width, height) = mask.levels[opaque].opacity.size();
            mask.levels[opaque].opacity = Image::new(width, height, 1.0);
            for (level, scale) in levels.iter_mut().zip(scales) {
                let at = Vector2::new(90.0, 40.0);
                if mask.label(&at, *scale, None) == Dynamic {
                    assert_eq!(*level, usize::MAX, "one level for {scale}");
                    *level = opaque;
                }
            }
        }
        levels
    };
    let of_orb = levels_of(&world.context.scales);
    assert_eq!(of_orb, [0, 0, 1, 1, 1, 1, 2, 2], "1 to 3.58");
    // The middle between 1 and 2 is √2, that between 2 and 4 is 2 √2.
    let (first, second) = (2f64.sqrt(), 8f64.sqrt());
    let of_bounds = levels_of(&[
        0.9999 * first,
        1.0001 * first,
        0.9999 * second,
        1.0001 * second,
    ]);
    assert_eq!(of_bounds, [0, 1, 1, 2], "beside the bounds");
}

/// A spot of sigma 4 px (with the 0.3 px² of the rasterizer: 4.04, 2.07 and 1.14 px at the levels) is above 0.5 up to
/// 1.133 sigma: 4, 2 and 1 pixels.
#[test]
fn every_level_shows_a_gaussian_at_its_place() {
    let world = world(GaussianMaskConfig::default());
    let frame = world.frame(20, &wall());
    let spot = spots(&[[80.0, 60.0]], WALL_M, 4.0, 0.95);
    let mask = GaussianMask::render(&world.context, &spot, &frame, &wall());
    for (level, columns) in [
        [75.4, 75.6, 84.4, 84.6],
        [74.9, 75.1, 84.9, 85.1],
        [73.9, 74.1, 85.9, 86.1],
    ]
    .iter()
    .enumerate()
    {
        let labels = along_row(columns, |x| {
            mask.label_at_level(level, &Vector2::new(x, 60.0), None)
        });
        let expected = [Static, Dynamic, Dynamic, Static];
        assert_eq!(labels, expected, "level {level}, {columns:?}");
    }
    for outside in [[-1.0, 60.0], [80.0, -1.0], [160.0, 60.0], [80.0, 120.0]] {
        let label = mask.label(&Vector2::from(outside), 1.0, None);
        assert_eq!(label, Static, "{outside:?}");
    }
}

/// Opacity 0.9 in the middle, 0.546 at one and 0.122 at two standard deviations.
#[test]
fn the_mask_begins_at_the_opacity_that_is_set() {
    let spot = spots(&[[80.0, 60.0]], WALL_M, 10.0, 0.9);
    for (opacity, expected) in [
        (0.1, [Dynamic, Dynamic, Dynamic]),
        (0.5, [Dynamic, Dynamic, Static]),
        (0.6, [Dynamic, Static, Static]),
        (0.95, [Static, Static, Static]),
    ] {
        let world = world(GaussianMaskConfig {
            opacity,
            ..GaussianMaskConfig::default()
        });
        let frame = world.frame(20, &wall());
        let mask = GaussianMask::render(&world.context, &spot, &frame, &wall());
        let labels = along_row(&[80.0, 90.0, 100.0], |x| {
            mask.label(&Vector2::new(x, 60.0), 1.0, None)
        });
        assert_eq!(labels, expected, "above {opacity}");
    }
}

/// A Gaussian on the box: the box is there, is gone, or has no depth.
#[test]
fn a_gaussian_whose_surface_has_gone_is_not_drawn() {
    let spot = spots(&[[80.0, 64.0]], BOX_M, 4.0, 0.95);
    let unknown = DepthImage::new(160, 120, 0.0);
    let images = [wall_behind(BOX_PX), wall(), unknown];
    for (depth_m, expected) in [
        (0.0, [Dynamic, Dynamic, Dynamic]),
        (0.45, [Dynamic, Static, Dynamic]),
        (1.49, [Dynamic, Static, Dynamic]),
        (1.51, [Dynamic, Dynamic, Dynamic]),
    ] {
        let world = world(GaussianMaskConfig {
            depth_m,
            ..GaussianMaskConfig::default()
        });
        let labels = images.each_ref().map(|depth| {
            let frame = world.frame(20, depth);
            let mask = GaussianMask::render(&world.context, &spot, &frame, depth);
            mask.label(&Vector2::new(80.0, 64.0), 1.0, None)
        });
        assert_eq!(labels, expected, "depth_m = {depth_m}");
    }
}

#[test]
fn a_keypoint_behind_or_before_the_rendered_surface_is_not_in_the_mask() {
    let spot = spots(&[[80.0, 64.0]], BOX_M, 4.0, 0.95);
    let depths_m = [Some(1.5), Some(1.9), Some(2.0), Some(3.0), Some(1.0), None];
    for (depth_m, expected) in [
        (0.0, [Dynamic; 6]),
        (0.45, [Dynamic, Dynamic, Static, Static, Static, Dynamic]),
    ] {
        let world = world(GaussianMaskConfig {
            depth_m,
            ..GaussianMaskConfig::default()
        });
        let depth = wall_behind(BOX_PX);
        let frame = world.frame(20, &depth);
        let mask = GaussianMask::render(&world.context, &spot, &frame, &depth);
        let labels = along_row(&depths_m, |z| mask.label(&Vector2::new(80.0, 64.0), 1.0, z));
        assert_eq!(labels, expected, "depth_m = {depth_m}: {depths_m:?}");
    }
}

/// Gaussians cover the samples of the left half of the box, at x = 56 and 72. The cell of the keypoint at x = 84 lies at
/// 85.5: of its surface the samples at 72, 88 and 104 weigh 0.4375, 0.896 and 0.229, of which the first is in the mask:
/// a share of 0.28. That of the keypoint at x = 92 is 0.07.
#[test]
fn the_mask_is_carried_along_a_surface_and_not_across_its_edge() {
    let at_px: Vec<_> = [56.0, 72.0]
        .iter()
        .flat_map(|x| [40.0, 56.0, 72.0, 88.0].map(|y| [*x, y]))
        .collect();
    let half = spots(&at_px, BOX_M, 6.0, 0.95);
    let columns = [36, 44, 52, 60, 68, 76, 84, 92, 116];
    for (surface_share, at_84) in [(0.0, Static), (0.1, Dynamic), (0.3, Static)] {
        let world = world(GaussianMaskConfig {
            surface_share,
            ..GaussianMaskConfig::default()
        });
        let depth = wall_behind(BOX_PX);
        let frame = world.frame(20, &depth);
        let labels = frame_labels(&world, &half, (&frame, &depth), None);
        let (wall, left) = ([Static; 2], [Dynamic; 4]);
        let expected = [&wall[..], &left, &[at_84, Static, Static]].concat();
        assert_eq!(row_of(&labels, 60, &columns), expected, "{surface_share}");
        assert_eq!(labels.restored, [], "no earlier image");
        if surface_share > 0.0 {
            let outside = |(i, moving): (usize, &u8)| {
                *moving == MOVING && !is_in(BOX_PX, i % 40 * CELL_PX, i / 40 * CELL_PX)
            };
            let over = labels
                .cells
                .data()
                .iter()
                .enumerate()
                .filter(|c| outside(*c));
            assert_eq!(over.count(), 0, "cells of the wall");
        }
        // Beside the moving cells, which the surface carries to its edge, a keypoint is static, but not used.
        let in_use = [36, 44, 60].map(|x| {
            let at = places().iter().position(|at| *at == [x, 60]);
            labels.in_use[at.expect("a keypoint is there")]
        });
        assert_eq!(
            in_use,
            [true, surface_share <= 0.0, false],
            "{surface_share}"
        );
    }
}

/// A spot on the wall covers four blocks and the twelve keypoints within 14.7 px of (80, 64); the image is that of ten
/// frames ago.
#[test]
fn suspects_at_rest_are_static_again_and_the_landmarks_they_show_are_named() {
    let mut world = world(GaussianMaskConfig::default());
    let spot = spots(&[[80.0, 64.0]], WALL_M, 13.0, 0.95);
    let (depth, free_space) = (wall(), FreeSpace::new(&wall(), 8.0));
    let pyramid = lk_pyramid(&texture(), &world.context.config).expect("wanted");
    let first = world.frame(0, &depth);
    let first = world.keep(first, &depth);
    let frame = world.frame(10, &depth);
    let suspects = |labels: &FrameLabels| labels.label.iter().filter(|l| **l == Dynamic).count();

    let unchecked = frame_labels(&world, &spot, (&frame, &depth), None);
    assert_eq!(suspects(&unchecked), 12, "without an earlier image");
    assert!(unchecked.cells.data().contains(&MOVING), "and cells");
    let images = Some((&pyramid, &free_space));
    let labels = frame_labels(&world, &spot, (&frame, &depth), images);
    assert_eq!(suspects(&labels), 0, "all are at rest");
    assert!(labels.in_use.iter().all(|in_use| *in_use), "and used");
    assert!(!labels.cells.data().contains(&MOVING), "all four blocks");
    assert_eq!(labels.restored, [], "no landmark is there");

    let scales = world.context.scales.clone();
    let landmark = |world: &mut World, [x, y]: [f64; 2], bits: u64, label| {
        let p_world = (world.context.camera).unproject(&Vector2::new(x, y), WALL_M);
        let i = world.map.landmarks().count();
        let id = world.map.add_landmark(p_world, first, i, &scales);
        world.map.landmark_mut(id).expect("made").descriptor = Descriptor([bits, bits, 0, 0]);
        let removed = false;
        let given = TaggedLabel { id, label, removed };
        take_labels_of_gaussians(&world.context, &mut world.map, &[given]);
        id
    };
    let shown = landmark(&mut world, [76.0, 60.0], 0b11, Dynamic);
    landmark(&mut world, [84.0, 60.0], u64::MAX, Dynamic); // looks different
    landmark(&mut world, [76.0, 68.0], 0, Static);
    landmark(&mut world, [4.0, 4.0], 0, Dynamic); // no suspect there
    let labels = frame_labels(&world, &spot, (&frame, &depth), images);
    assert_eq!(labels.restored, [shown], "4 of 256 bits differ");
    let nearer = landmark(&mut world, [79.0, 60.0], 0b1, Dynamic);
    let labels = frame_labels(&world, &spot, (&frame, &depth), images);
    assert_eq!(labels.restored, [nearer], "2 bits, 3 px beside a keypoint");
    let unchecked = frame_labels(&world, &spot, (&frame, &depth), None);
    assert_eq!(unchecked.restored, [], "nothing was checked");
}

#[test]
fn without_dynamic_gaussians_everything_is_static() {
    for surface_share in [0.0, 0.1] {
        let world = world(GaussianMaskConfig {
            surface_share,
            ..GaussianMaskConfig::default()
        });
        let depth = wall_behind(BOX_PX);
        let frame = world.frame(20, &depth);
        let labels = frame_labels(&world, &GaussianMap::new(0), (&frame, &depth), None);
        assert_eq!(labels.label, vec![Static; frame.len()], "keypoints");
        assert!(labels.in_use.iter().all(|in_use| *in_use), "all used");
        assert!(labels.cells.data().iter().all(|c| *c == 0), "cells");
        assert_eq!(labels.restored, [], "landmarks");
    }
}

/// A spot of 13 px is above 0.5 up to 14.7 px: the keypoint at x = 92, 12 px beside it, moves. The cells reach to 95 px; that at
/// x = 100 is in the second cell beside them, which a reach of 5 px covers and one of 4 px does not.
#[test]
fn keypoints_within_reach_of_the_mask_are_not_used() {
    for (reach_px, unused) in [(0, 1), (4, 1), (5, 2), (8, 2), (9, 2), (13, 3)] {
        let mut world = world(GaussianMaskConfig::default());
        world.context.config.labels.reach_px = reach_px;
        let spot = spots(&[[80.0, 60.0]], WALL_M, 13.0, 0.95);
        let frame = world.frame(20, &wall());
        let labels = frame_labels(&world, &spot, (&frame, &wall()), None);
        let columns = [92, 100, 108, 116];
        assert_eq!(
            row_of(&labels, 60, &columns),
            [Dynamic, Static, Static, Static]
        );
        let in_use = columns.map(|x| {
            let at = places().iter().position(|at| *at == [x, 60]);
            labels.in_use[at.expect("a keypoint is there")]
        });
        let expected = [0, 1, 2, 3].map(|k| k >= unused);
        assert_eq!(in_use, expected, "{reach_px} px");
    }
}
