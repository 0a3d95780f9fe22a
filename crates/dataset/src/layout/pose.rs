//! Poses written as 4x4 matrices.

use std::path::Path;

use garad_core::{Se3, So3};
use nalgebra::{Matrix3, Matrix4, Vector3};

use crate::errors::{DatasetError, excerpt};
use crate::text::{Place, for_each_line};

/// Largest entry of R Rᵀ - I, and difference of the last row from 0 0 0 1.
const TOLERANCE: f64 = 1e-2;
/// What a matrix is expected to be, for messages.
pub(super) const MATRIX: &str =
    "a rigid 4x4 matrix camera to world, 16 numbers in rows, the last row 0 0 0 1";

/// The numbers of a line; infinities and NaN count as numbers.
pub(super) fn numbers(place: Place<'_>, text: &str) -> Result<Vec<f64>, DatasetError> {
    let number = |field: &str| {
        field
            .parse::<f64>()
            .map_err(|_| place.error(excerpt(field), MATRIX))
    };
    text.split_whitespace().map(number).collect()
}

/// `world_from_camera` of 16 numbers in rows; `None` for a frame marked as lost by numbers that are not finite.
pub(super) fn pose(place: Place<'_>, v: &[f64]) -> Result<Option<Se3>, DatasetError> {
    if v.len() != 16 {
        return Err(place.error(format!("{} numbers", v.len()), MATRIX));
    }
    if v.iter().any(|v| !v.is_finite()) {
        return Ok(None);
    }
    let m = Matrix4::from_row_slice(v);
    let r: Matrix3<f64> = m.fixed_view::<3, 3>(0, 0).into_owned();
    let not_unit = (r * r.transpose() - Matrix3::identity()).amax();
    let last = (v[12].abs())
        .max(v[13].abs())
        .max(v[14].abs())
        .max((v[15] - 1.0).abs());
    // Written so that NaN is an error.
    let rigid = not_unit <= TOLERANCE && last <= TOLERANCE && r.determinant() > 0.0;
    if !rigid {
        let found = format!(
            "a matrix with determinant {:.3} and last row {} {} {} {}",
            r.determinant(),
            v[12],
            v[13],
            v[14],
            v[15]
        );
        return Err(place.error(found, MATRIX));
    }
    let translation = Vector3::new(v[3], v[7], v[11]);
    Ok(Some(Se3::new(So3::from_matrix(&r), translation)))
}

/// The pose in a file of its own: 16 numbers on any number of lines.
pub(super) fn pose_file(path: &Path, bytes: &[u8]) -> Result<Option<Se3>, DatasetError> {
    let (mut values, mut last) = (Vec::new(), 1);
    for_each_line(path, bytes, |place, text| {
        last = place.line;
        values.extend(numbers(place, text)?);
        Ok(())
    })?;
    pose(Place { path, line: last }, &values)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A quarter turn about z: x of the camera points along y of the world.
    const QUARTER: &str = "0 -1 0 1.5\n1 0 0 -2.5\n0 0 1 3.5\n0 0 0 1\n";

    #[test]
    fn rows_are_those_of_world_from_camera() {
        let read = |text: &str| pose_file(Path::new("p.txt"), text.as_bytes());
        let pose = read(QUARTER).expect("rigid").expect("not lost");
        let p_world = pose * Vector3::new(1.0, 0.0, 0.0);
        let expected = Vector3::new(1.5, -1.5, 3.5);
        assert!((p_world - expected).amax() < 1e-12, "{p_world}");
        let lost = QUARTER.replace("1.5", "-inf");
        assert_eq!(read(&lost).expect("lost"), None, "lost");
        let nan = QUARTER.replace("3.5", "nan");
        assert_eq!(read(&nan).expect("lost"), None, "lost");
        for (from, to, words) in [
            (
                "-1 0 1.5",
                "1 0 1.5",
                "p.txt:4: found a matrix with determinant -1.000",
            ),
            ("-1 0 1.5", "-1.02 0 1.5", "determinant 1.020"),
            ("0 0 0 1", "1.5 0 0 1", "last row 1.5 0 0 1"),
            ("0 0 0 1", "0 0 0", "15 numbers"),
            ("3.5", "x", "p.txt:3: found \"x\""),
        ] {
            let error = read(&QUARTER.replace(from, to)).expect_err(words);
            assert!(error.to_string().contains(words), "{words}: {error}");
        }
        read(&QUARTER.replace("-1 0 1.5", "-1.004 0 1.5")).expect("few decimals");
    }
}
