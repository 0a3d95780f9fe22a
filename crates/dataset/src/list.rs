//! Image lists, lines `timestamp filename`.

use std::path::Path;

use crate::errors::{DatasetError, excerpt};
use crate::files::{CLEAN_NAME, clean_name};
use crate::text::{Place, for_each_line, time_s};

/// If more than this part of a list, and so many images, repeat the time of another one, times are rounded too
/// coarsely.
const COARSE: f64 = 0.3;
const COARSE_IMAGES: usize = 4;

/// One line of a list.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Entry {
    /// Seconds.
    pub(crate) t_s: f64,
    /// The time as written: masks are named by it.
    pub(crate) stamp: String,
    /// Relative to the list, see [`clean_name`].
    pub(crate) file: String,
    /// Line in the list, from 1.
    pub(crate) line: usize,
}

/// Reads a list; the result is sorted by time, without duplicate times.
///
/// Lines out of order are sorted, a line with the time of an earlier line is dropped; both are
/// counted in `warnings`. With `strict` they are errors.
///
/// # Errors
/// [`DatasetError::Line`] for a line that is not `timestamp filename`,
/// or whose name leads outside the recording, and for times too coarse to tell images apart;
/// [`DatasetError::EmptyList`].
pub(crate) fn parse_list(
    path: &Path,
    bytes: &[u8],
    strict: bool,
    warnings: &mut Vec<String>,
) -> Result<Vec<Entry>, DatasetError> {
    parse_entries(path, bytes, strict, warnings, parse_line)
}

/// [`parse_list`] for lines of another form, which `parse` turns into an entry.
pub(crate) fn parse_entries(
    path: &Path,
    bytes: &[u8],
    strict: bool,
    warnings: &mut Vec<String>,
    mut parse: impl FnMut(Place<'_>, &str) -> Result<Entry, DatasetError>,
) -> Result<Vec<Entry>, DatasetError> {
    let mut entries: Vec<Entry> = Vec::new();
    let mut first_backward = None;
    let mut backward = 0;
    for_each_line(path, bytes, |place, text| {
        let entry = parse(place, text)?;
        if let Some(last) = entries.last()
            && entry.t_s < last.t_s
        {
            if strict {
                return Err(place.error(
                    format!("time {} after {}", entry.stamp, last.stamp),
                    "ascending times",
                ));
            }
            first_backward.get_or_insert(place.line);
            backward += 1;
        }
        entries.push(entry);
        Ok(())
    })?;
    if entries.is_empty() {
        return Err(DatasetError::EmptyList {
            path: path.to_path_buf(),
        });
    }
    if let Some(line) = first_backward {
        entries.sort_by(|a, b| a.t_s.total_cmp(&b.t_s).then(a.line.cmp(&b.line)));
        warnings.push(format!(
            "{}:{line}: time goes back, {backward} such lines; sorted",
            path.display()
        ));
    }
    let (lines, mut duplicates, mut others): (usize, Vec<usize>, usize) =
        (entries.len(), Vec::new(), 0);
    entries.dedup_by(|later, kept| {
        let same = later.t_s.total_cmp(&kept.t_s).is_eq();
        if same {
            duplicates.push(later.line);
            others += usize::from(later.file != kept.file);
        }
        same
    });
    if let Some(&line) = duplicates.iter().min() {
        let place = Place { path, line };
        if others >= COARSE_IMAGES && others as f64 > COARSE * lines as f64 {
            let found = format!("{lines} images with {} different times", entries.len());
            return Err(place.error(found, "times fine enough to tell images apart"));
        }
        if strict {
            return Err(place.error("the time of an earlier line", "ascending times"));
        }
        warnings.push(format!(
            "{}:{line}: time of an earlier line, {} such lines; dropped",
            path.display(),
            duplicates.len()
        ));
    }
    Ok(entries)
}

/// `timestamp filename`.
pub(crate) fn parse_line(place: Place<'_>, text: &str) -> Result<Entry, DatasetError> {
    let mut fields = text.split_whitespace();
    let (Some(stamp), Some(file), None) = (fields.next(), fields.next(), fields.next()) else {
        return Err(place.error(excerpt(text), "`timestamp filename`"));
    };
    let Some(clean) = clean_name(file) else {
        return Err(place.error(format!("name {}", excerpt(file)), CLEAN_NAME));
    };
    Ok(Entry {
        t_s: time_s(place, stamp)?,
        stamp: stamp.to_owned(),
        file: clean,
        line: place.line,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str, strict: bool) -> (Result<Vec<Entry>, DatasetError>, Vec<String>) {
        let mut warnings = Vec::new();
        let list = parse_list(Path::new("rgb.txt"), text.as_bytes(), strict, &mut warnings);
        (list, warnings)
    }

    #[test]
    fn lines_keep_time_stamp_file_and_number() {
        let (list, warnings) = parse("# colour\r\n1.50\trgb/1.50.png\r\n2 b.png \n", true);
        let list = list.expect("fine");
        assert_eq!(
            list[0],
            Entry {
                t_s: 1.5,
                stamp: "1.50".to_owned(),
                file: "rgb/1.50.png".to_owned(),
                line: 2
            }
        );
        assert_eq!((list.len(), warnings.len()), (2, 0), "no more, no warning");
    }

    #[test]
    fn disorder_is_sorted_or_refused() {
        let text = "1 a\n3 b\n2 c\n3.0 d\n";
        let (list, warnings) = parse(text, false);
        let files: Vec<_> = list.expect("sorted").into_iter().map(|e| e.file).collect();
        assert_eq!(files, ["a", "c", "b"], "sorted, the earlier line kept");
        assert_eq!(warnings.len(), 2, "{warnings:?}");
        assert!(
            warnings[0].starts_with("rgb.txt:3: time goes back"),
            "{warnings:?}"
        );
        assert!(warnings[1].starts_with("rgb.txt:4:"), "{warnings:?}");
        let message = parse(text, true).0.expect_err("strict").to_string();
        assert!(message.starts_with("rgb.txt:3:"), "{message}");
        let message = parse("1 a\n1 b\n", true).0.expect_err("strict").to_string();
        assert!(message.starts_with("rgb.txt:2:"), "{message}");
    }

    #[test]
    fn bad_lines_are_reported() {
        for bad in ["5", "5 a b", "x a", "NaN a", "inf a", "-1 a", "1e300 a"] {
            let message = parse(&format!("1 ok\n{bad}\n"), false)
                .0
                .expect_err(bad)
                .to_string();
            assert!(message.starts_with("rgb.txt:2:"), "{bad}: {message}");
        }
        for bad in ["../a", "/etc/passwd", "a/../../b", "a\\..\\b", "C:/x", "."] {
            let (list, _) = parse(&format!("1 ok\n2 {bad}\n"), false);
            let message = list.expect_err(bad).to_string();
            assert!(
                message.starts_with("rgb.txt:2: found name") && message.contains("without `..`"),
                "{bad}: {message}"
            );
        }
        for empty in ["", "# only\n\n"] {
            assert!(
                matches!(parse(empty, false).0, Err(DatasetError::EmptyList { .. })),
                "{empty:?}"
            );
        }
    }

    /// A damaged list gives a list or an error, never a panic.
    #[test]
    fn damaged_lists_do_not_panic() {
        let good = b"\xEF\xBB\xBF# t\r\n1.50\trgb/1.50.png\r\n2.5 rgb/2.5.png\n3 ./rgb/3.png\n";
        let mut refused = 0;
        for case in 0..4000u64 {
            let mut rng = garad_core::Rng::keyed(29, &[case]);
            let mut bytes = good.to_vec();
            crate::damage::damage(&mut bytes, &mut rng);
            let strict = rng.below(2) == 1;
            match parse_list(Path::new("rgb.txt"), &bytes, strict, &mut Vec::new()) {
                Ok(list) => {
                    assert!(list.is_sorted_by(|a, b| a.t_s < b.t_s), "ascending");
                    let inside = |entry: &Entry| clean_name(&entry.file).is_some();
                    assert!(list.iter().all(inside), "names stay inside");
                }
                Err(error) => {
                    refused += 1;
                    assert!(!error.to_string().contains('\n'), "one line: {error}");
                }
            }
        }
        assert!(
            refused > 500,
            "damage is noticed, {refused} of 4000 refused"
        );
    }

    /// Whole seconds at 3 images a second, against a list that was written twice.
    #[test]
    fn times_too_coarse_to_tell_images_apart() {
        let coarse = "10 a\n10 b\n10 c\n11 d\n11 e\n11 f\n";
        let message = parse(coarse, false).0.expect_err("coarse").to_string();
        assert!(
            message.starts_with("rgb.txt:2: found 6 images with 2 different times"),
            "{message}"
        );
        let twice = "10 a\n11 b\n10 a\n11 b\n";
        assert_eq!(parse(twice, false).0.expect("dropped").len(), 2, "twice");
        let one_of_five = "10 a\n11 b\n12 c\n12 d\n13 e\n";
        assert_eq!(
            parse(one_of_five, false).0.expect("dropped").len(),
            4,
            "20 %"
        );
    }
}
