//! A training run whose gradients are given: the mapper's loop without the renderer.

use garad_core::{GaussianMap, KeyframeId, Label, NewGaussian, RgbImage, Se3};
use garad_crf::LabelWindowConfig;
use garad_golden::{InputError, Inputs};
use garad_optim::{Adam, OptimError};
use garad_raster::Gradients;
use garad_slam::config::{DensifyConfig, TrainConfig};
use garad_slam::mapping::error::TrainError;
use garad_slam::mapping::optimiser::GroupRates;
use garad_slam::mapping::relabel::push_labels;
use garad_slam::mapping::train::{Compared, Pick, Trainer, TrainingScene, extent_m};
use garad_slam::mapping::view::TrainingView;
use nalgebra::Vector3;

use crate::convert::{codes, rotation, rows};
use crate::outputs::{Answer, Error, Outputs};
use crate::raster::camera;
use crate::training::rates;

/// Numbers of a Gaussian with colours of degree 1: mean 3, log-scales 3, quaternion 4, opacity logit, harmonics 12.
const COLUMNS: usize = 23;
const OPACITY: usize = 10;
/// The same with colours of degree 0.
const NEW_COLUMNS: usize = 14;
const HARMONICS: usize = COLUMNS - OPACITY - 1;

/// What is given for every iteration and row of the map.
struct Given {
    gradient: Vec<[f32; COLUMNS]>,
    by_mean_px: Vec<[f32; 2]>,
    visible: Vec<u8>,
    /// Rows per iteration.
    rows: usize,
}

impl Given {
    fn new(inputs: &Inputs) -> Result<Self, Error> {
        let visible = inputs.tensor("visible")?;
        let [iterations, per_iteration] = *visible.shape() else {
            return Err(inputs.shape_is_not("visible", "iterations x rows").into());
        };
        let given = Self {
            gradient: rows(inputs, "gradient")?,
            by_mean_px: rows(inputs, "gradient_px")?,
            visible: inputs.bytes("visible")?.to_vec(),
            rows: per_iteration,
        };
        match [given.gradient.len(), given.by_mean_px.len()] == [iterations * per_iteration; 2] {
            true => Ok(given),
            false => Err("gradients and 'visible' do not have matching shapes".into()),
        }
    }

    fn compared(&self, map: &GaussianMap, iteration: usize) -> Option<Compared> {
        let (n, triples) = (map.len(), map.coefficients());
        let rows = iteration * self.rows..iteration * self.rows + n;
        if n > self.rows || 3 * triples > HARMONICS {
            return None;
        }
        let gradient = self.gradient.get(rows.clone())?;
        let part = |from: usize| gradient.iter().map(move |g| &g[from..]);
        let triple = |g: &[f32]| [g[0], g[1], g[2]];
        let sh = part(OPACITY + 1).flat_map(|g| g.chunks_exact(3).take(triples).map(triple));
        Some(Compared {
            loss: 0.0,
            gradients: Gradients {
                means: part(0).map(triple).collect(),
                log_scales: part(3).map(triple).collect(),
                quaternions: part(6).map(|g| [g[0], g[1], g[2], g[3]]).collect(),
                opacity_logits: part(OPACITY).map(|g| g[0]).collect(),
                sh: sh.collect(),
                pose: [0.0; 6],
                means2d: self.by_mean_px.get(rows.clone())?.to_vec(),
                conics: vec![[0.0; 3]; n],
                opacities: vec![0.0; n],
                colors: vec![[0.0; 3]; n],
                depths: vec![0.0; n],
            },
            radii: self
                .visible
                .get(rows)?
                .iter()
                .map(|v| i32::from(*v))
                .collect(),
        })
    }
}

/// The state of every Gaussian, record after record.
#[derive(Default)]
struct Records {
    rows: Vec<usize>,
    parameters: Vec<[f32; COLUMNS]>,
    moments: [Vec<[f32; COLUMNS]>; 2],
    sums: Vec<f32>,
    seen: Vec<u32>,
    window_runs: Vec<u32>,
    window_dynamic: Vec<u32>,
    born: Vec<u32>,
    labels: Vec<bool>,
}

/// The numbers of row `i` in one array after the other; what a lower degree lacks is 0.
fn row<'a>(i: usize, arrays: impl IntoIterator<Item = (&'a [f32], usize)>) -> [f32; COLUMNS] {
    let mut row = [0.0; COLUMNS];
    let numbers = arrays
        .into_iter()
        .flat_map(|(array, width)| &array[i * width..][..width]);
    row.iter_mut()
        .zip(numbers)
        .for_each(|(to, from)| *to = *from);
    row
}

impl Records {
    fn push(&mut self, map: &GaussianMap, trainer: &mut Trainer, n: u32) {
        trainer.windows(map); // a row for every Gaussian
        let state = trainer.state();
        let groups = state.groups;
        let groups = [
            &groups.means,
            &groups.log_scales,
            &groups.quaternions,
            &groups.opacity_logits,
            &groups.sh,
        ];
        self.rows.push(map.len());
        let parameters = [
            (map.means.as_flattened(), 3),
            (map.log_scales.as_flattened(), 3),
            (map.quaternions.as_flattened(), 4),
            (&map.opacity_logits, 1),
            (map.sh.as_flattened(), 3 * map.coefficients()),
        ];
        for (k, records) in self.moments.iter_mut().enumerate() {
            let of = |group: &Adam<f32>| -> Vec<f32> {
                group.moments().iter().map(|moments| moments[k]).collect()
            };
            let moments = groups.map(|group| (of(group), group.moments().len() / group.rows()));
            let arrays = || moments.iter().map(|(array, width)| (&array[..], *width));
            records.extend((0..map.len()).map(|i| row(i, arrays())));
        }
        for i in 0..map.len() {
            self.parameters.push(row(i, parameters));
            self.sums
                .push(state.gradient.get(i).copied().unwrap_or_default());
            self.seen
                .push(state.seen.get(i).copied().unwrap_or_default());
            self.window_runs.push(state.windows[i].seen());
            self.window_dynamic.push(state.windows[i].dynamic_runs(n));
            self.born.push(map.born[i].0);
        }
        self.labels.extend(codes(&map.label));
    }
}

/// Appends a Gaussian given by its parameters.
fn insert(map: &mut GaussianMap, new: &[f32; NEW_COLUMNS], born: KeyframeId) {
    let i = map.push(&NewGaussian {
        mean: [new[0], new[1], new[2]],
        sigma_m: 1.0,
        opacity: 0.5,
        color: [0.5; 3],
        landmark: None,
        born,
    });
    map.log_scales[i] = [new[3], new[4], new[5]];
    map.quaternions[i] = [new[6], new[7], new[8], new[9]];
    map.opacity_logits[i] = new[10];
    let degree_0 = i * map.coefficients();
    map.sh[degree_0] = [new[11], new[12], new[13]];
}

fn count(inputs: &Inputs, name: &str) -> Result<u32, Error> {
    Ok(u32::try_from(inputs.count(name)?)?)
}

fn poses(inputs: &Inputs) -> Result<Vec<Se3>, Error> {
    let q = inputs.rows::<4>("camera_from_world_q")?.into_iter();
    let t = inputs.rows::<3>("camera_from_world_t")?.into_iter();
    q.zip(t)
        .map(|(q, t)| Ok(Se3::new(rotation(q)?, Vector3::from(t))))
        .collect()
}

fn configs(inputs: &Inputs) -> Result<(TrainConfig, DensifyConfig), InputError> {
    let train = TrainConfig {
        max_views: inputs.count("max_views")?,
        uses_per_level: inputs.count("uses_per_level")?,
        sh_degree: inputs.count("sh_degree")?,
        sh_every: inputs.count("sh_every")?,
        rates: rates(inputs)?,
        ..TrainConfig::default()
    };
    let densify = DensifyConfig {
        every: inputs.count("every")?,
        grad_threshold: inputs.number("grad_threshold")?,
        split_extent: inputs.number("split_extent")?,
        min_opacity: inputs.number("min_opacity")?,
        prune_large: inputs.switch("prune_large")?,
        max_gaussians: inputs.count("max_gaussians")?,
        ..DensifyConfig::default()
    };
    Ok((train, densify))
}

/// Keyframe after keyframe, as [`Mapper::run`](garad_slam::mapping::mapper::Mapper::run) has it: labels and what they
/// remove, new Gaussians, the new view, iterations.
pub(crate) fn train_run(inputs: &Inputs) -> Answer {
    let camera = camera(inputs)?;
    let (train, mut densify) = configs(inputs)?;
    densify.young_keyframes = count(inputs, "young_keyframes")?;
    let window = LabelWindowConfig {
        runs: count(inputs, "runs")?,
        ..LabelWindowConfig::default()
    };
    let (all_poses, given) = (poses(inputs)?, Given::new(inputs)?);
    let record_after = inputs.indices("record_after")?;
    let labels: Vec<Option<Label>> = (inputs.reals("run_labels")?.into_iter())
        .map(|l| {
            (l >= 0.0).then_some(if l > 0.0 {
                Label::Dynamic
            } else {
                Label::Static
            })
        })
        .collect();
    let mut new = rows::<f32, NEW_COLUMNS>(inputs, "new")?.into_iter();

    let mut trainer = Trainer::new(&camera, u64::from(count(inputs, "seed")?))?;
    let mut map = GaussianMap::new(0);
    let (mut records, mut out) = (Records::default(), Outputs::default());
    let (mut picks, mut gaussians, mut degrees) = (Vec::new(), Vec::new(), Vec::new());
    let (mut all_rates, mut extents, mut views) = (Vec::new(), Vec::new(), Vec::new());
    let jobs = inputs
        .indices("iterations")?
        .into_iter()
        .zip(inputs.indices("inserted")?);
    for (k, (iterations, inserted)) in jobs.enumerate() {
        let poses = all_poses.get(..=k).ok_or("a pose per keyframe")?;
        let keyframe = KeyframeId(u32::try_from(k)?);
        let labels = (labels.get(k * given.rows..k * given.rows + map.len()))
            .ok_or("a label per keyframe and row")?;
        let windows = trainer.windows(&map);
        let (_, expired) = push_labels(&mut map, windows, labels, &window);
        let keep: Vec<bool> = expired.iter().map(|expired| !expired).collect();
        trainer.retain(&mut map, &keep);
        for new in new.by_ref().take(inserted) {
            insert(&mut map, &new, keyframe);
        }
        let rgb = RgbImage::new(camera.width, camera.height, [0; 3]);
        trainer.add_view(TrainingView::new(keyframe, rgb, None, None, 0));
        trainer.thin_views(train.max_views, poses);
        views.extend(trainer.view_keyframes().map(|keyframe| keyframe.0));
        let scene = TrainingScene {
            poses,
            extent_m: extent_m(poses),
            window_runs: window.runs,
        };
        extents.push(scene.extent_m);
        records.push(&map, &mut trainer, window.runs);
        for i in 0..iterations {
            let pick = Pick::beside_tracking(i);
            let (t, mut degree) = (picks.len(), 0);
            let compared = |_: &Trainer, map: &GaussianMap, _| {
                degree = map.sh_degree();
                given
                    .compared(map, t)
                    .ok_or(TrainError::from(OptimError::SizeMismatch {
                        what: "gradients of an iteration",
                        got: given.rows,
                        expected: map.len(),
                    }))
            };
            let step = trainer.step_by(&mut map, pick, scene, &train, Some(&densify), compared)?;
            let step = step.ok_or("a view and a Gaussian")?;
            picks.push([step.keyframe.0, u32::try_from(step.level)?]);
            gaussians.push(step.gaussians);
            degrees.push(degree);
            let rates = GroupRates::new(&train.rates, scene.extent_m);
            all_rates.push([
                rates.mean,
                rates.log_scale,
                rates.quaternion,
                rates.opacity_logit,
                rates.sh,
                rates.sh_rest,
            ]);
            if record_after.contains(&picks.len()) {
                records.push(&map, &mut trainer, window.runs);
            }
        }
    }
    out.put("picks", picks);
    out.put("gaussians", gaussians);
    out.put("degree", degrees);
    out.put("rates", all_rates);
    out.put("extent", extents);
    out.put("views", views);
    let [first, second] = records.moments;
    out.put("rows", records.rows);
    out.put("parameters", records.parameters);
    out.put("first_moments", first);
    out.put("second_moments", second);
    out.put("gradient_sums", records.sums);
    out.put("seen", records.seen);
    out.put("window_runs", records.window_runs);
    out.put("window_dynamic", records.window_dynamic);
    out.put("born", records.born);
    out.put("labels", records.labels);
    Ok(out)
}
