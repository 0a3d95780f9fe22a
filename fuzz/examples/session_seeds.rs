//! Writes `seeds/session/`: the state of a run before its first frame, and after three frames of a small scene.
//! To be run again when the format of sessions changes.

use std::path::Path;

use anyhow::Result;
use garad::core::Par;
use garad::recording::Recording;
use garad::run::{Run, RunOptions};
use garad::source::SourceFrame;
use garad::synth::{Scene, SceneConfig, SceneName};

const FRAMES: usize = 3;

fn main() -> Result<()> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("seeds/session");
    std::fs::create_dir_all(&folder)?;
    let scene = Scene::new(&SceneConfig {
        frames: FRAMES,
        width: 40,
        height: 32,
        supersample: 1,
        ..SceneConfig::new(SceneName::QuietDesk)
    })?;
    let mut options = RunOptions {
        threads: 1,
        quiet: true,
        ..RunOptions::default()
    };
    options.config.features.count = 40;
    options.config.keyframes.max_gap = 1;
    options.config.schedule.handover_frames = 1;
    options.config.train.per_keyframe = 1;
    for frames in [0, FRAMES] {
        let mut run = Run::new(&scene.camera(), &options)?;
        let source = (0..frames).map(|i| {
            let frame = scene.frame(i, Par::Seq);
            Ok(SourceFrame {
                t_s: frame.t_s,
                depth_t_s: frame.t_s,
                rgb: frame.rgb,
                depth: frame.depth,
                mask: None,
                truth: Some(frame.mask),
            })
        });
        run.process(source, frames);
        let recording = Recording {
            name: "seed".to_owned(),
            given_masks: false,
            times_s: (0..frames).map(|i| scene.timestamp(i)).collect(),
            fingerprints: [None; 2],
        };
        let mut bytes = Vec::new();
        run.save(&mut bytes, &recording)?;
        std::fs::write(folder.join(format!("frames_{frames}")), bytes)?;
    }
    Ok(())
}
