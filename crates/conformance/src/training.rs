//! Initial scales, the optimiser, and whole iterations: render, losses, backward pass, step.

use garad_core::{GaussianMap, Par, Real};
use garad_golden::{InputError, Inputs};
use garad_optim::{Adam, AdamConfig, sgd};
use garad_raster::losses::{depth_l1, opacity_penalty, photometric};
use garad_raster::{
    Gradients, Include, RenderOptions, Upstream, knn_scales_m, rms_neighbour_distances_m,
};

use crate::convert::{channels, gray, has, labels, plane, reals};
use crate::outputs::{Answer, Element, Error, Outputs};
use crate::raster::{Engine, camera, map, pose, put_gradients};

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

/// The optimisers of the parameters of a map, with the rates of a case.
struct Optimiser<T>(Vec<(Adam<T>, Vec<f64>)>);

impl<T: Real> Optimiser<T> {
    fn new(inputs: &Inputs, map: &GaussianMap<T>) -> Result<Self, Error> {
        let columns = [
            ("means", 3),
            ("log_scales", 3),
            ("quaternions", 4),
            ("opacity_logits", 1),
            ("sh", 3 * map.coefficients()),
        ];
        let mut groups = Vec::new();
        for (name, width) in columns {
            let mut rates = vec![inputs.number(&format!("rate_{name}"))?; width];
            if name == "sh" {
                let divisor = inputs.number("rate_sh_rest_divisor")?;
                rates.iter_mut().skip(3).for_each(|rate| *rate /= divisor);
            }
            groups.push((Adam::new(adam_config(inputs)?, map.len(), width)?, rates));
        }
        Ok(Self(groups))
    }

    fn step(&mut self, map: &mut GaussianMap<T>, g: &Gradients<T>) -> Result<(), Error> {
        let pairs: [(&mut [T], &[T]); 5] = [
            (map.means.as_flattened_mut(), g.means.as_flattened()),
            (
                map.log_scales.as_flattened_mut(),
                g.log_scales.as_flattened(),
            ),
            (
                map.quaternions.as_flattened_mut(),
                g.quaternions.as_flattened(),
            ),
            (&mut map.opacity_logits, &g.opacity_logits),
            (map.sh.as_flattened_mut(), g.sh.as_flattened()),
        ];
        for ((parameters, gradient), (adam, rates)) in pairs.into_iter().zip(&mut self.0) {
            adam.step_by_column(parameters, gradient, rates)?;
        }
        Ok(())
    }
}

/// Iteration k looks at view k.
pub(crate) fn train_step<T: Real + Element>(
    inputs: &Inputs,
    par: Par,
    engine: Engine<T>,
) -> Answer {
    let mut map = map::<T>(inputs)?;
    map.label = labels(inputs, "dynamic")?;
    let mut optimiser = Optimiser::new(inputs, &map)?;
    let mut out = Outputs::default();
    for step in 0..inputs.count("iterations")? {
        let suffix = format!("_{step}");
        let (loss, gradients) = iteration(inputs, par, engine, &map, &suffix)?;
        optimiser.step(&mut map, &gradients)?;
        let named = |name: &str| format!("{name}{suffix}");
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

fn iteration<T: Real>(
    inputs: &Inputs,
    par: Par,
    engine: Engine<T>,
    map: &GaussianMap<T>,
    suffix: &str,
) -> Result<(T, Gradients<T>), Error> {
    let named = |name: &str| format!("{name}{suffix}");
    let weight = |name: &str| inputs.number(name).map(T::from_f64);
    let (camera, pose) = (camera(inputs)?, pose(inputs, suffix)?);
    let options = RenderOptions {
        background: inputs.row("background")?,
        include: Include::StaticOnly,
        ..RenderOptions::default()
    };
    let image = (engine.draw)(map, &camera, &pose, &options, par)?;
    let excluded = gray(inputs, &named("excluded"))?;
    let target = channels(inputs, &named("target"))?;
    let lambda = inputs.number("lambda_ssim")?;
    let photo = photometric(&image.color, &target, lambda, Some(&excluded), par)?;
    let depth = depth_l1(
        &image.depth,
        &image.opacity,
        &plane(inputs, &named("measured"))?,
        inputs.number("min_opacity")?,
        Some(&excluded),
    )?;
    let penalty = opacity_penalty(&map.opacity_logits, &map.label, None)?;
    let by_image = weight("lambda_photometric")?;
    let (by_depth, by_label) = (weight("lambda_depth")?, weight("lambda_dynamic")?);
    let upstream = Upstream {
        color: photo.gradient.map(|g| g.map(|v| v * by_image)),
        depth: Some(depth.depth.map(|v| *v * by_depth)),
        opacity: Some(depth.opacity.map(|v| *v * by_depth)),
    };
    let mut gradients = (engine.back)(map, &camera, &pose, &options, &image, &upstream, par)?;
    for (g, &pull) in gradients
        .opacity_logits
        .iter_mut()
        .zip(&penalty.opacity_logits)
    {
        *g += by_label * pull;
    }
    let loss = by_image * photo.value + by_depth * depth.value + by_label * penalty.value;
    Ok((loss, gradients))
}
