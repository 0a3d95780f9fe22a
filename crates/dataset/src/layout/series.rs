//! [`Series`]: images found by the number in their names.

use std::collections::BTreeMap;

use super::{Context, Pair, Remarks, Unpaired};
use crate::errors::DatasetError;
use crate::limits;
use crate::list::Entry;
use crate::source::{Source, image_size};

/// Endings of colour images.
pub(super) const COLOUR_ENDINGS: &[&str] = &[".jpg", ".png", ".jpeg"];
/// Endings of depth images.
pub(super) const DEPTH_ENDINGS: &[&str] = &[".png"];

/// Files `FOLDER/PREFIX NUMBER ENDING`, in any case of the ending; after the number may follow `-` and more, as the
/// time stamps in Redwood's names.
#[derive(Debug, Clone, Copy)]
pub(super) struct Series {
    /// Empty for the folder of the recording itself.
    pub(super) folder: &'static str,
    pub(super) prefix: &'static str,
    pub(super) endings: &'static [&'static str],
}

impl Series {
    /// Names by number.
    pub(super) fn files(&self, source: &Source) -> BTreeMap<usize, String> {
        let names = source.files_in(self.folder);
        let mut files = BTreeMap::new();
        for name in names {
            if let Some(number) = self.number(&name) {
                let inside = match self.folder {
                    "" => name,
                    folder => format!("{folder}/{name}"),
                };
                files.entry(number).or_insert(inside);
            }
        }
        files
    }

    fn number(&self, name: &str) -> Option<usize> {
        let rest = name.strip_prefix(self.prefix)?;
        let after = rest.trim_start_matches(|c: char| c.is_ascii_digit());
        let number = rest[..rest.len() - after.len()].parse::<u32>().ok()?;
        let ends = |ending: &&str| {
            let start = after.len().checked_sub(ending.len())?;
            let same = after.get(start..)?.eq_ignore_ascii_case(ending);
            (same && (start == 0 || after.starts_with('-'))).then_some(())
        };
        self.endings.iter().find_map(ends)?;
        usize::try_from(number).ok()
    }

    /// Size of the first image.
    pub(super) fn size(&self, source: &Source) -> Result<Option<(usize, usize)>, DatasetError> {
        let files = self.files(source);
        files
            .values()
            .next()
            .map_or(Ok(None), |file| image_size(source, file))
    }
}

/// Frames of the numbers that both series have, at number / fps.
pub(super) fn pairs(
    context: &Context<'_>,
    [colour, depth]: [Series; 2],
    remarks: &mut Remarks,
) -> Result<Vec<Pair>, DatasetError> {
    let [colour_files, depth_files] = [colour, depth].map(|series| series.files(context.source));
    if colour_files.len().max(depth_files.len()) > limits::LIST_LINES {
        return Err(DatasetError::TooLarge {
            path: context.path.to_path_buf(),
            what: "number of images",
            value: colour_files.len().max(depth_files.len()) as u64,
            limit: limits::LIST_LINES as u64,
        });
    }
    let pairs: Vec<Pair> = colour_files
        .iter()
        .filter_map(|(&number, colour)| Some((number, colour, depth_files.get(&number)?)))
        .enumerate()
        .map(|(i, (number, colour, depth))| pair(context, i, number, [colour, depth]))
        .collect();
    if pairs.is_empty() {
        return Err(DatasetError::NotARecording {
            path: context.path.to_path_buf(),
            found: format!(
                "{} colour images {}/{}N and {} depth images {}/{}N, none of the same number N",
                colour_files.len(),
                colour.folder,
                colour.prefix,
                depth_files.len(),
                depth.folder,
                depth.prefix
            ),
        });
    }
    for (mine, total, other) in [
        ("colour", colour_files.len(), "depth"),
        ("depth", depth_files.len(), "colour"),
    ] {
        if total > pairs.len() {
            let without = total - pairs.len();
            remarks.warnings.push(format!(
                "{without} of {total} {mine} images have no {other} image of their number"
            ));
        }
    }
    let alone = colour_files
        .keys()
        .filter(|number| !depth_files.contains_key(number));
    remarks.unpaired = Unpaired {
        why: "without a depth image of their number".to_owned(),
        times_s: alone.map(|&number| time_s(context, number)).collect(),
    };
    remarks.notes.push(format!(
        "no time stamps: frames are at their number / {} s, the fps of the calibration",
        context.fps
    ));
    Ok(pairs)
}

/// number / fps.
pub(super) fn time_s(context: &Context<'_>, number: usize) -> f64 {
    number as f64 / context.fps
}

/// The frame `number`, the i-th of those found, at number / fps.
pub(super) fn pair(
    context: &Context<'_>,
    i: usize,
    number: usize,
    [colour, depth]: [&String; 2],
) -> Pair {
    let t_s = time_s(context, number);
    let entry = |file: &String, offset_s: f64| Entry {
        t_s: t_s + offset_s,
        stamp: format!("{t_s:.6}"),
        file: file.clone(),
        line: i + 1,
    };
    Pair {
        colour: entry(colour, 0.0),
        depth: entry(depth, context.options.depth_offset_s),
        number,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_names() {
        let series = Series {
            folder: "color",
            prefix: "frame",
            endings: &[".jpg", ".png"],
        };
        for (name, number) in [
            ("frame000012.jpg", Some(12)),
            ("frame7.PNG", Some(7)),
            ("frame0000003-000000098765.png", Some(3)),
            ("frame12.txt", None),
            ("frame12jpg", None),
            ("frame.jpg", None),
            ("12.jpg", None),
            ("frame1305031102.175304.png", None),
            ("frame12.color.png", None),
            ("frame99999999999.png", None),
        ] {
            assert_eq!(series.number(name), number, "{name}");
        }
    }
}
