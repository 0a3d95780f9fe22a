//! The chapters on what moves: nodes, mask and suspects of one run of the profile `paper_tuned`; a row of a depth image
//! from above.

use std::collections::BTreeSet;
use std::error::Error;
use std::sync::OnceLock;

use garad::config_file::layered;
use garad::core::{Camera, FrameId, GaussianMap, Label, RgbImage, Se3};
use garad::profiles::Profile;
use garad::raster::{RenderOptions, fast};
use garad::slam::trace::{TraceRecord, Values};
use garad::slam::{Config, FrameInput, LabelledFrame, Silent, Slam};
use garad::synth::{Scene, SceneConfig, SceneName, SynthFrame};
use nalgebra::{Vector2, Vector3};

use crate::canvas::{BLACK, BLUE, Canvas, GRAY, GREEN, ORANGE, signed};
use crate::{Drawn, par};

/// The frame whose labels are drawn, and how many frames before it are recorded.
const FRAME: u32 = 40;
const RECORDED: u32 = 6;

/// The frames of the depth rays.
const OLDER: usize = 10;
const LATER: usize = 40;

/// Levels of the mask.
const LEVELS: usize = 3;

/// A run up to [`FRAME`].
struct LoopRun {
    camera: Camera,
    config: Config,
    frame: SynthFrame,
    camera_from_world: Se3,
    labelled: LabelledFrame,
    /// The last keyframe before.
    keyframe: (FrameId, SynthFrame),
    /// The dynamic Gaussians that its mapping job handed over.
    dynamic: GaussianMap,
    trace: Vec<TraceRecord>,
}

impl LoopRun {
    fn new() -> Result<Self, Box<dyn Error>> {
        let scene = Scene::new(&SceneConfig {
            width: 320,
            height: 240,
            frames: FRAME as usize + 1,
            noise: true,
            ..SceneConfig::new(SceneName::Walking)
        })?;
        let config = layered(&[Profile::find("paper_tuned")?.layer()])?;
        let slam = Slam::new(scene.camera(), config.clone(), 0, par())?;
        let mut slam = slam.with_trace(FRAME - RECORDED..=FRAME);
        let process = |slam: &mut Slam, i: u32| -> Result<_, Box<dyn Error>> {
            let frame = scene.frame(i as usize, par());
            let input = FrameInput {
                t_s: frame.t_s,
                depth_t_s: frame.t_s,
                rgb: &frame.rgb,
                depth: &frame.depth,
                mask: None,
            };
            let report = slam.process(&input, &mut Silent)?;
            Ok((frame, report))
        };
        let mut keyframe = None;
        for i in 0..FRAME {
            let (frame, report) = process(&mut slam, i)?;
            if report.keyframe.is_some() {
                keyframe = Some((report.id, frame));
            }
        }
        // What would be handed over at the next frame.
        slam.finish()?;
        let mut dynamic = slam.gaussians().ok_or("a map")?.clone();
        let keep: Vec<bool> = dynamic.label.iter().map(|l| *l == Label::Dynamic).collect();
        dynamic.retain(|i| keep[i]);
        let (frame, report) = process(&mut slam, FRAME)?;
        slam.finish()?;
        Ok(Self {
            camera: scene.camera(),
            config,
            frame,
            camera_from_world: report.camera_from_world.ok_or("a pose")?,
            labelled: slam.labelled_frame().ok_or("labels")?.clone(),
            keyframe: keyframe.ok_or("a keyframe")?,
            dynamic,
            trace: slam.take_trace(),
        })
    }

    /// The numbers of a tensor.
    fn tensor(&self, frame: FrameId, stage: &str, name: &str) -> Result<Vec<f64>, String> {
        let found = (self.trace.iter())
            .find(|r| r.frame == frame && r.stage == stage && r.tensor == name)
            .ok_or_else(|| format!("{stage} has recorded no {name}"))?;
        Ok(match &found.values {
            Values::U8(v) => v.iter().map(|v| f64::from(*v)).collect(),
            Values::U32(v) => v.iter().map(|v| f64::from(*v)).collect(),
            Values::F32(v) => v.iter().map(|v| f64::from(*v)).collect(),
            Values::F64(v) => v.clone(),
        })
    }
}

fn run() -> Result<&'static LoopRun, Box<dyn Error>> {
    static RUN: OnceLock<Result<LoopRun, String>> = OnceLock::new();
    let run = RUN.get_or_init(|| LoopRun::new().map_err(|error| error.to_string()));
    Ok(run.as_ref().map_err(String::as_str)?)
}

fn pairs(numbers: &[f64]) -> impl Iterator<Item = [f64; 2]> {
    numbers.chunks_exact(2).map(|p| [p[0], p[1]])
}

/// A pale picture of a frame, in few shades.
fn background(frame: &SynthFrame) -> RgbImage {
    frame.rgb.to_gray().map(|v| [180 + v / 64 * 20; 3])
}

const ZOOM: usize = 2;

/// Where a pixel is in a picture that is [`ZOOM`] times as large.
fn zoomed(px: [f64; 2]) -> [f64; 2] {
    px.map(|v| (v + 0.5) * ZOOM as f64 - 0.5)
}

/// The nodes of the field in a mapping job, by their belief.
pub(crate) fn nodes() -> Drawn {
    let run = run()?;
    let (id, frame) = &run.keyframe;
    let uv_px = run.tensor(*id, "label_map", "uv_px")?;
    let beliefs = run.tensor(*id, "label_map", "belief")?;
    let (width, height) = frame.rgb.size();
    let mut canvas = Canvas::new(ZOOM * width, ZOOM * height + 26);
    canvas.paste(&background(frame), [0, 0], ZOOM);
    for (uv, belief) in pairs(&uv_px).zip(&beliefs) {
        canvas.disc(zoomed(uv), 4.0, BLACK);
        canvas.disc(zoomed(uv), 3.0, signed(2.0 * belief - 1.0));
    }
    let dynamic = beliefs.iter().filter(|b| **b > run.config.crf.threshold);
    let said = format!("{} tagged, {} dynamic", beliefs.len(), dynamic.count());
    canvas.text([4.0, (ZOOM * height + 6) as f64], &said, BLACK);
    Ok(canvas.picture)
}

/// The dynamic Gaussians of the last job as the next frame's mask, level by level.
pub(crate) fn levels() -> Drawn {
    let run = run()?;
    let config = &run.config.labels.gaussian_mask;
    let is_there = |mean: &[f32; 3]| {
        let p = run.camera_from_world * Vector3::from(mean.map(f64::from));
        let pixel = run.camera.project(&p).map(|uv| uv.add_scalar(0.5));
        let pixel = pixel.filter(|uv| uv.min() >= 0.0);
        let measured = pixel.and_then(|uv| run.frame.depth.get(uv.x as usize, uv.y as usize));
        let known = measured.map(|z| f64::from(*z)).filter(|z| *z > 0.0);
        known.is_none_or(|z| (z - p.z).abs() < config.depth_m)
    };
    let mut drawn = run.dynamic.clone();
    let keep: Vec<bool> = drawn.means.iter().map(is_there).collect();
    drawn.retain(|i| keep[i]);
    let (width, height) = run.frame.rgb.size();
    let mask = &run.frame.mask;
    let step = width + 10;
    let mut canvas = Canvas::new(LEVELS * step - 10, height + 26);
    for level in 0..LEVELS {
        let camera = run.camera.level(level);
        let options = RenderOptions::default();
        let rendered = fast::render(&drawn, &camera, &run.camera_from_world, &options, par())?;
        let picture = rendered.opacity.map(|opacity| {
            // In few shades.
            let shade = (f64::from(*opacity) * 8.0).round() / 8.0;
            if f64::from(*opacity) > config.opacity {
                signed(0.3 + 0.7 * shade)
            } else {
                [(255.0 - 500.0 * shade).max(155.0) as u8; 3]
            }
        });
        let left = level * step;
        canvas.paste(&picture, [left, 0], 1 << level);
        // The outline of what moves.
        for (y, x) in (1..height).flat_map(|y| (1..width).map(move |x| (y, x))) {
            if mask[(x, y)] != mask[(x - 1, y)] || mask[(x, y)] != mask[(x, y - 1)] {
                let at = [(left + x) as f64, y as f64];
                canvas.area(at, at.map(|v| v + 1.0), BLACK);
            }
        }
        canvas.rect(
            [left as f64, 0.0],
            [(left + width - 1) as f64, (height - 1) as f64],
            1.0,
            GRAY,
        );
        let said = format!("level {level}");
        canvas.text([(left + 4) as f64, (height + 6) as f64], &said, BLACK);
    }
    Ok(canvas.picture)
}

/// The mask of a frame in cells, its keypoints by their labels, and the suspects that the flow check found at rest.
pub(crate) fn suspects() -> Drawn {
    let run = run()?;
    let (width, height) = run.frame.rgb.size();
    let moving = run.labelled.mask((width, height));
    let plain = background(&run.frame);
    let tinted = RgbImage::from_fn(width, height, |x, y| {
        let pixel = plain[(x, y)];
        match moving[(x, y)] {
            0 => pixel,
            _ => [pixel[0], pixel[1] / 16 * 13, pixel[2] / 16 * 10],
        }
    });
    let mut canvas = Canvas::new(ZOOM * width, ZOOM * height + 26);
    canvas.paste(&tinted, [0, 0], ZOOM);
    for (px, label) in &run.labelled.keypoints {
        let color = match label {
            Label::Static => BLUE,
            Label::Dynamic => ORANGE,
        };
        canvas.disc(zoomed(*px), 3.0, color);
    }
    // Support and suspects were tracked together, in this order; the verdicts are of the suspects that were found.
    let id = FrameId(FRAME);
    let points = run.tensor(id, "flow_lk", "points")?;
    let tracked = run.tensor(id, "flow_lk", "tracked")?;
    let inside = run.tensor(id, "flow", "inside")?;
    let found = pairs(&points).zip(&tracked).filter(|(_, t)| **t > 0.0);
    let found: Vec<[f64; 2]> = found.map(|(point, _)| point).collect();
    let judged = &found[found.len() - inside.len()..];
    let keypoints: BTreeSet<[u32; 2]> = (run.labelled.keypoints.iter())
        .map(|(px, _)| px.map(|v| (v as f32).to_bits()))
        .collect();
    let mut restored = 0;
    for (px, inside) in judged.iter().zip(&inside) {
        let is_keypoint = keypoints.contains(&px.map(|v| (v as f32).to_bits()));
        let [x, y] = zoomed(*px);
        if *inside > 0.0 {
            restored += usize::from(is_keypoint);
            match is_keypoint {
                true => canvas.circle([x, y], 7.0, 2.0, GREEN),
                false => canvas.rect([x - 5.0, y - 5.0], [x + 5.0, y + 5.0], 2.0, GREEN),
            }
        } else if !is_keypoint {
            canvas.rect([x - 4.0, y - 4.0], [x + 4.0, y + 4.0], 1.0, ORANGE);
        }
    }
    let dynamic = (run.labelled.keypoints.iter()).filter(|(_, l)| *l == Label::Dynamic);
    let said = format!(
        "{} keypoints, {} dynamic, {restored} restored",
        run.labelled.keypoints.len(),
        dynamic.count()
    );
    canvas.text([4.0, (ZOOM * height + 6) as f64], &said, BLACK);
    Ok(canvas.picture)
}

/// A row of an older depth image from above, and where a later one has its samples in it.
pub(crate) fn depth_rays() -> Drawn {
    let scene = crate::features::scene(SceneName::Walking)?;
    let camera = scene.camera();
    let frames = [scene.frame(OLDER, par()), scene.frame(LATER, par())];
    let older_from_later = frames[0].world_from_camera.inverse() * frames[1].world_from_camera;
    let noise = Config::default().labels.noise;
    let suspect_sigmas = Config::default().labels.suspect_sigmas;
    let (width, height) = frames[0].rgb.size();
    let row = height * 2 / 5;
    let mut canvas = Canvas::new(640, 470);
    let chart = crate::chart::Chart::new(
        &mut canvas,
        [[50.0, 10.0], [630.0, 415.0]],
        [[-3.0, 3.0], [0.0, 5.0]],
        [
            &[-2.0, -1.0, 0.0, 1.0, 2.0],
            &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0],
        ],
        |v| format!("{v:.0}"),
    );
    let point = |frame: &SynthFrame, x: usize| {
        let z = f64::from(frame.depth[(x, row)]);
        (z > 0.0).then(|| camera.unproject(&Vector2::new(x as f64, row as f64), z))
    };
    let surface: Vec<Vector3<f64>> = (0..width).filter_map(|x| point(&frames[0], x)).collect();
    let at = |p: &Vector3<f64>| chart.at([p.x, p.z]);
    let inside = |p: &&Vector3<f64>| chart.holds([p.x, p.z]);
    for p in surface.iter().filter(inside) {
        canvas.line(chart.at([0.0, 0.0]), at(p), 1.0, [235, 243, 250]);
    }
    for p in surface.iter().filter(inside) {
        canvas.disc(at(p), 1.5, BLACK);
    }
    for x in (4..width).step_by(4) {
        let Some(p) = point(&frames[1], x).map(|p| older_from_later * p) else {
            continue;
        };
        let Some(uv) = camera.project(&p).filter(|uv| camera.contains(uv)) else {
            continue;
        };
        // Nearest and farthest depth in the 3 x 3 cells of 4 x 4 pixels around.
        let around = |c: f64, n: usize| {
            let cell = (c + 0.5) as usize / 4;
            cell.saturating_sub(1) * 4..((cell + 2) * 4).min(n)
        };
        let depths = around(uv.y, height).flat_map(|y| around(uv.x, width).map(move |x| (x, y)));
        let depths = depths.map(|px| f64::from(frames[0].depth[px]));
        let [near, far] = depths
            .filter(|z| *z > 0.0)
            .fold([f64::INFINITY, 0.0], |[near, far], z| {
                [near.min(z), far.max(z)]
            });
        if far <= 0.0 || !chart.holds([p.x, p.z]) {
            continue;
        }
        let sigma_m = noise.sigma_m(near);
        let color = if p.z < near - suspect_sigmas * sigma_m {
            ORANGE
        } else if p.z <= far + 3.0 * sigma_m {
            BLUE
        } else {
            GRAY
        };
        canvas.disc(at(&p), 3.5, color);
    }
    canvas.text([50.0, 446.0], "in front", ORANGE);
    canvas.text([170.0, 446.0], "on the surface", BLUE);
    canvas.text([370.0, 446.0], "occluded", GRAY);
    Ok(canvas.picture)
}
