//! Text files line by line: byte order mark, CRLF, comments, limits; and the numbers in them.

use std::path::Path;

use crate::errors::{DatasetError, excerpt};
use crate::limits;

/// File and line, for messages.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Place<'a> {
    pub(crate) path: &'a Path,
    pub(crate) line: usize,
}

impl Place<'_> {
    pub(crate) fn error(self, found: impl Into<String>, expected: &'static str) -> DatasetError {
        DatasetError::Line {
            path: self.path.to_path_buf(),
            line: self.line,
            found: found.into(),
            expected,
        }
    }
}

/// Calls `each` with every line that is neither blank nor a comment (`#`), trimmed.
///
/// A UTF-8 byte order mark and carriage returns are skipped. The first error ends the reading.
///
/// # Errors
/// [`DatasetError::Line`] for text that is not UTF-8, [`DatasetError::TooLarge`] for a line
/// longer than [`limits::LINE_BYTES`] or more lines than [`limits::LIST_LINES`].
pub(crate) fn for_each_line(
    path: &Path,
    bytes: &[u8],
    mut each: impl FnMut(Place<'_>, &str) -> Result<(), DatasetError>,
) -> Result<(), DatasetError> {
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    for (index, raw) in bytes.split(|&b| b == b'\n').enumerate() {
        let place = Place {
            path,
            line: index + 1,
        };
        let too_large = |what, value: usize, limit: usize| DatasetError::TooLarge {
            path: path.to_path_buf(),
            what,
            value: value as u64,
            limit: limit as u64,
        };
        if index >= limits::LIST_LINES && !raw.is_empty() {
            return Err(too_large("number of lines", index + 1, limits::LIST_LINES));
        }
        if raw.len() > limits::LINE_BYTES {
            return Err(too_large("bytes of a line", raw.len(), limits::LINE_BYTES));
        }
        let Ok(text) = std::str::from_utf8(raw) else {
            return Err(place.error(excerpt(&String::from_utf8_lossy(raw)), "UTF-8 text"));
        };
        let text = text.trim();
        if !text.is_empty() && !text.starts_with('#') {
            each(place, text)?;
        }
    }
    Ok(())
}

/// A finite number.
pub(crate) fn number(
    place: Place<'_>,
    field: &str,
    expected: &'static str,
) -> Result<f64, DatasetError> {
    match field.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err(place.error(excerpt(field), expected)),
    }
}

/// A time in seconds, from 0 to [`limits::TIME_S`].
pub(crate) fn time_s(place: Place<'_>, field: &str) -> Result<f64, DatasetError> {
    const EXPECTED: &str = "a time in seconds, finite, from 0 to 1e11";
    let t_s = number(place, field, EXPECTED)?;
    if (0.0..=limits::TIME_S).contains(&t_s) {
        Ok(t_s.abs()) // -0 becomes 0
    } else {
        Err(place.error(excerpt(field), EXPECTED))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(bytes: &[u8]) -> Result<Vec<(usize, String)>, DatasetError> {
        let mut seen = Vec::new();
        for_each_line(Path::new("list.txt"), bytes, |place, text| {
            seen.push((place.line, text.to_owned()));
            Ok(())
        })?;
        Ok(seen)
    }

    #[test]
    fn marks_returns_comments_and_blanks_are_skipped() {
        let seen = lines(b"\xEF\xBB\xBF# title\r\n\r\n 1 a\t\r\n  # more\n2 b").expect("fine");
        assert_eq!(seen, [(3, "1 a".to_owned()), (5, "2 b".to_owned())]);
        assert_eq!(lines(b"").expect("fine"), [], "nothing");
    }

    #[test]
    fn other_encodings_and_long_lines_are_refused() {
        let message = lines(b"1 a\n2 \xFF\xFE\n")
            .expect_err("not UTF-8")
            .to_string();
        assert!(
            message.starts_with("list.txt:2:") && message.contains("UTF-8"),
            "{message}"
        );
        let mut long = vec![b'1'; limits::LINE_BYTES];
        assert!(lines(&long).is_ok(), "just short enough");
        long.push(b'1');
        assert!(
            matches!(
                lines(&long),
                Err(DatasetError::TooLarge { value: 4097, .. })
            ),
            "one byte too long"
        );
        let many = vec![b'\n'; limits::LIST_LINES];
        assert!(lines(&many).is_ok(), "just few enough");
        let one_more = [many, b"1".to_vec()].concat();
        assert!(
            matches!(
                lines(&one_more),
                Err(DatasetError::TooLarge {
                    value: 1_000_001,
                    ..
                })
            ),
            "one line too many"
        );
    }

    #[test]
    fn times_are_finite_seconds() {
        let place = Place {
            path: Path::new("list.txt"),
            line: 7,
        };
        for bad in ["nan", "inf", "-inf", "-0.5", "1e300", "1.5e18", "x", "1,5"] {
            let message = time_s(place, bad).expect_err(bad).to_string();
            assert!(message.starts_with("list.txt:7:"), "{message}");
        }
        assert!(time_s(place, "1e11").is_ok(), "the latest");
        assert!(time_s(place, "-0").expect("zero").is_sign_positive(), "-0");
    }
}
