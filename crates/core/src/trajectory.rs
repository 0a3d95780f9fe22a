//! [`StampedPose`]: a camera pose with its time.

use crate::Se3;

/// One pose of a trajectory. A trajectory is a slice of these, times ascending.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StampedPose {
    /// Seconds; the zero is the recording's own.
    pub t_s: f64,
    /// The pose as TUM files hold it.
    pub world_from_camera: Se3,
}
