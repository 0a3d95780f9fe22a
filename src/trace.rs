//! [`record`] and [`write()`]: inputs and outputs of every stage of some frames, on disk.

use std::ops::RangeInclusive;

use anyhow::{Context, Result};
use garad_core::{Camera, Par};
use garad_golden::trace::{Entry, INDEX, Index, Role};
use garad_golden::{Dtype, Tensor, npy};
use garad_slam::trace::{TraceRecord, Values};
use garad_slam::{Config, Silent, Slam};
use serde_json::Value;

use crate::config_file;
use crate::output::ResultFolder;
use crate::progress::Progress;
use crate::reason::reason;
use crate::run::RunOptions;
use crate::source::SourceFrame;

/// Runs a recording up to the last of `frames` and records the inputs and outputs of the stages in them.
/// Frames are counted as the run counts them, from 0; one that cannot be read is not counted, and its
/// error is in the second list returned.
///
/// # Errors
/// An invalid configuration or camera; with `strict` the first frame that cannot be read.
pub fn record(
    camera: &Camera,
    source: impl Iterator<Item = Result<SourceFrame>>,
    frames: RangeInclusive<u32>,
    options: &RunOptions,
) -> Result<(Vec<TraceRecord>, Vec<String>)> {
    let par = Par::new(options.threads);
    let mut slam = Slam::new(*camera, options.config.clone(), options.seed, par)
        .context("the run cannot start")?
        .with_trace(frames.clone());
    let total = frames.end().saturating_add(1);
    let mut progress = Progress::new("tracing", total as usize, options.quiet);
    let (mut next, mut skipped) = (0, Vec::new());
    for frame in source {
        if next >= total {
            break;
        }
        let outcome = frame.and_then(|frame| {
            next += 1;
            Ok(slam.process(&frame.input(), &mut Silent)?)
        });
        match outcome {
            Ok(report) => progress.step(report.state.name()),
            Err(error) if options.strict => return Err(error),
            Err(error) => {
                progress.step("frame skipped");
                skipped.push(reason(&error));
            }
        }
    }
    progress.finish();
    slam.finish().context("the map is lost")?;
    Ok((slam.take_trace(), skipped))
}

fn tensor(record: &TraceRecord) -> Option<Tensor> {
    let (dtype, bytes) = match &record.values {
        Values::U8(v) => (Dtype::U8, v.clone()),
        Values::U32(v) => (Dtype::U32, v.iter().flat_map(|v| v.to_le_bytes()).collect()),
        Values::F32(v) => (Dtype::F32, v.iter().flat_map(|v| v.to_le_bytes()).collect()),
        Values::F64(v) => (Dtype::F64, v.iter().flat_map(|v| v.to_le_bytes()).collect()),
    };
    Tensor::from_bytes(dtype, record.shape.clone(), bytes)
}

/// Writes the records and `config.toml` into a folder, as `garad_golden::trace` describes. `about` describes the run.
///
/// # Errors
/// Every file that cannot be written.
pub fn write(
    mut out: ResultFolder,
    records: &[TraceRecord],
    about: Value,
    config: &Config,
) -> Result<()> {
    let mut index = Index {
        schema: 1,
        about,
        tensors: Vec::new(),
    };
    for record in records {
        let file = Entry::path_of(record.frame.0, record.stage, record.call, &record.tensor);
        let tensor = tensor(record).with_context(|| format!("{file}: shape and size disagree"))?;
        out.bytes(&file, &npy::encode(&tensor));
        index.tensors.push(Entry {
            frame: record.frame.0,
            stage: record.stage.to_owned(),
            call: record.call,
            role: match record.role {
                garad_slam::trace::Role::Input => Role::Input,
                garad_slam::trace::Role::Output => Role::Output,
            },
            tensor: record.tensor.clone(),
            dtype: tensor.dtype().name().to_owned(),
            shape: record.shape.clone(),
            unit: record.unit.to_owned(),
            file,
        });
    }
    out.bytes(INDEX, text(&index)?.as_bytes());
    out.bytes("config.toml", config_file::write(config)?.as_bytes());
    out.finish()
}

/// The index with one line per tensor, so that it can be compared line by line.
fn text(index: &Index) -> Result<String> {
    let lines: Vec<String> = index
        .tensors
        .iter()
        .map(|entry| Ok(format!("    {}", serde_json::to_string(entry)?)))
        .collect::<Result<_>>()?;
    let about = serde_json::to_string(&index.about)?;
    Ok(format!(
        "{{\n  \"schema\": {},\n  \"about\": {about},\n  \"tensors\": [\n{}\n  ]\n}}\n",
        index.schema,
        lines.join(",\n")
    ))
}
