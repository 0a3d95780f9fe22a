//! Chapters 1 to 4: pixel centres, keypoints, matches, flow.

use garad::core::pyramid::GrayPyramid;
use garad::core::{Par, Real, RgbImage};
use garad::features::matching::match_descriptors;
use garad::features::{LkConfig, LkPyramid, MatchConfig, OrbConfig, OrbExtractor, lk};
use garad::synth::{Scene, SceneConfig, SceneName};

use crate::canvas::{BLACK, BLUE, Canvas, Color, GRAY, GREEN, ORANGE, PALE, PINK, YELLOW, length};
use crate::{Drawn, par};

/// Half-size frames of people walking: small files, all that matters visible.
pub(crate) fn scene(name: SceneName) -> Result<Scene, Box<dyn std::error::Error>> {
    Ok(Scene::new(&SceneConfig {
        width: 400,
        height: 300,
        frames: 60,
        noise: true,
        ..SceneConfig::new(name)
    })?)
}

/// Pixel centres at whole numbers, and those of the next level of the training pyramid.
pub(crate) fn pixels() -> Drawn {
    let (zoom, left, top) = (64.0, 70.0, 50.0);
    let at = |x: f64, y: f64| [left + zoom * (x + 0.5), top + zoom * (y + 0.5)];
    let mut canvas = Canvas::new(600, 410);
    for x in 0..=8 {
        let x = f64::from(x) - 0.5;
        canvas.line(at(x, -0.5), at(x, 4.5), 1.0, PALE);
    }
    for y in 0..=5 {
        let y = f64::from(y) - 0.5;
        canvas.line(at(-0.5, y), at(7.5, y), 1.0, PALE);
    }
    canvas.rect(at(-0.5, -0.5), at(7.5, 4.5), 2.0, BLACK);
    for (x, y) in (0..5).flat_map(|y| (0..8).map(move |x| (x, y))) {
        canvas.disc(at(f64::from(x), f64::from(y)), 3.0, BLACK);
        if x % 2 == 0 && y % 2 == 0 {
            canvas.circle(at(f64::from(x), f64::from(y)), 11.0, 2.5, ORANGE);
        }
    }
    for x in 0..8 {
        let [px, _] = at(f64::from(x), 0.0);
        canvas.centered([px, top - 24.0], &x.to_string(), BLACK);
    }
    for y in 0..5 {
        let [_, py] = at(0.0, f64::from(y));
        canvas.text([left - 22.0, py - 7.0], &y.to_string(), BLACK);
    }
    let [px, py] = at(2.75, 1.4);
    canvas.line([px - 8.0, py], [px + 8.0, py], 2.5, BLUE);
    canvas.line([px, py - 8.0], [px, py + 8.0], 2.5, BLUE);
    canvas.text([px + 12.0, py - 8.0], "(2.75, 1.4)", BLUE);
    let [x0, y1] = at(-0.5, 4.5);
    let [x1, _] = at(7.5, 4.5);
    canvas.text([x0 - 24.0, y1 + 8.0], "-0.5", GRAY);
    canvas.text([x1 - 20.0, y1 + 8.0], "7.5", GRAY);
    canvas.centered([310.0, y1 + 8.0], "rings: the pixels of level 1", ORANGE);
    Ok(canvas.picture)
}

const LEVEL_COLORS: [Color; 5] = [GREEN, BLUE, YELLOW, ORANGE, PINK];

/// ORB's keypoints, each circle as large as the patch it describes, and the levels they come from.
pub(crate) fn keypoints() -> Drawn {
    let frame = scene(SceneName::Walking)?.frame(20, par());
    let gray = frame.rgb.to_gray();
    let config = OrbConfig {
        features: 160,
        ..OrbConfig::default()
    };
    let mut orb = OrbExtractor::new(config)?;
    let found = orb.extract(&gray, Par::Seq)?;
    let (width, height) = gray.size();
    let mut canvas = Canvas::new(width + 250, height + 46);
    canvas.paste(&frame.rgb, [0, 0], 1);
    for keypoint in &found.keypoints {
        let at = [keypoint.x, keypoint.y].map(f64::from);
        let radius = 4.0 * f64::from(orb.level_scale(keypoint.level));
        let (sin, cos) = Real::sin_cos(f64::from(keypoint.angle_deg).to_radians());
        let color = LEVEL_COLORS[usize::from(keypoint.level) % LEVEL_COLORS.len()];
        canvas.circle(at, radius, 1.5, color);
        canvas.line(at, [at[0] + radius * cos, at[1] + radius * sin], 1.5, color);
    }
    let levels = GrayPyramid::scaled(gray, config.scale, config.levels);
    let mut top = 0;
    for (l, level) in levels
        .levels()
        .iter()
        .enumerate()
        .skip(3)
        .step_by(2)
        .take(2)
    {
        let rgb: RgbImage = level.map(|v| [*v; 3]);
        canvas.paste(&rgb, [width + 8, top], 1);
        let color = LEVEL_COLORS[l % LEVEL_COLORS.len()];
        top += level.height();
        canvas.text(
            [(width + 8) as f64, (top + 2) as f64],
            &format!("level {l}"),
            color,
        );
        top += 24;
    }
    Ok(canvas.picture)
}

/// Matches between two frames, those that a turn and a shift of the picture explain and the others.
pub(crate) fn matches() -> Drawn {
    let scene = scene(SceneName::Walking)?;
    let frames = [scene.frame(10, par()), scene.frame(24, par())];
    let flow = scene.flow(10, 24, par());
    let config = OrbConfig {
        features: 400,
        ..OrbConfig::default()
    };
    let mut orb = OrbExtractor::new(config)?;
    let a = orb.extract(&frames[0].rgb.to_gray(), Par::Seq)?;
    let b = orb.extract(&frames[1].rgb.to_gray(), Par::Seq)?;
    let found = match_descriptors(
        &a.descriptors,
        &b.descriptors,
        &MatchConfig::default(),
        Par::Seq,
    );
    let (width, height) = frames[0].rgb.size();
    let mut canvas = Canvas::new(2 * width + 6, height);
    canvas.paste(&frames[0].rgb, [0, 0], 1);
    canvas.paste(&frames[1].rgb, [width + 6, 0], 1);
    for pair in found.iter().step_by(2) {
        let [from, to] = [&a.keypoints[pair.query], &b.keypoints[pair.train]].map(|k| [k.x, k.y]);
        let moved = flow[((from[0] + 0.5) as usize, (from[1] + 0.5) as usize)];
        let miss = [0, 1].map(|k| f64::from(from[k] + moved[k] - to[k]));
        // NaN, where the point is hidden in the second frame, is not right.
        let color = if length(miss[0], miss[1]) < 4.0 {
            GREEN
        } else {
            ORANGE
        };
        let right = [f64::from(to[0]) + (width + 6) as f64, f64::from(to[1])];
        canvas.line(from.map(f64::from), right, 1.0, color);
        canvas.disc(from.map(f64::from), 2.0, color);
        canvas.disc(right, 2.0, color);
    }
    Ok(canvas.picture)
}

/// Where Lucas-Kanade says the keypoints of one frame are eight frames later.
pub(crate) fn tracks() -> Drawn {
    let scene = scene(SceneName::Walking)?;
    let frames = [scene.frame(20, par()), scene.frame(28, par())];
    let [prev, next] = [&frames[0], &frames[1]].map(|f| LkPyramid::new(&f.rgb.to_gray(), 3));
    let config = OrbConfig {
        features: 350,
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
    let (width, height) = frames[0].rgb.size();
    let mut canvas = Canvas::new(width, height);
    // Pale, so that the tracks stand out.
    canvas.paste(&frames[0].rgb.map(|p| p.map(|v| 90 + v / 5 * 3)), [0, 0], 1);
    for (from, track) in points.iter().zip(&found) {
        let from64 = from.map(f64::from);
        if !track.is_tracked() {
            canvas.circle(from64, 3.5, 1.5, GRAY);
            continue;
        }
        let object = frames[0].object[((from[0] + 0.5) as usize, (from[1] + 0.5) as usize)];
        let color = if object == 0 { BLUE } else { ORANGE };
        canvas.line(from64, track.xy.map(f64::from), 2.0, color);
        canvas.disc(track.xy.map(f64::from), 2.0, color);
    }
    Ok(canvas.picture)
}
