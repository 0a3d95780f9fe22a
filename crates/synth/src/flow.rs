//! [`flow`]: exact optical flow between two frames.

use garad_core::{Image, Par, Se3};

use crate::view::View;

/// A point is visible if the ray to it hits nothing nearer by more than this, metres.
const VISIBLE_WITHIN_M: f64 = 1e-5;

/// Displacement of the surface point at the centre of each pixel of `from`, in pixels of `to`.
///
/// p_j = world_from_solid_j · solid_from_world_i · p_i, flow = π(camera_j p_j) - (u, v)
///
/// Each rigid part of an object has its own motion. (NaN, NaN) where the point is outside the other
/// image, behind its camera, or hidden there.
pub(crate) fn flow(
    from: &View,
    to: &View,
    to_camera_from_world: &Se3,
    par: Par,
) -> Image<[f32; 2]> {
    let (width, height) = (from.camera.width, from.camera.height);
    let displacement = |x: usize, y: usize| -> Option<[f32; 2]> {
        let (u, v) = (x as f64, y as f64);
        let hit = from.cast(u, v)?;
        let p_solid = from.point_in_solid(&hit, u, v);
        let p_cam = *to_camera_from_world * (to.solids[hit.index].world_from_solid * p_solid);
        let there = to
            .camera
            .project(&p_cam)
            .filter(|uv| to.camera.contains(uv))?;
        let seen = to.cast(there.x, there.y)?;
        #[allow(clippy::cast_possible_truncation, reason = "flow images are f32")]
        let flow = [(there.x - u) as f32, (there.y - v) as f32];
        (seen.z > p_cam.z - VISIBLE_WITHIN_M).then_some(flow)
    };
    let data = par.map_chunks(height, 8, |rows| {
        rows.flat_map(|y| (0..width).map(move |x| (x, y)))
            .map(|(x, y)| displacement(x, y).unwrap_or([f32::NAN; 2]))
            .collect::<Vec<_>>()
    });
    Image::from_vec(width, height, data.concat()).unwrap_or_default()
}
