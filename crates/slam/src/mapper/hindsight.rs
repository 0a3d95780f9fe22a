//! What a keyframe shows, judged by those that came after it.
//!
//! When a keyframe is labelled, only what was before it can be asked. Who stands there and is about
//! to set off passes for static, and the map learns their shirt from that keyframe. Once they have
//! gone, later depth pictures see through the place where they stood. So every new keyframe is a
//! witness ([`crate::labels::witness`]) of the views before it, and what it sees through there is left
//! out of the loss from then on.

use garad_core::{Camera, DepthImage, FrameId, Image, MaskImage, Real, Se3};
use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::config::LabelConfig;
use crate::labels::witness::{Testimony, Witness};
use crate::mask::{self, MOVING};

/// Side of a block, of which one pixel is asked, px.
const BLOCK_PX: usize = 8;
/// Of a block and the eight around it, so many must be seen through: edges of things are thin,
/// people are not.
const LEAST_BLOCKS: usize = 5;

/// A keyframe's depth, to be asked about later.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct Shown {
    frame: FrameId,
    /// Where the middle of each block is, seen by its camera, metres; z = 0 if that is not known.
    p_cam: Image<[f32; 3]>,
}

/// A later keyframe, and where it stood.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Later<'a> {
    pub(crate) frame: FrameId,
    pub(crate) witness: &'a Witness,
    pub(crate) camera_from_world: Se3,
}

impl Shown {
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

    /// What `later` sees through, as a mask of the whole picture; `None` if that is nothing.
    pub(crate) fn seen_through(
        &self,
        camera_from_world: &Se3,
        later: &Later<'_>,
        camera: &Camera,
        config: &LabelConfig,
    ) -> Option<MaskImage> {
        let world_from_camera = camera_from_world.inverse();
        let through = self.p_cam.map(|p| {
            let p: Vector3<f64> = Vector3::from(*p).map(f64::from);
            let testimony = (p.z > 0.0).then(|| {
                let (witness, pose) = (later.witness, &later.camera_from_world);
                witness.testify(&(world_from_camera * p), camera, pose, &config.noise)
            });
            match testimony {
                Some(Testimony::SeenThrough(sigmas)) => sigmas > config.suspect_sigmas,
                _ => false,
            }
        });
        let (columns, rows) = through.size();
        let gone = Image::from_fn(columns, rows, |bx, by| {
            let across = bx.saturating_sub(1)..(bx + 2).min(columns);
            let down = by.saturating_sub(1)..(by + 2).min(rows);
            let around = down.flat_map(|y| across.clone().map(move |x| (x, y)));
            let seen_through = around.filter(|at| through[*at]).count();
            through[(bx, by)] && seen_through >= LEAST_BLOCKS
        });
        gone.data().contains(&true).then(|| {
            let pixels = MaskImage::from_fn(camera.width, camera.height, |x, y| {
                match gone[(x / BLOCK_PX, y / BLOCK_PX)] {
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
    /// Columns and rows of somebody half way to a wall at 3 m.
    const BODY_PX: [[usize; 2]; 2] = [[24, 48], [8, 40]];

    fn camera() -> Camera {
        Camera::pinhole(SIZE, [60.0, 60.0, 31.5, 23.5]).expect("valid")
    }

    fn somebody_at([[x0, x1], [y0, y1]]: [[usize; 2]; 2]) -> DepthImage {
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

    /// What the second picture, taken so far to the right, sees through in the first.
    fn gone(first: &DepthImage, second: &DepthImage, to_the_right_m: f64) -> Option<MaskImage> {
        let config = LabelConfig {
            dilate_px: 0,
            ..LabelConfig::default()
        };
        let shown = Shown::new(FrameId(0), first, &camera(), 8.0);
        let later = Later {
            frame: FrameId(5),
            witness: &Witness::new(second, 8.0),
            camera_from_world: Se3::new(Default::default(), [-to_the_right_m, 0.0, 0.0].into()),
        };
        shown.seen_through(&Se3::identity(), &later, &camera(), &config)
    }

    #[test]
    fn who_has_gone_was_there() {
        // From 10 cm to the right the body is seen through as well: 1.5 m are 4 px.
        for right_m in [0.0, 0.1] {
            let mask = gone(&somebody_at(BODY_PX), &wall(), right_m).expect("somebody");
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
    fn who_is_still_there_or_has_come_was_not_seen_through() {
        let (somebody, wall) = (somebody_at(BODY_PX), wall());
        assert_eq!(gone(&somebody, &somebody, 0.0), None, "still there");
        // From 40 cm to the right, 1.5 m away are 16 px.
        let aside = somebody_at([[8, 32], [8, 40]]);
        assert_eq!(
            gone(&somebody, &aside, 0.4),
            None,
            "still there, from the side"
        );
        assert!(gone(&somebody, &aside, 0.0).is_some(), "has stepped aside");
        assert_eq!(gone(&wall, &somebody, 0.0), None, "has come");
        assert_eq!(gone(&wall, &wall, 0.3), None, "nobody");
        let unknown = DepthImage::new(SIZE.0, SIZE.1, 0.0);
        assert_eq!(gone(&unknown, &wall, 0.0), None, "no depth then");
        assert_eq!(gone(&somebody, &unknown, 0.0), None, "no depth now");
    }

    #[test]
    fn what_is_thin_is_an_edge() {
        let post = [[28, 36], [0, 48]];
        assert_eq!(gone(&somebody_at(post), &wall(), 0.0), None, "a block wide");
        let person = [[24, 40], [0, 48]];
        assert!(gone(&somebody_at(person), &wall(), 0.0).is_some(), "two");
    }

    /// The mask of a view grows with every keyframe that sees through something, until nobody remembers.
    #[test]
    fn a_view_is_judged_while_it_is_remembered() {
        use crate::mapper::view::TrainingView;
        use garad_core::undistort::Undistortion;
        use garad_core::{KeyframeId, Par, RgbImage};

        let config = LabelConfig::default();
        let shown = Shown::new(FrameId(0), &somebody_at(BODY_PX), &camera(), 8.0);
        let rgb = RgbImage::new(SIZE.0, SIZE.1, [90; 3]);
        let after = |frame: u32| {
            let view = TrainingView::new(KeyframeId(0), rgb.clone(), None, None, 0);
            let mut view = view.judged_later(shown.clone());
            let later = Later {
                frame: FrameId(frame),
                witness: &Witness::new(&wall(), 8.0),
                camera_from_world: Se3::identity(),
            };
            view.look_back(&Se3::identity(), &later, &camera(), &config);
            let straight = Undistortion::new(&camera());
            view.target(&camera(), &straight, 0, Par::Seq).excluded
        };
        let memory = config.memory_frames;
        assert_eq!(after(memory)[(36, 24)], MOVING, "remembered");
        assert_eq!(after(memory)[(4, 4)], 0, "the wall");
        assert_eq!(after(memory + 1)[(36, 24)], 0, "forgotten");
    }
}
