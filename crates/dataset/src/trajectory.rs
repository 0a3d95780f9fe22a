//! Trajectories in TUM format: lines `timestamp tx ty tz qx qy qz qw`, `world_from_camera`.

use std::io::{self, Write};
use std::path::Path;

use garad_core::{Se3, So3, StampedPose};
use nalgebra::Vector3;

use crate::atomic::write_atomically;
use crate::errors::{DatasetError, excerpt};
use crate::source::read_file;
use crate::text::{Place, for_each_line, number, time_s};

/// How far the length of a written quaternion may be from 1; four decimals, as the TUM files
/// have them, cost 1e-4.
const QUATERNION_TOLERANCE: f64 = 1e-3;
const EXPECTED: &str = "`timestamp tx ty tz qx qy qz qw`, finite numbers";

/// Reads a trajectory file.
///
/// # Errors
/// [`DatasetError::NotFound`], and what [`parse_trajectory`] finds.
pub fn read_trajectory(path: &Path) -> Result<Vec<StampedPose>, DatasetError> {
    let bytes = read_file(path)?.ok_or_else(|| DatasetError::NotFound {
        path: path.to_path_buf(),
        expected: "a trajectory in TUM format",
    })?;
    parse_trajectory(path, &bytes)
}

/// Reads a trajectory from the bytes of its file; `path` serves the messages.
///
/// Strict: eight numbers a line, times strictly ascending. Quaternions are brought to unit
/// length. A file without a pose gives an empty trajectory.
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
    let mut poses: Vec<StampedPose> = Vec::new();
    for_each_line(path, bytes, |place, text| {
        let pose = parse_pose(place, text)?;
        // Written so that anything but "later" is an error.
        let later = poses.last().is_none_or(|last| pose.t_s > last.t_s);
        if !later {
            let found = format!("time {} after one that is not earlier", pose.t_s);
            return Err(place.error(found, "ascending times"));
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

/// Fixed decimals; what rounds to zero has no sign.
fn decimals(value: f64, digits: usize) -> String {
    let text = format!("{value:.digits$}");
    match text.strip_prefix('-') {
        Some(zero) if zero.bytes().all(|b| b == b'0' || b == b'.') => zero.to_owned(),
        _ => text,
    }
}
