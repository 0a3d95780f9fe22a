//! [`Metrics`]: how an answer that is out of tolerance differs as a whole.
//!
//! A wrong factor leaves the cosine at 1, a wrong term turns it; rows that are zero where the
//! expected ones are not were never computed.

use std::fmt;

/// Two tensors as vectors, and as lists of rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Metrics {
    /// |got - expected| / |expected|, Euclidean.
    pub rel_l2: f64,
    /// Cosine of the angle between the two.
    pub cosine: f64,
    /// Rows of zeros that should not be.
    pub rows_missing: usize,
    /// Rows that should be zeros.
    pub rows_extra: usize,
    /// Rows in all.
    pub rows: usize,
}

impl Metrics {
    /// Of tensors with rows of `columns` numbers; `None` unless both have as many numbers, all of
    /// them finite, and a direction.
    #[must_use]
    pub fn of(expected: &[f64], got: &[f64], columns: usize) -> Option<Self> {
        let finite = |v: &[f64]| v.iter().all(|x| x.is_finite());
        if expected.len() != got.len() || columns == 0 || !finite(expected) || !finite(got) {
            return None;
        }
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
        let (ee, gg) = (dot(expected, expected).sqrt(), dot(got, got).sqrt());
        let off = expected.iter().zip(got).map(|(e, g)| (g - e) * (g - e));
        let off = off.sum::<f64>().sqrt();
        let zero = |row: &[f64]| row.iter().all(|&v| v == 0.0);
        let rows = expected.chunks(columns).zip(got.chunks(columns));
        let missing = rows.clone().filter(|(e, g)| !zero(e) && zero(g));
        let extra = rows.clone().filter(|(e, g)| zero(e) && !zero(g));
        (ee > 0.0 && gg > 0.0).then(|| Self {
            rel_l2: off / ee,
            cosine: dot(expected, got) / (ee * gg),
            rows_missing: missing.count(),
            rows_extra: extra.count(),
            rows: rows.len(),
        })
    }
}

impl fmt::Display for Metrics {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            rel_l2,
            cosine,
            rows_missing,
            rows_extra,
            rows,
        } = self;
        write!(f, "as a whole off by {rel_l2:.2e}, cosine {cosine:.6}")?;
        if *rows_missing > 0 {
            write!(
                f,
                "; {rows_missing} of {rows} rows are zeros that should not be"
            )?;
        }
        if *rows_extra > 0 {
            write!(f, "; {rows_extra} of {rows} rows should be zeros")?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_factor_keeps_the_direction_and_a_lost_row_is_counted() {
        let expected = [3.0, 0.0, 4.0, 0.0, 0.0, 0.0];
        let twice = Metrics::of(&expected, &expected.map(|v| 2.0 * v), 2).unwrap();
        assert!((twice.rel_l2 - 1.0).abs() < 1e-15, "{twice}");
        assert!((twice.cosine - 1.0).abs() < 1e-15, "{twice}");
        let lost = Metrics::of(&expected, &[3.0, 0.0, 0.0, 0.0, 0.0, 1.0], 2).unwrap();
        assert_eq!(
            (lost.rows_missing, lost.rows_extra, lost.rows),
            (1, 1, 3),
            "{lost}"
        );
        let text = lost.to_string();
        assert!(
            text.contains("1 of 3 rows are zeros that should not be"),
            "{text}"
        );
    }

    #[test]
    fn what_has_no_direction_has_no_metrics() {
        assert_eq!(Metrics::of(&[0.0], &[1.0], 1), None, "zero");
        assert_eq!(Metrics::of(&[f64::NAN], &[1.0], 1), None, "NaN");
        assert_eq!(Metrics::of(&[1.0], &[1.0, 2.0], 1), None, "counts");
    }

    /// (3, 4, 0) and (4, 0, 3): cosine 12/25, off by √26; rows of one number.
    #[test]
    fn direction_and_distance_by_hand() {
        let m = Metrics::of(&[3.0, 4.0, 0.0], &[4.0, 0.0, 3.0], 1).unwrap();
        assert!((m.cosine - 0.48).abs() < 1e-15, "{m}");
        assert!((m.rel_l2 - 26f64.sqrt() / 5.0).abs() < 1e-15, "{m}");
        assert_eq!((m.rows_missing, m.rows_extra, m.rows), (1, 1, 3), "{m}");
        let opposite = Metrics::of(&[1.0, 2.0], &[-2.0, -4.0], 2).unwrap();
        assert!((opposite.cosine + 1.0).abs() < 1e-15, "{opposite}");
        assert!((opposite.rel_l2 - 3.0).abs() < 1e-15, "{opposite}");
    }
}
