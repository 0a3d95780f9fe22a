//! `garad ablate`: results with and without each part, as the paper's Table III.

use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use garad::output::{self, Judged};
use garad::run;
use garad_dataset::write_bytes_atomically;

use super::input::{InputArgs, Masks, frames};
use super::{CommonArgs, Part, make_folder, say};

#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// Folder, .tgz, .tar or .zip in TUM or BONN layout, with ground truth.
    dataset: PathBuf,
    #[command(flatten)]
    common: CommonArgs,
    #[command(flatten)]
    input: InputArgs,
}

/// The complete system, and the system without each part.
const VARIANTS: [(&str, &[Part]); 5] = [
    ("full", &[]),
    ("without flow", &[Part::Flow]),
    ("without crf", &[Part::Crf]),
    ("without mapping", &[Part::Mapping]),
    ("without crf, flow", &[Part::Crf, Part::Flow]),
];

pub(crate) fn run(args: &Args) -> Result<()> {
    let options = args.common.run_options(args.input.strict)?;
    let dataset = args.input.open(&args.dataset)?;
    let Some(ground_truth) = dataset.ground_truth() else {
        bail!(
            "{}: no ground truth; expected groundtruth.txt",
            args.dataset.display()
        );
    };
    let truth = Masks::of_recording(&dataset);
    let out = (args.common).out_folder(&format!("ablate_{}", dataset.name()))?;

    let mut table = vec![
        "| variant | ATE RMSE [m] | STD [m] | tracked | keypoint F1 | mask IoU |".to_owned(),
        "|---|---|---|---|---|---|".to_owned(),
    ];
    let mut figures = Vec::new();
    for (name, parts) in VARIANTS {
        let mut options = options.clone();
        for part in parts {
            part.leave_out(&mut options.config);
        }
        let result = run::run(
            &dataset.calibration().camera,
            frames(&dataset, None, truth.as_ref()),
            dataset.len(),
            &options,
        )
        .with_context(|| name.to_owned())?;
        let judged = Judged::new(dataset.name(), &result, Some(ground_truth), "ground truth");
        let folder = out.join(name.replace(", ", "_").replace(' ', "_"));
        make_folder(&folder)?;
        output::write(&folder, &result, &judged, dataset.warnings())?;
        let m = &judged.metrics;
        let number = |v: Option<f64>, digits: usize| match v {
            Some(v) => format!("{v:.digits$}"),
            None => "-".to_owned(),
        };
        table.push(format!(
            "| {name} | {} | {} | {} of {} | {} | {} |",
            number(m.ate.rmse_m, 4),
            number(m.ate.std_m, 4),
            m.tracked,
            m.frames,
            number(m.labels.keypoints.f1, 3),
            number(m.labels.pixels.iou, 3),
        ));
        figures.push(serde_json::json!({
            "variant": name,
            "ate_rmse_m": m.ate.rmse_m,
            "ate_std_m": m.ate.std_m,
            "tracked": m.tracked,
            "frames": m.frames,
            "labels": m.labels,
        }));
    }
    for line in &table {
        say(line)?;
    }
    let path = out.join("ablation.json");
    write_bytes_atomically(&path, serde_json::to_string_pretty(&figures)?.as_bytes())?;
    write_bytes_atomically(
        &out.join("ablation.md"),
        (table.join("\n") + "\n").as_bytes(),
    )?;
    say(&format!("results in {}", out.display()))
}
