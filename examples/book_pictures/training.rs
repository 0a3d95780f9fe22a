//! Chapters 12 and 13: a map trained from coarse to fine, and why the order of a sum matters.

use garad::core::{FrameId, GaussianMap, KeyframeId, Real, RgbImage, Rng};
use garad::images::color_image;
use garad::raster::{RenderOptions, fast};
use garad::slam::mapping::insert::insert_depth_samples;
use garad::slam::mapping::job::MappingJob;
use garad::slam::mapping::train::{Pick, Trainer, TrainingScene};
use garad::slam::mapping::view::TrainingView;
use garad::slam::trace::Recorder;
use garad::slam::{Config, Context};
use garad::synth::{Scene, SceneConfig, SceneName, SynthFrame};

use crate::canvas::{BLACK, BLUE, Canvas, GREEN, ORANGE};
use crate::chart::Chart;
use crate::{Drawn, par};

/// The keyframes of the small map.
const KEYFRAMES: [usize; 3] = [0, 5, 11];
const ITERATIONS: usize = 240;

/// What the map looks like before and after training, and the loss on the way.
pub(crate) fn coarse_to_fine() -> Drawn {
    let scene = Scene::new(&SceneConfig {
        width: 240,
        height: 180,
        frames: 12,
        static_twin: true,
        ..SceneConfig::new(SceneName::QuietDesk)
    })?;
    let (camera, config) = (scene.camera(), Config::default());
    let context = Context::new(camera, config.clone(), 0, par())?;
    let poses = KEYFRAMES.map(|k| scene.world_from_camera(k).inverse());
    let keyframes = TrainingScene {
        poses: &poses,
        extent_m: 1.0,
        window_runs: 10,
    };
    let mut map = GaussianMap::new(0);
    let mut trainer = Trainer::new(&camera, 0)?;
    for (id, &index) in (0..).map(KeyframeId).zip(&KEYFRAMES) {
        let SynthFrame { rgb, depth, .. } = scene.frame(index, par());
        let job = MappingJob {
            keyframe: id,
            frame: FrameId(0),
            rgb,
            depth,
            mask: None,
            cells: None,
            labels: Vec::new(),
            cues: Vec::new(),
            restored: std::collections::BTreeSet::new(),
            poses: Vec::new(),
            moved: Vec::new(),
            new_landmarks: Vec::new(),
            living: Vec::new(),
            iterations: 0,
        };
        insert_depth_samples(&context, &mut map, &job, &poses[id.index()])?;
        trainer.add_view(TrainingView::new(id, job.rgb, Some(job.depth), None, 0));
    }
    let mut canvas = Canvas::new(3 * 250, 520);
    let chart = Chart::new(
        &mut canvas,
        [[60.0, 250.0], [730.0, 480.0]],
        [[0.0, ITERATIONS as f64], [0.0, 0.15]],
        [&[0.0, 60.0, 120.0, 180.0, 240.0], &[0.0, 0.05, 0.1, 0.15]],
        |v| format!("{v}"),
    );
    canvas.text([60.0, 226.0], "loss:", BLACK);
    let levels = [("full size", BLUE), ("1/2", GREEN), ("1/4", ORANGE)];
    for ((name, color), left) in levels.into_iter().rev().zip([160.0, 310.0, 460.0]) {
        canvas.text([left, 226.0], name, color);
    }
    let mut left = 5;
    for i in 0..=ITERATIONS {
        if [0, 30, ITERATIONS].contains(&i) {
            let pose = poses[2];
            let drawn = fast::render(&map, &camera, &pose, &RenderOptions::default(), par())?;
            canvas.text([left as f64, 6.0], &format!("{i} iterations"), BLACK);
            canvas.paste(&color_image(&drawn), [left, 28], 1);
            left += 250;
        }
        // As after the last frame, nothing is cloned or split in the second half.
        let grow = (i < ITERATIONS / 2).then_some(&config.densify);
        let pick = Pick::Shuffled;
        let (train, recorder) = (&config.train, &mut Recorder::default());
        let step = trainer.step(&mut map, pick, keyframes, train, grow, par(), recorder)?;
        let step = step.ok_or("nothing to train on")?;
        let point = [i as f64, f64::from(step.loss)];
        if chart.holds(point) {
            canvas.disc(chart.at(point), 2.5, levels[step.level].1);
        }
    }
    Ok(canvas.picture)
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
