//! [`record`] and [`write()`]: inputs and outputs of every stage of some frames, on disk.

use std::collections::BTreeSet;
use std::ops::RangeInclusive;

use anyhow::{Context, Result, ensure};
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
/// Two tensors of one name in a run of a stage; every file that cannot be written.
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
    let mut files = BTreeSet::new();
    for record in records {
        let file = Entry::path_of(record.frame.0, record.stage, record.call, &record.tensor);
        ensure!(files.insert(file.clone()), "{file}: recorded twice");
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

#[cfg(test)]
mod tests {
    use garad_core::FrameId;
    use garad_slam::trace::Role;

    use super::*;

    #[test]
    fn no_tensor_is_written_over_another() {
        let record = |frame, call, role, tensor: &str| TraceRecord {
            frame: FrameId(frame),
            stage: "pose",
            call,
            role,
            tensor: tensor.to_owned(),
            unit: "m",
            shape: vec![2],
            values: Values::F64(vec![1.5, f64::from(frame)]),
        };
        let good = [
            record(3, 0, Role::Input, "before"),
            record(3, 0, Role::Output, "after"),
            record(3, 1, Role::Input, "before"),
            record(4, 0, Role::Input, "before"),
        ];
        for (role, error) in [
            (Role::Input, "000003/pose_1/before.npy: recorded twice"),
            (Role::Output, "000003/pose_1/before.npy: recorded twice"),
        ] {
            let folder = tempfile::tempdir().expect("a folder");
            let open = || ResultFolder::open(folder.path(), "trace").expect("empty");
            let config = Config::default();
            write(open(), &good, Value::Null, &config).expect("all different");
            assert!(folder.path().join(INDEX).is_file(), "written");
            let twice = [&good[..], &[record(3, 1, role, "before")]].concat();
            let found = write(open(), &twice, Value::Null, &config).expect_err("twice");
            assert_eq!(found.to_string(), error, "{role:?}");
        }
    }
}
