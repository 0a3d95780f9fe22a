//! Checks of the input, the same for the reference and for [`crate::fast`].

use garad_core::{Camera, GaussianMap, Image, Real, Se3};

use crate::error::RasterError;
use crate::options::{MAX_SIDE_PX, RenderOptions};
use crate::rendered::{Rendered, Upstream};
use crate::splat::Projected;

/// Camera, pose and options are usable, and the arrays of the map are of one length.
pub(crate) fn check_scene<T: Real>(
    map: &GaussianMap<T>,
    camera: &Camera,
    camera_from_world: &Se3,
    options: &RenderOptions,
) -> Result<(), RasterError> {
    camera.validate()?;
    if !camera_from_world.is_finite() {
        return Err(RasterError::PoseNotFinite);
    }
    for (channel, &value) in options.background.iter().enumerate() {
        if !T::from_f64(value).is_finite() {
            return Err(RasterError::BackgroundNotFinite { channel, value });
        }
    }
    if !(1..=MAX_SIDE_PX).contains(&options.tile_px) {
        let tile_px = options.tile_px;
        return Err(RasterError::TileSize { tile_px });
    }
    let n = map.len();
    let lengths = [
        ("log_scales", n, map.log_scales.len()),
        ("quaternions", n, map.quaternions.len()),
        ("opacity_logits", n, map.opacity_logits.len()),
        ("sh", n * map.coefficients(), map.sh.len()),
        ("label", n, map.label.len()),
    ];
    for (array, expected, got) in lengths {
        if got != expected {
            return Err(RasterError::MapLength {
                array,
                expected,
                got,
            });
        }
    }
    Ok(())
}

/// All images have the camera's size.
pub(crate) fn check_images<T: Real>(
    camera: &Camera,
    rendered: &Rendered<T>,
    upstream: &Upstream<T>,
) -> Result<(), RasterError> {
    let expected = (camera.width, camera.height);
    let size = |p: &Option<Image<T>>| p.as_ref().map_or(expected, Image::size);
    let images = [
        ("rendered.transmittance", rendered.transmittance.size()),
        ("rendered.last", rendered.last.size()),
        ("upstream.color", upstream.color.size()),
        ("upstream.depth", size(&upstream.depth)),
        ("upstream.opacity", size(&upstream.opacity)),
    ];
    check_sizes(expected, &images)
}

/// Every one of the named images has the expected size.
pub(crate) fn check_sizes(
    expected: (usize, usize),
    images: &[(&'static str, (usize, usize))],
) -> Result<(), RasterError> {
    match images.iter().find(|(_, got)| *got != expected) {
        Some(&(image, got)) => Err(RasterError::SizeMismatch {
            image,
            expected,
            got,
        }),
        None => Ok(()),
    }
}

/// Every splat names a row of the map and lies in the image.
pub(crate) fn check_splats<T: Real>(
    map: &GaussianMap<T>,
    camera: &Camera,
    splats: &[Projected<T>],
) -> Result<(), RasterError> {
    let fits = |s: &Projected<T>| {
        let f = &s.footprint;
        (s.index as usize) < map.len()
            && !f.is_empty()
            && f.x1 <= camera.width
            && f.y1 <= camera.height
    };
    match splats.iter().position(|s| !fits(s)) {
        Some(splat) => Err(RasterError::NotThisMap { splat }),
        None => Ok(()),
    }
}
