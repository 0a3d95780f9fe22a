//! What moves: cues, kernels, the field, the window.

use garad_core::{Par, Real};
use garad_crf::{
    Crf, CrfConfig, CueModel, Cues, Decision, Distance, Height, KernelConfig, LabelWindow,
    LabelWindowConfig, Method, Node, Normalisation, Pooling, PositionTerms, Score, Side, SmallCrf,
    UnaryConfig, WindowReading, kernel, unary,
};
use garad_golden::Inputs;

use crate::convert::{codes, labels, vectors};
use crate::outputs::{Answer, Error, Outputs};

/// NaN stands for what is missing.
fn number(x: f64) -> Option<f64> {
    (!x.is_nan()).then_some(x)
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "counts are small whole numbers; the cast saturates"
)]
fn count(x: f64) -> Option<u32> {
    number(x).map(|x| x as u32)
}

fn unary_config(inputs: &Inputs) -> Result<UnaryConfig, Error> {
    let n = |name| inputs.number(name);
    let [mean, sigma, weight]: [[f64; 4]; 3] = [
        inputs.row("mean")?,
        inputs.row("sigma")?,
        inputs.row("weight")?,
    ];
    let sides = inputs.word("side")?.split(' ').map(|word| match word {
        "above" => Ok(Side::Above),
        "below" => Ok(Side::Below),
        "both" => Ok(Side::Both),
        other => Err(format!("side '{other}'")),
    });
    let sides: Vec<Side> = sides.collect::<Result<_, _>>()?;
    let &[reprojection, depth, observations, epipolar] = sides.as_slice() else {
        return Err("not four sides".into());
    };
    let model = |k: usize, side| CueModel {
        mean: mean[k],
        sigma: sigma[k],
        side,
        weight: weight[k],
    };
    let (threshold, threshold_with_epipolar) = (n("threshold")?, n("threshold_with_epipolar")?);
    let confidence = n("confidence")?;
    let hard = |score| Decision::Hard {
        score,
        threshold,
        threshold_with_epipolar,
        confidence,
    };
    let heights = [("unit", Height::Unit), ("density", Height::Density)];
    let poolings = [("mean", Pooling::Mean), ("geometric", Pooling::Geometric)];
    let decisions = [
        ("soft", Decision::Soft),
        ("mean", hard(Score::Mean)),
        ("sum", hard(Score::Sum)),
    ];
    Ok(UnaryConfig {
        reprojection: model(0, reprojection),
        depth: model(1, depth),
        observations: model(2, observations),
        epipolar: model(3, epipolar),
        height: inputs.choice("height", &heights)?,
        pooling: inputs.choice("pooling", &poolings)?,
        decision: inputs.choice("score", &decisions)?,
        clamp: n("clamp")?,
        min_observations: count(n("min_observations")?).unwrap_or_default(),
        ..UnaryConfig::default()
    })
}

pub(crate) fn unary(inputs: &Inputs) -> Answer {
    let config = unary_config(inputs)?;
    let cues = inputs.rows::<4>("cues")?.into_iter().map(|c| Cues {
        reproj_px: number(c[0]),
        depth_residual: number(c[1]),
        observations: count(c[2]),
        epipolar_px: number(c[3]),
    });
    let cues: Vec<Cues> = cues.collect();
    let mixture = || {
        cues.iter()
            .map(|c| unary::mixture_likelihood(c, &config).unwrap_or(f64::NAN))
    };
    let mut out = Outputs::default();
    out.put("mixture", mixture());
    out.put("psi_static", mixture().map(|m| -Real::ln(m)));
    out.put("p_static", cues.iter().map(|c| unary::p_static(c, &config)));
    out.put("log_odds", cues.iter().map(|c| unary::log_odds(c, &config)));
    Ok(out)
}

fn nodes(inputs: &Inputs) -> Result<Vec<Node>, Error> {
    let (p, uv) = (
        vectors::<3>(inputs, "p_world")?,
        vectors::<2>(inputs, "uv_px")?,
    );
    let (reproj, seen) = (inputs.reals("reproj_px")?, inputs.reals("observations")?);
    if [uv.len(), reproj.len(), seen.len()] != [p.len(); 3] {
        return Err("the numbers of nodes differ".into());
    }
    let node = |i: usize| Node {
        p_world: p[i],
        uv_px: number(uv[i].x).map(|_| uv[i]),
        cues: Cues {
            reproj_px: number(reproj[i]),
            observations: count(seen[i]),
            ..Cues::default()
        },
        previous: None,
    };
    Ok((0..p.len()).map(node).collect())
}

fn field_config(inputs: &Inputs) -> Result<CrfConfig, Error> {
    let n = |name| inputs.number(name);
    let distances = [("squared", Distance::Squared), ("linear", Distance::Linear)];
    let terms = [
        ("both", PositionTerms::Both),
        ("space", PositionTerms::Space),
        ("pixel", PositionTerms::Pixel),
    ];
    let normalisations = [
        ("none", Normalisation::None),
        ("rows", Normalisation::Rows),
        ("symmetric", Normalisation::Symmetric),
    ];
    let mut config = CrfConfig {
        kernels: KernelConfig {
            feature_weight: n("feature_weight")?,
            sigma_reproj_px: n("sigma_reproj_px")?,
            sigma_observations: n("sigma_observations")?,
            position_weight: n("position_weight")?,
            sigma_m: n("sigma_m")?,
            sigma_px: n("sigma_px")?,
            distance: inputs.choice("distance", &distances)?,
            terms: inputs.choice("terms", &terms)?,
        },
        ..CrfConfig::default()
    };
    config.mean_field.normalisation = inputs.choice("normalisation", &normalisations)?;
    config.mean_field.self_message = inputs.switch("self_message")?;
    config.mean_field.damping = n("damping")?;
    Ok(config)
}

pub(crate) fn kernels(inputs: &Inputs) -> Answer {
    let (nodes, config) = (nodes(inputs)?, field_config(inputs)?.kernels);
    let pairs = || nodes.iter().flat_map(|a| nodes.iter().map(move |b| (a, b)));
    let axes = [nodes.len(); 2];
    let mut out = Outputs::default();
    out.shaped(
        "k1",
        &axes,
        pairs().map(|(a, b)| kernel::feature(a, b, &config)),
    )?;
    out.shaped(
        "k2",
        &axes,
        pairs().map(|(a, b)| kernel::position(a, b, &config)),
    )?;
    Ok(out)
}

pub(crate) fn mean_field(inputs: &Inputs, par: Par, method: Method) -> Answer {
    let (nodes, log_odds) = (nodes(inputs)?, inputs.reals("log_odds")?);
    let mut config = field_config(inputs)?;
    config.mean_field.method = method;
    let (mut after_each, mut last, mut counts) = (Vec::new(), None, 0);
    for count in inputs.word("iterations")?.split(' ') {
        config.mean_field.iterations = count.parse()?;
        let crf = Crf::new(config.clone())?;
        let beliefs = crf.infer_from_log_odds(&nodes, &log_odds, par)?;
        after_each.extend_from_slice(&beliefs.dynamic);
        last = Some(beliefs);
        counts += 1;
    }
    let last = last.ok_or("no number of iterations")?;
    let mut out = Outputs::default();
    out.shaped("q", &[counts, nodes.len()], after_each)?;
    out.put("labels", codes(&last.labels));
    // Couplings without a norm are symmetric, so that labellings have an energy; few nodes have few labellings.
    if config.mean_field.normalisation == Normalisation::None {
        let crf = SmallCrf::from_nodes(&nodes, &log_odds, &config.kernels)?;
        if let Ok(all) = crf.enumerate() {
            out.put("map", codes(&all.map));
            out.put("map_energy", [all.map_energy]);
            out.put("log_z", [all.log_z]);
            out.put("marginals", all.dynamic);
            out.put("free_energy", [crf.free_energy(&last.dynamic)]);
        }
    }
    Ok(out)
}

pub(crate) fn window(inputs: &Inputs) -> Answer {
    let readings = [
        ("static_share", WindowReading::StaticShare),
        ("literal", WindowReading::Literal),
    ];
    let config = LabelWindowConfig {
        runs: count(inputs.number("runs")?).unwrap_or_default(),
        reading: inputs.choice("reading", &readings)?,
    };
    let mut window = LabelWindow::default();
    let (mut scores, mut removed) = (Vec::new(), Vec::new());
    for label in labels(inputs, "labels")? {
        window.push(label);
        scores.extend(window.score(&config));
        removed.push(window.is_removed(&config));
    }
    let mut out = Outputs::default();
    out.put("score", scores);
    out.put("removed", removed);
    Ok(out)
}

#[cfg(test)]
mod tests {
    use garad_golden::Case;

    use super::*;

    /// F is above -ln Z, and beliefs above 1/2 name the best labelling.
    #[test]
    fn beliefs_are_those_of_the_best_labelling() {
        let mut checked = 0;
        for case in Case::load_all("mean_field") {
            if !case.outputs().contains_key("log_z") {
                continue;
            }
            let out = mean_field(case.inputs(), Par::Seq, Method::Reference).unwrap();
            let of = |name: &str| out.tensors()[name].f64();
            let name = case.name();
            assert!(
                of("free_energy")[0] > -of("log_z")[0],
                "{name}: F above -ln Z"
            );
            let (q, map) = (of("q"), of("map"));
            let last = &q[q.len() - map.len()..];
            let found: Vec<f64> = last.iter().map(|q| f64::from(*q > 0.5)).collect();
            assert_eq!(found, map, "{name}: the best labelling");
            checked += 1;
        }
        assert!(checked > 0, "no case was enumerated");
    }

    /// A window has a score from the run on that fills it.
    #[test]
    fn windows_have_a_score_once_they_are_full() {
        for case in Case::load_all("label_window") {
            let inputs = case.inputs();
            let scores = window(inputs).unwrap().tensors()["score"].len();
            let runs = inputs.tensor("labels").unwrap().len();
            assert_eq!(
                scores,
                runs - inputs.count("first").unwrap(),
                "{}",
                case.name()
            );
        }
    }
}
