//! The map learns the pictures: one training iteration, and which keyframe is next
//! (design section 5, point 6; paper eq. 12, 13, 15, 16).
//!
//! ```text
//! schedule ─ keyframe, level ─→ render (static Gaussians) ─→ photometric loss ─→ backward ─→ Adam
//! ```

use garad_core::pyramid::halve_real;
use garad_core::{
    Camera, GaussianMap, Image, KeyframeId, Label, MaskImage, Par, RgbImage, Rng, Se3,
};
use garad_optim::{Adam, AdamConfig, OptimError};
use garad_raster::losses::{opacity_penalty, photometric};
use garad_raster::{Gradients, Include, RasterError, RenderOptions, Upstream, backward, render};
use nalgebra::Vector2;
use thiserror::Error;

use crate::config::{RateConfig, TrainConfig};

/// Halvings of the coarsest picture (n = 2: three levels, eq. 16).
const TOP_LEVEL: usize = 2;

/// A keyframe's picture at every level, ready to be compared with.
#[derive(Debug, Clone)]
pub struct TrainingView {
    /// The keyframe.
    pub keyframe: KeyframeId,
    levels: Vec<Target>,
    uses: usize,
}

#[derive(Debug, Clone)]
struct Target {
    camera: Camera,
    color: Image<[f32; 3]>,
    /// Not 0 where the picture says nothing: something moves, or no pixel was seen.
    excluded: MaskImage,
}

impl TrainingView {
    /// Undistorts a picture and halves it twice (eq. 16). Pixels within `dilate_px` of something
    /// that moves are left out of the loss.
    #[must_use]
    pub fn new(
        keyframe: KeyframeId,
        camera: &Camera,
        rgb: &RgbImage,
        mask: Option<&MaskImage>,
        dilate_px: usize,
    ) -> Self {
        let (mut color, mut excluded) = undistorted(camera, rgb, mask, dilate_px);
        let mut levels = Vec::with_capacity(TOP_LEVEL + 1);
        for level in 0..=TOP_LEVEL {
            if level > 0 {
                color = halve_real(&color);
                excluded = halve_mask(&excluded);
            }
            let camera = Camera {
                distortion: garad_core::Distortion::default(),
                ..camera.level(level)
            };
            levels.push(Target {
                camera,
                color: color.clone(),
                excluded: excluded.clone(),
            });
        }
        Self {
            keyframe,
            levels,
            uses: 0,
        }
    }

    /// Coarse first: `per_level` uses at each coarser level, then full size.
    fn level(&self, per_level: usize) -> usize {
        TOP_LEVEL.saturating_sub(self.uses / per_level.max(1))
    }
}

/// What a pinhole would have seen, in [0, 1], and where it says nothing.
fn undistorted(
    camera: &Camera,
    rgb: &RgbImage,
    mask: Option<&MaskImage>,
    dilate_px: usize,
) -> (Image<[f32; 3]>, MaskImage) {
    let (width, height) = rgb.size();
    let mut excluded = MaskImage::new(width, height, 0);
    let color = Image::from_fn(width, height, |x, y| {
        let seen_at = camera.distort_pixel(&Vector2::new(x as f64, y as f64));
        let sample = bilinear(rgb, &seen_at);
        if sample.is_none() || mask.is_some_and(|m| moves_near(m, &seen_at, dilate_px)) {
            excluded[(x, y)] = 255;
        }
        sample.unwrap_or([0.0; 3])
    });
    (color, excluded)
}

/// The picture between its pixels; `None` outside.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "inside the picture by the test before; a weight in [0, 1)"
)]
fn bilinear(rgb: &RgbImage, at: &Vector2<f64>) -> Option<[f32; 3]> {
    let (last_x, last_y) = (rgb.width() - 1, rgb.height() - 1);
    let inside = at.x >= 0.0 && at.y >= 0.0 && at.x <= last_x as f64 && at.y <= last_y as f64;
    if !inside {
        return None;
    }
    let (x, y) = (at.x as usize, at.y as usize);
    let (wx, wy) = ((at.x - x as f64) as f32, (at.y - y as f64) as f32);
    let (right, below) = ((x + 1).min(last_x), (y + 1).min(last_y));
    let value = |x: usize, y: usize, c: usize| f32::from(rgb[(x, y)][c]) / 255.0;
    Some([0, 1, 2].map(|c| {
        let top = value(x, y, c) * (1.0 - wx) + value(right, y, c) * wx;
        let bottom = value(x, below, c) * (1.0 - wx) + value(right, below, c) * wx;
        top * (1.0 - wy) + bottom * wy
    }))
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "float to integer saturates; the ranges are cut to the picture"
)]
fn moves_near(mask: &MaskImage, at: &Vector2<f64>, radius: usize) -> bool {
    let (x, y) = ((at.x + 0.5) as usize, (at.y + 0.5) as usize);
    let (last_x, last_y) = (mask.width() - 1, mask.height() - 1);
    let columns = x.saturating_sub(radius).min(last_x)..=(x + radius).min(last_x);
    (y.saturating_sub(radius).min(last_y)..=(y + radius).min(last_y))
        .any(|y| mask.row(y)[columns.clone()].contains(&255))
}

/// Left out if any of the pixels that the 5-tap filter mixes is.
fn halve_mask(mask: &MaskImage) -> MaskImage {
    let (width, height) = (mask.width().div_ceil(2), mask.height().div_ceil(2));
    Image::from_fn(width, height, |x, y| {
        let near = |c: usize, last: usize| (2 * c).saturating_sub(2)..=(2 * c + 2).min(last);
        let columns = near(x, mask.width() - 1);
        let any = near(y, mask.height() - 1)
            .any(|y| mask.row(y)[columns.clone()].iter().any(|m| *m != 0));
        if any { 255 } else { 0 }
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
        let target = &view.levels[level];
        let pose = pose_of(keyframe);
        let options = RenderOptions {
            include: Include::StaticOnly,
            ..RenderOptions::default()
        };
        let rendered = render(map, &target.camera, &pose, &options, par)?;
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
        let mut gradients = backward(
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
