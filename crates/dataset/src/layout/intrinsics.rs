//! Cameras that a layout describes.

use std::path::Path;

use garad_core::Camera;
use serde::de::DeserializeOwned;

use crate::calibration::Calibration;
use crate::decode::can_shrink;
use crate::errors::DatasetError;
use crate::text::Place;

/// Frames per second where a layout does not say.
pub(super) const FPS: f64 = 30.0;
/// Raw depth per metre of images in millimetres.
pub(super) const MILLIMETRES: f64 = 1000.0;

/// A JSON file; `expected` says what it should hold.
pub(super) fn json<T: DeserializeOwned>(
    path: &Path,
    bytes: &[u8],
    expected: &'static str,
) -> Result<T, DatasetError> {
    let bytes = bytes.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(bytes);
    serde_json::from_slice(bytes).map_err(|error| {
        let line = error.line();
        Place { path, line }.error(error.to_string(), expected)
    })
}

/// A camera read from `path`, depth in `depth_factor` a metre at 30 frames per second.
pub(super) fn calibration(
    path: &Path,
    camera: Camera,
    depth_factor: f64,
) -> Result<Calibration, DatasetError> {
    let invalid = |source| DatasetError::Camera {
        path: path.to_path_buf(),
        line: 1,
        source,
    };
    camera.validate().map_err(invalid)?;
    if !(depth_factor > 0.0 && depth_factor.is_finite()) {
        let found = format!("{depth_factor} for the raw depth of a metre");
        return Err(Place { path, line: 1 }.error(found, "a positive number"));
    }
    let source = format!("file {}", path.display());
    Calibration::of_camera(camera, depth_factor, FPS, source)
}

/// The calibration for images scaled down to `size`; unchanged if that is another view or a larger one.
///
/// f' = s f, c' = s (c + 1/2) - 1/2 with s = `size` / size, since pixel centres are at integers.
pub(crate) fn scale_to(mut calibration: Calibration, size: (usize, usize)) -> Calibration {
    let camera = &mut calibration.camera;
    let from = (camera.width, camera.height);
    if from == size || !can_shrink(from, size) {
        return calibration;
    }
    let [sx, sy] = [(size.0, from.0), (size.1, from.1)].map(|(new, old)| new as f64 / old as f64);
    camera.fx *= sx;
    camera.fy *= sy;
    camera.cx = sx * (camera.cx + 0.5) - 0.5;
    camera.cy = sy * (camera.cy + 0.5) - 0.5;
    (camera.width, camera.height) = size;
    let note = format!(
        ", scaled from {}x{} to {}x{}",
        from.0, from.1, size.0, size.1
    );
    calibration.source += &note;
    calibration
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The picture's border at -1/2 stays there; its other one goes from 15.5 to 7.5 and from 11.5 to 2.875.
    #[test]
    fn cameras_scale_with_their_images() {
        let camera = |size| Camera::pinhole(size, [20.0, 24.0, 7.5, 4.0]).expect("valid");
        let path = Path::new("c.json");
        let of = |size| calibration(path, camera(size), 1000.0).expect("valid");
        let half = scale_to(of((16, 12)), (8, 6));
        assert_eq!(
            half.camera,
            Camera::pinhole((8, 6), [10.0, 12.0, 3.5, 1.75]).expect("valid")
        );
        assert_eq!(half.source, "file c.json, scaled from 16x12 to 8x6");
        for other in [(16, 12), (8, 5), (32, 24)] {
            assert_eq!(scale_to(of((16, 12)), other), of((16, 12)), "{other:?}");
        }
        assert_eq!(half.missing_from(), 60_000, "millimetres");
    }
}
