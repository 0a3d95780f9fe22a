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
use garad_optim::{AdamConfig, OptimError};
use garad_raster::Gradients;
use nalgebra::Vector3;

use super::densify::{Densifier, densify, faded, too_large};
use super::error::TrainError;
use super::iteration::{Engine, Iteration, iterate};
use super::loss::TargetImages;
use super::optimiser::{GroupRates, ParameterGroups};
use super::view::{TrainingView, least_needed};
use super::view_mask::LaterView;
use crate::config::{DensifyConfig, DynamicWeight, LabelConfig, TrainConfig};
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
    groups: ParameterGroups<f32>,
    /// Labels of the last runs of each Gaussian (eq. 7).
    windows: Vec<LabelWindow>,
    densifier: Densifier,
    iterations: usize,
}

/// Which keyframe an iteration trains on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pick {
    /// The newest keyframe.
    Youngest,
    /// The next in a shuffled order of all, repeated.
    Shuffled,
}

impl Pick {
    /// Of iteration `i` of a job, from 0: every second one trains on the newest keyframe, which the map knows least
    /// about.
    #[must_use]
    pub fn beside_tracking(i: usize) -> Self {
        match i % 2 {
            0 => Self::Youngest,
            _ => Self::Shuffled,
        }
    }
}

/// What an iteration trains on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Picked {
    /// Index of the view among those kept.
    view: usize,
    /// Its keyframe.
    pub keyframe: KeyframeId,
    /// Halvings of its image.
    pub level: usize,
}

/// A map compared with a view.
#[derive(Debug)]
pub struct Compared {
    /// Eq. 12.
    pub loss: f32,
    /// Its gradient.
    pub gradients: Gradients<f32>,
    /// Per Gaussian, in pixels; 0 where it was not rendered.
    pub radii: Vec<i32>,
}

/// What training keeps of each Gaussian beside the map: a row per Gaussian it was trained with.
#[derive(Debug, Clone, Copy)]
pub struct TrainingState<'a> {
    /// Moments of the parameters.
    pub groups: &'a ParameterGroups<f32>,
    /// Labels of the last runs (eq. 7).
    pub windows: &'a [LabelWindow],
    /// Σ |∂L/∂(NDC x, y)| since the last densification, ...
    pub gradient: &'a [f32],
    /// ... and the number of iterations that rendered it.
    pub seen: &'a [u32],
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

/// Extent of the camera's path: 1.1 times the largest distance of a keyframe from their mean, at
/// least a metre.
#[must_use]
pub fn extent_m(camera_from_world: &[Se3]) -> f64 {
    let centers: Vec<Vector3<f64>> = camera_from_world
        .iter()
        .map(|pose| pose.inverse().translation)
        .collect();
    let n = centers.len().max(1) as f64;
    let mean = centers.iter().fold(Vector3::zeros(), |sum, c| sum + c / n);
    let radius = centers
        .iter()
        .map(|c| (c - mean).norm())
        .fold(0.0, f64::max);
    (1.1 * radius).max(1.0)
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
        Ok(Self {
            camera: *camera,
            straight: Undistortion::new(camera),
            views: Vec::new(),
            order: Vec::new(),
            rng: Rng::keyed(seed, &[0x7261_696e]),
            seed,
            groups: ParameterGroups::new(AdamConfig::default())?,
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
    pub fn thin_views(&mut self, most: usize, poses: &[Se3]) {
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

    /// The keyframes of the views kept, oldest first.
    pub fn view_keyframes(&self) -> impl Iterator<Item = KeyframeId> {
        self.views.iter().map(|view| view.keyframe)
    }

    #[cfg(test)]
    pub(super) fn view(&self, i: usize) -> &TrainingView {
        &self.views[i]
    }

    /// What training keeps of each Gaussian.
    #[must_use]
    pub fn state(&self) -> TrainingState<'_> {
        let (gradient, seen) = self.densifier.sums();
        TrainingState {
            groups: &self.groups,
            windows: &self.windows,
            gradient,
            seen,
        }
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
        let compare = |trainer: &Self, map: &GaussianMap, picked, recorder: &mut Recorder| {
            trainer.compare(map, picked, scene, config, par, recorder)
        };
        self.recorded_step_by(map, pick, scene, config, densify, recorder, compare)
    }

    /// [`Trainer::step`] with loss and gradient from anywhere: everything of an iteration but the renderer.
    ///
    /// Golden: `train_run/*`.
    ///
    /// # Errors
    /// Those of `compare`; [`OptimError`] for a gradient that is not finite. The map is then as it was before the
    /// iteration.
    pub fn step_by(
        &mut self,
        map: &mut GaussianMap,
        pick: Pick,
        scene: TrainingScene<'_>,
        config: &TrainConfig,
        densify: Option<&DensifyConfig>,
        compare: impl FnOnce(&Self, &GaussianMap, Picked) -> Result<Compared, TrainError>,
    ) -> Result<Option<TrainStep>, TrainError> {
        let recorder = &mut Recorder::default();
        let compare = |trainer: &Self, map: &GaussianMap, picked, _: &mut Recorder| {
            compare(trainer, map, picked)
        };
        self.recorded_step_by(map, pick, scene, config, densify, recorder, compare)
    }

    fn recorded_step_by(
        &mut self,
        map: &mut GaussianMap,
        pick: Pick,
        scene: TrainingScene<'_>,
        config: &TrainConfig,
        densify: Option<&DensifyConfig>,
        recorder: &mut Recorder,
        compare: impl FnOnce(&Self, &GaussianMap, Picked, &mut Recorder) -> Result<Compared, TrainError>,
    ) -> Result<Option<TrainStep>, TrainError> {
        if map.is_empty() {
            return Ok(None);
        }
        let Some(view) = self.next_view(pick) else {
            return Ok(None);
        };
        self.sync_optimiser(map, config)?;
        let picked = Picked {
            view,
            keyframe: self.views[view].keyframe,
            level: self.views[view].next_level(config.uses_per_level),
        };
        let Compared {
            loss,
            gradients,
            radii,
        } = compare(self, map, picked, recorder)?;
        let rates = GroupRates::new(&config.rates, scene.extent_m);
        (self.groups).step(map, &gradients, &rates, config.optimiser)?;
        self.iterations += 1;
        if let Some(densify) = densify {
            let camera = self.camera.level(picked.level);
            self.densifier.add(&gradients.means2d, &radii, &camera);
            if self.iterations.is_multiple_of(densify.every) {
                self.densify_and_prune(map, scene.extent_m, densify, recorder);
            }
        }
        Ok(Some(TrainStep {
            keyframe: picked.keyframe,
            level: picked.level,
            loss,
            gaussians: map.len(),
        }))
    }

    /// The map against the picked view.
    fn compare(
        &self,
        map: &GaussianMap,
        picked: Picked,
        scene: TrainingScene<'_>,
        config: &TrainConfig,
        par: Par,
        recorder: &mut Recorder,
    ) -> Result<Compared, TrainError> {
        let Picked {
            view,
            keyframe,
            level,
        } = picked;
        let target = self.views[view].target(&self.camera, &self.straight, level, par);
        let images = TargetImages {
            color: &target.color,
            depth: target.depth.as_ref(),
            excluded: &target.excluded,
        };
        let weights = match config.dynamic_weight {
            DynamicWeight::Uniform => None,
            DynamicWeight::BeliefAndAge => Some(belief_and_age(&self.windows, scene.window_runs)),
        };
        let pose = &scene.poses[keyframe.index()];
        let Iteration {
            loss,
            gradients,
            rendered,
        } = iterate(
            Engine::FAST,
            map,
            (&target.camera, pose),
            images,
            weights.as_deref(),
            config,
            par,
        )?;
        recorder.record("train", |record| {
            let target = (&target.color, target.depth.as_ref(), &target.excluded);
            let rendered = (&rendered.color, &rendered.depth, &rendered.opacity);
            record.training((keyframe.0, level), pose, target, rendered, loss);
        });
        Ok(Compared {
            loss,
            gradients,
            radii: rendered.radii,
        })
    }

    /// Prunes the static Gaussians that have faded.
    pub fn prune(&mut self, map: &mut GaussianMap, min_opacity: f64) {
        let keep = faded(map, min_opacity).into_iter().map(|f| !f);
        self.retain(map, &keep.collect::<Vec<_>>());
    }

    fn densify_and_prune(
        &mut self,
        map: &mut GaussianMap,
        extent_m: f64,
        config: &DensifyConfig,
        recorder: &mut Recorder,
    ) {
        let mut rng = Rng::keyed(self.seed, &[0x6772_6f77, self.iterations as u64]);
        let newest = self.views.last().map_or(0, |view| view.keyframe.0);
        let young_from = KeyframeId(newest.saturating_sub(config.young_keyframes));
        let accumulated = &self.densifier;
        let unchanged = recorder.is_recording().then(|| (map.clone(), rng.clone()));
        let split = densify(map, accumulated, extent_m, young_from, config, &mut rng);
        let accumulated = std::mem::take(&mut self.densifier);
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
        if let Some((unchanged, mut rng)) = unchanged {
            let drawn = 6 * split.iter().filter(|s| **s).count(); // two children, three each
            let normals = (0..drawn).map(|_| rng.normal()).collect();
            recorder.record("densify", |record| {
                let maps = (&unchanged, &*map);
                record.densify(maps, accumulated.sums(), (extent_m, young_from), normals);
            });
        }
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
        self.extend(map.len());
        self.groups.fit(map)
    }

    fn extend(&mut self, rows: usize) {
        self.windows
            .resize(rows.max(self.windows.len()), LabelWindow::default());
        self.groups.extend(rows);
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

    /// The shuffled order is drawn by Fisher and Yates from the last place to the second, and taken from its end. A view
    /// that is added has its turn in the next order.
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
}

#[cfg(test)]
mod tests;
