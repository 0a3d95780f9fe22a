//! [`Node`]: a Gaussian in the field, with the four cues of eq. 2.
//!
//! The paper's assumptions (sec. III-A): dynamic Gaussians have larger reprojection errors,
//! vary more in depth, are observed less often, and lie further from their epipolar lines. Each is
//! one number here; any of them may be missing.

use nalgebra::{Vector2, Vector3};

use crate::error::CrfError;

/// The cues of one Gaussian. The paper's letters: α reprojection, β depth, γ observations,
/// δ epipolar.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Cues {
    /// Mean over the observing keyframes of the distance between the keypoint and the projected
    /// point, px; neither squared nor divided by the scale of the keypoint.
    pub reproj_px: Option<f64>,
    /// Mean over the observations of |measured - predicted depth| in standard deviations of the
    /// sensor, see [`DepthNoise`]; no unit.
    pub depth_residual: Option<f64>,
    /// Number of observing keyframes.
    pub observations: Option<u32>,
    /// Mean over the observations of the symmetric distance (d + d') / 2 to the epipolar lines, px.
    /// Leave it out when the baseline is too short for the lines to mean anything.
    pub epipolar_px: Option<f64>,
}

/// A Gaussian in the field, tagged (with cues) or not (with few or none).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Node {
    /// Centre in the world, metres.
    pub p_world: Vector3<f64>,
    /// Where the current keyframe sees it, px; may lie outside of the image.
    pub uv_px: Option<Vector2<f64>>,
    /// Its cues.
    pub cues: Cues,
    /// Belief of being dynamic from an earlier run, in [0, 1].
    pub previous: Option<f64>,
}

impl Node {
    /// # Errors
    /// [`CrfError::BadNode`] with the first number that is not finite or outside its range; `index`
    /// is passed on.
    pub fn validate(&self, index: usize) -> Result<(), CrfError> {
        let check = |what, value: f64, low: f64, high: f64, expected| {
            if value >= low && value <= high && value.is_finite() {
                Ok(())
            } else {
                Err(CrfError::BadNode {
                    node: index,
                    what,
                    value,
                    expected,
                })
            }
        };
        let any = (f64::NEG_INFINITY, f64::INFINITY, "a finite number");
        let distance = (0.0, f64::INFINITY, "a finite number of at least 0");
        let share = (0.0, 1.0, "a number in [0, 1]");
        let uv = self.uv_px.map(|uv| [uv.x, uv.y]);
        for (what, value, (low, high, expected)) in [
            ("p_world.x", Some(self.p_world.x), any),
            ("p_world.y", Some(self.p_world.y), any),
            ("p_world.z", Some(self.p_world.z), any),
            ("uv_px.x", uv.map(|uv| uv[0]), any),
            ("uv_px.y", uv.map(|uv| uv[1]), any),
            ("reproj_px", self.cues.reproj_px, distance),
            ("depth_residual", self.cues.depth_residual, distance),
            ("epipolar_px", self.cues.epipolar_px, distance),
            ("previous", self.previous, share),
        ] {
            if let Some(value) = value {
                check(what, value, low, high, expected)?;
            }
        }
        Ok(())
    }
}

/// Noise of a depth sensor that triangulates (Kinect, RealSense, Xtion): σ(z) = c z².
///
/// Such a sensor measures a disparity d = b f / z with the same noise everywhere, and
/// dz = z² / (b f) dd. A residual of 3 cm is less than σ at 5 m and 20 σ at 1 m. The floor stands for
/// quantisation and rolling shutter at short range.
///
/// # Example
/// ```
/// use garad_crf::DepthNoise;
/// let noise = DepthNoise::default(); // 1.4 mm at 1 m, 12.6 mm at 3 m
/// assert!((noise.sigma_m(3.0) - 0.0126).abs() < 1e-15);
/// assert!((noise.in_sigmas(0.063, 3.0) - 5.0).abs() < 1e-12);
/// assert_eq!(noise.sigma_m(0.1), 0.001); // the floor
/// ```
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DepthNoise {
    /// c, 1/m. About 1.4e-3 for a Kinect.
    pub per_m: f64,
    /// Smallest σ, metres.
    pub floor_m: f64,
}

impl Default for DepthNoise {
    fn default() -> Self {
        Self {
            per_m: 1.4e-3,
            floor_m: 1e-3,
        }
    }
}

impl DepthNoise {
    /// σ(z) = max(c z², floor), metres.
    #[must_use]
    pub fn sigma_m(&self, depth_m: f64) -> f64 {
        (self.per_m * (depth_m * depth_m)).max(self.floor_m)
    }

    /// |residual| / σ(z).
    #[must_use]
    pub fn in_sigmas(&self, residual_m: f64, depth_m: f64) -> f64 {
        residual_m.abs() / self.sigma_m(depth_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_numbers_are_named() {
        let name = |node: Node| match node.validate(3) {
            Err(CrfError::BadNode { node: 3, what, .. }) => what,
            other => panic!("{other:?}"),
        };
        let node = Node::default();
        assert_eq!(node.validate(3), Ok(()), "all cues may be missing");
        let mut bad = node;
        bad.p_world.y = f64::NAN;
        assert_eq!(name(bad), "p_world.y", "NaN");
        let mut bad = node;
        bad.uv_px = Some(Vector2::new(0.0, f64::INFINITY));
        assert_eq!(name(bad), "uv_px.y", "infinite");
        let mut bad = node;
        bad.cues.reproj_px = Some(-0.1);
        assert_eq!(name(bad), "reproj_px", "negative distance");
        let mut bad = node;
        bad.previous = Some(1.0 + 1e-9);
        assert_eq!(name(bad), "previous", "above 1");
    }

    #[test]
    fn depth_noise_grows_with_the_square_above_its_floor() {
        let noise = DepthNoise {
            per_m: 0.002,
            floor_m: 0.001,
        };
        // 0.002 z²: 18 mm at 3 m, 2 mm at 1 m; 0.5 mm at 0.5 m, which the floor lifts to 1 mm.
        for (depth_m, sigma_m) in [(3.0, 0.018), (1.0, 0.002), (0.5, 0.001)] {
            let got = noise.sigma_m(depth_m);
            assert!((got - sigma_m).abs() < 1e-15, "{got} at {depth_m} m");
        }
        let sigmas = noise.in_sigmas(-0.045, 3.0);
        assert!((sigmas - 2.5).abs() < 1e-12, "{sigmas}");
    }
}
