//! [`RasterError`]: input that cannot be drawn.

use garad_core::CameraError;
use thiserror::Error;

use crate::options::MAX_SIDE_PX;

/// What is wrong with the input of [`crate::render()`], [`crate::backward()`] or a loss.
///
/// A single Gaussian with a bad number is no error: it is invisible (see [`crate::Projected`]).
#[derive(Debug, Clone, PartialEq, Error)]
#[non_exhaustive]
pub enum RasterError {
    /// The calibration.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The pose.
    #[error("camera_from_world has a number that is not finite")]
    PoseNotFinite,
    /// The background.
    #[error("background channel {channel} is {value}; expected a finite number")]
    BackgroundNotFinite {
        /// 0 red, 1 green, 2 blue.
        channel: usize,
        /// Its value.
        value: f64,
    },
    /// The tile side.
    #[error("tiles of {tile_px} px; expected 1 to {MAX_SIDE_PX}")]
    TileSize {
        /// What was asked for.
        tile_px: usize,
    },
    /// An array of the map that does not have one row (or one set of SH triples) per Gaussian.
    #[error("map array {array} has {got} rows; expected {expected}")]
    MapLength {
        /// Name of the array.
        array: &'static str,
        /// Rows it should have.
        expected: usize,
        /// Rows it has.
        got: usize,
    },
    /// An image that is not of the camera's size.
    #[error(
        "{image} is {} x {} px; expected {} x {}",
        got.0, got.1, expected.0, expected.1
    )]
    SizeMismatch {
        /// Which image.
        image: &'static str,
        /// The size it should have, (columns, rows).
        expected: (usize, usize),
        /// The size it has.
        got: (usize, usize),
    },
    /// An image that this map cannot have been drawn into.
    #[error("splat {splat} of the image was not drawn from this map by this camera")]
    NotThisMap {
        /// Its place in [`crate::Rendered::projected`].
        splat: usize,
    },
    /// The weight of SSIM in the photometric loss.
    #[error("lambda is {value}; expected 0 to 1")]
    Lambda {
        /// What was asked for.
        value: f64,
    },
    /// The least opacity at which a depth is compared.
    #[error("min_opacity is {value}; expected above 0, at most 1")]
    MinOpacity {
        /// What was asked for.
        value: f64,
    },
}
