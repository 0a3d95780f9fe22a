//! Whole training iterations: render, losses, backward, Adam. Between them nothing is read back but the number
//! of pairs to sort and the loss.

use crate::Error;
use crate::adam::Adam;
use crate::case::{Answer, Case};
use crate::gpu::{Buffer, Gpu};
use crate::losses::{self, Frame};
use crate::render::{self, BEFORE_HARMONICS, Map, View};
use crate::{stages, sums};

/// Weights of eq. 12.
pub struct Weights {
    pub photometric: f32,
    pub ssim: f32,
    pub depth: f32,
    pub dynamic: f32,
    pub min_opacity: f32,
}

/// What one view is compared with.
pub struct Observation {
    pub view: View,
    pub frame: Frame,
    pub target: Buffer,
    pub measured: Buffer,
}

/// The map on the device.
pub struct Trained {
    pub map: Map,
    pub rows: Buffer,
    pub dynamic: Buffer,
}

/// The loss by the map, and buffers that its value is summed from.
pub struct Loss {
    pub gradient: Buffer,
    photometric_terms: Buffer,
    depth: losses::DepthLoss,
    squares: Buffer,
}

/// L of eq. 12 with its gradient, dynamic Gaussians not drawn.
pub fn loss(
    gpu: &Gpu,
    trained: &Trained,
    seen: &Observation,
    weights: &Weights,
) -> Result<Loss, Error> {
    let n = trained.map.gaussians;
    let pixels = seen.view.pixels();
    let splats = render::project(gpu, &seen.view, &trained.rows, &trained.dynamic, n);
    let rendered = render::blend(gpu, &seen.view, &splats)?;
    let [color, depth, opacity] = [3 * pixels, pixels, pixels].map(|words| gpu.zeros(words));
    let [l1, ssim] = [1.0 - weights.ssim, -weights.ssim].map(|w| w * weights.photometric);
    let settings = seen.frame.settings(gpu, l1, ssim);
    let unpacked = [&settings, &rendered.image, &color, &depth, &opacity];
    gpu.run_over("losses/unpack", &unpacked, pixels);
    let [photometric_terms, by_color] =
        losses::photometric(gpu, &seen.frame, [&color, &seen.target], [l1, ssim]);
    let images = [&depth, &opacity, &seen.measured];
    let by_depth = losses::depth(gpu, &seen.frame, images, weights.min_opacity, weights.depth);
    let upstream = gpu.zeros(5 * pixels);
    let packed = [
        &settings,
        &by_color,
        &by_depth.by_depth,
        &by_depth.by_opacity,
        &upstream,
    ];
    gpu.run_over("losses/pack", &packed, pixels);
    let found = render::backward(
        gpu,
        &seen.view,
        &trained.rows,
        &splats,
        &rendered,
        &upstream,
    );
    let buffers = [&trained.rows, &trained.dynamic, &found.map];
    let columns = [trained.map.columns(), 10];
    let squares = losses::penalty(gpu, buffers, n, columns, weights.dynamic);
    Ok(Loss {
        gradient: found.map,
        photometric_terms,
        depth: by_depth,
        squares,
    })
}

impl Loss {
    pub fn value(
        &self,
        gpu: &Gpu,
        trained: &Trained,
        seen: &Observation,
        w: &Weights,
    ) -> Result<f32, Error> {
        let photometric = sums::total(gpu, &self.photometric_terms, 3 * seen.view.pixels())?;
        let penalty = sums::total(gpu, &self.squares, trained.map.gaussians)?;
        Ok(w.photometric * w.ssim
            + photometric
            + w.depth * self.depth.value(gpu)?
            + w.dynamic * penalty)
    }
}

/// Rates by column of the map.
fn rates(case: &Case, map: &Map) -> Result<Vec<f32>, Error> {
    let mut rates = Vec::new();
    for (name, _, count) in map.groups() {
        rates.resize(rates.len() + count, case.single(&format!("rate_{name}"))?);
    }
    let divisor = case.single("rate_sh_rest_divisor")?;
    for rate in &mut rates[BEFORE_HARMONICS + 3..] {
        *rate /= divisor;
    }
    Ok(rates)
}

fn observation(gpu: &Gpu, case: &Case, map: &Map, suffix: &str) -> Result<Observation, Error> {
    let view = View::of_case(gpu, case, map, suffix)?;
    let excluded = case.flags(&format!("excluded{suffix}"))?;
    Ok(Observation {
        frame: Frame::new(gpu, [view.height, view.width], Some(&excluded)),
        target: gpu.upload(&case.singles(&format!("target{suffix}"))?),
        measured: gpu.upload(&losses::measured(
            &case.singles(&format!("measured{suffix}"))?,
        )),
        view,
    })
}

/// A map in training.
struct Training {
    trained: Trained,
    weights: Weights,
    adam: Adam,
}

impl Training {
    fn of_case(gpu: &Gpu, case: &Case) -> Result<Self, Error> {
        let map = Map::of_case(case)?;
        Ok(Self {
            weights: Weights {
                photometric: case.single("lambda_photometric")?,
                ssim: case.single("lambda_ssim")?,
                depth: case.single("lambda_depth")?,
                dynamic: case.single("lambda_dynamic")?,
                min_opacity: case.single("min_opacity")?,
            },
            adam: Adam::of_case(gpu, case, map.rows.len(), &rates(case, &map)?)?,
            trained: Trained {
                rows: gpu.upload(&map.rows),
                dynamic: gpu.upload(&case.flags("dynamic")?),
                map,
            },
        })
    }

    /// Loss and gradient before the step.
    fn step(&mut self, gpu: &Gpu, seen: &Observation) -> Result<(f32, Buffer), Error> {
        let found = loss(gpu, &self.trained, seen, &self.weights)?;
        let value = found.value(gpu, &self.trained, seen, &self.weights)?;
        self.adam.step(gpu, &found.gradient, &self.trained.rows);
        Ok((value, found.gradient))
    }
}

pub fn stage(gpu: &Gpu, case: &Case) -> Result<Answer, Error> {
    let mut training = Training::of_case(gpu, case)?;
    let mut out = Answer::default();
    for step in 0..case.whole("iterations")? {
        let suffix = format!("_{step}");
        let seen = observation(gpu, case, &training.trained.map, &suffix)?;
        let (value, gradient) = training.step(gpu, &seen)?;
        let Trained { map, rows, .. } = &training.trained;
        out.put(format!("loss{suffix}"), &[1], vec![value]);
        let gradient = gpu.read::<f32>(&gradient, map.rows.len())?;
        stages::put_map(&mut out, map, &gradient, "d_", &suffix);
        let rows = gpu.read::<f32>(rows, map.rows.len())?;
        stages::put_map(&mut out, map, &rows, "", &suffix);
    }
    Ok(out)
}

/// The training of a case of the stage `train_step` with a parameter `views`, V: iteration i looks at view i mod V. Answers
/// the map in the end, the loss of each iteration, and the PSNR of each view in dB.
pub fn run(gpu: &Gpu, case: &Case) -> Result<Answer, Error> {
    let mut training = Training::of_case(gpu, case)?;
    let views = (0..case.whole("views")?)
        .map(|view| observation(gpu, case, &training.trained.map, &format!("_{view}")))
        .collect::<Result<Vec<_>, _>>()?;
    let mut losses = Vec::new();
    for step in 0..case.whole("iterations")? as usize {
        losses.push(training.step(gpu, &views[step % views.len()])?.0);
    }
    let mut out = Answer::default();
    let trained = &training.trained;
    let rows = gpu.read::<f32>(&trained.rows, trained.map.rows.len())?;
    stages::put_map(&mut out, &trained.map, &rows, "", "");
    out.put("loss", &[losses.len()], losses);
    let psnr = views
        .iter()
        .map(|seen| psnr(gpu, trained, seen))
        .collect::<Result<Vec<_>, _>>()?;
    out.put("psnr", &[psnr.len()], psnr);
    Ok(out)
}

/// -10 log10 of the mean square over the pixels that count, rendered channels kept within [0, 1].
fn psnr(gpu: &Gpu, trained: &Trained, seen: &Observation) -> Result<f32, Error> {
    let n = trained.map.gaussians;
    let splats = render::project(gpu, &seen.view, &trained.rows, &trained.dynamic, n);
    let rendered = render::blend(gpu, &seen.view, &splats)?;
    let pixels = seen.view.pixels();
    let image = gpu.read::<f32>(&rendered.image, 8 * pixels)?;
    let target = gpu.read::<f32>(&seen.target, 3 * pixels)?;
    let mask = gpu.read::<f32>(&seen.frame.mask, pixels)?;
    let [mut total, mut count] = [0.0_f64; 2];
    for i in (0..pixels).filter(|&i| mask[i] > 0.0) {
        for c in 0..3 {
            let error = f64::from(image[8 * i + c].clamp(0.0, 1.0) - target[3 * i + c]);
            total += error * error;
            count += 1.0;
        }
    }
    #[allow(clippy::disallowed_methods, reason = "a figure to be printed")]
    let decibels = -10.0 * (total / count).log10();
    Ok(decibels as f32)
}
