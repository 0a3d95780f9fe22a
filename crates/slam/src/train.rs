//! The map learns the pictures: one training iteration, and which keyframe is next
//! (design section 5, point 6; paper eq. 12, 13, 15, 16).
//!
//! ```text
//! schedule ─ keyframe, level ─→ render (static Gaussians) ─→ photometric loss ─→ backward ─→ Adam
//! ```

use garad_core::pyramid::halve_real;
use garad_core::{
    Camera, Distortion, GaussianMap, Image, KeyframeId, Label, MaskImage, Par, RgbImage, Rng, Se3,
};
use garad_optim::{Adam, AdamConfig, OptimError};
use garad_raster::losses::{opacity_penalty, photometric};
use garad_raster::{Gradients, Include, RasterError, RenderOptions, Upstream, fast};
use nalgebra::Vector2;
use thiserror::Error;

use crate::config::{RateConfig, TrainConfig};
use crate::mask;

/// Halvings of the coarsest picture (n = 2: three levels, eq. 16).
const TOP_LEVEL: usize = 2;

/// A keyframe's picture, ready to be compared with at any level. It is kept as recorded, a megabyte
/// of bytes; what one iteration compares with is made when it is wanted.
#[derive(Debug, Clone)]
pub struct TrainingView {
    /// The keyframe.
    pub keyframe: KeyframeId,
    camera: Camera,
    rgb: RgbImage,
    /// 255 near something that moves.
    moving: Option<MaskImage>,
    uses: usize,
}

/// What one iteration compares with.
#[derive(Debug, Clone)]
struct Target {
    camera: Camera,
    color: Image<[f32; 3]>,
    /// Not 0 where the picture says nothing: something moves, or no pixel was seen.
    excluded: MaskImage,
}

impl TrainingView {
    /// Pixels within `dilate_px` of something that moves (255) are left out of the loss.
    #[must_use]
    pub fn new(
        keyframe: KeyframeId,
        camera: &Camera,
        rgb: RgbImage,
        mask: Option<&MaskImage>,
        dilate_px: usize,
    ) -> Self {
        Self {
            keyframe,
            camera: *camera,
            rgb,
            moving: mask.map(|mask| mask::dilated(mask, dilate_px)),
            uses: 0,
        }
    }

    /// Coarse first: `per_level` uses at each coarser level, then full size.
    fn level(&self, per_level: usize) -> usize {
        match per_level {
            0 => 0,
            _ => TOP_LEVEL.saturating_sub(self.uses / per_level),
        }
    }

    /// Undistorted, in [0, 1], halved `level` times (eq. 16).
    fn target(&self, level: usize) -> Target {
        let (mut color, mut excluded) = self.undistorted();
        for _ in 0..level {
            color = halve_real(&color);
            excluded = mask::halve(&excluded);
        }
        Target {
            camera: Camera {
                distortion: Distortion::default(),
                ..self.camera.level(level)
            },
            color,
            excluded,
        }
    }

    /// What a pinhole would have seen, in [0, 1], and where it says nothing.
    fn undistorted(&self) -> (Image<[f32; 3]>, MaskImage) {
        let (width, height) = self.rgb.size();
        let moving = |x: usize, y: usize| self.moving.as_ref().map_or(0, |m| m[(x, y)]);
        if self.camera.distortion.is_none() {
            let color = self.rgb.map(|c| c.map(|v| f32::from(v) / 255.0));
            return (color, MaskImage::from_fn(width, height, moving));
        }
        let mut excluded = MaskImage::new(width, height, 255);
        let color = Image::from_fn(width, height, |x, y| {
            let seen_at = self.camera.distort_pixel(&Vector2::new(x as f64, y as f64));
            let Some((corner, weights)) = bilinear(&seen_at, self.rgb.size()) else {
                return [0.0; 3];
            };
            excluded[(x, y)] = moving(corner[0], corner[1]);
            interpolate(&self.rgb, corner, weights)
        });
        (color, excluded)
    }
}

/// The pixel above and left of a place, and how far the place lies beyond it; `None` outside.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "inside the picture by the test before; a weight in [0, 1)"
)]
fn bilinear(at: &Vector2<f64>, (width, height): (usize, usize)) -> Option<([usize; 2], [f32; 2])> {
    let inside =
        at.x >= 0.0 && at.y >= 0.0 && at.x <= width as f64 - 1.0 && at.y <= height as f64 - 1.0;
    inside.then(|| {
        let (x, y) = (at.x as usize, at.y as usize);
        ([x, y], [(at.x - x as f64) as f32, (at.y - y as f64) as f32])
    })
}

fn interpolate(rgb: &RgbImage, [x, y]: [usize; 2], [wx, wy]: [f32; 2]) -> [f32; 3] {
    let (right, below) = ((x + 1).min(rgb.width() - 1), (y + 1).min(rgb.height() - 1));
    let value = |x: usize, y: usize, c: usize| f32::from(rgb[(x, y)][c]) / 255.0;
    [0, 1, 2].map(|c| {
        let top = value(x, y, c) * (1.0 - wx) + value(right, y, c) * wx;
        let bottom = value(x, below, c) * (1.0 - wx) + value(right, below, c) * wx;
        top * (1.0 - wy) + bottom * wy
    })
}

/// The state of training: pictures, optimiser, order of keyframes.
#[derive(Debug)]
pub struct Trainer {
    views: Vec<TrainingView>,
    order: Vec<usize>,
    rng: Rng,
    adam: Groups,
    extent_m: f64,
}

/// One optimiser per kind of parameter.
#[derive(Debug)]
struct Groups {
    means: Adam<f32>,
    log_scales: Adam<f32>,
    quaternions: Adam<f32>,
    opacity_logits: Adam<f32>,
    sh: Adam<f32>,
}

/// What stops training.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum TrainError {
    /// The map could not be drawn, or its gradient not found.
    #[error(transparent)]
    Raster(#[from] RasterError),
    /// A gradient that is not finite.
    #[error(transparent)]
    Optim(#[from] OptimError),
}

/// How one iteration went.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrainStep {
    /// The keyframe trained on.
    pub keyframe: KeyframeId,
    /// Halvings of its picture.
    pub level: usize,
    /// 0.8 L_photometric + 0.2 L_dyn (eq. 12).
    pub loss: f32,
}

impl Trainer {
    /// For these pictures; `extent_m` scales the steps of the means.
    ///
    /// # Errors
    /// [`OptimError`] (none for the settings used here).
    pub fn new(
        views: Vec<TrainingView>,
        map: &GaussianMap,
        extent_m: f64,
        seed: u64,
    ) -> Result<Self, OptimError> {
        let group = |width: usize| Adam::new(AdamConfig::default(), map.len(), width);
        Ok(Self {
            views,
            order: Vec::new(),
            rng: Rng::keyed(seed, &[0x7261_696e]),
            adam: Groups {
                means: group(3)?,
                log_scales: group(3)?,
                quaternions: group(4)?,
                opacity_logits: group(1)?,
                sh: group(3 * map.coefficients())?,
            },
            extent_m,
        })
    }

    /// One iteration on the next keyframe; `None` when there is no picture.
    ///
    /// # Errors
    /// [`TrainError`]; the map is then as it was before the iteration.
    pub fn step(
        &mut self,
        map: &mut GaussianMap,
        pose_of: impl Fn(KeyframeId) -> Se3,
        config: &TrainConfig,
        par: Par,
    ) -> Result<Option<TrainStep>, TrainError> {
        let Some(v) = self.next_view() else {
            return Ok(None);
        };
        let view = &mut self.views[v];
        let level = view.level(config.uses_per_level);
        view.uses += 1;
        let keyframe = view.keyframe;
        let target = view.target(level);
        let pose = pose_of(keyframe);
        let options = RenderOptions {
            include: Include::StaticOnly,
            ..RenderOptions::default()
        };
        let rendered = fast::render(map, &target.camera, &pose, &options, par)?;
        let lambda = config.lambda_ssim;
        let loss = photometric(
            &rendered.color,
            &target.color,
            lambda,
            Some(&target.excluded),
            par,
        )?;
        let weight = to_f32(config.lambda_photometric);
        let upstream = Upstream {
            color: loss.gradient.map(|g| g.map(|v| v * weight)),
            depth: None,
            opacity: None,
        };
        let mut gradients = fast::backward(
            map,
            &target.camera,
            &pose,
            &options,
            &rendered,
            &upstream,
            par,
        )?;
        let mut total = weight * loss.value;
        if map.label.contains(&Label::Dynamic) {
            let weight = to_f32(config.lambda_dynamic);
            let penalty = opacity_penalty(&map.opacity_logits, &map.label)?;
            total += weight * penalty.value;
            for (g, p) in gradients
                .opacity_logits
                .iter_mut()
                .zip(&penalty.opacity_logits)
            {
                *g += weight * p;
            }
        }
        self.update(map, &gradients, &config.rates)?;
        Ok(Some(TrainStep {
            keyframe,
            level,
            loss: total,
        }))
    }

    /// Every keyframe once, in shuffled order, then again.
    fn next_view(&mut self) -> Option<usize> {
        if self.order.is_empty() {
            self.order = (0..self.views.len()).collect();
            for i in (1..self.order.len()).rev() {
                let j = self.rng.below(i + 1);
                self.order.swap(i, j);
            }
        }
        self.order.pop()
    }

    fn update(
        &mut self,
        map: &mut GaussianMap,
        gradients: &Gradients<f32>,
        rate: &RateConfig,
    ) -> Result<(), OptimError> {
        let groups = &mut self.adam;
        let mean_rate = rate.mean * self.extent_m;
        groups.means.step(
            map.means.as_flattened_mut(),
            gradients.means.as_flattened(),
            mean_rate,
        )?;
        groups.log_scales.step(
            map.log_scales.as_flattened_mut(),
            gradients.log_scales.as_flattened(),
            rate.log_scale,
        )?;
        groups.quaternions.step(
            map.quaternions.as_flattened_mut(),
            gradients.quaternions.as_flattened(),
            rate.quaternion,
        )?;
        groups.opacity_logits.step(
            &mut map.opacity_logits,
            &gradients.opacity_logits,
            rate.opacity_logit,
        )?;
        groups.sh.step(
            map.sh.as_flattened_mut(),
            gradients.sh.as_flattened(),
            rate.sh,
        )
    }
}

#[allow(clippy::cast_possible_truncation, reason = "the map is f32 by design")]
fn to_f32(v: f64) -> f32 {
    v as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(k1: f64) -> Camera {
        let mut camera = Camera::pinhole((32, 24), [30.0, 30.0, 15.5, 11.5]).expect("valid");
        camera.distortion.k1 = k1;
        camera
    }

    #[test]
    fn levels_run_from_coarse_to_fine() {
        let rgb = RgbImage::new(32, 24, [51, 102, 255]);
        let mut view = TrainingView::new(KeyframeId(0), &camera(0.0), rgb, None, 0);
        let levels = [0, 7, 8, 15, 16, 99].map(|uses| {
            view.uses = uses;
            view.level(8)
        });
        assert_eq!(levels, [2, 2, 1, 1, 0, 0], "eight uses each, then whole");
        let target = view.target(2);
        assert_eq!(target.color.size(), (8, 6), "a quarter");
        assert_eq!(target.camera, camera(0.0).level(2), "with its camera");
        assert!((target.color[(3, 3)][0] - 0.2).abs() < 1e-6, "51 of 255");
        assert!(
            target.excluded.data().iter().all(|m| *m == 0),
            "all of it counts"
        );
    }

    /// A picture whose red is the column: undistorted, a pixel holds the column it was seen at.
    #[test]
    fn a_bent_picture_is_straightened() {
        let camera = camera(0.2);
        let rgb = RgbImage::from_fn(32, 24, |x, _| [u8::try_from(8 * x).expect("small"); 3]);
        let view = TrainingView::new(KeyframeId(0), &camera, rgb, None, 0);
        let target = view.target(0);
        let seen_at = camera.distort_pixel(&Vector2::new(20.0, 6.0));
        let expected = 8.0 * seen_at.x / 255.0;
        let found = f64::from(target.color[(20, 6)][0]);
        assert!(
            (found - expected).abs() < 1e-5,
            "{found} against {expected}"
        );
        assert_eq!(target.excluded[(20, 6)], 0, "it was seen");
        assert_eq!(target.excluded[(0, 0)], 255, "bent out of the picture");
        assert!(target.camera.distortion.is_none(), "a pinhole from here on");
    }

    #[test]
    fn moving_pixels_and_their_surroundings_are_left_out() {
        let mut mask = MaskImage::new(32, 24, 0);
        mask[(16, 12)] = 255;
        let rgb = RgbImage::new(32, 24, [0; 3]);
        let view = TrainingView::new(KeyframeId(0), &camera(0.0), rgb, Some(&mask), 2);
        let excluded = view.target(0).excluded;
        let count = excluded.data().iter().filter(|m| **m != 0).count();
        assert_eq!(count, 25, "a square of 5");
        assert_eq!(
            (excluded[(18, 14)], excluded[(19, 12)]),
            (255, 0),
            "its corner, beside it"
        );
        let quarter = view.target(2).excluded;
        assert_eq!(
            quarter[(4, 3)],
            255,
            "anything mixed with it, at coarse levels too"
        );
        assert_eq!(quarter[(0, 0)], 0, "but not far away");
    }
}
