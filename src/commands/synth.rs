//! `garad synth`: a synthetic dynamic scene as a recording in TUM layout, with masks and exact poses.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use garad::images::{png, png_gray, png_gray16};
use garad::output::ResultFolder;
use garad::progress::Progress;
use garad_core::{DepthImage, Image, Par, StampedPose};
use garad_golden::{Dtype, Tensor, npy};
use garad_synth::{Scene, SceneConfig, SceneName};

use super::{WorkArgs, say};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// quiet_desk, walking, crowd, stop_and_go, in_step, loop, comes_to_rest, sets_off, tripod,
    /// lights_out, throng, huddle or hall.
    scene: SceneName,
    /// Folder of the recording.
    #[arg(short = 'o', long = "out", value_name = "DIR")]
    out: PathBuf,
    /// Frames.
    #[arg(long, default_value_t = 150)]
    frames: usize,
    /// Image size.
    #[arg(long, value_name = "WxH", default_value = "640x480", value_parser = size)]
    size: (usize, usize),
    /// Frames per second.
    #[arg(long, default_value_t = 30.0)]
    fps: f64,
    /// Depth and colour with the noise of a Kinect. In `hall`, depth beyond 5 m is missing with and
    /// without it.
    #[arg(long)]
    noise: bool,
    /// The same recording without moving objects.
    #[arg(long)]
    static_twin: bool,
    /// Also write the exact optical flow to the next frame: flow/*.npy, [H, W, 2] f32 px, NaN where the
    /// point is hidden or outside the image.
    #[arg(long)]
    flow: bool,
    /// Seed of textures, motion and noise.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    work: WorkArgs,
}

/// Images are named by their time with six decimals; higher rates would give two images one name.
const MAX_FPS: f64 = 1e5;
/// Raw depth per metre, as in TUM recordings.
const DEPTH_FACTOR: f64 = 5000.0;

fn size(text: &str) -> Result<(usize, usize), String> {
    let parse = |s: &str| s.parse().ok();
    text.split_once('x')
        .and_then(|(w, h)| Some((parse(w)?, parse(h)?)))
        .ok_or_else(|| format!("`{text}`: expected a size such as 640x480"))
}

pub(crate) fn run(args: &Args) -> Result<()> {
    if args.fps > MAX_FPS {
        bail!("{} frames per second; expected at most {MAX_FPS}", args.fps);
    }
    let config = SceneConfig {
        frames: args.frames,
        width: args.size.0,
        height: args.size.1,
        fps: args.fps,
        noise: args.noise,
        static_twin: args.static_twin,
        seed: args.seed,
        ..SceneConfig::new(args.scene)
    };
    let scene = Scene::new(&config)?;
    // Files are written as they are drawn: those of another scene must be gone before.
    let out = ResultFolder::open(&args.out, "synth")?;
    let mut out = out.of(&format!("{config:?}, flow: {}", args.flow));
    let mut lists = Lists::default();
    let mut poses = Vec::new();
    let par = Par::new(args.work.threads);
    let mut progress = Progress::new("drawing", scene.len(), args.work.quiet);
    for i in 0..scene.len() {
        let frame = scene.frame(i, par);
        let stamp = format!("{:.6}", frame.t_s);
        lists.add(&stamp);
        let mut write = |folder: &str, ending: &str, bytes: &[u8]| {
            out.bytes(&format!("{folder}/{stamp}.{ending}"), bytes);
        };
        write("rgb", "png", &png(&frame.rgb)?);
        write("depth", "png", &png_gray16(&raw_depth(&frame.depth))?);
        write("mask", "png", &png_gray(&frame.mask)?);
        if args.flow && i + 1 < scene.len() {
            write("flow", "npy", &flow_npy(&scene.flow(i, i + 1, par))?);
        }
        if out.has_failed() {
            // Without its lists it is no recording.
            return out.finish();
        }
        poses.push(StampedPose {
            t_s: frame.t_s,
            world_from_camera: frame.world_from_camera,
        });
        progress.step("");
    }
    progress.finish();
    lists.write(&mut out);
    out.write("groundtruth.txt", |path| {
        Ok(garad_dataset::write_trajectory(path, &poses)?)
    });
    let c = scene.camera();
    let camera = format!(
        "# width height fx fy cx cy depth_factor fps\n{} {} {} {} {} {} {DEPTH_FACTOR} {}\n",
        c.width, c.height, c.fx, c.fy, c.cx, c.cy, args.fps
    );
    out.bytes("camera.txt", camera.as_bytes());
    out.finish()?;
    if !args.work.quiet {
        let frames = scene.len();
        say(&format!(
            "{}: {frames} frames of {}",
            args.out.display(),
            args.scene
        ))?;
    }
    Ok(())
}

/// rgb.txt and depth.txt.
#[derive(Debug, Default)]
struct Lists {
    rgb: String,
    depth: String,
}

impl Lists {
    fn add(&mut self, stamp: &str) {
        self.rgb += &format!("{stamp} rgb/{stamp}.png\n");
        self.depth += &format!("{stamp} depth/{stamp}.png\n");
    }

    fn write(&self, out: &mut ResultFolder) {
        let rgb = format!("# timestamp filename\n{}", self.rgb);
        let depth = format!(
            "# timestamp filename, 16 bit, factor {DEPTH_FACTOR}\n{}",
            self.depth
        );
        out.bytes("rgb.txt", rgb.as_bytes());
        out.bytes("depth.txt", depth.as_bytes());
    }
}

/// Metres to raw values; 0 (missing) for what does not fit 16 bits.
#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "compared with the range of u16 first"
)]
fn raw_depth(depth: &DepthImage) -> Image<u16> {
    depth.map(|&z| {
        let raw = (f64::from(z) * DEPTH_FACTOR + 0.5).floor();
        if raw >= 1.0 && raw < f64::from(u16::MAX) {
            raw as u16
        } else {
            0
        }
    })
}

/// A flow field as .npy: little-endian f32, [H, W, 2].
fn flow_npy(flow: &Image<[f32; 2]>) -> Result<Vec<u8>> {
    let (width, height) = flow.size();
    let values = flow.data().as_flattened().iter();
    let bytes = values.flat_map(|v| v.to_le_bytes()).collect();
    let tensor = Tensor::from_bytes(Dtype::F32, vec![height, width, 2], bytes);
    Ok(npy::encode(&tensor.context("two numbers per pixel")?))
}
