//! [`Trainer`]: one training iteration, and the choice of the view (paper eq. 12, 13, 15, 16; decision
//! 006).
//!
//! ```text
//! view, level (eq. 16) ─→ render static Gaussians (eq. 15) ─→ loss (eq. 12) ─→ backward ─→ Adam ─→ densify
//! ```

use std::io::{Read, Write};

use garad_core::undistort::Undistortion;
use garad_core::{Camera, GaussianMap, KeyframeId, Par, Real, Rng, Se3};
use garad_crf::LabelWindow;
use garad_optim::{Adam, AdamConfig, OptimError, sgd};
use garad_raster::{Gradients, Include, RenderOptions, fast};
use serde::{Deserialize, Serialize};

use super::densify::{Densifier, densify, faded, too_large};
use super::error::TrainError;
use super::loss::training_loss;
use super::view::{TrainingView, least_needed};
use super::view_mask::LaterView;
use crate::config::{
    DensifyConfig, DynamicWeight, LabelConfig, Optimiser, RateConfig, TrainConfig,
};
use crate::session::sections::{SectionReader, SectionWriter, SessionError};
use crate::trace::Recorder;

/// The state of training: views, their order, optimiser.
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

/// Which keyframe an iteration trains on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pick {
    /// The newest keyframe.
    Youngest,
    /// The next in a shuffled order of all, repeated.
    Shuffled,
}

/// The outcome of one iteration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrainStep {
    /// The keyframe trained on.
    pub keyframe: KeyframeId,
    /// Halvings of its image.
    pub level: usize,
    /// Eq. 12.
    pub loss: f32,
    /// Gaussians after the iteration.
    pub gaussians: usize,
}

/// What training reads of the camera's path, and of the labels' retention.
#[derive(Debug, Clone, Copy)]
pub struct TrainingScene<'a> {
    /// camera_from_world of every keyframe.
    pub poses: &'a [Se3],
    /// Extent of the path: it scales the steps of the means and says which Gaussians are large.
    pub extent_m: f64,
    /// n of eq. 7.
    pub window_runs: u32,
}

/// [`DynamicWeight::BeliefAndAge`]: dynamic runs among the last n, over n.
fn belief_and_age(windows: &[LabelWindow], n: u32) -> Vec<f32> {
    let share = |window: &LabelWindow| f64::from(window.dynamic_runs(n)) / f64::from(n);
    windows.iter().map(|w| share(w).to_f32()).collect()
}

impl Trainer {
    /// No view yet; every random draw follows from `seed`.
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

    /// Reads what [`Trainer::save`] wrote, into a trainer made for the same camera.
    pub(super) fn load<R: Read>(
        &mut self,
        from: &mut SectionReader<R>,
    ) -> Result<(), SessionError> {
        let views: usize = from.take("views")?;
        let view = |_| from.take("view");
        self.views = (0..views).map(view).collect::<Result<_, _>>()?;
        self.order = from.take("order")?;
        self.rng = from.take("rng")?;
        self.seed = from.take("train_seed")?;
        self.groups = from.take("groups")?;
        self.windows = from.take("windows")?;
        self.densifier = from.take("densifier")?;
        self.iterations = from.take("iterations")?;
        Ok(())
    }

    /// Adds a view.
    pub fn add_view(&mut self, view: TrainingView) {
        self.views.push(view);
    }

    /// Excludes from every view what a later keyframe shows to be free space.
    pub(super) fn mask_freed_space(
        &mut self,
        later: &LaterView<'_>,
        poses: &[Se3],
        camera: &Camera,
        config: &LabelConfig,
    ) {
        for view in &mut self.views {
            let pose = &poses[view.keyframe.index()];
            view.mask_freed_space(pose, later, camera, config);
        }
    }

    /// Drops views until there are no more than `most`.
    pub(super) fn thin_views(&mut self, most: usize, poses: &[Se3]) {
        while self.views.len() > most {
            let views = self.views.iter().map(|v| poses[v.keyframe.index()]);
            let Some(gone) = least_needed(&views.collect::<Vec<_>>()) else {
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

    /// Views kept.
    #[must_use]
    pub fn views(&self) -> usize {
        self.views.len()
    }

    /// One iteration; `None` without a view or a Gaussian. Without `densify` no Gaussian is cloned,
    /// split or pruned.
    ///
    /// # Errors
    /// [`TrainError`]; the map is then as it was before the iteration.
    pub fn step(
        &mut self,
        map: &mut GaussianMap,
        pick: Pick,
        scene: TrainingScene<'_>,
        config: &TrainConfig,
        densify: Option<&DensifyConfig>,
        par: Par,
        recorder: &mut Recorder,
    ) -> Result<Option<TrainStep>, TrainError> {
        if map.is_empty() {
            return Ok(None);
        }
        let Some(v) = self.next_view(pick) else {
            return Ok(None);
        };
        self.sync_optimiser(map, config)?;
        let view = &mut self.views[v];
        let keyframe = view.keyframe;
        let level = view.next_level(config.uses_per_level);
        let target = view.target(&self.camera, &self.straight, level, par);
        let pose = scene.poses[keyframe.index()];
        let options = RenderOptions {
            include: Include::StaticOnly,
            ..RenderOptions::default()
        };
        let camera = &target.camera;
        let rendered = fast::render(map, camera, &pose, &options, par)?;
        let weights = match config.dynamic_weight {
            DynamicWeight::Uniform => None,
            DynamicWeight::BeliefAndAge => Some(belief_and_age(&self.windows, scene.window_runs)),
        };
        let loss = training_loss(&rendered, &target, map, weights.as_deref(), config, par)?;
        let upstream = &loss.upstream;
        let mut gradients = fast::backward(map, camera, &pose, &options, &rendered, upstream, par)?;
        if let Some(penalty) = loss.opacity_logits {
            for (g, p) in gradients.opacity_logits.iter_mut().zip(penalty) {
                *g += p;
            }
        }
        recorder.record("train", |record| {
            let target = (&target.color, target.depth.as_ref(), &target.excluded);
            let rendered = (&rendered.color, &rendered.depth, &rendered.opacity);
            record.training((keyframe.0, level), &pose, target, rendered, loss.value);
        });
        self.update(map, &gradients, scene.extent_m, config)?;
        self.iterations += 1;
        if let Some(densify) = densify {
            self.densifier
                .add(&gradients.means2d, &rendered.radii, camera);
            if self.iterations.is_multiple_of(densify.every) {
                self.densify_and_prune(map, scene.extent_m, densify);
            }
        }
        Ok(Some(TrainStep {
            keyframe,
            level,
            loss: loss.value,
            gaussians: map.len(),
        }))
    }

    /// Prunes the static Gaussians that have faded.
    pub fn prune(&mut self, map: &mut GaussianMap, min_opacity: f64) {
        let keep = faded(map, min_opacity).into_iter().map(|f| !f);
        self.retain(map, &keep.collect::<Vec<_>>());
    }

    fn densify_and_prune(&mut self, map: &mut GaussianMap, extent_m: f64, config: &DensifyConfig) {
        let mut rng = Rng::keyed(self.seed, &[0x6772_6f77, self.iterations as u64]);
        let newest = self.views.last().map_or(0, |view| view.keyframe.0);
        let young_from = KeyframeId(newest.saturating_sub(config.young_keyframes));
        let accumulated = &self.densifier;
        let split = densify(map, accumulated, extent_m, young_from, config, &mut rng);
        self.densifier = Densifier::default();
        let before = self.windows.len();
        self.extend(map.len());
        for i in before..map.len() {
            // Clones and children inherit their parent's window.
            if let Some(parent) = map.parent[i] {
                self.windows[i] = self.windows[parent as usize];
            }
        }
        let faded = faded(map, config.min_opacity);
        let large = match config.prune_large {
            true => too_large(map, extent_m),
            false => vec![false; map.len()],
        };
        let keep: Vec<bool> = (0..map.len())
            .map(|i| !faded[i] && !large[i] && !split.get(i).copied().unwrap_or(false))
            .collect();
        self.retain(map, &keep);
    }

    /// Adds state for what was inserted, and for a new degree of the colours.
    fn sync_optimiser(
        &mut self,
        map: &mut GaussianMap,
        config: &TrainConfig,
    ) -> Result<(), OptimError> {
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
    /// # Panics
    /// Unless there is a decision for every Gaussian.
    pub fn retain(&mut self, map: &mut GaussianMap, keep: &[bool]) {
        assert_eq!(keep.len(), map.len(), "a decision per Gaussian");
        self.extend(map.len());
        for group in self.groups.each_mut() {
            group.retain(keep).expect("a row per Gaussian");
        }
        let mut kept = keep.iter();
        self.windows
            .retain(|_| kept.next().copied().unwrap_or(true));
        self.densifier.retain(keep);
        map.retain(|i| keep[i]);
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
