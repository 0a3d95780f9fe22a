//! Tests of the flow check: by hand, on both sides of each threshold, and as laws.

use super::*;
use garad_core::Rng;
use garad_core::chi_square::CHI2_2DOF_95;
use nalgebra::Matrix2;
use proptest::prelude::*;

fn literal() -> FlowConfig {
    FlowConfig {
        min_support: 3,
        ..FlowConfig::as_printed()
    }
}

/// Raw flow and plain moments with a floor of (0.5 px)².
fn floored() -> FlowConfig {
    FlowConfig {
        covariance_floor_px2: 0.25,
        ..FlowConfig::as_printed()
    }
}

fn points(vectors: &[[f64; 2]]) -> Vec<FlowPoint> {
    let raw = |&[x, y]: &[f64; 2]| FlowPoint::raw(Vector2::new(x, y));
    vectors.iter().map(raw).collect()
}

/// `n` draws from a Gaussian with this mean and these columns of a square root of the covariance.
fn gaussian(n: usize, mean: [f64; 2], [a, b]: [[f64; 2]; 2], seed: u64) -> Vec<Vector2<f64>> {
    let mut rng = Rng::new(seed);
    let mut draw = || Vector2::from(a) * rng.normal() + Vector2::from(b) * rng.normal();
    (0..n).map(|_| Vector2::from(mean) + draw()).collect()
}

fn model(vectors: &[Vector2<f64>], config: &FlowConfig) -> FlowModel {
    let fit = fit_flow(vectors, config).expect("finite vectors");
    *fit.model().expect("enough of them")
}

/// The formulas typed again, with the inverse of the covariance written out.
#[test]
fn spec_flow_check() {
    let static_flow = gaussian(37, [3.0, -1.0], [[0.8, 0.3], [0.0, 0.5]], 1);
    let suspects = gaussian(50, [3.0, -1.0], [[2.0, 0.0], [0.5, 1.5]], 2);
    for floor in [0.0, 0.25] {
        let config = FlowConfig {
            covariance_floor_px2: floor,
            ..literal()
        };
        let n = 37.0;
        let mean = |k: usize| static_flow.iter().map(|v| v[k]).sum::<f64>() / n;
        let (mx, my) = (mean(0), mean(1));
        let product = |i: usize, j: usize| {
            let m = [mx, my];
            let sum: f64 = static_flow
                .iter()
                .map(|v| (v[i] - m[i]) * (v[j] - m[j]))
                .sum();
            sum / (n - 1.0)
        };
        let (sxx, sxy, syy) = (product(0, 0) + floor, product(0, 1), product(1, 1) + floor);
        let determinant = sxx * syy - sxy * sxy;
        let raw = |v: &[Vector2<f64>]| v.iter().map(|v| FlowPoint::raw(*v)).collect::<Vec<_>>();
        let found = verify_flow(&raw(&static_flow), &raw(&suspects), &config).expect("finite flow");
        let (mut inside, mut outside) = (0, 0);
        for (v, verdict) in suspects.iter().zip(&found.verdicts) {
            let (dx, dy) = (v.x - mx, v.y - my);
            let expected = (syy * dx * dx - 2.0 * sxy * dx * dy + sxx * dy * dy) / determinant;
            let verdict = verdict.expect("there is a model");
            let error = (verdict.distance2 - expected).abs();
            assert!(error <= 1e-12 * expected, "{verdict:?} {expected}");
            assert_eq!(verdict.inside, expected <= CHI2_2DOF_95, "{expected}");
            inside += usize::from(verdict.inside);
            outside += usize::from(!verdict.inside);
        }
        assert!(inside > 5 && outside > 5, "{inside} in, {outside} out");
    }
}

#[test]
fn both_sides_of_the_threshold() {
    // Mean 0 and covariance 2/3 I: the edge is at sqrt(5.991 * 2/3).
    let static_points = points(&[[-1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]);
    let edge = (CHI2_2DOF_95 * 2.0 / 3.0).sqrt();
    let suspects = points(&[[edge - 1e-12, 0.0], [0.0, -edge - 1e-12]]);
    let found = verify_flow(&static_points, &suspects, &literal()).expect("finite");
    let inside = found.verdicts.iter().map(|v| v.expect("a model").inside);
    assert_eq!(inside.collect::<Vec<_>>(), [true, false], "in and out");
    // Exactly on it is inside: distance 1.5 (1)² = 1.5.
    let config = FlowConfig {
        chi2: model(
            &[Vector2::x(), -Vector2::x(), Vector2::y(), -Vector2::y()],
            &literal(),
        )
        .distance2(&Vector2::x()),
        ..literal()
    };
    let found = verify_flow(&static_points, &points(&[[1.0, 0.0]]), &config).expect("finite");
    assert!(found.verdicts[0].expect("a model").inside, "on the edge");
}

#[test]
fn too_little_support_decides_nothing() {
    let flow = gaussian(10, [1.0, 2.0], [[0.3, 0.0], [0.0, 0.3]], 3);
    let config = floored();
    assert_eq!(model(&flow, &config).support, 10, "just enough");
    let few = FlowFit::TooFew { got: 9, needed: 10 };
    assert_eq!(fit_flow(&flow[..9], &config), Ok(few), "one less");
    let raw: Vec<_> = flow[..9].iter().map(|v| FlowPoint::raw(*v)).collect();
    let found = verify_flow(&raw, &raw[..2], &config).expect("finite");
    assert_eq!(found.verdicts, [None, None], "nothing is decided");
    let found = verify_flow(&[], &raw[..1], &config).expect("finite");
    assert_eq!(found.verdicts, [None], "nor from nothing");
    assert!(
        fit_flow(&[], &config).is_ok_and(|fit| fit.model().is_none()),
        "empty"
    );
    let raw: Vec<_> = flow.iter().map(|v| FlowPoint::raw(*v)).collect();
    let off = FlowConfig {
        enabled: false,
        ..config
    };
    let found = verify_flow(&raw, &raw[..2], &off).expect("finite");
    let nothing = (FlowFit::Disabled, vec![None, None]);
    assert_eq!((found.fit, found.verdicts), nothing, "switched off");
}

/// A camera at rest: all flows are 0, and only the floor makes a model of them.
#[test]
fn equal_flows_need_the_floor() {
    let still = vec![Vector2::zeros(); 20];
    assert_eq!(fit_flow(&still, &literal()), Ok(FlowFit::Singular), "point");
    let line: Vec<_> = (0..20)
        .map(|k| Vector2::new(0.1, 0.3) * f64::from(k))
        .collect();
    assert_eq!(fit_flow(&line, &literal()), Ok(FlowFit::Singular), "line");
    let upright: Vec<_> = (0..20).map(|k| Vector2::y() * f64::from(k)).collect();
    assert_eq!(
        fit_flow(&upright, &literal()),
        Ok(FlowFit::Singular),
        "upright"
    );
    for estimator in [
        FlowEstimator::Moments,
        FlowEstimator::MedianMad,
        FlowEstimator::Trimmed,
    ] {
        let config = FlowConfig {
            estimator,
            ..floored()
        };
        let still = model(&still, &config);
        // (0.5 px)²: 1.2 px is 5.76, 1.25 px is 6.25.
        let distance2 = [1.2, 1.25].map(|x| still.distance2(&Vector2::new(x, 0.0)));
        assert!(
            distance2[0] < CHI2_2DOF_95 && distance2[1] > CHI2_2DOF_95,
            "{estimator:?}: {distance2:?}"
        );
    }
}

/// The camera rolls: raw flow is spread all over, and a walker's flow is among it; what is left
/// after the prediction is noise, and the walker stands out.
#[test]
fn residual_form_sees_what_raw_flow_hides() {
    let mut rng = Rng::new(4);
    let mut rolled = |own: Vector2<f64>| {
        let at = Vector2::new(rng.range(-320.0, 320.0), rng.range(-240.0, 240.0));
        let predicted = Vector2::new(-at.y, at.x) * 0.03;
        let noise = Vector2::new(rng.normal(), rng.normal()) * 0.2;
        FlowPoint {
            flow: predicted + own + noise,
            predicted: Some(predicted),
        }
    };
    let static_points: Vec<_> = (0..200).map(|_| rolled(Vector2::zeros())).collect();
    let walker: Vec<_> = (0..20).map(|_| rolled(Vector2::new(4.0, 0.5))).collect();
    let inside = |model| {
        let config = FlowConfig { model, ..floored() };
        let found = verify_flow(&static_points, &walker, &config).expect("finite");
        let verdicts = found.verdicts.iter();
        verdicts.filter(|v| v.expect("a model").inside).count()
    };
    assert!(
        inside(FlowForm::Raw) >= 15,
        "raw: {}",
        inside(FlowForm::Raw)
    );
    assert_eq!(inside(FlowForm::Residual), 0, "residual");
}

#[test]
fn points_without_prediction_are_left_out_of_the_residual_form() {
    let config = FlowConfig {
        model: FlowForm::Residual,
        ..floored()
    };
    let with = |x: f64| FlowPoint {
        flow: Vector2::new(x, 0.1 * x * x),
        predicted: Some(Vector2::new(0.5, 0.0)),
    };
    let mut static_points: Vec<_> = (0..10).map(|k| with(f64::from(k))).collect();
    let before = verify_flow(&static_points, &[with(3.0)], &config).expect("finite");
    static_points.push(FlowPoint::raw(Vector2::new(900.0, 0.0)));
    // Not used, so it may be anything.
    static_points.push(FlowPoint::raw(Vector2::new(f64::NAN, 0.0)));
    let suspects = [with(3.0), FlowPoint::raw(Vector2::zeros())];
    let after = verify_flow(&static_points, &suspects, &config).expect("finite");
    assert_eq!(after.fit, before.fit, "same model");
    assert_eq!(after.verdicts, [before.verdicts[0], None], "one undecided");
    assert!(before.verdicts[0].is_some(), "the other decided");
}

#[test]
fn medians_by_hand() {
    let config = FlowConfig {
        estimator: FlowEstimator::MedianMad,
        ..literal()
    };
    let flow = [[1.0, 0.0], [2.0, 4.0], [3.0, 8.0], [90.0, 12.0]].map(Vector2::from);
    // x: median 2.5, deviations 1.5 0.5 0.5 87.5, their median 1; y: median 6, deviations 6 2 2 6,
    // their median 4.
    let found = model(&flow, &config);
    assert_eq!(found.mean, Vector2::new(2.5, 6.0), "medians");
    let unit = 1.482_602_218_505_602f64 * 1.482_602_218_505_602;
    let expected = Matrix2::from_diagonal(&Vector2::new(unit, 16.0 * unit));
    assert!(
        (found.covariance - expected).norm() < 1e-13,
        "{}",
        found.covariance
    );
}

#[test]
fn wrong_points_inflate_the_moments_only() {
    let good = gaussian(200, [2.0, 1.0], [[0.5, 0.2], [0.0, 0.4]], 5);
    let wrong = gaussian(60, [-6.0, 3.0], [[1.0, 0.0], [0.0, 1.0]], 6);
    let all = [good.clone(), wrong].concat();
    let of = |vectors: &[Vector2<f64>], estimator| {
        let config = FlowConfig {
            estimator,
            ..literal()
        };
        model(vectors, &config)
    };
    let truth = of(&good, FlowEstimator::Moments);
    let suspect = Vector2::new(-2.0, 2.0); // between the two groups
    assert!(truth.distance2(&suspect) > 30.0, "far from the good ones");
    let moments = of(&all, FlowEstimator::Moments);
    assert!(
        moments.distance2(&suspect) < 2.0,
        "passes: {}",
        moments.distance2(&suspect)
    );
    for estimator in [FlowEstimator::MedianMad, FlowEstimator::Trimmed] {
        let robust = of(&all, estimator);
        let shift = (robust.mean - truth.mean).norm();
        assert!(shift < 0.35, "{estimator:?}: mean moved by {shift}");
        assert!(robust.distance2(&suspect) > 15.0, "{estimator:?}");
    }
    let trimmed = of(&all, FlowEstimator::Trimmed);
    assert!(
        (170..=205).contains(&trimmed.support),
        "{}",
        trimmed.support
    );
}

/// On clean data the cut and its correction cancel.
#[test]
fn trimming_does_not_shrink_a_gaussian() {
    let clean = gaussian(20_000, [0.0; 2], [[0.7, 0.0], [0.0, 1.9]], 7);
    for estimator in [FlowEstimator::Trimmed, FlowEstimator::MedianMad] {
        let config = FlowConfig {
            estimator,
            ..literal()
        };
        let found = model(&clean, &config).covariance;
        let ratios = [found[(0, 0)] / 0.49, found[(1, 1)] / 3.61];
        assert!(
            ratios.iter().all(|r| (r - 1.0).abs() < 0.05),
            "{estimator:?}: {ratios:?}"
        );
    }
}

#[test]
fn five_percent_of_static_points_are_outside() {
    // Whatever the shape of the ellipse.
    let flow = gaussian(40_000, [5.0, -2.0], [[2.0, 0.4], [0.1, 0.2]], 8);
    let fitted = model(&flow, &literal());
    let outside = flow
        .iter()
        .filter(|v| fitted.distance2(v) > CHI2_2DOF_95)
        .count();
    assert!((1800..2200).contains(&outside), "{outside} of 40000");
}

#[test]
fn bad_settings_and_bad_numbers_are_errors() {
    let good = floored();
    type Break = fn(&mut FlowConfig);
    let breaks: [(&str, Break); 6] = [
        ("covariance_floor_px2", |c| c.covariance_floor_px2 = -0.1),
        ("covariance_floor_px2", |c| {
            c.covariance_floor_px2 = f64::NAN
        }),
        ("covariance_floor_px2", |c| {
            c.covariance_floor_px2 = f64::INFINITY
        }),
        ("min_support", |c| c.min_support = 2),
        ("chi2", |c| c.chi2 = 0.0),
        ("chi2", |c| c.chi2 = f64::NAN),
    ];
    for (name, spoil) in breaks {
        let mut config = good;
        spoil(&mut config);
        let error = fit_flow(&[], &config).expect_err(name).to_string();
        assert!(error.starts_with(name), "{error}");
    }
    for poison in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        let flow = points(&[[0.0, poison]]);
        assert!(verify_flow(&flow, &[], &good).is_err(), "static {poison}");
        assert!(verify_flow(&[], &flow, &good).is_err(), "suspect {poison}");
    }
    // Finite, but their squares are not.
    let huge: Vec<_> = (0..12)
        .map(|k| Vector2::new(1e200, 1.0) * f64::from(k))
        .collect();
    assert_eq!(fit_flow(&huge, &good), Ok(FlowFit::Singular), "overflow");
}

proptest! {
    /// Distances do not depend on the origin, the scale and the axes of the flow.
    #[test]
    fn distance_is_affine_invariant(
        seed: u64, shift in proptest::array::uniform2(-50.0f64..50.0),
        turn in -3.0f64..3.0, scale in 0.1f64..10.0, skew in -2.0f64..2.0,
    ) {
        let flow = gaussian(30, [1.0, -2.0], [[0.6, 0.1], [-0.2, 0.9]], seed);
        let (sin, cos) = libm::sincos(turn);
        let a = Matrix2::new(cos, -sin, sin, cos) * Matrix2::new(scale, skew, 0.0, 1.0);
        let moved = flow.iter().map(|v| a * v + Vector2::from(shift));
        let moved: Vec<_> = moved.collect();
        let [before, after] = [model(&flow, &literal()), model(&moved, &literal())];
        for (v, w) in flow.iter().zip(&moved) {
            let (d, e) = (before.distance2(v), after.distance2(w));
            prop_assert!((d - e).abs() <= 1e-9 * (1.0 + d), "{d} {e}");
        }
    }

    /// The squared distances of the n vectors themselves add up to 2 (n - 1), the trace of the
    /// identity times n - 1.
    #[test]
    fn distances_add_up(seed: u64, n in 3usize..60) {
        let flow = gaussian(n, [4.0, 0.0], [[1.0, 0.7], [0.0, 0.05]], seed);
        let fitted = model(&flow, &literal());
        let sum: f64 = flow.iter().map(|v| fitted.distance2(v)).sum();
        let expected = 2.0 * (n as f64 - 1.0);
        prop_assert!((sum - expected).abs() < 1e-7 * expected, "{sum} {expected}");
    }

    #[test]
    fn a_floor_brings_everything_nearer(seed: u64, floor in 0.01f64..4.0) {
        let flow = gaussian(20, [0.0; 2], [[0.5, 0.1], [0.0, 0.3]], seed);
        let config = FlowConfig { covariance_floor_px2: floor, ..literal() };
        let [plain, floored] = [literal(), config].map(|c| model(&flow, &c));
        for v in &flow {
            prop_assert!(floored.distance2(v) <= plain.distance2(v));
        }
    }
}

/// Covariance 2/3 I: (1, 0) is at 1.5, (2, 0) at 6, which 1.6 and 5.9 tell apart, and 6.1 does not.
#[test]
fn the_gate_is_that_of_the_configuration() {
    let static_points = points(&[[-1.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]);
    for (chi2, expected) in [
        (1.4, [false, false]),
        (1.6, [true, false]),
        (5.9, [true, false]),
        (6.1, [true, true]),
    ] {
        let config = FlowConfig { chi2, ..literal() };
        let found = verify_flow(&static_points, &points(&[[1.0, 0.0], [0.0, 2.0]]), &config);
        let verdicts = found.expect("finite").verdicts;
        let inside: Vec<bool> = verdicts
            .iter()
            .map(|v| v.expect("a model").inside)
            .collect();
        assert_eq!(inside, expected, "χ² {chi2}");
    }
}

/// Medians 0; deviations 0 0 1 1 1 1 1 3 3 along x and 0 0 0 2 2 2 2 2 2 along y: σ = 1.48 and 2.97, and 3 px along x
/// with 2 along y is at (3/1.48)² + (2/2.97)² = 4.55, 4 px at 7.74.
#[test]
fn trimming_by_hand() {
    let near = [
        [0.0, 0.0],
        [1.0, 0.0],
        [-1.0, 0.0],
        [0.0, 2.0],
        [0.0, -2.0],
        [1.0, 2.0],
        [-1.0, -2.0],
        [1.0, -2.0],
        [-1.0, 2.0],
    ];
    let with = |x: f64| {
        [
            near.map(Vector2::from).to_vec(),
            vec![Vector2::new(x, 2.0), Vector2::new(-x, -2.0)],
        ]
        .concat()
    };
    let config = FlowConfig {
        estimator: FlowEstimator::Trimmed,
        min_support: 10,
        ..literal()
    };
    // 0.95 / (1 - 0.05 (1 + c/2)) with c/2 = ln 20
    let enlarged = 0.95 / (1.0 - 0.05 * (1.0 + libm::log(20.0)));
    let all = model(&with(3.0), &config);
    assert_eq!(all.support, 11, "none is cut");
    let expected = Matrix2::new(6.0 + 18.0, 12.0, 12.0, 24.0 + 8.0) / 10.0 * enlarged;
    assert!(
        (all.covariance - expected).amax() < 1e-12,
        "{} {expected}",
        all.covariance
    );
    let few = FlowFit::TooFew { got: 9, needed: 10 };
    assert_eq!(fit_flow(&with(4.0), &config), Ok(few), "two are cut");
    // The floor widens the cut, too: 16/(2.2 + 2) + 4/(8.8 + 2) = 4.18.
    let floored = FlowConfig {
        covariance_floor_px2: 2.0,
        ..config
    };
    assert_eq!(model(&with(4.0), &floored).support, 11, "with the floor");
    let nine = FlowConfig {
        min_support: 9,
        ..config
    };
    assert_eq!(model(&with(4.0), &nine).support, 9, "nine are enough");
}
