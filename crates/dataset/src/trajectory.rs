//! Trajectories in TUM format: lines `timestamp tx ty tz qx qy qz qw`, `world_from_camera`.

use std::io::{self, Write};
use std::path::Path;

use garad_core::{Se3, So3, StampedPose};
use nalgebra::Vector3;

use crate::atomic::write_atomically;
use crate::errors::{DatasetError, excerpt};
use crate::files::read_file;
use crate::text::{Place, for_each_line, number, time_s};

/// Tolerance of the length of a written quaternion; the four decimals of the TUM files cost 1e-4.
const QUATERNION_TOLERANCE: f64 = 1e-3;
/// Lines left out that are named one by one.
const LINES_NAMED: usize = 3;
const EXPECTED: &str = "`timestamp tx ty tz qx qy qz qw`, finite numbers";

/// Reads a trajectory file.
///
/// # Errors
/// [`DatasetError::NotFound`], and what [`parse_trajectory`] finds.
pub fn read_trajectory(path: &Path) -> Result<Vec<StampedPose>, DatasetError> {
    let bytes = read_file(path)?
        .ok_or_else(|| DatasetError::not_found(path, "a trajectory in TUM format"))?;
    parse_trajectory(path, &bytes)
}

/// Reads a trajectory from the bytes of its file; `path` is for messages.
///
/// Strict: eight numbers a line, times strictly ascending. Quaternions are normalised. A file without
/// a pose gives an empty trajectory.
///
/// # Errors
/// [`DatasetError::Line`] for a line of another shape, a number that is not finite, a time that
/// does not ascend, or a quaternion whose length is not 1 within 1e-3.
///
/// # Example
/// ```
/// let text = b"# a camera 2 m up, upside down\n1.5 0 0 2 1 0 0 0\n";
/// let poses = garad_dataset::parse_trajectory("t.txt".as_ref(), text)?;
/// assert_eq!(poses[0].t_s, 1.5);
/// assert_eq!(poses[0].world_from_camera.translation.z, 2.0);
/// assert_eq!(poses[0].world_from_camera.rotation.quaternion(), [0.0, 1.0, 0.0, 0.0]); // w first
/// # Ok::<(), garad_dataset::DatasetError>(())
/// ```
pub fn parse_trajectory(path: &Path, bytes: &[u8]) -> Result<Vec<StampedPose>, DatasetError> {
    parse_lines(path, bytes, Err)
}

/// [`parse_trajectory`], but a line that cannot be used is left out and named in `warnings`.
///
/// # Errors
/// [`DatasetError::Line`] for text that is not UTF-8, [`DatasetError::TooLarge`].
pub(crate) fn parse_leniently(
    path: &Path,
    bytes: &[u8],
    warnings: &mut Vec<String>,
) -> Result<Vec<StampedPose>, DatasetError> {
    let (mut left_out, mut more) = (Vec::new(), 0);
    let poses = parse_lines(path, bytes, |error| {
        match left_out.len() < LINES_NAMED {
            true => left_out.push(format!("{error}; the line is left out")),
            false => more += 1,
        }
        Ok(())
    })?;
    warnings.append(&mut left_out);
    if more > 0 {
        warnings.push(format!("{}: {more} more lines left out", path.display()));
    }
    Ok(poses)
}

/// Poses in ascending order of time; `bad` decides what becomes of a line that cannot be used.
fn parse_lines(
    path: &Path,
    bytes: &[u8],
    mut bad: impl FnMut(DatasetError) -> Result<(), DatasetError>,
) -> Result<Vec<StampedPose>, DatasetError> {
    let mut poses: Vec<StampedPose> = Vec::new();
    for_each_line(path, bytes, |place, text| {
        let pose = match parse_pose(place, text) {
            Ok(pose) => pose,
            Err(error) => return bad(error),
        };
        // Written so that NaN is an error.
        let later = poses.last().is_none_or(|last| pose.t_s > last.t_s);
        if !later {
            let found = format!("time {} after one that is not earlier", pose.t_s);
            return bad(place.error(found, "ascending times"));
        }
        poses.push(pose);
        Ok(())
    })?;
    Ok(poses)
}

fn parse_pose(place: Place<'_>, text: &str) -> Result<StampedPose, DatasetError> {
    let fields: Vec<&str> = text.split_whitespace().collect();
    let [time, rest @ ..] = &fields[..] else {
        return Err(place.error(excerpt(text), EXPECTED));
    };
    if rest.len() != 7 {
        return Err(place.error(format!("{} columns", fields.len()), EXPECTED));
    }
    let t_s = time_s(place, time)?;
    let mut v = [0.0; 7];
    for (value, field) in v.iter_mut().zip(rest) {
        *value = number(place, field, EXPECTED)?;
    }
    let [tx, ty, tz, qx, qy, qz, qw] = v;
    let norm = (qx * qx + qy * qy + qz * qz + qw * qw).sqrt();
    let rotation = So3::from_quaternion(qw, qx, qy, qz)
        .filter(|_| (norm - 1.0).abs() <= QUATERNION_TOLERANCE)
        .ok_or_else(|| {
            place.error(
                format!("a quaternion of length {norm}"),
                "qx qy qz qw of length 1 within 0.001",
            )
        })?;
    Ok(StampedPose {
        t_s,
        world_from_camera: Se3::new(rotation, Vector3::new(tx, ty, tz)),
    })
}

/// Writes a trajectory file, whole or not at all.
///
/// # Errors
/// [`DatasetError::PoseNotFinite`], [`DatasetError::Io`].
pub fn write_trajectory(path: &Path, poses: &[StampedPose]) -> Result<(), DatasetError> {
    check_finite(path, poses)?;
    write_atomically(path, |out| format_trajectory(out, poses))
}

/// Writes a trajectory: times with 6 decimals, the rest with 9, no negative zeros, one comment
/// line with the columns. The same poses give the same bytes.
///
/// # Errors
/// Those of `out`.
pub fn format_trajectory(out: &mut impl Write, poses: &[StampedPose]) -> io::Result<()> {
    writeln!(out, "# timestamp tx ty tz qx qy qz qw (world_from_camera)")?;
    for pose in poses {
        let t = &pose.world_from_camera.translation;
        let [qw, qx, qy, qz] = pose.world_from_camera.rotation.quaternion();
        write!(out, "{}", decimals(pose.t_s, 6))?;
        for value in [t.x, t.y, t.z, qx, qy, qz, qw] {
            write!(out, " {}", decimals(value, 9))?;
        }
        writeln!(out)?;
    }
    Ok(())
}

fn check_finite(path: &Path, poses: &[StampedPose]) -> Result<(), DatasetError> {
    let finite = |pose: &StampedPose| {
        let q = pose.world_from_camera.rotation.quaternion();
        let t = &pose.world_from_camera.translation;
        pose.t_s.is_finite() && t.iter().chain(&q).all(|v| v.is_finite())
    };
    match poses.iter().position(|pose| !finite(pose)) {
        Some(index) => Err(DatasetError::PoseNotFinite {
            path: path.to_path_buf(),
            index,
        }),
        None => Ok(()),
    }
}

/// Fixed decimals; no negative zero.
fn decimals(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    match text.strip_prefix('-') {
        Some(zero) if zero.bytes().all(|b| b == b'0' || b == b'.') => zero.to_owned(),
        _ => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn parse(text: &str) -> Result<Vec<StampedPose>, DatasetError> {
        parse_trajectory(Path::new("t.txt"), text.as_bytes())
    }

    fn format(poses: &[StampedPose]) -> String {
        let mut bytes = Vec::new();
        format_trajectory(&mut bytes, poses).expect("memory takes everything");
        String::from_utf8(bytes).expect("ASCII")
    }

    /// Stamps of recordings, in microseconds, come back with their bits; finer ones are rounded to the nearest.
    #[test]
    fn microseconds_are_kept() {
        for (stamp, written) in [
            ("1305031102.175304", "1305031102.175304"), // TUM
            ("1548266469.88155", "1548266469.881550"),  // BONN
            ("0.000001", "0.000001"),
            ("99999999.999999", "99999999.999999"),
            ("2147483648.000001", "2147483648.000001"),
            ("12.0000004", "12.000000"),
            ("12.0000006", "12.000001"),
            ("1305031102.175304123", "1305031102.175304"),
        ] {
            let pose = |t_s| StampedPose {
                t_s,
                world_from_camera: Se3::identity(),
            };
            let t_s: f64 = stamp.parse().expect("a number");
            let text = format(&[pose(t_s)]);
            let line = text.lines().nth(1).expect("a pose");
            assert!(line.starts_with(&format!("{written} ")), "{stamp}: {line}");
            let read = parse(&text).expect("own text")[0].t_s;
            let expected: f64 = written.parse().expect("a number");
            assert_eq!(read.to_bits(), expected.to_bits(), "{stamp}");
        }
    }

    #[test]
    fn bad_lines_are_reported() {
        let cases = [
            ("1 0 0 0 0 0 0", "7 columns"),
            ("1 0 0 0 0 0 0 1 0", "9 columns"),
            ("1,0,0,0,0,0,0,1", "1 columns"),
            ("nan 0 0 0 0 0 0 1", "nan"),
            ("-1 0 0 0 0 0 0 1", "-1"),
            ("1 0 0 inf 0 0 0 1", "inf"),
            ("1 0 x 0 0 0 0 1", "\"x\""),
            ("1 0 0 0 0 0 0 0", "length 0"),
            ("1 0 0 0 0 0 0 NaN", "NaN"),
            ("0.5 0 0 0 0 0 0 1", "time 0.5 after"),
            ("0.25 0 0 0 0 0 0 1", "time 0.25 after"),
        ];
        for (line, expected) in cases {
            let text = format!("# title\n0.5 0 0 0 0 0 0 1\n{line}\n");
            let message = parse(&text).expect_err(line).to_string();
            assert!(
                message.starts_with("t.txt:3: ") && message.contains(expected),
                "{line}: {message}"
            );
        }
        assert_eq!(parse("# nothing\n").expect("no pose").len(), 0, "empty");
    }

    /// A header, a doubled line, a NaN, a line out of order, one that is cut: all left out, three named.
    #[test]
    fn leniently_bad_lines_are_left_out() {
        let text = "time x y z\n1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n2 nan 0 0 0 0 0 1\n\
                    0.5 0 0 0 0 0 0 1\n3 0 0 0\n4 0 0 2 0 0 0 1\n";
        let mut warnings = Vec::new();
        let poses = parse_leniently(Path::new("t.txt"), text.as_bytes(), &mut warnings);
        let times: Vec<f64> = poses.expect("lines").iter().map(|p| p.t_s).collect();
        assert_eq!(times, [1.0, 4.0], "what can be used");
        assert_eq!(warnings.len(), 4, "{warnings:?}");
        let named = ["t.txt:1: ", "t.txt:3: ", "t.txt:4: ", "t.txt: 2 more lines"];
        for (warning, start) in warnings.iter().zip(named) {
            assert!(warning.starts_with(start), "{warning}, expected {start}");
        }
    }

    #[test]
    fn quaternions_of_nearly_unit_length_are_normalised() {
        for (qw, good) in [
            (1.0009, true),
            (0.9991, true),
            (1.0011, false),
            (0.9989, false),
        ] {
            let answer = parse(&format!("1 0 0 0 0 0 0 {qw}"));
            assert_eq!(answer.is_ok(), good, "length {qw}");
            if let Ok(poses) = answer {
                assert_eq!(
                    poses[0].world_from_camera.rotation,
                    So3::identity(),
                    "unit length"
                );
            }
        }
    }

    #[test]
    fn written_form_is_fixed() {
        let pose = StampedPose {
            t_s: 1_305_031_453.359_684,
            world_from_camera: Se3::new(
                So3::from_quaternion(0.5, -0.5, 0.5, 0.5).expect("unit length"),
                Vector3::new(-1e-12, 0.1, -2.0),
            ),
        };
        assert_eq!(
            format(&[pose]),
            "# timestamp tx ty tz qx qy qz qw (world_from_camera)\n\
             1305031453.359684 0.000000000 0.100000000 -2.000000000 \
             -0.500000000 0.500000000 0.500000000 0.500000000\n",
            "6 and 9 decimals, w last, no negative zero"
        );
        assert_eq!(decimals(-0.0, 3), "0.000", "negative zero");
        assert_eq!(decimals(-0.0006, 3), "-0.001", "no zero after rounding");
    }

    #[test]
    fn files_are_written_whole_and_finite() {
        let folder = tempfile::tempdir().expect("temporary folder");
        let path = folder.path().join("trajectory.txt");
        let pose = |t_s: f64| StampedPose {
            t_s,
            world_from_camera: Se3::identity(),
        };
        write_trajectory(&path, &[pose(1.0), pose(2.0)]).expect("written");
        assert_eq!(
            read_trajectory(&path).expect("read"),
            [pose(1.0), pose(2.0)],
            "back"
        );
        let answer = write_trajectory(&path, &[pose(1.0), pose(f64::NAN)]);
        assert!(
            matches!(answer, Err(DatasetError::PoseNotFinite { index: 1, .. })),
            "{answer:?}"
        );
        assert_eq!(
            read_trajectory(&path).expect("the old one").len(),
            2,
            "untouched"
        );
        let nowhere = read_trajectory(&folder.path().join("none.txt"));
        assert!(
            matches!(nowhere, Err(DatasetError::NotFound { .. })),
            "{nowhere:?}"
        );
    }

    proptest! {
        #[test]
        fn round_trip(
            v in proptest::array::uniform6(-3.0f64..3.0),
            start in 0.0f64..2e9,
        ) {
            let xi = nalgebra::Vector6::from(v);
            let poses: Vec<StampedPose> = (0..3)
                .map(|i| StampedPose {
                    t_s: start + f64::from(i),
                    world_from_camera: Se3::exp(&(xi * f64::from(i))),
                })
                .collect();
            let text = format(&poses);
            let back = parse(&text).expect("our own");
            for (a, b) in poses.iter().zip(&back) {
                prop_assert!((a.t_s - b.t_s).abs() <= 1e-6, "time"); // half a step, and f64's own
                let error = (a.world_from_camera.inverse() * b.world_from_camera).log();
                prop_assert!(error.norm() < 1e-8, "{error}"); // 9 decimals, positions up to 18 m
            }
            // Reading the decimals and writing them again changes nothing but the last digit
            // of a quaternion brought to unit length.
            prop_assert_eq!(text.lines().count(), format(&back).lines().count());
        }
    }

    /// A damaged file gives a trajectory or an error, never a panic.
    #[test]
    fn damaged_files_do_not_panic() {
        let good = b"# t\r\n1.5 1 2 3 0 0 0 1\n2.5 -1e-3 +2 .5 0.5 -0.5 0.5 0.5\n3 0 0 0 1 0 0 0\n";
        let mut refused = 0;
        for case in 0..4000u64 {
            let mut rng = garad_core::Rng::keyed(19, &[case]);
            let mut bytes = good.to_vec();
            crate::damage::damage(&mut bytes, &mut rng);
            match parse_trajectory(Path::new("t.txt"), &bytes) {
                Ok(poses) => {
                    check_finite(Path::new("t.txt"), &poses).expect("what is read is finite");
                    assert!(poses.is_sorted_by(|a, b| a.t_s < b.t_s), "ascending");
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
}
