//! `garad demo`: a small dynamic sequence, generated, run, evaluated and drawn.

use std::sync::mpsc::sync_channel;

use anyhow::Result;
use garad::interrupt::{self, Interrupted};
use garad::output::{self, Judged, Truth};
use garad::run;
use garad::source::SourceFrame;
use garad_core::Par;
use garad_synth::{Scene, SceneConfig, SceneName};

use super::{CommonArgs, ProfileArgs, say};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(flatten)]
    profile: ProfileArgs,
    #[command(flatten)]
    common: CommonArgs,
    /// Which scene; `garad synth --help` lists them.
    #[arg(long, default_value_t = SceneName::Walking)]
    scene: SceneName,
    /// Frames of the sequence.
    #[arg(long, default_value_t = 75)]
    frames: usize,
    /// Use the true masks of the scene instead of computed labels.
    #[arg(long)]
    oracle_labels: bool,
}

/// Training iterations, unless the command line or a configuration sets them.
const REFINE: usize = 120;
/// Frames generated ahead of tracking.
const AHEAD: usize = 2;

pub(crate) fn run(args: &Args) -> Result<()> {
    let mut options = args.common.run_options(args.profile.get(), false)?;
    let iterations = &mut options.config.train.final_iterations;
    if args.common.refine.is_none() && args.common.pipeline.config.is_none() && *iterations == 0 {
        *iterations = REFINE;
    }
    let scene = Scene::new(&SceneConfig {
        frames: args.frames,
        noise: true,
        seed: options.seed.wrapping_add(1),
        ..SceneConfig::new(args.scene)
    })?;
    let name = format!("demo_{}", args.scene);
    let out = args.common.out_folder(&name, "run")?;
    let page = out.path().join("report.html");
    interrupt::listen()?;
    if !options.quiet {
        let labels = if args.oracle_labels {
            "true labels of the scene"
        } else if options.config.labels.enabled {
            "computed labels"
        } else {
            "no labels"
        };
        say(&format!(
            "{name}: {} frames, Kinect-like noise, {labels}",
            args.frames
        ))?;
    }
    let camera = scene.camera();
    let result = std::thread::scope(|scope| {
        let (sender, receiver) = sync_channel(AHEAD);
        let scene = &scene;
        scope.spawn(move || {
            for i in 0..scene.len() {
                let frame = scene.frame(i, Par::Seq);
                let frame = SourceFrame {
                    t_s: frame.t_s,
                    depth_t_s: frame.t_s,
                    rgb: frame.rgb,
                    depth: frame.depth,
                    mask: args.oracle_labels.then(|| frame.mask.clone()),
                    truth: Some(frame.mask),
                };
                if sender.send(Ok(frame)).is_err() {
                    return; // the run ended early
                }
            }
        });
        run::run(&camera, receiver.into_iter(), scene.len(), &options)
    })?;
    if result.log.interrupted && result.done == 0 {
        return Err(Interrupted::before("the first frame").into());
    }
    let truth = Truth::exact(scene.trajectory());
    let judged = Judged::new(&name, &result, Some(&truth));
    let written = output::write(out, &result, &judged, &[]);
    for line in judged.summary() {
        say(&line)?;
    }
    written?;
    say(&format!("look at   {}", page.display()))?;
    match result.interruption(scene.len()) {
        Some(how) => Err(Interrupted(format!("{how}; results so far are written")).into()),
        None => Ok(()),
    }
}
