//! The map learns the pictures: one training iteration, and which keyframe is next
//! (paper eq. 12, 13, 15, 16; decision 006).
//!
//! ```text
//! keyframe, level ─→ render (static Gaussians) ─→ loss ─→ backward ─→ Adam ─→ clone, split, prune
//! ```

use std::io::{Read, Write};

use garad_core::undistort::Undistortion;
use garad_core::{Camera, GaussianMap, KeyframeId, Label, Par, Rng, Se3};
use garad_crf::LabelWindow;
use garad_optim::{Adam, AdamConfig, OptimError, sgd};
use garad_raster::losses::{depth_l1, opacity_penalty, photometric};
use garad_raster::{Gradients, Include, RasterError, RenderOptions, Upstream, fast};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::densify::{Densifier, densify, faded};
use super::hindsight::Later;
use super::view::{TrainingView, least_needed};
use crate::config::LabelConfig;
use crate::config::{DensifyConfig, Optimiser, RateConfig, TrainConfig};
use crate::session::{SectionReader, SectionWriter, SessionError};
use crate::trace::Tape;

/// Rendered opacity from which a pixel's depth is judged.
const DEPTH_MIN_OPACITY: f64 = 0.5;

/// The state of training: pictures, optimiser, order of keyframes.
#[derive(Debug)]
pub struct Trainer {
    camera: Camera,
    straight: Undistortion,
    views: Vec<TrainingView>,
    order: Vec<usize>,
    rng: Rng,
    seed: u64,
    groups: Groups,
    /// Labels of the last runs of each Gaussian (eq. 7).
    windows: Vec<LabelWindow>,
    densifier: Densifier,
    iterations: usize,
    pub(super) tape: Tape,
}

/// One optimiser per kind of parameter.
#[derive(Debug, Serialize, Deserialize)]
struct Groups {
    means: Adam<f32>,
    log_scales: Adam<f32>,
    quaternions: Adam<f32>,
    opacity_logits: Adam<f32>,
    sh: Adam<f32>,
}

impl Groups {
    fn each_mut(&mut self) -> [&mut Adam<f32>; 5] {
        [
            &mut self.means,
            &mut self.log_scales,
            &mut self.quaternions,
            &mut self.opacity_logits,
            &mut self.sh,
        ]
    }
}

/// One group about to take a step.
struct Step<'a> {
    parameters: &'a mut [f32],
    gradient: &'a [f32],
    adam: &'a mut Adam<f32>,
    /// One per column.
    rates: Vec<f64>,
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

/// Which keyframe an iteration trains on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pick {
    /// The youngest: what the map knows least about.
    Youngest,
    /// The next of all, each once in shuffled order, then again.
    Shuffled,
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
    /// Gaussians after the iteration.
    pub gaussians: usize,
}

impl Trainer {
    /// Nothing to learn from yet; every random draw follows from `seed`.
    ///
    /// # Errors
    /// [`OptimError`] (none for the settings used here).
    pub fn new(camera: &Camera, seed: u64) -> Result<Self, OptimError> {
        let group = |width: usize| Adam::new(AdamConfig::default(), 0, width);
        Ok(Self {
            camera: *camera,
            straight: Undistortion::new(camera),
            views: Vec::new(),
            order: Vec::new(),
            rng: Rng::keyed(seed, &[0x7261_696e]),
            seed,
            groups: Groups {
                means: group(3)?,
                log_scales: group(3)?,
                quaternions: group(4)?,
                opacity_logits: group(1)?,
                sh: group(3)?,
            },
            windows: Vec::new(),
            densifier: Densifier::default(),
            iterations: 0,
            tape: Tape::default(),
        })
    }

    pub(super) fn save<W: Write>(&self, to: &mut SectionWriter<W>) -> Result<(), SessionError> {
        let Self {
            camera: _,
            straight: _, // from the camera
            views,
            order,
            rng,
            seed,
            groups,
            windows,
            densifier,
            iterations,
            tape: _,
        } = self;
        to.put("views", &views.len())?;
        for view in views {
            to.put("view", view)?; // one by one: together they are the largest part of a session
        }
        to.put("order", order)?;
        to.put("rng", rng)?;
        to.put("train_seed", seed)?;
        to.put("groups", groups)?;
        to.put("windows", windows)?;
        to.put("densifier", densifier)?;
        to.put("iterations", iterations)
    }

    /// Into a trainer made for the same camera.
    pub(super) fn load<R: Read>(
        &mut self,
        from: &mut SectionReader<R>,
    ) -> Result<(), SessionError> {
        let Self {
            camera: _,
            straight: _,
            views,
            order,
            rng,
            seed,
            groups,
            windows,
            densifier,
            iterations,
            tape: _,
        } = self;
        let count: usize = from.take("views")?;
        *views = (0..count)
            .map(|_| from.take("view"))
            .collect::<Result<_, _>>()?;
        *order = from.take("order")?;
        *rng = from.take("rng")?;
        *seed = from.take("train_seed")?;
        *groups = from.take("groups")?;
        *windows = from.take("windows")?;
        *densifier = from.take("densifier")?;
        *iterations = from.take("iterations")?;
        Ok(())
    }

    /// One more picture to learn from.
    pub fn add_view(&mut self, view: TrainingView) {
        self.views.push(view);
    }

    /// Tells every view what a later keyframe sees through there.
    pub(super) fn look_back(
        &mut self,
        later: &Later<'_>,
        camera: &Camera,
        config: &LabelConfig,
        pose_of: impl Fn(KeyframeId) -> Se3,
    ) {
        for view in &mut self.views {
            view.look_back(&pose_of(view.keyframe), later, camera, config);
        }
    }

    /// Lets pictures go until there are no more than `most`.
    pub(super) fn thin_views(&mut self, most: usize, pose_of: impl Fn(KeyframeId) -> Se3) {
        while self.views.len() > most {
            let poses: Vec<_> = self.views.iter().map(|v| pose_of(v.keyframe)).collect();
            let Some(gone) = least_needed(&poses) else {
                return;
            };
            self.views.remove(gone);
            self.order.retain(|v| *v != gone);
            for v in self.order.iter_mut().filter(|v| **v > gone) {
                *v -= 1;
            }
        }
    }

    /// The label windows, one per Gaussian of the map.
    pub fn windows(&mut self, map: &GaussianMap) -> &mut [LabelWindow] {
        self.extend(map.len());
        &mut self.windows
    }

    /// Pictures so far.
    #[must_use]
    pub fn views(&self) -> usize {
        self.views.len()
    }

    /// One iteration; `None` when there is no picture or no Gaussian. `extent_m` is the size of the
    /// camera's path: it scales the steps of the means and says which Gaussians are large. Without
    /// `grow` none is cloned, split or dropped.
    ///
    /// # Errors
    /// [`TrainError`]; the map is then as it was before the iteration.
    pub fn step(
        &mut self,
        map: &mut GaussianMap,
        pick: Pick,
        pose_of: impl Fn(KeyframeId) -> Se3,
        extent_m: f64,
        config: &TrainConfig,
        grow: Option<&DensifyConfig>,
        par: Par,
    ) -> Result<Option<TrainStep>, TrainError> {
        if map.is_empty() {
            return Ok(None);
        }
        let Some(v) = self.next_view(pick) else {
            return Ok(None);
        };
        self.follow(map, config)?;
        let view = &mut self.views[v];
        let keyframe = view.keyframe;
        let level = view.next_level(config.uses_per_level);
        let target = view.target(&self.camera, &self.straight, level, par);
        let pose = pose_of(keyframe);
        let options = RenderOptions {
            include: Include::StaticOnly,
            ..RenderOptions::default()
        };
        let rendered = fast::render(map, &target.camera, &pose, &options, par)?;
        let excluded = Some(&target.excluded);
        let lambda = config.lambda_ssim;
        let photo = photometric(&rendered.color, &target.color, lambda, excluded, par)?;
        let weight = to_f32(config.lambda_photometric);
        let mut loss = weight * photo.value;
        let mut upstream = Upstream {
            color: photo.gradient.map(|g| g.map(|v| v * weight)),
            depth: None,
            opacity: None,
        };
        if let Some(measured) = &target.depth {
            let weight = to_f32(config.lambda_depth);
            let depth = depth_l1(
                &rendered.depth,
                &rendered.opacity,
                measured,
                DEPTH_MIN_OPACITY,
                excluded,
            )?;
            loss += weight * depth.value;
            upstream.depth = Some(depth.depth.map(|g| g * weight));
            upstream.opacity = Some(depth.opacity.map(|g| g * weight));
        }
        let camera = &target.camera;
        let mut gradients =
            fast::backward(map, camera, &pose, &options, &rendered, &upstream, par)?;
        if map.label.contains(&Label::Dynamic) {
            let weight = to_f32(config.lambda_dynamic);
            let penalty = opacity_penalty(&map.opacity_logits, &map.label)?;
            loss += weight * penalty.value;
            let pulls = penalty.opacity_logits.iter();
            for (g, p) in gradients.opacity_logits.iter_mut().zip(pulls) {
                *g += weight * p;
            }
        }
        self.tape.put("train", |page| {
            let target = (&target.color, target.depth.as_ref(), &target.excluded);
            let drawn = (&rendered.color, &rendered.depth, &rendered.opacity);
            page.training((keyframe.0, level), &pose, target, drawn, loss);
        });
        self.update(map, &gradients, extent_m, config)?;
        self.iterations += 1;
        if let Some(grow) = grow {
            self.densifier
                .watch(&gradients.means2d, &rendered.radii, camera);
            if self.iterations.is_multiple_of(grow.every) {
                self.grow_and_prune(map, extent_m, grow)?;
            }
        }
        Ok(Some(TrainStep {
            keyframe,
            level,
            loss,
            gaussians: map.len(),
        }))
    }

    /// Drops the Gaussians that have faded. Those that move are left to their labels.
    ///
    /// # Errors
    /// [`TrainError::Optim`] (none as long as the trainer follows one map).
    pub fn prune(&mut self, map: &mut GaussianMap, min_opacity: f64) -> Result<(), TrainError> {
        let keep = faded(map, min_opacity).into_iter().map(|f| !f);
        self.retain(map, &keep.collect::<Vec<_>>())
    }

    fn grow_and_prune(
        &mut self,
        map: &mut GaussianMap,
        extent_m: f64,
        config: &DensifyConfig,
    ) -> Result<(), TrainError> {
        let mut rng = Rng::keyed(self.seed, &[0x6772_6f77, self.iterations as u64]);
        let newest = self.views.last().map_or(0, |view| view.keyframe.0);
        let young_from = KeyframeId(newest.saturating_sub(config.young_keyframes));
        let watched = &self.densifier;
        let split = densify(map, watched, extent_m, young_from, config, &mut rng);
        self.densifier = Densifier::default();
        let before = self.windows.len();
        self.extend(map.len());
        for i in before..map.len() {
            // Clones and children inherit what is known of their parent.
            if let Some(parent) = map.parent[i] {
                self.windows[i] = self.windows[parent as usize];
            }
        }
        let faded = faded(map, config.min_opacity);
        let keep: Vec<bool> = (0..map.len())
            .map(|i| !faded[i] && !split.get(i).copied().unwrap_or(false))
            .collect();
        self.retain(map, &keep)
    }

    /// The optimiser follows what was inserted, and colours that gained a degree.
    fn follow(&mut self, map: &mut GaussianMap, config: &TrainConfig) -> Result<(), OptimError> {
        let degree = self
            .iterations
            .checked_div(config.sh_every)
            .unwrap_or(config.sh_degree);
        map.raise_sh_degree(degree.min(config.sh_degree));
        self.groups.sh.widen(3 * map.coefficients())?;
        self.extend(map.len());
        Ok(())
    }

    fn extend(&mut self, rows: usize) {
        let new = rows.saturating_sub(self.groups.means.rows());
        self.windows
            .resize(rows.max(self.windows.len()), LabelWindow::default());
        for group in self.groups.each_mut() {
            group.extend(new);
        }
    }

    /// Keeps these Gaussians, in the map and in the optimiser.
    ///
    /// # Errors
    /// [`TrainError::Optim`] unless there is a decision for every Gaussian.
    pub fn retain(&mut self, map: &mut GaussianMap, keep: &[bool]) -> Result<(), TrainError> {
        self.extend(map.len());
        for group in self.groups.each_mut() {
            group.retain(keep)?;
        }
        let mut kept = keep.iter();
        self.windows
            .retain(|_| kept.next().copied().unwrap_or(true));
        self.densifier.retain(keep);
        map.retain(|i| keep[i]);
        Ok(())
    }

    fn next_view(&mut self, pick: Pick) -> Option<usize> {
        if pick == Pick::Youngest {
            return self.views.len().checked_sub(1);
        }
        if self.order.is_empty() {
            self.order = (0..self.views.len()).collect();
            for i in (1..self.order.len()).rev() {
                let j = self.rng.below(i + 1);
                self.order.swap(i, j);
            }
        }
        self.order.pop()
    }

    /// One step of every group, or of none.
    fn update(
        &mut self,
        map: &mut GaussianMap,
        gradients: &Gradients<f32>,
        extent_m: f64,
        config: &TrainConfig,
    ) -> Result<(), OptimError> {
        let RateConfig {
            mean,
            log_scale,
            quaternion,
            opacity_logit,
            sh,
            sh_rest_divisor,
        } = config.rates;
        let groups = &mut self.groups;
        let mut sh_rates = vec![sh / sh_rest_divisor; 3 * map.coefficients()];
        sh_rates[..3].fill(sh);
        let group = |parameters, gradient, adam, rates| Step {
            parameters,
            gradient,
            adam,
            rates,
        };
        let means = vec![mean * extent_m; 3];
        #[rustfmt::skip]
        let steps = [
            group(map.means.as_flattened_mut(), gradients.means.as_flattened(),
                  &mut groups.means, means),
            group(map.log_scales.as_flattened_mut(), gradients.log_scales.as_flattened(),
                  &mut groups.log_scales, vec![log_scale; 3]),
            group(map.quaternions.as_flattened_mut(), gradients.quaternions.as_flattened(),
                  &mut groups.quaternions, vec![quaternion; 4]),
            group(&mut map.opacity_logits, &gradients.opacity_logits,
                  &mut groups.opacity_logits, vec![opacity_logit]),
            group(map.sh.as_flattened_mut(), gradients.sh.as_flattened(), &mut groups.sh, sh_rates),
        ];
        let bad = |step: &Step<'_>| step.gradient.iter().position(|g| !g.is_finite());
        if let Some(index) = steps.iter().find_map(bad) {
            return Err(OptimError::NotFinite {
                what: "gradient",
                index,
            });
        }
        for step in steps {
            match config.optimiser {
                Optimiser::Adam => {
                    step.adam
                        .step_by_column(step.parameters, step.gradient, &step.rates)?;
                }
                Optimiser::Sgd => sgd(step.parameters, step.gradient, step.rates[0])?,
            }
        }
        Ok(())
    }
}

#[allow(clippy::cast_possible_truncation, reason = "the map is f32 by design")]
fn to_f32(v: f64) -> f32 {
    v as f32
}
