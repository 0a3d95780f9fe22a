//! View masks: what a later keyframe shows to be free space is excluded from an earlier view (decision
//! 013).
//!
//! A keyframe can only be labelled by what came before it. Somebody who stands still and is about
//! to set off passes for static, and the map is trained on their image. Once they have left, later
//! depth images see free space where they stood. So every new keyframe's free space
//! ([`crate::dynamics::free_space`]) is compared with the views before it, and what it shows to be free
//! there is excluded from the loss from then on.

use garad_core::{Camera, DepthImage, FrameId, Image, MaskImage, Real, Se3};
use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::config::LabelConfig;
use crate::dynamics::free_space::{FreeSpace, Visibility};
use crate::mask::{self, MOVING};

/// Side of a block, one pixel of which is compared, px.
const BLOCK_PX: usize = 8;
/// Of a block and the eight around it, this many must be free: depth edges are thin, people are not.
const MIN_BLOCKS: usize = 5;

/// A keyframe's depth, to be compared with later keyframes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct ViewDepth {
    frame: FrameId,
    /// The centre of each block in the camera's frame, metres; z = 0 without depth.
    p_cam: Image<[f32; 3]>,
}

/// A later keyframe's free space, and its pose.
#[derive(Debug, Clone, Copy)]
pub(crate) struct LaterView<'a> {
    pub(crate) frame: FrameId,
    pub(crate) free_space: &'a FreeSpace,
    pub(crate) camera_from_world: Se3,
}

impl ViewDepth {
    pub(crate) fn new(
        frame: FrameId,
        depth: &DepthImage,
        camera: &Camera,
        max_depth_m: f64,
    ) -> Self {
        let (width, height) = depth.size();
        let middle = |block: usize, n: usize| (block * BLOCK_PX + BLOCK_PX / 2).min(n - 1);
        let blocks = (width.div_ceil(BLOCK_PX), height.div_ceil(BLOCK_PX));
        let p_cam = Image::from_fn(blocks.0, blocks.1, |bx, by| {
            let (x, y) = (middle(bx, width), middle(by, height));
            let z = f64::from(depth[(x, y)]);
            let known = z > 0.0 && z <= max_depth_m;
            let uv_px = camera.undistort_pixel(&Vector2::new(x as f64, y as f64));
            uv_px.filter(|_| known).map_or([0.0; 3], |uv| {
                camera.unproject(&uv, z).map(Real::to_f32).into()
            })
        });
        Self { frame, p_cam }
    }

    /// Frames from here to a later one.
    pub(crate) fn age(&self, later: FrameId) -> u32 {
        later.0.saturating_sub(self.frame.0)
    }

    /// The part of this view that is free space in `later`, dilated, as a mask of the whole image; `None` if
    /// that is nothing.
    pub(crate) fn freed_space(
        &self,
        camera_from_world: &Se3,
        later: &LaterView<'_>,
        camera: &Camera,
        config: &LabelConfig,
    ) -> Option<MaskImage> {
        let world_from_camera = camera_from_world.inverse();
        let free = self.p_cam.map(|p| {
            let p: Vector3<f64> = Vector3::from(*p).map(f64::from);
            let visibility = (p.z > 0.0).then(|| {
                let (free_space, pose) = (later.free_space, &later.camera_from_world);
                free_space.query(&(world_from_camera * p), camera, pose, &config.noise)
            });
            match visibility {
                Some(Visibility::InFront(sigmas)) => sigmas > config.suspect_sigmas,
                _ => false,
            }
        });
        let (columns, rows) = free.size();
        let freed = Image::from_fn(columns, rows, |bx, by| {
            let across = bx.saturating_sub(1)..(bx + 2).min(columns);
            let down = by.saturating_sub(1)..(by + 2).min(rows);
            let around = down.flat_map(|y| across.clone().map(move |x| (x, y)));
            free[(bx, by)] && around.filter(|at| free[*at]).count() >= MIN_BLOCKS
        });
        freed.data().contains(&true).then(|| {
            let pixels = MaskImage::from_fn(camera.width, camera.height, |x, y| {
                match freed[(x / BLOCK_PX, y / BLOCK_PX)] {
                    true => MOVING,
                    false => 0,
                }
            });
            mask::dilated(&pixels, config.dilate_px)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIZE: (usize, usize) = (64, 48);
    /// Columns and rows of a body half way to a wall at 3 m.
    const BODY_PX: [[usize; 2]; 2] = [[24, 48], [8, 40]];

    fn camera() -> Camera {
        Camera::pinhole(SIZE, [60.0, 60.0, 31.5, 23.5]).expect("valid")
    }

    fn body_at([[x0, x1], [y0, y1]]: [[usize; 2]; 2]) -> DepthImage {
        DepthImage::from_fn(SIZE.0, SIZE.1, |x, y| {
            match (x0..x1).contains(&x) && (y0..y1).contains(&y) {
                true => 1.5,
                false => 3.0,
            }
        })
    }

    fn wall() -> DepthImage {
        DepthImage::new(SIZE.0, SIZE.1, 3.0)
    }

    /// What the second image, taken this far to the right, shows to be free in the first.
    fn freed(first: &DepthImage, second: &DepthImage, to_the_right_m: f64) -> Option<MaskImage> {
        let config = LabelConfig {
            dilate_px: 0,
            ..LabelConfig::default()
        };
        let view_depth = ViewDepth::new(FrameId(0), first, &camera(), 8.0);
        let later = LaterView {
            frame: FrameId(5),
            free_space: &FreeSpace::new(second, 8.0),
            camera_from_world: Se3::new(Default::default(), [-to_the_right_m, 0.0, 0.0].into()),
        };
        view_depth.freed_space(&Se3::identity(), &later, &camera(), &config)
    }

    #[test]
    fn a_body_that_left_is_masked() {
        // From 10 cm to the right the body is seen through as well: 1.5 m are 4 px.
        for right_m in [0.0, 0.1] {
            let mask = freed(&body_at(BODY_PX), &wall(), right_m).expect("body");
            let [[x0, x1], [y0, y1]] = BODY_PX;
            for (x, y) in (0..SIZE.1).flat_map(|y| (0..SIZE.0).map(move |x| (x, y))) {
                let inside = (x0..x1).contains(&x) && (y0..y1).contains(&y);
                let corner = (x < x0 + BLOCK_PX || x >= x1 - BLOCK_PX)
                    && (y < y0 + BLOCK_PX || y >= y1 - BLOCK_PX);
                if !corner {
                    assert_eq!(
                        mask[(x, y)] == MOVING,
                        inside,
                        "({x}, {y}) from {right_m} m"
                    );
                }
            }
        }
    }

    #[test]
    fn a_body_that_stayed_or_came_is_not_masked() {
        let (body, wall) = (body_at(BODY_PX), wall());
        assert_eq!(freed(&body, &body, 0.0), None, "still there");
        // From 40 cm to the right, 1.5 m away are 16 px.
        let aside = body_at([[8, 32], [8, 40]]);
        assert_eq!(
            freed(&body, &aside, 0.4),
            None,
            "still there, from the side"
        );
        assert!(freed(&body, &aside, 0.0).is_some(), "has stepped aside");
        assert_eq!(freed(&wall, &body, 0.0), None, "has come");
        assert_eq!(freed(&wall, &wall, 0.3), None, "nobody");
        let unknown = DepthImage::new(SIZE.0, SIZE.1, 0.0);
        assert_eq!(freed(&unknown, &wall, 0.0), None, "no depth then");
        assert_eq!(freed(&body, &unknown, 0.0), None, "no depth now");
    }

    #[test]
    fn thin_differences_are_depth_edges() {
        let post = [[28, 36], [0, 48]];
        assert_eq!(freed(&body_at(post), &wall(), 0.0), None, "a block wide");
        let person = [[24, 40], [0, 48]];
        assert!(freed(&body_at(person), &wall(), 0.0).is_some(), "two");
    }

    /// Block (bx, by) stands for pixel (8 bx + 4, 8 by + 4), in the camera's frame.
    #[test]
    fn a_block_is_its_middle_pixel() {
        let camera = Camera::pinhole((20, 12), [20.0, 10.0, 9.5, 5.5]).expect("valid");
        let depth = DepthImage::from_fn(20, 12, |x, y| match (x, y) {
            (4, 4) => 2.0,
            (12, 4) => 3.0,
            (19, 4) => 3.001,
            (4, 11) => f32::NAN,
            (12, 11) => -1.0,
            (19, 11) => 1.0,
            _ => 0.5,
        });
        let of = |max_depth_m: f64| ViewDepth::new(FrameId(4), &depth, &camera, max_depth_m);
        let view = of(3.0);
        assert_eq!(view.p_cam.size(), (3, 2), "the last ones are cut off");
        let near = |at: (usize, usize), expected: [f32; 3]| {
            let p = view.p_cam[at];
            let apart = p.iter().zip(expected).map(|(a, b)| (a - b).abs());
            assert!(apart.fold(0.0, f32::max) < 1e-6, "{at:?}: {p:?}");
        };
        near((0, 0), [-0.55, -0.3, 2.0]);
        near((1, 0), [0.375, -0.45, 3.0]);
        near((2, 0), [0.0; 3]); // too far
        near((0, 1), [0.0; 3]);
        near((1, 1), [0.0; 3]);
        near((2, 1), [0.475, 0.55, 1.0]);
        assert!(of(3.1).p_cam[(2, 0)][2] > 3.0, "not too far");
        assert_eq!([4, 9, 3].map(|frame| view.age(FrameId(frame))), [0, 5, 0]);
    }

    /// Free blocks of an image of 8 x 6; at 1.5 m before a wall at 3 m, 1.5 m / σ.
    #[test]
    fn five_free_blocks_of_nine_make_a_mask_in_the_middle() {
        let freed_by = |near: &[(usize, usize)], suspect_sigmas: f64, dilate_px: usize| {
            let depth = DepthImage::from_fn(SIZE.0, SIZE.1, |x, y| {
                match near.contains(&(x / BLOCK_PX, y / BLOCK_PX)) {
                    true => 1.5,
                    false => 3.0,
                }
            });
            let mut config = LabelConfig {
                suspect_sigmas,
                dilate_px,
                ..LabelConfig::default()
            };
            (config.noise.per_m, config.noise.floor_m) = (0.0, 0.25);
            let later = LaterView {
                frame: FrameId(5),
                free_space: &FreeSpace::new(&wall(), 8.0),
                camera_from_world: Se3::identity(),
            };
            let view_depth = ViewDepth::new(FrameId(0), &depth, &camera(), 8.0);
            let mask = view_depth.freed_space(&Se3::identity(), &later, &camera(), &config)?;
            Some(mask.data().iter().filter(|m| **m == MOVING).count())
        };
        let middle = (3, 2);
        let four = [middle, (2, 1), (3, 1), (4, 3)];
        let five = [middle, (2, 1), (3, 1), (4, 3), (4, 2)];
        let around = [(2, 1), (2, 3), (4, 1), (4, 3), (3, 1)];
        assert_eq!(freed_by(&four, 5.0, 0), None, "four of nine");
        assert_eq!(
            freed_by(&five, 5.0, 0),
            Some(64),
            "five: the middle one alone"
        );
        assert_eq!(freed_by(&around, 5.0, 0), None, "the middle is not free");
        assert_eq!(freed_by(&five, 5.0, 3), Some(14 * 14), "dilated");
        assert_eq!(
            freed_by(&five, 6.0, 0),
            None,
            "as many standard deviations, not more"
        );
        let corner = [(0, 0), (1, 0), (0, 1), (1, 1)];
        assert_eq!(
            freed_by(&corner, 5.0, 0),
            None,
            "four of four in the corner"
        );
    }

    /// The mask of a view grows with every later keyframe, up to `memory_frames`.
    #[test]
    fn a_view_is_masked_for_as_long_as_memory_frames() {
        use crate::mapping::view::TrainingView;
        use garad_core::undistort::Undistortion;
        use garad_core::{KeyframeId, Par, RgbImage};

        let config = LabelConfig::default();
        let view_depth = ViewDepth::new(FrameId(0), &body_at(BODY_PX), &camera(), 8.0);
        let rgb = RgbImage::new(SIZE.0, SIZE.1, [90; 3]);
        let after = |frame: u32| {
            let view = TrainingView::new(KeyframeId(0), rgb.clone(), None, None, 0);
            let mut view = view.with_view_depth(Some(view_depth.clone()));
            let later = LaterView {
                frame: FrameId(frame),
                free_space: &FreeSpace::new(&wall(), 8.0),
                camera_from_world: Se3::identity(),
            };
            view.mask_freed_space(&Se3::identity(), &later, &camera(), &config);
            let straight = Undistortion::new(&camera());
            view.target(&camera(), &straight, 0, Par::Seq).excluded
        };
        let memory = config.memory_frames;
        assert_eq!(after(memory)[(36, 24)], MOVING, "remembered");
        assert_eq!(after(memory)[(4, 4)], 0, "the wall");
        assert_eq!(after(memory + 1)[(36, 24)], 0, "forgotten");
    }
}
