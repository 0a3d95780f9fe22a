//! Chapters 8, 9 and 15: a bundle, a loop, a path and its error.

use garad::core::{Camera, Real, Rng, Se3, So3, StampedPose};
use garad::eval::{Alignment, AteOptions, ate};
use garad::optim::{BundleConfig, BundleObservation, optimise_bundle};
use garad::optim::{PoseEdge, PoseGraph, PoseGraphConfig};
use nalgebra::{Matrix6, Vector2, Vector3, Vector6};

use crate::Drawn;
use crate::canvas::{BLACK, BLUE, Canvas, GRAY, GREEN, ORANGE};
use crate::chart::Chart;

/// A room from above: seven cameras, points on the far wall and two side walls.
pub(crate) fn bundle() -> Drawn {
    let camera = Camera::pinhole((640, 480), [525.0, 525.0, 319.5, 239.5])?;
    let mut rng = Rng::new(4);
    let truth: Vec<Vector3<f64>> = (0..150)
        .map(|i| match i % 3 {
            0 => Vector3::new(-2.0, rng.range(-1.0, 1.0), rng.range(1.5, 4.0)),
            1 => Vector3::new(2.0, rng.range(-1.0, 1.0), rng.range(1.5, 4.0)),
            _ => Vector3::new(rng.range(-2.0, 2.0), rng.range(-1.0, 1.0), 4.0),
        })
        .collect();
    let poses: Vec<Se3> = (0..7)
        .map(|k| {
            let x = f64::from(k) * 0.3 - 0.9;
            let turned = So3::exp(&Vector3::new(0.0, 0.25 * x, 0.0));
            Se3::new(turned, -(turned * Vector3::new(x, 0.0, -0.2 * x * x)))
        })
        .collect();
    let mut observations = Vec::new();
    for (k, pose) in poses.iter().enumerate() {
        for (i, point) in truth.iter().enumerate() {
            let seen = camera
                .project(&(*pose * *point))
                .filter(|uv| camera.contains(uv));
            if let Some(uv) = seen {
                observations.push(BundleObservation {
                    pose: k,
                    point: i,
                    uv_px: uv + Vector2::new(rng.normal(), rng.normal()),
                    sigma_px: 1.0,
                    depth: None,
                });
            }
        }
    }
    // What one camera alone has seen is nowhere along its ray.
    let seen_by = |i: usize| observations.iter().filter(|o| o.point == i).count();
    let shown: Vec<usize> = (0..truth.len()).filter(|i| seen_by(*i) > 1).collect();
    let mut moved: Vec<Se3> = poses.clone();
    for pose in &mut moved[2..] {
        let xi = Vector6::from_fn(|i, _| rng.normal() * if i < 3 { 0.06 } else { 0.02 });
        *pose = Se3::exp(&xi) * *pose;
    }
    let noise = |rng: &mut Rng| Vector3::from_fn(|_, _| rng.normal() * 0.15);
    let mut points: Vec<Vector3<f64>> = truth.iter().map(|p| p + noise(&mut rng)).collect();
    // Two poses are held: they say where the world is and how large.
    let fixed: Vec<bool> = (0..7).map(|k| k < 2).collect();
    let mut canvas = Canvas::new(860, 420);
    draw_room(
        &mut canvas,
        50.0,
        "before",
        &pick(&truth, &shown),
        &pick(&points, &shown),
        &moved,
    );
    let config = BundleConfig {
        iterations: 30,
        ..BundleConfig::default()
    };
    let report = optimise_bundle(
        &camera,
        40.0,
        &mut moved,
        &fixed,
        &mut points,
        &observations,
        &config,
    )?;
    let title = format!("after {} steps", report.report.iterations);
    draw_room(
        &mut canvas,
        480.0,
        &title,
        &pick(&truth, &shown),
        &pick(&points, &shown),
        &moved,
    );
    Ok(canvas.picture)
}

fn pick(points: &[Vector3<f64>], shown: &[usize]) -> Vec<Vector3<f64>> {
    shown.iter().map(|i| points[*i]).collect()
}

fn draw_room(
    canvas: &mut Canvas,
    left: f64,
    title: &str,
    truth: &[Vector3<f64>],
    points: &[Vector3<f64>],
    poses: &[Se3],
) {
    canvas.text([left, 8.0], title, BLACK);
    let chart = Chart::new(
        canvas,
        [[left, 34.0], [left + 360.0, 390.0]],
        [[-2.5, 2.5], [-0.5, 4.5]],
        [&[-2.0, -1.0, 0.0, 1.0, 2.0], &[0.0, 1.0, 2.0, 3.0, 4.0]],
        |v| format!("{v:.0}"),
    );
    for (point, truth) in points.iter().zip(truth) {
        let [at, target] = [point, truth].map(|p| chart.at([p.x, p.z]));
        canvas.line(at, target, 1.0, ORANGE);
        canvas.disc(at, 2.5, BLUE);
    }
    for pose in poses {
        let world_from_camera = pose.inverse();
        let corner = |x: f64, z: f64| {
            let p = world_from_camera * Vector3::new(x, 0.0, z);
            chart.at([p.x, p.z])
        };
        let frustum = [
            corner(0.0, 0.0),
            corner(-0.1, 0.2),
            corner(0.1, 0.2),
            corner(0.0, 0.0),
        ];
        canvas.path(&frustum, 1.5, BLACK);
    }
}

/// A lap of forty poses measured with a small error each, and what one loop edge makes of it.
pub(crate) fn closed_loop() -> Drawn {
    let n = 40;
    let mut rng = Rng::new(9);
    let truth: Vec<Se3> = (0..n)
        .map(|k| {
            let angle = std::f64::consts::TAU * f64::from(k) / f64::from(n);
            let (sin, cos) = Real::sin_cos(angle);
            let turned = So3::exp(&Vector3::new(0.0, angle, 0.0));
            Se3::new(turned, Vector3::zeros())
                * Se3::new(So3::identity(), -Vector3::new(2.0 * cos, 0.0, 2.0 * sin))
        })
        .collect();
    let edge = |a: usize, b: usize, noise: Vector6<f64>| PoseEdge {
        a,
        b,
        a_from_b: Se3::exp(&noise) * truth[a] * truth[b].inverse(),
        information: Matrix6::identity(),
    };
    let mut graph = PoseGraph::default();
    graph.add_pose(truth[0], true);
    for k in 1..truth.len() {
        let noise = Vector6::from_fn(|i, _| match i {
            4 => 0.016 + 0.006 * rng.normal(), // a gyroscope's bias
            0 | 2 => 0.015 * rng.normal(),
            _ => 0.0,
        });
        let step = edge(k, k - 1, noise);
        graph.add_pose(step.a_from_b * graph.poses[k - 1], false);
        graph.edges.push(step);
    }
    graph.edges.push(edge(truth.len() - 1, 0, Vector6::zeros()));
    let mut canvas = Canvas::new(860, 440);
    draw_lap(&mut canvas, 50.0, "measured step by step", &truth, &graph);
    graph.optimise(&PoseGraphConfig::default())?;
    draw_lap(&mut canvas, 480.0, "with one edge more", &truth, &graph);
    Ok(canvas.picture)
}

fn draw_lap(canvas: &mut Canvas, left: f64, title: &str, truth: &[Se3], graph: &PoseGraph) {
    canvas.text([left, 8.0], title, BLACK);
    let chart = Chart::new(
        canvas,
        [[left, 34.0], [left + 360.0, 394.0]],
        [[-3.0, 3.0], [-3.0, 3.0]],
        [&[-2.0, -1.0, 0.0, 1.0, 2.0], &[-2.0, -1.0, 0.0, 1.0, 2.0]],
        |v| format!("{v:.0}"),
    );
    let place = |pose: &Se3| {
        let center = pose.inverse().translation;
        chart.at([center.x, center.z])
    };
    let path: Vec<[f64; 2]> = truth.iter().map(&place).collect();
    canvas.path(&path, 1.0, GRAY);
    for edge in &graph.edges {
        let [a, b] = [edge.a, edge.b].map(|k| place(&graph.poses[k]));
        let closes = edge.a.abs_diff(edge.b) > 1;
        canvas.line(
            a,
            b,
            if closes { 4.0 } else { 1.5 },
            if closes { ORANGE } else { BLUE },
        );
    }
    for pose in &graph.poses {
        canvas.disc(place(pose), 3.5, BLUE);
    }
}

/// The same path in two worlds, and the distances that are left when one is laid over the other.
pub(crate) fn trajectory_error() -> Drawn {
    let mut rng = Rng::new(6);
    let turned = So3::exp(&Vector3::new(0.0, 0.0, 0.4));
    let (mut truth, mut estimate) = (Vec::new(), Vec::new());
    let mut drift = Vector3::zeros();
    for k in 0..80 {
        let t_s = f64::from(k) * 0.1;
        let (sin, cos) = Real::sin_cos(0.7 * t_s);
        let at = Vector3::new(1.6 * cos + 0.15 * t_s, 0.9 * sin * (1.0 + 0.1 * t_s), 0.0);
        drift += Vector3::new(rng.normal(), rng.normal(), 0.0) * 0.012;
        let pose = |p: Vector3<f64>| StampedPose {
            t_s,
            world_from_camera: Se3::new(So3::identity(), p),
        };
        truth.push(pose(at));
        estimate.push(pose(turned * (at + drift) + Vector3::new(0.7, -0.6, 0.0)));
    }
    let mut canvas = Canvas::new(860, 430);
    for (title, alignment, left) in [
        ("each in its own world", Alignment::None, 50.0),
        ("after rigid alignment", Alignment::Rigid, 480.0),
    ] {
        let options = AteOptions {
            alignment,
            ..AteOptions::default()
        };
        let judged = ate(&truth, &estimate, &options)?;
        canvas.text([left, 8.0], title, BLACK);
        let chart = Chart::new(
            &mut canvas,
            [[left, 34.0], [left + 360.0, 354.0]],
            [[-2.25, 4.05], [-2.8, 2.8]],
            [&[-2.0, 0.0, 2.0, 4.0], &[-2.0, 0.0, 2.0]],
            |v| format!("{v:.0}"),
        );
        let xy = |p: &Vector3<f64>| chart.at([p.x, p.y]);
        for point in &judged.points {
            canvas.line(xy(&point.ground_truth), xy(&point.estimate), 1.0, ORANGE);
        }
        let paths = judged.points.iter();
        let (a, b): (Vec<_>, Vec<_>) = paths
            .map(|p| (xy(&p.ground_truth), xy(&p.estimate)))
            .unzip();
        canvas.path(&a, 2.0, GREEN);
        canvas.path(&b, 2.0, BLUE);
        let said = format!("rmse {:.3} m", judged.stats.rmse);
        canvas.text([left, 392.0], &said, ORANGE);
    }
    Ok(canvas.picture)
}
