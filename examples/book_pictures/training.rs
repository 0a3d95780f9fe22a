//! Chapters 12 and 13: a map that learns from coarse to fine, and why the order of a sum matters.

use garad::core::{Real, RgbImage, Rng};
use garad::pictures::color_picture;
use garad::raster::{RenderOptions, fast};
use garad::slam::{Config, FrameInput, Silent, Slam};
use garad::synth::{Scene, SceneConfig, SceneName};

use crate::canvas::{BLACK, BLUE, Canvas, GREEN, ORANGE};
use crate::chart::Chart;
use crate::{Drawn, par};

/// What the map looks like before and after training, and the loss on the way.
pub(crate) fn coarse_to_fine() -> Drawn {
    let scene = Scene::new(&SceneConfig {
        width: 240,
        height: 180,
        frames: 12,
        static_twin: true,
        ..SceneConfig::new(SceneName::QuietDesk)
    })?;
    let mut canvas = Canvas::new(3 * 250, 520);
    let mut left = 5;
    let mut losses = Vec::new();
    let mut last = None;
    for iterations in [0, 30, 240] {
        let (slam, levels) = trained(&scene, iterations)?;
        let pose = slam
            .trajectory()
            .last()
            .ok_or("not tracked")?
            .world_from_camera;
        let map = slam.gaussians().ok_or("no map")?;
        let options = RenderOptions::default();
        let drawn = fast::render(map, slam.camera(), &pose.inverse(), &options, par())?;
        canvas.text(
            [left as f64, 6.0],
            &format!("{iterations} iterations"),
            BLACK,
        );
        canvas.paste(&color_picture(&drawn), [left, 28], 1);
        left += 250;
        losses = levels;
        last = Some(drawn);
    }
    last.ok_or("nothing drawn")?;
    let chart = Chart::new(
        &mut canvas,
        [[60.0, 250.0], [730.0, 480.0]],
        [[0.0, 240.0], [0.0, 0.6]],
        [&[0.0, 60.0, 120.0, 180.0, 240.0], &[0.0, 0.2, 0.4, 0.6]],
        |v| format!("{v}"),
    );
    canvas.text([60.0, 226.0], "loss:", BLACK);
    for (level, color) in [(2, ORANGE), (1, GREEN), (0, BLUE)] {
        let x = 160.0 + 150.0 * f64::from(2 - level);
        canvas.text(
            [x, 226.0],
            ["full size", "1/2", "1/4"][level as usize],
            color,
        );
        for (i, (_, loss)) in losses
            .iter()
            .enumerate()
            .filter(|(_, step)| step.0 == level as usize)
        {
            let point = [i as f64, f64::from(*loss)];
            if chart.holds(point) {
                canvas.disc(chart.at(point), 2.5, color);
            }
        }
    }
    Ok(canvas.picture)
}

/// A map, and level and loss of each iteration.
type Trained = (Slam, Vec<(usize, f32)>);

/// The map after so many iterations.
fn trained(scene: &Scene, iterations: usize) -> Result<Trained, Box<dyn std::error::Error>> {
    let mut config = Config::default();
    config.train.per_keyframe = 0;
    config.train.per_frame = 0;
    config.train.refine = iterations;
    let mut slam = Slam::new(scene.camera(), config, 0, par())?;
    for i in 0..scene.len() {
        let frame = scene.frame(i, par());
        let input = FrameInput {
            t_s: frame.t_s,
            rgb: &frame.rgb,
            depth: &frame.depth,
            mask: None,
        };
        slam.process(&input, &mut Silent)?;
    }
    slam.finish()?;
    let mut steps = Vec::new();
    slam.refine_map(&mut |step| steps.push((step.level, step.loss)))?;
    Ok((slam, steps))
}

/// One hundred thousand numbers added in f32 in five hundred orders: how often which answer.
pub(crate) fn orders_of_a_sum() -> Drawn {
    let mut rng = Rng::new(8);
    let mut values: Vec<f32> = (0..100_000)
        .map(|_| Real::exp(-8.0 * rng.uniform()).to_f32())
        .collect();
    let exact: f64 = values.iter().map(|v| f64::from(*v)).sum();
    let mut misses = Vec::new();
    for _ in 0..500 {
        for i in (1..values.len()).rev() {
            values.swap(i, rng.below(i + 1));
        }
        let sum: f32 = values.iter().sum();
        misses.push((f64::from(sum) - exact) / exact * 1e6);
    }
    let bin = |miss: f64| ((miss + 30.0) / 2.0).floor() as i64;
    let mut canvas = Canvas::new(760, 330);
    canvas.text(
        [60.0, 8.0],
        "500 orders of one sum in f32: error, millionths",
        BLACK,
    );
    let chart = Chart::new(
        &mut canvas,
        [[60.0, 34.0], [730.0, 290.0]],
        [[-30.0, 30.0], [0.0, 100.0]],
        [
            &[-30.0, -20.0, -10.0, 0.0, 10.0, 20.0, 30.0],
            &[0.0, 50.0, 100.0],
        ],
        |v| format!("{v:.0}"),
    );
    for k in 0..30 {
        let count = misses.iter().filter(|miss| bin(**miss) == k).count();
        let x = -29.0 + 2.0 * k as f64;
        if count > 0 {
            let ([x0, y1], [x1, y0]) =
                (chart.at([x - 0.8, 0.0]), chart.at([x + 0.8, count as f64]));
            canvas.area([x0, y0], [x1, y1], BLUE);
        }
    }
    let picture: RgbImage = canvas.picture;
    Ok(picture)
}
