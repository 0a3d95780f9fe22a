//! Chapters 5 and 7: flow that fits and flow that does not, and a field of beliefs.

use garad::core::chi_square::CHI2_2DOF_95;
use garad::core::{Par, Real, Rng};
use garad::crf::{Crf, Node};
use garad::features::flow::{FlowConfig, FlowEstimator, FlowForm, FlowPoint, verify_flow};
use garad::features::{LkConfig, LkPyramid, OrbConfig, OrbExtractor, lk};
use garad::slam::Config;
use garad::synth::SceneName;
use nalgebra::{Vector2, Vector3};

use crate::canvas::{BLACK, BLUE, Canvas, ORANGE, PALE};
use crate::chart::Chart;
use crate::features::scene;
use crate::{Drawn, par};

/// The flow of keypoints, raw and less what the camera's motion does, and the 95 % ellipse of the
/// static ones.
pub(crate) fn flow_check() -> Drawn {
    let scene = scene(SceneName::Walking)?;
    let camera = scene.camera();
    let frames = [scene.frame(20, par()), scene.frame(25, par())];
    let [prev, next] = [&frames[0], &frames[1]].map(|f| LkPyramid::new(&f.rgb.to_gray(), 3));
    let config = OrbConfig {
        features: 600,
        ..OrbConfig::default()
    };
    let corners = OrbExtractor::new(config)?.extract(&frames[0].rgb.to_gray(), Par::Seq)?;
    let points: Vec<[f32; 2]> = corners.keypoints.iter().map(|k| [k.x, k.y]).collect();
    let found = lk::track(
        &prev?,
        &next?,
        &points,
        None,
        &LkConfig::default(),
        Par::Seq,
    )?;
    let motion = frames[1].world_from_camera.inverse() * frames[0].world_from_camera;
    let (mut still, mut movers) = (Vec::new(), Vec::new());
    for (from, track) in points
        .iter()
        .zip(&found)
        .filter(|(_, track)| track.is_tracked())
    {
        let pixel = from.map(|v| (v + 0.5) as usize);
        let (from, to) = (from.map(f64::from), track.xy.map(f64::from));
        let uv = Vector2::new(from[0], from[1]);
        let depth_m = f64::from(frames[0].depth[(pixel[0], pixel[1])]);
        let predicted = (depth_m > 0.0)
            .then(|| camera.project(&(motion * camera.unproject(&uv, depth_m))))
            .flatten();
        let point = FlowPoint {
            flow: Vector2::new(to[0], to[1]) - uv,
            predicted: predicted.map(|p| p - uv),
        };
        if predicted.is_some() {
            let moves = frames[0].mask[(pixel[0], pixel[1])] == 255;
            if moves { &mut movers } else { &mut still }.push(point);
        }
    }
    let mut canvas = Canvas::new(860, 440);
    let forms = [
        (
            "flow as measured, px",
            FlowForm::Raw,
            FlowEstimator::Moments,
            60.0,
            30.0,
        ),
        (
            "less the camera's motion",
            FlowForm::Residual,
            FlowEstimator::Trimmed,
            490.0,
            3.0,
        ),
    ];
    for (title, form, estimator, left, reach) in forms {
        let config = FlowConfig {
            model: form,
            estimator,
            covariance_floor_px2: 0.04,
            chi2: CHI2_2DOF_95,
            ..FlowConfig::default()
        };
        let checked = verify_flow(&still, &movers, &config)?;
        let model = *checked.fit.model().ok_or("too few static points")?;
        let recovered = checked
            .verdicts
            .iter()
            .flatten()
            .filter(|v| v.inside)
            .count();
        let middle = if form == FlowForm::Raw {
            model.mean
        } else {
            Vector2::zeros()
        };
        canvas.text([left, 8.0], title, BLACK);
        let ranges = [middle.x, middle.y].map(|m| [m - reach, m + reach]);
        let ticks = |[low, high]: [f64; 2]| {
            let step = if reach > 10.0 { 10.0 } else { 1.0 };
            let first = (low / step).ceil() as i64;
            let last = (high / step).floor() as i64;
            (first..=last)
                .map(|k| step * k as f64)
                .collect::<Vec<f64>>()
        };
        let (across, up) = (ticks(ranges[0]), ticks(ranges[1]));
        let corners = [[left, 34.0], [left + 350.0, 384.0]];
        let chart = Chart::new(&mut canvas, corners, ranges, [&across, &up], |v| {
            format!("{v:.0}")
        });
        let vector = |p: &FlowPoint| match form {
            FlowForm::Raw => Some(p.flow),
            FlowForm::Residual => p.predicted.map(|predicted| p.flow - predicted),
        };
        for (points, color) in [(&still, BLUE), (&movers, ORANGE)] {
            for v in points
                .iter()
                .filter_map(vector)
                .filter(|v| chart.holds([v.x, v.y]))
            {
                canvas.disc(chart.at([v.x, v.y]), 2.2, color);
            }
        }
        let root = model.covariance.cholesky().ok_or("a covariance")?.l();
        let ellipse: Vec<[f64; 2]> = (0..=120)
            .map(|k| {
                let (sin, cos) = Real::sin_cos(std::f64::consts::TAU * f64::from(k) / 120.0);
                let p = model.mean + root * Vector2::new(cos, sin) * config.chi2.sqrt();
                [p.x, p.y]
            })
            .collect();
        chart.curve(&mut canvas, &ellipse, 2.0, BLACK);
        let said = format!("moving inside: {recovered} of {}", movers.len());
        canvas.text([left, 412.0], &said, ORANGE);
    }
    Ok(canvas.picture)
}

const COLUMNS: usize = 40;
const ROWS: usize = 26;

/// Beliefs of a grid of points, some of them misled, before and after the field.
pub(crate) fn field() -> Drawn {
    let mut rng = Rng::new(2);
    let (mut nodes, mut log_odds) = (Vec::new(), Vec::new());
    let moves = |x: usize, y: usize| (14..26).contains(&x) && y >= 6;
    for (y, x) in (0..ROWS).flat_map(|y| (0..COLUMNS).map(move |x| (y, x))) {
        let depth_m = if moves(x, y) { 1.5 } else { 3.0 };
        let uv = Vector2::new(x as f64, y as f64) * 16.0;
        let ray = Vector3::new((uv.x - 320.0) / 525.0, (uv.y - 208.0) / 525.0, 1.0);
        nodes.push(Node {
            p_world: ray * depth_m,
            uv_px: Some(uv),
            ..Node::default()
        });
        let side = if moves(x, y) == (rng.below(6) != 0) {
            1.0
        } else {
            -1.0
        };
        log_odds.push(side * rng.range(0.2, 2.5));
    }
    let together =
        Crf::new(Config::default().crf)?.infer_from_log_odds(&nodes, &log_odds, par())?;
    let alone: Vec<f64> = log_odds
        .iter()
        .map(|u| 1.0 / (1.0 + Real::exp(-u)))
        .collect();
    let mut canvas = Canvas::new(870, 330);
    for (title, beliefs, left) in [
        ("what each point says", &alone, 10.0),
        ("after five rounds", &together.dynamic, 450.0),
    ] {
        canvas.text([left, 6.0], title, BLACK);
        let corner = |x: usize, y: usize| [left + 10.0 * x as f64, 32.0 + 11.0 * y as f64];
        for (i, q) in beliefs.iter().enumerate() {
            let [x, y] = corner(i % COLUMNS, i / COLUMNS);
            // Still blue, moving orange, undecided white.
            let color = crate::canvas::signed(2.0 * q - 1.0);
            canvas.area([x, y], [x + 10.0, y + 11.0], color);
        }
        let [x0, y0] = corner(14, 6);
        let [x1, y1] = corner(26, ROWS);
        canvas.rect([x0 - 1.0, y0 - 1.0], [x1, y1], 1.5, BLACK);
        let (low, high) = (corner(0, 0), corner(COLUMNS, ROWS));
        canvas.rect(low, high, 1.0, PALE);
    }
    Ok(canvas.picture)
}
