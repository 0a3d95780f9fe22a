//! Losses, optimiser, and a whole iteration of both passes and both of these.

use garad_core::{GaussianMap, Image, Label, Par, Real};
use garad_optim::{Adam, AdamConfig};
use garad_raster::losses::{depth_l1, l1, opacity_penalty, photometric, ssim};
use garad_raster::{Gradients, Include, RenderOptions, Upstream};

use super::fields::Fields;
use super::raster::{Engine, map, put_gradients, scaled};
use super::{Outputs, OwnError};

fn labels(fields: Fields<'_>) -> Result<Vec<Label>, OwnError> {
    let label = |d: u8| [Label::Static, Label::Dynamic][usize::from(d != 0)];
    Ok(fields.bytes("dynamic")?.into_iter().map(label).collect())
}

pub(super) fn losses<T: Real>(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let excluded = match fields.0.try_input("excluded") {
        Some(_) => Some(fields.gray("excluded")?),
        None => None,
    };
    let excluded = excluded.as_ref();
    let mut out = Outputs::default();
    let kind = fields.word("loss")?;
    match kind {
        "l1" | "ssim" | "photometric" => {
            let x: Image<[T; 3]> = fields.picture("rendered")?;
            let y = fields.picture("target")?;
            let loss = match kind {
                "l1" => l1(&x, &y, excluded),
                "ssim" => ssim(&x, &y, excluded, Par::Seq),
                _ => photometric(&x, &y, fields.number("lambda")?, excluded, Par::Seq),
            }
            .map_err(|error| fields.wrong(error))?;
            out.put("value", [loss.value]);
            out.put(
                "gradient",
                loss.gradient.data().as_flattened().iter().copied(),
            );
        }
        "depth" => {
            let loss = depth_l1(
                &fields.plane::<T>("depth")?,
                &fields.plane("opacity")?,
                &fields.plane("measured")?,
                fields.number("min_opacity")?,
                excluded,
            )
            .map_err(|error| fields.wrong(error))?;
            out.put("value", [loss.value]);
            out.put("by_depth", loss.depth.data().iter().copied());
            out.put("by_opacity", loss.opacity.data().iter().copied());
        }
        "opacity" => {
            let logits: Vec<T> = fields
                .reals("logits")?
                .into_iter()
                .map(T::from_f64)
                .collect();
            let loss = opacity_penalty(&logits, &labels(fields)?);
            let loss = loss.map_err(|error| fields.wrong(error))?;
            out.put("value", [loss.value]);
            out.put("gradient", loss.opacity_logits);
        }
        other => return Err(fields.wrong(format!("loss '{other}'"))),
    }
    Ok(out)
}

fn adam_config(fields: Fields<'_>) -> Result<AdamConfig, OwnError> {
    Ok(AdamConfig {
        beta1: fields.number("beta1")?,
        beta2: fields.number("beta2")?,
        eps: fields.number("eps")?,
    })
}

/// Every number after every step, NaN while its row does not exist.
pub(super) fn adam<T: Real>(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let start = fields.reals("start")?;
    let (gradients, rates) = (fields.reals("gradients")?, fields.reals("learning_rates")?);
    let n = start.len();
    if n == 0 || gradients.len() != n * rates.len() {
        return Err(fields.wrong("gradients, rates and start do not have matching sizes"));
    }
    let (kept, change_after) = match fields.0.try_input("kept") {
        Some(_) => (Some(fields.bytes("kept")?), fields.count("change_after")?),
        None => (None, usize::MAX),
    };
    let old = kept.as_ref().map_or(n, Vec::len).min(n);
    let wrong = |error: garad_optim::OptimError| fields.wrong(error);
    let mut adam = Adam::<T>::new(adam_config(fields)?, old, 1).map_err(wrong)?;
    let start: Vec<T> = start.into_iter().map(T::from_f64).collect();
    // Which numbers of the case the rows are, and their values.
    let mut rows: Vec<usize> = (0..old).collect();
    let mut values = start[..old].to_vec();
    let mut path = Vec::new();
    for (t, (gradient, rate)) in gradients.chunks_exact(n).zip(rates).enumerate() {
        if let Some(kept) = kept.as_ref().filter(|_| t == change_after) {
            let keep: Vec<bool> = kept.iter().map(|&k| k != 0).collect();
            adam.retain(&keep).map_err(wrong)?;
            adam.extend(n - old);
            let stay = (0..old).filter(|&i| keep[i]);
            values = stay.clone().map(|i| values[i]).collect();
            values.extend(&start[old..]);
            rows = stay.chain(old..n).collect();
        }
        let part: Vec<T> = rows.iter().map(|&i| T::from_f64(gradient[i])).collect();
        adam.step(&mut values, &part, rate).map_err(wrong)?;
        let mut all = vec![T::from_f64(f64::NAN); n];
        for (&i, &value) in rows.iter().zip(&values) {
            all[i] = value;
        }
        path.extend(all);
    }
    let mut out = Outputs::default();
    out.put("path", path);
    Ok(out)
}

/// The optimisers of a map, with the rates of a case.
struct Optimiser<T> {
    groups: Vec<(Adam<T>, Vec<f64>)>,
}

impl<T: Real> Optimiser<T> {
    fn new(fields: Fields<'_>, map: &GaussianMap<T>) -> Result<Self, OwnError> {
        let coefficients = 3 * map.coefficients();
        let columns = [
            ("means", 3),
            ("log_scales", 3),
            ("quaternions", 4),
            ("opacity_logits", 1),
            ("sh", coefficients),
        ];
        let mut groups = Vec::new();
        for (name, width) in columns {
            let mut rates = vec![fields.number(&format!("rate_{name}"))?; width];
            if name == "sh" {
                let divisor = fields.number("rate_sh_rest_divisor")?;
                rates.iter_mut().skip(3).for_each(|rate| *rate /= divisor);
            }
            let adam = Adam::new(adam_config(fields)?, map.len(), width);
            groups.push((adam.map_err(|error| fields.wrong(error))?, rates));
        }
        Ok(Self { groups })
    }

    fn step(
        &mut self,
        fields: Fields<'_>,
        map: &mut GaussianMap<T>,
        gradients: &Gradients<T>,
    ) -> Result<(), OwnError> {
        let pairs: [(&mut [T], &[T]); 5] = [
            (map.means.as_flattened_mut(), gradients.means.as_flattened()),
            (
                map.log_scales.as_flattened_mut(),
                gradients.log_scales.as_flattened(),
            ),
            (
                map.quaternions.as_flattened_mut(),
                gradients.quaternions.as_flattened(),
            ),
            (&mut map.opacity_logits, &gradients.opacity_logits),
            (map.sh.as_flattened_mut(), gradients.sh.as_flattened()),
        ];
        for ((parameters, gradient), (adam, rates)) in pairs.into_iter().zip(&mut self.groups) {
            let step = adam.step_by_column(parameters, gradient, rates);
            step.map_err(|error| fields.wrong(error))?;
        }
        Ok(())
    }
}

/// Iterations of render, losses, backward, Adam; iteration k looks at view k.
pub(super) fn train_step<T: Real>(
    fields: Fields<'_>,
    engine: Engine<T>,
) -> Result<Outputs, OwnError> {
    let mut map = map::<T>(fields)?;
    map.label = labels(fields)?;
    let mut optimiser = Optimiser::new(fields, &map)?;
    let mut out = Outputs::default();
    for step in 0..fields.count("iterations")? {
        let suffix = format!("_{step}");
        let (loss, gradients) = iteration(fields, engine, &map, &suffix)?;
        optimiser.step(fields, &mut map, &gradients)?;
        out.put(&format!("loss{suffix}"), [loss]);
        put_gradients(&mut out, &gradients, &suffix);
        let parameters = [
            ("means", map.means.as_flattened()),
            ("log_scales", map.log_scales.as_flattened()),
            ("quaternions", map.quaternions.as_flattened()),
            ("opacity_logits", &map.opacity_logits),
            ("sh", map.sh.as_flattened()),
        ];
        for (name, values) in parameters {
            out.put(&format!("{name}{suffix}"), values.iter().copied());
        }
    }
    Ok(out)
}

fn iteration<T: Real>(
    fields: Fields<'_>,
    engine: Engine<T>,
    map: &GaussianMap<T>,
    suffix: &str,
) -> Result<(T, Gradients<T>), OwnError> {
    let named = |name: &str| format!("{name}{suffix}");
    let weight = |name: &str| fields.number(name).map(T::from_f64);
    let wrong = |error: garad_raster::RasterError| fields.wrong(error);
    let (camera, pose) = (fields.camera()?, fields.pose(suffix)?);
    let options = RenderOptions {
        background: fields.row("background")?,
        include: Include::StaticOnly,
        ..RenderOptions::default()
    };
    let picture = (engine.draw)(map, &camera, &pose, &options, Par::Seq).map_err(wrong)?;
    let excluded = fields.gray(&named("excluded"))?;
    let target = fields.picture(&named("target"))?;
    let lambda = fields.number("lambda_ssim")?;
    let photo = photometric(&picture.color, &target, lambda, Some(&excluded), Par::Seq);
    let photo = photo.map_err(wrong)?;
    let depth = depth_l1(
        &picture.depth,
        &picture.opacity,
        &fields.plane(&named("measured"))?,
        fields.number("min_opacity")?,
        Some(&excluded),
    )
    .map_err(wrong)?;
    let penalty = opacity_penalty(&map.opacity_logits, &map.label).map_err(wrong)?;
    let by_picture = weight("lambda_photometric")?;
    let (by_depth, by_label) = (weight("lambda_depth")?, weight("lambda_dynamic")?);
    let upstream = Upstream {
        color: photo.gradient.map(|g| g.map(|v| v * by_picture)),
        depth: Some(scaled(&depth.depth, by_depth)),
        opacity: Some(scaled(&depth.opacity, by_depth)),
    };
    let mut gradients = (engine.back)(map, &camera, &pose, &options, &picture, &upstream, Par::Seq)
        .map_err(wrong)?;
    let pulls = penalty.opacity_logits.iter();
    for (g, &pull) in gradients.opacity_logits.iter_mut().zip(pulls) {
        *g += by_label * pull;
    }
    let loss = by_picture * photo.value + by_depth * depth.value + by_label * penalty.value;
    Ok((loss, gradients))
}
