//! TUM and BONN: `rgb.txt` and `depth.txt`, lines `timestamp filename`, paired by time; `groundtruth.txt`.

use garad_core::StampedPose;

use super::{Context, Layout, Pair, Remarks, Unpaired};
use crate::associate::{associate, closest_s};
use crate::errors::DatasetError;
use crate::list::{Entry, parse_list};
use crate::source::Source;
use crate::trajectory::{parse_leniently, parse_trajectory};

const COLOUR: &str = "rgb.txt";
const DEPTH: &str = "depth.txt";
/// The true trajectory.
pub(super) const TRUTH: &str = "groundtruth.txt";

#[derive(Debug)]
pub(super) struct Tum;

impl Layout for Tum {
    fn name(&self) -> &'static str {
        "TUM or BONN"
    }

    fn lists(&self) -> [&'static str; 2] {
        [COLOUR, DEPTH]
    }

    fn matches(&self, source: &Source) -> bool {
        source.has_file(COLOUR) && source.has_file(DEPTH)
    }

    fn pairs(
        &self,
        context: &Context<'_>,
        remarks: &mut Remarks,
    ) -> Result<Vec<Pair>, DatasetError> {
        let Context {
            path,
            source,
            options,
            ..
        } = *context;
        let mut read_list = |name: &str| {
            let bytes = source
                .read(name)?
                .ok_or_else(|| DatasetError::NotARecording {
                    path: path.to_path_buf(),
                    found: format!("no readable {name}"),
                })?;
            let warnings = &mut remarks.warnings;
            parse_list(&source.locate(name), &bytes, options.strict, warnings)
        };
        let colour = read_list(COLOUR)?;
        let mut depth = read_list(DEPTH)?;
        for entry in &mut depth {
            entry.t_s += options.depth_offset_s;
        }
        let times = |list: &[Entry]| -> Vec<f64> { list.iter().map(|entry| entry.t_s).collect() };
        let (colour_s, depth_s) = (times(&colour), times(&depth));
        let pairs = associate(&colour_s, &depth_s, options.max_dt_s);
        if pairs.is_empty() {
            return Err(DatasetError::NoPairs {
                path: path.to_path_buf(),
                colour: colour.len(),
                depth: depth.len(),
                max_dt_s: options.max_dt_s,
                closest_s: closest_s(&colour_s, &depth_s),
            });
        }
        let window_ms = options.max_dt_s * 1e3;
        for (mine, total, other) in [
            ("colour", colour.len(), "depth"),
            ("depth", depth.len(), "colour"),
        ] {
            if total > pairs.len() {
                remarks.warnings.push(format!(
                    "{} of {total} {mine} images have no {other} image of their own within {window_ms} ms",
                    total - pairs.len()
                ));
            }
        }
        let mut paired = pairs.iter().map(|pair| pair.0).peekable();
        remarks.unpaired = Unpaired {
            why: format!("without a depth image within {window_ms} ms"),
            times_s: (colour_s.iter().enumerate())
                .filter_map(|(i, t_s)| paired.next_if_eq(&i).is_none().then_some(*t_s))
                .collect(),
        };
        let pair = |(i, j): (usize, usize)| Pair {
            colour: colour[i].clone(),
            depth: depth[j].clone(),
            number: i,
        };
        Ok(pairs.into_iter().map(pair).collect())
    }

    fn truth(
        &self,
        context: &Context<'_>,
        _pairs: &[Pair],
        remarks: &mut Remarks,
    ) -> Result<Option<Vec<StampedPose>>, DatasetError> {
        read_truth(context, TRUTH, &mut remarks.warnings)
    }

    fn scales_colour(&self) -> bool {
        false
    }
}

/// A trajectory in TUM's format. It only judges: without `strict`, what cannot be read is a warning.
pub(super) fn read_truth(
    context: &Context<'_>,
    file: &str,
    warnings: &mut Vec<String>,
) -> Result<Option<Vec<StampedPose>>, DatasetError> {
    let strict = context.options.strict;
    let path = context.source.locate(file);
    let read = context.source.read(file).and_then(|bytes| {
        let parse = |bytes: Vec<u8>| match strict {
            true => parse_trajectory(&path, &bytes),
            false => parse_leniently(&path, &bytes, warnings),
        };
        bytes.map(parse).transpose()
    });
    let poses = match read {
        Ok(Some(poses)) => poses,
        Ok(None) => return Ok(None),
        Err(error) if strict => return Err(error),
        Err(error) => {
            warnings.push(format!("{error}; the path is not judged"));
            return Ok(None);
        }
    };
    if poses.is_empty() {
        warnings.push(format!("{}: holds no pose", path.display()));
        return Ok(None);
    }
    Ok(Some(poses))
}
