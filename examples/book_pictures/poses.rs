//! Chapter 6: what a residual may pull, and how Levenberg-Marquardt finds its way.

use garad::core::{Camera, Rng, Se3};
use garad::optim::dense::Dense;
use garad::optim::lm::minimise_observed;
use garad::optim::pose::PoseProblem;
use garad::optim::{LmConfig, PoseObservation, RobustKernel};
use nalgebra::{Vector2, Vector6};

use crate::Drawn;
use crate::canvas::{BLACK, BLUE, Canvas, GRAY, GREEN, ORANGE, PINK};
use crate::chart::Chart;

/// Square root of 5.991: the knee of a residual with two rows.
const DELTA: f64 = 2.447_651_936_039_926;

pub(crate) fn kernels_and_damping() -> Drawn {
    let mut canvas = Canvas::new(880, 380);
    pulls(&mut canvas);
    costs(&mut canvas)?;
    Ok(canvas.picture)
}

/// r ρ'(r²) over r.
fn pulls(canvas: &mut Canvas) {
    canvas.text([60.0, 8.0], "pull of a residual r", BLACK);
    let chart = Chart::new(
        canvas,
        [[60.0, 34.0], [400.0, 340.0]],
        [[0.0, 10.0], [0.0, 5.0]],
        [
            &[0.0, 2.0, 4.0, 6.0, 8.0, 10.0],
            &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0],
        ],
        |v| format!("{v:.0}"),
    );
    let kernels = [
        ("none", GRAY, RobustKernel::None),
        ("huber", BLUE, RobustKernel::Huber { delta: DELTA }),
        ("cauchy", GREEN, RobustKernel::Cauchy { c: DELTA }),
        ("tukey", PINK, RobustKernel::Tukey { c: 2.0 * DELTA }),
    ];
    for (i, (name, color, kernel)) in kernels.into_iter().enumerate() {
        let points: Vec<[f64; 2]> = (0..=400)
            .map(|k| f64::from(k) / 40.0)
            .map(|r| [r, r * kernel.weight(r * r)])
            .collect();
        chart.curve(canvas, &points, 2.5, color);
        canvas.text([318.0, 46.0 + 20.0 * i as f64], name, color);
    }
}

/// Cost after each trial of one pose problem, for three first dampings.
fn costs(canvas: &mut Canvas) -> Result<(), Box<dyn std::error::Error>> {
    let camera = Camera::pinhole((640, 480), [525.0, 525.0, 319.5, 239.5])?;
    let truth = Se3::exp(&Vector6::new(0.2, -0.1, 0.3, 0.05, 0.1, -0.05));
    let mut rng = Rng::new(5);
    let observations: Vec<PoseObservation> = (0..60)
        .map(|i| {
            let seen = Vector2::new(rng.range(0.0, 639.0), rng.range(0.0, 479.0));
            let p_cam = camera.unproject(&seen, rng.range(1.0, 4.0));
            let wrong = if i % 5 == 0 { 60.0 } else { 1.0 };
            PoseObservation {
                p_world: truth.inverse() * p_cam,
                uv_px: seen + Vector2::new(rng.normal(), rng.normal()) * wrong,
                sigma_px: 1.0,
                depth: None,
            }
        })
        .collect();
    let problem = PoseProblem::new(&camera, 40.0, Some([DELTA, DELTA]), observations);
    canvas.text([490.0, 8.0], "cost after each trial", BLACK);
    let chart = Chart::new(
        canvas,
        [[520.0, 34.0], [860.0, 340.0]],
        [[0.0, 12.0], [2.5, 4.5]],
        [&[0.0, 3.0, 6.0, 9.0, 12.0], &[3.0, 4.0]],
        |v| format!("{v:.0}"),
    );
    for (i, (lambda, color)) in [(1e-4, BLUE), (1.0, GREEN), (100.0, ORANGE)]
        .into_iter()
        .enumerate()
    {
        let config = LmConfig {
            iterations: 12,
            lambda,
            cost_tolerance: 0.0,
            ..LmConfig::default()
        };
        let mut points = Vec::new();
        let model = Dense(&problem);
        minimise_observed(&model, Se3::identity(), &config, |trial| {
            if points.is_empty() {
                points.push([0.0, log10(trial.cost)]);
            }
            let best = if trial.accepted {
                trial.new_cost
            } else {
                trial.cost
            };
            points.push([points.len() as f64, log10(best)]);
        });
        chart.curve(canvas, &points, 2.0, color);
        for point in points.iter().filter(|point| chart.holds(**point)) {
            canvas.disc(chart.at(*point), 3.0, color);
        }
        let text = format!("first λ = {lambda}");
        canvas.text([645.0, 46.0 + 20.0 * i as f64], &text, color);
    }
    Ok(())
}

fn log10(v: f64) -> f64 {
    use garad::core::Real;
    Real::ln(v) / std::f64::consts::LN_10
}
