//! Initial scales, the optimiser, and whole iterations: render, losses, backward pass, step.

use garad_core::{Par, Real};
use garad_golden::{InputError, Inputs};
use garad_optim::{Adam, AdamConfig, sgd};
use garad_raster::{knn_scales_m, rms_neighbour_distances_m};
use garad_slam::config::{Optimiser, RateConfig, TrainConfig};
use garad_slam::mapping::iteration::{Engine, Iteration, iterate};
use garad_slam::mapping::loss::{DEPTH_MIN_OPACITY, TargetImages};
use garad_slam::mapping::optimiser::{GroupRates, ParameterGroups};

use crate::convert::{channels, gray, has, labels, plane, reals};
use crate::outputs::{Answer, Element, Outputs};
use crate::raster::{camera, map, pose, put_gradients};

/// Scales of the points from `first` on.
pub(crate) fn knn_scale(inputs: &Inputs) -> Answer {
    let (points, first) = (inputs.rows::<3>("points")?, inputs.count("first")?);
    let footprints = inputs.reals("footprints")?;
    if points.len().checked_sub(first) != Some(footprints.len()) {
        return Err("points and footprints do not have matching sizes".into());
    }
    let mut out = Outputs::default();
    let distances = rms_neighbour_distances_m(&points, first..points.len());
    out.put("distance", distances);
    out.put("scale", knn_scales_m(&points, first, &footprints));
    Ok(out)
}

fn adam_config(inputs: &Inputs) -> Result<AdamConfig, InputError> {
    Ok(AdamConfig {
        beta1: inputs.number("beta1")?,
        beta2: inputs.number("beta2")?,
        eps: inputs.number("eps")?,
    })
}

/// Every number after every step, NaN while its row does not exist.
pub(crate) fn adam<T: Real + Element>(inputs: &Inputs) -> Answer {
    let (start, rates) = (
        reals::<T>(inputs, "start")?,
        inputs.reals("learning_rates")?,
    );
    let gradients = reals::<T>(inputs, "gradients")?;
    let n = start.len();
    if n == 0 || gradients.len() != n * rates.len() {
        return Err("gradients, rates and start do not have matching sizes".into());
    }
    let change = match has(inputs, "kept") {
        true => Some((inputs.bytes("kept")?, inputs.count("change_after")?)),
        false => None,
    };
    let old = change.map_or(n, |(kept, _)| kept.len()).min(n);
    let mut adam = Adam::<T>::new(adam_config(inputs)?, old, 1)?;
    // Which numbers of the case the rows are, and their values.
    let mut rows: Vec<usize> = (0..old).collect();
    let mut values = start[..old].to_vec();
    let mut path = Vec::new();
    for (t, (gradient, rate)) in gradients.chunks_exact(n).zip(&rates).enumerate() {
        if let Some((kept, _)) = change.filter(|(_, after)| t == *after) {
            let keep: Vec<bool> = kept.iter().map(|&k| k != 0).collect();
            adam.retain(&keep)?;
            adam.extend(n - old);
            let stay = (0..old).filter(|&i| keep[i]);
            values = stay.clone().map(|i| values[i]).collect();
            values.extend(&start[old..]);
            rows = stay.chain(old..n).collect();
        }
        let part: Vec<T> = rows.iter().map(|&i| gradient[i]).collect();
        adam.step(&mut values, &part, *rate)?;
        let mut all = vec![T::from_f64(f64::NAN); n];
        for (&i, &value) in rows.iter().zip(&values) {
            all[i] = value;
        }
        path.extend(all);
    }
    let mut out = Outputs::default();
    out.shaped("path", &[rates.len(), n], path)?;
    Ok(out)
}

/// Every number after every step of plain gradient descent.
pub(crate) fn plain_descent<T: Real + Element>(inputs: &Inputs) -> Answer {
    let (mut values, rates) = (
        reals::<T>(inputs, "start")?,
        inputs.reals("learning_rates")?,
    );
    let (gradients, n) = (reals::<T>(inputs, "gradients")?, values.len());
    if n == 0 || gradients.len() != n * rates.len() {
        return Err("gradients, rates and start do not have matching sizes".into());
    }
    let mut path: Vec<T> = Vec::new();
    for (gradient, rate) in gradients.chunks_exact(n).zip(&rates) {
        sgd(&mut values, gradient, *rate)?;
        path.extend_from_slice(&values);
    }
    let mut out = Outputs::default();
    out.shaped("path", &[rates.len(), n], path)?;
    Ok(out)
}

/// The settings of a training iteration: weights of the loss, and rates.
pub(crate) fn train_config(inputs: &Inputs) -> Result<TrainConfig, InputError> {
    let number = |name: &str| inputs.number(name);
    Ok(TrainConfig {
        lambda_photometric: number("lambda_photometric")?,
        lambda_ssim: number("lambda_ssim")?,
        lambda_depth: number("lambda_depth")?,
        lambda_dynamic: number("lambda_dynamic")?,
        rates: rates(inputs)?,
        ..TrainConfig::default()
    })
}

pub(crate) fn rates(inputs: &Inputs) -> Result<RateConfig, InputError> {
    let rate = |name: &str| inputs.number(&format!("rate_{name}"));
    Ok(RateConfig {
        mean: rate("means")?,
        log_scale: rate("log_scales")?,
        quaternion: rate("quaternions")?,
        opacity_logit: rate("opacity_logits")?,
        sh: rate("sh")?,
        sh_rest_divisor: rate("sh_rest_divisor")?,
    })
}

/// Iteration k looks at view k. The functions are those of the mapper's loop, which renders over black and compares
/// depth from [`DEPTH_MIN_OPACITY`] on.
pub(crate) fn train_step<T: Real + Element>(
    inputs: &Inputs,
    par: Par,
    engine: Engine<T>,
) -> Answer {
    let black = inputs.row::<3>("background")?.iter().all(|v| *v <= 0.0);
    if !black || (inputs.number("min_opacity")? - DEPTH_MIN_OPACITY).abs() > 0.0 {
        return Err(
            "training has a black background and compares depth from opacity 0.5 on".into(),
        );
    }
    let mut map = map::<T>(inputs)?;
    map.label = labels(inputs, "dynamic")?;
    let config = train_config(inputs)?;
    let rates = GroupRates::new(&config.rates, 1.0);
    let mut groups = ParameterGroups::new(adam_config(inputs)?)?;
    groups.fit(&map)?;
    let camera = camera(inputs)?;
    let mut out = Outputs::default();
    for step in 0..inputs.count("iterations")? {
        let suffix = format!("_{step}");
        let named = |name: &str| format!("{name}{suffix}");
        let (pose, color) = (pose(inputs, &suffix)?, channels(inputs, &named("target"))?);
        let (depth, excluded) = (
            plane(inputs, &named("measured"))?,
            gray(inputs, &named("excluded"))?,
        );
        let target = TargetImages {
            color: &color,
            depth: Some(&depth),
            excluded: &excluded,
        };
        let view = (&camera, &pose);
        let Iteration {
            loss, gradients, ..
        } = iterate(engine, &map, view, target, None, &config, par)?;
        groups.step(&mut map, &gradients, &rates, Optimiser::Adam)?;
        out.put(&named("loss"), [loss]);
        put_gradients(&mut out, &gradients, map.coefficients(), &suffix)?;
        out.put(&named("means"), map.means.iter().copied());
        out.put(&named("log_scales"), map.log_scales.iter().copied());
        out.put(&named("quaternions"), map.quaternions.iter().copied());
        out.put(&named("opacity_logits"), map.opacity_logits.iter().copied());
        let axes = [map.len(), map.coefficients()];
        out.shaped(&named("sh"), &axes, map.sh.iter().copied())?;
    }
    Ok(out)
}
