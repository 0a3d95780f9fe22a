//! [`TrainingView`]: a keyframe's image as the target of training, at any level.

use garad_core::undistort::Undistortion;
use garad_core::{
    Camera, DepthImage, Distortion, Image, KeyframeId, MaskImage, Par, RgbImage, Se3,
};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::coarse_to_fine::{gaussian_pyramid, level_of_iteration};
use super::view_mask::{LaterView, ViewDepth};
use crate::config::LabelConfig;
use crate::mask;

/// A keyframe's image. It is kept as recorded, a megabyte; the target of an iteration is computed
/// from it when needed.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct TrainingView {
    /// The keyframe.
    pub keyframe: KeyframeId,
    rgb: RgbImage,
    /// Kept only if the loss asks for it.
    depth: Option<DepthImage>,
    /// 255 near something that moves.
    moving: Option<MaskImage>,
    /// To be compared with later keyframes, up to `memory_frames`.
    view_depth: Option<ViewDepth>,
    uses: usize,
}

/// A recorded image as a rendered one is compared with it.
#[derive(Debug, Clone)]
pub struct Target {
    /// Of this level, without distortion.
    pub camera: Camera,
    /// In [0, 1].
    pub color: Image<[f32; 3]>,
    /// Metres, 0 where it is not known.
    pub depth: Option<DepthImage>,
    /// Not 0 where the loss is not evaluated: something moves, or no pixel was seen.
    pub excluded: MaskImage,
}

impl TrainingView {
    /// Pixels within `dilate_px` of something that moves (255) are left out of the loss.
    #[must_use]
    pub fn new(
        keyframe: KeyframeId,
        rgb: RgbImage,
        depth: Option<DepthImage>,
        mask: Option<&MaskImage>,
        dilate_px: usize,
    ) -> Self {
        Self {
            keyframe,
            rgb,
            depth,
            moving: mask.map(|mask| mask::dilated(mask, dilate_px)),
            view_depth: None,
            uses: 0,
        }
    }

    /// With the depth that later keyframes are compared with.
    #[must_use]
    pub(crate) fn with_view_depth(mut self, view_depth: Option<ViewDepth>) -> Self {
        self.view_depth = view_depth;
        self
    }

    /// Excludes what a later keyframe shows to be free space. `camera_from_world` is this view's.
    pub(crate) fn mask_freed_space(
        &mut self,
        camera_from_world: &Se3,
        later: &LaterView<'_>,
        camera: &Camera,
        config: &LabelConfig,
    ) {
        self.view_depth = self
            .view_depth
            .take_if(|depth| depth.age(later.frame) <= config.memory_frames);
        let Some(view_depth) = &self.view_depth else {
            return;
        };
        let Some(freed) = view_depth.freed_space(camera_from_world, later, camera, config) else {
            return;
        };
        match &mut self.moving {
            None => self.moving = Some(freed),
            Some(moving) => {
                for (moving, freed) in moving.data_mut().iter_mut().zip(freed.data()) {
                    *moving |= freed;
                }
            }
        }
    }

    /// The level of the next iteration (eq. 16).
    pub(crate) fn next_level(&mut self, per_level: usize) -> usize {
        let level = level_of_iteration(self.uses, per_level);
        self.uses += 1;
        level
    }

    /// See [`Target::new`].
    pub(crate) fn target(
        &self,
        camera: &Camera,
        straight: &Undistortion,
        level: usize,
        par: Par,
    ) -> Target {
        let (depth, moving) = (self.depth.as_ref(), self.moving.as_ref());
        Target::new(camera, straight, (&self.rgb, depth, moving), level, par)
    }
}

impl Target {
    /// Undistorted, in [0, 1], halved `level` times (eq. 16). Depth is subsampled, not smoothed:
    /// the mean of two surfaces is on neither. `moving`: not 0 where something moves.
    #[must_use]
    pub fn new(
        camera: &Camera,
        straight: &Undistortion,
        (rgb, depth, moving): (&RgbImage, Option<&DepthImage>, Option<&MaskImage>),
        level: usize,
        par: Par,
    ) -> Self {
        let color = gaussian_pyramid(straight.color(rgb, par), level);
        let mut excluded = straight.unseen();
        if let Some(moving) = moving {
            let moving = straight.nearest(moving, 255);
            for (excluded, moving) in excluded.data_mut().iter_mut().zip(moving.data()) {
                *excluded |= moving;
            }
        }
        let mut depth = depth.map(|d| straight.nearest(d, 0.0));
        for _ in 0..level {
            excluded = mask::halve(&excluded);
            depth = depth.map(|d| {
                Image::from_fn(d.width().div_ceil(2), d.height().div_ceil(2), |x, y| {
                    d[(2 * x, 2 * y)]
                })
            });
        }
        Self {
            camera: Camera {
                distortion: Distortion::default(),
                ..camera.level(level)
            },
            color,
            depth,
            excluded,
        }
    }
}

/// A point this far ahead stands for the camera's direction: two views are near if their cameras are
/// and the points in front of them are.
const AHEAD_M: f64 = 2.5;
/// One view in this many counts as young, and stays.
const YOUNG_SHARE: usize = 4;

/// The view to drop: of the two nearest to each other the older, because the room may have changed
/// since. Repeated, this leaves views that are evenly spread. The youngest quarter always stays.
/// `None` if there are fewer than two.
///
/// `poses` are camera_from_world, the oldest first. Two views are
/// |c_a - c_b| + |f_a - f_b| apart, c the camera's centre and f a point 2.5 m ahead of it, metres.
pub(crate) fn least_needed(poses: &[Se3]) -> Option<usize> {
    let points: Vec<_> = (poses.iter())
        .map(|camera_from_world| {
            let world_from_camera = camera_from_world.inverse();
            let ahead = world_from_camera * Vector3::new(0.0, 0.0, AHEAD_M);
            (world_from_camera.translation, ahead)
        })
        .collect();
    let old = points.len() - points.len() / YOUNG_SHARE;
    let mut least: Option<(f64, usize)> = None;
    for (i, a) in points.iter().enumerate().take(old) {
        for b in &points[i + 1..] {
            let apart_m = (a.0 - b.0).norm() + (a.1 - b.1).norm();
            if least.is_none_or(|(d, _)| apart_m < d) {
                least = Some((apart_m, i));
            }
        }
    }
    least.map(|(_, i)| i)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera::pinhole((32, 24), [30.0, 30.0, 15.5, 11.5]).expect("valid")
    }

    fn target(view: &TrainingView, level: usize) -> Target {
        view.target(&camera(), &Undistortion::new(&camera()), level, Par::Seq)
    }

    #[test]
    fn levels_run_from_coarse_to_fine() {
        let rgb = RgbImage::new(32, 24, [51, 102, 255]);
        let mut view = TrainingView::new(KeyframeId(0), rgb, None, None, 0);
        let levels: Vec<_> = (0..20).map(|_| view.next_level(8)).collect();
        assert_eq!(
            [0, 7, 8, 15, 16, 19].map(|i: usize| levels[i]),
            [2, 2, 1, 1, 0, 0],
            "eight uses each, then whole"
        );
        let target = target(&view, 2);
        assert_eq!(target.color.size(), (8, 6), "a quarter");
        assert_eq!(target.camera, camera().level(2), "with its camera");
        assert!((target.color[(3, 3)][0] - 0.2).abs() < 1e-6, "51 of 255");
        assert!(
            target.excluded.data().iter().all(|m| *m == 0),
            "all of it counts"
        );
    }

    #[test]
    fn moving_pixels_and_their_surroundings_are_left_out() {
        let mut mask = MaskImage::new(32, 24, 0);
        mask[(16, 12)] = 255;
        let rgb = RgbImage::new(32, 24, [0; 3]);
        let view = TrainingView::new(KeyframeId(0), rgb, None, Some(&mask), 2);
        let excluded = target(&view, 0).excluded;
        let count = excluded.data().iter().filter(|m| **m != 0).count();
        assert_eq!(count, 25, "a square of 5");
        assert_eq!(
            (excluded[(18, 14)], excluded[(19, 12)]),
            (255, 0),
            "its corner, beside it"
        );
        let quarter = target(&view, 2).excluded;
        assert_eq!(
            quarter[(4, 3)],
            255,
            "anything mixed with it, at coarse levels too"
        );
        assert_eq!(quarter[(0, 0)], 0, "but not far away");
    }

    #[test]
    fn coarse_depth_is_one_of_the_depths() {
        let depth = DepthImage::from_fn(32, 24, |x, _| if x < 16 { 1.0 } else { 3.0 });
        let rgb = RgbImage::new(32, 24, [0; 3]);
        let view = TrainingView::new(KeyframeId(0), rgb, Some(depth), None, 0);
        let coarse = target(&view, 1).depth.expect("kept");
        assert_eq!(
            (coarse[(7, 0)], coarse[(8, 0)]),
            (1.0, 3.0),
            "nothing between"
        );
    }

    #[test]
    fn coarse_depth_is_that_of_the_even_pixels() {
        let depth = DepthImage::from_fn(32, 24, |x, y| (100 * y + x) as f32 + 1.0);
        let rgb = RgbImage::new(32, 24, [0; 3]);
        let view = TrainingView::new(KeyframeId(0), rgb, Some(depth), None, 0);
        for (level, step) in [(0, 1), (1, 2), (2, 4)] {
            let coarse = target(&view, level).depth.expect("kept");
            assert_eq!(coarse.size(), (32 / step, 24 / step), "level {level}");
            let at = |x: usize, y: usize| (100 * y * step + x * step) as f32 + 1.0;
            assert_eq!(
                (coarse[(0, 0)], coarse[(3, 0)], coarse[(5, 2)]),
                (1.0, at(3, 0), at(5, 2)),
                "level {level}: every pixel number {step}"
            );
        }
    }

    /// The mask of the keyframe, and what two later ones show to be free space: their union.
    #[test]
    fn masks_add_up() {
        use crate::dynamics::free_space::FreeSpace;
        use crate::mask::MOVING;
        use garad_core::FrameId;

        let camera = Camera::pinhole((64, 48), [60.0, 60.0, 31.5, 23.5]).expect("valid");
        let wall_with = |near: &[(usize, usize)]| {
            let is_near = |x: usize| near.iter().any(|(from, to)| (*from..*to).contains(&x));
            DepthImage::from_fn(64, 48, |x, _| if is_near(x) { 1.5 } else { 3.0 })
        };
        // Somebody on the left, who leaves first, and somebody on the right.
        let (left, right) = ((8, 24), (40, 56));
        let view_depth = ViewDepth::new(FrameId(0), &wall_with(&[left, right]), &camera, 8.0);
        let config = LabelConfig {
            dilate_px: 0,
            ..LabelConfig::default()
        };
        for own_mask in [true, false] {
            let own = MaskImage::from_fn(64, 48, |x, y| match x == 31 && y == 3 {
                true => MOVING,
                false => 0,
            });
            let rgb = RgbImage::new(64, 48, [90; 3]);
            let own = own_mask.then_some(&own);
            let view = TrainingView::new(KeyframeId(0), rgb, None, own, 0);
            let mut view = view.with_view_depth(Some(view_depth.clone()));
            let straight = Undistortion::new(&camera);
            let mut after = |depth: DepthImage, frame: u32| {
                let later = LaterView {
                    frame: FrameId(frame),
                    free_space: &FreeSpace::new(&depth, 8.0),
                    camera_from_world: Se3::identity(),
                };
                view.mask_freed_space(&Se3::identity(), &later, &camera, &config);
                let excluded = view.target(&camera, &straight, 0, Par::Seq).excluded;
                [(31, 3), (16, 24), (48, 24), (2, 24)].map(|at| excluded[at] == MOVING)
            };
            let nobody = wall_with(&[left, right]);
            assert_eq!(
                after(nobody, 1),
                [own_mask, false, false, false],
                "both are there"
            );
            assert_eq!(
                after(wall_with(&[right]), 2),
                [own_mask, true, false, false],
                "one left"
            );
            assert_eq!(
                after(wall_with(&[left]), 3),
                [own_mask, true, true, false],
                "back, and the other left"
            );
            assert_eq!(
                after(wall_with(&[]), 9),
                [own_mask, true, true, false],
                "for good"
            );
        }
    }

    /// At half size a pixel is excluded if any under its filter is; the border of a distorted image is.
    #[test]
    fn what_the_image_does_not_show_is_left_out() {
        let mut camera = camera();
        camera.distortion.k1 = 0.3;
        let rgb = RgbImage::new(32, 24, [90; 3]);
        let view = TrainingView::new(KeyframeId(0), rgb, None, None, 0);
        let straight = Undistortion::new(&camera);
        let target = view.target(&camera, &straight, 0, Par::Seq);
        assert_eq!(target.excluded, straight.unseen());
        assert_eq!(target.camera.distortion, Distortion::default(), "straight");
        let mut mask = MaskImage::new(32, 24, 0);
        mask[(16, 12)] = 255;
        let rgb = RgbImage::new(32, 24, [90; 3]);
        let view = TrainingView::new(KeyframeId(0), rgb, None, Some(&mask), 0);
        let target = view.target(&camera, &straight, 0, Par::Seq);
        let unseen = straight.unseen();
        assert_ne!(unseen, MaskImage::new(32, 24, 0), "some pixels lie outside");
        let differs = target.excluded.data().iter().zip(unseen.data());
        assert_eq!(
            differs.filter(|(a, b)| a != b).count(),
            1,
            "beside the mask"
        );
    }

    fn looking(x_m: f64, turn: f64) -> Se3 {
        let rotation = garad_core::So3::exp(&Vector3::new(0.0, turn, 0.0));
        Se3::new(rotation, Vector3::new(x_m, 0.0, 0.0)).inverse()
    }

    #[test]
    fn of_the_two_nearest_views_the_older_is_dropped() {
        let at = |xs: &[f64]| -> Vec<_> { xs.iter().map(|x| looking(*x, 0.0)).collect() };
        assert_eq!(
            least_needed(&at(&[0.0, 1.0, 1.1, 2.0])),
            Some(1),
            "1 and 1.1 m"
        );
        assert_eq!(
            least_needed(&at(&[0.0, 1.0, 2.0, 2.9, 1.2])),
            Some(1),
            "not in a row"
        );
        let turned = [
            looking(0.0, 0.0),
            looking(0.0, 1.0),
            looking(0.2, 0.0),
            looking(3.0, 0.0),
        ];
        assert_eq!(
            least_needed(&turned),
            Some(0),
            "a turn is farther than a step"
        );
        // The youngest two of eight stay, near as they are.
        let young = at(&[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 6.01]);
        assert_eq!(least_needed(&young), Some(0), "first of the evenly spaced");
        // The youngest quarter is that of the number of views, rounded down: of seven one.
        let pair = |at_end: &[f64]| [&[0.0, 2.0, 4.0, 6.0, 8.0][..], at_end].concat();
        assert_eq!(
            least_needed(&at(&pair(&[9.0, 9.2]))),
            Some(5),
            "the sixth is old"
        );
        assert_eq!(
            least_needed(&at(&pair(&[9.0, 20.0, 20.2]))),
            Some(4),
            "the seventh of eight is not"
        );
        // 0.4 rad apart at the same place are 2 · 2.5 sin 0.2 = 0.993 m.
        for (step_m, expected) in [(0.48, 1), (0.51, 0)] {
            let views = [
                looking(0.0, 0.4),
                looking(0.0, 0.0),
                looking(step_m, 0.0),
                looking(9.0, 0.0),
            ];
            assert_eq!(least_needed(&views), Some(expected), "2 x {step_m} m");
        }
        assert_eq!(least_needed(&at(&[1.0])), None, "alone");
        assert_eq!(least_needed(&[]), None, "nothing");
    }

    #[test]
    fn thinned_views_are_spread_evenly() {
        let mut poses = Vec::new();
        for i in 0..200 {
            // Half of them at one place, half along three metres.
            let x_m = if i % 2 == 0 {
                1e-3 * f64::from(i)
            } else {
                0.015 * f64::from(i)
            };
            poses.push(looking(x_m, 0.0));
            if poses.len() > 20 {
                let gone = least_needed(&poses).expect("more than two");
                poses.remove(gone);
            }
        }
        let old = &poses[..15];
        let near_start = old
            .iter()
            .filter(|p| p.inverse().translation.x < 0.3)
            .count();
        assert!(near_start <= 5, "{near_start} of 15 in the first tenth");
    }
}
