//! What moves: cues, kernels, the field, the window.

use garad_core::{Label, Par, Real};
use garad_crf::{
    Crf, CrfConfig, CrfError, CueModel, Cues, Decision, Distance, Height, KernelConfig,
    LabelWindow, LabelWindowConfig, Method, Node, Normalisation, Pooling, PositionTerms, Score,
    Side, SmallCrf, UnaryConfig, WindowReading, kernel, unary,
};
use nalgebra::{Vector2, Vector3};

use super::fields::Fields;
use super::{Outputs, OwnError};

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

fn of_word<T: Copy>(fields: Fields<'_>, name: &str, known: &[(&str, T)]) -> Result<T, OwnError> {
    let word = fields.word(name)?;
    let found = known.iter().find(|(k, _)| *k == word);
    let found = found.ok_or_else(|| fields.wrong(format!("{name} '{word}'")))?;
    Ok(found.1)
}

fn unary_config(fields: Fields<'_>) -> Result<UnaryConfig, OwnError> {
    let [mean, sigma, weight]: [[f64; 4]; 3] = [
        fields.row("mean")?,
        fields.row("sigma")?,
        fields.row("weight")?,
    ];
    let mut sides = Vec::new();
    for word in fields.word("side")?.split(' ') {
        sides.push(match word {
            "above" => Side::Above,
            "below" => Side::Below,
            "both" => Side::Both,
            other => return Err(fields.wrong(format!("side '{other}'"))),
        });
    }
    if sides.len() != 4 {
        return Err(fields.wrong("not four sides"));
    }
    let model = |k: usize| CueModel {
        mean: mean[k],
        sigma: sigma[k],
        side: sides[k],
        weight: weight[k],
    };
    let [threshold, threshold_with_epipolar, confidence] = [
        fields.number("threshold")?,
        fields.number("threshold_with_epipolar")?,
        fields.number("confidence")?,
    ];
    let hard = |score| Decision::Hard {
        score,
        threshold,
        threshold_with_epipolar,
        confidence,
    };
    let decisions = [
        ("soft", Decision::Soft),
        ("mean", hard(Score::Mean)),
        ("sum", hard(Score::Sum)),
    ];
    Ok(UnaryConfig {
        reprojection: model(0),
        depth: model(1),
        observations: model(2),
        epipolar: model(3),
        height: of_word(
            fields,
            "height",
            &[("unit", Height::Unit), ("density", Height::Density)],
        )?,
        pooling: of_word(
            fields,
            "pooling",
            &[("mean", Pooling::Mean), ("geometric", Pooling::Geometric)],
        )?,
        decision: of_word(fields, "score", &decisions)?,
        clamp: fields.number("clamp")?,
        min_observations: count(fields.number("min_observations")?).unwrap_or_default(),
        ..UnaryConfig::default()
    })
}

pub(super) fn unary(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let config = unary_config(fields)?;
    let cues: Vec<Cues> = fields
        .rows::<4>("cues")?
        .into_iter()
        .map(|c| Cues {
            reproj_px: number(c[0]),
            depth_residual: number(c[1]),
            observations: count(c[2]),
            epipolar_px: number(c[3]),
        })
        .collect();
    let mixture = cues
        .iter()
        .map(|c| unary::mixture_likelihood(c, &config).unwrap_or(f64::NAN));
    let mut out = Outputs::default();
    out.put("mixture", mixture.clone());
    out.put("psi_static", mixture.map(|m| -Real::ln(m)));
    out.put("p_static", cues.iter().map(|c| unary::p_static(c, &config)));
    out.put("log_odds", cues.iter().map(|c| unary::log_odds(c, &config)));
    Ok(out)
}

fn nodes(fields: Fields<'_>) -> Result<Vec<Node>, OwnError> {
    let (p, uv) = (fields.rows::<3>("p_world")?, fields.rows::<2>("uv_px")?);
    let (reproj, seen) = (fields.reals("reproj_px")?, fields.reals("observations")?);
    if [uv.len(), reproj.len(), seen.len()] != [p.len(); 3] {
        return Err(fields.wrong("the numbers of nodes differ"));
    }
    let node = |i: usize| Node {
        p_world: Vector3::from(p[i]),
        uv_px: number(uv[i][0]).map(|_| Vector2::from(uv[i])),
        cues: Cues {
            reproj_px: number(reproj[i]),
            observations: count(seen[i]),
            ..Cues::default()
        },
        previous: None,
    };
    Ok((0..p.len()).map(node).collect())
}

fn field_config(fields: Fields<'_>) -> Result<CrfConfig, OwnError> {
    let n = |name| fields.number(name);
    let mut config = CrfConfig {
        kernels: KernelConfig {
            feature_weight: n("feature_weight")?,
            sigma_reproj_px: n("sigma_reproj_px")?,
            sigma_observations: n("sigma_observations")?,
            position_weight: n("position_weight")?,
            sigma_m: n("sigma_m")?,
            sigma_px: n("sigma_px")?,
            distance: of_word(
                fields,
                "distance",
                &[("squared", Distance::Squared), ("linear", Distance::Linear)],
            )?,
            terms: of_word(
                fields,
                "terms",
                &[
                    ("both", PositionTerms::Both),
                    ("space", PositionTerms::Space),
                    ("pixel", PositionTerms::Pixel),
                ],
            )?,
        },
        ..CrfConfig::default()
    };
    let field = &mut config.mean_field;
    field.normalisation = of_word(
        fields,
        "normalisation",
        &[
            ("none", Normalisation::None),
            ("rows", Normalisation::Rows),
            ("symmetric", Normalisation::Symmetric),
        ],
    )?;
    field.self_message = fields.switch("self_message")?;
    field.damping = n("damping")?;
    field.method = Method::Reference;
    Ok(config)
}

type PairKernel = fn(&Node, &Node, &KernelConfig) -> f64;

pub(super) fn kernels(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let (nodes, config) = (nodes(fields)?, field_config(fields)?.kernels);
    let mut out = Outputs::default();
    for (name, kernel) in [
        ("k1", kernel::feature as PairKernel),
        ("k2", kernel::position),
    ] {
        let row = |a| nodes.iter().map(move |b| (a, b));
        let pairs = nodes.iter().flat_map(row);
        out.put(name, pairs.map(|(a, b)| kernel(a, b, &config)));
    }
    Ok(out)
}

fn codes(labels: &[Label]) -> impl Iterator<Item = u8> {
    labels.iter().map(|l| u8::from(*l == Label::Dynamic))
}

pub(super) fn mean_field(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let (nodes, log_odds) = (nodes(fields)?, fields.reals("log_odds")?);
    let wrong = |error: CrfError| fields.wrong(error);
    let mut config = field_config(fields)?;
    let (mut after_each, mut labels) = (Vec::new(), Vec::new());
    let mut last = Vec::new();
    for count in fields.word("iterations")?.split(' ') {
        let count = count.parse();
        config.mean_field.iterations = count.map_err(|_| fields.wrong("iterations"))?;
        let crf = Crf::new(config.clone()).map_err(wrong)?;
        let beliefs = crf.infer_from_log_odds(&nodes, &log_odds, Par::Seq);
        let beliefs = beliefs.map_err(wrong)?;
        last.clone_from(&beliefs.dynamic);
        after_each.extend(beliefs.dynamic);
        labels = beliefs.labels;
    }
    let mut out = Outputs::default();
    out.put("q", after_each);
    out.put_whole("labels", codes(&labels));
    if fields.asks("energy") || fields.asks("log_z") {
        let crf = written_out(fields, &nodes, &log_odds, &config)?;
        out.put("energy", [crf.energy(&labels)]);
        if fields.asks("log_z") {
            let all = crf.enumerate().map_err(wrong)?;
            out.put_whole("map", codes(&all.map));
            out.put("map_energy", [all.map_energy]);
            out.put("log_z", [all.log_z]);
            out.put("marginals", all.dynamic);
            out.put("free_energy", [crf.free_energy(&last)]);
        }
    }
    Ok(out)
}

/// The couplings of eq. 4, symmetric.
fn written_out(
    fields: Fields<'_>,
    nodes: &[Node],
    log_odds: &[f64],
    config: &CrfConfig,
) -> Result<SmallCrf, OwnError> {
    let n = nodes.len();
    let mut coupling = vec![0.0; n * n];
    let k = &config.kernels;
    for (weight, of) in [
        (k.feature_weight, kernel::feature as PairKernel),
        (k.position_weight, kernel::position),
    ] {
        let value = |i: usize, j: usize| match i == j {
            true => 0.0,
            false => of(&nodes[i], &nodes[j], k),
        };
        let rows: Vec<f64> = (0..n)
            .map(|i| (0..n).fold(0.0, |sum, j| sum + value(i, j)))
            .collect();
        for i in 0..n {
            for j in 0..n {
                let divisor = match config.mean_field.normalisation {
                    Normalisation::Symmetric => (rows[i] * rows[j]).sqrt(),
                    _ => 1.0,
                };
                coupling[i * n + j] += weight * value(i, j) / divisor;
            }
        }
    }
    SmallCrf::from_log_odds(log_odds, coupling).map_err(|error| fields.wrong(error))
}

pub(super) fn window(fields: Fields<'_>) -> Result<Outputs, OwnError> {
    let config = LabelWindowConfig {
        runs: count(fields.number("runs")?).unwrap_or_default(),
        reading: of_word(
            fields,
            "reading",
            &[
                ("static_share", WindowReading::StaticShare),
                ("literal", WindowReading::Literal),
            ],
        )?,
    };
    let mut window = LabelWindow::default();
    let (mut scores, mut removed) = (Vec::new(), Vec::new());
    for label in fields.bytes("labels")? {
        window.push([Label::Static, Label::Dynamic][usize::from(label == 1)]);
        scores.extend(window.score(&config));
        removed.push(u8::from(window.is_removed(&config)));
    }
    let mut out = Outputs::default();
    out.put("score", scores);
    out.put_whole("removed", removed);
    Ok(out)
}
