//! The committed cases of this crate's stages: truth from numpy, mpmath and plain enumeration.

use garad_core::{Label, Par};
use garad_crf::{
    Crf, CrfConfig, CueModel, Cues, Decision, Distance, Height, KernelConfig, LabelWindow,
    LabelWindowConfig, Method, Node, Normalisation, Pooling, PositionTerms, Score, Side, SmallCrf,
    UnaryConfig, WindowReading, kernel, unary,
};
use garad_golden::Case;
use nalgebra::{Vector2, Vector3};

fn check(case: &Case, name: &str, got: &[f64]) {
    case.check(name, got)
        .unwrap_or_else(|report| panic!("{report}"));
}

fn has(case: &Case, name: &str) -> bool {
    case.output_names().any(|output| output == name)
}

/// A number, or none for NaN.
fn number(x: f64) -> Option<f64> {
    (!x.is_nan()).then_some(x)
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "counts in the cases are small whole numbers"
)]
fn count(x: f64) -> Option<u32> {
    number(x).map(|x| x as u32)
}

fn unary_config(case: &Case) -> UnaryConfig {
    let (mean, sigma, weight) = (
        case.input("mean").f64(),
        case.input("sigma").f64(),
        case.input("weight").f64(),
    );
    let sides: Vec<Side> = case
        .param_str("side")
        .split(' ')
        .map(|side| match side {
            "above" => Side::Above,
            "below" => Side::Below,
            "both" => Side::Both,
            other => panic!("side {other}"),
        })
        .collect();
    let model = |k: usize| CueModel {
        mean: mean[k],
        sigma: sigma[k],
        side: sides[k],
        weight: weight[k],
    };
    let hard = |score| Decision::Hard {
        score,
        threshold: case.param_f64("threshold"),
        threshold_with_epipolar: case.param_f64("threshold_with_epipolar"),
        confidence: case.param_f64("confidence"),
    };
    UnaryConfig {
        reprojection: model(0),
        depth: model(1),
        observations: model(2),
        epipolar: model(3),
        height: match case.param_str("height") {
            "unit" => Height::Unit,
            "density" => Height::Density,
            other => panic!("height {other}"),
        },
        pooling: match case.param_str("pooling") {
            "mean" => Pooling::Mean,
            "geometric" => Pooling::Geometric,
            other => panic!("pooling {other}"),
        },
        decision: match case.param_str("score") {
            "soft" => Decision::Soft,
            "mean" => hard(Score::Mean),
            "sum" => hard(Score::Sum),
            other => panic!("score {other}"),
        },
        clamp: case.param_f64("clamp"),
        min_observations: count(case.param_f64("min_observations")).expect("a number"),
        ..UnaryConfig::default()
    }
}

#[test]
fn unary_terms() {
    for case in Case::load_all("unary") {
        let config = unary_config(&case);
        let cues: Vec<Cues> = case
            .input("cues")
            .f64()
            .chunks(4)
            .map(|c| Cues {
                reproj_px: number(c[0]),
                depth_residual: number(c[1]),
                observations: count(c[2]),
                epipolar_px: number(c[3]),
            })
            .collect();
        let all = |of: &dyn Fn(&Cues) -> f64| -> Vec<f64> { cues.iter().map(of).collect() };
        let mixture = |c: &Cues| unary::mixture_likelihood(c, &config).expect("a node with cues");
        if has(&case, "mixture") {
            check(&case, "mixture", &all(&mixture));
        }
        if has(&case, "psi_static") {
            check(&case, "psi_static", &all(&|c| -libm::log(mixture(c))));
        }
        if has(&case, "p_static") {
            check(&case, "p_static", &all(&|c| unary::p_static(c, &config)));
            check(&case, "log_odds", &all(&|c| unary::log_odds(c, &config)));
        }
    }
}

fn nodes(case: &Case) -> Vec<Node> {
    let (p, uv) = (case.input("p_world").f64(), case.input("uv_px").f64());
    let (reproj, seen) = (
        case.input("reproj_px").f64(),
        case.input("observations").f64(),
    );
    (0..reproj.len())
        .map(|i| Node {
            p_world: Vector3::new(p[3 * i], p[3 * i + 1], p[3 * i + 2]),
            uv_px: number(uv[2 * i]).map(|u| Vector2::new(u, uv[2 * i + 1])),
            cues: Cues {
                reproj_px: number(reproj[i]),
                observations: count(seen[i]),
                ..Cues::default()
            },
            previous: None,
        })
        .collect()
}

fn field_config(case: &Case) -> CrfConfig {
    let mut config = CrfConfig {
        kernels: KernelConfig {
            feature_weight: case.param_f64("feature_weight"),
            sigma_reproj_px: case.param_f64("sigma_reproj_px"),
            sigma_observations: case.param_f64("sigma_observations"),
            position_weight: case.param_f64("position_weight"),
            sigma_m: case.param_f64("sigma_m"),
            sigma_px: case.param_f64("sigma_px"),
            distance: match case.param_str("distance") {
                "squared" => Distance::Squared,
                "linear" => Distance::Linear,
                other => panic!("distance {other}"),
            },
            terms: match case.param_str("terms") {
                "both" => PositionTerms::Both,
                "space" => PositionTerms::Space,
                "pixel" => PositionTerms::Pixel,
                other => panic!("terms {other}"),
            },
        },
        ..CrfConfig::default()
    };
    config.mean_field.normalisation = match case.param_str("normalisation") {
        "none" => Normalisation::None,
        "rows" => Normalisation::Rows,
        "symmetric" => Normalisation::Symmetric,
        other => panic!("normalisation {other}"),
    };
    config.mean_field.self_message = case.param_bool("self_message");
    config.mean_field.damping = case.param_f64("damping");
    config
}

#[test]
fn kernels() {
    for case in Case::load_all("kernel") {
        let (nodes, config) = (nodes(&case), field_config(&case).kernels);
        let pairs = |k: fn(&Node, &Node, &KernelConfig) -> f64| -> Vec<f64> {
            let config = &config;
            let row = |a| nodes.iter().map(move |b| k(a, b, config));
            nodes.iter().flat_map(row).collect()
        };
        check(&case, "k1", &pairs(kernel::feature));
        check(&case, "k2", &pairs(kernel::position));
    }
}

fn codes(labels: &[Label]) -> Vec<f64> {
    labels.iter().map(|l| f64::from(*l as u8)).collect()
}

#[test]
fn mean_field() {
    for case in Case::load_all("mean_field") {
        let nodes = nodes(&case);
        let log_odds = case.input("log_odds").f64();
        let counts: Vec<usize> = case
            .param_str("iterations")
            .split(' ')
            .map(|n| n.parse().expect("a number of iterations"))
            .collect();
        for method in [
            Method::Reference,
            Method::Fast { tail: 0.0 },
            Method::Fast { tail: 1e-17 },
        ] {
            let mut config = field_config(&case);
            config.mean_field.method = method;
            let mut after_each = Vec::new();
            let mut labels = Vec::new();
            for &iterations in &counts {
                config.mean_field.iterations = iterations;
                let crf = Crf::new(config.clone()).expect("a valid configuration");
                let beliefs = crf
                    .infer_from_log_odds(&nodes, &log_odds, Par::Seq)
                    .expect("valid nodes");
                after_each.extend(beliefs.dynamic);
                labels = beliefs.labels;
            }
            check(&case, "q", &after_each);
            if has(&case, "labels") {
                check(&case, "labels", &codes(&labels));
            }
            let small = SmallCrf::from_nodes(&nodes, &log_odds, &config.kernels).expect("N each");
            if has(&case, "log_z") {
                let last = &after_each[after_each.len() - nodes.len()..];
                check_enumeration(&case, &small, last);
            }
            if has(&case, "energy") {
                check(&case, "energy", &[small.energy(&labels)]);
            }
        }
    }
}

fn check_enumeration(case: &Case, crf: &SmallCrf, q: &[f64]) {
    let all = crf.enumerate().expect("few nodes");
    check(case, "map", &codes(&all.map));
    check(case, "map_energy", &[all.map_energy]);
    check(case, "log_z", &[all.log_z]);
    check(case, "marginals", &all.dynamic);
    check(case, "free_energy", &[crf.free_energy(q)]);
    assert!(
        crf.free_energy(q) > -all.log_z,
        "{}: F above -ln Z",
        case.name()
    );
    let found: Vec<f64> = q.iter().map(|q| f64::from(*q > 0.5)).collect();
    assert_eq!(
        found,
        codes(&all.map),
        "{}: mean field finds the best labelling",
        case.name()
    );
}

#[test]
fn label_window() {
    for case in Case::load_all("label_window") {
        let config = LabelWindowConfig {
            runs: count(case.param_f64("runs")).expect("a number"),
            reading: match case.param_str("reading") {
                "static_share" => WindowReading::StaticShare,
                "literal" => WindowReading::Literal,
                other => panic!("reading {other}"),
            },
        };
        let mut window = LabelWindow::default();
        let (mut scores, mut removed) = (Vec::new(), Vec::new());
        for (run, label) in case.input("labels").u8().into_iter().enumerate() {
            window.push(if label == 1 {
                Label::Dynamic
            } else {
                Label::Static
            });
            let full = run >= case.param_usize("first");
            assert_eq!(
                window.score(&config).is_some(),
                full,
                "{}, run {run}",
                case.name()
            );
            scores.extend(window.score(&config));
            removed.push(f64::from(u8::from(window.is_removed(&config))));
        }
        check(&case, "score", &scores);
        check(&case, "removed", &removed);
    }
}
